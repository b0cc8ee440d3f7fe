"""Rigid motions between frames, from /tf_static and /tf."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..se2 import Array

#: a frame that moves by more than this against its parent [m, or part of a quaternion] is not mounted on it
_STILL = 1e-3


def rotation_of(quaternions: Array) -> Array:
    """The rotation matrices (..., 3, 3) of quaternions (..., 4), x, y, z, w, of any length above zero."""
    quaternions = np.asarray(quaternions, dtype=float)
    squares = np.sum(quaternions**2, axis=-1)[..., None, None]
    x, y, z, w = np.moveaxis(quaternions, -1, 0)
    rows = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2) / squares


@dataclass
class Frames:
    """The frames of a bag: for each frame its parent, and where it is there."""

    parents: dict[str, tuple[str, Array, Array]] = field(default_factory=dict)
    moving: set[str] = field(default_factory=set)

    def add(self, transforms: Iterable[Any], *, static: bool) -> None:
        """Take over the transforms of a tf2_msgs/TFMessage; of frames that move, the first place stays."""
        for each in transforms:
            child, parent = clean(each.child_frame_id), clean(each.header.frame_id)
            at, turn = each.transform.translation, each.transform.rotation
            position, rotation = np.array([at.x, at.y, at.z]), np.array([turn.x, turn.y, turn.z, turn.w])
            known = self.parents.get(child)
            if known is None or static:
                self.parents[child] = (parent, position, rotation)
            elif known[0] != parent or np.abs(known[1] - position).max() > _STILL or not _same(known[2], rotation):
                self.moving.add(child)

    def between(self, base: str, sensor: str) -> tuple[Array, Array] | None:
        """Position (3,) and rotation (3, 3) of a sensor's frame in that of a base; None where they are not connected.

        Frames on the way that move do not count as connected.
        """
        if base == sensor:
            return np.zeros(3), np.eye(3)
        neighbours: dict[str, list[tuple[str, Array, Array]]] = {}
        for child, (parent, position, quaternion) in self.parents.items():
            if child not in self.moving:
                turn = rotation_of(quaternion)
                neighbours.setdefault(parent, []).append((child, position, turn))
                neighbours.setdefault(child, []).append((parent, -turn.T @ position, turn.T))
        reached: dict[str, tuple[Array, Array]] = {base: (np.zeros(3), np.eye(3))}
        queue = deque([base])
        while queue:
            frame = queue.popleft()
            origin, turn = reached[frame]
            for other, position, rotation in neighbours.get(frame, ()):
                if other not in reached:
                    reached[other] = (origin + turn @ position, turn @ rotation)
                    queue.append(other)
        return reached.get(sensor)


def clean(frame: str) -> str:
    """The name of a frame without the slash that ROS 1 put before it."""
    return frame.lstrip("/")


def _same(one: Array, other: Array) -> bool:
    """Whether two quaternions turn alike; q and -q do."""
    return bool(min(np.abs(one - other).max(), np.abs(one + other).max()) <= _STILL)
