"""A long drive seen from afar: every so manieth pose, with the motions between them joined.

Where dead reckoning has drifted for kilometres Gauss-Newton takes a dozen steps to straighten it, each over all poses.
Straightened on a tenth of the poses first, the rest takes few.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .edges import AnchorEdges, EdgeFamily, ObservationEdges, RelativePoseEdges
from .graph import Graph
from .se2 import Array, rotation, wrap


def coarse(graph: Graph, every: int) -> tuple[Graph, np.ndarray] | None:
    """The graph of every so manieth pose and all landmarks they see, and the nodes of the whole graph that it keeps.

    None where the poses are not one chain of motion edges with sightings of landmark nodes.
    """
    chain = _chain(graph)
    if chain is None:
        return None
    poses = len(graph.steps)
    kept = np.unique(np.append(np.arange(0, poses, every), poses - 1))
    used = np.zeros(graph.num_nodes, dtype=bool)
    used[kept] = True
    for family in graph.families:
        if isinstance(family, ObservationEdges):
            used[family.second[used[family.first]]] = True
    nodes = np.flatnonzero(used)
    number = np.full(graph.num_nodes, -1)
    number[nodes] = np.arange(len(nodes))
    families: list[EdgeFamily] = [_joined(chain, kept)]
    for family in graph.families:
        if isinstance(family, AnchorEdges):
            here = used[family.nodes]
            families.append(AnchorEdges(number[family.nodes[here]], family.values[here], family.information[here]))
        elif isinstance(family, ObservationEdges):
            here = used[family.first]
            families.append(
                replace(
                    family, first=number[family.first[here]], second=number[family.second[here]],
                    sightings=family.sightings[here], trust=None if family.trust is None else family.trust[here],
                )
            )  # fmt: skip
    landmarks = nodes[len(kept) :] - poses
    return replace(
        graph, initial=graph.initial[nodes], families=tuple(families), steps=np.arange(len(kept)),
        trajectory=graph.initial[kept], pose_ids=graph.pose_ids[kept], landmark_ids=graph.landmark_ids[landmarks],
        fixed=number[graph.fixed[used[graph.fixed]]], log=None,
    ), nodes  # fmt: skip


def filled(graph: Graph, kept: np.ndarray, poses: Array) -> Array:
    """All poses (P, 3) from those kept (k,): the others by their motions from the kept one before them."""
    chain = _chain(graph)
    assert chain is not None
    driven = _driven(chain.measured)
    before = np.searchsorted(kept, np.arange(len(graph.steps)), side="right") - 1
    at, start = poses[before], driven[kept[before]]
    turn = at[:, 2] - start[:, 2]
    out = np.empty((len(graph.steps), 3))
    out[:, :2] = at[:, :2] + np.einsum("kij,kj->ki", rotation(turn), driven[:, :2] - start[:, :2])
    out[:, 2] = at[:, 2] + driven[:, 2] - start[:, 2]
    return out


def _chain(graph: Graph) -> RelativePoseEdges | None:
    """The motion edges, if there are sightings and nothing else besides, and they lead from each pose to the next."""
    found = [family for family in graph.families if isinstance(family, RelativePoseEdges)]
    known = (RelativePoseEdges, AnchorEdges, ObservationEdges)
    if len(found) != 1 or not all(isinstance(family, known) for family in graph.families):
        return None
    first = np.arange(len(graph.steps) - 1)
    whole = np.array_equal(found[0].first, first) and np.array_equal(found[0].second, first + 1)
    return found[0] if whole and any(isinstance(family, ObservationEdges) for family in graph.families) else None


def _driven(measured: Array) -> Array:
    """Where the relative poses (E, 3) lead from the origin, one after the other; (E+1, 3)."""
    heading = np.concatenate([[0.0], np.cumsum(measured[:, 2])])
    steps = np.einsum("kij,kj->ki", rotation(heading[:-1]), measured[:, :2])
    return np.column_stack([np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)]), heading])


def _joined(chain: RelativePoseEdges, kept: np.ndarray) -> RelativePoseEdges:
    """The relative poses between kept nodes, with covariance sum of J C J', J = [I, lever; 0, 1] after each motion."""
    driven = _driven(chain.measured)
    start, end = driven[kept[:-1]], driven[kept[1:]]
    last = np.repeat(np.arange(len(kept) - 1), np.diff(kept))
    lever = end[last, :2] - driven[1:, :2]
    J = np.zeros((len(last), 3, 3))
    J[:, :2, :2], J[:, 2, 2] = rotation(driven[:-1, 2]), 1.0
    J[:, 0, 2], J[:, 1, 2] = -lever[:, 1], lever[:, 0]
    covariance = np.add.reduceat(J @ np.linalg.inv(chain.information) @ np.swapaxes(J, 1, 2), kept[:-1], axis=0)
    back = np.zeros((len(start), 3, 3))
    back[:, :2, :2], back[:, 2, 2] = rotation(-start[:, 2]), 1.0
    offset = np.einsum("kij,kj->ki", back[:, :2, :2], end[:, :2] - start[:, :2])
    information = np.linalg.inv(back @ covariance @ np.swapaxes(back, 1, 2))
    number = np.arange(len(kept))
    return RelativePoseEdges(
        number[:-1], number[1:], np.column_stack([offset, wrap(end[:, 2] - start[:, 2])]),
        (information + np.swapaxes(information, 1, 2)) / 2,
    )  # fmt: skip
