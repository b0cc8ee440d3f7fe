"""`calibrate`: the noise models of logs, from the logs or their files."""

from __future__ import annotations

from dataclasses import replace
from os import PathLike
from typing import Any

import graphslam
from graphslam import Log, OptionError, SensorModel
from graphslam.calibration import Calibration

from .options import CalibrationOptions
from .reading import read_log


def calibrate(
    log: Log | str | PathLike[str] | None = None, *others: Log | str | PathLike[str], **options: Any
) -> Calibration:
    """Estimate the noise of motion and sensor, and what is wrong with all sightings and controls.

    Args:
        log, others: logs, or files or folders of such; all of one kind of robot. None stands for the sample log.
        options: the fields of `options.CalibrationOptions`: source, gaussian, robots, sensor_offset, and
            those that read a log.

    Raises:
        FormatError: a file cannot be read.
        LogError: the logs do not determine the noise.
        OptionError: an option is unknown or impossible.
    """
    given = CalibrationOptions.of(**options)
    if given.robots is not None and given.robot is not None:
        raise OptionError("robot and robots exclude each other: name all of them in robots")
    readings = [given] if given.robots is None else [replace(given, robot=robot) for robot in given.robots]
    logs = [read_log(each, reading)[0] for each in (log, *others) for reading in readings]
    sensor = (logs[0].sensor or SensorModel()).changed(**given.of_component("sensor"))
    degrees = float("inf") if given.gaussian else None
    return graphslam.calibrate(*logs, source=given.source, sensor=sensor, degrees=degrees)
