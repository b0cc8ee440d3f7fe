"""TOML files of options: read with a clear message that names the line, and written again by the package ``tomli-w``.

A noise file has noise models and biases: ``slam-compare calibrate`` writes it (`write_noise`), ``slam-compare run --noise``
reads it (`read_noise`).

    [motion]        # the numbers of `graphslam.MotionModel`; absent where the log has no controls
    nn = 0.19
    [sensor]        # those of `graphslam.SensorModel`
    range_rate = 0.14
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

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from graphslam import FormatError, OptionError, SensorModel, files
from graphslam.calibration import Calibration
from graphslam.errors import printable, quoted
from graphslam.files import TYPE_NAMES, write_whole

from . import MODELS, NoiseOptions
from .declaration import Option, options_of


class TomlFile(files.TomlFile):
    """A TOML file of options."""

    def options(self, table: Mapping[str, Any], known: Mapping[str, Option], where: str = "") -> dict[str, Any]:
        """The options of a table, flat and checked; those of the noise models stand in tables [motion] and [sensor].

        Args:
            table: whose keys are read.
            known: the options, by name; see `declaration.options_of`.
            where: the name of the table, for messages.

        Raises:
            FormatError: a key is unknown or a value is impossible; with the line.
        """
        inside = {model: {n: o for n, o in known.items() if o.model == model} for model in MODELS}
        plain = {n: o for n, o in known.items() if o.model not in MODELS and o.only != "python"}
        for key in table:
            if key in known and known[key].model in MODELS:
                raise self.error(f"{where}.{key}" if where else key, f"{key} belongs in the table [{known[key].model}]")
        self.check_keys(table, (*plain, *(model for model in MODELS if inside[model])), where)
        values: dict[str, Any] = {}
        for key in table:
            place = f"{where}.{key}" if where else key
            if key in plain:
                values[key] = self.checked(plain[key], table[key], place)
            else:
                values |= self.options_of_model(self.value(table, key, dict, where=where), inside[key], place)
        return values

    def options_of_model(self, table: Mapping[str, Any], known: Mapping[str, Option], where: str) -> dict[str, Any]:
        """The numbers of one noise model in its table [motion] or [sensor], by the names of their options."""
        names = {name.removeprefix("sensor_"): name for name in known}
        self.check_keys(table, names, where)
        values = {key: self.checked(known[names[key]], table[key], f"{where}.{key}") for key in table}
        self.attempt(lambda: MODELS[where.rpartition(".")[2]]().changed(**values), where)
        return {names[key]: value for key, value in values.items()}

    def checked(self, option: Option, value: Any, place: str) -> Any:
        """The value of an option; ``place`` is its key.

        Raises:
            FormatError: the value is impossible; with the line.
        """
        try:
            if option.each is not str and option.each is not Path and isinstance(value, str):
                raise OptionError(f"{place} should be {TYPE_NAMES[option.each]}, not {quoted(value)}")
            return option.checked(value)
        except OptionError as error:
            raise self.error(place, str(error)) from None


def to_toml(table: Mapping[str, Any], comment: str = "") -> str:
    """A table as TOML: text, numbers, true and false, lists of these, and tables.

    Args:
        table: keys with None are left out, because TOML has no such value.
        comment: lines for the head of the file.
    """
    return "".join(f"# {line}\n" for line in comment.splitlines()) + tomli_w.dumps(_present(table))


def _present(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _present(entry) for key, entry in value.items() if entry is not None}
    if isinstance(value, (list, tuple)):
        return [_present(entry) for entry in value]
    return str(value) if isinstance(value, Path) else value


#: the tables of corrections, whose keys are options: {table: {key: option}}
_CORRECTIONS = {
    "ranges": {"scale": "range_scale", "bias": "range_bias"},
    "odometry": {name: name for name in ("wheel_scale", "turn_scale", "turn_rate_bias", "curvature_bias")},
    "sightings": {name: name for name in ("bearing_bias", "sensor_delay")},
}


def read_noise(path: Path) -> dict[str, Any]:
    """Read a noise file.

    Returns:
        The numbers of the noise models and the corrections by the names of their options, {"nn": 0.19, "range_scale": 1.02,
        ...}, as far as the file has them.

    Raises:
        FormatError: it is not TOML, has an unknown key, or an impossible number; with the line.
    """
    file, known = TomlFile(path), options_of(NoiseOptions)
    tables = (*MODELS, *_CORRECTIONS)
    file.check_keys(file.table, tables)
    if not file.table:
        raise FormatError(path, None, f"no noise in this file: it needs some of the tables [{'], ['.join(tables)}]")
    models = {key: table for key, table in file.table.items() if key in MODELS}
    found = file.options(models, {name: each for name, each in known.items() if each.model})
    for table, keys in _CORRECTIONS.items():
        corrections = file.value(file.table, table, dict) or {}
        file.check_keys(corrections, keys, table)
        for key in corrections:
            value = file.value(corrections, key, float, where=table)
            found[keys[key]] = file.checked(known[keys[key]], value, f"{table}.{key}")
    return found


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
    comment = [f"The noise of {printable(log)}, from {result.source}; read by slam-compare run --noise."]
    if errors := ", ".join(f"{name} {error:.2g}" for name, error in result.errors.items() if error < np.inf):
        comment.append(f"Standard errors: {errors}.")
    comment += [*result.notes, *(f"Not recommended: {doubt}" for doubt in result.doubts)]
    with write_whole(path) as temporary:
        temporary.write_text(to_toml(table, "\n".join(comment)), encoding="utf-8")
