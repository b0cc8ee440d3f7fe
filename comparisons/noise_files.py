"""Noise models as a small TOML file: ``slam-compare calibrate`` writes it, ``slam-compare run --noise`` reads it.

    [motion]        # the numbers of `graphslam.MotionModel`; absent where the log has no controls
    nn = 0.19
    [sensor]        # those of `graphslam.SensorModel`
    bearing_std = 0.05
    [ranges]        # measured range = scale * range + bias [m]
    scale = 1.02
    bias = 0.03

Every table may be absent, and so may every number: then it is that of the log, else the book's.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from graphslam import FormatError, SensorModel
from graphslam.calibration import Calibration
from graphslam.errors import printable
from graphslam.files import write_whole

from .option import options_of
from .options import MODELS, NoiseOptions
from .toml_files import TomlFile, to_toml

_RANGES = ("scale", "bias")


def read_noise(path: Path) -> tuple[dict[str, Any], dict[str, float]]:
    """Read a noise file.

    Returns:
        The numbers of the noise models by the names of their options, {"nn": 0.19, ...}; and the line of the ranges,
        {"range_scale": 1.02, "range_bias": 0.03}, as far as the file has it.

    Raises:
        FormatError: it is not TOML, has an unknown key, or an impossible number; with the line.
    """
    file, known = TomlFile(path), options_of(NoiseOptions)
    file.check_keys(file.table, (*MODELS, "ranges"))
    if not file.table:
        raise FormatError(path, None, "no noise in this file: it needs some of the tables [motion], [sensor], [ranges]")
    models = {key: table for key, table in file.table.items() if key in MODELS}
    numbers = file.options(models, {name: each for name, each in known.items() if each.model})
    ranges = file.value(file.table, "ranges", dict) or {}
    file.check_keys(ranges, _RANGES, "ranges")
    line = {f"range_{key}": file.value(ranges, key, float, where="ranges") for key in _RANGES if key in ranges}
    for name, value in line.items():
        file.checked(known[name], value, name.replace("_", "s.", 1))
    return numbers, line


def write_noise(result: Calibration, path: Path, log: str) -> None:
    """Write the result of a calibration, whole or not at all; `read_noise` reads the same numbers back.

    Args:
        result: the noise.
        path: of the file.
        log: the name of the log that it was estimated from, for the head of the file.

    Raises:
        FormatError: the file cannot be written.
    """
    place = {k for k in SensorModel.GEOMETRY if k == "offset" or getattr(result.sensor, k) != getattr(SensorModel(), k)}
    table = {
        "motion": None if result.motion is None else asdict(result.motion),
        # the noise of psi stays that of the reader where no orientation was measured
        "sensor": {k: v for k, v in asdict(result.sensor).items() if k in result.numbers or k in place},
        "ranges": {"scale": result.range_scale, "bias": result.range_bias},
    }
    comment = [f"The noise of {printable(log)}, from {result.source}; read by slam-compare run --noise.", *result.notes]
    with write_whole(path) as temporary:
        temporary.write_text(to_toml(table, "\n".join(comment)), encoding="utf-8")
