"""Noise from a log without truth: from the residuals that are left when its graph is solved.

A least-squares solution bends towards its data, so residuals are smaller than the noise: their covariance is C_e - P_e,
where P_e = B_e Omega^-1 B_e' is what the solution itself is uncertain by. For variances theta_p with covariance parts C_p
restricted maximum likelihood asks that, with W_e = C_e^-1,

    sum_e u_e e' W C_p W e  =  sum_e tr(W C_p) - u_e tr(W P_e W C_p)          for each p with theta_p > 0.

The right side is what the left is expected to be; the quotient of the two multiplies theta_p, the graph is solved again,
and so on until nothing moves. u_e = (nu + d) / (nu + e' W e + tr(W P_e)) is the weight of Student's t (1 where Gaussian),
for sightings and motions alike, so that wrong sightings and slips count little; nu is estimated from the same squares.

Sources: Patterson and Thompson, *Recovery of inter-block information when block sizes are unequal*, Biometrika 58(3),
1971 (the equations); Anderson, *Asymptotically efficient estimation of covariance matrices with linear structure*, Annals
of Statistics 1(1), 1973 (the iteration). The part of the weights is an approximation: residuals of different edges count
as independent given the solution.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import brentq
from scipy.special import digamma

from ..edges import ObservationEdges, RelativePoseEdges
from ..errors import GraphError
from ..graph import Graph
from ..log import Log
from ..models import MotionModel, SensorModel
from ..se2 import Array
from ..solvers.solve import solve
from ..uncertainty import Uncertainty
from .parts import (
    LEAST_EPSILON,
    motion_parts,
    motion_variances,
    ordinary,
    sensor_model,
    sensor_parts,
    sensor_variances,
)
from .variances import FEWEST, MOST, VarianceFit, standard_errors

#: the iteration has settled when no variance, made e times larger or smaller, would change the log likelihood by more
SETTLED = 0.1
#: the most that a variance grows or shrinks in one round
FASTEST = 10.0
#: a part that explains less than this of the edges' variance is none
NEGLIGIBLE = 1e-6


@dataclass
class _Share:
    """One kind of edges, and what its noise is made of."""

    parts: Mapping[str, Array]
    variances: dict[str, float]
    counted: np.ndarray
    degrees: float | None
    weights: Array
    nu: float = 10.0
    leverage: Array = field(default_factory=lambda: np.empty(0))

    @property
    def covariances(self) -> Array:
        """C_e (E, d, d)."""
        return sum(self.variances[name] * C for name, C in self.parts.items())  # type: ignore[return-value]

    def improve(self, residuals: Array, leverage: Array) -> float:
        """One round on residuals (E, d) with P_e (E, d, d); the steepest slope of the log likelihood by a log variance."""
        self.leverage = leverage
        W = np.linalg.inv(self.covariances)
        pulled = np.einsum("eij,ej->ei", W, residuals)
        d = residuals.shape[1]
        squares = np.einsum("ei,ei->e", residuals, pulled) + np.einsum("eij,eji->e", W, leverage)
        if self.degrees is None:
            self.nu = degrees_of_freedom(squares[self.counted], d)
        else:
            self.nu = self.degrees
        self.weights = np.ones(len(squares)) if np.isinf(self.nu) else (self.nu + d) / (self.nu + squares)
        u = self.weights * self.counted
        held = W @ leverage @ W
        steepest = 0.0
        for name, C in self.parts.items():
            before = self.variances[name]
            if before == 0:
                continue
            found = float(np.einsum("e,ei,eij,ej->", u, pulled, C, pulled, optimize=True))
            whole = float(np.einsum("e,eij,eji->", self.counted.astype(float), W, C, optimize=True))
            wanted = whole - float(np.einsum("e,eij,eji->", u, held, C, optimize=True))
            after = before * float(np.clip(found / wanted if wanted > 0 else 1.0, 1 / FASTEST, FASTEST))
            if name == "epsilon":
                after = max(after, LEAST_EPSILON)
            elif after * whole < NEGLIGIBLE * len(u) * d:
                after = 0.0
            if after != before:
                steepest = max(steepest, 0.5 * before * abs(found - wanted))
            self.variances[name] = after
        return steepest

    def fit(self) -> VarianceFit:
        """The outcome, with standard errors from the information that the leverage leaves."""
        names = list(self.parts)
        W = np.linalg.inv(self.covariances)[self.counted]
        reduced = W - W @ self.leverage[self.counted] @ W
        C = np.stack([self.parts[name][self.counted] for name in names])
        errors = standard_errors(reduced, C, np.array([self.variances[name] for name in names]), self.nu)
        return VarianceFit(
            self.variances, dict(zip(names, errors.tolist())), self.nu, float("nan"), self.weights,
            int(self.counted.sum()),
        )  # fmt: skip


@dataclass(frozen=True)
class Settled:
    """What `noise_from_residuals` found, and in how many rounds; ``converged`` where nothing moved any more."""

    motion: VarianceFit
    sensor: VarianceFit
    rounds: int
    converged: bool


def noise_from_residuals(
    log: Log, motion: MotionModel, sensor: SensorModel, degrees: float | None = None, max_rounds: int = 200
) -> Settled:
    """The variances of both models, from a graph with landmark nodes and motion edges.

    Args:
        log: with controls and ids.
        motion, sensor: where the search begins. Numbers that are zero begin at a part of the others.
        degrees: of freedom of both; None to estimate them, infinity for Gaussian noise.
        max_rounds: the most graphs to solve.

    Raises:
        GraphError: the log has no controls, or its graph is not determined.
    """
    graph = Graph.from_log(log, motion=motion, sensor=sensor, edges="landmark+motion", kernel="huber")
    anchor, seen, driven = graph.families
    assert isinstance(seen, ObservationEdges) and isinstance(driven, RelativePoseEdges)
    n = log.sightings.shape[1]
    regular = ordinary(log)
    moved = _Share(motion_parts(log), {}, regular, degrees, np.ones(driven.count))
    sighted = _Share(
        sensor_parts(log.sightings), {}, np.ones(seen.count, dtype=bool), degrees, np.ones(seen.count)
    )  # fmt: skip
    moved.variances = _begun(motion_variances(motion), moved.parts)
    sighted.variances = _begun(sensor_variances(sensor, n), sighted.parts)
    across_gaps = log.motions(motion)[1][~regular]

    def models() -> Graph:
        covariances = moved.covariances
        covariances[~regular] = across_gaps
        information = np.linalg.inv(covariances)
        information = moved.weights[:, None, None] * (information + np.swapaxes(information, 1, 2)) / 2
        model = sensor_model(sighted.variances, sensor)
        return replace(
            graph,
            families=(
                anchor,
                replace(seen, sensor=model, kernel=None, trust=sighted.weights),
                replace(driven, information=information),
            ),
        )

    solution = solve(graph, initialize="auto", tolerance=1e-4)
    state = solution.state
    rounds, converged = 0, False
    while rounds < max_rounds and not converged:
        current = graph if rounds == 0 else models().with_initial(state)
        if rounds > 0:
            solution = solve(current, tolerance=1e-6, max_iterations=20)
            if not np.all(np.isfinite(solution.state)):
                raise GraphError(f"{log.name}: the graph could not be solved with the noise found so far")
            state = solution.state
        uncertainty = Uncertainty(current, state)
        slope = 0.0
        for share, family in ((sighted, current.families[1]), (moved, current.families[2])):
            taken = family.linearize(state, state)
            slope = max(slope, share.improve(taken.residuals, uncertainty.of_edges(taken)))
        rounds += 1
        converged = slope < SETTLED
    return Settled(moved.fit(), sighted.fit(), rounds, converged)


def degrees_of_freedom(squares: Array, d: int) -> float:
    """The likeliest nu for squared Mahalanobis norms (E,) of d-vectors; infinite from `MOST` on."""

    def slope(log_nu: float) -> float:
        nu = np.exp(log_nu)
        weights = (nu + d) / (nu + squares)
        of_gamma = digamma((nu + d) / 2) - digamma(nu / 2) - d / nu
        return float(of_gamma + np.mean(-np.log1p(squares / nu) + weights * squares / nu))

    low, high = np.log(FEWEST), np.log(MOST)
    if slope(low) <= 0:
        return FEWEST
    if slope(high) >= 0:
        return float("inf")
    return float(np.exp(brentq(slope, low, high)))


def _begun(variances: dict[str, float], parts: Mapping[str, Array]) -> dict[str, float]:
    """The variances to begin with: of parts that are zero, as much as makes a hundredth of the others' sum."""
    size = {name: float(np.einsum("eii->", C)) for name, C in parts.items()}
    whole = sum(variances[name] * size[name] for name in parts)
    least = {name: 0.01 * whole / size[name] if size[name] > 0 else 0.0 for name in parts}
    return {name: max(variances[name], least[name]) for name in parts}
