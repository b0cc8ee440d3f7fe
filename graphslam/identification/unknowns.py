"""A drive whose noise and biases are unknown: nodes, parameters and variances of one least-squares problem.

The nodes are the poses x_t and the places m of the landmarks (with headings where psi was measured). The parameters p are
those of `declared` (scales, biases, delay and place of the sensor), each with a prior about its ideal value. The
residuals are

    motions:    e = (R(theta_t)' (t_{t+1} - t_t), theta_{t+1} - theta_t) - the motion of the corrected controls,
    sightings:  e = (range_scale r + range_bias, direction - theta + bearing_bias, direction - heading of m) - z,

where r and direction lead from the sensor to the landmark; a single number has one of these. A sighting that is late by tau
was made from x_t moved back by tau times the control. The covariances are sums of variances times known parts
(`identification.odometry`). Every edge of d numbers has the weight u = (nu + d) / (nu + e' W e + tr(W F)) of Student's t, so
that slipping wheels and wrong sightings count little. F is the covariance of the residual due to that of the solution: the
residual of an edge that nothing else determines is near zero, but the error that it hides is as large as C says.

Nodes and parameters are solved together: with C = sum B' W J, D = sum J' W J + P and J = de/dp,

    delta = (D - C' Omega^-1 C)^-1 (g - C' Omega^-1 xi),   Delta = Omega^-1 (xi - C delta).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import replace
from typing import cast

import numpy as np

from ..engine import engine
from ..errors import GraphError
from ..linear.cholesky import Bordered, Factor, FactorizationError
from ..linear.information import BlockSystem
from ..log import Log
from ..log.measurements import PartialSightings
from ..models import MotionModel, SensorModel, plausible_ranges
from ..se2 import (
    Array,
    between,
    chained,
    compose,
    difference,
    interpolate,
    inverse,
    perpendicular,
    rotation,
    turn_matrix,
    wrap,
)
from .corrections import corrected_sensor, moves
from .declared import Parameters, ideal_values
from .odometry import LEAST_EPSILON, NOISE, STILL, Edges, Odometry, sensor_parts, with_variances

#: the columns of whole sightings, and of their residuals
RANGE, BEARING = 0, 1
#: the parameters of an unknown robot, with the standard deviations of their priors. The scale of ranges is not among them:
#: only its quotient with the scale of the wheels is identifiable.
PRIORS = {
    "wheel_scale": 0.03, "turn_scale": 0.03, "turn_rate_bias": 0.01, "curvature_bias": 0.01, "range_bias": 0.03,
    "bearing_bias": 0.03, "sensor_ahead": 0.05, "sensor_left": 0.03, "sensor_delay": 0.1,
}  # fmt: skip
#: typical standard deviations of the noise, the centres of priors on the logarithms of the variances
TYPICAL = {name: each.typical for name, each in NOISE.items() if each.typical is not None}
#: the standard deviation of the logarithm of a variance about its typical value
SPREAD = 5.0
#: the most that the logarithm of a variance changes in one step
LONGEST = 1.5
#: degrees of freedom of Student's t: of sightings, among which some are wrong, and of motions
DEGREES_SIGHTINGS, DEGREES_MOTIONS = 4.0, 8.0
#: the squared scale of Student's t over the variance of the Gaussian errors of d numbers to which it is fitted: the s² of
#: E[(nu + d) q / (nu s² + q)] = d, q chi-squared with d degrees of freedom; of sightings by d, and of motions
OF_GAUSSIAN_SIGHTINGS, OF_GAUSSIAN_MOTIONS = {1: 0.6906, 2: 0.7267, 3: 0.7559}, 0.8389
#: the information of its edges over that of the solution, see `Unknowns.parameter_covariance`
OVERSTATED_SIGHTINGS, OVERSTATED_MOTIONS = {1: 1.622, 2: 1.552, 3: 1.495}, 1.259
#: where nothing speaks against exact odometry, its noise has this part of the estimate (docs/decisions.md)
EXACT = 1 / 3
#: what counts as no variance
LEAST_VARIANCE = 1e-14
#: the standard deviation of the prior of a parameter that is held
HELD = 1e-7
#: the least distance between sensor and landmark [m], where the bearing is undefined
NEAREST = 1e-3
#: what Omega's diagonal is raised by, where rounding makes it singular
DAMPING = (0.0, 1e-10, 1e-7)


class Unknowns:
    """Nodes, parameters and variances of a drive, at their current values.

    Args:
        log: with controls and sightings.
        groups: (M,) the landmark of each sighting, in any numbers. Sightings of landmarks seen once are left out.
        sensor: where the sensor is believed to be.
        start: what is known from an earlier problem of the same log, or of a part of it: poses, parameters and variances.
        places: {group: (2,)} of landmarks that were seen by ranges and bearings alone, to begin with; then the groups are
            those of these (`Log.partial_sightings`, in the order of time).
    """

    def __init__(
        self, log: Log, groups: np.ndarray, sensor: SensorModel, start: Unknowns | None = None,
        places: Mapping[int, Array] | None = None,
    ) -> None:  # fmt: skip
        assert log.controls is not None and log.dt is not None
        steps, sightings, measured = log.steps, log.sightings, np.ones(log.sightings.shape, dtype=bool)
        self._given = places
        if places is not None:
            partial = cast(PartialSightings, log.partial_sightings)
            steps, sightings = partial.steps, np.column_stack([partial.ranges, partial.bearings])
            measured = np.isfinite(sightings)
            sightings[~measured] = 1.0
        self.log, self.sensor = log, sensor
        _, group, count = np.unique(groups, return_inverse=True, return_counts=True)
        self.used = count[group] > 1
        if not self.used.any():
            raise GraphError(f"{log.name}: no landmark is seen twice, so that nothing tells the noise")
        #: the numbers of the landmarks that are nodes
        self.ids, group = np.unique(groups[self.used], return_inverse=True)
        self.poses = log.num_poses
        self.seen_from, self.seen = steps[self.used].astype(np.int64), group.astype(np.int64) + self.poses
        #: with any value where nothing was measured; and (M, d, d) 1 there on the diagonal
        self.sightings = sightings[self.used]
        self._unmeasured = ~measured[self.used, :, None] * np.eye(sightings.shape[1])
        #: how many numbers a sighting has
        self.numbers = sightings.shape[1] if places is None else 1
        # sightings are in the order of time
        self._first_sightings = np.unique(group, return_index=True)[1]
        self.before, self.after = np.arange(self.poses - 1), np.arange(1, self.poses)
        self.odometry: Odometry = start.odometry if start is not None and start.odometry.covers(log) else Odometry(log)
        self._steps = self.odometry.steps(log)
        self.motion_parts, gaps = self.odometry.parts(self._steps)
        self._least = gaps + LEAST_EPSILON * np.eye(3)
        parts = {name: C * (1 - self._unmeasured) for name, C in sensor_parts(self.sightings).items()}
        self.sensor_parts = {name: C for name, C in parts.items() if C.any()}
        self.centres = self._centres()
        if start is None:
            names = tuple(PRIORS)
            ideal = np.array([ideal_values(sensor)[name] for name in names])
            deviations = np.array([PRIORS[name] for name in names])
            self.parameters = Parameters(names, ideal, ideal, deviations, self.odometry.log, MotionModel(), sensor)
            self.logarithms = dict(self.centres)
            poses = self.dead_reckoning()
        else:
            self.parameters = replace(start.parameters, recorded=self.odometry.log)
            self.logarithms = {name: start.logarithms[name] for name in self.centres}
            poses = start.poses_of(log, self.odometry)
        self.longest, self.last_change = np.full(len(self.centres), LONGEST), np.zeros(len(self.centres))
        self.state: Array = np.concatenate([poses, self.places(poses)])
        #: the names of variances that keep their values
        self.held_variances: frozenset[str] = frozenset() if start is None else start.held_variances
        #: tr(W F) of motions and sightings, see `Edges.weigh`; `hide` sets it
        self.hidden: list[Array | float] = [0.0, 0.0]
        self.take_noise()
        ends = np.r_[self.before, self.seen_from], np.r_[self.after, self.seen]
        cliques = [(np.arange(0, 2 * len(ends[0]) + 1, 2), np.column_stack(ends).ravel())]
        points = range(len(poses), len(self.state)) if self.sightings.shape[1] == 2 else ()
        self.system = BlockSystem.from_cliques(len(self.state), cliques, points)

    def take_noise(self) -> None:
        """Use the present variances where controls are averaged, for the delay of the sensor and for scales."""
        self.parameters = replace(self.parameters, motion=self.models[0])
        self._speeds = self.odometry.speeds(self.parameters)[self._steps]

    def _centres(self) -> dict[str, float]:
        """The centres of the priors on the logarithms of the variances."""
        log = self.log
        assert log.dt is not None
        interval = float(np.median(log.dt if log.recorded_dt is None else log.recorded_dt))
        typical = TYPICAL | {"sigma_omega": TYPICAL["sigma_omega"] / interval**0.5}
        return {name: 2 * np.log(typical[name]) for name in (*self.motion_parts, *self.sensor_parts)}

    def evidence_against(self, names: Collection[str]) -> float:
        """The logarithm of how much more probable the log is where these parameters have their ideal values.

        It is p(ideal | log) / p(ideal), the density of the solution over that of the prior (Dickey, Annals of Mathematical
        Statistics 42(1), 1971).
        """
        p = self.parameters
        k = [p.names.index(name) for name in names]
        covariance, away = self.linearized().covariance[np.ix_(k, k)], p.values[k] - p.means[k]
        scaled = covariance / np.outer(p.deviations[k], p.deviations[k])
        return float(-0.5 * away @ np.linalg.solve(covariance, away) - 0.5 * np.linalg.slogdet(scaled)[1])

    def hold(self, names: Collection[str]) -> None:
        """Keep parameters at their ideal values."""
        p = self.parameters
        held = np.isin(p.names, list(names))
        values, deviations = np.where(held, p.means, p.values), np.where(held, HELD, p.deviations)
        self.parameters = replace(p, values=values, deviations=deviations)

    def hold_noise(self, motion: MotionModel, sensor: SensorModel) -> None:
        """Keep these variances, and all parameters at their ideal values."""
        self.hold(self.parameters.names)
        known, sightings = vars(motion) | vars(sensor), OF_GAUSSIAN_SIGHTINGS[self.numbers]
        for name in self.logarithms:
            part = OF_GAUSSIAN_MOTIONS if name in self.motion_parts else sightings
            self.logarithms[name] = float(np.log(max(known[name] ** 2 * part, LEAST_VARIANCE)))
        self.held_variances = frozenset(self.logarithms)
        self.take_noise()

    def with_nearly_exact_odometry(self) -> Unknowns:
        """The same problem with `EXACT` times the noise of the motion, which is kept."""
        exact = copy(self)
        exact.longest, exact.last_change = self.longest.copy(), self.last_change.copy()
        exact.hidden, exact.held_variances = [0.0, self.hidden[1]], frozenset(self.motion_parts)
        of_motion = {name: self.logarithms[name] + 2 * float(np.log(EXACT)) for name in self.motion_parts}
        exact.logarithms = self.logarithms | of_motion
        return exact

    @property
    def variances(self) -> dict[str, float]:
        """The variances by the names of the models' fields."""
        return {name: float(np.exp(value)) for name, value in self.logarithms.items()}

    @property
    def models(self) -> tuple[MotionModel, SensorModel]:
        """The noise models whose Gaussian errors the variances fit, and the estimated place of the sensor."""
        variances = self.variances
        sightings, sensor = OF_GAUSSIAN_SIGHTINGS[self.numbers], corrected_sensor(self.parameters)
        return (
            with_variances(STILL, {name: variances[name] / OF_GAUSSIAN_MOTIONS for name in self.motion_parts}),
            with_variances(sensor, {name: variances[name] / sightings for name in self.sensor_parts}),
        )

    @property
    def trajectory(self) -> Array:
        """The poses (T+1, 3)."""
        return self.state[: self.poses]

    def dead_reckoning(self) -> Array:
        """The poses (T+1, 3) of the corrected controls."""
        return self.odometry.poses(self.parameters)[self._steps]

    def poses_of(self, log: Log, odometry: Odometry) -> Array:
        """The poses (T+1, 3) of another log of the same drive, with more poses or fewer; ``odometry`` covers it.

        The motions between poses are those of the corrected controls. What these leave out is shared out in time.
        """
        assert self.log.times is not None and log.times is not None
        there = odometry.poses(self.parameters)[odometry.steps(log)]
        # where dead reckoning would have to start for each pose to be right
        starts = compose(self.trajectory, inverse(self.dead_reckoning()))
        number = np.interp(log.times, self.log.times, np.arange(self.poses))
        before = number.astype(np.int64)
        after = np.minimum(before + 1, self.poses - 1)
        return interpolate(compose(starts[before], there), compose(starts[after], there), number - before)

    def places(self, poses: Array) -> Array:
        """The medians (L, 3) of the places at which sightings from poses (T+1, 3) put their landmarks, or those given."""
        places, group = np.zeros((len(self.ids), 3)), self.seen - self.poses
        if self._given is not None:
            places[:, :2] = [self._given[id] for id in self.ids.tolist()]
            return places
        d = self.sightings.shape[1]
        each = corrected_sensor(self.parameters).h_inverse(poses[self.seen_from], self.sightings)
        count = np.bincount(group)
        starts = np.cumsum(count) - count
        below, above = starts + (count - 1) // 2, starts + count // 2
        for k in range(2):
            ordered = each[np.lexsort((each[:, k], group)), k]
            places[:, k] = (ordered[below] + ordered[above]) / 2
        if d == 3:
            places[:, 2] = each[np.argsort(group, kind="stable")[above], 2]
        return places

    def motions(self) -> Edges:
        """The edges of all motions."""
        measured, slopes = self.measured()
        a, b = self.trajectory[:-1], self.trajectory[1:]
        moved = between(a, b)
        residuals = difference(moved, measured)
        by_second = turn_matrix(-a[:, 2])
        by_first = -by_second
        by_first[:, :2, 2] = -perpendicular(moved[:, :2])
        return Edges(self.before, self.after, residuals, by_first, by_second, -slopes, self.motion_parts)

    def measured(self) -> tuple[Array, Array]:
        """The motions (T, 3) of the corrected controls, and their derivative (T, 3, K) by the parameters."""
        return self.odometry.motions(self.parameters, self._steps)

    def by_differences(self) -> Array:
        """The derivative (T, 3, 2) of the motions by what `Odometry.by_differences` says."""
        return self.odometry.by_differences(self.parameters, self._steps)

    def sighted(
        self, steps: np.ndarray | None = None, seen: np.ndarray | None = None, sightings: Array | None = None
    ) -> Edges:
        """The edges of the sightings, or of others: their steps (M,), nodes of landmarks (M,) and values (M, d)."""
        parts, z = self.sensor_parts, self.sightings
        if steps is None or seen is None or sightings is None:
            steps, seen = self.seen_from, self.seen
        else:
            parts, z = sensor_parts(sightings), sightings
        p, d, sensor = self.parameters.by_name(), z.shape[1], corrected_sensor(self.parameters)
        at, m, speed = self.state[steps].copy(), self.state[seen][:, :d], self._speeds[steps]
        # where the sighting was made from, the robot was earlier
        heading = np.column_stack([np.cos(at[:, 2]), np.sin(at[:, 2])])
        back = -p["sensor_delay"] * speed
        at[:, :2] += back[:, :1] * heading
        at[:, 2] += back[:, 1]
        eyes = sensor.mount(at)[:, :2]
        at_sensor = np.hypot(*(m[:, :2] - eyes).T) < NEAREST
        m[at_sensor, :2] = eyes[at_sensor] + [NEAREST, 0.0]
        predicted, by_at = sensor.h(at, m), sensor.H_pose(at, m)
        residuals = predicted.copy()
        residuals[:, 0] = p["range_scale"] * residuals[:, 0] + p["range_bias"]
        residuals[:, 1] += p["bearing_bias"]
        residuals -= z
        residuals[:, 1:] = wrap(residuals[:, 1:])
        by_at[:, 0] *= p["range_scale"]
        # only the difference of the two positions counts
        by_landmark = np.zeros((len(z), d, 3))
        by_landmark[:, :, :2] = -by_at[:, :, :2]
        by_landmark[:, 2:, 2] = -1.0
        # a turn of the present pose also turns the way back
        by_pose = by_at.copy()
        by_pose[:, :, 2] += np.einsum("edi,ei->ed", by_at[:, :, :2], back[:, :1] * perpendicular(heading))
        # a parameter has the effect of a move of the pose from which the sighting was made, in its own axes ...
        by_own = by_at @ turn_matrix(at[:, 2])
        slopes = np.einsum("edi,eik->edk", by_own, moves(self.parameters, predicted, speed))
        if "sensor_delay" in self.parameters.names:
            # ... but for the delay, which moves it along the heading of the present pose
            driven = np.einsum("edi,ei->ed", by_at[:, :, :2], speed[:, :1] * heading)
            slopes[:, :, self.parameters.names.index("sensor_delay")] = -driven - by_at[:, :, 2] * speed[:, 1:]
        if "range_rate" in parts:
            # noise at the measured range would give short readings more weight than long ones, so that lengths shrink
            longer = plausible_ranges(predicted[:, 0], z[:, 0]) / z[:, 0]
            parts = parts | {"range_rate": parts["range_rate"] * (longer**2)[:, None, None]}
        if self._given is not None:
            for each in (residuals, by_pose, by_landmark, slopes):
                each[self._unmeasured.any(axis=1)] = 0.0
        return Edges(steps, seen, residuals, by_pose, by_landmark, slopes, parts)

    def covariances(self, edges: Edges) -> Array:
        """C (E, d, d) of edges."""
        total = sum(np.exp(self.logarithms[name]) * C for name, C in edges.parts.items())
        if edges.parts is self.motion_parts:
            total = total + self._least
        elif self._given is not None:
            total = total + self._unmeasured
        return np.asarray(total)

    def linearized(self) -> Linear:
        """The linear problem at the current values.

        Raises:
            GraphError: it determines no solution.
        """
        motions, sightings = self.motions(), self.sighted()
        motions.weigh(self.covariances(motions), 3, DEGREES_MOTIONS, self.hidden[0])
        sightings.weigh(self.covariances(sightings), self.numbers, DEGREES_SIGHTINGS, self.hidden[1])
        return Linear(self, (motions, sightings))

    def parameter_covariance(self) -> Array:
        """The covariance (K, K) of the parameters, for Gaussian errors.

        For errors e ~ N(0, I), the solution of sum psi(e) = 0, psi = u e / s², has the information A² / V an edge, with
        A = E[tr dpsi/de] / d and V = E[psi' psi] / d. The normal equations have E[u] / s² instead.

        Source: Huber, *Robust estimation of a location parameter*, Annals of Mathematical Statistics 35(1), 1964.
        """
        edges = self.linearized().edges
        for each, part in zip(edges, (OVERSTATED_MOTIONS, OVERSTATED_SIGHTINGS[self.numbers])):
            each.information /= part
        return Linear(self, edges).covariance

    def hide(self, linear: Linear) -> list[Array]:
        """Set what edges hide (`hidden`); and F (E, d, d) of motions and sightings."""
        every = [linear.fitted(edges) for edges in linear.edges]
        self.hidden = [np.sum(e.information * F, axis=(1, 2)) / e.weights for e, F in zip(linear.edges, every)]
        return every

    def iterate(self, steps: int) -> None:
        """Gauss-Newton steps.

        Raises:
            GraphError: the values became infinite, or the problem determines no solution.
        """
        for _ in range(steps):
            self.take_step(self.linearized())

    def take_step(self, linear: Linear) -> None:
        """The Gauss-Newton step of a linear problem at the current values.

        Raises:
            GraphError: the values became infinite.
        """
        nodes, values = linear.step()
        self.state = self._moved(linear.edges[0], nodes)
        self.parameters = self.parameters.at(self.parameters.values + values)
        if not np.isfinite(self.state).all():
            raise GraphError(f"{self.log.name}: the search for noise and biases diverged")

    def _moved(self, motions: Edges, step: Array) -> Array:
        """The state after a step (n, 3) of the nodes: each pose moves against the one before, and is added to it.

        A correction of the first headings turns all later poses, which a step in world axes approximates by a straight line.
        Landmarks move with the pose that saw them first.
        """
        x, new = self.trajectory, np.empty_like(self.state)
        turn = np.swapaxes(rotation(x[:-1, 2]), 1, 2)
        relative = np.empty((self.poses - 1, 3))
        relative[:, :2] = np.einsum("eij,ej->ei", turn, x[1:, :2] - x[:-1, :2])
        relative[:, 2] = x[1:, 2] - x[:-1, 2]
        change = motions.by_first @ step[self.before, :, None] + motions.by_second @ step[self.after, :, None]
        relative += change[:, :, 0]
        new[: self.poses] = chained(x[0], relative)
        rows = self._first_sightings
        at, nodes = self.seen_from[rows], self.seen[rows]
        offset = self.state[nodes] - x[at]
        changed = step[nodes] - step[at]
        changed[:, :2] -= perpendicular(offset[:, :2]) * step[at, 2, None]
        offset[:, :2] = np.einsum("eij,ej->ei", rotation(new[at, 2] - x[at, 2]), offset[:, :2] + changed[:, :2])
        offset[:, 2] += changed[:, 2]
        new[nodes] = new[at] + offset
        return new


