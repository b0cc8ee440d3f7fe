"""Noise from a log without ground truth: from the residuals of its solved graph.

A least-squares solution fits part of the noise, so residuals are smaller than the noise: their covariance is C_e - P_e,
where P_e = B_e Omega^-1 B_e' is due to the uncertainty of the solution. For variances theta_p with covariance parts C_p
restricted maximum likelihood requires, with W_e = C_e^-1,

    sum_e u_e e' W C_p W e  =  sum_e tr(W C_p) - u_e tr(W P_e W C_p)          for each p with theta_p > 0.

The right side is the expectation of the left one. theta_p is multiplied by the quotient of the two, the graph is solved
again, and so on until the variances converge. u_e = (nu + d) / (nu + e' W e + tr(W P_e)) is the weight of Student's t (1
where Gaussian), for sightings and motions, so that wrong sightings and wheel slip count little; nu is estimated from the
same squares.

Sources: Patterson and Thompson, *Recovery of inter-block information when block sizes are unequal*, Biometrika 58(3),
1971 (the equations); Anderson, *Asymptotically efficient estimation of covariance matrices with linear structure*, Annals
of Statistics 1(1), 1973 (the iteration). The weights are an approximation: residuals of different edges are treated as
independent given the solution.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import brentq

from ..edges import ObservationEdges, RelativePoseEdges
from ..errors import GraphError, LogError
from ..graph import Graph
from ..log import Log
from ..models import MotionModel, SensorModel
from ..se2 import Array
from ..solvers.solve import solve
from ..uncertainty import Uncertainty
from .parts import LEAST, motion_parts, ordinary, sensor_parts, variances_of, with_variances
from .variances import FEWEST, MOST, VarianceFit, fit_of_solution, slope_by_nu

#: converged when no variance, made e times larger or smaller, would change the log likelihood by more than this
SETTLED = 0.1
#: the most graphs to solve
MAX_ROUNDS = 200
#: the greatest factor by which a variance changes in one round
FASTEST = 10.0
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


def noise_from_residuals(
    log: Log, motion: MotionModel, sensor: SensorModel, degrees: float | None = None
) -> tuple[VarianceFit, VarianceFit, bool]:
    """The variances of both models, from a graph with landmark nodes and motion edges.

    Args:
        log: with controls and ids.
        motion, sensor: the start of the search. Variances that are zero start at a fraction of the others.
        degrees: of freedom of both; None to estimate them, infinity for Gaussian noise.

    Returns:
        The fits of motion and sensor, and whether they converged within `MAX_ROUNDS` rounds.

    Raises:
        GraphError: the log has no controls, or its graph is not determined.
    """
    graph = Graph.from_log(log, motion=motion, sensor=sensor, edges="landmark+motion", kernel="huber", residual="polar")
    anchor, seen, driven = graph.families
    assert isinstance(seen, ObservationEdges) and isinstance(driven, RelativePoseEdges)
    regular = ordinary(log)
    moved = _share(motion_parts(log), variances_of(motion), regular, degrees)
    sighted = _share(sensor_parts(log.sightings), variances_of(sensor), np.ones(seen.count, dtype=bool), degrees)
    across_gaps = log.motions(motion)[1][~regular]

    def models() -> Graph:
        covariances = moved.covariances
        covariances[~regular] = across_gaps
        information = np.linalg.inv(covariances)
        information = moved.weights[:, None, None] * (information + np.swapaxes(information, 1, 2)) / 2
        weighted = replace(seen, sensor=with_variances(sensor, sighted.variances), kernel=None, trust=sighted.weights)
        return replace(graph, families=(anchor, weighted, replace(driven, information=information)))

    current, state = graph, solve(graph, tolerance=1e-4).state
    for rounds in range(MAX_ROUNDS):
        try:
            if rounds > 0:
                current = models().with_initial(state)
                state = solve(current, tolerance=1e-6, max_iterations=20, initialize="given").state
            uncertainty = Uncertainty(current, state)
            slope = 0.0
            for share, family in ((sighted, current.families[1]), (moved, current.families[2])):
                taken = family.linearize(state, state)
                slope = max(slope, share.improve(taken.residuals, uncertainty.of_edges(taken)))
        except (GraphError, np.linalg.LinAlgError):
            if rounds == 0:
                raise
            # the edges determined the nodes with the first noise models
            raise LogError(_lost(log, sighted.variances | moved.variances)) from None
        if slope < SETTLED:
            break
    return moved.fit(), sighted.fit(), slope < SETTLED


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
