"""Noise models and biases as a small TOML file: ``slam-compare calibrate`` writes it, ``slam-compare run --noise`` reads it.

    [motion]        # the numbers of `graphslam.MotionModel`; absent where the log has no controls
    nn = 0.19
    [sensor]        # those of `graphslam.SensorModel`
    bearing_std = 0.05
    [ranges]        # measured range = scale * range + bias [m]
    scale = 1.02
    bias = 0.03
    [odometry]      # recorded speed = wheel_scale * speed, recorded turn rate = turn_scale * turn rate + turn_rate_bias
    wheel_scale = 1.01                                                     # [rad/s] + curvature_bias [rad/m] * speed
    turn_scale = 1.02
    turn_rate_bias = 0.001
    curvature_bias = 0.002
    [sightings]     # measured bearing = bearing + bearing_bias [rad]; times that are late by sensor_delay [s]
    bearing_bias = 0.003
    sensor_delay = 0.03

Every table may be absent, and so may every number: then it is that of the log, else the book's.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from graphslam import FormatError, SensorModel
from graphslam.calibration import Calibration
from graphslam.errors import printable
from graphslam.files import write_whole

from .option import options_of
from .options import MODELS, NoiseOptions
from .toml_files import TomlFile, to_toml

#: the tables of corrections, whose keys are options: {table: {key: option}}
_CORRECTIONS = {
    "ranges": {"scale": "range_scale", "bias": "range_bias"},
    "odometry": {name: name for name in ("wheel_scale", "turn_scale", "turn_rate_bias", "curvature_bias")},
    "sightings": {name: name for name in ("bearing_bias", "sensor_delay")},
}


def read_noise(path: Path) -> tuple[dict[str, Any], dict[str, float]]:
    """Read a noise file.

    Returns:
        The numbers of the noise models by the names of their options, {"nn": 0.19, ...}; and the corrections,
        {"range_scale": 1.02, "range_bias": 0.03, "wheel_scale": 1.01, ...}, as far as the file has them.

    Raises:
        FormatError: it is not TOML, has an unknown key, or an impossible number; with the line.
    """
    file, known = TomlFile(path), options_of(NoiseOptions)
    tables = (*MODELS, *_CORRECTIONS)
    file.check_keys(file.table, tables)
    if not file.table:
        raise FormatError(path, None, f"no noise in this file: it needs some of the tables [{'], ['.join(tables)}]")
    models = {key: table for key, table in file.table.items() if key in MODELS}
    numbers = file.options(models, {name: each for name, each in known.items() if each.model})
    corrections: dict[str, float] = {}
    for table, keys in _CORRECTIONS.items():
        found = file.value(file.table, table, dict) or {}
        file.check_keys(found, keys, table)
        for key in found:
            value = file.value(found, key, float, where=table)
            corrections[keys[key]] = file.checked(known[keys[key]], value, f"{table}.{key}")
    return numbers, corrections


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
        **{
            table: {key: result.corrections[name] for key, name in keys.items() if name in result.corrections} or None
            for table, keys in _CORRECTIONS.items()
        },
    }
    head = f"The noise of {printable(log)}, from {result.source}; read by slam-compare run --noise."
    errors = ", ".join(f"{name} {error:.2g}" for name, error in result.errors.items() if error < np.inf)
    comment = [
        head,
        *([f"Standard errors: {errors}."] if errors else []),
        *result.notes,
        *(f"Not recommended: {doubt}" for doubt in result.doubts),
    ]
    with write_whole(path) as temporary:
        temporary.write_text(to_toml(table, "\n".join(comment)), encoding="utf-8")
