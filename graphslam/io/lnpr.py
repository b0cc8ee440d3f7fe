"""The text format of the lectures' book (LNPR, R. Ueda), with and without controls.

Lines, in the order of the steps::

    delta DT            seconds per step; only in logs with controls
    u t NU OMEGA        control that *leaves* pose t [m/s, rad/s]
    x t X Y THETA       dead-reckoned pose [m, m, rad]; t counts 0, 1, 2, ... without a gap
    z t ID L PHI PSI    sighting from pose t: landmark id, range [m], bearing, orientation [rad]

The slides' u_t arrives at pose t; here, as in the book's files, line ``u t`` leaves it, which is row t of
`Log.controls`. A control after the last pose moves nothing: it is dropped, with a note. Sightings without PSI are
read where no line has it (our extension: the book's camera always measures it). The book's robot sees a landmark at
most once in a step; a second sighting is an error. Logs with controls bring the noise models of the book, with which they are
made.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import FormatError, quoted
from ..files import number, read_text, whole, write_text
from ..log import Log
from ..log.rows import ReadOptions, sound_sightings
from ..models import MotionModel, SensorModel
from ..se2 import Array
from .base import Format, errors_name

#: the columns of each kind of line; the last one of z may be missing
_COLUMNS = {"delta": "DT", "u": "t NU OMEGA", "x": "t X Y THETA", "z": "t ID RANGE BEARING PSI"}


def _recognises(_: Path, head: bytes) -> bool:
    # most of the first lines are enough, so that the reader can name the line that is wrong in a damaged file
    tags = [line.split()[0] for line in head.decode("utf-8", errors="replace").splitlines() if line.strip()]
    return sum(tag in _COLUMNS for tag in tags) > len(tags) / 2


class _Reader:
    """Collects the lines of one file."""

    def __init__(self, path: Path, strict: bool = False) -> None:
        self.path, self.line, self.strict = path, 0, strict
        self.delta: float | None = None
        self.controls: list[list[float]] = []
        self.poses: list[list[float]] = []
        self.sightings: list[list[float]] = []
        #: the line, step and landmark of each sighting
        self.seen: list[tuple[int, int, int]] = []

    def error(self, message: str) -> FormatError:
        return FormatError(self.path, self.line or None, message)

    def take(self, line: int, tag: str, words: list[str]) -> None:
        self.line = line
        if tag not in _COLUMNS:
            raise self.error(f"unknown line tag {quoted(tag)}; expected delta, u, x or z")
        columns = _COLUMNS[tag].split()
        if len(words) != len(columns) and (tag, len(words)) != ("z", 4):
            form = f"{tag} {_COLUMNS[tag].replace('PSI', '[PSI]')}"
            message = f"expected {quoted(form)}, found {1 + len(words)} columns in {quoted(' '.join([tag, *words]))}"
            raise self.error(message)
        names = {"t": "the step number"}
        integers = [whole(self.path, line, names.get(c, c), w) for c, w in zip(columns, words) if c in ("t", "ID")]
        numbers = [(c, w) for c, w in zip(columns, words) if c not in ("t", "ID")]
        values = [number(self.path, line, c, w, finite=tag != "z") for c, w in numbers]
        if tag == "delta":
            if self.delta is not None:
                raise self.error("a second delta line; a log has one step time")
            (self.delta,) = values
            if self.delta <= 0:
                raise self.error(f"delta is {words[0]}; a step must last longer than 0 s")
        elif tag == "z":
            self.take_sighting(integers[0], integers[1], values)
        else:
            rows = self.controls if tag == "u" else self.poses
            if (step := integers[0]) != (expected := len(rows)):
                how = "jumps" if step > expected else ("repeats" if step == expected - 1 else "runs backwards")
                raise self.error(f"step number {how}: expected '{tag} {expected}', found '{tag} {step}'")
            if tag == "u" and self.delta is None:
                raise self.error("a control before any delta line; a log with controls begins with 'delta DT'")
            rows.append(values)

    def take_sighting(self, step: int, landmark: int, values: list[float]) -> None:
        current = len(self.poses) - 1
        if step != current:
            how = "runs backwards" if 0 <= step < current else "jumps"
            latest = f"'x {current}'" if current >= 0 else "missing"
            raise self.error(f"step number {how}: a sighting of step {step}, but the latest pose line is {latest}")
        if self.sightings and len(values) != len(self.sightings[0]):
            have, other = "has no PSI" if len(values) == 2 else "has PSI", self.seen[0][0]
            raise self.error(f"this sighting {have}, unlike line {other}; all must be alike")
        self.seen.append((self.line, step, landmark))
        self.sightings.append(values)

    def sound(self) -> tuple[np.ndarray, Array, tuple[str, ...]]:
        """Steps and landmarks (M, 2) and sightings that can be, and notes on others."""
        seen, sightings = np.array(self.seen or np.empty((0, 3), int)), np.array(self.sightings or np.empty((0, 3)))
        kept, notes = sound_sightings(
            sightings, lambda k, text: FormatError(self.path, int(seen[k, 0]), text), strict=self.strict
        )
        lines = dict[tuple[int, int], int]()
        for line, step, landmark in seen[kept].tolist():
            if (earlier := lines.setdefault((step, landmark), line)) != line:
                again = f"landmark {landmark} is seen twice in step {step} (first in line {earlier}); remove one"
                raise FormatError(self.path, line, again)
        return seen[kept, 1:], sightings[kept], notes

    def log(self) -> Log:
        motions, notes, controlled = len(self.poses) - 1, [], self.delta is not None
        if not self.poses:
            raise self.error("no pose line ('x t X Y THETA') in the whole file")
        if controlled and len(self.controls) not in (motions, motions + 1):
            raise self.error(f"{len(self.poses)} poses need {motions} controls, found {len(self.controls)}")
        if controlled and len(self.controls) > motions:
            notes.append(f"the control of line 'u {motions}' leaves the last pose and moves nothing: dropped")
        seen, sightings, about = self.sound()
        return Log(
            dt=np.full(motions, self.delta) if controlled else None,
            controls=np.array(self.controls[:motions]).reshape(-1, 2) if controlled else None,
            steps=seen[:, 0],
            landmarks=seen[:, 1],
            sightings=sightings,
            initial_poses=np.array(self.poses),
            # logs in this format are made with the noise of the book
            motion=MotionModel() if controlled else None,
            sensor=SensorModel() if controlled else None,
            name=self.path.stem,
            notes=(*notes, *about),
        )


def _read(path: Path, options: ReadOptions) -> Log:
    reader = _Reader(path, options.strict)
    for line, content in enumerate(read_text(path).splitlines(), start=1):
        if words := content.split():
            reader.take(line, words[0], words[1:])
    with errors_name(path):
        return reader.log()


def _write(log: Log, path: Path) -> None:
    pairs, models = np.column_stack([log.steps, log.landmarks]), (log.motion, log.sensor)
    of_book = (None, None) if log.dt is None else (MotionModel(), SensorModel())
    obstacles = {
        "the truth": log.true_poses is not None or log.true_landmarks is not None,
        "motions of several controls": log.composite,
        "a log with controls but without motions": log.dt is not None and len(log.dt) == 0,
        "steps of different length": log.dt is not None and len(np.unique(log.dt)) > 1,
        "sightings of landmarks without ids": not log.identified,
        "other noise than the book's, which its logs with controls have": models != of_book
        and not (log.simulated and models == (None, None)),
        "a start time": log.start_time != 0,
        "two sightings of one landmark in one step": len(np.unique(pairs, axis=0)) < len(pairs),
        "the classes of sightings": log.classes is not None,
        **{name.replace("_", " "): True for name in log.measured},
        "several sessions": len(log.sessions) > 0,
        "biases that were taken out": bool(log.uncertain),
    }
    for what, present in obstacles.items():
        if present:
            raise FormatError(path, None, f"the format 'lnpr' cannot hold {what}; save the log as .npz instead")
    out = [] if log.dt is None else [f"delta {float(log.dt[0])!r}"]
    starts = np.searchsorted(log.steps, np.arange(log.num_poses + 1))
    for t, pose in enumerate(log.initial_poses.tolist()):
        if log.controls is not None and t < len(log.controls):
            out.append(f"u {t} " + " ".join(map(repr, log.controls[t].tolist())))
        out.append(f"x {t} " + " ".join(map(repr, pose)))
        for k in range(starts[t], starts[t + 1]):
            out.append(f"z {t} {log.landmarks[k]} " + " ".join(map(repr, log.sightings[k].tolist())))
    write_text(path, "\n".join(out) + "\n")


FORMAT = Format("lnpr", _recognises, _read, _write, (".txt", ".lnpr"))