class Linear(Bordered):
    """The normal equations of `Unknowns` at one state, and their factors."""

    def __init__(self, unknowns: Unknowns, edges: Sequence[Edges]) -> None:
        self.edges, system, parameters = tuple(edges), unknowns.system, unknowns.parameters
        self.poses, self.flat = unknowns.poses, unknowns.sightings.shape[1] == 2
        self.prior = parameters.weights
        self.gradient = -self.prior * (parameters.values - parameters.means)
        own = np.diag(self.prior).astype(float)
        system.clear()
        mixed = np.zeros((system.num_nodes, 3, len(parameters)))
        for each in self.edges:
            jacobians = each.by_first, each.by_second, each.by_parameters, each.information
            engine.add_linearized(
                each.first, each.second, system.slots_of(each.first, each.second), each.residuals,
                *map(np.ascontiguousarray, jacobians), *system.arrays, mixed, own, self.gradient,
            )  # fmt: skip
        if self.flat:
            system.rest(np.arange(self.poses, system.num_nodes), 2)
        system.hold(np.zeros(1, dtype=np.int64))
        self.xi = system.xi.copy()
        self._free(mixed)
        super().__init__(_factorized(system, unknowns.log.name), mixed, own)

    def _free(self, nodes: Array) -> None:
        """Set to zero what belongs to no free coordinate, in right-hand sides (n, 3, k)."""
        nodes[0] = 0.0
        if self.flat:
            nodes[self.poses :, 2] = 0.0

    def solve(self, nodes: Array, values: Array) -> tuple[Array, Array]:
        """As `Bordered.solve`; ``nodes`` is changed."""
        self._free(nodes)
        return super().solve(nodes, values)

    def step(self) -> tuple[Array, Array]:
        """The Gauss-Newton step of the nodes (n, 3) and the parameters (K,)."""
        return self.solve(self.xi.copy(), self.gradient)

    def fitted(self, edges: Edges) -> Array:
        """The covariance (E, d, d) of the residuals of edges that is due to that of the solution.

        With A = (B, J) the Jacobians by nodes and parameters, and X = Omega^-1 times their common blocks, it is
        B Omega^-1 B' + (J - B X) S^-1 (J - B X)', S the information of the parameters alone.
        """
        diagonal, mixed = self.factor.diagonal_covariances(), self.factor.covariances_between(edges.first, edges.second)
        # the first pose is known
        diagonal[0], mixed[edges.first == 0] = 0.0, 0.0
        one, two = edges.by_first, edges.by_second
        crossed = one @ mixed @ np.swapaxes(two, 1, 2)
        total = one @ diagonal[edges.first] @ np.swapaxes(one, 1, 2)
        total += two @ diagonal[edges.second] @ np.swapaxes(two, 1, 2)
        of_parameters = edges.moved(-self.reach, np.eye(len(self.schur)))
        spread = of_parameters @ np.linalg.cholesky(self.covariance)
        return total + crossed + np.swapaxes(crossed, 1, 2) + spread @ np.swapaxes(spread, 1, 2)

    def samples(self, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """Errors of nodes (n, 3, count) and parameters (K, count), drawn from the covariance of the solution."""
        return self.drawn(count, rng)[:2]

    def drawn(self, count: int, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        """`samples`, and the errors W^(-1/2) w (M, d, count) of the sightings from which they follow.

        The solution of sum B' W^(1/2) w with random signs w has the covariance Omega^-1.
        """
        nodes, errors = np.zeros((*self.xi.shape, count)), np.zeros(0)
        values = self.prior[:, None] ** 0.5 * rng.choice([-1.0, 1.0], size=(len(self.prior), count))
        for each in self.edges:
            root = np.linalg.cholesky(each.information)
            signs = rng.choice([-1.0, 1.0], size=(*each.residuals.shape, count))
            values += each.pull(root @ signs, nodes)
            errors = np.linalg.solve(np.swapaxes(root, 1, 2), signs)
        return *self.solve(nodes, values), errors


def _factorized(system: BlockSystem, name: str) -> Factor:
    for damping in DAMPING:
        with suppress(FactorizationError):
            return system.factorize(damping)
    raise GraphError(f"{name}: the sightings do not determine noise and biases together with the poses")
