"""`calibrate`: the noise and the biases of a robot, estimated from its logs, whose sightings may have no ids."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

import numpy as np

from ..association.associate import robot_of
from ..errors import LogError, OptionError, checks
from ..identification.corrections import honest_variances, without_biases
from ..identification.declared import CORRECTIONS, PLACE, of_sensor_alone
from ..identification.odometry import OF_SENSOR, with_variances
from ..identification.result import RobotEstimate
from ..log import Log, check_is_log
from ..models import MotionModel, SensorModel
from .from_truth import Means, errors_of_truth, knows_enough, knows_poses, motion_noise, sensor_noise, true_motions
from .variances import VarianceFit

#: at least so many motions with true poses at both ends tell their noise
FEWEST_MOTIONS = 10
#: the standard deviations of the sensor that are lengths
LENGTHS = [f.name for f in fields(SensorModel) if f.name in OF_SENSOR and f.metadata["unit"] == "m"]
#: the choices of the option ``source``
SOURCES = ("auto", "truth", "residuals")

#: distributions with fewer degrees of freedom than this have heavy tails: plain least squares is not enough
HEAVY = 10.0
#: how often logs of one robot are said to disagree although they do not
ERROR_RATE = 1e-3


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Noise models and biases, with their standard errors.

    Attributes:
        motion: the motion model; None from a log without controls.
        sensor: the sensor model, for sightings that are corrected by the numbers below; from residuals with the estimated
            place of the sensor.
        wheel_scale, turn_scale, turn_rate_bias, curvature_bias, range_scale, range_bias, bearing_bias, sensor_delay: the
            biases of `PARAMETERS`. Residuals determine all but ``range_scale``, the truth ``wheel_scale``,
            ``turn_rate_bias``, ``range_scale`` and ``range_bias``, which are 1 or 0 within three standard errors of that.
        errors: standard errors of all numbers, {"nn": ..., "range_bias": ...}; NaN for those near zero, and for noise that
            residuals determine to no better than 100 %.
        bounds: upper 95 % bounds of the numbers near zero, whose variance is less than two of its standard errors;
            infinite where the log gives no bound. From the truth only.
        degrees: {"motion": nu, "sensor": nu}, the degrees of freedom of Student's t; infinite where Gaussian. Where there
            are few, the models describe typical motions and sightings, without the outliers, and a robust kernel is
            needed. From the truth only.
        counts: {"motion": number of motions, "sensor": number of sightings} that were used.
        misread: the part of the sightings whose id is wrong, or that show no landmark; None from the truth.
        inflation: the factor on the variances of the sensor with which correlated errors count as independent, see
            `RobotEstimate`; 1: they are, or nobody asked.
        source: "truth" or "residuals"; the latter, too, where true poses without a map tell the numbers of the motion only.
        logs: the names of the logs.
        notes: what the user should know, one sentence each.
        doubts: why the noise should not be used, one sentence each: the biases of several logs differ beyond chance, or
            `RobotEstimate.doubts`.
    """

    motion: MotionModel | None
    sensor: SensorModel
    wheel_scale: float = 1.0
    turn_scale: float = 1.0
    turn_rate_bias: float = 0.0
    curvature_bias: float = 0.0
    range_scale: float = 1.0
    range_bias: float = 0.0
    bearing_bias: float = 0.0
    sensor_delay: float = 0.0
    errors: dict[str, float] = field(default_factory=dict)
    bounds: dict[str, float] = field(default_factory=dict)
    degrees: dict[str, float] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    misread: float | None = None
    inflation: float = 1.0
    source: str = "truth"
    logs: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    @classmethod
    def of(cls, found: RobotEstimate, *others: RobotEstimate) -> Calibration:
        """The joint estimate from several logs of one robot.

        Logarithms of standard deviations, and biases, are weighted by their information; the factors for correlated errors,
        whose errors are not known, count alike. The prior of a bias counts once. A log that the book's noise fits better than
        an estimate counts only if there is no other one.
        """
        logs = (found, *others)
        every = [one for one in logs if one.errors] or [*logs]
        found = every[0]
        (means, deviations, disagreements, contradictions), motion, sensor = _noise(every), found.motion, found.sensor
        priors = {name: prior for one in every for name, prior in one.parameters.priors.items()}
        ideal = {name: mean for name, (mean, _) in priors.items()}
        information, pulled = np.zeros((len(priors), len(priors))), np.zeros(len(priors))
        for one in every:
            # a log that holds a bias at its ideal value has no information on it
            k = [list(priors).index(name) for name in one.parameters.names]
            own = np.linalg.inv(one.parameters.covariance)
            weights = [
                0.0 if information[i, i] == 0 else one.parameters.priors[name][1] ** -2
                for i, name in zip(k, one.parameters.names)
            ]
            information[np.ix_(k, k)] += own - np.diag(weights)
            pulled[k] += own @ (one.parameters.values - [ideal[name] for name in one.parameters.names])
        covariance = np.linalg.inv(information)
        biases = {name: ideal[name] + change for name, change in zip(priors, (covariance @ pulled).tolist())}
        if len(every) > 1:
            shared = {name: float(np.exp(2 * mean)) for name, mean in means.items()}
            motion = with_variances(motion, {n: v for n, v in shared.items() if n not in OF_SENSOR})
            sensor = with_variances(sensor, {n: v for n, v in shared.items() if n in OF_SENSOR})
            place = [biases.get(name, here) for name, here in zip(PLACE, sensor.offset)]
            sensor = replace(sensor, offset=tuple(place))
        else:
            # without rounding, so that the noise file gives the very graph of the estimate
            biases = dict(zip(found.parameters.names, found.parameters.values.tolist()))
        values = vars(motion) | vars(sensor)
        errors = {name: values[name] * error if error < 1 else np.nan for name, error in deviations.items()}
        return cls(
            motion=motion, sensor=sensor, **{name: value for name, value in biases.items() if name not in PLACE},
            errors=errors | dict(zip(priors, np.sqrt(np.diag(covariance)).tolist())),
            counts={
                "motion": sum(one.log.num_poses - 1 for one in every), "sensor": sum(_sightings(one.log) for one in every),
            },
            misread=float(np.average([one.ids.share for one in logs], weights=[len(one.ids.changed) for one in logs])),
            inflation=float(np.exp(np.mean([np.log(one.inflation) for one in every]))),
            source="residuals", logs=tuple(one.log.name for one in logs),
            notes=(
                *disagreements,
                *(
                    f"{one.log.name}: {said}" if others else said
                    for one in every
                    for said in (one.remarks if one.errors else one.sentences)
                ),
                *(
                    f"{one.log.name} does not count: {one.basis} predicts its sightings better than an estimate from it"
                    for one in logs
                    if one not in every
                ),
            ),
            doubts=(
                *contradictions,
                *(f"{one.log.name}: {doubt}" if others else doubt for one in every for doubt in one.doubts),
            ),
        )  # fmt: skip

    def __repr__(self) -> str:
        """One line: source and all numbers."""
        return f"<Calibration from {self.source}: {', '.join(f'{k} {v:.3g}' for k, v in self.numbers.items())}>"

    @property
    def numbers(self) -> dict[str, float]:
        """All numbers by name: those of the motion, of the sensor, and biases.

        The noise of psi is left out where psi was not measured, biases of controls without controls, and the place of the
        sensor where it was not estimated.
        """
        of_models = {} if self.motion is None else asdict(self.motion)
        of_models |= {name: getattr(self.sensor, name) for name in OF_SENSOR}
        if "orientation_std" not in self.errors:
            del of_models["orientation_std"]
        place = {name: value for name, value in zip(PLACE, self.sensor.offset) if name in self.errors}
        return of_models | self.corrections | place

    @property
    def corrections(self) -> dict[str, float]:
        """The biases, arguments of `without_biases`; without controls only those of sightings."""
        values = {name: getattr(self, name) for name in CORRECTIONS}
        return of_sensor_alone(values) if self.motion is None else values

    def to_json(self) -> dict[str, Any]:
        """The calibration as plain data."""
        return asdict(self) | {name: list(getattr(self, name)) for name in ("logs", "notes", "doubts")}

    def apply(self, log: Log) -> Log:
        """The log with these models as its own, and its sightings and odometry corrected.

        Raises:
            LogError: a corrected range would not be above zero.
        """
        values = of_sensor_alone(self.corrections) if log.controls is None else self.corrections
        corrected = without_biases(log, motion=self.motion, sensor=self.sensor, **values)
        if log.controls is not None:
            corrected = corrected.replace(control_variances=honest_variances(corrected))
        return corrected.replace(motion=self.motion or log.motion, sensor=self.sensor)


