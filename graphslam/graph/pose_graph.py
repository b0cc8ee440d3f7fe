"""Text files of pose graphs in three dialects: g2o, TORO and iSAM.

======================  =================================================================================================
g2o                     ``VERTEX_SE2 id x y theta``, ``VERTEX_XY id x y``, ``FIX id ...``,
                        ``EDGE_SE2 i j x y theta`` + information 11 12 13 22 23 33,
                        ``EDGE_SE2_XY i j x y`` + information 11 12 22,
                        ``EDGE_RANGE_SE2_XY i j l`` + its information, ``EDGE_BEARING_SE2_XY i j phi`` + its information,
                        ``EDGE_PRIOR_SE2 id x y theta`` + 6, ``EDGE_PRIOR_SE2_XY id x y`` + 3 of the information
TORO                    ``VERTEX2 id x y theta``, ``EDGE2 i j x y theta`` + information **11 12 22 33 13 23**
iSAM                    ``ODOMETRY`` or ``EDGE2 i j x y theta`` + upper triangle of the **square root** R of the
                        information (R'R), 11 12 13 22 23 33; ``LANDMARK i j x y`` + 11 12 22 of the root;
                        no vertices; a landmark may have the same number as a pose
======================  =================================================================================================

Every tag has the meaning of its own dialect. Only ``EDGE2`` belongs to two: it is TORO's in a file that has ``VERTEX2``
lines, and iSAM's in any other, unless the format is named. All edges measure the second node in the frame of the first.
`RelativePoseEdges` needs the information in the axes of the first pose. TORO and iSAM give it so: their residual is
(x_i^-1 x_j) - z. g2o's residual is e = z^-1 (x_i^-1 x_j), in axes turned by the measured heading, so its information is
turned back here; that of a prior of a pose likewise. Lines that begin with # are comments.

In a file without vertices the initial values follow the odometry: from the first pose along edges to the next id, then
along the others.

Sources: Kümmerle et al., *g2o*, ICRA 2011; Grisetti et al., TORO; Kaess et al., *iSAM*, T-RO 2008.
"""

from __future__ import annotations

import warnings
from collections import Counter, deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import FormatError, named, quoted
from ..errors.checks import FOUR_TURNS, WHOLE_TURN, check_choice, first
from ..files import number, read_text, whole, write_text
from ..se2 import Array, compose, inverse, transform, turned_by, wrap

DIALECTS = ("g2o", "toro", "isam")
#: kind of edge -> how many ids it has, and how many numbers it measures
KINDS = {"pose": (2, 3), "point": (2, 2), "range": (2, 1), "bearing": (2, 1), "prior": (1, 3), "place": (1, 2)}
#: which of these numbers is an angle
_ANGLES = {"pose": 2, "bearing": 0, "prior": 2}


class FileEdges(NamedTuple):
    """The edges of one kind: the ids (E, 2), or (E, 1) of priors, and what they measure (E, d) with information (E, d, d).

    The information of relative poses is in the axes of the first pose, that of priors in world axes.
    """

    ids: np.ndarray
    measured: Array
    information: Array


@dataclass
class PoseGraphFile:
    """The contents of a file: ids and values of poses (P,), (P, 3) and landmarks (L,), (L, 2), fixed ids, and the edges.

    ``edges`` are those of each of `KINDS`, and ``notes`` doubts about the numbers, one sentence each.
    """

    pose_ids: np.ndarray
    poses: Array
    landmark_ids: np.ndarray
    landmarks: Array
    fixed: list[int]
    edges: dict[str, FileEdges]
    notes: tuple[str, ...] = ()


class _Edge(NamedTuple):
    """The line of an edge: its number, the dialect of its tag, its one or two ids, and the numbers."""

    line: int
    dialect: str
    ids: list[int]
    numbers: list[float]


