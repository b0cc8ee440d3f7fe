"""The messages of a topic of a bag: as columns of numbers, and topics of poses as relations and absolute positions.

Messages are collected while the bag is streamed. `Frames` are the rigid motions of /tf_static and /tf. Topics of poses are
PoseWithCovarianceStamped, Odometry, PoseStamped and NavSatFix.

**Absolute positions.** Each message is one. Latitude and longitude become metres as those of tables do (`log.geometry`).

**Relations.** Poses of a second odometry at least `APART` seconds apart become relations from each to the next one, z =
x_k^-1 x_{k+1}. Where the covariances P_k of the poses grow as those of dead reckoning do, that of a relation is what they
grow by, J Q J' = P_{k+1} - F P_k F'. Otherwise those of the speeds count, Q = V dt² for each message. Relations across a
pause longer than `GAP`, or across a jump, are left out. A message whose frame is "base_link@T" is a relation from the
pose at the time T itself; `slam-compare run --mcap` writes such.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any

import numpy as np

from ..errors import FormatError, quoted
from ..log.measurements import cut_headings, not_positive, symmetric
from ..log.table import COVARIANCES, Columns
from ..se2 import Array, between, compose, lever_matrix, perpendicular, turned_by
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
    source: str = "TF"

    def add(self, transforms: Iterable[Any], *, static: bool) -> None:
        """Take over the transforms of a tf2_msgs/TFMessage; of frames that move, the first place stays."""
        for each in transforms:
            child, parent = clean(each.child_frame_id), clean(each.header.frame_id)
            at, turn = each.transform.translation, each.transform.rotation
            position, rotation = np.array([at.x, at.y, at.z]), np.array([turn.x, turn.y, turn.z, turn.w])
            if (known := self.parents.get(child)) is None or static:
                self.parents[child] = (parent, position, rotation)
            elif known[0] != parent or np.abs(known[1] - position).max() > _STILL or not _same(known[2], rotation):
                self.moving.add(child)

    def between(self, base: str, sensor: str) -> tuple[Array, Array] | None:
        """Position (3,) and rotation (3, 3) of a sensor's frame in that of a base; None where they are not connected.

        Frames on the way that move do not count as connected.

        Raises:
            FormatError: a frame on the way is its own parent, or the parent of one of its parents.
        """
        (root, origin, turn), (other, position, rotation) = self._from_root(base), self._from_root(sensor)
        return (turn.T @ (position - origin), turn.T @ rotation) if root == other else None

    def _from_root(self, frame: str) -> tuple[str, Array, Array]:
        """The farthest frame that a frame is fixed to, parent after parent; its position (3,) and rotation (3, 3) there."""
        position, turn, passed = np.zeros(3), np.eye(3), list[str]()
        while frame in self.parents.keys() - self.moving:
            if frame in passed:
                circle = ", ".join(map(quoted, [*passed[passed.index(frame) :], frame]))
                advice = "each frame has one parent, so that one of these transforms is wrong: leave it out of the bag"
                raise FormatError(self.source, None, f"the parents of frames in TF form a circle: {circle}; {advice}")
            passed.append(frame)
            frame, at, quaternion = self.parents[frame]
            step = rotation_of(quaternion)
            position, turn = at + step @ position, step @ turn
        return frame, position, turn


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
        return np.array(self._values).reshape(-1, len(every))[:, [every.index(name) for name in names]]

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


#: the types of poses that are read
_ODOMETRY, _STAMPED = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"
POSES = ("geometry_msgs/msg/PoseWithCovarianceStamped", _ODOMETRY, _STAMPED)
_FIX = "sensor_msgs/msg/NavSatFix"
#: the time between the poses of relations, the longest pause that one may span [s], and how many times faster than nearly all
#: others a jump is
APART, GAP, JUMP = 1.0, 2.0, 5.0
#: the standard deviation of a fix whose covariance is not known [m]: that of a receiver without corrections, in the open
FIX = 5.0
#: variances from here on mean that something was not measured [m², rad²]
UNKNOWN = 1e4
_UPPER = ((0, 0), (0, 1), (0, 5), (1, 1), (1, 5), (5, 5))


class Poses(Collector):
    """Collects the messages of a topic of poses, or of fixes.

    Args:
        source: bag and topic, for messages.
        kind: relations or positions.
        type: of the messages.

    Raises:
        FormatError: the type gives no poses.
    """

    def __init__(self, source: str, kind: str, type: str) -> None:
        fits = [*POSES, _FIX] if kind == "positions" else list(POSES)
        if type not in fits:
            known = ", ".join(each.partition("/msg/")[2] for each in fits)
            raise FormatError(source, None, f"its messages, {type}, give no {kind}; {known} do")
        plan = Plan("", {}, (), stamp="message", child="child_frame_id" if type == _ODOMETRY else "")
        super().__init__(source, plan, numbers={_FIX: _of_fix, _STAMPED: _of_stamped}.get(type, _of_pose))
        self.type = type
        self._from = array("q")

    def add(self, time: int, message: Any) -> None:
        """Take over a message that was recorded at a time [ns]."""
        super().add(time, message)
        self._from.append(_time_of(message.header.frame_id))

    def _rows_of_numbers(self) -> Array:
        return np.array(self._values).reshape(len(self), -1)

    def poses(self) -> tuple[Array, Array, Array]:
        """Poses (N, 3), headings NaN where the quaternion is none, and covariances (N, 3, 3) of poses and of speeds."""
        rows = self._rows_of_numbers()
        turns, known = rows[:, 2:6], np.linalg.norm(rows[:, 2:6], axis=1) > 0.5
        headings = np.full(len(rows), np.nan)
        R = rotation_of(turns[known])
        headings[known] = np.unwrap(np.arctan2(R[:, 1, 0], R[:, 0, 0]))
        return np.column_stack([rows[:, :2], headings]), symmetric(rows[:, 6:12]), symmetric(rows[:, 12:18])

    def fixes(self) -> tuple[Array, Array, np.ndarray]:
        """Latitude, longitude [degrees], altitude [m] (N, 3), covariances (N, 2, 2), and their types (N,), -1 for no fix."""
        rows = self._rows_of_numbers()
        return rows[:, :3], rows[:, [3, 4, 4, 5]].reshape(-1, 2, 2), rows[:, 6].astype(int)

    @property
    def explicit(self) -> np.ndarray:
        """The times [ns] (N,) of the poses that relations are measured from; -1 where the message has no such time."""
        return np.array(self._from, dtype=np.int64)


def _of_fix(message: Any) -> tuple[float, ...]:
    """Latitude, longitude, altitude, the covariance of both axes, and its type, -1 for no fix."""
    C = message.position_covariance
    known = message.position_covariance_type if message.status.status >= 0 else -1
    return message.latitude, message.longitude, message.altitude, C[0], C[1], C[4], known


def _of_pose(message: Any) -> tuple[float, ...]:
    """Place and quaternion, and the covariances of pose and speeds; zeros where there are none."""
    C, speeds = message.pose.covariance, message.twist.covariance if hasattr(message, "twist") else 36 * (0.0,)
    return *_place(message.pose.pose), *(each[6 * i + j] for each in (C, speeds) for i, j in _UPPER)


def _of_stamped(message: Any) -> tuple[float, ...]:
    """The same of a pose without covariances."""
    return *_place(message.pose), *(2 * len(_UPPER) * (0.0,))


def _place(pose: Any) -> tuple[float, ...]:
    at, q = pose.position, pose.orientation
    return at.x, at.y, q.x, q.y, q.z, q.w


def _time_of(frame: str) -> int:
    """The time T [ns] of a frame "base_link@T", -1 for others."""
    _, at, time = frame.partition("@")
    return int(time) if at and time.isdigit() else -1


def positions_table(
    found: Poses, frames: Frames, base: str, std: Sequence[float] | None = None, lever: Sequence[float] | None = None
) -> tuple[Columns, list[str]]:
    """The table of absolute positions, and notes.

    Args:
        base: the frame of the robot; where TF leads from there to the frame of a receiver, that is the lever.
        std: standard deviations that the user states, of x and y [m] and of the heading [rad].
        lever: the point of the robot that is measured, as the user states it [m].

    Raises:
        FormatError: no message has a position, or no covariance and none is stated.
    """
    notes: list[str] = []
    names = ("latitude", "longitude", "altitude") if found.type == _FIX else ("x", "y")
    if found.type == _FIX:
        places, C, kept, notes = _fixes(found, std)
        if lever is None and (mounted := frames.between(base, found.frame)) is not None:
            lever = mounted[0][:2].tolist()
    else:
        places, C, _ = found.poses()
        kept = np.asarray(np.isfinite(places[:, :2]).all(axis=1))
        if std is not None:
            C = np.tile(np.diag([std[0], std[0], std[1] if len(std) > 1 else np.inf]) ** 2, (len(C), 1, 1))
        blind = ~(C[:, 2, 2] > 0) | ~(C[:, 2, 2] < UNKNOWN)
        places[blind, 2] = np.nan
        cut_headings(C, blind)
        silent = not_positive(C) | (C[:, 0, 0] >= UNKNOWN)
        if silent[kept].all():
            raise FormatError(found.source, None, f"{_no_noise(C)}, [positions] std = [0.05] in the recipe")
        if silent.any():
            count = f"{np.sum(silent & kept):,} of {len(kept):,}"
            notes.append(f"{count} messages of {found.source} have no covariance: left out")
        kept &= ~silent
        unknown = np.isnan(places[:, 2])
        C[unknown, 2] = C[unknown, :, 2] = np.nan
    if not kept.any():
        raise FormatError(found.source, None, "none of its messages has a position")
    columns: dict[str, Any] = {"t": found.times, **dict(zip(names, places.T))}
    if C.shape[1] == 3 and np.isfinite(places[kept, 2]).any():
        columns |= {"theta": places[:, 2]} | _entries(C)
    else:
        columns |= {"cov_xx": C[:, 0, 0], "cov_xy": C[:, 0, 1], "cov_yy": C[:, 1, 1]}
    if lever is not None:
        columns |= {"lever_x": np.full(len(kept), lever[0]), "lever_y": np.full(len(kept), lever[1])}
    return Columns(found.source, {name: values[kept] for name, values in columns.items()}, rows="message"), notes


def _fixes(found: Poses, std: Sequence[float] | None) -> tuple[Array, Array, np.ndarray, list[str]]:
    """Latitude, longitude and altitude (N, 3) of fixes, their covariances, which of them are fixes, and notes."""
    fixes, C, known = found.fixes()
    good = (known >= 0) & np.isfinite(fixes[:, :2]).all(axis=1) & (np.abs(fixes[:, 0]) <= 90)
    notes = []
    if not good.any():
        raise FormatError(found.source, None, f"none of its {len(good)} messages has a fix")
    if not good.all():
        notes.append(f"{np.sum(~good):,} of {len(good):,} messages of {found.source} have no fix: left out")
    vague = good & ((known == 0) | not_positive(C))
    if std is not None:
        C = np.tile(std[0] ** 2 * np.eye(2), (len(good), 1, 1))
    elif vague.any():
        C[vague] = FIX**2 * np.eye(2)
        which = f"{np.sum(vague):,} of {np.sum(good):,} fixes of {found.source} have no covariance"
        assumed = f"a standard deviation of {FIX:g} m is assumed; [positions] std = [METRES] in the recipe states it"
        notes.append(f"{which}: {assumed}")
    C[~good] = np.eye(2)
    return fixes, C, good, notes


def _no_noise(C: Array) -> str:
    which = "are zero" if not np.any(C[:, 0, 0]) else "are no covariances"
    return f"the covariances of its messages {which}, which says nothing of their noise; state the standard deviations"


def relations_table(
    found: Poses, frames: Frames, base: str, std: Sequence[float] | None = None
) -> tuple[Columns, list[str]]:
    """The table of relations, and notes.

    Args:
        base: the frame of the robot; where the poses are of another frame that is fixed to it, those of the robot are taken.
        std: standard deviations of a relation that the user states, of x and y [m] and of the heading [rad].

    Raises:
        FormatError: there are no two poses, or no covariances and none are stated.
    """
    times, explicit = found.times, found.explicit
    x, P, V = found.poses()
    notes: list[str] = []
    if not np.isfinite(x).all():
        message = "its poses have no orientation; a relation needs the heading of both poses"
        raise FormatError(found.source, None, message)
    if np.any(explicit >= 0):
        kept = explicit >= 0
        return _relations(found, explicit[kept], times[kept], x[kept], P[kept]), notes
    order = np.argsort(times, kind="stable")
    times, x, P, V = times[order], x[order], P[order], V[order]
    if found.child not in ("", base) and (mounted := frames.between(base, found.child)) is not None:
        turn = float(np.arctan2(mounted[1][1, 0], mounted[1][0, 0]))
        x = compose(x, between(np.array([*mounted[0][:2], turn]), np.zeros(3)))
    elif found.child not in ("", base):
        which = f"the poses of {found.source} are of {found.child}"
        notes.append(f"{which}, and no fixed transform leads there from {base}: taken as the robot's")
    if len(times) < 2:
        raise FormatError(found.source, None, "it has one pose, and a relation takes two")
    seconds = (times - times[0]) / 1e9
    rows = [0]
    for k, t in enumerate(seconds.tolist()):
        if t - seconds[rows[-1]] >= APART:
            rows.append(k)
    first, second = np.array(rows[:-1], dtype=int), np.array(rows[1:], dtype=int)
    spent = np.diff(seconds)
    way = np.hypot(*np.diff(x[:, :2], axis=0).T)
    speed = way / np.maximum(spent, 1e-9)
    bad = (spent > GAP) | ((speed > JUMP * np.quantile(speed, 0.95)) & (way > 0.1))
    spans = np.add.reduceat(bad, first) > 0 if len(first) else np.zeros(0, dtype=bool)
    if spans.any():
        causes = f"{np.sum(spent > GAP)} pauses and {np.sum(bad & (spent <= GAP))} jumps"
        notes.append(f"{found.source}: {spans.sum()} relations are left out because of {causes}")
    first, second = first[~spans], second[~spans]
    if not len(first):
        message = f"no two of its poses are {APART:g} s apart without a pause or a jump between them"
        raise FormatError(found.source, None, message)
    motions = between(x[first], x[second])
    if std is not None:
        C = np.tile(np.diag([std[0], std[0], std[1] if len(std) > 1 else std[0]]) ** 2, (len(first), 1, 1))
    else:
        C, how = _growth(x, P, V, spent, first, second)
        if not how:
            message = f"{_no_noise(P)} of a relation, [relations] std = [METRES, RADIANS] in the recipe"
            raise FormatError(found.source, None, message)
        notes.append(f"the noise of the relations of {found.source} is {how}")
    return _relations(found, times[first], times[second], motions, C), notes


def _growth(x: Array, P: Array, V: Array, spent: Array, first: np.ndarray, second: np.ndarray) -> tuple[Array, str]:
    """The covariances of motions in the axes of the first pose, by the growth of those of the poses or by those of speeds.

    And which of both; empty where neither are covariances.
    """
    a, b = x[first], x[second]
    F = lever_matrix(perpendicular(b[:, :2] - a[:, :2]))
    grown = turned_by(P[second] - F @ P[first] @ np.swapaxes(F, 1, 2), -a[:, 2])
    if not not_positive(grown).any():
        return grown, "what the covariances of its poses grow by"
    each = V[1:] * spent[:, None, None] ** 2
    total = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(each, axis=0)])
    driven = total[second] - total[first]
    # some programs leave out the speed sideways
    driven[:, 1, 1] = np.where(driven[:, 1, 1] > 0, driven[:, 1, 1], driven[:, 0, 0])
    known = not not_positive(driven).any() and (V[:, 0, 0] < UNKNOWN).all()
    return driven, "that of its speeds" if known else ""


def _relations(found: Poses, begin: np.ndarray, end: np.ndarray, motions: Array, C: Array) -> Columns:
    columns = {"t1": begin, "t2": end, **dict(zip(("dx", "dy", "dtheta"), motions.T)), **_entries(C)}
    return Columns(found.source, columns, rows="relation")


def _entries(C: Array) -> dict[str, Array]:
    """The columns of covariances (N, 3, 3)."""
    return {name: C[:, i, j] for name, i, j in zip(COVARIANCES, *np.triu_indices(3))}
