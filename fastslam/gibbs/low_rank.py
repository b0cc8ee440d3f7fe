"""The Gaussian at the mode of trajectory and map, and its widest directions, along which the chains move all of it at once.

The moves are in the engine (``engine/sources/gibbs/low_rank.cpp``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from graphslam.edges.relative import RelativePointEdges, RelativePoseEdges
from graphslam.errors import OptionError
from graphslam.linear.cholesky import FactorizationError
from graphslam.linear.information import BlockSystem
from graphslam.se2 import Array, wrap

from ..motions import Problem
from ..options import GibbsOptions

#: the most directions, and the share of all dimensions
DIRECTIONS, SHARE = 150, 0.5
#: moves after each sweep
MOVES = 15
#: Gauss-Newton steps to the mode
FITS = 20
#: up to this size all eigenvectors are computed
DENSE = 300


def _no_inverse(problem: Problem) -> OptionError:
    return OptionError(
        "a motion or a sighting has a covariance without an inverse in floating point: look for a wrong range (the longest "
        f"is {problem.z[:, 0].max():.3g} m), or raise epsilon of the motion"
    )


@dataclass(frozen=True, eq=False)
class Target:
    """-log of the posterior of a trajectory and a map, without constants, with precisions of the sightings integrated out.

    Attributes:
        degrees: of freedom of Student's t distribution of the sightings; 0 for a Gaussian.
        exact: whether the sightings have the density of range and bearing, or the linearised one.
        weights: (K, n, n) the information of the linearised sightings; without psi n = 2.
        in_engine: the same for the chains.
    """

    problem: Problem
    degrees: float
    exact: bool
    weights: Array
    in_engine: Any

    @classmethod
    def of(cls, problem: Problem, options: GibbsOptions) -> Target:
        """Return that of a problem."""
        p, n = problem, problem.columns
        W = np.zeros((len(p.C), 3, 3))
        try:
            W[:, :n, :n] = np.linalg.inv(full(p.C)[:, :n, :n])
        except np.linalg.LinAlgError:
            raise _no_inverse(problem) from None
        rows, columns = np.tril_indices(3)
        degrees, exact = options.degrees_of_freedom or 0.0, options.density == "exact"
        in_engine = p.in_engine(p.motions, p.information, W[:, rows, columns], exact=exact, degrees=degrees)
        return cls(problem, degrees, exact, np.ascontiguousarray(W[:, :n, :n]), in_engine)

    def __call__(self, poses: Array, marks: Array) -> float:
        """Return its value."""
        return self.in_engine.cost(poses, marks, self.exact)[0]

    def linearised(self, poses: Array, marks: Array) -> tuple[float, Array]:
        """Return the value of the linearised density, and e' C^-1 e (K,) of the sightings."""
        return self.in_engine.cost(poses, marks, False)


class LowRank:
    """The Gaussian at the mode of a target, and its widest directions.

    A state is a vector of 3 T + n J numbers: the poses after the first, and the n numbers of each landmark. Without psi n is
    2: nothing depends on the headings of landmarks, so that they must not be among the directions of the Gaussian.

    Args:
        target: of the moves. The Gaussian is that of its linearised density.
        poses, marks: (T + 1, 3) and (J, 3), where the search for the mode begins.

    Attributes:
        target: as given.
        mode: the poses (T + 1, 3) and landmarks (J, 3) there.
        directions: (r, 3 T + n J) of unit length; ``deviations``: (r,) the standard deviations along them.
    """

    def __init__(self, target: Target, poses: Array, marks: Array) -> None:
        self.target = target
        self.mode = mode(target, poses, marks)
        system = System(target)
        system.linearise(*self.mode)
        size = len(system.free)
        r = min(DIRECTIONS, int(SHARE * size))
        if size <= DENSE:
            information = system.blocks.to_sparse()[system.free][:, system.free]
            values, V = np.linalg.eigh(information.toarray())
            V, self.deviations = V[:, :r], values[:r] ** -0.5
        else:
            from scipy.sparse.linalg import LinearOperator, eigsh

            inverse = LinearOperator((size, size), matvec=system.solver())
            values, V = eigsh(inverse, k=r, v0=np.ones(size))
            self.deviations = np.sqrt(values)
        self.directions = np.ascontiguousarray(V.T)


