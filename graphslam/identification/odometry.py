"""`Odometry`, a drive's motions and their covariances between any of its poses; and `Edges` whose noise is unknown.

A log may have fifty controls for each pose and fifty poses for each that a problem needs, and an estimate evaluates its
motions a hundred times. So the controls are evaluated rarely, and motions are joined from those between successive poses:
with R the rotation of the heading that the robot has before motion i, and d its way after motion i until the end, both in the
axes of the first pose, errors (e_xy, e_theta) of motion i move the end by

    L_i e,    L_i = ( R   (-d_y, d_x)' )
                    ( 0        1       ).

`motion_parts` and `sensor_parts` write the noise models as sums of variances: covariance = sum over the model's fields p of
theta_p C_p. The covariance of a motion (`MotionModel.accumulate`) is linear in the squares of the model's standard deviations
and in epsilon, and that of a sighting (`SensorModel.Q`) in the squares of the sensor's standard deviations.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

import numpy as np

from ..linear.precision import inverses
from ..log import Log
from ..models import MotionModel, SensorModel
from ..se2 import Array, chained, joined_motions
from .corrections import (
    averaged_controls,
    averaging_times,
    changes_within,
    controls_at_steps,
    corrected_controls,
    honest_variances,
    motion_slopes,
    smoothed_controls,
)
from .declared import Parameters

Model = TypeVar("Model", MotionModel, SensorModel)

#: the standard deviations of the models
OF_MOTION = tuple(f.name for f in fields(MotionModel) if f.name != "epsilon")
OF_SENSOR = tuple(f.name for f in fields(SensorModel) if f.name not in SensorModel.GEOMETRY)

#: the least epsilon [m², rad²] that a calibrated model has, because A M A' has only rank 2
LEAST_EPSILON = 1e-9


@dataclass(frozen=True)
class Noise:
    """What is believed of a number of the noise models before a log says more.

    Attributes:
        typical: its typical value, where it is estimated without a truth; that of a noise per recorded control is for one
            second of controls.
        unusual: a value above this is that of hardly any robot. That of ways [m/√m] is for ways of at most a metre in a
            second, and grows with the root of the way, of which it is the same part.
        cause: what a value above may be.
        least: the least variance in a calibrated model: noise that is smaller counts as this, (0.01 mm)² or (0.01 mrad)².
    """

    typical: float | None
    unusual: float = np.inf
    cause: str = ""
    least: float | None = None


_TURNS = "the turn rate has another sign or unit, or bearings count clockwise"
_ORIENTATIONS = (
    "orientations are in another unit, or are not psi = theta + phi - m_theta; correct them or leave out their column"
)
#: the numbers of the noise models that logs tell
NOISE = {
    "nn": Noise(0.01, 0.3, "the speed is in another unit, or ids are wrong"),
    "on": Noise(0.01, 0.2, _TURNS),
    "oo": Noise(0.02, 0.15, _TURNS),
    "slip": Noise(0.004, 0.3, "the robot does not move along its heading"),
    "sigma_omega": Noise(0.001),
    "epsilon": Noise(None, least=LEAST_EPSILON),
    "range_rate": Noise(0.01, 0.3, "ranges and odometry have other units, or ids are wrong"),
    "range_std": Noise(0.03, least=1e-10),
    "bearing_std": Noise(0.01, 0.3, "bearings count clockwise or from another axis, or ids are wrong", least=1e-10),
    "orientation_std": Noise(0.02, 1.0, _ORIENTATIONS, least=1e-10),
}
LEAST = {name: each.least for name, each in NOISE.items() if each.least is not None}

#: an epsilon that vanishes beside every other variance
NOTHING = 1e-20
#: the model without noise, and one whose variances, 1e-18, vanish beside 1
STILL = MotionModel(**dict.fromkeys(OF_MOTION, 0.0), epsilon=LEAST_EPSILON)
_TINY: dict[str, Any] = dict.fromkeys(OF_SENSOR, 1e-9)
_EXACT = SensorModel(**_TINY)


def motion_parts(log: Log, names: Iterable[str] = (*OF_MOTION, "epsilon")) -> dict[str, Array]:
    """C_p (T, 3, 3) of fields of the motion model, for all motions of a log, in the frame each starts from."""
    assert log.controls is not None and log.dt is not None
    shape, parts = (log.num_poses - 1, 3, 3), {}
    for name in names:
        if name == "epsilon":
            parts[name] = np.broadcast_to(np.eye(3), shape).copy()
        else:
            alone = replace(STILL, **{name: 1.0, "epsilon": NOTHING})
            parts[name] = alone.accumulate(log.controls, log.dt, log.control_starts, recorded_dt=log.recorded_dt)[1]
    return parts


def stacked(parts: Iterable[Mapping[str, Array]]) -> dict[str, Array]:
    """The parts of several logs, one after the other; all of the same names."""
    several = list(parts)
    return {name: np.concatenate([each[name] for each in several]) for name in several[0]}


def with_variances(model: Model, variances: Mapping[str, float]) -> Model:
    """The model with these variances, epsilon at least `LEAST_EPSILON`; fields that are not named stay."""
    numbers: dict[str, Any] = {n: max(v, LEAST_EPSILON) if n == "epsilon" else v**0.5 for n, v in variances.items()}
    return replace(model, **numbers)


def ordinary(log: Log) -> np.ndarray:
    """The motions (T,) bool whose noise is the model's alone: those across no gap in the odometry."""
    if log.control_variances is None:
        return np.ones(log.num_poses - 1, dtype=bool)
    more = np.any(log.control_variances > changes_within(log) * (1 + 1e-9), axis=1)
    return ~np.logical_or.reduceat(more, log.control_starts[:-1])


