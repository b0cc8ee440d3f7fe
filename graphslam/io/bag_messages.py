"""The messages of a topic as columns of numbers, and rigid motions between frames.

Messages are collected while the bag is streamed. The motions are those of /tf_static and /tf.
"""

from __future__ import annotations

import re
from array import array
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any

import numpy as np

from ..se2 import Array
from .bag_topics import Plan, getter

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


_NAN = float("nan")
#: a function that returns the numbers of a row
Numbers = Callable[[Any], tuple[float, ...]]


class Collector:
    """Collects the rows of one topic; `add` takes its messages.

    Args:
        source: bag and topic, for messages.
        plan: which fields become which columns.
        parent, child: of TF, the frames whose transforms are taken; child may be a pattern with *.
        numbers: the numbers of a row; default: those of the plan's columns.

    Attributes:
        source, plan: as given.
        frame, child: names of the frames of the first row; empty where the messages have none.
        unstamped: the number of rows that have the time of their recording, because their stamp is 0 or absent.
    """

    def __init__(
        self, source: str, plan: Plan, *, parent: str = "", child: str = "", numbers: Numbers | None = None
    ) -> None:
        self.source, self.plan, self.unstamped = source, plan, 0
        self.frame = self.child = ""
        self._times = array("q")
        self._values = array("d")
        self._ids: list[Any] = []
        self._looks: list[Any] = []
        self._parent, self._child = clean(parent), re.compile(re.escape(clean(child)).replace(r"\*", ".*") or ".*")
        self._rows = attrgetter(plan.row) if plan.row else None
        self._get = numbers or _values(list(plan.columns.values()))
        self._id = getter(plan.id) if plan.id else None
        self._look = getter(plan.look) if plan.look else None
        self._of_child = attrgetter(plan.child) if plan.child else None
        self._only = bool(parent or child)

    def __len__(self) -> int:
        """The number of rows."""
        return len(self._times)

    def add(self, time: int, message: Any) -> None:
        """Take over the rows of a message that was recorded at a time [ns]."""
        for row in self._rows(message) if self._rows else (message,):
            if self.plan.action and row.action != 0:
                continue
            frame, child, stamp = "", self._of_child(row) if self._of_child else "", 0
            if self.plan.stamp:
                header = (row if self.plan.stamp == "row" else message).header
                frame, stamp = header.frame_id, _nanoseconds(header)
                if stamp == 0 and self.plan.stamp == "row" and self._rows and hasattr(message, "header"):
                    stamp = _nanoseconds(message.header)
            if self._only and not (self._child.fullmatch(clean(child)) and self._parent in ("", clean(frame))):
                continue
            values = self._get(row)
            if not self._times:
                self.frame, self.child = clean(frame), clean(child)
            self.unstamped += stamp == 0
            self._times.append(stamp or time)
            self._values.extend(values)
            if self._id:
                self._ids.append(self._id(row))
            if self._look:
                self._looks.append(self._look(row))

    @property
    def times(self) -> np.ndarray:
        """The time of each row (N,) [ns]."""
        return np.array(self._times, dtype=np.int64)

    def columns(self, names: list[str]) -> Array:
        """Columns (N, k) by name."""
        every = list(self.plan.columns)
        values = np.array(self._values).reshape(-1, len(every))
        return values[:, [every.index(name) for name in names]]

    def ids(self) -> np.ndarray | None:
        """The ids (N,) as numbers or text; None where there are none."""
        return _words(self._ids)

    def classes(self) -> np.ndarray | None:
        """The classes (N,) as numbers or text; None where there are none."""
        return _words(self._looks)


def _nanoseconds(header: Any) -> int:
    return int(header.stamp.sec * 1_000_000_000 + header.stamp.nanosec)


def _words(values: list[Any]) -> np.ndarray | None:
    if all(isinstance(each, (int, np.integer)) for each in values):
        return np.array(values, dtype=np.int64) if values else None
    words = np.array(["" if each is None else str(each) for each in values])
    return words if np.any(words != "") else None


def _values(paths: list[str]) -> Numbers:
    """A function that returns the numbers at some paths of a row; NaN where a list in the path is empty."""
    if not any("[]" in path for path in paths):
        # twice the first path, so that the value is a tuple for one path, too
        fields: Callable[[Any], Any] = attrgetter(*paths, paths[0])
        return lambda row: fields(row)[:-1]
    getters = [getter(path) for path in paths]
    return lambda row: tuple(_NAN if (value := get(row)) is None else value for get in getters)
