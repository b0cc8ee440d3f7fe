"""`evaluate`: trajectories and maps of any program against the ground truth.

A trajectory is a table of times and poses (CSV, TSV, TUM, Parquet), as `run` writes them; its rows may have the
covariances of the poses in world axes, in the columns `graphslam.maps.map_files.COVARIANCE`. It is also the topic of a bag
with poses, BAG:TOPIC where there are several, or an .npz archive of the arrays times (N,) [s], poses (N, 3) and, if
known, covariances (N, 3, 3). Each pose of an estimate is compared with the truth at its time: between two true poses, on
the arc that leads from one to the other.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from graphslam import FormatError, LandmarkMap, LogError, OptionError, load, metrics
from graphslam.errors import named
from graphslam.files import check_file, first_bytes, path_of, read_archive
from graphslam.io.bag_messages import POSES, Poses
from graphslam.io.bag_topics import SUFFIXES, is_bag, open_bag
from graphslam.log.drive import truth_of
from graphslam.log.measurements import finite_floats, not_positive, symmetric
from graphslam.log.rows import TableOptions
from graphslam.log.streams import poses_at
from graphslam.log.table import plain
from graphslam.log.text_table import PARQUET, TEXT, table_of
from graphslam.maps.map_files import COVARIANCE, UPPER
from graphslam.se2 import Array, compose, mounted, transform

from .options import EvaluationOptions
from .results import Count, Displayed, jsonable
from .results.files import NO_HEADINGS, OTHER_POINT

#: times that differ by at most this are the same [ns]: those since 1970 are rounded in other programs
ROUNDED = 1_000
#: what to do with a log that is given as an estimate
SOLVED = "'slam-compare run LOG --out FOLDER' solves a log and writes trajectories, such as FOLDER/graph.tum"
#: stands for the map of an estimate that has none
NO_MAP = Path("-")
#: the tables of all estimates in the options of tables, beside "truth"
ESTIMATES = "estimates"


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses with times.

    Attributes:
        name: that of the file, without its ending.
        times: (N,) in nanoseconds, increasing.
        poses: (N, 3), the heading NaN where it is not known.
        covariances: (N, 3, 3) in world axes, or None.
        offset: the point of the robot that the positions are of, as `graphslam.Log.truth_offset`; of the truth only.
    """

    name: str
    times: np.ndarray
    poses: Array
    covariances: Array | None = None
    notes: tuple[str, ...] = ()
    offset: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class Evaluated(metrics.Errors):
    """The errors of one estimate; None where they cannot be known. Errors of the map are those after the same alignment.

    Attributes:
        name: of the estimate.
        poses, compared: the number of its poses, and of those at whose time the truth is known.
        most_m: the largest position error after alignment [m].
        nees: mean of e' P^-1 e / 3; about 1 for right covariances. Where that of the first pose is zero, errors are those
            in its frame, else in that of the truth. None without covariances, true headings, or the truth of the first pose.
        landmarks: the number of landmarks of the map.
        landmark_rmse_m: of landmarks whose ids are true ones, or, with ``match="place"``, of the pairs.
        missed, false: true landmarks that have no partner within the cutoff, and landmarks of the map without.
        gospa_m: see `graphslam.metrics.gospa`.
        times, errors: (N,) [s] since the first true pose, and position errors [m], NaN where the truth is not known.
        aligned: (N, 3) the aligned poses, of the point that the truth is of.
        aligned_map: {id: place}.
        notes: those of the reader of the files.
    """

    name: str
    poses: Count
    compared: Count
    most_m: float
    nees: float | None
    times: Array = field(repr=False)
    errors: Array = field(repr=False)
    aligned: Array = field(repr=False)
    landmarks: Count | None = None
    missed: Count | None = None
    false: Count | None = None
    gospa_m: float | None = None
    aligned_map: Mapping[int, Array] = field(default_factory=dict, repr=False)
    notes: tuple[str, ...] = field(default=(), repr=False)


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation(Displayed):
    """Estimates against one ground truth."""

    truth: Trajectory
    estimates: tuple[Evaluated, ...]
    options: EvaluationOptions
    true_map: Mapping[int, Array] | None = None

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """The notes of the readers of all files."""
        read = [(self.truth.name, self.truth.notes), *((each.name, each.notes) for each in self.estimates)]
        return tuple(f"{name}: {note}" for name, notes in read for note in notes)

    def to_json(self) -> dict[str, Any]:
        """The errors as plain data, see docs/schema.json."""
        landmarks, counted = None if self.true_map is None else len(self.true_map), len(self.truth.times)
        document = (self.truth.name, counted, landmarks, self.options.cutoff, self.estimates, self.notes)
        return jsonable(EvaluateDocument(*document))


