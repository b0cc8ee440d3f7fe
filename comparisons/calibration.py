"""`calibrate`: the noise models of a log, from the log or its file."""

from __future__ import annotations

from os import PathLike
from typing import Any

import graphslam
from graphslam import Calibration, Log, SensorModel

from .options import CalibrationOptions
from .reading import read_log


def calibrate(log: Log | str | PathLike[str] | None = None, **options: Any) -> Calibration:
    """Estimate the noise of motion and sensor, range scale and range bias, by maximum likelihood.

    Args:
        log: a log, the file or folder of one, or None for the sample log of the package.
        options: the fields of `options.CalibrationOptions`: source, gaussian, sensor_offset, and those that read the log.

    Raises:
        FormatError: a file cannot be read.
        LogError: the log does not determine the noise.
        OptionError: an option is unknown or impossible.
    """
    given = CalibrationOptions.of(**options)
    data, _ = read_log(log, given)
    sensor = (data.sensor or SensorModel()).changed(**given.of_component("sensor"))
    degrees = float("inf") if given.gaussian else None
    return graphslam.calibrate(data, source=given.source, sensor=sensor, degrees=degrees)