def sighting_times(log: Log) -> Array:
    """The times (M,) of the sightings of a log with controls since its first pose [s].

    Those of the clock are rounded: sightings at a regular rate would lie on one side of a limit or the other by its zero.
    """
    return log.control_times[log.control_starts[log.steps]]


def sensor_parts(sightings: Array) -> dict[str, Array]:
    """C_p (M, n, n) of each field of the sensor model that affects sightings (M, n), n = 2 or 3."""
    least = _EXACT.Q(sightings)
    parts = {name: SensorModel(**(_TINY | {name: 1.0})).Q(sightings) - least for name in OF_SENSOR}
    return {name: C for name, C in parts.items() if C.any()}


#: the fields of the motion model whose variances are estimated
ESTIMATED = ("nn", "on", "oo", "slip", "sigma_omega")
#: parameters that differ by less than this are near: what a derivative leaves out of a motion is some 1e-5 of it
NEAR = {"wheel_scale": 0.006, "turn_scale": 0.006, "turn_rate_bias": 0.002, "curvature_bias": 0.002}
#: how many evaluations are kept: an estimate solves several problems of one drive, with other biases, in turn
EVALUATIONS = 4


class Odometry:
    """The motions of a log with controls.

    Attributes:
        log: the log.
        times: (T+1,) of its poses [s].
    """

    def __init__(self, log: Log) -> None:
        assert log.controls is not None and log.dt is not None and log.times is not None
        self.log, self.times = log, log.times
        self._parts = motion_parts(log, ESTIMATED)
        # variances of single controls, such as those across a silence of the odometry
        self._recorded, self._of_controls = replace(STILL, epsilon=NOTHING).accumulate(
            log.controls, log.dt, log.control_starts, honest_variances(log)
        )
        #: the last evaluations by `_single`: values of the parameters, averaging times, motions and slopes
        self._evaluated: list[tuple[Array, list[float], Array, Array]] = []
        #: the last noise of the motion, and its averaging times
        self._times_of: tuple[MotionModel | None, list[float]] = None, []

    def covers(self, log: Log) -> bool:
        """Whether all poses of a log are poses of this one."""
        assert log.times is not None
        return bool(np.isin(log.times, self.times).all())

    def steps(self, log: Log) -> np.ndarray:
        """The numbers of the poses of a log that this one covers."""
        assert log.times is not None
        return np.searchsorted(self.times, log.times)

    def parts(self, steps: np.ndarray) -> tuple[Mapping[str, Array], Array]:
        """C_p (n, 3, 3) of each field of the motion model for the motions between poses, and C of `honest_variances`."""
        if len(steps) == len(self.times):
            return self._parts, self._of_controls
        inside = slice(steps[0], steps[-1])
        levers = joined_motions(self._recorded[inside], steps - steps[0])[1]

        def joined(C: Array) -> Array:
            return np.add.reduceat(levers @ C[inside] @ np.swapaxes(levers, 1, 2), steps[:-1] - steps[0])

        return {name: joined(C) for name, C in self._parts.items()}, joined(self._of_controls)

    def motions(self, parameters: Parameters, steps: np.ndarray) -> tuple[Array, Array]:
        """The motions (n, 3) of the corrected controls between poses, and their derivative (n, 3, K) by the parameters."""
        motions, slopes = self._single(parameters)
        if len(steps) == len(self.times):
            return motions, slopes
        inside = slice(steps[0], steps[-1])
        motions, levers = joined_motions(motions[inside], steps - steps[0])
        return motions, np.add.reduceat(levers @ slopes[inside], steps[:-1] - steps[0])

    def by_differences(self, parameters: Parameters, steps: np.ndarray) -> Array:
        """The derivative (n, 3, 2) of the motions between poses by `Uneven.difference` of speeds and of turn rates."""
        everything, inside = replace(parameters, recorded=self.log), slice(steps[0], steps[-1])
        motions, slopes = motion_slopes(
            everything, corrected_controls(everything), scaled=np.abs(averaged_controls(self.log)) / 2
        )
        scales = [parameters.names.index(name) for name in ("wheel_scale", "turn_scale")]
        levers = joined_motions(motions[inside], steps - steps[0])[1]
        return np.add.reduceat(levers @ slopes[inside][:, :, scales], steps[:-1] - steps[0])

    def poses(self, parameters: Parameters) -> Array:
        """The poses (T+1, 3) of the corrected controls."""
        return chained(self.log.initial_poses[0], self._single(parameters)[0])

    def speeds(self, parameters: Parameters) -> Array:
        """The control (T+1, 2) at each pose, `controls_at_steps`."""
        return controls_at_steps(replace(parameters, recorded=self.log))

    def _single(self, parameters: Parameters) -> tuple[Array, Array]:
        """`motions` between successive poses."""
        everything = replace(parameters, recorded=self.log)
        if parameters.motion is not self._times_of[0]:
            self._times_of = parameters.motion, averaging_times(everything, of_scales=True)
        times = self._times_of[1]
        for at, averaged, motions, slopes in self._evaluated:
            if averaged == times and near(parameters, at):
                return motions + slopes @ (parameters.values - at), slopes
        motions, slopes = motion_slopes(
            everything, corrected_controls(everything), scaled=smoothed_controls(everything)
        )
        self._evaluated = [(parameters.values, times, motions, slopes), *self._evaluated[: EVALUATIONS - 1]]
        return motions, slopes


