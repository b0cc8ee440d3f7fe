"""Two logs of one place, and the graph of both together, put together by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from graphslam import Graph, Log, MotionModel, SensorModel, simulate
from graphslam.edges import AnchorEdges
from graphslam.se2 import between, compose


def sessions(noise: float = 1.0, *, orientation: bool = True) -> tuple[Log, Log]:
    """A log, and a second one in another frame, whose noise is this part of the book's; both see landmarks 0 to 5."""
    models = {
        "motion": MotionModel(nn=0.19 * noise, no=0.001 * noise, on=0.13 * noise, oo=0.2 * noise, epsilon=1e-4 * noise**2),
        "sensor": SensorModel(range_rate=0.14 * noise, bearing_std=0.05 * noise, orientation_std=0.05 * noise),
    }  # fmt: skip
    landmarks = (
        (-4.0, 2.0, 0.3),
        (2.0, -3.0, 1.0),
        (3.0, 3.0, -2.0),
        (0.0, 4.0, 0.0),
        (1.0, 1.0, 3.0),
        (-3.0, -1.0, 2.0),
    )
    same = {"landmarks": landmarks, "clean": True, "orientation": orientation, "max_range": 9.0, **models}
    first = simulate(steps=40, start=(0.0, -3.0, 0.0), seed=1, name="first", **same)
    second = simulate(steps=30, start=(-2.0, 0.0, 1.0), seed=2, name="second", **same)
    frame = np.array([10.0, 5.0, 2.0])
    return first, second.replace(initial_poses=compose(frame, between(second.initial_poses[0], second.initial_poses)))


def joint_graph(first: Log, second: Log, placed: Graph) -> Graph:
    """The graph of two logs that see the same landmarks: only the first log is anchored.

    ``placed`` is the graph of the second log in a map, whose initial values are in the frame of the first.
    """
    a, b = (Graph.from_log(log, edges="landmark+motion", kernel="none") for log in (first, second))
    P, Q = len(a.steps), len(b.steps)
    # nodes: poses of the first log, poses of the second one, landmarks of the first one, and others of the second one
    ids = placed.landmark_ids
    of_a = np.concatenate([np.arange(P), P + Q + np.searchsorted(ids, a.landmark_ids)])
    of_b = np.concatenate([P + np.arange(Q), P + Q + np.searchsorted(ids, b.landmark_ids)])
    families = [
        replace(f, nodes=number[f.nodes]) if isinstance(f, AnchorEdges)
        else replace(f, first=number[f.first], second=number[f.second])
        for graph, number in ((a, of_a), (b, of_b))
        for f in graph.families
        if graph is a or not isinstance(f, AnchorEdges)
    ]  # fmt: skip
    initial = np.concatenate([a.initial[:P], placed.initial])
    return replace(
        a, initial=initial, families=tuple(families), steps=np.arange(P + Q), trajectory=initial[: P + Q],
        pose_ids=np.arange(P + Q), log=None, landmark_ids=ids,
    )  # fmt: skip
