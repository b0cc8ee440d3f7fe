"""PyFactorGraph's text files (``.pyfg``): one robot or several in the plane, with odometry, landmarks and ranges.

==============================================  =====================================================================
``VERTEX_SE2 t A0 x y theta``                   a pose; letters name robots, L is for landmarks
``VERTEX_XY L6 x y``                            a landmark
``VERTEX_SE2:PRIOR t A0 x y theta`` + 6         an absolute pose and the upper triangle of its covariance, by rows
``EDGE_SE2 t A0 A1 dx dy dtheta`` + 6           odometry; between other poses or robots a relation
``EDGE_SE2_XY t A0 L6 dx dy`` + 3               a landmark, or another robot without its heading, in the pose's axes
``EDGE_RANGE t A0 L6 range variance``           the range of a landmark alone
==============================================  =====================================================================

Several robots become one log, whose sessions they are. The values of the vertices are the true poses, unless they are
what the odometry leads to. A robot starts at its prior, or else at its first vertex.

A log has a noise model and no covariances of single sightings, so that the sensor is the one that fits those of the file
best. Odometry keeps its own variances: a motion is a pause, in which the robot is displaced with those of x and y, an
arc, and a turn in place, with that of the heading (`Log.control_variances`).

Source: Papalia and others, *PyFactorGraph*, https://github.com/MarineRoboticsGroup/PyFactorGraph.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import FormatError, OptionError, checks, quoted
from ..files import number, read_text
from ..log import Log
from ..log.geometry import polar
from ..log.join import end_to_end
from ..log.measurements import NOT_POSITIVE, AbsolutePositions, PartialSightings, PoseRelations, not_positive, symmetric
from ..log.rows import ReadOptions
from ..models import MotionModel, SensorModel
from ..se2 import Array, between, difference, sinc, wrap
from .base import Format

#: tag -> whether a time comes first, how many names, how many numbers, form of the line
_TAGS = {
    "VERTEX_SE2": (True, 1, 3, "t NAME x y theta"),
    "VERTEX_XY": (False, 1, 2, "NAME x y"),
    "VERTEX_SE2:PRIOR": (True, 1, 9, "t NAME x y theta c11 c12 c13 c22 c23 c33"),
    "VERTEX_XY:PRIOR": (True, 1, 5, "t NAME x y c11 c12 c22"),
    "EDGE_SE2": (True, 2, 9, "t A B dx dy dtheta c11 c12 c13 c22 c23 c33"),
    "EDGE_SE2_XY": (True, 2, 5, "t POSE LANDMARK dx dy c11 c12 c22"),
    "EDGE_RANGE": (True, 2, 2, "t A B range variance"),
}
#: the letter of landmarks
_LANDMARK = "L"
#: the noise of the odometry is in its variances
_MOTION = MotionModel(nn=0.0, no=0.0, on=0.0, oo=0.0, epsilon=1e-9)
#: vertices that are nearer than this to where the odometry leads are no ground truth [m, rad]: files have six decimals
_SAME = 1e-4
#: covariances of single sightings that differ from the sensor's by more than this factor are worth a note
_DIFFER = 1.2
#: the parts of the time of a motion that its pause takes, and its turn in place at least and at most
_PAUSE, _SHARES = 0.01, (0.01, 0.98)


class _Row(NamedTuple):
    """A line: its number, its time [s], the names and the numbers."""

    line: int
    time: float
    names: tuple[str, ...]
    numbers: tuple[float, ...]


@dataclass
class _File:
    """The lines of a file by their tags, and the vertices by their names."""

    path: Path
    rows: dict[str, list[_Row]] = field(default_factory=lambda: {tag: [] for tag in _TAGS})
    vertices: dict[str, _Row] = field(default_factory=dict)

    def error(self, line: int | None, message: str) -> FormatError:
        return FormatError(self.path, line, message)

    def covariances(self, rows: list[_Row], d: int) -> Array:
        """Those of rows (N, d, d).

        Raises:
            FormatError: one is not positive definite.
        """
        found = symmetric(np.array([row.numbers[d:] for row in rows]).reshape(len(rows), d * (d + 1) // 2))
        for k in np.flatnonzero(not_positive(found)).tolist():
            raise self.error(rows[k].line, f"the covariance {NOT_POSITIVE}")
        return found


def _recognises(path: Path, head: bytes) -> bool:
    if path.suffix.lower() == ".pyfg":
        return True
    line = next((each for each in head.splitlines() if each.strip() and not each.startswith(b"#")), b"")
    # g2o counts its vertices
    return re.match(rb"(VERTEX_SE2(:PRIOR)?\s+\S+|VERTEX_XY|EDGE_\S+\s+\S+)\s+[A-Z]\d+\s", line) is not None


def _parsed(path: Path) -> _File:
    """The lines of a file.

    Raises:
        FormatError: a line breaks the rules, or uses a pose or landmark that has no vertex.
    """
    file = _File(path)
    for line, content in enumerate(read_text(path).splitlines(), start=1):
        words = content.split()
        if not words or words[0].startswith("#"):
            continue
        tag = words[0]
        if tag not in _TAGS:
            solid = "; this program is for the plane" if "SE3" in tag or "XYZ" in tag else ""
            raise file.error(line, f"unknown tag {quoted(tag)}{solid}: lines of a .pyfg file are {', '.join(_TAGS)}")
        timed, names, count, form = _TAGS[tag]
        if len(words) != 1 + timed + names + count:
            raise file.error(line, f"expected '{tag} {form}', {1 + timed + names + count} words, found {len(words)}")
        time = number(path, line, "the time", words[1]) if timed else 0.0
        at = 1 + timed
        numbers = tuple(number(path, line, "an entry", word) for word in words[at + names :])
        row = _Row(line, time, tuple(words[at : at + names]), numbers)
        for name in row.names:
            if not re.fullmatch(r"[A-Z]\d{1,9}", name):
                raise file.error(line, f"a name is a capital letter and a number, such as A0 or L6, not {quoted(name)}")
            if (name[0] == _LANDMARK) != tag.startswith("VERTEX_XY") and tag not in ("EDGE_SE2_XY", "EDGE_RANGE"):
                raise file.error(line, f"{name} cannot be the name in {tag}: L is the letter of landmarks")
        if tag in ("VERTEX_SE2", "VERTEX_XY"):
            name = row.names[0]
            if name in file.vertices:
                raise file.error(line, f"{name} was in line {file.vertices[name].line} already; remove one of the two")
            file.vertices[name] = row
        file.rows[tag].append(row)
    for row in (row for rows in file.rows.values() for row in rows):
        for name in row.names:
            if name not in file.vertices:
                raise file.error(row.line, f"{name} has no vertex: each pose and landmark needs one")
        if len(set(row.names)) < len(row.names):
            raise file.error(row.line, f"the edge goes from {row.names[0]} to itself; it ties two")
    if not any(name[0] != _LANDMARK for name in file.vertices):
        raise file.error(None, "no poses: a robot needs lines like 'VERTEX_SE2 t A0 x y theta'")
    return file


def _number_of(letter: str) -> int:
    """The number of a robot, 1 for A; landmarks have no number."""
    return ord(letter) - ord("A") + (letter < _LANDMARK)


def _robots(file: _File) -> list[int]:
    return sorted({_number_of(name[0]) for name in file.vertices if name[0] != _LANDMARK})


def _read(path: Path, options: ReadOptions) -> Log:
    return _log_of(_parsed(path), options.robot)


def _read_robots(path: Path, _: ReadOptions) -> dict[int, Log]:
    file = _parsed(path)
    return {robot: _log_of(file, robot) for robot in _robots(file)}


def _log_of(file: _File, robot: int | None) -> Log:
    """The log of all robots, or of one."""
    chains: dict[str, list[str]] = {}
    for name in sorted(file.vertices, key=lambda name: (name[0], int(name[1:]))):
        if name[0] != _LANDMARK and robot in (None, _number_of(name[0])):
            chains.setdefault(name[0], []).append(name)
    if not chains:
        raise OptionError(f"{file.path} has no robot {robot}; its robots are {', '.join(map(str, _robots(file)))}")
    every = [name for chain in chains.values() for name in chain]
    step = {name: k for k, name in enumerate(every)}
    odometry, others = _odometry(file, chains)
    notes = Counter[str]()
    if robot is not None:
        left_out = sum(len(_outside(row, step)) > 0 and bool(step.keys() & row.names) for row in others)
        notes[f"edges to other robots are left out, because one robot is named: {left_out:,}"] += left_out
    others = [row for row in others if not _outside(row, step)]
    truth = np.array([file.vertices[name].numbers for name in every])
    known = _is_truth(chains, odometry, file)
    if not known:
        notes["the values of the vertices are where the odometry leads, and no ground truth"] += 1
    ranges, seen = _split(file, step, notes)
    sensor, remarks = _sensor(file, ranges, seen)
    priors = [row for row in file.rows["VERTEX_SE2:PRIOR"] if row.names[0] in step]
    starts = {row.names[0]: row.numbers[:3] for row in priors}
    if len(priors) == 1 and priors[0].names[0] == every[0]:
        # the gauge of the first robot, as in all logs
        priors = []
    if unused := len(file.rows["VERTEX_XY:PRIOR"]):
        notes[f"priors of landmarks are not used: {unused:,}; a map has them (slam-compare run --map)"] += 1
    landmarks = {int(name[1:]): np.array(row.numbers) for name, row in file.vertices.items() if name[0] == _LANDMARK}
    log: Log | None = None
    begin = 0
    for letter, chain in chains.items():
        own = _drive(file, chain, odometry[letter], notes)
        mine, single = ([row for row in rows if row.names[0][0] == letter] for rows in (seen, ranges))
        start = starts.get(chain[0], file.vertices[chain[0]].numbers)
        part = Log(
            **own,
            **_sightings(mine, single, step, begin),
            initial_poses=_MOTION.dead_reckoning(start, own["controls"], own["dt"])[own["control_starts"]],
            true_poses=truth[begin : begin + len(chain)] if known else None,
            true_landmarks=landmarks if known else None,
            motion=_MOTION,
            sensor=sensor,
            name=file.path.stem if len(chains) == 1 and robot is None else f"robot {letter}",
        )
        log = part if log is None else end_to_end(log, part)
        begin += len(chain)
    assert log is not None
    remarks += [note for note, count in notes.items() if count]
    return log.replace(
        relations=_relations(file, others, step),
        positions=_positions(file, priors, step),
        notes=(*log.notes, *remarks),
        name=log.name if robot is not None else file.path.stem,
    )


def _sightings(seen: list[_Row], ranges: list[_Row], step: dict[str, int], begin: int) -> dict[str, Any]:
    """The sightings and the ranges of one robot, whose first step is ``begin``, as arguments of its log."""
    seen = sorted(seen, key=lambda row: step[row.names[0]])
    z = np.array([row.numbers[:2] for row in seen]).reshape(-1, 2)
    found: dict[str, Any] = {"sightings": polar(z)}
    of_ranges: dict[str, Any] = {"ranges": np.array([row.numbers[0] for row in ranges])}
    for rows, values in ((seen, found), (ranges, of_ranges)):
        values["steps"] = np.array([step[row.names[0]] - begin for row in rows], dtype=np.int64)
        values["landmarks"] = np.array([int(row.names[1][1:]) for row in rows], dtype=np.int64)
    if ranges:
        found["partial_sightings"] = PartialSightings(**of_ranges, bearings=np.full(len(ranges), np.nan))
    return found


def _outside(row: _Row, step: dict[str, int]) -> list[str]:
    """The names of poses that are not read."""
    return [name for name in row.names if name[0] != _LANDMARK and name not in step]


def _odometry(file: _File, chains: dict[str, list[str]]) -> tuple[dict[str, list[_Row]], list[_Row]]:
    """The odometry of each robot, one row for each motion, and all other relations between two poses.

    Raises:
        FormatError: nothing leads from a pose to the next.
    """
    wanted = {pair for chain in chains.values() for pair in zip(chain, chain[1:])}
    first: dict[tuple[str, ...], _Row] = {}
    others = []
    for row in file.rows["EDGE_SE2"]:
        if row.names in wanted and row.names not in first:
            first[row.names] = row
        else:
            others.append(row)
    for a, b in sorted(wanted - first.keys(), key=lambda pair: file.vertices[pair[1]].line):
        message = f"no EDGE_SE2 leads from {a} to {b}: a robot needs odometry from each pose to its next"
        raise file.error(file.vertices[b].line, message)
    return {letter: [first[pair] for pair in zip(chain, chain[1:])] for letter, chain in chains.items()}, others


def _is_truth(chains: dict[str, list[str]], odometry: dict[str, list[_Row]], file: _File) -> bool:
    """Whether the vertices are something else than what the odometry leads to."""
    for letter, chain in chains.items():
        poses = np.array([file.vertices[name].numbers for name in chain])
        if len(chain) > 1:
            off = difference(between(poses[:-1], poses[1:]), np.array([row.numbers[:3] for row in odometry[letter]]))
            if np.abs(off).max() > _SAME:
                return True
    return False


def _split(file: _File, step: dict[str, int], notes: Counter[str]) -> tuple[list[_Row], list[_Row]]:
    """The ranges of landmarks, and the sightings; those of poses that are read.

    Raises:
        FormatError: a range is not above zero, or an edge has no pose.
    """
    ranges, seen = [], list[_Row]()
    between_robots = 0
    for row in file.rows["EDGE_RANGE"]:
        for what, value in zip(("range", "variance"), row.numbers):
            if not value > 0:
                raise file.error(row.line, f"the {what} is {value:g}, but it must be above zero")
        a, b = sorted(row.names, key=lambda name: name[0] == _LANDMARK)
        if a[0] == _LANDMARK:
            raise file.error(row.line, f"the range is between the landmarks {a} and {b}; one end must be a pose")
        if b[0] != _LANDMARK:
            between_robots += a in step or b in step
        elif a in step:
            ranges.append(row._replace(names=(a, b)))
    for row in file.rows["EDGE_SE2_XY"]:
        if row.names[0][0] == _LANDMARK:
            raise file.error(row.line, f"the first name must be a pose, and {row.names[0]} is a landmark")
        if not np.hypot(row.numbers[0], row.numbers[1]) > 0:
            raise file.error(row.line, f"{row.names[1]} is where the robot is; a range must be above zero")
        if row.names[1][0] == _LANDMARK and row.names[0] in step:
            seen.append(row)
    if between_robots:
        notes[checks.singular(f"{between_robots:,} ranges between two poses, such as of two robots: not used")] += 1
    return ranges, seen


def _sensor(file: _File, ranges: list[_Row], seen: list[_Row]) -> tuple[SensorModel, list[str]]:
    """The sensor whose noise fits the variances of all ranges and sightings best, and a note where single ones differ."""
    from scipy.optimize import nnls  # late: 0.2 s that other formats do not need

    z = np.array([row.numbers[:2] for row in seen]).reshape(-1, 2)
    C, r = file.covariances(seen, 2), np.hypot(*z.T)
    along = z / r[:, None]
    across = np.column_stack([-along[:, 1], along[:, 0]])
    lengths = np.concatenate([r, [row.numbers[0] for row in ranges]])
    variances = np.concatenate([np.einsum("ni,nij,nj->n", along, C, along), [row.numbers[1] for row in ranges]])
    bearings = np.einsum("ni,nij,nj->n", across, C, across) / r**2
    rate = constant = middle = None
    ratios = [np.ones(1)]
    if len(lengths):
        A = np.column_stack([lengths**2, np.ones_like(lengths)]) / variances[:, None]
        parts = nnls(A, np.ones(len(A)))[0]
        # what one part adds to every range less than rounding does is zero
        parts[parts * [lengths.max() ** 2, 1.0] < 1e-5 * variances.min()] = 0.0
        rate, constant = parts.tolist()
        ratios.append(variances / (rate * lengths**2 + constant))
    if len(bearings):
        middle = float(np.median(bearings))
        ratios.append(bearings / middle)
    most = float(np.exp(np.abs(np.log(np.concatenate(ratios))).max() / 2))
    sensor = SensorModel.of_variances(rate, constant, middle)
    if most < _DIFFER:
        return sensor, []
    single = f"the standard deviations of single ones in the file differ from it by up to a factor of {most:.2g}"
    return sensor, [f"a log has one noise model of the sensor for all sightings: {single}"]


def _drive(file: _File, chain: list[str], odometry: list[_Row], notes: Counter[str]) -> dict[str, Any]:
    """The controls of a robot as arguments of its log."""
    times = np.array([file.vertices[name].time for name in chain])
    dt = np.diff(times)
    if np.any(dt <= 0):
        notes[f"the times of robot {chain[0][0]} do not increase: each motion lasts a second"] += 1
        dt = np.ones(len(dt))
    motions = np.array([row.numbers[:3] for row in odometry]).reshape(-1, 3)
    controls, lasting = controls_of(motions, dt)
    C = file.covariances(odometry, 3)
    sizes = np.sqrt(np.diagonal(C, axis1=1, axis2=2))
    if np.any(np.abs(C / (sizes[:, :, None] * sizes[:, None, :]) - np.eye(3)) > 0.01):
        notes["covariances between x, y and the heading of odometry are left out"] += 1
    variances = np.zeros((len(controls), 3))
    variances[::3, [0, 2]] = sizes[:, :2] ** 2 / lasting[::3, None] ** 2
    variances[2::3, 1] = sizes[:, 2] ** 2 / lasting[2::3] ** 2
    return {
        "controls": controls, "dt": lasting, "control_starts": np.arange(0, len(controls) + 1, 3),
        "control_variances": variances, "start_time": float(times[0]),
    }  # fmt: skip


def controls_of(motions: Array, dt: Array) -> tuple[Array, Array]:
    """Controls (3T, 2) and their durations (3T,) that lead along motions (T, 3) in times (T,): a pause, an arc, and a turn.

    The arc that leads from (0, 0, 0) to (x, y) turns by 2 atan2(y, x); backwards where x is negative.
    """
    sign = np.where(motions[:, 0] < 0, -1.0, 1.0)
    arc = 2 * np.arctan2(sign * motions[:, 1], sign * motions[:, 0])
    length = sign * np.hypot(motions[:, 0], motions[:, 1]) / sinc(arc / 2)
    rest = wrap(motions[:, 2] - arc)
    total = np.abs(rest) + np.abs(arc) + np.abs(length)
    share = np.clip(np.abs(rest) / np.where(total > 0, total, 1.0), *_SHARES)
    lasting = np.column_stack([np.full_like(share, _PAUSE), 1 - _PAUSE - share, share]) * dt[:, None]
    controls = np.zeros((len(motions), 3, 2))
    controls[:, 1] = np.column_stack([length, arc]) / lasting[:, 1:2]
    controls[:, 2, 1] = rest / lasting[:, 2]
    return controls.reshape(-1, 2), lasting.ravel()


def _relations(file: _File, others: list[_Row], step: dict[str, int]) -> PoseRelations | None:
    """All relations that are no odometry, and sightings of other robots, whose heading is not measured."""
    seen = [row for row in file.rows["EDGE_SE2_XY"] if row.names[1] in step and row.names[0] in step]
    if not others and not seen:
        return None
    motions = np.full((len(others) + len(seen), 3), np.nan)
    motions[: len(others)] = np.array([row.numbers[:3] for row in others]).reshape(-1, 3)
    motions[len(others) :, :2] = np.array([row.numbers[:2] for row in seen]).reshape(-1, 2)
    covariances = np.tile(np.eye(3), (len(motions), 1, 1))
    covariances[: len(others)] = file.covariances(others, 3)
    covariances[len(others) :, :2, :2] = file.covariances(seen, 2)
    ends = np.array([[step[name] for name in row.names] for row in (*others, *seen)])
    return PoseRelations(first=ends[:, 0], second=ends[:, 1], motions=motions, covariances=covariances)


def _positions(file: _File, priors: list[_Row], step: dict[str, int]) -> AbsolutePositions | None:
    """The priors of poses."""
    if not priors:
        return None
    return AbsolutePositions(
        steps=np.array([step[row.names[0]] for row in priors]),
        places=np.array([row.numbers[:3] for row in priors]),
        covariances=file.covariances(priors, 3),
    )


FORMAT = Format("pyfg", _recognises, _read, robots=lambda path: _robots(_parsed(path)), read_robots=_read_robots)
