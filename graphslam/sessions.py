"""Several drives of one place as one log: their common landmarks tie them, and each keeps its own odometry.

Between the end of a drive and the start of the next, the robot may have gone anywhere. The log has a control there that
says nothing, with the variances `ANYWHERE`, so that all solvers of graphs and all checks take it like any other log, and it
knows its `Log.sessions`. The start values matter: each drive is put where its first sightings fit the map of those before
(`first_fix`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from .errors import GraphError, LogError, OptionError
from .graph import Graph
from .identification.robot import known_robot
from .localization import first_fix
from .log import Log
from .log_arrays import Session
from .measurements import MEASURED, Measured
from .models import MotionModel, SensorModel, additional_variances
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
            be given to `Graph.from_log`. Their ground truth is in one frame, and unknown where a log has none.

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
    if len(logs) > 1:
        known = known_robot(logs[0])[0]
        models = {"motion": known.motion or MotionModel(), "sensor": known.sensor or SensorModel()}
    for each in logs[1:]:
        starts.append(joined.num_poses)
        joined = _joined(joined, _placed(each, joined, models))
    return Sessions(joined, (*starts, joined.num_poses))


def with_common_noise(logs: Sequence[Log]) -> list[Log]:
    """The logs with noise models that are the same in all, as one graph needs them.

    Variances are the means of those of the logs, of which the ones that bring no models count with the book's. Where the
    sensors sit in different places, sightings are given as from the mean of these.
    """
    motions, sensors = [each.motion or MotionModel() for each in logs], [each.sensor or SensorModel() for each in logs]
    if len(set(motions)) == len(set(sensors)) == 1:
        return list(logs)

    def squares(models: Sequence[MotionModel | SensorModel]) -> dict[str, float]:
        rows = [vars(each) for each in models]
        geometry = (*SensorModel.GEOMETRY, "epsilon")
        return {
            name: float(np.sqrt(np.mean([row[name] ** 2 for row in rows]))) for name in rows[0] if name not in geometry
        }

    motion = MotionModel(**squares(motions), epsilon=float(np.mean([each.epsilon for each in motions])))
    ahead, left = np.mean([each.offset for each in sensors], axis=0).tolist()
    sensor = SensorModel(
        **squares(sensors), offset=(ahead, left), min_range=min(each.min_range for each in sensors),
        max_range=max(each.max_range for each in sensors), field_of_view=max(each.field_of_view for each in sensors),
    )  # fmt: skip
    note = f"its noise models are the means of those of {len(logs)} logs"
    common = []
    for log, own in zip(logs, sensors):
        robot = np.zeros((len(log.sightings), 3))
        seen = log.sightings if own.offset == sensor.offset else sensor.h(robot, own.h_inverse(robot, log.sightings))
        common.append(log.replace(motion=motion, sensor=sensor, sightings=seen, notes=(*log.notes, note)))
    return common


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
                + (", or take graphslam.sessions.with_common_noise(logs)" if name != "truth_offset" else "")
            )
    if not log.identified:
        raise LogError(
            f"{log.name} has sightings without ids, and drives are joined by landmarks that are the same in all of them"
        )


def _placed(log: Log, before: Log, models: dict[str, Any]) -> Log:
    """The log with its initial poses in the frame of those before, by the map that these give."""
    if not set(log.landmark_ids.tolist()) & set(before.landmark_ids.tolist()):
        others = _listed([each.name for each in before.sessions] or [before.name])
        raise GraphError(f"{log.name} and {others} share no landmark: do the ids mean the same ones in all of them?")
    solution = solve(Graph.from_log(before, edges="landmark+motion", **models))
    fix = first_fix(log, solution.map, **models)
    start = log.initial_poses[0]
    initial = compose(fix.pose, between(start, log.initial_poses))
    # without jumps of a full turn
    initial[:, 2] = fix.pose[2] + log.initial_poses[:, 2] - start[2]
    return log.replace(initial_poses=initial, notes=(*log.notes, f"joined where {fix.sentence}"))


def _joined(first: Log, second: Log) -> Log:
    """Two logs as one, the second already in the frame of the first."""
    a, b = first, second
    assert a.controls is not None and b.controls is not None and a.dt is not None and b.dt is not None
    poses, pieces = a.num_poses, len(a.controls) + 1
    of_first, of_second = (additional_variances(each.control_variances, len(each.controls)) for each in (a, b))  # type: ignore[arg-type]

    def both(name: str) -> Array | None:
        one, other = getattr(a, name), getattr(b, name)
        return None if one is None or other is None else np.concatenate([one, other])

    def with_unknown(name: str, sizes: Sequence[int]) -> Array | None:
        """Rows of both, NaN for the one that has none."""
        rows = [getattr(each, name) for each in (a, b)]
        if all(each is None for each in rows):
            return None
        return np.concatenate([np.full((n, 3), np.nan) if each is None else each for each, n in zip(rows, sizes)])

    recorded = [each.dt if each.recorded_dt is None else each.recorded_dt for each in (a, b)]
    truth = with_unknown("true_poses", (poses, b.num_poses))
    known = [each for each in (a, b) if each.true_poses is not None]
    path = (
        with_unknown("true_path", (pieces, len(b.controls) + 1))
        if all(e.true_path is not None for e in known)
        else None
    )
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
        true_path=path,
        true_landmarks={**(b.true_landmarks or {}), **(a.true_landmarks or {})} or None,
        **{name: _shifted(getattr(a, name), getattr(b, name), poses) for name in MEASURED},
        notes=(*_of_each(a, a.notes), *_of_each(b, b.notes)),
        doubts=(*a.doubts, *b.doubts),
        sessions=(
            *(a.sessions or (Session(a.name, 0, a.start_time),)),
            *(
                replace(each, start=poses + each.start)
                for each in b.sessions or (Session(b.name, 0, b.start_time),)
            ),
        ),
        name=f"{a.sessions[0].name} and {len(a.sessions)} more" if a.sessions else f"{a.name} and {b.name}",
    )  # fmt: skip


def _listed(names: Sequence[str]) -> str:
    """Names in a sentence: A, B and C."""
    return " and ".join(part for part in (", ".join(names[:-1]), names[-1]) if part)


def _of_each(log: Log, remarks: Iterable[str]) -> Iterator[str]:
    """Remarks about a log, with its name; those about logs that were joined have it already."""
    yield from remarks if log.sessions else (f"{log.name}: {remark}" for remark in remarks)


def _shifted(first: Measured | None, second: Measured | None, poses: int) -> Measured | None:
    """The measurements of two logs, the steps of the second counted from ``poses`` on."""
    if second is None:
        return first
    later = second.moved({end: getattr(second, end) + poses for end in second.ENDS})
    if first is None:
        return later
    rows = {f.name: np.concatenate([getattr(first, f.name), getattr(later, f.name)]) for f in fields(later)}
    return replace(later, **rows)  # type: ignore[arg-type]
