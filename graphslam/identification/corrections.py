"""Controls and sightings corrected by parameters, and the derivatives of both.

A corrected sighting is to the first order the same sighting from another pose. So the derivative of every residual by a
parameter is its Jacobian by the pose of the sighting times the move of this pose: no kind of edge needs equations of its
own. The moves are evaluated at the predicted sighting, not at the measured one, whose noise would be correlated with the
residual (at 14 % of noise in the range, a scale of 0.95 comes out as 1.07; docs/parameters.md).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, TypeAlias
from weakref import WeakKeyDictionary

import numpy as np

from ..engine import engine
from ..errors import LogError
from ..errors.checks import check_choice, check_number, check_positive, first
from ..log import Log, check_is_log
from ..models import MotionModel, SensorModel, additional_variances
from ..se2 import Array
from .declared import CORRECTIONS, PARAMETERS, Parameters, of_sensor_alone

#: the control at a pose is the mean over at most this time before and after it [s]
LONGEST = 0.5
#: the same for the derivatives by scales, and how many times noise counts there: blurred turns cost only precision, but noise
#: biases a scale, and noise that is estimated too small must not look like changes of the speeds
LONGEST_OF_SCALES, NOISE_OF_SCALES = 64.0, 4.0
#: where recorded controls last longer [s], speeds change within them by more than the noise of the odometry
LASTING = 0.3
_WITHOUT_NOISE = MotionModel(nn=0.0, no=0.0, on=0.0, oo=0.0)

_Averages: TypeAlias = tuple[Array, Array, dict[str, Array]]
#: those of logs that are in use: an estimate asks for them some fifty times, and they take as long as a Gauss-Newton step
_averages_of: WeakKeyDictionary[Log, _Averages] = WeakKeyDictionary()


def corrected_controls(parameters: Parameters) -> Array:
    """The controls (S, 2) corrected by the parameters."""
    p, log = parameters.by_name(), parameters.recorded
    assert log.controls is not None
    nu = log.controls[:, 0] / p["wheel_scale"]
    turned = log.controls[:, 1] - p["turn_rate_bias"] - p["curvature_bias"] * nu
    return np.column_stack([nu, turned / p["turn_scale"]])


def control_slopes(parameters: Parameters, controls: Array) -> Iterator[tuple[int, Array | None, Array]]:
    """For each parameter of the motion its column, and the derivatives (S,) of speed and turn rate by it.

    None is a speed that does not depend on it, and (1,) a derivative that is the same for all controls.
    """
    p, (nu, omega) = parameters.by_name(), controls.T
    for k, name in enumerate(parameters.names):
        if name == "wheel_scale":
            yield k, -nu / p["wheel_scale"], p["curvature_bias"] * nu / (p["wheel_scale"] * p["turn_scale"])
        elif PARAMETERS[name].of_motion:
            by = {"turn_scale": omega, "turn_rate_bias": np.ones(1), "curvature_bias": nu}[name]
            yield k, None, -by / p["turn_scale"]


def motion_slopes(
    parameters: Parameters, controls: Array, displacement: Array | None = None, *, scaled: Array | None = None
) -> tuple[Array, Array]:
    """The motions (T, 3) of corrected controls, and their derivative (T, 3, K) by the parameters.

    Args:
        controls: (S, 2) corrected.
        displacement: (T, 2) what the wheel scale scales, in place of the motions' own displacements.
        scaled: (S, 2) what the scales scale; default: the controls. The noise of a recorded control is in the residual of its
            motion, too. With the control as the derivative, the square of this noise makes the scale too large (on two
            minutes of 50 Hz odometry 1.03 for 1.00); `smoothed_controls` are an instrumental variable, which has hardly any
            part of it. Poses correct odometry only over some seconds, so that residuals are correlated that long, and half a
            second is not enough where speeds are nearly constant (on a circle 1.16 for 1.00).
    """
    log = parameters.recorded
    assert log.dt is not None
    motions, by_control = engine.accumulated_slopes(controls, log.dt, log.control_starts)
    by_parameter = np.zeros((len(motions), 3, len(parameters)))
    for k, speed, turn in control_slopes(parameters, controls if scaled is None else scaled):
        each = by_control[:, :, 1] * turn[:, None]
        if speed is not None and displacement is None:
            each += by_control[:, :, 0] * speed[:, None]
        by_parameter[:, :, k] = np.add.reduceat(each, log.control_starts[:-1])
        if speed is not None and displacement is not None:
            # a displacement is linear in the speed
            by_parameter[:, :2, k] -= displacement / parameters.values[k]
    return motions, by_parameter


def corrected_sensor(parameters: Parameters) -> SensorModel:
    """The sensor model with the estimated place of the sensor."""
    p = parameters.by_name()
    return replace(parameters.sensor, offset=(p["sensor_ahead"], p["sensor_left"]))


def corrected_sightings(parameters: Parameters, rows: np.ndarray, d: int) -> Array:
    """The sightings (M, d) in rows (M,) of the log, corrected by the parameters."""
    p, z = parameters.by_name(), parameters.recorded.sightings[rows, :d].copy()
    z[:, 0] = (z[:, 0] - p["range_bias"]) / p["range_scale"]
    z[:, 1] -= p["bearing_bias"]
    if p["sensor_delay"]:
        # where the landmark was seen from, the robot was earlier: from there to the sensor's place now
        nu, omega = -p["sensor_delay"] * controls_at_steps(parameters)[parameters.recorded.steps[rows]].T
        ahead, left = p["sensor_ahead"], p["sensor_left"]
        x, y = ahead + z[:, 0] * np.cos(z[:, 1]), left + z[:, 0] * np.sin(z[:, 1])
        x, y = nu + x * np.cos(omega) - y * np.sin(omega) - ahead, x * np.sin(omega) + y * np.cos(omega) - left
        bearing = np.arctan2(y, x)
        if d == 3:
            z[:, 2] += bearing - z[:, 1] - omega
        z[:, 0], z[:, 1] = np.hypot(x, y), bearing
    return z


def moves(parameters: Parameters, predicted: Array, controls: Array) -> Array:
    """How the pose of each sighting moves in its own axes when a parameter changes, (M, 3, K).

    Args:
        predicted: (M, d) the sightings that the state predicts.
        controls: (M, 2) the corrected control at the pose of each (`controls_at_steps`), on which the delay depends.
    """
    p, by = parameters.by_name(), np.zeros((len(predicted), 3, len(parameters)))
    l, phi = predicted[:, 0], predicted[:, 1]  # noqa: E741  # the slides' letter for the range
    ray = np.column_stack([np.cos(phi), np.sin(phi)])
    for k, name in enumerate(parameters.names):
        if name == "range_scale":
            by[:, :2, k] = -ray * (l / p["range_scale"])[:, None]
        elif name == "range_bias":
            by[:, :2, k] = -ray / p["range_scale"]
        elif name == "bearing_bias":
            # a turn about the sensor, which stays where it is
            by[:, :, k] = [-p["sensor_left"], p["sensor_ahead"], -1.0]
        elif name in ("sensor_ahead", "sensor_left"):
            by[:, 0 if name == "sensor_ahead" else 1, k] = 1.0
        elif name == "sensor_delay":
            by[:, 0, k], by[:, 2, k] = -controls[:, 0], -controls[:, 1]
    return by


def smoothed_controls(parameters: Parameters) -> Array:
    """The corrected controls (S, 2), each averaged for some time before and after its middle; `averaging_times` chooses."""
    ends = parameters.recorded.control_times
    return _averaged(parameters, corrected_controls(parameters), (ends[:-1] + ends[1:]) / 2, of_scales=True)


def controls_at_steps(parameters: Parameters) -> Array:
    """The control (T+1, 2) at the time of each pose: the mean of the corrected ones for some time before and after it.

    A single control is noisy where odometry is frequent, and a delay that multiplies noise is estimated too small, as in
    every regression on noisy values; a long mean blurs turns. `averaging_times` chooses.
    """
    log = parameters.recorded
    return _averaged(parameters, corrected_controls(parameters), log.control_times[log.control_starts])


def _control_variances(parameters: Parameters) -> Array:
    """The variances (S, 2) of the controls by the motion model."""
    log = parameters.recorded
    assert log.controls is not None and log.dt is not None
    return np.asarray(np.diagonal(parameters.motion.M(log.controls, log.dt, log.recorded_dt), axis1=1, axis2=2))


def control_noise(parameters: Parameters, rng: np.random.Generator) -> Array:
    """Noise (S, 2) of the controls, drawn from the motion model."""
    variances = _control_variances(parameters)
    return np.asarray(np.sqrt(variances) * rng.standard_normal(variances.shape))


def recorded_noise(parameters: Parameters) -> Array:
    """The parts (2,) of the changes of recorded speeds and turn rates whose size is that of the motion model's noise.

    Nearly all for measured ones, fewer where sightings cut controls, and few for commands, which the robot follows with
    noise: they stay as they are, or change by more.
    """
    variances, controls = _control_variances(parameters), parameters.recorded.controls
    assert controls is not None
    changes = np.diff(controls, axis=0) ** 2
    expected = variances[1:] + variances[:-1]
    alike = (changes > 0.01 * expected) & (changes < 4 * expected)
    return np.asarray(alike.mean(axis=0)) if len(changes) else np.zeros(2)


def control_noise_at_steps(parameters: Parameters, rng: np.random.Generator) -> Array:
    """Noise (T+1, 2) of `controls_at_steps`, drawn from the motion model."""
    log = parameters.recorded
    return _averaged(parameters, control_noise(parameters, rng), log.control_times[log.control_starts])


def noise_of_slopes(parameters: Parameters, rng: np.random.Generator) -> tuple[Array, Array]:
    """Noise of the corrected motions (T, 3), drawn from the motion model, and that of their derivatives (T, 3, K)."""
    p, log, controls = parameters.by_name(), parameters.recorded, corrected_controls(parameters)
    nu, omega = control_noise(parameters, rng).T
    nu = nu / p["wheel_scale"]
    noise = np.column_stack([nu, (omega - p["curvature_bias"] * nu) / p["turn_scale"]])
    _, slopes = motion_slopes(parameters, controls, scaled=noise)
    if "turn_rate_bias" in parameters.names:
        # the only derivative that does not depend on the control
        slopes[:, :, parameters.names.index("turn_rate_bias")] = 0.0
    _, by_control = engine.accumulated_slopes(controls, log.dt, log.control_starts)
    return np.add.reduceat((by_control @ noise[:, :, None])[:, :, 0], log.control_starts[:-1]), slopes


def recorded_rows(log: Log) -> np.ndarray:
    """The number (S,) of the recorded control of which each control is a piece.

    It is counted back from the end of each stretch of one control, and in the last one from its beginning.
    """
    assert log.controls is not None and log.dt is not None
    share = log.dt / (log.dt if log.recorded_dt is None else log.recorded_dt)
    changed = np.flatnonzero(np.any(np.diff(log.controls, axis=0) != 0, axis=1))
    ends = np.cumsum(share)
    stretch = np.searchsorted(changed, np.arange(len(share)))
    zeros = ends[np.append(changed, changed[-1:])] if len(changed) else np.zeros(1)
    rows = np.floor(ends - share / 2 - zeros[stretch])
    begins = (np.diff(rows, prepend=np.nan) != 0) | (np.diff(stretch, prepend=-1) != 0)
    return np.cumsum(begins) - 1


def with_whole_controls(log: Log) -> Log:
    """The log with the pieces of each recorded control that belong to one motion joined to one control.

    Poses that are left out have cut controls, which should not change what is estimated from the others.
    """
    assert log.controls is not None and log.dt is not None
    motion = np.repeat(np.arange(log.num_poses - 1), np.diff(log.control_starts))
    begins = np.flatnonzero((np.diff(recorded_rows(log), prepend=-1) != 0) | (np.diff(motion, prepend=-1) != 0))
    if len(begins) == len(log.dt):
        return log
    dt = np.add.reduceat(log.dt, begins)
    recorded = log.dt if log.recorded_dt is None else log.recorded_dt
    changes: dict[str, Any] = {
        "dt": dt,
        "controls": log.controls[begins],
        "recorded_dt": np.maximum(recorded[begins], dt),
    }
    if log.control_variances is not None:
        # a variance V of a control that lasts D moves the robot by V D²
        moved = np.add.reduceat(log.control_variances * log.dt[:, None] ** 2, begins)
        changes["control_variances"] = moved / dt[:, None] ** 2
    if log.true_path is not None:
        changes["true_path"] = log.true_path[np.append(begins, len(log.dt))]
    return log.replace(**changes, control_starts=np.searchsorted(begins, log.control_starts))


def changes_within(log: Log) -> Array:
    """The variances (S, 3) of single controls whose speeds change before the next one, as `Log.control_variances`.

    A control says the mean over its duration D. With d the differences from the controls before and after it, d² the mean of
    both squares, and one jump at any time, the mean over a piece s D has a variance of (1 - s)² d². The robot also leaves the
    arc sideways, with a mean speed of the variance (nu² d_omega² + omega² d_nu²) s (s D)² / 40.

    They are zero where the controls of the log last at most `LASTING`.
    """
    assert log.controls is not None and log.dt is not None
    recorded = log.dt if log.recorded_dt is None else log.recorded_dt
    share = log.dt / recorded
    if np.median(recorded) <= LASTING or not np.any(np.diff(log.controls, axis=0)):
        return np.zeros((len(log.dt), 3))
    row = recorded_rows(log)
    first_piece = np.flatnonzero(np.diff(row, prepend=-1))
    d = np.pad(np.diff(log.controls[first_piece], axis=0), ((1, 1), (0, 0)), mode="edge")
    squares = ((d[1:] ** 2 + d[:-1] ** 2) / 2)[row]
    sideways = np.sum(log.controls**2 * squares[:, ::-1], axis=1) * share * log.dt**2 / 40
    return np.column_stack([squares * (1 - share[:, None]) ** 2, sideways])


def honest_variances(log: Log) -> Array | None:
    """The variances (S, 3) of single controls that a log has, at least those of `changes_within`; None for none."""
    within = changes_within(log)
    if not within.any():
        return log.control_variances
    return np.maximum(within, additional_variances(log.control_variances, len(within)))


def _averaged(parameters: Parameters, controls: Array, times: Array, *, of_scales: bool = False) -> Array:
    """Controls (S, 2) of the log, averaged around times (n,) as `averaging_times` says, (n, 2)."""
    log, ends = parameters.recorded, parameters.recorded.control_times
    columns = zip(controls.T * log.dt, averaging_times(parameters, of_scales=of_scales))
    return np.column_stack([_means(_summed(each), ends, times, window) for each, window in columns])


def averaging_times(parameters: Parameters, *, of_scales: bool) -> list[float]:
    """For how long before and after a pose each of the two numbers of a control is averaged [s].

    The one of the times w = D, 2 D, 4 D, ... up to `LONGEST`, or up to `LONGEST_OF_SCALES`, with the least estimated risk,
    where D is the usual duration of a recorded control: with m_w the mean over w to each side and q the variance of the noise
    integrated over D to each side,

        E |m_w - u|² = E |m_w - m_D|² + 2 q / (4 w D) - q / (4 D²).

    Source: Stein, *Estimation of the mean of a multivariate normal distribution* (1981).
    """
    log = parameters.recorded
    if log not in _averages_of:
        _averages_of[log] = _averages(log)
    times, changes, noises = _averages_of[log]
    usual = times[0]
    # the variance of the noise is linear in the squares of the standard deviations
    q = 2 * usual * sum(getattr(parameters.motion, name) ** 2 * noise for name, noise in noises.items())
    longest, noises_count = (LONGEST_OF_SCALES, NOISE_OF_SCALES) if of_scales else (LONGEST, 1.0)
    risks = changes + np.outer(1 / (2 * times * usual) - 1 / (4 * usual**2), noises_count * q)
    allowed = max(1, np.count_nonzero(times <= longest))
    return times[np.argmin(risks[:allowed], axis=0)].tolist()


def _averages(log: Log) -> _Averages:
    """What `averaging_times` takes from a log, whatever the noise is.

    Returns:
        The times w (n,); E |m_w - m_D|² (n, 2) of the two numbers of a control; and by the name of each standard deviation of
        the noise the mean variance (2,) around poses where it is 1 and the others are 0.
    """
    assert log.controls is not None and log.dt is not None
    times = [float(np.median(log.dt if log.recorded_dt is None else log.recorded_dt))]
    while 2 * times[-1] <= LONGEST_OF_SCALES:
        times.append(2 * times[-1])
    ends = log.control_times

    def around(values: Array, window: float) -> Array:
        # `np.interp` looks up both numbers of a control at once where they are one complex number
        means = _means(_summed(values[:, 0] + 1j * values[:, 1]), ends, ends[log.control_starts], window)
        return np.array([means.real, means.imag])

    means = np.array([around(log.controls * log.dt[:, None], w) for w in times])
    noises = {}
    for name in ("nn", "no", "on", "oo", "sigma_v", "sigma_omega"):
        M = replace(_WITHOUT_NOISE, **{name: 1.0}).M(log.controls, log.dt, log.recorded_dt)
        variances = np.diagonal(M, axis1=1, axis2=2) * log.dt[:, None] ** 2
        noises[name] = around(variances, times[0]).mean(axis=1)
    return np.array(times), np.mean((means - means[0]) ** 2, axis=2), noises


def _summed(values: Array) -> Array:
    """The sums (S+1,) of the first 0 to S values."""
    return np.concatenate([[0.0], np.cumsum(values)])


def _means(total: Array, ends: Array, times: Array, window: float) -> Array:
    """The mean (n,) within a time of each of ``times``, from integrals ``total`` (S+1,) up to the ends (S+1,) of controls."""
    since, until = (np.clip(times + w, 0.0, ends[-1]) for w in (-window, window))
    return (np.interp(until, ends, total) - np.interp(since, ends, total)) / (until - since)


def averaged_controls(log: Log) -> Array:
    """The recorded controls (S, 2), averaged for `LONGEST` before and after: noise about zero is no motion."""
    assert log.controls is not None and log.dt is not None
    ends = log.control_times
    middles = (ends[:-1] + ends[1:]) / 2
    return np.column_stack([_means(_summed(each * log.dt), ends, middles, LONGEST) for each in log.controls.T])


def corrected_log(parameters: Parameters) -> Log:
    """The log corrected by the parameters; its initial poses stay.

    Raises:
        LogError: a corrected range would not be above zero.
    """
    log, bias, numbers = parameters.recorded, parameters.by_name()["range_bias"], parameters.recorded.partial_sightings
    alone = np.zeros(0) if numbers is None else numbers.ranges
    for noun, ranges in (("sighting", log.sightings[:, 0]), ("partial sighting", alone)):
        if (k := first(ranges <= bias)) is not None:
            raise LogError(
                f"{log.name}: {noun} {k} has a range of {ranges[k]:g} m, which a range bias of {bias:g} m takes below zero; "
                "does the bias belong to another sensor?"
            )
    every, d = np.arange(len(log.steps)), log.sightings.shape[1]
    changes: dict[str, Any] = {
        "sightings": corrected_sightings(parameters, every, d),
        "sensor": corrected_sensor(parameters),
    }
    if numbers is not None:
        p = parameters.by_name()
        changes["partial_sightings"] = replace(
            numbers,
            ranges=(numbers.ranges - p["range_bias"]) / p["range_scale"],
            bearings=numbers.bearings - p["bearing_bias"],
        )
        if p["sensor_delay"]:
            changes["notes"] = (*log.notes, "ranges and bearings alone keep the delay of the sensor")
    if any(PARAMETERS[name].of_motion for name in parameters.names):
        changes["controls"] = corrected_controls(parameters)
    return log.replace(**changes)


def without_biases(
    log: Log, *, motion: MotionModel | None = None, sensor: SensorModel | None = None, **values: float
) -> Log:
    """The log with its sightings and controls corrected for known biases.

    Where controls change, the initial poses are those of dead reckoning.

    Args:
        log: as it was recorded.
        motion, sensor: the noise of the odometry and the place of the sensor, on which the correction of a delay depends;
            default: those of the log, else the book's.
        values: of `PARAMETERS` by name, except for the place of the sensor, which belongs to the sensor model; default: the
            ideal ones.

    Raises:
        LogError: there are no controls to correct, a corrected range would not be above zero, or a delay should be taken out
            of ranges and bearings alone.
        OptionError: there is no such parameter, a scale is not positive, or a value is not finite.
    """
    check_is_log(log)
    for name, value in values.items():
        check_choice("a bias", name, tuple(CORRECTIONS))
        if name.endswith("_scale"):
            check_positive(**{name: value})
        check_number(**{name: value})
    wrong = {name: float(value) for name, value in values.items() if value != CORRECTIONS[name]}
    if not wrong:
        return log
    if log.controls is None and len(lost := wrong.keys() - of_sensor_alone(wrong)):
        raise LogError(f"{log.name} has no controls, and {', '.join(sorted(lost))} cannot be taken out of them")
    if "sensor_delay" in wrong and len(log.steps) == 0 and log.partial_sightings is not None:
        raise LogError(
            f"{log.name} has ranges and bearings alone, out of which sensor_delay cannot be taken: a single number does not "
            "tell where its landmark is; correct the times of the sightings before the log is made"
        )
    motion, sensor = log.noise_models(motion, sensor)
    numbers, none = np.array(list(wrong.values())), np.full(len(wrong), np.inf)
    corrected = corrected_log(Parameters(tuple(wrong), numbers, numbers, none, log, motion, sensor))
    corrected = corrected.replace(sensor=log.sensor)
    if any(PARAMETERS[name].of_motion for name in wrong):
        corrected = corrected.replace(initial_poses=corrected.dead_reckoning())
    return corrected
