"""The text format of the lectures' book (LNPR, R. Ueda), with and without controls.

Lines, in the order of the steps::

    delta DT            seconds per step; only in logs with controls
    u t NU OMEGA        control that *leaves* pose t [m/s, rad/s]
    x t X Y THETA       dead-reckoned pose [m, m, rad]; t counts 0, 1, 2, ... without a gap
    z t ID L PHI PSI    sighting from pose t: landmark id, range [m], bearing, orientation [rad]

The slides' u_t arrives at pose t; here, as in the book's files, line ``u t`` leaves it, which is row t of
`Log.controls`. A control after the last pose drives nothing: it is dropped, with a note. Sightings without PSI are
read where no line has it (our extension: the book's camera always measures it). The book's robot sees a landmark at
most once in a step; a second sighting is taken for a damaged file.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from ..errors import FormatError, LogError
from ..files import check_file, write_whole
from ..log import Log
from .base import Format

_COLUMNS = {
    "delta": (2,),
    "u": (4,),
    "x": (5,),
    "z": (5, 6),
}
_FORM = {"delta": "delta DT", "u": "u t NU OMEGA", "x": "x t X Y THETA", "z": "z t ID RANGE BEARING [PSI]"}


def _recognises(path: Path, head: bytes) -> bool:  # noqa: ARG001
    # damaged files are recognised by what most of their first lines are, so that the reader can say which line is wrong
    tags = [line.split()[0] for line in head.decode("utf-8", errors="replace").splitlines() if line.strip()]
    return sum(tag in _COLUMNS for tag in tags) > len(tags) / 2


def _number(path: Path, line: int, column: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise FormatError(path, line, f"{column} should be a number, not {text!r}") from None
    if not math.isfinite(value):
        raise FormatError(path, line, f"{column} is {text}; only finite numbers make sense here")
    return value


def _whole(path: Path, line: int, column: str, text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise FormatError(path, line, f"{column} should be a whole number, not {text!r}") from None


class _Reader:
    """Collects the lines of one file; each method takes one kind of line."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.delta: float | None = None
        self.controls: list[list[float]] = []
        self.poses: list[list[float]] = []
        self.steps: list[int] = []
        self.landmarks: list[int] = []
        self.sightings: list[list[float]] = []
        self.seen_at: dict[tuple[int, int], int] = {}
        self.lines: list[int] = []

    def take(self, line: int, words: list[str]) -> None:
        tag = words[0]
        if tag not in _COLUMNS:
            raise FormatError(self.path, line, f"unknown line tag {tag!r}; expected delta, u, x or z")
        if len(words) not in _COLUMNS[tag]:
            raise FormatError(
                self.path, line, f"expected {_FORM[tag]!r}, found {len(words)} columns in {' '.join(words)!r}"
            )
        getattr(self, f"take_{tag}")(line, words[1:])

    def take_delta(self, line: int, words: list[str]) -> None:
        if self.delta is not None:
            raise FormatError(self.path, line, "a second delta line; a log has one step time")
        self.delta = _number(self.path, line, "DT", words[0])
        if self.delta <= 0:
            raise FormatError(self.path, line, f"delta is {words[0]}; a step must last longer than 0 s")

    def counted(self, line: int, tag: str, word: str, expected: int) -> None:
        step = _whole(self.path, line, "the step number", word)
        if step != expected:
            how = "jumps" if step > expected else ("repeats" if step == expected - 1 else "runs backwards")
            raise FormatError(self.path, line, f"step number {how}: expected '{tag} {expected}', found '{tag} {step}'")

    def take_u(self, line: int, words: list[str]) -> None:
        self.counted(line, "u", words[0], len(self.controls))
        if self.delta is None:
            raise FormatError(
                self.path, line, "a control before any delta line; a log with controls begins with 'delta DT'"
            )
        self.controls.append([_number(self.path, line, *pair) for pair in zip(("NU", "OMEGA"), words[1:])])

    def take_x(self, line: int, words: list[str]) -> None:
        self.counted(line, "x", words[0], len(self.poses))
        self.poses.append([_number(self.path, line, *pair) for pair in zip(("X", "Y", "THETA"), words[1:])])

    def take_z(self, line: int, words: list[str]) -> None:
        step, landmark = _whole(self.path, line, "the step number", words[0]), _whole(self.path, line, "ID", words[1])
        current = len(self.poses) - 1
        if step != current:
            how = "runs backwards" if 0 <= step < current else "jumps"
            latest = f"'x {current}'" if current >= 0 else "missing"
            raise FormatError(
                self.path, line, f"step number {how}: a sighting of step {step}, but the latest pose line is {latest}"
            )
        values = [_number(self.path, line, *pair) for pair in zip(("RANGE", "BEARING", "PSI"), words[2:])]
        if values[0] <= 0:
            raise FormatError(self.path, line, f"range {words[2]} m; a range must be above zero")
        if self.sightings and len(values) != len(self.sightings[0]):
            have = "has no PSI" if len(values) == 2 else "has PSI"
            raise FormatError(self.path, line, f"this sighting {have}, unlike line {self.lines[0]}; all must be alike")
        first = self.seen_at.setdefault((step, landmark), line)
        if first != line:
            raise FormatError(
                self.path, line, f"landmark {landmark} is seen twice in step {step} (first in line {first}); remove one"
            )
        self.steps.append(step)
        self.landmarks.append(landmark)
        self.sightings.append(values)
        self.lines.append(line)

    def log(self, last_line: int) -> Log:
        motions, notes = len(self.poses) - 1, []
        if not self.poses:
            raise FormatError(self.path, last_line, "no pose line ('x t X Y THETA') in the whole file")
        if self.delta is not None and len(self.controls) not in (motions, motions + 1):
            raise FormatError(
                self.path, last_line, f"{len(self.poses)} poses need {motions} controls, found {len(self.controls)}"
            )
        if self.delta is not None and len(self.controls) > motions:
            notes.append(f"the control of line 'u {motions}' leaves the last pose and drives nothing: dropped")
        controls = np.array(self.controls[:motions]).reshape(-1, 2)
        return Log(
            dt=np.full(motions, self.delta) if self.delta is not None else None,
            controls=controls if self.delta is not None else None,
            steps=np.array(self.steps, dtype=np.int64),
            landmarks=np.array(self.landmarks, dtype=np.int64),
            sightings=np.array(self.sightings) if self.sightings else np.empty((0, 3)),
            initial_poses=np.array(self.poses),
            name=self.path.stem,
            notes=tuple(notes),
        )


