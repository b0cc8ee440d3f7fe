"""`calibrate`: the noise of a robot's motion and sensor, from a log."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from ..errors import LogError, check_choice
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
        if not knows_enough(log):
            raise LogError(
                f"{log.name} has no truth that tells poses with headings and landmarks that were seen; estimate its "
                "noise from residuals"
            )
        moved = None if log.controls is None else motion_noise(log, degrees)
        seen, line = sensor_noise(log, sensor, degrees)
        errors = {} if moved is None else _errors(moved)
        return Calibration(
            motion=None if moved is None else motion_model(moved.variances),
            sensor=sensor_model(seen.variances, sensor),
            range_scale=line.scale,
            range_bias=line.bias,
            errors=errors | _errors(seen) | {"range_scale": line.scale_error, "range_bias": line.bias_error},
            source=source,
            notes=_notes(moved, seen),
            **_counts(moved, seen),
        )
    if log.controls is None:
        raise LogError(f"{log.name} has no controls, and without them residuals cannot tell the noise")
    settled = noise_from_residuals(log, motion, sensor, degrees)
    notes = _notes(settled.motion, settled.sensor)
    if not settled.converged:
        notes += (f"the variances had not settled after {settled.rounds} rounds",)
    return Calibration(
        motion=motion_model(settled.motion.variances),
        sensor=sensor_model(settled.sensor.variances, sensor),
        errors=_errors(settled.motion) | _errors(settled.sensor),
        source=source,
        notes=notes,
        **_counts(settled.motion, settled.sensor),
    )


def _errors(fit: VarianceFit) -> dict[str, float]:
    """The standard errors of the model's numbers: standard deviations, all but epsilon, which is a variance itself."""
    return {
        name: error if name == "epsilon" or not value > 0 else error / (2 * value**0.5)
        for name, error in fit.errors.items()
        for value in (fit.variances[name],)
    }


def _counts(moved: VarianceFit | None, seen: VarianceFit) -> dict[str, dict[str, float]]:
    fits = {"sensor": seen} if moved is None else {"motion": moved, "sensor": seen}
    return {
        "degrees": {name: fit.degrees for name, fit in fits.items()},
        "counts": {name: fit.count for name, fit in fits.items()},
    }


def _notes(moved: VarianceFit | None, seen: VarianceFit) -> tuple[str, ...]:
    notes = []
    if np.isfinite(seen.degrees) and seen.degrees < HEAVY:
        notes.append(
            f"sightings have heavy tails ({seen.degrees:.1f} degrees of freedom): their noise is that of the bulk, so "
            "run with a robust kernel (--robust huber)"
        )
    if moved is not None and np.isfinite(moved.degrees) and moved.degrees < HEAVY:
        notes.append(
            f"motions have heavy tails ({moved.degrees:.1f} degrees of freedom): their noise is that of the bulk"
        )
    return tuple(notes)
