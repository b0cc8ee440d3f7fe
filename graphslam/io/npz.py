"""The framework's own format: a NumPy ``.npz`` archive that holds everything a `Log` holds, without rounding.

Arrays (absent = None): ``format`` ("graphslam-log-1"), ``dt`` (T,), ``controls`` (T, 2), ``steps`` (M,), ``landmarks``
(M,), ``sightings`` (M, 2 or 3), ``classes`` (M,), numbers or words, ``initial_poses`` (T+1, 3), ``true_poses`` (T+1, 3),
``truth_offset`` (2,; absent = at the robot's pose), ``true_landmark_ids`` (L,), ``true_landmark_poses`` (L, 3; a third
column of NaN marks a landmark without heading), ``start_time``, and for logs with several controls per motion
``control_starts`` (T+1,), ``control_variances`` (S, 3) or (S, 2), ``recorded_dt`` (S,) and ``true_path`` (S+1, 3);
``motion`` and ``sensor``, the fields of the noise models in their order, where the log has such models; ``notes`` (N,) and
``doubts`` (N, 2), texts; ``relations_first``, ``relations_second``, ``relations_motions``, ``relations_covariances`` and
``positions_steps``, ``positions_places``, ``positions_covariances``, ``positions_levers``, ``positions_datums``, the fields
of `PoseRelations` and `AbsolutePositions`; ``partial_sightings_steps`` and so on, those of `PartialSightings`;
``uncertain`` (K, 2), names and numbers as texts; ``sessions`` (N, 5), the fields of each as texts;
``simulated``, where `simulate` made the log. No pickles.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import astuple, fields
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FormatError, OptionError, SlamError, checks, reason_of
from ..files import check_file, read_archive, write_whole
from ..log import Log
from ..log.measurements import MEASURED, Session
from ..log.rows import ReadOptions, sound_sightings
from ..models import MotionModel, SensorModel
from ..se2 import Array
from .base import Format

VERSION = "graphslam-log-1"
_REQUIRED = ("steps", "landmarks", "sightings", "initial_poses")
_MODELS: dict[str, type[MotionModel | SensorModel]] = {"motion": MotionModel, "sensor": SensorModel}
_OPTIONAL = (
    "classes", "dt", "controls", "control_starts", "control_variances", "recorded_dt", "true_poses", "true_path",
    "truth_offset",
)  # fmt: skip


def _read(path: Path, options: ReadOptions) -> Log:
    check_file(path)
    content = read_archive(path, "a log")
    if str(content.get("format")) != VERSION:
        raise FormatError(path, None, f"the archive is not a log: its entry 'format' should be {VERSION!r}")
    if missing := [name for name in _REQUIRED if name not in content]:
        raise FormatError(path, None, f"the archive lacks the array {missing[0]!r}")
    try:
        notes = (*map(str, content.get("notes", ())), *_left_out(content, path, options.strict))
        models: dict[str, Any] = {}
        for name, model in _MODELS.items():
            if name in content:
                if content[name].shape != np.hstack(astuple(model())).shape:
                    raise OptionError(f"{name} must be numbers, one for each field of the model")
                numbers = iter(checks.real_array(content[name]).tolist())
                values: dict[str, Any] = {
                    f.name: (next(numbers), next(numbers)) if f.name == "offset" else next(numbers)
                    for f in fields(model)
                }
                models[name] = model(**values)
        measured: dict[str, Any] = {}
        for name, kind in MEASURED.items():
            arrays: dict[str, Any] = {f.name: content.get(f"{name}_{f.name}") for f in fields(kind)}
            if lacking := [field for field, array in arrays.items() if array is None]:
                if len(lacking) < len(arrays):
                    raise OptionError(f"the archive has {name} without the array {name}_{lacking[0]}")
            else:
                measured[name] = kind(**arrays)
        return Log(
            **models,
            **measured,
            **{name: content[name] for name in _REQUIRED},
            **{name: content[name] for name in _OPTIONAL if name in content},
            true_landmarks=_true_landmarks(content) if "true_landmark_ids" in content else None,
            start_time=float(checks.real_array(content.get("start_time", 0.0))),
            notes=notes,
            doubts=tuple((str(check), str(message)) for check, message in content.get("doubts", np.empty((0, 2)))),
            uncertain={str(name): float(number) for name, number in content.get("uncertain", np.empty((0, 2)))} or None,
            simulated=bool(content.get("simulated", False)),
            sessions=tuple(
                Session(str(name), int(start), float(time), *(float(number) if number else None for number in clock))
                for name, start, time, *clock in content.get("sessions", np.empty((0, 3)))
            ),
            name=path.stem,
        )
    except (SlamError, TypeError, ValueError) as error:
        raise FormatError(path, None, reason_of(error)) from None


def _left_out(content: dict[str, np.ndarray], path: Path, strict: bool) -> tuple[str, ...]:
    """Remove impossible sightings from the arrays of an archive; notes on them. `Log` refuses arrays of a wrong shape."""
    sightings = content["sightings"]
    if sightings.ndim != 2 or sightings.shape[1] not in (2, 3) or sightings.dtype.kind != "f":
        return ()
    kept, notes = sound_sightings(
        sightings, lambda k, text: FormatError(f"{path}: sighting {k}", None, text), strict=strict
    )
    for name in ("steps", "landmarks", "sightings", "classes"):
        if name in content and content[name].shape[:1] == kept.shape:
            content[name] = content[name][kept]
    return notes


def _true_landmarks(content: Mapping[str, np.ndarray]) -> dict[int, Array]:
    """The true map, {id: (x, y) or (x, y, heading)}.

    Raises:
        OptionError: there is not one row of three numbers for each id.
    """
    ids, poses = content["true_landmark_ids"], content.get("true_landmark_poses", np.empty(0))
    if ids.dtype.kind not in "iu" or ids.ndim != 1 or poses.shape != (len(ids), 3) or poses.dtype.kind not in "iuf":
        wanted = "true_landmark_ids must be whole numbers (L,) and true_landmark_poses numbers (L, 3)"
        raise OptionError(f"{wanted}, but their shapes are {ids.shape} and {poses.shape}")
    return {j: pose[:2] if np.isnan(pose[2]) else pose for j, pose in zip(ids.tolist(), poses)}


def _write(log: Log, path: Path) -> None:
    content = {name: getattr(log, name) for name in _REQUIRED}
    content |= {name: getattr(log, name) for name in _OPTIONAL if getattr(log, name) is not None}
    if log.truth_offset == (0.0, 0.0):
        del content["truth_offset"]
    if not log.composite:
        content.pop("control_starts", None)
    content |= {name: np.hstack(astuple(model)) for name, model in vars(log).items() if name in _MODELS and model}
    if log.true_landmarks is not None:
        content["true_landmark_ids"] = np.array(list(log.true_landmarks), dtype=np.int64)
        poses = [np.append(m, np.nan)[:3] for m in log.true_landmarks.values()]
        content["true_landmark_poses"] = np.array(poses).reshape(-1, 3)
    if log.simulated:
        content["simulated"] = np.array(True)
    if log.uncertain:
        content["uncertain"] = np.array([(name, repr(float(number))) for name, number in log.uncertain.items()])
    if log.sessions:
        rows = [[*vars(each).values()] for each in log.sessions]
        content["sessions"] = np.array([["" if value is None else str(value) for value in row] for row in rows])
    for name, measured in log.measured.items():
        content |= {f"{name}_{f.name}": getattr(measured, f.name) for f in fields(measured)}
    for name in ("notes", "doubts"):
        if texts := getattr(log, name):
            content[name] = np.array(texts)
    content |= {"format": np.array(VERSION), "start_time": np.array(log.start_time)}
    # at its default level the compression takes four times as long, for files that are a few percent smaller
    with (
        write_whole(path) as temporary,
        zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
    ):
        for name, values in content.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
                np.lib.format.write_array(entry, np.asarray(values), allow_pickle=False)


FORMAT = Format(
    "npz", lambda path, head: head.startswith(b"PK\x03\x04") and path.suffix != ".zip", _read, _write, (".npz",)
)
