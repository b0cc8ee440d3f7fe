"""Text files of pose graphs in three dialects: g2o, TORO and iSAM.

======================  =================================================================================================
g2o                     ``VERTEX_SE2 id x y theta``, ``VERTEX_XY id x y``, ``FIX id ...``,
                        ``EDGE_SE2 i j x y theta`` + information 11 12 13 22 23 33,
                        ``EDGE_SE2_XY i j x y`` + information 11 12 22
TORO                    ``VERTEX2 id x y theta``, ``EDGE2 i j x y theta`` + information **11 12 22 33 13 23**
iSAM                    ``ODOMETRY`` or ``EDGE2 i j x y theta`` + upper triangle of the **square root** R of the
                        information (R'R), 11 12 13 22 23 33; ``LANDMARK i j x y`` + 11 12 22 of the root;
                        no vertices; a landmark may have the same number as a pose
======================  =================================================================================================

Every tag means what its own dialect says. Only ``EDGE2`` belongs to two: it is TORO's in a file that has ``VERTEX2`` lines,
and iSAM's in any other, unless the format is named. All edges
measure the second node in the frame of the first. The residual is g2o's, e = z^-1 (x_i^-1 x_j), and its information is
turned here into the axes of the first pose, in which `RelativePoseEdges` has it. Lines that begin with # are comments.

A file without vertices is laid out along its odometry: from the first pose along edges to the next id, then along the others.

Sources: Kümmerle et al., *g2o*, ICRA 2011; Grisetti et al., TORO; Kaess et al., *iSAM*, T-RO 2008.
"""

from __future__ import annotations

import math
import warnings
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..checks import check_choice
from ..errors import FormatError
from ..files import check_file, write_whole
from ..se2 import Array, compose, inverse, rotation, transform, wrap

DIALECTS = ("g2o", "toro", "isam")


