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

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from graphslam import FormatError, Log, MotionModel, OptionError, SensorModel
from graphslam.calibration import Calibration
from graphslam.checks import check_positive
from graphslam.files import write_whole

from .config import MODELS, models, read_model
from .toml_files import TomlFile, to_toml

_RANGES = ("scale", "bias")


@dataclass(frozen=True, kw_only=True)
class Noise:
    """What a noise file says.

    Attributes:
        motion, sensor: {"nn": 0.19, ...}, the numbers that the file has of each model.
        range_scale, range_bias: measured range = range_scale * range + range_bias [m].
    """

    motion: dict[str, Any]
    sensor: dict[str, Any]
    range_scale: float = 1.0
    range_bias: float = 0.0

    def apply(self, log: Log) -> Log:
        """The log with these models as its own; its ranges are as they were.

        Raises:
            OptionError: the numbers go ill with those that the log has.
        """
        motion = replace(log.motion or MotionModel(), **self.motion) if self.motion else log.motion
        sensor = replace(log.sensor or SensorModel(), **self.sensor) if self.sensor else log.sensor
        return log.replace(motion=motion, sensor=sensor)


def read_noise(path: Path) -> Noise:
    """Read a noise file.

    Raises:
        FormatError: it is not TOML, has an unknown key, or a number that is impossible; with the line.
    """
    file = TomlFile(path)
    file.check_keys(file.table, (*MODELS, "ranges"))
    if not file.table:
        raise FormatError(path, None, "no noise in this file: it needs some of the tables [motion], [sensor], [ranges]")
    said = {
        name: dict(read_model(file, file.table, name, name)) if name in file.table else {} for name in MODELS
    }  # fmt: skip
    ranges = file.value(file.table, "ranges", dict) or {}
    file.check_keys(ranges, _RANGES, "ranges")
    scale, bias = (file.value(ranges, key, float, where="ranges") for key in _RANGES)
    try:
        models({f"{name}.{key}": value for name, table in said.items() for key, value in table.items()})
        if scale is not None:
            check_positive(scale=scale)
        if bias is not None and not math.isfinite(bias):
            raise OptionError(f"bias must be a finite number, not {bias!r}")
    except OptionError as error:
        # the sentence begins with the name of the number
        raise file.error(str(error).split()[0], str(error)) from None
    return Noise(
        **said, range_scale=1.0 if scale is None else scale, range_bias=0.0 if bias is None else bias
    )  # fmt: skip


def write_noise(found: Calibration, path: Path, log: str) -> None:
    """Write what a calibration found, whole or not at all; `read_noise` reads the same numbers back.

    Args:
        found: the noise.
        path: of the file.
        log: what it was found from, for the head of the file.

    Raises:
        FormatError: the place cannot be written.
    """
    table = {
        "motion": None if found.motion is None else asdict(found.motion),
        # psi's noise stays what the reader of the file has where nothing was seen of psi
        "sensor": {k: v for k, v in asdict(found.sensor).items() if k == "offset" or k in found.numbers},
        "ranges": {"scale": found.range_scale, "bias": found.range_bias},
    }
    comment = "\n".join([f"The noise of {log}, from {found.source}; read by slam-compare run --noise.", *found.notes])
    with write_whole(path) as temporary:
        temporary.write_text(to_toml(table, comment), encoding="utf-8")
