"""The files of results: folders, trajectories, maps, and sightings with the ids that an estimator gave them.

A folder of results is written completely or not at all. Of several logs that were joined each has its trajectories in files
of its own, with its own clock.

Trajectories are in the text format of the TUM RGB-D benchmark, one pose per line,

    timestamp x y z qx qy qz qw        [s, m, quaternion]; here z = qx = qy = 0, qz = sin(theta / 2), qw = cos(theta / 2)

An estimated trajectory has the poses of the log, and between them the ends of the recorded controls, at most ten a second
(`graphslam.log.continuous_time`). Maps are tables with commas. Reading a file gives exactly the same numbers.
"""

from __future__ import annotations

import csv
import io
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import datetime
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from graphslam import FormatError, GraphError, Log, OptionError, control_path
from graphslam.files import check_path, check_place
from graphslam.graph.transform import relative_graph
from graphslam.log import UNIDENTIFIED
from graphslam.log.continuous_time import ControlPath
from graphslam.maps.map_files import map_text
from graphslam.se2 import Array, wrap

from .results import EstimatorResult, status_of

if TYPE_CHECKING:
    from ..comparison import Comparison


#: the default folder of the results folders
RESULTS = Path("results")


def check_can_write(path: Path, *, endings: tuple[str, ...] = ()) -> None:
    """Raise now rather than after minutes of work if a file cannot be written at ``path``.

    Args:
        path: of the file.
        endings: those that the name may have, such as (".png", ".pdf"); default: any.

    Raises:
        OptionError: the name has another ending.
        FormatError: no file can be written there.
    """
    if endings and path.suffix.lower() not in endings:
        raise OptionError(f"{path}: the name of this file must end in {' or '.join(endings)}")
    check_place(path)
    path = path.resolve()
    if not path.parent.is_dir():
        raise FormatError(path, None, f"cannot write into {path.parent}: there is no such folder")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise FormatError(path, None, f"cannot write into {path.parent}: Permission denied")


def check_can_make(directory: Path) -> None:
    """Raise `FormatError` now rather than after minutes of work if ``directory`` cannot be made or written into."""
    check_path(directory)
    for place in (directory, *directory.absolute().parents):
        if place.is_dir():
            if not os.access(place, os.W_OK | os.X_OK):
                raise FormatError(directory, None, f"cannot write into {place}: Permission denied")
            return
        if os.path.lexists(place):
            raise FormatError(directory, None, f"{place} is a file; give the name of a folder")


def new_directory(root: Path = RESULTS, now: datetime | None = None) -> Path:
    """Make the folder ``root/YYYY-mm-ddTHH-MM-SS`` (with -2, -3, ... where that exists) and return it.

    Raises:
        FormatError: the folder cannot be made.
    """
    stamp = (now or datetime.now()).strftime("%Y-%m-%dT%H-%M-%S")
    try:
        root.mkdir(parents=True, exist_ok=True)
        for attempt in count(1):
            directory = root / (stamp if attempt == 1 else f"{stamp}-{attempt}")
            # mkdir itself is the test: two runs of the same second never share a folder
            with suppress(FileExistsError):
                directory.mkdir()
                return directory
    except OSError as error:
        raise FormatError(root, None, f"cannot make a folder here: {error.strerror}") from None
    raise AssertionError("count() never ends")


def point_latest(directory: Path) -> None:
    """Link ``latest``, next to a results folder, to it, where links are possible and the name is free."""
    link = directory.parent / "latest"
    if os.path.lexists(link) and not link.is_symlink():
        return
    spare = directory.parent / f".latest-{directory.name}"
    with suppress(OSError):
        spare.symlink_to(directory.name, target_is_directory=True)
        # replacing is atomic, so that a reader never finds the link missing
        spare.replace(link)
    with suppress(OSError):
        spare.unlink()


class SavedFiles(dict[str, Path]):
    """The files that were written, by kind or name.

    Attributes:
        notes: which files could not be made, and why, one sentence each.
    """

    def __init__(self, files: Mapping[str, Path]) -> None:
        super().__init__(files)
        self.notes: list[str] = []


@contextmanager
def fill_results(directory: Path, *, new: bool) -> Iterator[Path]:
    """Fill a results folder whole or not at all; files of an earlier run in it, which its JSON lists, are removed.

    Args:
        directory: of the results.
        new: whether it was made by `new_directory` just now; then ``latest`` will point to it.
    """
    former = _written_before(directory)
    with fill_whole(directory, for_this_only=new) as folder:
        yield folder
        former -= {path.name for path in folder.iterdir()}
    for name in former:
        # readers would take them for a part of the new results
        (directory / name).unlink(missing_ok=True)
    if new:
        point_latest(directory)


def _written_before(directory: Path) -> set[str]:
    """The names of the files that an earlier comparison left in a folder, according to its comparison.json."""
    try:
        listed = json.loads((directory / "comparison.json").read_text(encoding="utf-8"))["files"].values()
        names = {Path(name).name for name in listed if Path(name).parent.name == directory.name}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return set()
    return {name for name in names if (directory / name).is_file()}


