"""Trajectories, maps, and sightings with the ids that an estimator gave them, in files that other programs read.

Of several logs that were joined each has its trajectories in files of its own, with its own clock.

Trajectories are in the text format of the TUM RGB-D benchmark, one pose per line,

    timestamp x y z qx qy qz qw        [s, m, quaternion]; here z = qx = qy = 0, qz = sin(theta / 2), qw = cos(theta / 2)

An estimated trajectory has the poses of the log, and between them the ends of the recorded controls, at most ten a second
(`graphslam.log.continuous_time`). Maps are tables with commas. Reading a file gives exactly the same numbers.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from graphslam import GraphError, Log, control_path
from graphslam.graph.map_files import map_text
from graphslam.graph.transform import relative_graph
from graphslam.log import UNIDENTIFIED
from graphslam.log.continuous_time import ControlPath
from graphslam.se2 import Array, wrap

from .results import EstimatorResult, status_of

if TYPE_CHECKING:
    from ..comparison import Comparison

#: ends of controls between poses are written at most this often [s]
INTERVAL = 0.1

#: a graph with more edges than this is not listed one by one
MOST_EDGES = 200_000


def times_of(log: Log) -> Array:
    """The time of each pose [s], (T+1,); the number of its step where the log has no times."""
    return np.arange(log.num_poses, dtype=float) if log.times is None else log.times


def elapsed_of(log: Log) -> Array:
    """The time of each pose since the first one [s], (T+1,); the number of its step where the log has no times.

    It is exact where `times_of` is not: seconds since 1970 leave no room for nanoseconds in a floating-point number.
    """
    if log.dt is None:
        return np.arange(log.num_poses, dtype=float)
    return log.control_times[log.control_starts]


def time_axis(log: Log) -> str:
    """The label of an axis of `elapsed_of`."""
    return "step" if log.dt is None else "time since the first pose [s]"


def tum_text(times: Array, poses: Array, note: str = "") -> str:
    """Poses (n, 3) at times (n,) as TUM text. An unknown heading (NaN) is written as 0, and said at the top, as is a note."""
    heading = wrap(poses[:, 2])
    lines = ["# timestamp x y z qx qy qz qw"]
    if note:
        lines.append(f"# {note}")
    if np.isnan(heading).any():
        lines.append("# headings are unknown and written as 0")
        heading = np.nan_to_num(heading, nan=0.0)
    zero = np.zeros(len(poses))
    quaternion = [zero, zero, zero, np.sin(heading / 2), np.cos(heading / 2)]
    rows = np.column_stack([times, poses[:, 0], poses[:, 1], *quaternion])
    lines += [" ".join(map(repr, row)) for row in rows.tolist()]
    return "\n".join(lines) + "\n"


SIGHTING_COLUMNS = ("step", "range", "bearing", "orientation", "class", "landmark", "status", "true_id")


def sightings_text(log: Log, result: EstimatorResult) -> str:
    """A table of all sightings with the ids that an estimator gave them; what is not known, or none, stays empty."""
    assert result.association is not None
    status, known = status_of(result).tolist(), log.classified
    classes = [] if log.classes is None else log.classes.tolist()
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(SIGHTING_COLUMNS)
    for k, z in enumerate(log.sightings.tolist()):
        ids = ["" if j == UNIDENTIFIED else j for j in (int(result.association[k]), int(log.landmarks[k]))]
        shown = classes[k] if known[k] else ""
        table.writerow([int(log.steps[k]), *z, *[""] * (3 - len(z)), shown, ids[0], status[k], ids[1]])
    return text.getvalue()


def texts(comparison: Comparison) -> Iterator[tuple[str, Callable[[], str]]]:
    """Every trajectory and map: the name of its file, and the function that makes its text.

    They are NAME.tum (of joined logs NAME-1.tum, NAME-2.tum, ...) and NAME-map.csv of each estimator, NAME-sightings.csv of
    those that gave sightings ids themselves, and those of the ground truth. truth.tum has the poses at which errors are
    measured, so that other programs find the same errors.
    """
    log = comparison.log
    times, between = times_of(log), control_path(log, comparison.options.motion, interval=INTERVAL)
    if log.true_poses is not None:
        where = log.truth_place
        note = f"positions of the point {where} of the robot's pose, which the other files hold" if where else ""
        for number, drive, late in _clocks(log):
            known = np.flatnonzero(log.covered[drive]) + drive.start
            yield f"truth{number}.tum", partial(tum_text, times[known] + late, log.true_poses[known], note)
    if log.true_landmarks:
        yield "truth-map.csv", partial(map_text, log.true_landmarks, {})
    for result in comparison.results:
        for number, drive, late in _clocks(log):
            yield f"{result.name}{number}.tum", partial(_path_text, between, result, drive, late)
        if result.association is not None:
            yield f"{result.name}-sightings.csv", partial(sightings_text, log, result)
        if result.landmarks:
            yield f"{result.name}-map.csv", partial(map_text, result.landmarks, result.landmark_covariances)


def _clocks(log: Log) -> Iterator[tuple[str, slice, float]]:
    """For each of several joined logs its number in names of files, its steps, and how late its own clock is [s]."""
    if not log.sessions:
        yield "", slice(0, log.num_poses), 0.0
    for k, (session, drive) in enumerate(zip(log.sessions, log.drives), start=1):
        yield f"-{k}", drive, session.start_time - float(times_of(log)[drive.start])


def _path_text(between: ControlPath, result: EstimatorResult, drive: slice, late: float) -> str:
    path = between.through(np.where(result.estimated[:, None], result.poses, np.nan))
    rows = np.arange(between.rows[drive.start], between.rows[drive.stop - 1] + 1)
    known = rows[np.isfinite(path[rows, 0])]
    return tum_text(between.times[known] + late, path[known])


def write_pose_graph(comparison: Comparison, path: Path) -> str | None:
    """Write the graph that ``graph`` solved as g2o, with its solution as initial values, see `graphslam.graph.transform`.

    It is the graph of the solution itself: sightings that graduated non-convexity rejected do not count in the file, and
    a robust kernel is in it as the weight of each edge at the solution.

    Returns:
        None, or why there is no such file.

    Raises:
        FormatError: the file cannot be written.
    """
    reason = reason_without_graph(comparison)
    if reason is None:
        result = comparison["graph"]
        assert result.graph is not None
        relative_graph(result.graph, state=result.state).save_g2o(path)
    return reason


def reason_without_graph(comparison: Comparison) -> str | None:
    """The reason why the graph of ``graph`` cannot be written as g2o; None where it can."""
    if "graph" not in comparison:
        return "the estimator graph did not run"
    result = comparison["graph"]
    if result.graph is None:
        return "the result has no graph"
    if result.graph.num_edges > MOST_EDGES:
        return f"the graph has {result.graph.num_edges} edges, more than {MOST_EDGES}"
    try:
        relative_graph(result.graph)
    except GraphError as error:
        return str(error)
    return None