@dataclass
class _Lines:
    """The lines of one file, sorted by kind."""

    path: Path
    tags: Counter[str] = field(default_factory=Counter)
    poses: dict[int, list[float]] = field(default_factory=dict)
    landmarks: dict[int, list[float]] = field(default_factory=dict)
    fixed: dict[int, int] = field(default_factory=dict)
    edges: dict[str, list[_Edge]] = field(default_factory=lambda: {kind: [] for kind in KINDS})


#: tag -> the kind of its edges, or how many numbers its vertices have; its dialect, which EDGE2 has in two; form of the line
_TAGS: dict[str, tuple[str | int, str, str]] = {
    "VERTEX_SE2": (3, "g2o", "id x y theta"),
    "VERTEX2": (3, "toro", "id x y theta"),
    "VERTEX_XY": (2, "g2o", "id x y"),
    "EDGE_SE2": ("pose", "g2o", "i j x y theta and 6 of the information"),
    "EDGE2": ("pose", "", "i j x y theta and 6 of the information"),
    "ODOMETRY": ("pose", "isam", "i j x y theta and 6 of the square-root information"),
    "EDGE_SE2_XY": ("point", "g2o", "i j x y and 3 of the information"),
    "LANDMARK": ("point", "isam", "i j x y and 3 of the square-root information"),
    "EDGE_RANGE_SE2_XY": ("range", "g2o", "i j range and its information"),
    "EDGE_BEARING_SE2_XY": ("bearing", "g2o", "i j bearing and its information"),
    "EDGE_PRIOR_SE2": ("prior", "g2o", "id x y theta and 6 of the information"),
    "EDGE_PRIOR_SE2_XY": ("place", "g2o", "id x y and 3 of the information"),
}
#: the tags of graphs in space, and what is said of them
SPATIAL = ("VERTEX_SE3", "EDGE_SE3", "VERTEX3", "EDGE3", "VERTEX_TRACKXYZ")
IN_THE_PLANE = "the graphs of this project are in the plane, with poses x, y, theta (VERTEX_SE2, EDGE_SE2)"
#: the tag of each kind of edge in g2o's dialect
_G2O = {kind: tag for tag, (kind, dialect, _) in _TAGS.items() if dialect == "g2o"}


def is_pose_graph(head: bytes) -> bool:
    """Whether the first bytes of a file have a line of a pose graph."""
    return any(line.split()[:1] and line.split()[0] in _TAGS for line in head.decode("utf-8", "replace").splitlines())


def read_pose_graph(path: Path, dialect: str | None = None, unknown: str = "error") -> PoseGraphFile:
    """Read a file in one of the dialects; which one follows from its tags unless named.

    Args:
        path: the file.
        dialect: "g2o", "toro" or "isam"; decides what an EDGE2 line means. (g2o has none, so it is TORO's then.)
        unknown: "error" refuses tags that no dialect has, "skip" leaves them out with a warning that counts them.

    Raises:
        FormatError: the file breaks the rules; the message has file and line, what was expected and what to do.
        OptionError: an option has an impossible value.
    """
    if dialect is not None:
        check_choice("format", dialect, DIALECTS)
    check_choice("unknown", unknown, ("error", "skip"))
    lines = _Lines(path)
    contents = read_text(path).split("\n")
    for line, content in enumerate(contents, start=1):
        words = content.split()
        if words and not words[0].startswith("#"):
            lines.tags[words[0]] += 1
            try:
                _take(lines, line, words, unknown)
            except FormatError as error:
                if line < len(contents):
                    raise
                hint = "the file ends within this line; perhaps it was not copied or downloaded to its end"
                raise FormatError(path, line, f"{error.problem}; {hint}") from None
    tags = lines.tags
    if left_out := tags.keys() - {*_TAGS, "FIX"}:
        counted = named(f"{count} x {tag}" for tag, count in tags.items() if tag in left_out)
        warnings.warn(f"{path}: left out lines with unknown tags: {counted}", UserWarning, stacklevel=3)
    if not any(rows for kind, rows in lines.edges.items() if KINDS[kind][0] == 2):
        raise FormatError(path, None, "no edges: a graph has at least one line like 'EDGE_SE2 i j x y theta ...'")
    if dialect is None:
        if "EDGE2" in tags and "VERTEX2" in tags and ("LANDMARK" in tags or "ODOMETRY" in tags):
            raise FormatError(
                path,
                None,
                "EDGE2 is TORO's beside VERTEX2 and iSAM's beside ODOMETRY or LANDMARK, and this file has both; name "
                "the format that is meant, toro or isam",
            )
        dialect = "toro" if "VERTEX2" in tags else "isam"
    return _assemble(lines, "isam" if dialect == "isam" else "toro")


