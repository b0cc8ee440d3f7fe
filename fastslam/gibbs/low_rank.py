"""The Gaussian at the mode of trajectory and map, and its widest directions, along which the chains move all of it at once.

The moves are in the engine (``engine/sources/gibbs/low_rank.cpp``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from graphslam import Cauchy, Graph, GraphError, solve
from graphslam.edges.relative import DoubtedPointEdges, RelationEdges, RelativePoseEdges
from graphslam.errors import OptionError
from graphslam.linear.cholesky import FactorizationError
from graphslam.se2 import Array, wrap

from ..motions import Problem
from ..options import GibbsOptions

#: the most directions, and the share of all dimensions
DIRECTIONS, SHARE = 150, 0.5
#: moves after each sweep
MOVES = 15
#: the most steps to the mode
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
        problem: the motions and sightings.
        graph: the density with the sightings linearised; the nodes are the poses, of which the first is known, and the
            landmarks. A sighting e with covariance C that has Student's t distribution with nu degrees of freedom costs
            (nu + n) log(1 + e' C^-1 e / nu): that is Cauchy's kernel of width sqrt(nu + n) on (1 + n / nu) C^-1.
        in_engine: the density for the chains.
    """

    problem: Problem
    graph: Graph
    in_engine: Any

    @classmethod
    def of(cls, problem: Problem, options: GibbsOptions) -> Target:
        """Return that of a problem."""
        p, n, T = problem, problem.columns, len(problem.motions)
        W = np.zeros((len(p.C), 3, 3))
        try:
            W[:, :n, :n] = np.linalg.inv(full(p.C)[:, :n, :n])
        except np.linalg.LinAlgError:
            raise _no_inverse(problem) from None
        rows, columns = np.tril_indices(3)
        degrees, exact = options.degrees_of_freedom or 0.0, options.density == "exact"
        in_engine = p.in_engine(p.motions, p.information, W[:, rows, columns], exact=exact, degrees=degrees)
        information, kernel = np.ascontiguousarray(W[:, :n, :n]), None
        if degrees > 0:
            information, kernel = (1 + n / degrees) * information, Cauchy((degrees + n) ** 0.5)
        steps, marks = np.arange(T + 1), np.arange(T + 1, T + 1 + len(p.ids))
        kind = RelationEdges if n == 3 else DoubtedPointEdges
        families = (
            RelativePoseEdges(steps[:-1], steps[1:], p.motions, full(p.information)),
            kind(p.steps, marks[p.marks], np.ascontiguousarray(p.y[:, :n]), information, kernel=kernel),
        )
        nodes = np.zeros((T + 1 + len(p.ids), 3))
        graph = Graph(
            nodes, families=families, steps=steps, trajectory=nodes[: T + 1], pose_ids=steps, landmark_ids=p.ids,
            landmark_dimension=n, fixed=steps[:1],
        )  # fmt: skip
        return cls(problem, graph, in_engine)


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
        graph = target.graph.with_initial(np.concatenate([poses, marks]))
        try:
            solution = solve(graph, method="levenberg-marquardt", max_iterations=FITS, initialize="given")
            system, _ = graph.linearize(solution.state)
            factor = system.factorize()
        except (GraphError, FactorizationError):
            raise _no_inverse(target.problem) from None
        mode = np.column_stack([solution.state[:, :2], wrap(solution.state[:, 2])])
        self.mode = mode[: len(poses)], mode[len(poses) :]
        numbers, n = np.arange(mode.size).reshape(-1, 3), target.problem.columns
        # the places of the state among the numbers of all nodes
        free = np.concatenate([numbers[1 : len(poses)].ravel(), numbers[len(poses) :, :n].ravel()])
        size = len(free)
        r = min(DIRECTIONS, int(SHARE * size))
        if size <= DENSE:
            values, V = np.linalg.eigh(system.to_sparse()[free][:, free].toarray())
            V, self.deviations = V[:, :r], values[:r] ** -0.5
        else:
            from scipy.sparse.linalg import LinearOperator, eigsh

            whole = np.zeros(mode.size)

            def covariance_times(vector: Array) -> Array:
                whole[free] = vector.ravel()
                return factor.solve(whole.reshape(-1, 3)).ravel()[free]

            values, V = eigsh(LinearOperator((size, size), matvec=covariance_times), k=r, v0=np.ones(size))
            self.deviations = np.sqrt(values)
        self.directions = np.ascontiguousarray(V.T)


def full(upper: Array) -> Array:
    """Symmetric matrices (k, 3, 3) from their upper triangles (k, 6), column by column."""
    return upper[:, [[0, 1, 3], [1, 2, 4], [3, 4, 5]]]