def calibrate(
    log: Log | Sequence[Log],
    *others: Log,
    source: str = "auto",
    motion: MotionModel | None = None,
    sensor: SensorModel | None = None,
    degrees: float | None = None,
) -> Calibration:
    """Estimate the noise and the systematic errors (scales, biases, delay) of motion and sensor from one log or several.

    With ground truth, by maximum likelihood: true motions are compared with the commanded ones, and sightings with those
    that the true poses imply (`from_truth`). The residuals have t-distributions with unknown degrees of freedom, so that
    wheel slip and wrong sightings do not increase the estimated noise of all others: see `variances`. Without ground
    truth, by `estimate_robot` on each log (`Calibration.of`).

    Noise that is to be used on a log without ground truth is best calibrated from the ground truth of other robots of the
    same kind. Several logs give one noise for all; what differs between them is part of the noise from the truth, and is
    reported where the noise is from residuals.

    In logs whose sightings have no ids, ids and noise are found in turn, see `robot_of`.

    Args:
        log, others: the logs, or a list of them; of one kind of robot, since they share all numbers.
        source: "truth", "residuals", or "auto": the truth where poses, headings and landmarks are known. Where the map is
            not, "auto" takes the numbers of the motion from the true poses, and those of the sensor from residuals. Where
            fewer than `FEWEST_MOTIONS` motions have true poses at both ends, all are from residuals.
        motion, sensor: the noise with which ids are found first, and the offset of the sensor; default: the first log's, or
            the book's.
        degrees: degrees of freedom of the residuals against the truth; None to estimate them, infinity for a Gaussian
            likelihood.

    Raises:
        LogError: a log lacks what is needed.
        GraphError: the sightings do not determine the noise.
        OptionError: an option has an impossible value.
    """
    logs: tuple[Any, ...] = (*log, *others) if isinstance(log, list | tuple) and log else (log, *others)
    for each in logs:
        check_is_log(each)
    if degrees is not None:
        checks.check_not_negative(degrees=degrees)
        if (degrees := float(degrees)) == 0:
            raise OptionError("degrees must be above zero, not 0: 1 is Cauchy's distribution, infinity a Gaussian")
    checks.check_choice("source", source, SOURCES)
    motion, sensor = logs[0].noise_models(motion, sensor)
    moved = sum(map(true_motions, logs))
    if auto := source == "auto":
        without_motions = logs[0].controls is not None and moved < FEWEST_MOTIONS
        source = "truth" if all(map(knows_enough, logs)) and not without_motions else "residuals"
    _check(logs, source)
    if source == "truth":
        return _from_truth(logs, motion, sensor, degrees)
    known, reason = all(map(knows_poses, logs)), "no true poses with headings are known"
    if known:
        reason = f"only {moved} motions have true poses at both ends ({FEWEST_MOTIONS} are needed)"
    try:
        robots = [robot_of(each, motion, sensor) for each in logs]
    except LogError as error:
        if auto and known and moved < FEWEST_MOTIONS:
            raise LogError(f"{error}; the ground truth is not used, because {reason}") from error
        raise
    found = Calibration.of(*(robot for robot, _ in robots))
    found = replace(found, notes=(*(note for _, notes in robots for note in notes), *found.notes))
    if auto and known and moved >= FEWEST_MOTIONS:
        return _with_true_motion(found, motion, *motion_noise(logs, degrees))
    return replace(found, notes=(*(f"{reason}: all numbers are from residuals",) * auto, *found.notes))