def _read(path: Path) -> Log:
    check_file(path)
    reader, line = _Reader(path), 0
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise FormatError(path, None, "not a text file (it has bytes that are not UTF-8)") from None
    for line, content in enumerate(text.splitlines(), start=1):
        if content.strip():
            reader.take(line, content.split())
    try:
        return reader.log(line or 1)
    except LogError as error:
        raise error if isinstance(error, FormatError) else FormatError(path, None, str(error)) from None


def _write(log: Log, path: Path) -> None:
    cannot = None
    pairs = np.column_stack([log.steps, log.landmarks])
    if log.true_poses is not None or log.true_landmarks is not None:
        cannot = "the truth"
    elif log.composite:
        cannot = "motions of several controls"
    elif log.dt is not None and len(log.dt) == 0:
        cannot = "a log with controls but without motions"
    elif log.dt is not None and np.any(log.dt != log.dt[0]):
        cannot = "steps of different length"
    elif not log.identified:
        cannot = "sightings of landmarks without ids"
    elif log.motion is not None or log.sensor is not None:
        cannot = "noise models"
    elif log.start_time != 0:
        cannot = "a start time"
    elif len(np.unique(pairs, axis=0)) < len(pairs):
        cannot = "two sightings of one landmark in one step"
    if cannot is not None:
        raise FormatError(path, None, f"the format 'lnpr' cannot hold {cannot}; save the log as .npz instead")
    out = [] if log.dt is None else [f"delta {float(log.dt[0])!r}"]
    starts = np.searchsorted(log.steps, np.arange(log.num_poses + 1))
    for t, pose in enumerate(log.initial_poses.tolist()):
        if log.controls is not None and t < len(log.controls):
            out.append(f"u {t} " + " ".join(map(repr, log.controls[t].tolist())))
        out.append(f"x {t} " + " ".join(map(repr, pose)))
        for k in range(starts[t], starts[t + 1]):
            out.append(f"z {t} {log.landmarks[k]} " + " ".join(map(repr, log.sightings[k].tolist())))
    with write_whole(path) as temporary:
        temporary.write_text("\n".join(out) + "\n", encoding="utf-8")


FORMAT = Format("lnpr", (".txt", ".lnpr"), _recognises, _read, _write)