@dataclass(frozen=True)
class EvaluateDocument:
    """The JSON of `slam-compare evaluate`.

    Attributes:
        truth: name of the ground truth.
        true_poses: number of true poses.
        true_landmarks: number of true landmarks; null without a true map.
        cutoff_m: `--cutoff` [m].
        estimates: one for each estimate, in the order of the command.
        notes: remarks of the readers.
    """

    truth: str
    true_poses: Count
    true_landmarks: Count | None
    cutoff_m: float
    estimates: tuple[Evaluated, ...]
    notes: tuple[str, ...]


def evaluate(truth: str | PathLike[str], *estimates: str | PathLike[str], **options: Any) -> Evaluation:
    """Compare trajectories, and maps, with the ground truth.

    Args:
        truth: a table of the true poses, or a log with ground truth, whose map counts, too.
        estimates: tables of poses.
        options: the fields of `options.EvaluationOptions`.

    Raises:
        LogError: a file holds no trajectory; no pose of an estimate is within the time of the truth.
        OptionError: an option is impossible, or there is no estimate.
    """
    given = EvaluationOptions.of(**options)
    if not estimates:
        raise OptionError("name at least one estimate after the ground truth: evaluate TRUTH ESTIMATE ...")
    if given.map and len(given.map) != len(estimates):
        message = f"there are {len(given.map)} maps for {len(estimates)} estimates; name one for each, - for none"
        raise OptionError(message)
    right, true_map = _truth(path_of(truth), _table_options(given, "truth"))
    tables = _table_options(given, ESTIMATES)
    if given.true_map is not None:
        true_map = LandmarkMap.load(given.true_map)
    if given.map and true_map is None:
        raise OptionError("maps are compared with the true map: name it with --true-map FILE")
    paths = [path_of(path) for path in estimates]
    found = []
    for path, name, of_map in zip(paths, _names(paths), given.map or [NO_MAP] * len(paths)):
        try:
            trajectory = read_trajectory(path, name, tables)
        except LogError as error:
            # the reader's advice names the table "truth"
            advice = re.sub(r"(?<==')truth(?=[=.])", ESTIMATES, str(error))
            raise error if advice == str(error) else LogError(advice) from None
        places = None if of_map == NO_MAP else LandmarkMap.load(of_map)
        found.append(_evaluated(right, trajectory, true_map, places, given))
    return Evaluation(right, tuple(found), given, true_map)


def read_trajectory(path: Path, name: str, options: TableOptions) -> Trajectory:
    """The trajectory of a table, a bag or an archive; of the ``options``, these two have the clock alone.

    Raises:
        LogError: it has no times or poses; with the line and the likely cause.
    """
    bag, topic = _bag_of(path)
    if bag is not None:
        return _by_clock(_of_topic(bag, topic, name), options)
    if path.suffix.lower() == ".npz":
        check_file(path)
        return _by_clock(_of_archive(path, name), options)
    if path.suffix.lower() not in (*TEXT, *PARQUET):
        raise LogError(
            f"{path}: a trajectory is a table ({', '.join((*TEXT, *PARQUET))}) with columns t, x, y and theta, a topic of a "
            f"bag, or an .npz archive; {SOLVED}"
        )
    table = table_of(path, "trajectory")
    timed = truth_of(table, options)
    poses = timed.rows
    if poses.shape[1] == 2:
        poses = np.column_stack([poses, np.full(len(poses), np.nan)])
    head, notes = first_bytes(path), timed.notes
    if NO_HEADINGS.encode() in head.splitlines():
        poses[poses[:, 2] == 0, 2] = np.nan
    if f"# {OTHER_POINT}".encode() in head:
        notes += (
            "its positions are not those of the robot's pose; evaluate with the log as the truth knows the point",
        )
    columns = {plain(each)[0]: k for k, each in enumerate(table.names or ())}
    covariances = None
    if "var_x" in columns and all(each in columns for each in COVARIANCE):
        if any(unit in each for each in timed.columns for unit in ("[cm]", "[mm]", "[degrees]")):
            message = "poses with covariances must be in metres and radians, the units of the covariances"
            raise table.error(None, message)
        if len(timed.times) != len(table) or np.any(np.diff(timed.times) <= 0):
            raise table.error(None, "rows with covariances must be in the order of time, and each needs a pose")
        covariances = symmetric(table.numbers([columns[each] for each in COVARIANCE]), UPPER)
    return Trajectory(name, timed.times, poses, covariances, notes)


