"""Noise from logs without ground truth: from the residuals of their solved graphs.

A least-squares solution fits part of the noise, so residuals are smaller than the noise: their covariance is C_e - P_e,
where P_e = B_e Omega^-1 B_e' is due to the uncertainty of the solution. For variances theta_p with covariance parts C_p
restricted maximum likelihood requires, with W_e = C_e^-1,

    sum_e u_e e' W C_p W e  =  sum_e tr(W C_p) - u_e tr(W P_e W C_p)          for each p with theta_p > 0.

The right side is the expectation of the left one. theta_p is multiplied by the quotient of the two, the graph is solved
again, and so on until the variances converge. u_e = (nu + d) / (nu + e' W e + tr(W P_e)) is the weight of Student's t (1
where Gaussian), for sightings and motions, so that wrong sightings and wheel slip count little; nu is estimated from the
same squares.

Numbers by which all measurements are wrong (wheel scale, turn-rate bias, range scale and bias) are further unknowns p
of the graphs. With W = Omega_e, J = de/dp and X = sum of B' W J, a step is

    -(sum of J' W J - X' Omega^-1 X)^-1 sum of J' W e,

whose matrix is also their covariance. Odometry and ranges may have one scale in common, which only the truth tells.
Therefore one of the two scales stays 1, by default that of the odometry, or both do. A number
within three standard errors of its ideal value is held there.

All this assumes that the errors of sightings are independent. Where successive sightings of a landmark have errors in common,
the solution follows them, the noise comes out too small, and p comes out wrong. Therefore variances are estimated first. p is
added only if they leave no correlation above `CORRELATED`, and kept only if this stays so.

Sources: Patterson and Thompson, *Recovery of inter-block information when block sizes are unequal*, Biometrika 58(3),
1971 (the equations); Anderson, *Asymptotically efficient estimation of covariance matrices with linear structure*, Annals
of Statistics 1(1), 1973 (the iteration). The weights are an approximation: residuals of different edges are treated as
independent given the solution.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import brentq

from ..edges import ObservationEdges, RelativePoseEdges
from ..edges.base import Linearization
from ..errors import GraphError, LogError
from ..graph import Graph
from ..identification.parts import LEAST, motion_parts, ordinary, sensor_parts, stacked, variances_of, with_variances
from ..log import Log
from ..models import MotionModel, SensorModel
from ..se2 import Array
from ..solvers.solve import solve
from ..uncertainty import Uncertainty
from .from_truth import SIGNIFICANT, STEP, inverse_information
from .variances import FEWEST, MOST, VarianceFit, fit_of_solution, slope_by_nu

#: converged when no variance, made e times larger or smaller, would change the log likelihood by more than this
SETTLED = 0.1
#: the most graphs to solve
MAX_ROUNDS = 200
#: the greatest factor by which a variance changes in one round
FASTEST = 10.0
#: the numbers by which all measurements are wrong, and their ideal values; the last ones are given up first
MEANS = {"turn_rate_bias": 0.0, "wheel_scale": 1.0, "range_scale": 1.0, "range_bias": 0.0}
#: what has the right scale, and the numbers that are therefore not estimated
SCALES = {"odometry": ("wheel_scale",), "ranges": ("range_scale",), "both": ("wheel_scale", "range_scale")}
#: they have converged when they change by less than this part of their standard errors
FINE = 0.05
#: successive residuals of a landmark whose correlation is above this are not independent
CORRELATED = 0.2
#: a part that explains less than this fraction of the edges' variance is zero
NEGLIGIBLE = 1e-6


@dataclass
class _Share:
    """One kind of edges, and the parts of its noise."""

    parts: Mapping[str, Array]
    variances: dict[str, float]
    counted: np.ndarray
    degrees: float | None
    weights: Array
    nu: float = 10.0
    residuals: Array = field(default_factory=lambda: np.empty(0))
    leverage: Array = field(default_factory=lambda: np.empty(0))

    @property
    def covariances(self) -> Array:
        """C_e (E, d, d)."""
        return sum(self.variances[name] * C for name, C in self.parts.items())  # type: ignore[return-value]

    def improve(self, residuals: Array, leverage: Array) -> float:
        """One round on residuals (E, d) with P_e (E, d, d); the steepest slope of the log likelihood by a log variance."""
        self.residuals, self.leverage = residuals, leverage
        W = np.linalg.inv(self.covariances)
        pulled = np.einsum("eij,ej->ei", W, residuals)
        d = residuals.shape[1]
        squares = np.einsum("ei,ei->e", residuals, pulled) + np.einsum("eij,eji->e", W, leverage)
        self.nu = degrees_of_freedom(squares[self.counted], d) if self.degrees is None else self.degrees
        self.weights = np.ones(len(squares)) if np.isinf(self.nu) else (self.nu + d) / (self.nu + squares)
        u = self.weights * self.counted
        fitted = W @ leverage @ W
        steepest = 0.0
        for name, C in self.parts.items():
            before = self.variances[name]
            if before == 0:
                continue
            actual = float(np.einsum("e,ei,eij,ej->", u, pulled, C, pulled, optimize=True))
            whole = float(np.einsum("e,eij,eji->", self.counted.astype(float), W, C, optimize=True))
            expected = whole - float(np.einsum("e,eij,eji->", u, fitted, C, optimize=True))
            after = before * float(np.clip(actual / expected if expected > 0 else 1.0, 1 / FASTEST, FASTEST))
            least = LEAST.get(name, 0.0)
            after = max(after, least) if after * whole >= NEGLIGIBLE * len(u) * d or name == "epsilon" else 0.0
            if after != before:
                steepest = max(steepest, 0.5 * before * abs(actual - expected))
            self.variances[name] = after
        return steepest

    def fit(self) -> VarianceFit:
        """The variances, with errors and bounds from the information reduced by the leverage."""
        here = self.counted
        parts = {name: C[here] for name, C in self.parts.items()}
        return fit_of_solution(
            self.residuals[here], parts, self.variances, self.nu, least=LEAST, leverage=self.leverage[here]
        )


@dataclass(frozen=True)
class _Drive:
    """A log, its graph, and which of all motions and sightings are its own."""

    log: Log
    graph: Graph
    motions: slice
    sightings: slice

    def successive(self) -> tuple[np.ndarray, np.ndarray]:
        """The sightings that are followed by another of the same landmark, and those that follow, among all."""
        order = np.argsort(self.log.landmarks, kind="stable")
        same = np.diff(self.log.landmarks[order]) == 0
        return order[:-1][same] + self.sightings.start, order[1:][same] + self.sightings.start

    def weighted(self, moved: _Share, sighted: _Share, means: Array) -> Graph:
        """The graph with the current noise, weights and means."""
        anchor, seen, driven = self.graph.families
        assert isinstance(seen, ObservationEdges) and isinstance(driven, RelativePoseEdges)
        regular, covariances = moved.counted[self.motions], moved.covariances[self.motions].copy()
        # motions across gaps keep the noise that they began with
        covariances[~regular] = np.linalg.inv(driven.information[~regular])
        information = np.linalg.inv(covariances)
        information = moved.weights[self.motions, None, None] * (information + np.swapaxes(information, 1, 2)) / 2
        z = seen.sightings.copy()
        z[:, 0] = (z[:, 0] - means[3]) / means[2]
        noise = with_variances(seen.sensor, sighted.variances)
        seen = replace(seen, sightings=z, sensor=noise, kernel=None, trust=sighted.weights[self.sightings])
        driven = replace(driven, measured=self.measured(means), information=information)
        return replace(self.graph, families=(anchor, seen, driven))

    def measured(self, means: Array) -> Array:
        """The motions (T, 3) of the corrected odometry."""
        return self.log.with_corrected_odometry(wheel_scale=means[1], turn_rate_bias=means[0]).motions()[0]

    def slopes(self, graph: Graph, state: Array, means: Array) -> tuple[Array, Array]:
        """de/dp (E, d, K) of the sightings and of the motions."""
        seen = graph.families[1]
        assert isinstance(seen, ObservationEdges)
        predicted = seen.linearize(state, state).residuals[:, 0] + seen.sightings[:, 0]
        by_sightings = np.zeros((*seen.sightings.shape, len(MEANS)))
        # a regression of measured ranges on those of the solution
        by_sightings[:, 0, 2:] = np.column_stack([predicted, np.ones(len(predicted))]) / means[2]
        by_motions = np.zeros((self.log.num_poses - 1, 3, len(MEANS)))
        for k, h in enumerate(STEP * np.eye(len(MEANS))[:2]):
            by_motions[:, :, k] = (self.measured(means - h) - self.measured(means + h)) / (2 * STEP)
        return by_sightings, by_motions


@dataclass(frozen=True, kw_only=True)
class ResidualNoise:
    """What `noise_from_residuals` finds.

    Attributes:
        motion, sensor: the fits.
        means, errors: the numbers of `MEANS`, and their standard errors; NaN where they were not estimated.
        correlation: the highest correlation of successive residuals of a landmark, over the numbers of a sighting.
        settled: whether all converged within `MAX_ROUNDS` rounds.
    """

    motion: VarianceFit
    sensor: VarianceFit
    means: dict[str, float]
    errors: dict[str, float]
    correlation: float
    settled: bool


def noise_from_residuals(
    logs: Sequence[Log],
    motion: MotionModel,
    sensor: SensorModel,
    degrees: float | None = None,
    *,
    scale: str = "odometry",
) -> ResidualNoise:
    """The variances of both models, from graphs with landmark nodes and motion edges, and the numbers of `MEANS`.

    Args:
        logs: with controls and ids.
        motion, sensor: the start of the search. Variances that are zero start at a fraction of the others.
        degrees: of freedom of both; None to estimate them, infinity for Gaussian noise.
        scale: what has the right scale, "odometry", "ranges" or "both".

    Raises:
        GraphError: a log has no controls, or its graph is not determined.
        LogError: the residuals do not determine the noise.
    """
    z = np.concatenate([log.sightings for log in logs])
    counted = np.concatenate([ordinary(log) for log in logs])
    moved = _share(stacked(map(motion_parts, logs)), variances_of(motion), counted, degrees)
    sighted = _share(sensor_parts(z), variances_of(sensor), np.ones(len(z), dtype=bool), degrees)
    drives, t, m = [], 0, 0
    for log in logs:
        graph = Graph.from_log(
            log, motion=motion, sensor=sensor, edges="landmark+motion", kernel="huber", residual="polar"
        )
        drives.append(_Drive(log, graph, slice(t, t + log.num_poses - 1), slice(m, m + len(log.steps))))
        t, m = t + log.num_poses - 1, m + len(log.steps)
    first = _Search(drives, moved, sighted, [solve(drive.graph, tolerance=1e-4).state for drive in drives])
    first.run(np.zeros(len(MEANS), dtype=bool))
    if first.correlation > CORRELATED:
        return first.found()
    second = deepcopy(first)
    try:
        second.run(np.array([name not in SCALES[scale] for name in MEANS]))
    except LogError:
        return first.found()
    return (second if second.settled and second.correlation < CORRELATED else first).found()


@dataclass
class _Search:
    """Variances, means and trajectories, improved in turn."""

    drives: Sequence[_Drive]
    moved: _Share
    sighted: _Share
    states: list[Array]
    means: Array = field(default_factory=lambda: np.array(list(MEANS.values())))
    errors: Array = field(default_factory=lambda: np.full(len(MEANS), np.nan))
    settled: bool = False
    begun: bool = False

    def run(self, free: np.ndarray) -> None:
        """Search until nothing changes any more, with the means that are ``free`` (K,) among the unknowns.

        Raises:
            GraphError: the edges do not determine a graph.
            LogError: the noise came to where a graph cannot be solved.
        """
        ideal, free, self.settled = np.array(list(MEANS.values())), free.copy(), False
        for _ in range(MAX_ROUNDS):
            slope, gradient, information = self._round()
            covariance, known = inverse_information(information[np.ix_(free, free)])
            if not known:
                free[np.flatnonzero(free)[-1]] = False
                continue
            step = -covariance @ gradient[free]
            self.errors[free], self.means[free] = np.sqrt(np.diag(covariance)), self.means[free] + step
            if slope < SETTLED and np.all(np.abs(step) < FINE * self.errors[free]):
                distance = np.where(free, np.abs(self.means - ideal) / self.errors, np.inf)
                self.settled = bool(np.all(distance > SIGNIFICANT))
                if self.settled:
                    break
                k = int(np.argmin(distance))
                free[k], self.means[k] = False, ideal[k]

    def _round(self) -> tuple[float, Array, Array]:
        """Solve the graphs and improve the variances: their steepest slope, and the normal equations of the means."""
        residuals: tuple[list[Array], list[Array]] = ([], [])
        leverages: tuple[list[Array], list[Array]] = ([], [])
        gradient, information = np.zeros(len(MEANS)), np.zeros((len(MEANS), len(MEANS)))
        try:
            for k, drive in enumerate(self.drives):
                current = drive.graph
                if self.begun:
                    current = drive.weighted(self.moved, self.sighted, self.means).with_initial(self.states[k])
                    self.states[k] = solve(current, tolerance=1e-6, max_iterations=20, initialize="given").state
                state = self.states[k]
                uncertainty = Uncertainty(current, state)
                ends = [family.linearize(state, state) for family in current.families[1:]]
                for edges, e, P in zip(ends, residuals, leverages):
                    e.append(edges.residuals)
                    P.append(uncertainty.of_edges(edges))
                part = _normal_equations(ends, drive.slopes(current, state, self.means), uncertainty, len(state))
                gradient, information = gradient + part[0], information + part[1]
            shares = (self.sighted, self.moved)
            slopes = [s.improve(np.concatenate(e), np.concatenate(P)) for s, e, P in zip(shares, residuals, leverages)]
        except (GraphError, np.linalg.LinAlgError):
            if not self.begun:
                raise
            # the edges determined the nodes with the first noise models
            variances = self.sighted.variances | self.moved.variances
            raise LogError(_lost(self.drives[0].log, variances)) from None
        self.begun = True
        return max(slopes), gradient, information

    @property
    def correlation(self) -> float:
        """The correlation of successive residuals of a landmark, the highest of all numbers of a sighting."""
        noise = np.sqrt(np.diagonal(self.sighted.covariances, axis1=1, axis2=2))
        e = self.sighted.residuals / noise * np.sqrt(self.sighted.weights)[:, None]
        one, next_one = (np.concatenate(each) for each in zip(*(drive.successive() for drive in self.drives)))
        return float(np.max(np.mean(e[one] * e[next_one], axis=0) / np.mean(e**2, axis=0))) if len(one) else 0.0

    def found(self) -> ResidualNoise:
        """The result."""
        return ResidualNoise(
            motion=self.moved.fit(), sensor=self.sighted.fit(), means=dict(zip(MEANS, self.means.tolist())),
            errors=dict(zip(MEANS, self.errors.tolist())), correlation=self.correlation, settled=self.settled,
        )  # fmt: skip


def _normal_equations(
    ends: Sequence[Linearization], slopes: Sequence[Array], uncertainty: Uncertainty, nodes: int
) -> tuple[Array, Array]:
    """The gradient (K,) and the information (K, K) of the means, with the nodes eliminated."""
    K = slopes[0].shape[2]
    gradient, information, mixed = np.zeros(K), np.zeros((K, K)), np.zeros((nodes, 3, K))
    for edges, J in zip(ends, slopes):
        weighted = edges.information @ J
        gradient += np.einsum("edk,ed->k", weighted, edges.residuals)
        information += np.einsum("edk,edl->kl", weighted, J)
        for node, B in zip(edges.nodes, edges.jacobians):
            np.add.at(mixed, node, np.swapaxes(B, 1, 2) @ weighted)
    return gradient, information - np.einsum("nik,nil->kl", mixed, uncertainty.solve(mixed))


def _lost(log: Log, variances: Mapping[str, float]) -> str:
    """Why a search was given up."""
    reached = ", ".join(f"{n} {v if n == 'epsilon' else v**0.5:.2g}" for n, v in variances.items() if v > 0)
    return (
        f"{log.name}: the residuals do not determine the noise: the search came to {reached}, with which the graph cannot "
        "be solved; give the noise by hand, or calibrate from the ground truth"
    )


def degrees_of_freedom(squares: Array, d: int) -> float:
    """The maximum-likelihood nu for squared Mahalanobis norms (E,) of d-vectors; infinite from `MOST` on."""

    def slope(log_nu: float) -> float:
        return slope_by_nu(squares, d, np.exp(log_nu))

    low, high = np.log(FEWEST), np.log(MOST)
    if slope(low) <= 0:
        return FEWEST
    if slope(high) >= 0:
        return float("inf")
    return float(np.exp(brentq(slope, low, high)))


def _share(parts: dict[str, Array], variances: dict[str, float], counted: np.ndarray, degrees: float | None) -> _Share:
    """The parts with the variances to start with; those that are zero start at a hundredth of the sum of all."""
    size = {name: float(np.einsum("eii->", C)) for name, C in parts.items()}
    whole = sum(variances[name] * size[name] for name in parts)
    least = {name: 0.01 * whole / size[name] if size[name] > 0 else 0.0 for name in parts}
    begun = {name: max(variances[name], least[name]) for name in parts}
    return _Share(parts, begun, counted, degrees, np.ones(len(counted)))
