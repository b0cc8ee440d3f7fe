"""The well-known data sets that can be read: where they are published, how they must look, and what is at hand.

The project ships readers, not data. `survey` looks below a folder and reads everything that it recognises.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from graphslam import Graph, Log, SlamError, load
from graphslam.edges import AnchorEdges
from graphslam.formats import FORMATS, mrclam

from .display import Displayed
from .saving import jsonable

#: how far below the folder of the data is looked, and files larger than this [bytes] are not opened to see what they are
DEPTH, LARGEST = 3, 200_000_000


def data_folder() -> Path:
    """Where data sets lie: the environment variable SLAM_DATA, else ../shared/data."""
    return Path(os.environ.get("SLAM_DATA") or Path("..") / "shared" / "data")


@dataclass(frozen=True)
class DataSet:
    """A data set that people know.

    Attributes:
        name: as tables call it; of a log also the name of its format.
        title, source, terms: what it is, where it is published, and what its owners ask.
        layout: how the file or folder must look.
        is_graph: whether its files are pose graphs, for ``slam-compare backends``, and not logs.
    """

    name: str
    title: str
    source: str
    terms: str
    layout: str
    is_graph: bool = False


DATA_SETS = (
    DataSet(
        "mrclam", "UTIAS MR.CLAM: five robots among 15 landmarks, nine sets",
        "http://asrl.utias.utoronto.ca/datasets/mrclam/; Leung et al., IJRR 30(8), 2011",
        "free for education and research, cite the paper; not to be passed on",
        "a folder a set: Barcodes.dat, Landmark_Groundtruth.dat, RobotN_Odometry.dat, RobotN_Measurement.dat, "
        "RobotN_Groundtruth.dat",
    ),
    DataSet(
        "lost-in-the-woods", "Lost in the Woods: a robot among 17 tubes, laser and odometry at 10 Hz",
        "T. Barfoot, course AER1513 of the University of Toronto, data set 2",
        "not stated; course material", "dataset2.mat, or a folder with it",
    ),
    DataSet(
        "huang", "Huang's simulated logs of 535 and 8,240 steps",
        "https://openslam-org.github.io (2D-I-SLSJF); Huang, Wang and Dissanayake, IEEE T-RO 24(5), 2008",
        "not stated",
        "a folder a log: store_speed.mat, store_turnrate.mat, sensor_data.mat, parameters.txt, and for the truth "
        "store_robotTrue.mat, store_beaconsTrue.mat",
    ),
    DataSet(
        "victoria-park", "Victoria Park: a car among trees without ids, with GPS",
        "J. Guivant and E. Nebot, University of Sydney; IEEE T-RA 17(3), 2001", "not stated; cite the paper",
        "trees.mat, or a folder with it, and aa3_gpsx.mat beside it for the truth",
    ),
    DataSet(
        "lnpr", "The logs of the lectures' book", "R. Ueda, LNPR, https://github.com/ryuichiueda/LNPR", "MIT licence",
        "a text file of lines x, z and perhaps delta, u",
    ),
    DataSet(
        "pose-graphs", "INTEL, M3500, CSAIL, city10000, dlr, cityTrees10000, Victoria Park with ids, and their kind",
        "the collections of g2o, iSAM and TORO", "not stated for most", "text files: g2o, TORO or iSAM", is_graph=True,
    ),
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Found:
    """A log or pose graph that is at hand, read.

    Attributes:
        path: where; robot: which one, where a folder has several.
        poses, sightings, landmarks: how many; of a pose graph ``sightings`` counts all its edges.
        controls, seconds: of the odometry: how many, and from the first pose to the last [s]; None where there is none.
        poses_covered: how many poses the truth covers; None without truth.
        notes: what the reader had to say.
        error: why it cannot be read, one sentence; None where it can.
    """

    path: Path
    robot: int | None = None
    poses: int = 0
    sightings: int = 0
    landmarks: int = 0
    controls: int | None = None
    seconds: float | None = None
    poses_covered: int | None = None
    notes: tuple[str, ...] = ()
    error: str | None = None


@dataclass(frozen=True)
class Survey(Displayed):
    """What `survey` found below a folder, by the name of the data set."""

    folder: Path
    found: dict[str, tuple[Found, ...]] = field(default_factory=dict)

    @property
    def problems(self) -> tuple[str, ...]:
        """One sentence for each thing that is there and cannot be read."""
        return tuple(entry.error for entries in self.found.values() for entry in entries if entry.error is not None)

    def to_json(self) -> dict[str, Any]:
        """The survey as plain data: {"folder", "exists", "sets": [{"name", ..., "found": [...]}]}."""
        sets = [vars(known) | {"found": [vars(entry) for entry in self.found[known.name]]} for known in DATA_SETS]
        return jsonable({"folder": self.folder, "exists": self.folder.is_dir(), "sets": sets})


def survey(folder: Path | None = None, progress: Callable[[Path], None] | None = None) -> Survey:
    """Look for the known data sets below a folder (default: `data_folder`) and read what is found."""
    folder = data_folder() if folder is None else folder
    found: dict[str, list[Found]] = {known.name: [] for known in DATA_SETS}
    for path in _below(folder):
        name = _kind(path)
        if name is None:
            continue
        if progress is not None:
            progress(path)
        found[name] += _read(name, path)
    return Survey(folder, {name: tuple(entries) for name, entries in found.items()})


def _below(folder: Path, depth: int = DEPTH) -> Iterator[Path]:
    """The folders and files below a folder; nothing inside of what is itself a log."""
    if not folder.is_dir():
        return
    if _kind(folder) is not None:
        yield folder
    for path in sorted(folder.iterdir()):
        if path.is_file():
            # the files of a folder that is a log belong to it; others may lie beside them
            if _kind(folder) is None or path.suffix in (".txt", ".g2o", ".graph"):
                yield path
        elif depth > 0 and not path.name.startswith("."):
            yield from _below(path, depth - 1)


def _kind(path: Path) -> str | None:
    """The data set that a file or folder is of, by what it looks like."""
    head = b""
    if path.is_file():
        try:
            if path.stat().st_size > LARGEST:
                return None
            with path.open("rb") as stream:
                head = stream.read(4096)
        except OSError:
            return None
    names = {known.name for known in DATA_SETS}
    for form in FORMATS.values():
        if form.recognises(path, head):
            return form.name if form.name in names else None
    tags = {line.split()[0] for line in head.decode("utf-8", errors="replace").splitlines() if line.split()}
    of_graphs = {"VERTEX_SE2", "VERTEX_XY", "EDGE_SE2", "EDGE_SE2_XY", "VERTEX2", "EDGE2", "ODOMETRY"}
    return "pose-graphs" if path.is_file() and tags & of_graphs else None


def _read(name: str, path: Path) -> list[Found]:
    if name == "pose-graphs":
        return [_graph(path)]
    if name != "mrclam":
        return [_log(path)]
    return [_log(path, robot) for robot in mrclam.robots(path)] or [_log(path)]


def _log(path: Path, robot: int | None = None) -> Found:
    try:
        with warnings.catch_warnings():
            # what a reader warns of is among the log's notes, too
            warnings.simplefilter("ignore", UserWarning)
            log: Log = load(path, robot=robot)
    except SlamError as error:
        return Found(path=path, robot=robot, error=str(error))
    times = log.times
    return Found(
        path=path,
        robot=robot,
        poses=log.num_poses,
        sightings=len(log.steps),
        landmarks=len(log.landmark_ids),
        controls=None if log.controls is None else len(log.controls),
        seconds=None if times is None else float(times[-1] - times[0]),
        poses_covered=None if log.true_poses is None else int(log.covered.sum()),
        notes=log.notes,
    )


def _graph(path: Path) -> Found:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            graph = Graph.from_g2o(path)
    except SlamError as error:
        return Found(path=path, error=str(error))
    edges = sum(family.count for family in graph.families if not isinstance(family, AnchorEdges))
    return Found(
        path=path, poses=len(graph.steps), landmarks=len(graph.landmark_ids), sightings=edges, notes=graph.notes
    )