@dataclass
class PoseGraphFile:
    """What a file holds: ids and values of poses (P,), (P, 3) and landmarks (L,), (L, 2), fixed ids, and the edges.

    Edges name ids: ``pose_edges`` (E, 2) with ``pose_measured`` (E, 3) and ``pose_information`` (E, 3, 3) in the axes of
    the first pose; ``point_edges`` (K, 2) with ``point_measured`` (K, 2) and ``point_information`` (K, 2, 2).
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


@dataclass
class _Lines:
    """The lines of one file, sorted by what they are."""

    path: Path
    poses: dict[int, list[float]] = field(default_factory=dict)
    landmarks: dict[int, list[float]] = field(default_factory=dict)
    fixed: dict[int, int] = field(default_factory=dict)
    pose_edges: list[tuple[int, int]] = field(default_factory=list)
    pose_numbers: list[list[float]] = field(default_factory=list)
    pose_lines: list[int] = field(default_factory=list)
    pose_tags: list[str] = field(default_factory=list)
    point_edges: list[tuple[int, int]] = field(default_factory=list)
    point_numbers: list[list[float]] = field(default_factory=list)
    point_lines: list[int] = field(default_factory=list)
    point_tags: list[str] = field(default_factory=list)
    unknown: Counter[str] = field(default_factory=Counter)

    def vertex(self, line: int, tag: str, ids: list[int], numbers: list[float]) -> None:  # noqa: ARG002
        if ids[0] in self.poses or ids[0] in self.landmarks:
            raise FormatError(self.path, line, f"vertex {ids[0]} is given a second time; remove one of the two")
        (self.poses if len(numbers) == 3 else self.landmarks)[ids[0]] = numbers

    def edge(self, line: int, tag: str, ids: list[int], numbers: list[float]) -> None:
        if len(numbers) == 9:
            if ids[0] == ids[1]:
                raise FormatError(
                    self.path, line, f"the edge goes from node {ids[0]} to itself; an edge ties two nodes"
                )
            self.pose_edges.append((ids[0], ids[1]))
            self.pose_numbers.append(numbers)
            self.pose_lines.append(line)
            self.pose_tags.append(tag)
        else:
            self.point_edges.append((ids[0], ids[1]))
            self.point_numbers.append(numbers)
            self.point_lines.append(line)
            self.point_tags.append(tag)


#: tag -> ids, numbers, what takes them, form of the line
_TAGS: dict[str, tuple[int, int, Callable[[_Lines, int, str, list[int], list[float]], None], str]] = {
    "VERTEX_SE2": (1, 3, _Lines.vertex, "id x y theta"),
    "VERTEX2": (1, 3, _Lines.vertex, "id x y theta"),
    "VERTEX_XY": (1, 2, _Lines.vertex, "id x y"),
    "EDGE_SE2": (2, 9, _Lines.edge, "i j x y theta and 6 of the information"),
    "EDGE2": (2, 9, _Lines.edge, "i j x y theta and 6 of the information"),
    "ODOMETRY": (2, 9, _Lines.edge, "i j x y theta and 6 of the square-root information"),
    "EDGE_SE2_XY": (2, 5, _Lines.edge, "i j x y and 3 of the information"),
    "LANDMARK": (2, 5, _Lines.edge, "i j x y and 3 of the square-root information"),
}
#: which dialect an edge's tag belongs to; EDGE2 is TORO's or iSAM's
_DIALECT_OF = {"EDGE_SE2": "g2o", "EDGE_SE2_XY": "g2o", "ODOMETRY": "isam", "LANDMARK": "isam"}


def read_pose_graph(path: Path, dialect: str | None = None, unknown: str = "error") -> PoseGraphFile:
    """Read a file in one of the dialects; which one follows from its tags unless named.

    Args:
        path: the file.
        dialect: "g2o", "toro" or "isam"; decides what an EDGE2 line means. (In g2o's there is none: it is TORO's then.)
        unknown: "error" refuses tags that no dialect knows, "skip" leaves them out with a warning that counts them.

    Raises:
        FormatError: the file breaks the rules; the message has file and line, what was expected and what to do.
        OptionError: an option has an impossible value.
    """
    if dialect is not None:
        check_choice("format", dialect, DIALECTS)
    check_choice("unknown", unknown, ("error", "skip"))
    check_file(path)
    lines, tags = _Lines(path), Counter[str]()
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise FormatError(path, None, "not a text file (it has bytes that are not UTF-8)") from None
    for number, content in enumerate(text.split("\n"), start=1):
        words = content.split()
        if not words or words[0].startswith("#"):
            continue
        tags[words[0]] += 1
        _take(lines, number, words, unknown)
    if lines.unknown:
        counted = ", ".join(f"{count} x {tag}" for tag, count in lines.unknown.items())
        warnings.warn(f"{path}: left out lines with unknown tags: {counted}", UserWarning, stacklevel=3)
    if not lines.pose_edges and not lines.point_edges:
        raise FormatError(path, None, "no edges: a graph has at least one line like 'EDGE_SE2 i j x y theta ...'")
    if dialect is None:
        isam = "LANDMARK" in tags or "ODOMETRY" in tags
        if "EDGE2" in tags and "VERTEX2" in tags and isam:
            raise FormatError(
                path, None, "EDGE2 is TORO's beside VERTEX2 and iSAM's beside ODOMETRY or LANDMARK, and here are both; name "
                "the format that is meant, toro or isam"
            )  # fmt: skip
        dialect = "toro" if "VERTEX2" in tags else "isam"
    return _assemble(lines, "isam" if dialect == "isam" else "toro")


def _take(lines: _Lines, number: int, words: list[str], unknown: str) -> None:
    path, tag = lines.path, words[0]
    if tag == "FIX":
        if len(words) == 1:
            raise FormatError(path, number, "expected 'FIX id ...', at least one id")
        for word in words[1:]:
            lines.fixed.setdefault(_whole(path, number, word), number)
        return
    if tag not in _TAGS:
        if unknown == "error":
            known = ", ".join([*_TAGS, "FIX"])
            raise FormatError(
                path, number, f"unknown tag {tag!r}; known are {known} (unknown='skip' leaves others out)"
            )
        lines.unknown[tag] += 1
        return
    ids, numbers, take, form = _TAGS[tag]
    if len(words) != 1 + ids + numbers:
        raise FormatError(path, number, f"expected '{tag} {form}', {1 + ids + numbers} columns, found {len(words)}")
    wrong = next((word for word in words[1:] if "_" in word), None)
    if wrong is not None:
        # Python reads 1_0 as 10, nobody else does
        raise FormatError(path, number, f"expected a number, found {wrong!r}")
    try:
        values = [float(word) for word in words[1 + ids :]]
    except ValueError:
        wrong = next(word for word in words[1 + ids :] if not _is_number(word))
        raise FormatError(path, number, f"expected a number, found {wrong!r}") from None
    if not all(map(math.isfinite, values)):
        raise FormatError(path, number, "only finite numbers make sense here, found nan or inf")
    take(lines, number, tag, [_whole(path, number, word) for word in words[1 : 1 + ids]], values)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _whole(path: Path, line: int, word: str) -> int:
    try:
        value = int(word)
    except ValueError:
        raise FormatError(path, line, f"a node's id should be a whole number, not {word!r}") from None
    if not -(2**63) <= value < 2**63:
        raise FormatError(path, line, f"a node's id should be a whole number of at most 64 bits, not {word!r}")
    return value


def _assemble(lines: _Lines, edge2: str) -> PoseGraphFile:
    path = lines.path
    pose_edges = np.array(lines.pose_edges, dtype=np.int64).reshape(-1, 2)
    point_edges = np.array(lines.point_edges, dtype=np.int64).reshape(-1, 2)
    pose_numbers = np.array(lines.pose_numbers).reshape(-1, 9)
    point_numbers = np.array(lines.point_numbers).reshape(-1, 5)
    information = _information(pose_numbers[:, 3:], lines.pose_tags, edge2)
    point_information = _information(point_numbers[:, 2:], lines.point_tags, edge2)
    for matrices, where in ((information, lines.pose_lines), (point_information, lines.point_lines)):
        if len(matrices):
            beyond = ~np.isfinite(matrices).all(axis=(1, 2))
            if np.any(beyond):
                raise FormatError(
                    path,
                    where[int(np.argmax(beyond))],
                    "the square-root information is so large that its square overflows",
                )
            smallest = np.linalg.eigvalsh(matrices)[:, 0]
            bad = smallest < -1e-9 * np.abs(matrices).max(axis=(1, 2))
            if np.any(bad):
                k = int(np.argmax(bad))
                raise FormatError(
                    path, where[k], f"the information is not positive semi-definite (eigenvalue {smallest[k]:.3g})"
                )
    # g2o's residual is turned by R(theta_z)' against ours
    turn = np.broadcast_to(np.eye(3), (len(pose_edges), 3, 3)).copy()
    turn[:, :2, :2] = rotation(pose_numbers[:, 2])
    information = turn @ information @ np.swapaxes(turn, 1, 2)

    pose_values, landmark_values = lines.poses, lines.landmarks
    if not pose_values and not landmark_values:
        pose_values, landmark_values = _laid_out(pose_edges, pose_numbers, point_edges, point_numbers)
        for k, (i, _) in enumerate(lines.pose_edges + lines.point_edges):
            if i not in pose_values:
                first = next(iter(pose_values))
                raise FormatError(
                    path, (lines.pose_lines + lines.point_lines)[k], f"the graph falls into pieces: no edges lead from "
                    f"pose {first} to pose {i}; add the edge that ties them, or give all vertices"
                )  # fmt: skip
    for edges, where, ends in (
        (pose_edges, lines.pose_lines, (pose_values, pose_values)),
        (point_edges, lines.point_lines, (pose_values, landmark_values)),
    ):
        for column, vertices in enumerate(ends):
            absent = ~np.isin(edges[:, column], np.fromiter(vertices, dtype=np.int64, count=len(vertices)))
            if np.any(absent):
                k = int(np.argmax(absent))
                kind = "pose" if vertices is pose_values else "landmark"
                raise FormatError(
                    path, where[k], f"the edge uses {kind} {edges[k, column]}, which no vertex line gives"
                )
    for node, line in lines.fixed.items():
        if node not in pose_values:
            raise FormatError(path, line, f"FIX names node {node}, which is no pose of the file")
    pose_ids = np.array(sorted(pose_values), dtype=np.int64)
    landmark_ids = np.array(sorted(landmark_values), dtype=np.int64)
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
        point_measured=point_numbers[:, :2],
        point_information=point_information,
    )


def _information(entries: Array, tags: list[str], edge2: str) -> Array:
    """The symmetric matrices (E, d, d) of their entries (E, 6 or 3) in the order of each tag's dialect."""
    d = 3 if entries.shape[1] == 6 else 2
    dialects = np.array([_DIALECT_OF.get(tag, edge2) for tag in tags], dtype="U4")
    found = np.zeros((len(entries), d, d))
    for dialect in np.unique(dialects).tolist():
        those = dialects == dialect
        rows, columns = np.triu_indices(d)
        if dialect == "toro":
            rows, columns = np.array([0, 0, 1, 2, 0, 1]), np.array([0, 1, 1, 2, 2, 2])
        matrices = np.zeros((int(those.sum()), d, d))
        matrices[:, rows, columns] = entries[those]
        if dialect == "isam":
            with np.errstate(over="ignore", invalid="ignore"):
                matrices = np.swapaxes(matrices, 1, 2) @ matrices
        else:
            matrices[:, columns, rows] = entries[those]
        found[those] = matrices
    return found