@contextmanager
def fill_whole(directory: Path, *, for_this_only: bool = False) -> Iterator[Path]:
    """Yield an empty folder; what the block puts there moves into ``directory`` only if the block ends well.

    ``directory`` is made if it does not exist. If the block fails it is removed again, provided that it was made here
    (or ``for_this_only`` says that the caller made it just for this) and is empty.

    Raises:
        FormatError: the folder cannot be made or written.
    """
    ours = for_this_only or not directory.exists()
    try:
        directory.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=".unfinished-", dir=directory))
    except OSError as error:
        raise FormatError(directory, None, f"cannot write into this folder: {error.strerror}") from None
    try:
        yield temporary
        for path in sorted(temporary.iterdir()):
            path.replace(directory / path.name)
    except OSError as error:
        raise FormatError(error.filename or directory, None, f"cannot be written: {error.strerror}") from None
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        with suppress(OSError):
            # refuses, as it should, unless the folder is empty
            if ours:
                directory.rmdir()


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
    return np.arange(log.num_poses, dtype=float) if log.dt is None else log.control_times[log.control_starts]


def time_axis(log: Log) -> str:
    """The label of an axis of `elapsed_of`."""
    return "step" if log.dt is None else "time since the first pose [s]"


#: the comment of a trajectory whose headings are unknown, which this format cannot hold; `evaluate` looks for it
NO_HEADINGS = "# headings are unknown and written as 0"
#: how the comment begins of a ground truth that is of another point than the robot's pose
OTHER_POINT = "positions of the point "


def tum_text(times: Array, poses: Array, note: str = "") -> str:
    """Poses (n, 3) at times (n,) as TUM text. An unknown heading (NaN) is written as 0, and said at the top, as is a note."""
    heading = wrap(poses[:, 2])
    lines = ["# timestamp x y z qx qy qz qw", *[f"# {note}"] * bool(note)]
    if np.isnan(heading).any():
        lines.append(NO_HEADINGS)
        heading = np.nan_to_num(heading, nan=0.0)
    rows = np.column_stack([times, poses[:, :2], np.zeros((len(poses), 3)), np.sin(heading / 2), np.cos(heading / 2)])
    return "\n".join([*lines, *(" ".join(map(repr, row)) for row in rows.tolist())]) + "\n"


SIGHTING_COLUMNS = ("step", "range", "bearing", "orientation", "class", "landmark", "status", "true_id")


def sightings_text(log: Log, result: EstimatorResult) -> str:
    """A table of all sightings with the ids that an estimator gave them; what is not known, or none, stays empty."""
    assert result.association is not None
    given, true = (
        ["" if j == UNIDENTIFIED else j for j in ids.tolist()] for ids in (result.association, log.landmarks)
    )
    classes = [""] * len(log.steps)
    if log.classes is not None:
        classes = [each if known else "" for each, known in zip(log.classes.tolist(), log.classified)]
    sightings = [[*z, *[""] * (3 - len(z))] for z in log.sightings.tolist()]
    columns = zip(log.steps.tolist(), sightings, classes, given, status_of(result).tolist(), true)
    text = io.StringIO()
    rows = ([step, *z, *rest] for step, z, *rest in columns)
    csv.writer(text, lineterminator="\n").writerows([SIGHTING_COLUMNS, *rows])
    return text.getvalue()


def texts(comparison: Comparison) -> Iterator[tuple[str, Callable[[], str]]]:
    """Every trajectory and map: the name of its file, and the function that makes its text.

    They are NAME.tum (of joined logs NAME-1.tum, NAME-2.tum, ...) and NAME-map.csv of each estimator, NAME-sightings.csv of
    those that gave sightings ids themselves, and those of the ground truth. truth.tum has the poses at which errors are
    measured, so that other programs find the same errors; a comment says where they are of another point of the robot.
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
            covariances = result.landmark_covariances
            datum = getattr(result.origin, "datum", None)
            text = partial(map_text, result.landmarks, covariances, correlated=bool(covariances), datum=datum)
            yield f"{result.name}-map.csv", text


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


def write_pose_graph(result: EstimatorResult, path: Path) -> None:
    """Write the graph that ``graph`` solved as g2o, with its solution as initial values, see `graphslam.graph.transform`.

    It is the graph of the solution itself: sightings that graduated non-convexity rejected do not count in the file, and
    a robust kernel is in it as the weight of each edge at the solution.

    Raises:
        GraphError: such files cannot hold the graph, or it has more than `MOST_EDGES`.
        FormatError: the file cannot be written.
    """
    if result.graph is None:
        raise GraphError("the result has no graph")
    if result.graph.num_edges > MOST_EDGES:
        raise GraphError(f"the graph has {result.graph.num_edges} edges, more than {MOST_EDGES}")
    relative_graph(result.graph, state=result.state).save_g2o(path)