def _from_truth(logs: tuple[Log, ...], motion: MotionModel, sensor: SensorModel, degrees: float | None) -> Calibration:
    """The calibration from the ground truth of logs."""
    seen, of_ranges = sensor_noise(logs, sensor, degrees)
    means: dict[str, Any] = {**of_ranges[0]}
    errors, fits = of_ranges[1], {"sensor": seen}
    if logs[0].controls is not None:
        moved, odometry = motion_noise(logs, degrees)
        means, errors, fits = means | odometry[0], errors | odometry[1], {"motion": moved, "sensor": seen}
    return Calibration(
        motion=with_variances(motion, fits["motion"].variances) if "motion" in fits else None,
        sensor=with_variances(sensor, seen.variances),
        **means,
        errors={name: error for fit in fits.values() for name, error in fit.errors_of_model().items()} | errors,
        bounds={name: bound for fit in fits.values() for name, bound in fit.bounds_of_model().items()},
        degrees={name: fit.degrees for name, fit in fits.items()},
        counts={name: fit.count for name, fit in fits.items()},
        source="truth",
        logs=tuple(each.name for each in logs),
        notes=(*_heavy_tails(fits), *_common_errors(logs, sensor)),
    )


def _common_errors(logs: tuple[Log, ...], sensor: SensorModel) -> tuple[str, ...]:
    """Sentences on logs in which the sightings of one scan have errors in common."""
    found = [(log.name, errors_of_truth(log, sensor)) for log in logs if log.controls is not None]
    return tuple(f"{name}: {text}" if len(logs) > 1 else text for name, text in found if text)


def _heavy_tails(fits: dict[str, VarianceFit]) -> tuple[str, ...]:
    """What the user should know of the degrees of freedom."""
    return tuple(
        f"{what} have heavy tails ({fits[name].degrees:.1f} degrees of freedom): the values describe typical {what}, "
        f"without the outliers{advice}"
        for name, what, advice in (
            ("sensor", "sightings", ", so run with a robust kernel (kernel='cauchy', or huber)"),
            ("motion", "motions", ""),
        )
        if name in fits and fits[name].degrees < HEAVY
    )


