"""From the reading and noise options to the log that the estimators work on."""

from __future__ import annotations

import hashlib
import warnings
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from graphslam import (
    Calibration,
    FormatError,
    GraphError,
    Log,
    LogError,
    OptionError,
    SensorModel,
    calibrate,
    load,
    sample_log_path,
)
from graphslam.errors import quoted
from graphslam.files import check_file
from graphslam.keyframes import with_poses_every

from .noise_files import read_noise
from .option import options_of
from .options import AUTO, AUTO_TOOK, CORRECTIONS, LogOptions, NoiseOptions, ReadingOptions

Given = TypeVar("Given", bound=LogOptions)

#: options that only a file or folder has; a `Log` has been read already
OF_FILES = ("format", "robot")


def prepare(log: Log | str | PathLike[str] | None, options: Given) -> tuple[Log, Path | None, Given]:
    """The log as the options want it, its file or folder, and the options with the noise models filled in.

    Args:
        log: a log, a file or folder, or None for the sample log of the package.
        options: their reading and noise options are applied.

    Returns:
        The log; where it came from, None for a `Log`; the options, whose noise models are those of the options, else
        those of the noise file, else those of the log, else the book's. Its ``noise`` is None, and its ``numbers`` are
        those of the filters.

    Raises:
        FormatError: a file cannot be read.
        LogError: the log lacks what is asked for, or a corrected range would not be above zero.
        OptionError: an option does not apply to this log.
    """
    data, source = read_log(log, options)
    motion, sensor = data.motion, data.sensor
    values: dict[str, Any] = dict(CORRECTIONS)
    if options.noise == AUTO:
        # the sensor of the options has the place of the sensor
        data, found = _calibrated(data, options.models(motion, sensor)[1])
        if found is not None:
            motion, sensor = found.motion, found.sensor
            values |= found.corrections
    elif options.noise is not None:
        numbers, of_file = read_noise(options.noise)
        motion, sensor = NoiseOptions.of(**numbers).models(motion, sensor)
        if data.controls is None:
            # a noise file of other logs of the robot may correct odometry that this one has not
            of_file = {name: value for name, value in of_file.items() if name.startswith("range")}
        values |= of_file
    values |= {name: value for name in values if (value := getattr(options, name)) is not None}
    data = data.corrected(**values)
    corrected: dict[str, Any] = {n: None if value == CORRECTIONS[n] else value for n, value in values.items()}
    motion, sensor = options.models(motion, sensor)
    if options.max_range is not None:
        # what is farther away has been left out, so that the sensor does not see it
        sensor = replace(sensor, max_range=min(sensor.max_range, options.max_range))
    others = {name: number for name, number in options.numbers.items() if name not in options_of(NoiseOptions)}
    return data, source, replace(options, motion=motion, sensor=sensor, noise=None, numbers=others, **corrected)


def _calibrated(log: Log, sensor: SensorModel) -> tuple[Log, Calibration | None]:
    """The noise of a log from its own residuals, None where its checks fail; and the log with a note that says so."""
    kept = "kept the noise models of the log" if log.motion or log.sensor else "kept the book's noise models"
    found = None
    try:
        found = calibrate(log, source="residuals", sensor=sensor)
        reason = "; ".join(found.doubts)
        if found.range_scale != 1 and not reason:
            reason = (
                f"ranges and odometry differ by a factor of {found.range_scale:.3f} in scale, and residuals do not tell "
                "which is wrong; "
            )
            reason += (
                "the true poses do: slam-compare calibrate this log, and run with that noise file"
                if log.true_poses is not None
                else "calibrate with --scale odometry or ranges, and run with that noise file"
            )
    except (GraphError, LogError) as error:
        reason = str(error)
    if found is None or reason:
        return log.replace(notes=(*log.notes, f"noise auto {kept}: {reason}")), None
    numbers = ", ".join(f"{n} {v:.3g}" for n, v in found.numbers.items() if v != CORRECTIONS.get(n, 0.0))
    return log.replace(notes=(*log.notes, f"{AUTO_TOOK}: {numbers}")), found


def read_log(log: Log | str | PathLike[str] | None, options: ReadingOptions) -> tuple[Log, Path | None]:
    """The log that the reading options ask for, and its file or folder; None for a `Log`."""
    source = None
    if isinstance(log, Log):
        data = log
        for name in OF_FILES:
            if getattr(options, name) is not None:
                raise OptionError(
                    f"{name} applies when a file is read, and {quoted(log.name)} is a Log that has been read"
                )
        if options.keep_every is not None:
            data = with_poses_every(data, options.keep_every)
    elif log is not None and not isinstance(log, (str, PathLike)):
        raise OptionError(f"a log is a Log, or the path of its file or folder, not {type(log).__name__}: {quoted(log)}")
    else:
        path = sample_log_path() if log is None else Path(log)
        keywords = {name: getattr(options, name) for name in (*OF_FILES, "keep_every")}
        with warnings.catch_warnings():
            # the warnings of a reader are also notes of the log, which are shown
            warnings.simplefilter("ignore", UserWarning)
            data = load(path, **keywords)
        # absolute, so that a repeated run from another folder writes the same
        source = path.absolute()
    if options.dimensions == 3 and not data.has_orientation:
        raise LogError(
            f"{data.name if isinstance(log, Log) else path}: the sightings have no orientation psi, but dimensions 3 "
            "requires it; use dimensions 2"
        )
    if options.truth_offset is not None:
        data = data.replace(truth_offset=options.truth_offset)
    if options.stride > 1:
        data = data.at_steps(np.arange(0, data.num_poses, options.stride))
    if options.max_range is not None:
        data = data.nearer_than(options.max_range)
    return (data.without_orientation() if options.dimensions == 2 else data), source


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file's content, in hexadecimal digits; of a folder, of the names and contents of its files.

    Raises:
        FormatError: a file cannot be read.
    """
    try:
        if path.is_dir():
            whole = hashlib.sha256()
            for inner in sorted(each for each in path.iterdir() if each.is_file()):
                whole.update(f"{inner.name}\n{sha256_of(inner)}\n".encode())
            return whole.hexdigest()
        check_file(path)
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise FormatError(path, None, f"cannot be read: {error.strerror}") from None
