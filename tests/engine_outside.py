"""What the engine must give in C++ and in WebAssembly."""

from __future__ import annotations

from typing import Any

import numpy as np

from graphslam import Graph, Log, Solution, solve
from graphslam.online.replay import replay
from graphslam.se2 import wrap


def solution(log: Log) -> Solution:
    """The solution of the graph that the engine makes of a log."""
    graph = Graph.from_log(log, edges="virtual+motion", weight="marginal", frame="body", kernel="none")
    return solve(graph, initialize="dead-reckoning")


def online(log: Log) -> tuple[np.ndarray, dict[int, np.ndarray]]:
    """The newest pose of the online solver after each step, and the landmarks in the end."""
    poses = []
    for solver in replay(Graph.from_log(log, edges="landmark+motion", kernel="none", motion_weight=1.0)):
        poses.append(solver.pose)
    return np.array(poses), solver.landmarks


def assert_same_poses(found: Any, expected: np.ndarray) -> None:
    """Poses (N, 3) differ by at most 1e-9 m and rad."""
    poses = np.array(found, dtype=float)
    np.testing.assert_allclose(poses[:, :2], expected[:, :2], atol=1e-9)
    np.testing.assert_allclose(wrap(poses[:, 2] - expected[:, 2]), 0.0, atol=1e-9)