def near(parameters: Parameters, values: Array) -> bool:
    """Whether parameters are so near the values (K,) of an evaluation that its derivatives are enough (`NEAR`)."""
    k = [parameters.names.index(name) for name in NEAR]
    return bool(np.all(np.abs(parameters.values - values)[k] <= list(NEAR.values())))


@dataclass
class Edges:
    """Edges of one kind, of a drive whose noise and biases are unknown, at one state.

    Attributes:
        first, second: (E,) nodes.
        residuals: (E, d).
        by_first, by_second: (E, d, 3) Jacobians.
        by_parameters: (E, d, K).
        parts: {name of a variance: C (E, d, d)}.
        information: W (E, d, d), the inverse covariance times the weights.
        weights: u (E,) of Student's t.
        squares: (E,) e' W e without the weights.
    """

    first: np.ndarray
    second: np.ndarray
    residuals: Array
    by_first: Array
    by_second: Array
    by_parameters: Array
    parts: Mapping[str, Array]
    information: Array = field(default_factory=lambda: np.empty(0))
    weights: Array = field(default_factory=lambda: np.empty(0))
    squares: Array = field(default_factory=lambda: np.empty(0))

    def weigh(self, covariances: Array, numbers: int, degrees: float, hidden: Array | float) -> None:
        """Set the information and the weights.

        Args:
            covariances: (E, d, d).
            numbers: how many numbers each edge measures.
            degrees: of freedom of Student's t.
            hidden: (E,) tr(W F) without the weights.
        """
        remedy = "give the noise of the robot: motion and sensor models, or noise=FILE"
        inverse = inverses(covariances, "motion or sighting", remedy, least=0.0)
        self.squares = np.einsum("ei,ei->e", self.residuals, (inverse @ self.residuals[:, :, None])[:, :, 0])
        self.weights = (degrees + numbers) / (degrees + self.squares + hidden)
        self.information = self.weights[:, None, None] * inverse

    def pull(self, forces: Array, nodes: Array) -> Array:
        """Add B' f for forces f (E, d, k) to right-hand sides (n, 3, k), and return J' f (K, k)."""
        add_at(nodes, self.first, np.swapaxes(self.by_first, 1, 2) @ forces)
        add_at(nodes, self.second, np.swapaxes(self.by_second, 1, 2) @ forces)
        return np.einsum("edp,edk->pk", self.by_parameters, forces)

    def moved(self, nodes: Array, parameters: Array) -> Array:
        """How residuals change, (E, d, k), when nodes (n, 3, k) and parameters (K, k) do."""
        return self.by_first @ nodes[self.first] + self.by_second @ nodes[self.second] + self.by_parameters @ parameters