def _with_true_motion(found: Calibration, motion: MotionModel, moved: VarianceFit, odometry: Means) -> Calibration:
    """The calibration from residuals, with the numbers of the motion from true poses without a map.

    Residuals determine the scale of the wheels relative to that of ranges. So the true one gives that of ranges, and all
    lengths that the sensor measures change by this factor.
    """
    means, errors = odometry
    factor = found.wheel_scale / means["wheel_scale"]
    relative = [found.errors.get("wheel_scale", 0.0) / found.wheel_scale, np.nan_to_num(errors["wheel_scale"])]
    biases: dict[str, Any] = {"turn_scale": 1.0, "curvature_bias": 0.0, "range_scale": 1 / factor} | means
    known = {name: error for name, error in found.errors.items() if name not in biases}
    known |= {"range_scale": math.hypot(*relative) / factor} | {
        name: known[name] * factor for name in LENGTHS if name in known
    }
    longer: dict[str, Any] = {name: getattr(found.sensor, name) * factor for name in LENGTHS}
    note = (
        "no landmark whose true place is known is seen with range and bearing: the numbers of the motion, with wheel_scale "
        "and turn_rate_bias, are from the true poses, and those of the sensor from residuals"
    )
    return replace(
        found,
        motion=with_variances(motion, moved.variances),
        sensor=replace(found.sensor, **longer),
        **biases,
        errors=known | moved.errors_of_model() | errors,
        bounds=moved.bounds_of_model(),
        degrees={"motion": moved.degrees},
        counts=found.counts | {"motion": moved.count},
        notes=(note, *_heavy_tails({"motion": moved}), *found.notes),
    )


def _values(found: RobotEstimate, every: Sequence[RobotEstimate]) -> dict[str, tuple[float, float]]:
    """{name: (value, standard deviation)} in one log of each bias that at least one log of ``every`` has estimated.

    A log that prefers the ideal value does not say how well it would tell another one: at most as well as the others do. So
    it contradicts them where they are far from it.
    """
    of_logs: dict[str, tuple[float, float]] = {}
    for name, (ideal, _) in {name: prior for one in every for name, prior in one.parameters.priors.items()}.items():
        others = [one.parameters.deviations[name] for one in every if name in one.parameters.names]
        unknown = (found.log.uncertain or {}).get(name, np.inf)
        of_logs[name] = ideal, max(unknown, *others)
    own = found.parameters
    return of_logs | {name: (own[name], own.deviations[name]) for name in own.names}


def _noise(every: Sequence[RobotEstimate]) -> tuple[dict[str, float], dict[str, float], list[str], list[str]]:
    """The pooled noise of the estimates, and sentences on noise and biases on which they differ beyond chance.

    The noise is the logarithms of standard deviations by name, and the errors of these logarithms.

    Values of one number from R logs, weighted by their information, scatter by chi-square with R - 1 degrees of freedom.
    Errors of sightings that last make their noise differ from log to log, and so only biases are doubtful.
    """
    from scipy.special import chdtri

    names = list(every[0].errors)
    biased = list(dict.fromkeys(name for one in every for name in one.parameters.names))
    widths = 0.5 * np.log([one.inflation for one in every])[:, None] * np.isin(names, OF_SENSOR)
    models = [vars(one.motion) | vars(one.sensor) for one in every]
    values = np.log([[model[name] for name in names] for model in models]) - widths
    found = [_values(one, every) for one in every]
    biases = np.array([[each[name][0] for name in biased] for each in found])
    spreads = [[each[name][1] for name in biased] for each in found]
    errors = np.hstack([[list(one.errors.values()) for one in every], spreads])
    both, information = np.hstack([values, biases]), errors**-2
    means = np.average(both, axis=0, weights=information)
    scatter = np.sum(((both - means) / errors) ** 2, axis=0)
    notes: list[str] = []
    doubts: list[str] = []
    for k, name in enumerate((*names, *biased)):
        count = int(np.sum(information[:, k] > 0))
        if count > 1 and scatter[k] > chdtri(count - 1, ERROR_RATE / len(means)):
            shown = ", ".join(f"{value:.3g}" for value in (np.exp(values[:, k]) if k < len(names) else both[:, k]))
            (notes if k < len(names) else doubts).append(f"the logs disagree beyond chance on {name} ({shown})")
    together = means[: len(names)] + widths.mean(axis=0)
    deviations = np.sum(information[:, : len(names)], axis=0) ** -0.5
    return dict(zip(names, together.tolist())), dict(zip(names, deviations.tolist())), notes, doubts


def _sightings(log: Log) -> int:
    """The number of sightings, those of a range or a bearing alone included."""
    return len(log.steps) + len(log.partial_sightings or ())


def _check(logs: tuple[Log, ...], source: str) -> None:
    """Raise `LogError` where a log lacks what is needed, or the logs are of different kinds."""
    for log in logs:
        if not _sightings(log):
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
