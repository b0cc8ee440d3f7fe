"""Noise from logs whose true poses and landmarks are known: the residuals are the noise itself.

Before the noise there are numbers by which all measurements are wrong in the same way: the scale and bias of ranges, the
scale of the wheels, and the bias of the turn rate,

    measured range = range_scale * range + range_bias,   recorded speed = wheel_scale * speed,
    recorded turn rate = turn rate + turn_rate_bias.

They and the variances are estimated in turn (`fit_with_means`). Those within three standard errors of their ideal values are
held there, because a correction that is not significant helps no other log.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ..errors import LogError
from ..identification.corrections import without_biases
from ..identification.odometry import LEAST, motion_parts, ordinary, sensor_parts, stacked
from ..log import Log
from ..log.streams import poses_at
from ..models import MotionModel, SensorModel
from ..se2 import Array, between, difference, sinc, wrap
from .variances import VarianceFit, fit_variances

#: the means have converged when they change by less than this
SETTLED = 1e-6
#: standard errors count the residuals of this many stretches of the logs as independent, and no single ones
STRETCHES = 50
#: a mean nearer to its ideal value, in standard errors, is held there
SIGNIFICANT = 3.0
#: the step of numeric derivatives by wheel scale and turn-rate bias [rad/s]
STEP = 1e-5

#: the fewest pairs of bearings in one scan that say something, the ratio of variances that is said (at most 1.7 on 68 drives
#: with the right truth), and the part of what it is above 1 that a late truth leaves
FEWEST_PAIRS, COMMON, LEFT = 50, 2.0, 0.3
#: larger errors count as so many standard deviations
CLIPPED = 5.0
#: how late or early the ground truth may be, and the steps in which that is looked for first [s]
LATEST, STEPS = 1.5, 0.05

#: numbers by name, and their standard errors
Means = tuple[dict[str, float], dict[str, float]]


def knows_enough(log: Log) -> bool:
    """Whether true poses with headings and the positions of landmarks that were seen are known."""
    return knows_poses(log) and bool(np.isin(log.landmarks, list(log.true_landmarks or {})).any())


def true_motions(log: Log) -> int:
    """The number of motions whose true start and end are known, with headings, and that have odometry."""
    if not knows_poses(log):
        return 0
    truth = _truth(log)
    return int(np.sum(np.isfinite(between(truth[:-1], truth[1:])).all(axis=1) & ordinary(log)))


def knows_poses(log: Log) -> bool:
    """Whether true poses with headings are known."""
    truth = log.robot_truth
    return truth is not None and bool(np.isfinite(truth[:, 2]).any())


def motion_noise(logs: Sequence[Log], degrees: float | None = None) -> tuple[VarianceFit, Means]:
    """The variances of the motion, and "wheel_scale" and "turn_rate_bias" [rad/s], from true motions.

    The residuals are the differences of true and commanded motions in the frame of their start. Motions across gaps in the
    odometry, and those whose true start or end is unknown, do not count.

    Raises:
        LogError: there are too few motions.
    """
    moved = [between(truth[:-1], truth[1:]) for truth in map(_truth, logs)]
    counted = np.concatenate([np.isfinite(m).all(axis=1) & ordinary(log) for log, m in zip(logs, moved)])
    parts = {name: C[counted] for name, C in stacked(map(motion_parts, logs)).items()}
    if 3 * np.count_nonzero(counted) <= len(parts) + 1:
        raise LogError(
            f"{np.count_nonzero(counted)} motions with true poses at both ends are too few to estimate their noise; with "
            "source 'residuals' it is estimated without the true poses"
        )

    def residuals(means: Array, way: Callable[[Log, Array], Array] = differences) -> Array:
        corrected = [without_biases(log, wheel_scale=means[0], turn_rate_bias=means[1]) for log in logs]
        return np.concatenate([way(log, m) for log, m in zip(corrected, moved)])[counted]

    def slopes(means: Array) -> Array:
        changes = np.stack([residuals(means + h) - residuals(means - h) for h in STEP * np.eye(2)], axis=2)
        changes[:, 2] = wrap(changes[:, 2])
        return changes / (2 * STEP)

    fit, means, errors = fit_with_means(residuals, slopes, np.array([1.0, 0.0]), parts, degrees, robust=False)
    if not any(log.composite for log in logs):
        # the noise may enter by the controls or at the poses: the better explanation of the motions counts
        other = fit_variances(residuals(means, straightened), parts, degrees=degrees, least=LEAST)
        fit = max(fit, other, key=lambda each: each.log_likelihood)
    return fit, _named(("wheel_scale", "turn_rate_bias"), means, errors)


def differences(log: Log, moved: Array) -> Array:
    """The true motions (T, 3) minus the commanded ones."""
    return difference(moved, log.motions()[0])


def straightened(log: Log, moved: Array) -> Array:
    """The residuals (T, 3) of motions of one control each, computed from the controls that were really carried out.

    The noise du of a control changes the arc of the motion. To first order the residual is A du. To second order the
    product of the two parts of du also moves the robot sideways, a direction in which A is zero and the covariance only
    epsilon, which may be tiny; that would look like heavy tails. Therefore du is computed exactly, from the arc that
    turns as far as the robot did and ends nearest to it. The residual is A du plus the remaining distance to the arc.

    Args:
        log: without composite motions.
        moved: (T, 3) the true motions in the frames they start from.
    """
    assert log.controls is not None and log.dt is not None
    dt, origin, e = log.dt, np.zeros(3), differences(log, moved)
    turn = log.controls[:, 1] * dt + e[:, 2]
    along = np.column_stack([np.cos(turn / 2), np.sin(turn / 2)])
    length = np.einsum("ti,ti->t", moved[:, :2], along)
    done = np.column_stack([length / (dt * sinc(turn / 2)), turn / dt])
    straight = np.einsum("tij,tj->ti", MotionModel().A(origin, log.controls, dt), done - log.controls)
    straight[:, :2] += moved[:, :2] - length[:, None] * along
    # turns of more than half a circle are ambiguous
    return np.where((np.abs(turn) < np.pi)[:, None], straight, e)


def sensor_noise(logs: Sequence[Log], sensor: SensorModel, degrees: float | None = None) -> tuple[VarianceFit, Means]:
    """The variances of the sensor, and the line by which it measures ranges, "range_scale" and "range_bias" [m].

    The line is a regression of measured on true ranges, and the variances are those of the corrected ranges. The noise is
    assumed to grow with the true range; if it grew with the measured one, the likelihood would not be a density of the
    measurement.

    Raises:
        LogError: there are too few sightings of true landmarks from true poses.
    """
    z, seen = (np.concatenate(each) for each in zip(*[_seen(log, sensor) for log in logs]))

    def residuals(line: Array) -> Array:
        e = z - seen
        e[:, 0] = (z[:, 0] - line[1]) / line[0] - seen[:, 0]
        e[:, 1:] = wrap(e[:, 1:])
        return e

    def slopes(line: Array) -> Array:
        # of z - (scale seen + bias) over the scale, which is held: a regression on the true ranges
        slope = np.zeros((*z.shape, 2))
        slope[:, 0] = -np.column_stack([seen[:, 0], np.ones(len(z))]) / line[0]
        return slope

    fit, line, errors = fit_with_means(residuals, slopes, np.array([1.0, 0.0]), sensor_parts(seen), degrees)
    return fit, _named(("range_scale", "range_bias"), line, errors)


def errors_of_truth(log: Log, sensor: SensorModel) -> str:
    """A sentence where the bearings of one scan have an error in common, as from a late truth; empty otherwise.

    Differences e_k - e_l of the errors of two bearings of one scan have the variance 2 s², and their products the mean of
    the squared error that they have in common. Sightings that are wrong count little: s is by the median, and errors beyond
    `CLIPPED` s count as that. A truth that is late by tau has at t + tau the pose of t: the tau with the smallest errors is
    looked for where the products are large.
    """
    e, first, second = _bearing_errors(log, sensor)
    if len(first) < FEWEST_PAIRS:
        return ""
    single = max(_scale(e[second] - e[first]) / 2**0.5, 1e-12)
    ratio = _common(e, first, second, single)
    if ratio < COMMON:
        return ""
    found = (
        "the bearings of one scan have errors in common, which the noise of the sensor contains: their variance is "
        f"{ratio:.2g} times that of single bearings, whose standard deviation is about {single:.2g} rad"
    )
    late = _lateness(log, sensor, single)
    if late is not None and _common(*_errors_if_late(log, sensor, late), single) - 1 < LEFT * (ratio - 1):
        size, (truth, seen) = f"{abs(late):.2g}", ("-", "") if late > 0 else ("", "-")
        when = "s late against the sightings" if late > 0 else "s early against the sightings"
        return (
            f"{found}. Probably the ground truth is {size} {when}: add "
            f"clocks='truth={truth}{size}' where its clock is wrong, or clocks='sightings={seen}{size}' where that of the "
            "sensor is, and calibrate again"
        )
    return (
        f"{found}. The true poses may be inexact or shifted, or the sensor shakes: check the ground truth, or estimate the "
        "noise from residuals (source='residuals')"
    )


def _scale(values: Array) -> float:
    """The standard deviation of values (N,) by their median."""
    return float(1.4826 * np.median(np.abs(values - np.median(values)))) if len(values) else 0.0


def _common(e: Array, first: np.ndarray, second: np.ndarray, single: float) -> float:
    """1 + the mean product of the errors (M,) of pairs of bearings in one scan over the variance of single ones."""
    each = np.clip((e - np.median(e)) / single, -CLIPPED, CLIPPED)
    return 1 + float(np.mean(each[first] * each[second]))


def _bearing_errors(log: Log, sensor: SensorModel) -> tuple[Array, np.ndarray, np.ndarray]:
    """The errors (M,) of bearings whose truth is known, and the pairs (N,) of neighbours in one scan."""
    z, seen = _seen(log.without_orientation() if log.has_orientation else log, sensor)
    counted = _counted(log)
    steps, landmarks = log.steps[counted], log.landmarks[counted]
    pairs = np.flatnonzero((steps[1:] == steps[:-1]) & (landmarks[1:] != landmarks[:-1]))
    return wrap(z[:, 1] - seen[:, 1]), pairs, pairs + 1


def _errors_if_late(log: Log, sensor: SensorModel, late: float) -> tuple[Array, np.ndarray, np.ndarray]:
    """`_bearing_errors` where the pose of a time stands so much later [s] in the ground truth.

    Raises:
        LogError: no true pose is known then.
    """
    path = log.true_poses if log.true_path is None else log.true_path
    assert path is not None
    starts = log.control_times[log.control_starts]
    ends = starts if log.true_path is None else log.control_times
    return _bearing_errors(log.replace(true_poses=poses_at(starts + late, ends, path, LATEST)), sensor)


def _lateness(log: Log, sensor: SensorModel, single: float) -> float | None:
    """How late the ground truth is [s], by the least mean of log(1 + (e / single)²); None where too few poses are known."""
    from scipy.optimize import minimize_scalar

    def misfit(late: float) -> float:
        try:
            e, pairs, _ = _errors_if_late(log, sensor, late)
        except LogError:
            return np.inf
        return float(np.mean(np.log1p(((e - np.median(e)) / single) ** 2))) if len(pairs) >= FEWEST_PAIRS else np.inf

    best = min(np.arange(-LATEST, LATEST + STEPS / 2, STEPS).tolist(), key=misfit)
    found = minimize_scalar(misfit, bounds=(best - STEPS, best + STEPS), method="bounded", options={"xatol": 1e-3})
    return float(found.x) if np.isfinite(found.fun) else None


def fit_with_means(
    residuals: Callable[[Array], Array],
    slopes: Callable[[Array], Array],
    ideal: Array,
    parts: Mapping[str, Array],
    degrees: float | None,
    *,
    robust: bool = True,
) -> tuple[VarianceFit, Array, Array]:
    """Variances and means in turn: the means by weighted least squares with the last variances and weights, and so on.

    Args:
        residuals: from the means (K,) to e (E, d), in the order of time.
        slopes: from the means to de/d(means) (E, d, K).
        ideal: the values of the means where nothing is wrong.
        parts, degrees: as for `fit_variances`.
        robust: whether outliers count less for the means, too, as they do for the variances. They must count in full where
            residuals add up, as those of motions do, and are not symmetric.

    Returns:
        The fit, the means, and their standard errors; NaN where the residuals do not determine them. Means that are held at
        their ideal values have the error that they had before.
    """
    fit, means, errors, free = None, ideal.copy(), np.full(len(ideal), np.nan), np.ones(len(ideal), dtype=bool)
    while True:
        for _ in range(100):
            e, J = residuals(means), slopes(means)[:, :, free]
            fit = fit_variances(e, parts, degrees=degrees, least=LEAST, start=fit)
            W = np.linalg.inv(sum(fit.variances[name] * C for name, C in parts.items()))
            pull = np.einsum("e,edk,edc->eck", fit.weights if robust else np.ones(len(e)), J, W, optimize=True)
            inverse, known = inverse_information(np.einsum("eck,ecl->kl", pull, J))
            each = np.einsum("eck,ec->ek", pull, e)
            change = -inverse @ each.sum(axis=0)
            means[free] += change
            if not np.any(np.abs(change) > SETTLED):
                break
        assert fit is not None
        # the sandwich, with the residuals themselves for their covariance; neighbours in time may be correlated
        starts = np.unique(np.linspace(0, len(each), STRETCHES, endpoint=False).astype(int))
        stretches = np.add.reduceat(each, starts, axis=0)
        errors[free] = np.sqrt(np.diag(inverse @ (stretches.T @ stretches) @ inverse)) if known else np.nan
        distance = np.where(free, np.abs(means - ideal) / errors, np.inf)
        if not known or np.all(distance > SIGNIFICANT):
            break
        k = int(np.argmin(distance))
        free[k], means[k] = False, ideal[k]
    return fit, means, errors


def inverse_information(information: Array) -> tuple[Array, bool]:
    """The inverse (K, K), and whether there is one; else the pseudo-inverse."""
    if len(information) == 0:
        return information, True
    unit = np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information / np.outer(unit, unit)
    known = bool(np.linalg.eigvalsh(scaled)[0] > 1e-9)
    return np.linalg.pinv(scaled, rcond=1e-9, hermitian=True) / np.outer(unit, unit), known


def _named(names: Sequence[str], means: Array, errors: Array) -> Means:
    return dict(zip(names, means.tolist())), dict(zip(names, errors.tolist()))


def _truth(log: Log) -> Array:
    truth = log.robot_truth
    assert truth is not None
    return truth


def _counted(log: Log) -> np.ndarray:
    """The sightings (M,) bool whose true pose and landmark are known."""
    return np.isfinite(_truth(log)[log.steps]).all(axis=1) & np.isin(log.landmarks, list(log.true_landmarks or {}))


def _seen(log: Log, sensor: SensorModel) -> tuple[Array, Array]:
    """The sightings (M, n) whose truth is known, and what they should have been."""
    truth, counted = _truth(log), _counted(log)
    assert log.true_landmarks is not None
    if not counted.any():
        raise LogError(f"{log.name}: no sighting has a known true pose and a known true landmark")
    n = log.sightings.shape[1]
    places = [log.true_landmarks[j] for j in log.landmarks[counted].tolist()]
    if n == 3 and any(len(place) == 2 for place in places):
        message = f"{log.name}: the truth of psi is unknown, because true landmarks have no heading; leave psi out"
        raise LogError(message)
    return log.sightings[counted], sensor.h(truth[log.steps[counted]], np.array([place[:n] for place in places]))
