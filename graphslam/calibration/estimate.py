"""`calibrate`: the noise of a robot's motion and sensor, estimated from a log."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any

from ..checks import array_of, check_choice, check_not_negative, check_type
from ..errors import LogError
from ..identification.parts import OF_SENSOR, with_variances
from ..log import Log, check_is_log
from ..models import MotionModel, SensorModel
from .from_residuals import CORRELATED, MAX_ROUNDS, SCALES, noise_from_residuals
from .from_truth import Means, knows_enough, knows_poses, motion_noise, sensor_noise
from .unidentified import with_found_ids
from .variances import VarianceFit

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
        range_scale, range_bias: measured range = range_scale * range + range_bias [m].
        wheel_scale, turn_rate_bias: recorded speed = wheel_scale * speed, recorded turn rate = turn rate + turn_rate_bias
            [rad/s]. From residuals one of the two scales is 1, since both together only change the size of the world. Numbers
            within three standard errors of 1 or 0 are 1 or 0.
        errors: standard errors of all numbers, {"nn": ..., "range_bias": ...}; NaN for those near zero.
        bounds: upper 95 % bounds of the numbers near zero, whose variance is less than two of its standard errors;
            infinite where the log gives no bound.
        degrees: {"motion": nu, "sensor": nu}, the degrees of freedom of Student's t; infinite where Gaussian. Where there
            are few, the models describe typical motions and sightings, without the outliers, and a robust kernel is
            needed.
        counts: {"motion": number of motions, "sensor": number of sightings} that were used.
        source: "truth" or "residuals"; the latter, too, where true poses without a map tell the numbers of the motion only.
        logs: the names of the logs.
        notes: what the user should know, one sentence each.
        doubts: why the noise should not be used, one sentence each; empty where all checks pass. Only noise from residuals
            is checked.
    """

    motion: MotionModel | None
    sensor: SensorModel
    range_scale: float = 1.0
    range_bias: float = 0.0
    wheel_scale: float = 1.0
    turn_rate_bias: float = 0.0
    errors: dict[str, float] = field(default_factory=dict)
    bounds: dict[str, float] = field(default_factory=dict)
    degrees: dict[str, float] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    source: str = "truth"
    logs: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """One line: source and all numbers."""
        return f"<Calibration from {self.source}: {', '.join(f'{k} {v:.3g}' for k, v in self.numbers.items())}>"

    @property
    def numbers(self) -> dict[str, float]:
        """All numbers by name: those of the motion, of the sensor (not its offset), and scales and biases.

        The noise of psi is left out where psi was not measured, and wheel scale and turn-rate bias without controls.
        """
        of_models = {} if self.motion is None else asdict(self.motion)
        of_models |= {name: getattr(self.sensor, name) for name in OF_SENSOR}
        if "orientation_std" not in self.errors:
            del of_models["orientation_std"]
        return of_models | self.corrections

    @property
    def corrections(self) -> dict[str, float]:
        """Scales and biases, the arguments of `Log.corrected`; those of the odometry only where there was some."""
        names = ["range_scale", "range_bias", *([] if self.motion is None else ["wheel_scale", "turn_rate_bias"])]
        return {name: getattr(self, name) for name in names}

    def to_json(self) -> dict[str, Any]:
        """The calibration as plain data."""
        return asdict(self) | {name: list(getattr(self, name)) for name in ("logs", "notes", "doubts")}

    def apply(self, log: Log) -> Log:
        """The log with these models as its own, and its ranges and odometry corrected.

        Raises:
            LogError: a corrected range would not be above zero.
        """
        values = self.corrections
        if log.controls is None:
            values = {name: value for name, value in values.items() if name.startswith("range")}
        corrected = log.corrected(**values)
        return corrected.replace(motion=self.motion or log.motion, sensor=self.sensor)


def calibrate(
    log: Log,
    *others: Log,
    source: str = "auto",
    motion: MotionModel | None = None,
    sensor: SensorModel | None = None,
    degrees: float | None = None,
    scale: str = "odometry",
) -> Calibration:
    """Estimate the noise of motion and sensor from one log or several, and what is wrong with all their measurements.

    With ground truth, by maximum likelihood: true motions are compared with the commanded ones, and sightings with those
    that the true poses imply (`from_truth`). Without ground truth, from the residuals of the solved graphs
    (`from_residuals`). Both assume t-distributed residuals with unknown degrees of freedom, so that wheel slip and wrong
    sightings do not increase the estimated noise of all others: see `variances`.

    Noise that is to be used on a log without ground truth is best calibrated from the ground truth of other robots of the
    same kind. Several logs give one noise for all; what differs between them is part of it.

    In logs whose sightings have no ids, ids and noise are found in turn, see `with_found_ids`.

    Args:
        log, others: the logs; of one kind of robot, since they share all numbers.
        source: "truth", "residuals", or "auto": the truth where poses, headings and landmarks are known. Where the map is
            not, "auto" takes the numbers of the motion from the true poses, and those of the sensor from residuals.
        motion, sensor: the start of the search by "residuals", and the offset of the sensor; default: the first log's, or
            the book's.
        degrees: degrees of freedom; None to estimate them, infinity for a Gaussian likelihood.
        scale: what has the right scale where only residuals tell: "odometry" or "ranges", relative to which the other one
            is corrected, or "both".

    Raises:
        LogError: a log lacks what is needed.
        GraphError: its graph cannot be made or is not determined.
        OptionError: an option has an impossible value.
    """
    for each in (log, *others):
        check_is_log(each)
    check_type(MotionModel, motion=motion)
    check_type(SensorModel, sensor=sensor)
    if degrees is not None:
        check_not_negative(degrees=degrees)
        degrees = float(array_of("degrees", degrees))
    check_choice("source", source, SOURCES)
    check_choice("scale", scale, tuple(SCALES))
    logs = (log, *others)
    motion, sensor = motion or log.motion or MotionModel(), sensor or log.sensor or SensorModel()
    if source == "truth" or all(each.identified for each in logs):
        return _calibrated(logs, source, motion, sensor, degrees, scale)
    _check(logs, "residuals")
    named = [with_found_ids(each, motion, sensor) for each in logs]
    first = _calibrated(tuple(each for each, _ in named), source, motion, sensor, degrees, scale)
    motion, sensor = first.motion or motion, first.sensor
    named = [with_found_ids(each, motion, sensor, first.corrections) for each in logs]
    second = _calibrated(tuple(each for each, _ in named), source, motion, sensor, degrees, scale)
    return replace(second, notes=(*(note for _, note in named if note), *second.notes))