def add_at(total: Array, rows: np.ndarray, values: Array) -> None:
    """Add values (E, ...) to these rows (E,) of ``total`` (n, ...), which may occur several times."""
    width = total[0].size
    places = rows[:, None] * width + np.arange(width)
    # several times as fast as `np.add.at`
    total += np.bincount(places.ravel(), values.ravel(), total.size).reshape(total.shape)


#: motions with so many times the variance of others are left out
UNUSUAL = 1e3
#: the fewest motions between scans that say something. Their errors are clipped to this many times their median;
#: successive ones cancel each other where their correlation is below the next number and below zero by so many standard
#: errors, and their variance is not below the last part of the models'
FEWEST_MOTIONS, MEDIANS, CANCEL, SURELY, SMALL = 20, 4.5, -0.2, 3.0, 0.25
#: the least part of the variance of motions that is their own
LEAST_OWN = 0.03


@dataclass(frozen=True)
class CommonErrors:
    """The errors that all sightings of a scan have in common.

    Attributes:
        covariance: C (3, 3), in the robot's axes.
        own: (3,) the part of the variance of the motions along each axis that is not due to these errors.
    """

    covariance: Array
    own: Array


def common_errors(first: np.ndarray, second: np.ndarray, errors: Array, covariances: Array) -> CommonErrors | None:
    """The errors of whole scans, where a drive surely shows some.

    An error b_t of all sightings of a scan moves the estimate of that pose: it makes one motion too large and the next one
    too small by as much, so that

        E[e_t e_(t+1)'] = -E[b_t b_t'] = -C,

    whereas the errors of odometry are independent, and what a solution leaves of these is smooth. Errors of successive
    motions must surely cancel each other in one axis; the others count from the same correlation on.

    Args:
        first, second: (E,) the poses that motions join, in the order of time.
        errors: e (E, 3) of the motions at the solution, in the axes of the robot.
        covariances: (E, 3, 3) by the noise model.
    """
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    # of motions between two drives next to nothing is known
    usual = np.all(variances <= UNUSUAL * np.quantile(variances, 0.9, axis=0), axis=1)
    joined = (second[:-1] == first[1:]) & usual[:-1] & usual[1:]
    # inexact times make motions short, and their errors as large as those of others
    deviations = np.sqrt(np.maximum(variances, np.median(variances, axis=0)))
    z = errors / deviations
    far = MEDIANS * np.median(np.abs(z), axis=0)
    z = np.clip(z, -far, far)
    z = np.where(usual[:, None], z - z[usual].mean(axis=0), 0.0)
    count, squares = np.count_nonzero(joined), np.sum(z**2, axis=0)
    if count < FEWEST_MOTIONS or not squares.all():
        return None
    correlations = np.sum((z[:-1] * z[1:])[joined], axis=0) / squares
    # errors much smaller than the models of the odometry are those of single sightings, which covariances have already
    size = squares / np.count_nonzero(usual)
    if not np.any((size > SMALL) & (correlations < min(CANCEL, -SURELY / count**0.5))):
        return None
    cancel = (size > SMALL) & (correlations < CANCEL)
    e = np.where(cancel, z * deviations, 0.0)
    C = -(e[:-1][joined].T @ e[1:][joined]) / count
    values, axes = np.linalg.eigh((C + C.T) / 2)
    own = np.where(cancel, np.clip((1 + 2 * correlations) * np.minimum(size, 1.0), LEAST_OWN, 1.0), 1.0)
    return CommonErrors((axes * np.maximum(values, 0.0)) @ axes.T, own)