class System:
    """J' J and -J' e of the linearised density, as the information and the vector xi of a graph.

    Student's sightings are weighed by (nu + n) / (nu + e' C^-1 e).

    Attributes:
        blocks: the nodes are the poses, then the landmarks; the first pose is known.
        free: the places of the 3 T + n J numbers of a state among the 3 (T + 1 + J) of the nodes.
    """

    def __init__(self, target: Target) -> None:
        p = target.problem
        self._target, T, J = target, len(p.motions), len(p.ids)
        self._motions = RelativePoseEdges(np.arange(T), np.arange(1, T + 1), p.motions, full(p.information))
        self._marks = np.arange(T + 1, T + 1 + J)
        self._ends = p.steps, self._marks[p.marks]
        self.blocks = BlockSystem.from_cliques(
            T + 1 + J, [self._motions.cliques(), self._sightings(np.ones(1)).cliques()]
        )
        numbers = np.arange(3 * (T + 1 + J)).reshape(-1, 3)
        self.free = np.concatenate([numbers[1 : T + 1].ravel(), numbers[T + 1 :, : p.columns].ravel()])

    def _sightings(self, factor: Array) -> RelativePoseEdges | RelativePointEdges:
        p = self._target.problem
        kind = RelativePoseEdges if p.columns == 3 else RelativePointEdges
        weights = np.broadcast_to(factor, len(p.y))[:, None, None] * self._target.weights
        return kind(*self._ends, np.ascontiguousarray(p.y[:, : p.columns]), weights)

    def linearise(self, poses: Array, marks: Array) -> None:
        """Compute both at a state."""
        target, factor = self._target, np.ones(1)
        n = target.problem.columns
        if target.degrees > 0:
            factor = (target.degrees + n) / (target.degrees + target.linearised(poses, marks)[1])
        state = np.concatenate([poses, marks])
        self.blocks.clear()
        for edges in (self._motions, self._sightings(factor)):
            edges.accumulate(state, state, self.blocks)
        self.blocks.hold(np.zeros(1, dtype=np.int64))
        if n == 2:
            self.blocks.rest(self._marks, 2)

    def solver(self, damping: float = 0.0) -> Any:
        """Return the function that solves for a vector (3 T + n J,).

        Raises:
            OptionError: the information has no factor in floating point.
        """
        try:
            factor = self.blocks.factorize(damping)
        except FactorizationError:
            raise _no_inverse(self._target.problem) from None
        whole = np.zeros(3 * self.blocks.num_nodes)

        def solve(b: Array) -> Array:
            whole[self.free] = b.ravel()
            return factor.solve(whole.reshape(-1, 3)).ravel()[self.free]

        return solve

    @property
    def descent(self) -> Array:
        """-J' e (3 T + n J,)."""
        return self.blocks.xi.ravel()[self.free]


def mode(target: Target, poses: Array, marks: Array) -> tuple[Array, Array]:
    """Return poses and landmarks at the mode of the linearised density: damped Gauss-Newton steps from where they are."""
    x, m, system = poses.copy(), marks.copy(), System(target)
    lowest, damping = target.linearised(x, m)[0], 1e-9
    for _ in range(FITS):
        system.linearise(x, m)
        trial = displaced(x, m, system.solver(damping)(system.descent))
        value = target.linearised(*trial)[0]
        if not value < lowest:
            damping = max(100 * damping, 1e-6)
            continue
        done = lowest - value < 1e-6
        (x, m), lowest, damping = trial, value, max(damping / 10, 1e-9)
        if done:
            break
    return x, m


def displaced(poses: Array, marks: Array, step: Array) -> tuple[Array, Array]:
    """Return poses and landmarks plus a displacement (3 T + n J,) of all but the first pose."""
    x, m, after = poses.copy(), marks.copy(), 3 * (len(poses) - 1)
    x[1:] += step[:after].reshape(-1, 3)
    moved = step[after:].reshape(len(marks), -1)
    m[:, : moved.shape[1]] += moved
    x[:, 2], m[:, 2] = wrap(x[:, 2]), wrap(m[:, 2])
    return x, m


def full(upper: Array) -> Array:
    """Symmetric matrices (k, 3, 3) from their upper triangles (k, 6), column by column."""
    return upper[:, [[0, 1, 3], [1, 2, 4], [3, 4, 5]]]
