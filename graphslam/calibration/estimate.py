"""`calibrate`: the noise of a robot's motion and sensor, estimated from a log."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from ..checks import check_choice
from ..errors import LogError
from ..log import Log
from ..models import MotionModel, SensorModel
from .from_residuals import MAX_ROUNDS, noise_from_residuals
from .from_truth import knows_enough, motion_noise, sensor_noise
from .parts import OF_SENSOR, with_variances

#: the choices of the option ``source``
SOURCES = ("auto", "truth", "residuals")

#: distributions with fewer degrees of freedom than this have heavy tails: plain least squares is not enough
HEAVY = 10.0


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Noise models, with their standard errors.

    Attributes:
        motion: the motion model; None from a log without controls.
        sensor: the sensor model, for ranges that are corrected by the line below.
        range_scale, range_bias: measured range = range_scale * range + range_bias [m]; 1 and 0 without ground truth.
        errors: standard errors of all numbers, {"nn": ..., "range_bias": ...}; NaN for those near zero.
        bounds: upper 95 % bounds of the numbers near zero, whose variance is less than two of its standard errors;
            infinite where the log gives no bound.
        degrees: {"motion": nu, "sensor": nu}, the degrees of freedom of Student's t; infinite where Gaussian. Where there
            are few, the models describe typical motions and sightings, without the outliers, and a robust kernel is
            needed.
        counts: {"motion": number of motions, "sensor": number of sightings} that were used.
        source: "truth" or "residuals".
        notes: what the user should know, one sentence each.
    """

    motion: MotionModel | None
    sensor: SensorModel
    range_scale: float = 1.0
    range_bias: float = 0.0
    errors: dict[str, float] = field(default_factory=dict)
    bounds: dict[str, float] = field(default_factory=dict)
    degrees: dict[str, float] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    source: str = "truth"
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """One line: source and all numbers."""
        return f"<Calibration from {self.source}: {', '.join(f'{k} {v:.3g}' for k, v in self.numbers.items())}>"

    @property
    def numbers(self) -> dict[str, float]:
        """All numbers by name: those of the motion, of the sensor (not its offset), ``range_scale`` and ``range_bias``.

        The noise of psi is left out where psi was not measured.
        """
        of_models = {} if self.motion is None else asdict(self.motion)
        of_models |= {name: getattr(self.sensor, name) for name in OF_SENSOR}
        if "orientation_std" not in self.errors:
            del of_models["orientation_std"]
        return of_models | {"range_scale": self.range_scale, "range_bias": self.range_bias}

    def to_json(self) -> dict[str, Any]:
        """The calibration as plain data."""
        return asdict(self) | {"notes": list(self.notes)}

    def apply(self, log: Log) -> Log:
        """The log with these models as its own, and its ranges corrected.

        Raises:
            LogError: a corrected range would not be above zero.
        """
        corrected = log.with_corrected_ranges(self.range_scale, self.range_bias)
        return corrected.replace(motion=self.motion or log.motion, sensor=self.sensor)


def calibrate(
    log: Log,
    *,
    source: str = "auto",
    motion: MotionModel | None = None,
    sensor: SensorModel | None = None,
    degrees: float | None = None,
) -> Calibration:
    """Estimate the noise of motion and sensor from a log.

    With ground truth, by maximum likelihood: true motions are compared with the commanded ones, and sightings with those
    that the true poses imply, together with the line (scale, bias) by which ranges are measured. Without ground truth,
    from the residuals of the solved graph, see `from_residuals`; there a scale of the ranges cannot be distinguished from
    one of the odometry, and stays 1. Both methods assume t-distributed residuals with unknown degrees of freedom, so that
    wheel slip and wrong sightings do not increase the estimated noise of all others: see `variances`.

    Args:
        log: the log of the robot.
        source: "truth", "residuals", or "auto": the truth where poses, headings and landmarks are known.
        motion, sensor: the start of the search by "residuals", and the offset of the sensor; default: the log's, or the
            book's.
        degrees: degrees of freedom; None to estimate them, infinity for a Gaussian likelihood.

    Raises:
        LogError: the log lacks what is needed.
        GraphError: its graph cannot be made or is not determined.
        OptionError: an option has an impossible value.
    """
    check_choice("source", source, SOURCES)
    motion, sensor = motion or log.motion or MotionModel(), sensor or log.sensor or SensorModel()
    if len(log.steps) == 0:
        raise LogError(f"{log.name} has no sightings at all, so the noise of the sensor cannot be estimated")
    if not log.identified:
        raise LogError(f"{log.name} has sightings without landmark ids, so the noise of the sensor cannot be estimated")
    if source == "auto":
        source = "truth" if knows_enough(log) else "residuals"
    if source == "truth":
        if not knows_enough(log):
            raise LogError(
                f"{log.name} has no ground truth with headings and landmarks that were seen; estimate its noise from "
                "residuals"
            )
        moved = None if log.controls is None else motion_noise(log, degrees)
        seen, line, line_errors = sensor_noise(log, sensor, degrees)
        converged = True
    else:
        if log.controls is None:
            raise LogError(f"{log.name} has no controls, and residuals alone do not determine the noise without them")
        moved, seen, converged = noise_from_residuals(log, motion, sensor, degrees)
        line, line_errors = {}, {}
    fits = {"sensor": seen} if moved is None else {"motion": moved, "sensor": seen}
    notes = [
        f"{what} have heavy tails ({fits[name].degrees:.1f} degrees of freedom): the values describe typical {what}, "
        f"without the outliers{advice}"
        for name, what, advice in (
            ("sensor", "sightings", ", so run with a robust kernel (--kernel cauchy, or huber)"),
            ("motion", "motions", ""),
        )
        if name in fits and fits[name].degrees < HEAVY
    ]
    if not converged:
        notes.append(f"the variances had not settled after {MAX_ROUNDS} rounds")
    return Calibration(
        motion=None if moved is None else with_variances(motion, moved.variances),
        sensor=with_variances(sensor, seen.variances),
        **line,
        errors={name: error for fit in fits.values() for name, error in fit.errors_of_model().items()} | line_errors,
        bounds={name: bound for fit in fits.values() for name, bound in fit.bounds_of_model().items()},
        degrees={name: fit.degrees for name, fit in fits.items()},
        counts={name: fit.count for name, fit in fits.items()},
        source=source,
        notes=tuple(notes),
    )
