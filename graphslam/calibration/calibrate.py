"""`calibrate`: the noise of a robot's motion and sensor, from a log."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from ..checks import check_choice
from ..errors import LogError
from ..log import Log
from ..models import MotionModel, SensorModel
from .from_residuals import noise_from_residuals
from .from_truth import knows_enough, motion_noise, sensor_noise
from .parts import motion_model, sensor_model
from .variances import VarianceFit

#: where the noise may be seen
SOURCES = ("auto", "truth", "residuals")

#: fewer degrees of freedom than this are tails that squares should not be trusted with
HEAVY = 10.0


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Noise models, and how well they are known.

    Attributes:
        motion: of the motion; None from a log without controls.
        sensor: of the sensor, for ranges that are corrected by the line below.
        range_scale, range_bias: measured range = range_scale * range + range_bias [m]; 1 and 0 without truth.
        errors: standard errors of all numbers, {"nn": ..., "range_bias": ...}; NaN of those that came out as zero.
        degrees: {"motion": nu, "sensor": nu}, the degrees of freedom of Student's t; infinite where Gaussian. Where they
            are few the models are those of the bulk, and a robust kernel has to see to the rest.
        counts: {"motion": how many motions, "sensor": how many sightings} were looked at.
        source: "truth" or "residuals".
        notes: what the user should know.
    """

    motion: MotionModel | None
    sensor: SensorModel
    range_scale: float = 1.0
    range_bias: float = 0.0
    errors: dict[str, float] = field(default_factory=dict)
    degrees: dict[str, float] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    source: str = "truth"
    notes: tuple[str, ...] = ()

    @property
    def numbers(self) -> dict[str, float]:
        """All numbers by name: those of the motion, of the sensor (not its place), ``range_scale`` and ``range_bias``."""
        of_models = {} if self.motion is None else asdict(self.motion)
        of_models |= {name: value for name, value in asdict(self.sensor).items() if name != "offset"}
        if "orientation_std" not in self.errors:
            # nothing was seen of psi
            del of_models["orientation_std"]
        return of_models | {"range_scale": self.range_scale, "range_bias": self.range_bias}

    def to_json(self) -> dict[str, Any]:
        """The calibration as plain data."""
        return {
            "source": self.source,
            "motion": None if self.motion is None else asdict(self.motion),
            "sensor": asdict(self.sensor),
            "range_scale": self.range_scale,
            "range_bias": self.range_bias,
            "errors": dict(self.errors),
            "degrees": dict(self.degrees),
            "counts": dict(self.counts),
            "notes": list(self.notes),
        }

    def apply(self, log: Log) -> Log:
        """The log with these models as its own, and its ranges corrected.

        Raises:
            LogError: a corrected range would not be above zero.
        """
        corrected = log.with_corrected_ranges(self.range_scale, self.range_bias)
        return corrected.replace(motion=self.motion or log.motion, sensor=self.sensor)


def calibrate(
    log: Log,
    source: str = "auto",
    *,
    motion: MotionModel | None = None,
    sensor: SensorModel | None = None,
    degrees: float | None = None,
) -> Calibration:
    """Estimate the noise of motion and sensor from a log.

    With truth, by maximum likelihood: true motions against those of the controls, sightings against those that the true
    poses should have made, together with the line (scale, bias) by which ranges are measured. Without, from the
    residuals of the solved graph, see `from_residuals`; a scale of the ranges cannot be told from one of the odometry
    then, and is left at 1. Both take residuals for t-distributed with unknown degrees of freedom, so that slips and wrong
    sightings do not blow up the noise of all others: see `variances`.

    Args:
        log: what the robot did and saw.
        source: "truth", "residuals", or "auto": the truth where it tells poses, headings and landmarks.
        motion, sensor: where "residuals" begins, and the place of the sensor on the robot; default: the log's, or the
            book's.
        degrees: of freedom; None to estimate them, infinity for plain Gaussian likelihood.

    Raises:
        LogError: the log has not enough of what is needed.
        GraphError: its graph cannot be made or is not determined.
        OptionError: an option has an impossible value.
    """
    check_choice("source", source, SOURCES)
    motion, sensor = motion or log.motion or MotionModel(), sensor or log.sensor or SensorModel()
    if len(log.steps) == 0:
        raise LogError(f"{log.name} has no sightings at all, so the noise of the sensor cannot be told")
    if not log.identified:
        raise LogError(
            f"{log.name} has sightings that do not tell their landmark, so the noise of the sensor cannot be told"
        )
    if source == "auto":
        source = "truth" if knows_enough(log) else "residuals"
    if source == "truth":
        return _from_truth(log, sensor, degrees)
    return _from_residuals(log, motion, sensor, degrees)


def _from_truth(log: Log, sensor: SensorModel, degrees: float | None) -> Calibration:
    if not knows_enough(log):
        raise LogError(
            f"{log.name} has no truth that tells poses with headings and landmarks that were seen; estimate its noise "
            "from residuals"
        )
    moved = None if log.controls is None else motion_noise(log, degrees)
    seen, line = sensor_noise(log, sensor, degrees)
    found = _calibration("truth", moved, seen, sensor)
    errors = found.errors | {"range_scale": line.scale_error, "range_bias": line.bias_error}
    return replace(found, range_scale=line.scale, range_bias=line.bias, errors=errors)


def _from_residuals(log: Log, motion: MotionModel, sensor: SensorModel, degrees: float | None) -> Calibration:
    if log.controls is None:
        raise LogError(f"{log.name} has no controls, and without them residuals cannot tell the noise")
    settled = noise_from_residuals(log, motion, sensor, degrees)
    found = _calibration("residuals", settled.motion, settled.sensor, sensor)
    if settled.converged:
        return found
    return replace(found, notes=(*found.notes, f"the variances had not settled after {settled.rounds} rounds"))


def _calibration(source: str, moved: VarianceFit | None, seen: VarianceFit, sensor: SensorModel) -> Calibration:
    fits = {"sensor": seen} if moved is None else {"motion": moved, "sensor": seen}
    return Calibration(
        motion=None if moved is None else motion_model(moved.variances),
        sensor=sensor_model(seen.variances, sensor),
        errors={name: error for fit in fits.values() for name, error in _errors(fit).items()},
        degrees={name: fit.degrees for name, fit in fits.items()},
        counts={name: fit.count for name, fit in fits.items()},
        source=source,
        notes=tuple(_heavy_tails(fits)),
    )


def _errors(fit: VarianceFit) -> dict[str, float]:
    """The standard errors of the model's numbers: standard deviations, all but epsilon, which is a variance itself."""
    return {
        name: error if name == "epsilon" or not value > 0 else error / (2 * value**0.5)
        for name, error in fit.errors.items()
        for value in (fit.variances[name],)
    }


def _heavy_tails(fits: Mapping[str, VarianceFit]) -> Iterator[str]:
    for what, advice in (("sensor", ", so run with a robust kernel (--robust cauchy, or huber)"), ("motion", "")):
        if what in fits and fits[what].degrees < HEAVY:
            yield (
                f"{'sightings' if what == 'sensor' else 'motions'} have heavy tails ({fits[what].degrees:.1f} degrees of "
                f"freedom): their noise is that of the bulk{advice}"
            )