def _take(lines: _Lines, line: int, words: list[str], unknown: str) -> None:
    path, tag = lines.path, words[0]
    if tag == "FIX":
        if len(words) == 1:
            raise FormatError(path, line, "expected 'FIX id ...', at least one id")
        for word in words[1:]:
            lines.fixed.setdefault(whole(path, line, "a node's id", word), line)
        return
    if tag not in _TAGS:
        if unknown == "error":
            if tag.startswith(SPATIAL):
                raise FormatError(path, line, f"{quoted(tag)} is of a graph in space; {IN_THE_PLANE}")
            known = ", ".join([*_TAGS, "FIX"])
            message = f"unknown tag {quoted(tag)}; known are {known} (unknown='skip' leaves others out)"
            raise FormatError(path, line, message)
        return
    kind, dialect, form = _TAGS[tag]
    num_ids, d = KINDS[kind] if isinstance(kind, str) else (1, kind)
    count = d + d * (d + 1) // 2 if isinstance(kind, str) else d
    if len(words) != 1 + num_ids + count:
        raise FormatError(path, line, f"expected '{tag} {form}', {1 + num_ids + count} columns, found {len(words)}")
    ids = [whole(path, line, "a node's id", word) for word in words[1 : 1 + num_ids]]
    numbers = [number(path, line, "an entry", word) for word in words[1 + num_ids :]]
    if isinstance(kind, str):
        if kind == "pose" and ids[0] == ids[1]:
            raise FormatError(path, line, f"the edge goes from node {ids[0]} to itself; an edge ties two nodes")
        if kind == "range" and numbers[0] <= 0:
            raise FormatError(path, line, f"the range is {numbers[0]:g} m; a range must be above zero")
        lines.edges[kind].append(_Edge(line, dialect, ids, numbers))
    elif ids[0] in lines.poses or ids[0] in lines.landmarks:
        raise FormatError(path, line, f"vertex {ids[0]} is given a second time; remove one of the two")
    else:
        (lines.poses if d == 3 else lines.landmarks)[ids[0]] = numbers


def _assemble(lines: _Lines, edge2: str) -> PoseGraphFile:
    path, poses, landmarks = lines.path, lines.poses, lines.landmarks
    edges = {kind: _edges(path, kind, rows, edge2) for kind, rows in lines.edges.items()}
    if not poses and not landmarks:
        poses, landmarks = _initial_values(edges["pose"], edges["point"])
        for edge in (*lines.edges["pose"], *lines.edges["point"]):
            if edge.ids[0] not in poses:
                raise FormatError(
                    path,
                    edge.line,
                    f"the graph falls into pieces: no edges lead from pose {next(iter(poses))} to pose "
                    f"{edge.ids[0]}; add the edge that ties them, or give all vertices",
                )
    for kind, rows in lines.edges.items():
        ends = (("pose", poses), ("pose", poses) if kind == "pose" else ("landmark", landmarks))
        for edge in rows:
            for id, (what, values) in zip(edge.ids, ends):
                if id not in values:
                    raise FormatError(path, edge.line, f"the edge uses {what} {id}, which no vertex line gives")
    for node, line in lines.fixed.items():
        if node not in poses and node not in landmarks:
            raise FormatError(path, line, f"FIX names node {node}, which is no pose or landmark of the file")
    pose_ids, landmark_ids = (np.array(sorted(values), dtype=np.int64) for values in (poses, landmarks))
    places = np.array([poses[k] for k in pose_ids.tolist()]).reshape(-1, 3)
    places[:, 2] = wrap(places[:, 2])
    root = any((edge.dialect or edge2) == "isam" for edge in lines.edges["pose"])
    return PoseGraphFile(
        pose_ids, places, landmark_ids, np.array([landmarks[k] for k in landmark_ids.tolist()]).reshape(-1, 2),
        list(lines.fixed), edges, _doubts(lines, edges["pose"].information, root),
    )  # fmt: skip