def _laid_out(
    pose_edges: np.ndarray, pose_numbers: Array, point_edges: np.ndarray, point_numbers: Array
) -> tuple[dict[int, list[float]], dict[int, list[float]]]:
    """Initial values of all nodes that edges lead to from the first pose, odometry first."""
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
                    placed[there] = compose(placed[here], pose_numbers[k, :3])
                    queue.appendleft(there)
                else:
                    ahead.append((there, k, backwards, here))
        else:
            there, k, backwards, here = ahead.popleft()
            if there not in placed:
                step = inverse(pose_numbers[k, :3]) if backwards else pose_numbers[k, :3]
                placed[there] = compose(placed[here], step)
                queue.append(there)
    landmarks: dict[int, list[float]] = {}
    for (i, j), z in zip(point_edges.tolist(), point_numbers):
        if j not in landmarks and i in placed:
            landmarks[j] = transform(placed[i], z[:2]).tolist()
    return {k: pose.tolist() for k, pose in placed.items()}, landmarks


def write_g2o(data: PoseGraphFile, path: Path) -> None:
    """Write a file in g2o's dialect, numbers at full precision, whole or not at all."""
    out = [f"VERTEX_SE2 {k} {_numbers(pose)}" for k, pose in zip(data.pose_ids.tolist(), data.poses)]
    out += [f"VERTEX_XY {k} {_numbers(m)}" for k, m in zip(data.landmark_ids.tolist(), data.landmarks)]
    out += [f"FIX {k}" for k in data.fixed]
    turn = np.broadcast_to(np.eye(3), (len(data.pose_edges), 3, 3)).copy()
    turn[:, :2, :2] = rotation(-data.pose_measured[:, 2])
    information = turn @ data.pose_information @ np.swapaxes(turn, 1, 2)
    upper = np.triu_indices(3)
    for (i, j), z, omega in zip(data.pose_edges.tolist(), data.pose_measured, information):
        out.append(f"EDGE_SE2 {i} {j} {_numbers(z)} {_numbers(omega[upper])}")
    upper = np.triu_indices(2)
    for (i, j), z, omega in zip(data.point_edges.tolist(), data.point_measured, data.point_information):
        out.append(f"EDGE_SE2_XY {i} {j} {_numbers(z)} {_numbers(omega[upper])}")
    with write_whole(path) as temporary:
        temporary.write_text("\n".join(out) + "\n", encoding="utf-8")


def _numbers(values: Array) -> str:
    return " ".join(map(repr, values.tolist()))
