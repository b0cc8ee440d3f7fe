"""What the engine must give in C++ and in WebAssembly."""

from __future__ import annotations

from typing import Any

import numpy as np

from graphslam import Graph, Log, Solution, solve
from graphslam.incremental.solver import OnlineSolver
from graphslam.se2 import wrap


def solution(log: Log) -> Solution:
    """The solution of the graph that the engine makes of a log."""
    graph = Graph.from_log(log, edges="virtual+motion", weight="marginal", frame="body", kernel="none")
    return solve(graph, initialize="dead-reckoning")


def online(log: Log) -> tuple[np.ndarray, dict[int, np.ndarray]]:
    """The newest pose of `OnlineSolver` after each step, and the landmarks in the end."""
    solver, poses = OnlineSolver(log.initial_poses[0]), []
    assert log.controls is not None and log.dt is not None
    for t in range(log.num_poses):
        seen = {"ids": log.landmarks[log.steps == t], "sightings": log.sightings[log.steps == t]}
        if t > 0:
            solver.step(log.controls[t - 1], log.dt[t - 1], **seen)
        elif len(seen["ids"]):
            solver.step(pose=0, **seen)
        poses.append(solver.pose)
    return np.array(poses), solver.landmarks


def assert_same_poses(found: Any, expected: np.ndarray) -> None:
    """Poses (N, 3) differ by at most 1e-9 m and rad."""
    poses = np.array(found, dtype=float)
    np.testing.assert_allclose(poses[:, :2], expected[:, :2], atol=1e-9)
    np.testing.assert_allclose(wrap(poses[:, 2] - expected[:, 2]), 0.0, atol=1e-9)