def _by_clock(found: Trajectory, options: TableOptions) -> Trajectory:
    """A trajectory with the seconds that the options add to its times."""
    return replace(found, times=found.times + options.clock("truth"))


def _bag_of(path: Path) -> tuple[Path | None, str]:
    """The bag of a path BAG or BAG:TOPIC, None for what is no bag, and the topic."""
    whole, _, topic = str(path).partition(":")
    for each, name in ((path, ""), (Path(whole), f"/{topic.lstrip('/')}")):
        # a path has lost the slash after the colon only where the name of the topic has none
        if each.suffix.lower() in SUFFIXES or (each.is_dir() and is_bag(each, b"")):
            if not each.exists():
                raise FormatError(each, None, "there is no such file")
            return each, name if each is not path else ""
    return None, ""


def _of_topic(path: Path, topic: str, name: str) -> Trajectory:
    """The poses of a topic of a bag; covariances that are zero are none."""
    with open_bag(path) as bag:
        offered = [each for each in bag.topics if each.type in POSES and each.count]
        chosen = [each for each in offered if each.name == topic] if topic else offered
        if len(chosen) != 1:
            names = named(each.name for each in offered)
            what = f"there is no topic {topic} of poses" if topic else "several topics have poses" if offered else ""
            hint = f": it has {names}; name one, as in {path.name}:{offered[0].name}" if offered else ""
            raise FormatError(path, None, f"{what or 'no topic has poses'}{hint}")
        found = Poses(f"{path}: {chosen[0].name}", "positions", chosen[0].type)
        for _, time, message in bag.messages([chosen[0].name]):
            found.add(time, message)
    times, first = np.unique(found.times, return_index=True)
    poses, covariances, _ = (each[first] for each in found.poses())
    return Trajectory(name, times, poses, None if not_positive(covariances).any() else covariances)


def _of_archive(path: Path, name: str) -> Trajectory:
    """The arrays times, poses and covariances of an .npz archive."""
    arrays = read_archive(path, "a trajectory")
    if not {"times", "poses"} <= arrays.keys():
        which = f"it is a log; {SOLVED}" if "steps" in arrays else f"it has {named(arrays) or 'nothing'}"
        message = f"a trajectory in .npz has the arrays times [s] and poses (x, y, theta), and {which}"
        raise FormatError(path, None, message)
    times = np.round(finite_floats("times", arrays["times"], (None,)) * 1e9).astype(np.int64)
    poses = finite_floats("poses", arrays["poses"], (len(times), 3))
    covariances = arrays.get("covariances")
    if covariances is not None:
        covariances = finite_floats("covariances", covariances, (len(times), 3, 3))
    if np.any(np.diff(times) <= 0):
        raise FormatError(path, None, "the times must increase")
    return Trajectory(name, times, poses, covariances)


def _truth(path: Path, options: TableOptions) -> tuple[Trajectory, Mapping[int, Array] | None]:
    """The true trajectory, and the true map of a log."""
    bag, topic = _bag_of(path)
    archive = path.suffix.lower() == ".npz" and path.is_file() and "poses" in read_archive(path, "a trajectory")
    if archive or path.suffix.lower() in (*TEXT, *PARQUET) or (topic and bag != path):
        return read_trajectory(path, path.stem, options), None
    log = load(path)
    if log.true_poses is None or log.times is None:
        raise LogError(f"{path}: the log has no true poses with times")
    if log.sessions:
        own = "it was joined from several logs, and the trajectories of each have its own clock"
        raise LogError(f"{path}: {own}: take truth-1.tum, truth-2.tum, ... as the truth, which run writes beside them")
    known = log.covered
    times = np.round(log.times[known] * 1e9).astype(np.int64)
    found = Trajectory(path.stem, times, log.true_poses[known], notes=log.notes, offset=log.truth_offset)
    return _by_clock(found, options), log.true_landmarks


