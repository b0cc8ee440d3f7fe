"""Several drives of one place as one log: their common landmarks tie them, and each keeps its own odometry.

Between the end of a drive and the start of the next, the robot may have gone anywhere. The log has a control there that
says nothing, with the variances `ANYWHERE`, so that all solvers, filters and checks take it like any other log. The start
values matter: each drive is put where its first sightings fit the map of those before (`first_fix`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from .errors import GraphError, LogError, OptionError
from .graph import Graph
from .localization import first_fix
from .log import Log
from .measurements import AbsolutePositions, PoseRelations
from .models import additional_variances
from .se2 import Array, between, compose
from .solvers.solve import solve

#: the variances of speed, turn rate and sideways speed of the control between two drives, which takes a second: a kilometre,
#: and several turns, in any direction
ANYWHERE = (1e6, 1e3, 1e6)


@dataclass(frozen=True, eq=False)
class Sessions:
    """Drives that were joined.

    Attributes:
        log: all of them, in the frame of the first.
        starts: the step at which each drive starts, and after them the number of poses.
    """

    log: Log
    starts: tuple[int, ...]

    def split(self, rows: Array) -> list[Array]:
        """Rows (T+1, ...) that belong to the poses, one array for each drive."""
        return np.split(np.asarray(rows), self.starts[1:-1])


def join_logs(logs: Sequence[Log]) -> Sessions:
    """One log of several drives in one place; ``Graph.from_log(join_logs(logs).log)`` solves them together.

    Args:
        logs: with controls, and ids that mean the same landmarks in all of them. Noise models must be the same in all, or
            be given to `Graph.from_log`. Ground truth is kept where all have it; it is in one frame.

    Raises:
        OptionError: there is no log, or something else than logs.
        LogError: a log has no controls, or logs differ in their noise models, their sightings, or the point of their truth.
        GraphError: a log shares no landmarks with those before, or its first sightings fit no place among them.
    """
    if isinstance(logs, Log) or not isinstance(logs, Sequence) or not all(isinstance(each, Log) for each in logs):
        raise OptionError("join_logs takes a list of logs: join_logs([first, second])")
    if not logs:
        raise OptionError("join_logs needs at least one log")
    for each in logs:
        _check(each, logs[0])
    joined, starts = logs[0], [0]
    for each in logs[1:]:
        starts.append(joined.num_poses)
        joined = _joined(joined, _placed(each, joined))
    return Sessions(joined, (*starts, joined.num_poses))


def _check(log: Log, first: Log) -> None:
    """Raise `LogError` where a log cannot be joined to the first one."""
    if log.controls is None:
        raise LogError(f"{log.name} has no controls, and drives are joined by their odometry and their landmarks")
    if log.sightings.shape[1] != first.sightings.shape[1]:
        raise LogError(
            f"{log.name} has sightings of {log.sightings.shape[1]} numbers and {first.name} of {first.sightings.shape[1]}; "
            "use Log.without_orientation of the one with psi"
        )
    for name in ("motion", "sensor", "truth_offset"):
        if getattr(log, name) != getattr(first, name):
            raise LogError(
                f"{log.name} and {first.name} differ in {name}: {getattr(log, name)} and {getattr(first, name)}. One graph "
                f"has one; make them the same with Log.replace({name}=...)"
            )


def _placed(log: Log, before: Log) -> Log:
    """The log with its initial poses in the frame of those before, by the map that these give."""
    if not set(log.landmark_ids.tolist()) & set(before.landmark_ids.tolist()):
        raise GraphError(f"{log.name} and {before.name} share no landmark: do the ids mean the same ones in both?")
    solution = solve(Graph.from_log(before, edges="landmark+motion"))
    fix = first_fix(log, solution.map)
    start = log.initial_poses[0]
    initial = compose(fix.pose, between(start, log.initial_poses))
    # without jumps of a full turn
    initial[:, 2] = fix.pose[2] + log.initial_poses[:, 2] - start[2]
    return log.replace(initial_poses=initial, notes=(*log.notes, f"{log.name} joined: {fix.sentence}"))


def _joined(first: Log, second: Log) -> Log:
    """Two logs as one, the second already in the frame of the first."""
    a, b = first, second
    assert a.controls is not None and b.controls is not None and a.dt is not None and b.dt is not None
    poses, pieces = a.num_poses, len(a.controls) + 1
    of_first, of_second = (additional_variances(each.control_variances, len(each.controls)) for each in (a, b))  # type: ignore[arg-type]

    def both(name: str) -> Array | None:
        one, other = getattr(a, name), getattr(b, name)
        return None if one is None or other is None else np.concatenate([one, other])

    recorded = [each.dt if each.recorded_dt is None else each.recorded_dt for each in (a, b)]
    truth = both("true_poses")
    return a.replace(
        dt=np.concatenate([a.dt, [1.0], b.dt]),
        controls=np.concatenate([a.controls, np.zeros((1, 2)), b.controls]),
        control_starts=np.concatenate([a.control_starts, pieces + b.control_starts]),
        control_variances=np.concatenate([of_first, [ANYWHERE], of_second]),
        recorded_dt=np.concatenate([recorded[0], [1.0], recorded[1]]),
        steps=np.concatenate([a.steps, poses + b.steps]),
        landmarks=both("landmarks"),
        sightings=both("sightings"),
        classes=both("classes"),
        initial_poses=both("initial_poses"),
        true_poses=truth,
        true_path=None if truth is None else both("true_path"),
        true_landmarks=None if truth is None else {**(b.true_landmarks or {}), **(a.true_landmarks or {})} or None,
        relations=_shifted(a.relations, b.relations, poses),
        positions=_shifted(a.positions, b.positions, poses),
        notes=(*a.notes, *b.notes),
        doubts=(*a.doubts, *b.doubts),
        name=f"{a.name} and {b.name}",
    )  # fmt: skip


Records = PoseRelations | AbsolutePositions


def _shifted(first: Records | None, second: Records | None, poses: int) -> Records | None:
    """The measurements of two logs, the steps of the second counted from ``poses`` on."""
    if second is None:
        return first
    later = second.moved({end: getattr(second, end) + poses for end in second.ENDS})
    if first is None:
        return later
    rows = {f.name: np.concatenate([getattr(first, f.name), getattr(later, f.name)]) for f in fields(later)}
    return replace(later, **rows)  # type: ignore[arg-type]
