"""The well-known data sets that can be read: where they are published, how their files are laid out, what is present.

The project contains readers, not data. `survey` searches a folder and reads everything that it recognises.
"""

from __future__ import annotations

import os
import tomllib
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from importlib.resources import files
from os import PathLike
from pathlib import Path
from typing import ClassVar

from graphslam import Graph, SlamError, load
from graphslam.files import check_path, first_bytes, path_of
from graphslam.graph.pose_graph import is_pose_graph
from graphslam.io import mrclam
from graphslam.io.formats import FORMATS

from .results import Count, Displayed, describe

#: how many levels of folders are searched, and the size from which on files are not opened for recognition [bytes]
DEPTH, LARGEST = 3, 200_000_000


def data_folder() -> Path:
    """The folder of the data sets: the environment variable SLAM_DATA, else ../shared/data."""
    return Path(os.environ.get("SLAM_DATA") or Path("..") / "shared" / "data")


@dataclass(frozen=True)
class DataSet:
    """A well-known data set.

    Attributes:
        name: in tables; of a log also the name of its format.
        title, source, terms: what it is, where it is published, and the terms of its owners.
        layout: of its files.
        is_graph: whether its files are pose graphs, for ``slam-compare backends``, and not logs.
        found: the local copies.
    """

    name: str
    title: str
    source: str
    terms: str
    layout: str
    is_graph: bool = False
    found: tuple[Found, ...] = ()


DATA_SETS = tuple(
    DataSet(name=name, **entry)
    for name, entry in tomllib.loads(files("comparisons").joinpath("datasets.toml").read_text(encoding="utf-8")).items()
)


@dataclass(frozen=True, kw_only=True)
class Found:
    """A log or pose graph that is present, read.

    Attributes:
        path: of the file or folder.
        robot: which one, where a folder has several.
        poses, sightings, landmarks: their numbers; of a pose graph ``sightings`` counts all its edges.
        controls, seconds: the number of controls, and the time from the first pose to the last [s]; None without odometry.
        poses_covered: the number of poses that the ground truth covers; None without ground truth.
        notes: of the reader.
        error: why it cannot be read, one sentence; None where it can.
    """

    path: Path
    robot: int | None = None
    poses: Count = 0
    sightings: Count = 0
    landmarks: Count = 0
    controls: Count | None = None
    seconds: float | None = None
    poses_covered: Count | None = None
    notes: tuple[str, ...] = ()
    error: str | None = None


@dataclass(frozen=True)
class Survey(Displayed):
    """The result of `survey`: the logs below a folder, by the name of the data set."""

    folder: Path
    found: dict[str, tuple[Found, ...]] = field(default_factory=dict, repr=False)
    shown: ClassVar = {"exists": "exists", "sets": "sets"}

    @property
    def exists(self) -> bool:
        """Whether there is such a folder."""
        return self.folder.is_dir()

    @property
    def sets(self) -> tuple[DataSet, ...]:
        """The known data sets."""
        return tuple(replace(known, found=self.found[known.name]) for known in DATA_SETS)

    @property
    def problems(self) -> tuple[str, ...]:
        """One sentence for each file or folder that cannot be read."""
        return tuple(entry.error for entries in self.found.values() for entry in entries if entry.error is not None)


def survey(folder: str | PathLike[str] | None = None, *, progress: Callable[[Path], None] | None = None) -> Survey:
    """Search a folder (default: `data_folder`) for the known data sets, and read what is there.

    Args:
        folder: with the folders below it, to `DEPTH`.
        progress: called with the path of each log or pose graph before it is read.

    Raises:
        FormatError: the folder's path is impossible.
    """
    folder = data_folder() if folder is None else path_of(folder)
    check_path(folder)
    entries: dict[str, list[Found]] = {known.name: [] for known in DATA_SETS}
    for path, name in _below(folder):
        if progress is not None:
            progress(path)
        robots: list[int] = mrclam.robots(path) if name == "mrclam" else []
        entries[name] += [_read(name, path, robot) for robot in robots] or [_read(name, path, None)]
    return Survey(folder, {name: tuple(found) for name, found in entries.items()})


def _below(folder: Path, depth: int = DEPTH) -> Iterator[tuple[Path, str]]:
    """The logs and pose graphs below a folder, with the names of their data sets."""
    if not folder.is_dir():
        return
    if (of_folder := _kind(folder)) is not None:
        yield folder, of_folder
    for path in sorted(folder.iterdir()):
        if path.is_dir():
            if depth > 0 and not path.name.startswith("."):
                yield from _below(path, depth - 1)
        # the files of a folder that is a log belong to it; others may lie beside them
        elif (of_folder is None or path.suffix in (".txt", ".g2o", ".graph")) and (name := _kind(path)) is not None:
            yield path, name


def _kind(path: Path) -> str | None:
    """The data set that a file or folder belongs to, by its first lines or its files."""
    try:
        if path.is_file() and path.stat().st_size > LARGEST:
            return None
        head = first_bytes(path) if path.is_file() else b""
    except OSError:
        return None
    for form in FORMATS.values():
        if form.recognises(path, head):
            return form.name if form.name in {known.name for known in DATA_SETS} else None
    return "pose-graphs" if is_pose_graph(head) else None


def _read(name: str, path: Path, robot: int | None) -> Found:
    try:
        # the warnings of a reader are also notes of the log
        with warnings.catch_warnings(action="ignore", category=UserWarning):
            return _graph(path) if name == "pose-graphs" else _log(path, robot)
    except SlamError as error:
        return Found(path=path, robot=robot, error=str(error))


def _log(path: Path, robot: int | None) -> Found:
    log = load(path, robot=robot)
    described = describe(log)
    same = {name: getattr(described, name) for name in ("poses", "sightings", "landmarks", "controls", "notes")}
    seconds = None if log.times is None else float(log.times[-1] - log.times[0])
    covered = None if log.true_poses is None else described.poses_covered
    return Found(path=path, robot=robot, seconds=seconds, poses_covered=covered, **same)


def _graph(path: Path) -> Found:
    graph = Graph.from_g2o(path)
    poses, landmarks = len(graph.steps), len(graph.landmark_ids)
    return Found(path=path, poses=poses, landmarks=landmarks, sightings=graph.num_edges, notes=graph.notes)