def _table_options(options: EvaluationOptions, table: str) -> TableOptions:
    """The options of a trajectory: those for all tables and those for this one, which the reader calls "truth"."""
    found: dict[str, Any] = {}
    for name, value in options.of_component("tables").items():
        entries = [each.strip() for each in value.split(",")] if isinstance(value, str) else []
        others = {"truth", ESTIMATES} - {table}
        kept = [each for each in entries if re.split("[=.]", each)[0] not in others]
        renamed = [re.sub(f"^{table}(?=[=.])", "truth", each) for each in kept]
        found[name] = (",".join(renamed) or None) if entries else value
    return TableOptions(**found)


def _evaluated(
    truth: Trajectory, estimate: Trajectory, true_map: Mapping[int, Array] | None, places: Mapping[int, Array] | None,
    options: EvaluationOptions,
) -> Evaluated:  # fmt: skip
    right = poses_at(estimate.times, truth.times, truth.poses, 1e9 * options.longest_gap, same=ROUNDED)
    known = np.isfinite(right[:, 0])
    if np.count_nonzero(known) < 2:
        spans = [f"{each.times[0] / 1e9:.3f} to {each.times[-1] / 1e9:.3f} s" for each in (truth, estimate)]
        apart = np.median(np.diff(truth.times)) / 1e9 if len(truth.times) > 1 else 0.0
        remedy = f"True poses are {apart:.3g} s apart: --longest-gap {apart:.3g} interpolates between them"
        if not apart > options.longest_gap:
            remedy = "If their clocks begin at different moments, write the times of one by that of the other "
            remedy += "(--clocks estimates=SECONDS)"
        raise LogError(
            f"{estimate.name}: {np.count_nonzero(known)} of {len(known)} poses are at a time at which the truth is known; "
            f"the truth goes from {spans[0]}, the estimate from {spans[1]}. {remedy}"
        )
    # errors are those of the point that the truth is of
    at_point = mounted(estimate.poses, truth.offset)
    if not np.isfinite(at_point[known, :2]).all():
        raise LogError(
            f"{estimate.name}: it has no headings, and {truth.name} is the truth of a point off the robot's pose, whose "
            "place depends on them"
        )
    poses, at = at_point[known], right[known]
    placement = metrics.align(at, poses)
    errors = np.full(len(known), np.nan)
    errors[known] = metrics.position_errors(at, poses)
    nees, covariances = None, None if estimate.covariances is None else estimate.covariances[known]
    if covariances is not None and known[0] and np.isfinite([at[0], poses[0]]).all():
        robot = mounted(at, (-truth.offset[0], -truth.offset[1]))
        nees = metrics.mean_nees(robot, estimate.poses[known], covariances, relative=not covariances[0].any())
    on_map: dict[str, Any] = {}
    notes, named = estimate.notes, dict[int, Array]()
    if places is not None and true_map is not None:
        moved = {j: transform(placement, place[:2]) for j, place in places.items()}
        pairs = metrics.matched_places(true_map, moved, options.cutoff)
        named = {j: places[k] for j, k in pairs} if options.match == "place" else dict(places)
        on_map = {
            "landmarks": len(places), "missed": len(true_map) - len(pairs), "false": len(moved) - len(pairs),
            "gospa_m": metrics.gospa(true_map, moved, options.cutoff), "aligned_map": moved,
        }  # fmt: skip
        if options.match == "id" and true_map.keys().isdisjoint(moved):
            notes += (
                "the map has no id of the true map, so that its error is not known; --match place finds pairs by place",
            )
    # poses without truth stay in their places, so that no motion leads across them
    found = metrics.evaluate(right, true_map, at_point, named)
    measured = {name: getattr(found, name) for name in metrics.METRICS}
    if not np.isfinite(poses[:, 2]).all():
        measured |= {"rpe_m": None, "rpe_rad": None, "heading_rad": None}
    return Evaluated(
        name=estimate.name, poses=len(known), compared=int(np.count_nonzero(known)), most_m=float(np.nanmax(errors)),
        nees=nees, times=(estimate.times - truth.times[0]) / 1e9, errors=errors,
        aligned=compose(placement, at_point), notes=notes, **measured, **on_map,
    )  # fmt: skip


def _names(paths: Sequence[Path]) -> list[str]:
    """The names of the files without their endings; with these, and with the folder, where two are alike."""
    names = [path.stem for path in paths]
    for longer in (lambda p: p.name, lambda p: str(Path(p.parent.name) / p.name)):
        names = [longer(p) if names.count(name) > 1 else name for p, name in zip(paths, names)]
    return names
