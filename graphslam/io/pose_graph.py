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
from ..errors.checks import check_choice, first
from ..files import read_text, write_whole
from ..se2 import Array, compose, inverse, transform, turn_matrix, wrap
from .base import number, whole

DIALECTS = ("g2o", "toro", "isam")


@dataclass
class PoseGraphFile:
    """The contents of a file: ids and values of poses (P,), (P, 3) and landmarks (L,), (L, 2), fixed ids, and the edges.

    Edges name ids: ``pose_edges`` (E, 2) with ``pose_measured`` (E, 3) and ``pose_information`` (E, 3, 3) in the axes of
    the first pose; ``point_edges`` (K, 2) with ``point_measured`` (K, 2) and ``point_information`` (K, 2, 2). Priors of poses
    name ids, too, and have information in world axes: ``priors`` (A,) with ``prior_measured`` (A, 3) and
    ``prior_information`` (A, 3, 3), ``places`` (B,) with ``place_measured`` (B, 2) and ``place_information`` (B, 2, 2).
    Ranges alone are ``range_edges`` (F, 2) with ``range_measured`` (F, 1) and ``range_information`` (F, 1, 1), and bearings
    ``bearing_edges`` likewise.
    ``notes`` are doubts about the numbers, one sentence each.
    """

    pose_ids: np.ndarray
    poses: Array
    landmark_ids: np.ndarray
    landmarks: Array
    fixed: list[int]
    pose_edges: np.ndarray
    pose_measured: Array
    pose_information: Array
    point_edges: np.ndarray
    point_measured: Array
    point_information: Array
    priors: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    prior_measured: Array = field(default_factory=lambda: np.zeros((0, 3)))
    prior_information: Array = field(default_factory=lambda: np.zeros((0, 3, 3)))
    places: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    place_measured: Array = field(default_factory=lambda: np.zeros((0, 2)))
    place_information: Array = field(default_factory=lambda: np.zeros((0, 2, 2)))
    range_edges: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    range_measured: Array = field(default_factory=lambda: np.zeros((0, 1)))
    range_information: Array = field(default_factory=lambda: np.zeros((0, 1, 1)))
    bearing_edges: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    bearing_measured: Array = field(default_factory=lambda: np.zeros((0, 1)))
    bearing_information: Array = field(default_factory=lambda: np.zeros((0, 1, 1)))
    notes: tuple[str, ...] = ()


class _Edge(NamedTuple):
    """The line of an edge: its number and tag, its one or two ids, and the numbers."""

    line: int
    tag: str
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
    pose_edges: list[_Edge] = field(default_factory=list)
    point_edges: list[_Edge] = field(default_factory=list)
    ranges: list[_Edge] = field(default_factory=list)
    bearings: list[_Edge] = field(default_factory=list)
    priors: list[_Edge] = field(default_factory=list)
    places: list[_Edge] = field(default_factory=list)


