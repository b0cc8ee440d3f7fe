"""Pose graphs whose global minimum is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graphslam import Graph
from graphslam.edges import ConstantEdges, EdgeFamily, Linearization, RelativePoseEdges
from graphslam.se2 import between, wrap


def pose_graph(poses, pairs, information, *, noise=0.0, rng=None, fixed=(0,)):
    """A graph of relative poses between the true poses (n, 3), with noise."""
    first, second = np.array(pairs).T
    measured = between(poses[first], poses[second])
    if noise:
        measured = measured + noise * rng.standard_normal(measured.shape)
    edges = RelativePoseEdges(first, second, measured, np.broadcast_to(information, (len(first), 3, 3)).copy())
    return Graph(
        poses, families=(edges,), steps=np.arange(len(poses)), trajectory=poses, pose_ids=np.arange(len(poses)),
        fixed=np.array(fixed, dtype=int),
    )  # fmt: skip


def ring(n, windings=1):
    """A ring of n poses whose headings turn by one turn; the winding number of a wrong minimum differs."""
    pairs = [(k, (k + 1) % n) for k in range(n)]
    measured = np.tile([1.0, 0.0, 2 * np.pi / n], (n, 1))
    edges = RelativePoseEdges(*np.array(pairs).T, measured, np.tile(np.diag([1.0, 1.0, 10.0]), (n, 1, 1)))
    heading = windings * 2 * np.pi * np.arange(n) / n
    step = np.column_stack([np.cos(heading), np.sin(heading)])
    poses = np.column_stack([np.cumsum(step, axis=0) - step, wrap(heading)])
    return Graph(
        poses,
        families=(edges,),
        steps=np.arange(n),
        trajectory=poses,
        pose_ids=np.arange(n),
        fixed=np.zeros(1, dtype=int),
    )


@dataclass(frozen=True, eq=False)
class GivenEdges(EdgeFamily):
    """A family of which only the constant form is known."""

    edges: ConstantEdges

    @property
    def count(self) -> int:
        return len(self.edges.first)

    def cliques(self) -> tuple[np.ndarray, np.ndarray]:
        raise NotImplementedError

    def linearize(self, state: np.ndarray, reference: np.ndarray) -> Linearization:
        raise NotImplementedError

    def constant(self, _: np.ndarray) -> ConstantEdges:
        return self.edges
