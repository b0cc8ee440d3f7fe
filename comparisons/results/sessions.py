"""Several logs of one place that were solved together: the errors of each log, and its rows of trajectories."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from graphslam import Log
from graphslam.log.measurements import Session
from graphslam.metrics import METRICS, Errors, Metrics, evaluate
from graphslam.se2 import Array

from .documents import Count

if TYPE_CHECKING:
    from ..comparison import Comparison


@dataclass(frozen=True, kw_only=True)
class SessionErrors(Errors):
    """The errors of an estimator in one of several logs, aligned alone; None where the ground truth is not known.

    Attributes:
        together_m: the ATE of its poses after the common alignment of all logs [m].
        alone_m: the ATE where the estimator has this log only [m]; of the graph solvers.
        poses_counted: number of poses that the metrics are of.
    """

    session: Session = field(repr=False)
    estimator: str = field(repr=False)
    together_m: float | None
    alone_m: float | None
    poses_counted: Count | None


@dataclass(frozen=True, kw_only=True)
class SolvedSession(Session):
    """One of several logs of a place that were solved as one.

    Attributes:
        file: file or folder it was read from.
        name: of the log.
        start: its first step among those of all logs.
        start_time: the time of that by its own clock [s].
        clock_offset, clock_deviation: what is added to its times so that they are those of the first robot, and the standard
            error [s]; null where that was not estimated.
        poses, sightings: their numbers.
        landmarks: number of landmarks it has seen.
        shared: number of these that another log has seen, too.
        estimators: the errors of every estimator, by name.
    """

    file: Path | None
    poses: Count
    sightings: Count
    landmarks: Count
    shared: Count
    estimators: Mapping[str, SessionErrors]


def errors_of_sessions(comparison: Comparison) -> Iterator[SessionErrors]:
    """The errors of every estimator in each log of a joined one, log by log."""
    log = comparison.log
    truth = np.full((log.num_poses, 3), np.nan) if log.true_poses is None else log.true_poses
    estimates = {r.name: log.at_truth(r.poses) for r in comparison.results}
    off = comparison.position_errors
    for k, (session, drive) in enumerate(zip(log.sessions, log.drives)):
        for r in comparison.results:
            here, together, apart = Metrics(), None, comparison.alone.get(r.name, (None,) * len(log.sessions))[k]
            alone = None
            if log.covered[drive].any():
                here = evaluate(truth[drive], None, estimates[r.name][drive], {}, mask=r.estimated[drive])
                if apart is not None:
                    placed = log.at_truth(np.concatenate([r.poses[: drive.start], apart.poses, r.poses[drive.stop :]]))
                    alone = evaluate(truth[drive], None, placed[drive], {}, mask=apart.estimated).ate_m
            if r.name in off and np.isfinite(off[r.name][drive]).any():
                together = float(np.sqrt(np.nanmean(off[r.name][drive] ** 2)))
            errors = {name: getattr(here, name) for name in (*METRICS, "poses_counted")}
            yield SessionErrors(session=session, estimator=r.name, together_m=together, alone_m=alone, **errors)


def shared_landmarks(log: Log) -> list[tuple[int, int]]:
    """How many landmarks each of the joined logs has seen, and how many of them another one has seen, too."""
    drive = np.searchsorted([each.start for each in log.sessions], log.steps, side="right") - 1
    seen = np.unique(np.column_stack([drive, log.landmarks]), axis=0)
    _, place, count = np.unique(seen[:, 1], return_inverse=True, return_counts=True)
    counts = (np.bincount(each, minlength=len(log.sessions)) for each in (seen[:, 0], seen[count[place] > 1, 0]))
    return list(zip(*(each.tolist() for each in counts)))


def parted(rows: Array, ends: np.ndarray | list[int]) -> Array:
    """Rows (n, ...) with a row of NaN before each of ``ends``, where another log begins: lines break there."""
    return np.insert(rows, ends, np.nan, axis=0)


def solved_sessions(comparison: Comparison) -> list[SolvedSession] | None:
    """The logs and their errors; None where there is one log."""
    log = comparison.log
    if not log.sessions:
        return None
    errors: dict[Session, dict[str, SessionErrors]] = {each: {} for each in log.sessions}
    for each in errors_of_sessions(comparison):
        errors[each.session][each.estimator] = each
    source = comparison.source
    files = source if isinstance(source, tuple) else (source,) * len(log.sessions)
    solved = []
    for session, drive, file, (seen, shared) in zip(log.sessions, log.drives, files, shared_landmarks(log)):
        sightings = int(np.sum((log.steps >= drive.start) & (log.steps < drive.stop)))
        counts = {"poses": drive.stop - drive.start, "sightings": sightings, "landmarks": seen, "shared": shared}
        solved.append(SolvedSession(**vars(session), file=file, estimators=errors[session], **counts))
    return solved