#: tag -> number of ids, number of numbers, form of the line
_TAGS: dict[str, tuple[int, int, str]] = {
    "VERTEX_SE2": (1, 3, "id x y theta"),
    "VERTEX2": (1, 3, "id x y theta"),
    "VERTEX_XY": (1, 2, "id x y"),
    "EDGE_SE2": (2, 9, "i j x y theta and 6 of the information"),
    "EDGE2": (2, 9, "i j x y theta and 6 of the information"),
    "ODOMETRY": (2, 9, "i j x y theta and 6 of the square-root information"),
    "EDGE_SE2_XY": (2, 5, "i j x y and 3 of the information"),
    "LANDMARK": (2, 5, "i j x y and 3 of the square-root information"),
    "EDGE_RANGE_SE2_XY": (2, 2, "i j range and its information"),
    "EDGE_BEARING_SE2_XY": (2, 2, "i j bearing and its information"),
    "EDGE_PRIOR_SE2": (1, 9, "id x y theta and 6 of the information"),
    "EDGE_PRIOR_SE2_XY": (1, 5, "id x y and 3 of the information"),
}
#: the dialect of an edge's tag; EDGE2 is TORO's or iSAM's
_DIALECT_OF = {
    "EDGE_SE2": "g2o", "EDGE_SE2_XY": "g2o", "EDGE_PRIOR_SE2": "g2o", "EDGE_PRIOR_SE2_XY": "g2o",
    "EDGE_RANGE_SE2_XY": "g2o", "EDGE_BEARING_SE2_XY": "g2o", "ODOMETRY": "isam",
    "LANDMARK": "isam",
}  # fmt: skip


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
    for line, content in enumerate(read_text(path).split("\n"), start=1):
        words = content.split()
        if words and not words[0].startswith("#"):
            lines.tags[words[0]] += 1
            _take(lines, line, words, unknown)
    tags = lines.tags
    if left_out := tags.keys() - {*_TAGS, "FIX"}:
        counted = named(f"{count} x {tag}" for tag, count in tags.items() if tag in left_out)
        warnings.warn(f"{path}: left out lines with unknown tags: {counted}", UserWarning, stacklevel=3)
    if not (lines.pose_edges or lines.point_edges or lines.ranges or lines.bearings):
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
            known = ", ".join([*_TAGS, "FIX"])
            raise FormatError(
                path, line, f"unknown tag {quoted(tag)}; known are {known} (unknown='skip' leaves others out)"
            )
        return
    num_ids, count, form = _TAGS[tag]
    if len(words) != 1 + num_ids + count:
        raise FormatError(path, line, f"expected '{tag} {form}', {1 + num_ids + count} columns, found {len(words)}")
    ids = [whole(path, line, "a node's id", word) for word in words[1 : 1 + num_ids]]
    numbers = [number(path, line, "an entry", word) for word in words[1 + num_ids :]]
    if num_ids == 2:
        if count == 9 and ids[0] == ids[1]:
            raise FormatError(path, line, f"the edge goes from node {ids[0]} to itself; an edge ties two nodes")
        alone = lines.ranges if "RANGE" in tag else lines.bearings
        (lines.pose_edges if count == 9 else lines.point_edges if count == 5 else alone).append(
            _Edge(line, tag, ids, numbers)
        )
        if tag == "EDGE_RANGE_SE2_XY" and numbers[0] <= 0:
            raise FormatError(path, line, f"the range is {numbers[0]:g} m; a range must be above zero")
    elif tag.startswith("EDGE"):
        (lines.priors if count == 9 else lines.places).append(_Edge(line, tag, ids, numbers))
    elif ids[0] in lines.poses or ids[0] in lines.landmarks:
        raise FormatError(path, line, f"vertex {ids[0]} is given a second time; remove one of the two")
    else:
        (lines.poses if count == 3 else lines.landmarks)[ids[0]] = numbers


