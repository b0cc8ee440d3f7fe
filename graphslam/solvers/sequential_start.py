"""Initial values by solving a growing part of the trajectory: solve the first poses, add the next ones, solve again.

Each added pose begins where its motion edge leads from the corrected pose before it, so that no error of dead reckoning
accumulates, and each new landmark where its first sighting puts it. This finds the optimum where noise is so large that
starts which look at all poses at once end in other minima. Fewer poses at a time find it more often, and take longer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import GraphError
from ..graph import Graph
from ..se2 import Array, compose
from ..transform import first_poses
from .gauss_newton import gauss_newton
from .initial_values import odometry
from .iteration import Run

#: beyond this number of poses, more are added at a time in proportion, so that the time grows little faster than them
MANY = 300
#: the most steps of Gauss-Newton after each addition
STEPS = 4


@dataclass(frozen=True, eq=False)
class _Tree:
    """The parent (n,) of each node, a pose with a lower number, and the pose (n, 3) of the node in the axes of its parent."""

    parents: np.ndarray
    offsets: Array


def most_steps(total: int, poses: int) -> float:
    """The most steps of `sequential_start` for ``total`` poses, each counted as the part of the poses that it moves."""
    steps, count = 0.0, 1
    while count < total:
        count = _next(count, poses, total)
        steps += STEPS * count / total
    return steps


def _next(count: int, poses: int, total: int) -> int:
    """The number of poses after some more were added to ``count``."""
    return min(count + poses * max(count, MANY) // MANY, total)


def sequential_start(graph: Graph, poses: int) -> Array:
    """A state (n, 3) from solving the first poses, then ``poses`` more, until all are there.

    Raises:
        GraphError: no chain of motion edges leads through all poses.
    """
    tree, count, total = _tree(graph), 1, len(graph.steps)
    state = graph.initial.copy()
    _place(state, tree, np.flatnonzero(tree.parents[total:] == 0) + total)
    while count < total:
        before, count = count, _next(count, poses, total)
        for pose in range(before, count):
            _place(state, tree, np.array([pose]))
        seen_from = tree.parents[total:]
        _place(state, tree, np.flatnonzero((seen_from >= before) & (seen_from < count)) + total)
        piece, nodes = first_poses(graph, count)
        # a start needs little accuracy
        run = Run(state[nodes], tolerance=1e-3 * count**0.5, max_iterations=STEPS)
        try:
            gauss_newton(piece, run)
        except GraphError:
            continue  # more poses may determine what these leave open
        if np.isfinite(run.state).all():
            state[nodes] = run.state
    return state


def _place(state: Array, tree: _Tree, nodes: np.ndarray) -> None:
    """Set nodes of a state (n, 3) to where their parents see them."""
    state[nodes] = compose(state[tree.parents[nodes]], tree.offsets[nodes])


def _tree(graph: Graph) -> _Tree:
    """Poses follow from the pose before, landmarks from the first pose that sees them."""
    poses, unturned = len(graph.steps), np.zeros_like(graph.initial)
    parents, offsets = np.full(graph.num_nodes, -1), np.zeros((graph.num_nodes, 3))
    parents[1:poses] = np.arange(poses - 1)
    offsets[:poses], _ = odometry(graph, "grow")
    for family in graph.families:
        for relations, columns in ((family.positions(unturned), slice(0, 2)), (family.headings(), 2)):
            if relations is None:
                continue
            # of several sightings the last assignment stays: that of the first pose
            backwards = np.argsort(-relations.first, kind="stable")
            first, second = relations.first[backwards], relations.second[backwards]
            at_landmark = second >= poses
            parents[second[at_landmark]] = first[at_landmark]
            offsets[second[at_landmark], columns] = relations.value[backwards][at_landmark]
    # those of a map stay where they are
    parents[graph.mapped] = -1
    return _Tree(parents, offsets)