def _doubts(lines: _Lines, information: Array, root: bool) -> tuple[str, ...]:
    """Notes where edges turn by more than a whole turn, which is a number of degrees, where the information (E, 3, 3) of
    relative poses is so small that the file must have covariances, and where an edge has the very numbers of another one.

    A heading that is not measured at all is uniform, with a deviation of pi / sqrt(3). Edges that claim more say nothing,
    and a covariance read as information claims it nearly always. Edges without information on the heading do not count.
    """
    notes = []
    beyond = sorted(
        (edge.line, edge.numbers[k])
        for kind, k in _ANGLES.items()
        for edge in lines.edges[kind]
        # headings of priors may count turns
        if abs(edge.numbers[k]) > (FOUR_TURNS if kind == "prior" else WHOLE_TURN)
    )
    if len(beyond) > 1:
        notes.append(
            f"{len(beyond)} edges, the first one in line {beyond[0][0]}, turn by more than 2 pi "
            f"({beyond[0][1]:g} rad): are angles in degrees? Files have radians"
        )
    heading = information[:, 2, 2]
    heading = heading[heading > 0]
    if len(heading) and (middle := float(np.median(heading))) < 3 / np.pi**2:
        wanted = "the square root R of the information R'R, 1 / deviation" if root else "the information, 1 / variance"
        notes.append(
            f"the information of this file means a deviation of {middle**-0.5:.2g} rad for half of its headings: it "
            f"seems to hold covariances where its format wants {wanted}"
        )
    for note in notes:
        warnings.warn(f"{lines.path}: {note}", UserWarning, stacklevel=5)
    rows, seen = [*lines.edges["pose"], *lines.edges["point"]], dict[tuple[float, ...], _Edge]()
    # a hash of three numbers is faster than that of all
    pairs = ((edge, seen.setdefault((edge.ids[0], edge.ids[1], edge.numbers[0]), edge)) for edge in rows)
    if again := [(e.line, before.line) for e, before in pairs if before is not e and before.numbers == e.numbers]:
        # a note alone, because both may have been measured
        line, before = again[0]
        notes.append(
            f"edges that repeat another one, with the same nodes and numbers: {len(again)}, the first one in line {line} "
            f"(as line {before}); both count: remove the copies unless both were measured"
        )
    return tuple(notes)


def _edges(path: Path, kind: str, rows: list[_Edge], edge2: str) -> FileEdges:
    """The edges of some lines of one kind; ``edge2`` is the dialect of EDGE2."""
    num_ids, d = KINDS[kind]
    upper = np.triu_indices(d)
    ids = np.array([edge.ids for edge in rows], dtype=np.int64).reshape(-1, num_ids)
    numbers = np.array([edge.numbers for edge in rows]).reshape(-1, d + len(upper[0]))
    dialects = np.array([edge.dialect or edge2 for edge in rows], dtype="U4")
    measured, entries = numbers[:, :d], numbers[:, d:]
    if d == 3:
        # TORO has 11 12 22 33 13 23
        entries = np.where(dialects[:, None] == "toro", entries[:, [0, 1, 4, 2, 5, 3]], entries)
    information = np.zeros((len(rows), d, d))
    information[:, *upper] = entries
    roots = dialects == "isam"
    with np.errstate(over="ignore", invalid="ignore"):
        squares = np.swapaxes(information[roots], 1, 2) @ information[roots]
    information[:, *upper[::-1]] = entries
    information[roots] = squares
    if (k := first(~np.isfinite(information).all(axis=(1, 2)))) is not None:
        raise FormatError(path, rows[k].line, "the square-root information is so large that its square overflows")
    smallest = np.linalg.eigvalsh(information)[:, 0]
    if (k := first(smallest < -1e-9 * np.abs(information).max(axis=(1, 2)))) is not None:
        what = f"the information is not positive semi-definite (eigenvalue {smallest[k]:.3g})"
        raise FormatError(path, rows[k].line, what)
    if d == 3:
        # the residual of g2o is turned by R(theta_z)' against ours; those of TORO and iSAM are ours
        information = turned_by(information, np.where(dialects == "g2o", measured[:, 2], 0.0))
    if kind in _ANGLES:
        measured[:, _ANGLES[kind]] = wrap(measured[:, _ANGLES[kind]])
    return FileEdges(ids, measured, information)