def _assemble(lines: _Lines, edge2: str) -> PoseGraphFile:
    path = lines.path
    pose_edges, pose_numbers, information = _arrays(path, lines.pose_edges, 3, edge2)
    point_edges, point_numbers, point_information = _arrays(path, lines.point_edges, 2, edge2)
    # the residual of g2o is turned by R(theta_z)' against ours; those of TORO and iSAM are ours
    dialects = np.array([_DIALECT_OF.get(edge.tag, edge2) for edge in lines.pose_edges], dtype="U4")
    turn = turn_matrix(np.where(dialects == "g2o", pose_numbers[:, 2], 0.0))
    information = turn @ information @ np.swapaxes(turn, 1, 2)

    ranges, range_numbers, range_information = _arrays(path, lines.ranges, 1, edge2)
    bearings, bearing_numbers, bearing_information = _arrays(path, lines.bearings, 1, edge2)
    priors, prior_numbers, prior_information = _arrays(path, lines.priors, 3, edge2)
    places, place_numbers, place_information = _arrays(path, lines.places, 2, edge2)
    # g2o measures the error of a prior in the axes of the prior
    turn = turn_matrix(prior_numbers[:, 2])
    prior_information = turn @ prior_information @ np.swapaxes(turn, 1, 2)

    pose_values, landmark_values = lines.poses, lines.landmarks
    if not pose_values and not landmark_values:
        pose_values, landmark_values = _initial_values(pose_edges, pose_numbers, point_edges, point_numbers)
        for edge in (*lines.pose_edges, *lines.point_edges):
            if edge.ids[0] not in pose_values:
                raise FormatError(
                    path,
                    edge.line,
                    f"the graph falls into pieces: no edges lead from pose {next(iter(pose_values))} to pose "
                    f"{edge.ids[0]}; add the edge that ties them, or give all vertices",
                )
    for edges, last, of_last in (
        (lines.pose_edges, "pose", pose_values),
        (lines.point_edges + lines.ranges + lines.bearings, "landmark", landmark_values),
        (lines.priors + lines.places, "pose", pose_values),
    ):
        for edge in edges:
            for id, kind, values in zip(edge.ids, ("pose", last), (pose_values, of_last)):
                if id not in values:
                    raise FormatError(path, edge.line, f"the edge uses {kind} {id}, which no vertex line gives")
    for node, line in lines.fixed.items():
        if node not in pose_values and node not in landmark_values:
            raise FormatError(path, line, f"FIX names node {node}, which is no pose or landmark of the file")
    pose_ids, landmark_ids = (np.array(sorted(values), dtype=np.int64) for values in (pose_values, landmark_values))
    poses = np.array([pose_values[k] for k in pose_ids.tolist()]).reshape(-1, 3)
    return PoseGraphFile(
        pose_ids=pose_ids,
        poses=np.column_stack([poses[:, :2], wrap(poses[:, 2])]),
        landmark_ids=landmark_ids,
        landmarks=np.array([landmark_values[k] for k in landmark_ids.tolist()]).reshape(-1, 2),
        fixed=list(lines.fixed),
        pose_edges=pose_edges,
        pose_measured=np.column_stack([pose_numbers[:, :2], wrap(pose_numbers[:, 2])]),
        pose_information=information,
        point_edges=point_edges,
        point_measured=point_numbers,
        point_information=point_information,
        range_edges=ranges,
        range_measured=range_numbers,
        range_information=range_information,
        bearing_edges=bearings,
        bearing_measured=wrap(bearing_numbers),
        bearing_information=bearing_information,
        priors=priors[:, 0],
        prior_measured=np.column_stack([prior_numbers[:, :2], wrap(prior_numbers[:, 2])]),
        prior_information=prior_information,
        places=places[:, 0],
        place_measured=place_numbers,
        place_information=place_information,
        notes=_doubts(path, information, dialects),
    )


def _doubts(path: Path, information: Array, dialects: np.ndarray) -> tuple[str, ...]:
    """A note where the information (E, 3, 3) of relative poses is so small that the file must have covariances.

    A heading that is not measured at all is uniform, with a deviation of pi / sqrt(3). Edges that claim more say nothing,
    and a covariance read as information claims it nearly always. Edges without information on the heading do not count.
    """
    heading = information[:, 2, 2]
    heading = heading[heading > 0]
    if len(heading) == 0 or (middle := float(np.median(heading))) >= 3 / np.pi**2:
        return ()
    root = np.any(dialects == "isam")
    wanted = "the square root R of the information R'R, 1 / deviation" if root else "the information, 1 / variance"
    note = (
        f"the information of this file means a deviation of {middle**-0.5:.2g} rad for half of its headings: it "
        f"seems to hold covariances where its format wants {wanted}"
    )
    warnings.warn(f"{path}: {note}", UserWarning, stacklevel=5)
    return (note,)


def _arrays(path: Path, edges: list[_Edge], d: int, edge2: str) -> tuple[np.ndarray, Array, Array]:
    """The ids of edges (E, 2), or of priors (E, 1), their measurements (E, d), and their information (E, d, d).

    The information comes in the order of the dialect.
    """
    rows, columns = np.triu_indices(d)
    ids = np.array([edge.ids for edge in edges], dtype=np.int64)
    if ids.ndim < 2:
        ids = ids.reshape(0, 2)
    numbers = np.array([edge.numbers for edge in edges]).reshape(-1, d + len(rows))
    dialects = np.array([_DIALECT_OF.get(edge.tag, edge2) for edge in edges], dtype="U4")
    entries = numbers[:, d:]
    if d == 3:
        # TORO has 11 12 22 33 13 23
        entries = np.where(dialects[:, None] == "toro", entries[:, [0, 1, 4, 2, 5, 3]], entries)
    information = np.zeros((len(edges), d, d))
    information[:, rows, columns] = entries
    roots = dialects == "isam"
    with np.errstate(over="ignore", invalid="ignore"):
        squares = np.swapaxes(information[roots], 1, 2) @ information[roots]
    information[:, columns, rows] = entries
    information[roots] = squares
    if (k := first(~np.isfinite(information).all(axis=(1, 2)))) is not None:
        raise FormatError(path, edges[k].line, "the square-root information is so large that its square overflows")
    smallest = np.linalg.eigvalsh(information)[:, 0]
    if (k := first(smallest < -1e-9 * np.abs(information).max(axis=(1, 2)))) is not None:
        what = f"the information is not positive semi-definite (eigenvalue {smallest[k]:.3g})"
        raise FormatError(path, edges[k].line, what)
    return ids, numbers[:, :d], information


