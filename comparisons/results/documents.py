"""The JSON of result objects, without NaN: what a class shows of itself, and the objects that exist only for the JSON,
such as the errors in each of several logs that were solved together (`errors_of_sessions`).

A result is declared once. Its JSON has its fields under their names, without those that have ``repr=False``, and what its
class attribute ``shown`` names, {name in the JSON: property}. The schema (docs/schema.json) has the types from the
annotations and the sentences from the docstring: fields from "Attributes:", properties from their own docstrings.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from graphslam import Log
from graphslam.files import write_text
from graphslam.log.measurements import Session
from graphslam.metrics import METRICS, Errors, Metrics, evaluate

if TYPE_CHECKING:
    from ..comparison import Comparison


@cache
def shown_by(kind: type) -> dict[str, str]:
    """{name in the JSON: attribute} of a class of results."""
    return {f.name: f.name for f in fields(kind) if f.repr} | dict(getattr(kind, "shown", {}))


class Finite(list[Any]):
    """An array as lists of numbers that JSON can hold, null for what is not finite; `jsonable` leaves it as it is."""


def jsonable(value: Any) -> Any:
    """The value as JSON can hold it: results as `documents` says, keys as text, NaN and infinity as null."""
    # the types of most values first: a long log has millions of numbers
    if isinstance(value, (str, int, Finite)) or value is None:
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.ndarray):
        if value.dtype.kind == "f" and not np.isfinite(value).all():
            known = np.isfinite(value)
            value = value.astype(object)
            value[~known] = None
        elif value.dtype.kind not in "biuf":
            return jsonable(value.tolist())
        return Finite(value.tolist()) if value.ndim else jsonable(value.item())
    if isinstance(value, np.generic):
        return jsonable(value.item())
    if isinstance(value, (list, tuple)):
        return [jsonable(entry) for entry in value]
    if isinstance(value, Mapping):
        return {str(key): jsonable(entry) for key, entry in value.items()}
    if isinstance(value, Path):
        return str(value)
    if is_dataclass(kind := type(value)):
        return {name: jsonable(getattr(value, part)) for name, part in shown_by(kind).items()}
    return value


def json_text(payload: object) -> str:
    """A JSON document: numbers to their last digit, each pose or other row on a line, never NaN or Infinity."""
    return _laid_out(jsonable(payload), "\n") + "\n"


def _laid_out(value: Any, line: str) -> str:
    """Like json.dumps with indent, but what holds no further lists or objects stays on one line."""
    entries = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    if not any(isinstance(entry, (dict, list)) for entry in entries):
        return _one_line(value)
    inner = line + " "
    if isinstance(value, dict):
        parts = [f"{_one_line(key)}: {_laid_out(entry, inner)}" for key, entry in value.items()]
        return "{" + inner + f",{inner}".join(parts) + line + "}"
    if isinstance(value, Finite) and not (value[0] and isinstance(value[0][0], list)):
        # rows of numbers, all at once
        return "[" + inner + _AS_IT_IS(value)[1:-1].replace("], [", f"],{inner}[") + line + "]"
    return "[" + inner + f",{inner}".join(_laid_out(entry, inner) for entry in value) + line + "]"


def _one_line(value: Any) -> str:
    """JSON on one line; ASCII where a name has bytes that are not UTF-8, which JSON can hold as escapes only."""
    text = _AS_IT_IS(value)
    return text if text.isascii() or _SURROGATES.search(text) is None else _IN_ASCII(value)


_AS_IT_IS = json.JSONEncoder(allow_nan=False, ensure_ascii=False).encode
_IN_ASCII = json.JSONEncoder(allow_nan=False).encode
_SURROGATES = re.compile("[\ud800-\udfff]")


def json_line(value: Any) -> str:
    """A value as JSON on one line."""
    return _one_line(jsonable(value))


def write_json(payload: object, path: Path) -> None:
    """Write a JSON document whole or not at all.

    Raises:
        FormatError: the place cannot be written.
    """
    write_text(path, json_text(payload))


class Entry(dict[str, Any]):
    """An entry of the schema, which stands beside a type in `Annotated`."""

    __hash__ = object.__hash__  # type: ignore[assignment]


def one_of(*values: str | int) -> Entry:
    """The entry of a value that is one of a few."""
    return Entry({"enum": list(values)})


def _list_of(items: dict[str, Any], **more: Any) -> Entry:
    """The entry of a list."""
    return Entry({"type": "array", "items": items} | more)


def _numbers(description: str = "", **limits: int) -> Entry:
    """The entry of a list of numbers, null where unknown."""
    return _list_of({"anyOf": [{"type": "number"}, {"type": "null"}]}, description=description, **limits)


#: types with what the schema says of them
Count = Annotated[int, Entry({"type": "integer", "minimum": 0})]
Numbers = Annotated[np.ndarray, _numbers()]
Flags = Annotated[np.ndarray, _list_of({"type": "boolean"})]
Poses = Annotated[
    np.ndarray, _list_of(_numbers("x [m], y [m], heading [rad]; null where unknown", minItems=3, maxItems=3))
]
Position = Annotated[
    np.ndarray, _numbers("x, y [m] and, where the landmark has one, heading [rad]", minItems=2, maxItems=3)
]
Covariance = Annotated[
    np.ndarray, _list_of(_numbers(), minItems=2, maxItems=3, description="n rows of n numbers, n as long as the mean")
]
Band = Annotated[tuple[float, float], _numbers("lower and upper end", minItems=2, maxItems=2)]


@dataclass(frozen=True, kw_only=True)
class LogDocument:
    """The log that the estimators worked on.

    Attributes:
        name: of the log.
        file: file or folder it was read from.
        poses, sightings: their numbers.
        landmarks: number of landmarks seen.
        dimensions: columns of a sighting: 2 without, 3 with orientation psi.
        classes: number of sightings of each class; null without classes.
        simulated: whether `simulate` made it; all others count as real data.
        has_controls: whether there is odometry.
        controls: number of controls.
        poses_covered: number of poses whose ground truth is known.
        true_poses: the true trajectory.
        truth_offset: the point of the robot that `true_poses` are of: ahead and to the left of its pose [m].
        true_landmarks: the true map, by id.
        notes: remarks of the reader.
    """

    name: str
    file: Path | None
    poses: Count
    sightings: Count
    landmarks: Count
    dimensions: Annotated[int, one_of(2, 3)]
    classes: dict[str, int] | None
    simulated: bool
    has_controls: bool
    controls: Count | None
    poses_covered: Count
    true_poses: Poses | None
    truth_offset: Numbers
    true_landmarks: Mapping[int, Position] | None
    notes: tuple[str, ...]


def describe(log: Log, source: Path | None = None) -> LogDocument:
    """A log in a few numbers and with its ground truth, for JSON."""
    same = ("name", "simulated", "true_poses", "truth_offset", "true_landmarks", "notes")
    names, counts = np.unique(() if log.classes is None else log.classes[log.classified], return_counts=True)
    return LogDocument(
        file=source, poses=log.num_poses, sightings=len(log.steps), landmarks=len(log.landmark_ids),
        dimensions=log.sightings.shape[1], has_controls=log.controls is not None,
        classes=None if log.classes is None else dict(zip(map(str, names.tolist()), counts.tolist())),
        controls=None if log.controls is None else len(log.controls), poses_covered=int(np.count_nonzero(log.covered)),
        **{name: getattr(log, name) for name in same},
    )  # fmt: skip


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


@dataclass(frozen=True)
class SimulateDocument:
    """A simulated log.

    Attributes:
        file: the file written.
    """

    file: Path
    log: LogDocument


@dataclass(frozen=True, kw_only=True)
class AnimateDocument:
    """An animation.

    Attributes:
        file: the file written.
        estimator: the estimator that is animated.
        pictures: number of frames.
        steps: number of iterations or steps, the start included.
        fps: frames per second.
        bytes: size of the file.
        seconds: time of estimation and drawing [s].
        notes: remarks of the estimator.
        poses: the trajectory in the last frame.
    """

    file: Path
    log: LogDocument
    estimator: str
    pictures: Count
    steps: Count
    fps: float
    bytes: Count
    seconds: float
    notes: tuple[str, ...]
    poses: Poses