def _initial_values(
    pose_edges: FileEdges, point_edges: FileEdges
) -> tuple[dict[int, list[float]], dict[int, list[float]]]:
    """Initial values of all nodes that edges connect with the first pose, along the odometry first."""
    neighbours: dict[int, list[tuple[int, int, bool]]] = {}
    for k, (i, j) in enumerate(pose_edges.ids.tolist()):
        neighbours.setdefault(i, []).append((j, k, False))
        neighbours.setdefault(j, []).append((i, k, True))
    ids = np.unique(pose_edges.ids) if len(pose_edges.ids) else point_edges.ids[:1, 0]
    # where poses and landmarks share one numbering, the next pose need not have the next number
    following = dict(zip(ids[:-1].tolist(), ids[1:].tolist()))
    first = int(ids[0])
    placed = {first: np.zeros(3)}
    queue = deque([first])
    # a pose whose odometry is known is placed by it before any loop closure may place it
    ahead: deque[tuple[int, int, bool, int]] = deque()
    while queue or ahead:
        if queue:
            here = queue.popleft()
            for there, k, backwards in neighbours.get(here, []):
                if there in placed:
                    continue
                if there == following.get(here) and not backwards:
                    placed[there] = compose(placed[here], pose_edges.measured[k])
                    queue.appendleft(there)
                else:
                    ahead.append((there, k, backwards, here))
        else:
            there, k, backwards, here = ahead.popleft()
            if there not in placed:
                step = inverse(pose_edges.measured[k]) if backwards else pose_edges.measured[k]
                placed[there] = compose(placed[here], step)
                queue.append(there)
    landmarks: dict[int, list[float]] = {}
    for (i, j), z in zip(point_edges.ids.tolist(), point_edges.measured):
        if j not in landmarks and i in placed:
            landmarks[j] = transform(placed[i], z).tolist()
    return {k: pose.tolist() for k, pose in placed.items()}, landmarks


def write_g2o(data: PoseGraphFile, path: Path) -> None:
    """Write a file in g2o's dialect, numbers at full precision, completely or not at all."""
    out = [f"VERTEX_SE2 {k} {_text(pose)}" for k, pose in zip(data.pose_ids.tolist(), data.poses)]
    out += [f"VERTEX_XY {k} {_text(m)}" for k, m in zip(data.landmark_ids.tolist(), data.landmarks)]
    out += [f"FIX {k}" for k in data.fixed]
    for kind, (ids, measured, information) in data.edges.items():
        d = KINDS[kind][1]
        if d == 3:
            information = turned_by(information, -measured[:, 2])
        upper = information[:, *np.triu_indices(d)]
        out += [f"{_G2O[kind]} {_text(ends)} {_text(z)} {_text(omega)}" for ends, z, omega in zip(ids, measured, upper)]
    write_text(path, "\n".join(out) + "\n")


def _text(values: np.ndarray) -> str:
    return " ".join(map(repr, values.tolist()))
