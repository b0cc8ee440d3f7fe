"""Sightings and landmarks as places in the robot's axes, with derivatives: the Cartesian residual of `edges.observation`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..log import Log
from ..models import SensorModel
from ..se2 import Array, wrap


@dataclass(frozen=True, eq=False)
class Places:
    """The place (M, d) of each sighting in the robot's axes, (x, y) or (x, y, heading), and its covariance (M, d, d)."""

    means: Array
    covariances: Array

    @classmethod
    def of(cls, log: Log, sensor: SensorModel) -> Places:
        """The places of the sightings of a log."""
        return cls(*sensor.places(log.sightings))


def seen_from(pose: Array, landmarks: Array) -> tuple[Array, Array, Array]:
    """Landmarks (n, d) in the axes of poses (3,) or (n, 3), and the derivatives by pose (n, d, 3) and landmark (n, d, d)."""
    n, d = landmarks.shape
    pose = np.broadcast_to(pose, (n, 3))
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    delta = landmarks[:, :2] - pose[:, :2]
    h = np.empty((n, d))
    h[:, 0], h[:, 1] = c * delta[:, 0] + s * delta[:, 1], c * delta[:, 1] - s * delta[:, 0]
    by_pose, by_landmark = np.zeros((n, d, 3)), np.zeros((n, d, d))
    by_landmark[:, 0, 0] = by_landmark[:, 1, 1] = c
    by_landmark[:, 0, 1], by_landmark[:, 1, 0] = s, -s
    by_pose[:, :2, :2] = -by_landmark[:, :2, :2]
    by_pose[:, 0, 2], by_pose[:, 1, 2] = h[:, 1], -h[:, 0]
    if d == 3:
        h[:, 2] = wrap(landmarks[:, 2] - pose[:, 2])
        by_pose[:, 2, 2], by_landmark[:, 2, 2] = -1.0, 1.0
    return h, by_pose, by_landmark


def differences(a: Array, b: Array) -> Array:
    """a - b (..., d), headings wrapped."""
    difference = a - b
    if difference.shape[-1] == 3:
        difference[..., 2] = wrap(difference[..., 2])
    return difference
