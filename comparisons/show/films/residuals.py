"""The residuals of a graph's edges as Mahalanobis distances sqrt(e' Omega e), and where to draw them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from matplotlib.colors import LinearSegmentedColormap

from graphslam import Graph
from graphslam.edges import AnchorEdges, EdgeFamily, MarginalEdges, VirtualMotionEdges
from graphslam.se2 import Array

from ..style import RESIDUALS

#: of a family with more edges some are drawn, evenly spread: more lines would only fill the picture
MOST_EDGES = 4000
COLORS = LinearSegmentedColormap.from_list("residuals", RESIDUALS)


class Residuals:
    """The edges of a graph as lines, those with the largest residuals last.

    The number of virtual-motion edges is quadratic in the sightings, so each landmark's sightings are thinned before the
    edges are listed. Of the other families every N-th edge is drawn.

    Attributes:
        drawn, count: how many edges are drawn, and how many there are.
    """

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._families = [_thinned(f) for f in graph.families if not isinstance(f, AnchorEdges)]
        self.count = graph.num_edges
        self.drawn = len(self(graph.initial)[1])

    def __call__(self, state: Array) -> tuple[Array, Array]:
        """At a state (n, 3): the lines (E, 2, 2) [m] and their Mahalanobis distances (E,), increasing.

        A line ends at the point of the robot to which the log's ground truth belongs, as paths do.
        """
        places, poses = state.copy(), len(self._graph.steps)
        if self._graph.log is not None:
            places[:poses] = self._graph.log.at_truth(state[:poses])
        lines, distances = [np.empty((0, 2, 2))], [np.empty(0)]
        for family, factor, every in self._families:
            edges = family.linearize(state, state)
            begin = places[edges.nodes[0], :2]
            if isinstance(family, MarginalEdges):
                end = family.landmarks(state, state)[family.group, :2]
            else:
                end = places[edges.nodes[1], :2]
            lines.append(np.stack([begin, end], axis=1)[::every])
            distances.append(np.sqrt(np.maximum(factor * edges.mahalanobis, 0))[::every])
        line, distance = np.concatenate(lines), np.concatenate(distances)
        order = np.argsort(distance, kind="stable")
        return line[order], distance[order]


def _thinned(family: EdgeFamily) -> tuple[EdgeFamily, Array, int]:
    """A family that is quick to list, the factor (E,) or (1,) on its e' Omega e, and N where every N-th edge is drawn."""
    if family.count <= MOST_EDGES or not isinstance(family, VirtualMotionEdges):
        return family, np.ones(1), max(1, math.ceil(family.count / MOST_EDGES))
    apart = math.ceil(math.sqrt(family.count / MOST_EDGES))
    rank = np.arange(len(family.nodes)) - family.starts[family.group]
    left = rank % apart == 0
    starts = np.concatenate([[0], np.cumsum(np.bincount(family.group[left], minlength=len(family.starts) - 1))])
    trust = None if family.trust is None else family.trust[left]
    fewer = replace(family, starts=starts, nodes=family.nodes[left], sightings=family.sightings[left], trust=trust)
    # the weight of a tempered pair is 2/K, with K of all sightings
    return fewer, (family.group_weights / fewer.group_weights)[fewer.pairs()[2]], 1