def _calibrated(
    logs: tuple[Log, ...], source: str, motion: MotionModel, sensor: SensorModel, degrees: float | None, scale: str
) -> Calibration:
    """`calibrate` for logs with ids."""
    log = logs[0]
    if auto := source == "auto":
        source = "truth" if all(map(knows_enough, logs)) else "residuals"
    _check(logs, source)
    notes: list[str] = []
    doubts: list[str] = []
    moved: VarianceFit | None = None
    if source == "truth":
        seen, (means, errors) = sensor_noise(logs, sensor, degrees)
        if log.controls is not None:
            moved, odometry = motion_noise(logs, degrees)
            means, errors = means | odometry[0], errors | odometry[1]
    else:
        known: tuple[VarianceFit, Means] | None = None
        drives = logs
        if auto and log.controls is not None and all(map(knows_poses, logs)):
            known = motion_noise(logs, degrees)
            means = known[1][0]
            drives = tuple(each.with_corrected_odometry(means["wheel_scale"], means["turn_rate_bias"]) for each in logs)
            scale = "odometry"
            notes.append(
                "there is no true map: the numbers of the motion, with wheel_scale and turn_rate_bias, are from the true "
                "poses, and those of the sensor from residuals"
            )
        elif auto:
            notes.append("no true poses with headings are known: all numbers are from residuals")
        found = noise_from_residuals(drives, motion, sensor, degrees, scale=scale)
        moved, seen, means, errors = found.motion, found.sensor, found.means, found.errors
        if known is not None:
            moved, (of_odometry, errors_of_odometry) = known
            means, errors = means | of_odometry, errors | errors_of_odometry
        if not found.settled:
            doubts.append(f"the variances had not settled after {MAX_ROUNDS} rounds")
        for name, reference in (("range_scale", "odometry"), ("wheel_scale", "ranges")):
            if means[name] != 1 and known is None:
                other = ", ".join(each for each in SCALES if each != reference)
                notes.append(
                    f"{name} {means[name]:.3f} is relative to the {reference}; only ground truth tells which of the two has "
                    f"the wrong scale (option scale: {other})"
                )
        if found.correlation > CORRELATED:
            doubts.append(
                f"the errors of successive sightings of a landmark are correlated ({found.correlation:.2f}): the solution "
                "follows them, so that the noise of the sensor comes out too small"
            )
    fits = {"sensor": seen} if moved is None else {"motion": moved, "sensor": seen}
    notes += [
        f"{what} have heavy tails ({fits[name].degrees:.1f} degrees of freedom): the values describe typical {what}, "
        f"without the outliers{advice}"
        for name, what, advice in (
            ("sensor", "sightings", ", so run with a robust kernel (--kernel cauchy, or huber)"),
            ("motion", "motions", ""),
        )
        if name in fits and fits[name].degrees < HEAVY
    ]
    return Calibration(
        motion=None if moved is None else with_variances(motion, moved.variances),
        sensor=with_variances(sensor, seen.variances),
        **means,
        errors={name: error for fit in fits.values() for name, error in fit.errors_of_model().items()} | errors,
        bounds={name: bound for fit in fits.values() for name, bound in fit.bounds_of_model().items()},
        degrees={name: fit.degrees for name, fit in fits.items()},
        counts={name: fit.count for name, fit in fits.items()},
        source=source,
        logs=tuple(each.name for each in logs),
        notes=tuple(notes),
        doubts=tuple(doubts),
    )


def _check(logs: tuple[Log, ...], source: str) -> None:
    """Raise `LogError` where a log lacks what is needed, or the logs are of different kinds."""
    for log in logs:
        if len(log.steps) == 0:
            raise LogError(f"{log.name} has no sightings at all, so the noise of the sensor cannot be estimated")
        if source == "truth" and not log.identified:
            raise LogError(
                f"{log.name} has sightings without landmark ids, which cannot be compared with its true map; estimate its "
                "noise from residuals"
            )
        if source == "truth" and not knows_enough(log):
            raise LogError(
                f"{log.name} has no ground truth with headings and landmarks that were seen; estimate its noise from "
                "residuals"
            )
        if source == "residuals" and log.controls is None:
            raise LogError(f"{log.name} has no controls, and residuals alone do not determine the noise without them")
        for what, has in (("controls", log.controls is not None), ("orientation psi", log.has_orientation)):
            if has != (logs[0].controls is not None if what == "controls" else logs[0].has_orientation):
                names = (log.name, logs[0].name) if has else (logs[0].name, log.name)
                raise LogError(f"{names[0]} has {what} and {names[1]} has not: calibrate them one by one")