def _initial_values(
    pose_edges: np.ndarray, pose_numbers: Array, point_edges: np.ndarray, point_numbers: Array
) -> tuple[dict[int, list[float]], dict[int, list[float]]]:
    """Initial values of all nodes that edges connect with the first pose, along the odometry first."""
    neighbours: dict[int, list[tuple[int, int, bool]]] = {}
    for k, (i, j) in enumerate(pose_edges.tolist()):
        neighbours.setdefault(i, []).append((j, k, False))
        neighbours.setdefault(j, []).append((i, k, True))
    ids = np.unique(pose_edges) if len(pose_edges) else point_edges[:1, 0]
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
                    placed[there] = compose(placed[here], pose_numbers[k])
                    queue.appendleft(there)
                else:
                    ahead.append((there, k, backwards, here))
        else:
            there, k, backwards, here = ahead.popleft()
            if there not in placed:
                step = inverse(pose_numbers[k]) if backwards else pose_numbers[k]
                placed[there] = compose(placed[here], step)
                queue.append(there)
    landmarks: dict[int, list[float]] = {}
    for (i, j), z in zip(point_edges.tolist(), point_numbers):
        if j not in landmarks and i in placed:
            landmarks[j] = transform(placed[i], z).tolist()
    return {k: pose.tolist() for k, pose in placed.items()}, landmarks


def write_g2o(data: PoseGraphFile, path: Path) -> None:
    """Write a file in g2o's dialect, numbers at full precision, completely or not at all."""
    out = [f"VERTEX_SE2 {k} {_numbers(pose)}" for k, pose in zip(data.pose_ids.tolist(), data.poses)]
    out += [f"VERTEX_XY {k} {_numbers(m)}" for k, m in zip(data.landmark_ids.tolist(), data.landmarks)]
    out += [f"FIX {k}" for k in data.fixed]
    turn = turn_matrix(-data.pose_measured[:, 2])
    information = turn @ data.pose_information @ np.swapaxes(turn, 1, 2)
    upper = np.triu_indices(3)
    for (i, j), z, omega in zip(data.pose_edges.tolist(), data.pose_measured, information):
        out.append(f"EDGE_SE2 {i} {j} {_numbers(z)} {_numbers(omega[upper])}")
    upper = np.triu_indices(2)
    for (i, j), z, omega in zip(data.point_edges.tolist(), data.point_measured, data.point_information):
        out.append(f"EDGE_SE2_XY {i} {j} {_numbers(z)} {_numbers(omega[upper])}")
    for tag, edges, measured, information in (
        ("EDGE_RANGE_SE2_XY", data.range_edges, data.range_measured, data.range_information),
        ("EDGE_BEARING_SE2_XY", data.bearing_edges, data.bearing_measured, data.bearing_information),
    ):
        for (i, j), z, omega in zip(edges.tolist(), measured, information):
            out.append(f"{tag} {i} {j} {_numbers(z)} {_numbers(omega[0])}")
    # the residual of a prior is turned like that of an edge
    turn = turn_matrix(-data.prior_measured[:, 2])
    of_priors = turn @ data.prior_information @ np.swapaxes(turn, 1, 2)
    for tag, ids, measured, information in (
        ("EDGE_PRIOR_SE2", data.priors, data.prior_measured, of_priors),
        ("EDGE_PRIOR_SE2_XY", data.places, data.place_measured, data.place_information),
    ):
        upper = np.triu_indices(measured.shape[1])
        for i, z, omega in zip(ids.tolist(), measured, information):
            out.append(f"{tag} {i} {_numbers(z)} {_numbers(omega[upper])}")
    with write_whole(path) as temporary:
        temporary.write_text("\n".join(out) + "\n", encoding="utf-8")


def _numbers(values: Array) -> str:
    return " ".join(map(repr, values.tolist()))
