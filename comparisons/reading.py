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
from graphslam.calibration.from_truth import knows_enough
from graphslam.errors import quoted
from graphslam.files import check_file
from graphslam.identification.robot import TAKEN, known_robot
from graphslam.keyframes import with_poses_every

from .noise_files import read_noise
from .option import options_of
from .options import AUTO, BOOK, CORRECTIONS, LogOptions, NoiseOptions, ReadingOptions

Given = TypeVar("Given", bound=LogOptions)

#: options that only a file or folder has; a `Log` has been read already
OF_FILES = ("format", "robot", "strict")


def prepare(log: Log | str | PathLike[str] | None, options: Given) -> tuple[Log, Path | None, Given]:
    """The log as the options want it, its file or folder, and the options with the noise models filled in.

    Args:
        log: a log, a file or folder, or None for the sample log of the package.
        options: their reading and noise options are applied.

    Returns:
        The log; where it came from, None for a `Log`; the options, whose noise models are those of the options, else
        those of the noise file, else those of the log, else those estimated from it, else the book's. Its ``noise`` is
        `AUTO` where they were estimated and None otherwise, and its ``numbers`` are those of the filters.

    Raises:
        FormatError: a file cannot be read.
        LogError: the log lacks what is asked for, or a corrected range would not be above zero.
        OptionError: an option does not apply to this log.
    """
    data, source = read_log(log, options)
    recorded = data
    data, values = _with_noise(data, options)
    values |= {name: value for name in values if (value := getattr(options, name)) is not None}
    data = data.corrected(**values)
    corrected: dict[str, Any] = {n: None if value == CORRECTIONS[n] else value for n, value in values.items()}
    estimated = data is not recorded and any(note.startswith(TAKEN) for note in data.notes[len(recorded.notes) :])
    # the place of the sensor that was given is where the estimate began
    numbers = {n: v for n, v in options.numbers.items() if not (estimated and n in SensorModel.GEOMETRY)}
    motion, sensor = replace(options, numbers=numbers).models(data.motion, data.sensor)
    if options.max_range is not None:
        # what is farther away has been left out, so that the sensor does not see it
        sensor = replace(sensor, max_range=min(sensor.max_range, options.max_range))
    others = {name: number for name, number in options.numbers.items() if name not in options_of(NoiseOptions)}
    noise = AUTO if estimated else None
    return data, source, replace(options, motion=motion, sensor=sensor, noise=noise, numbers=others, **corrected)


def _with_noise(log: Log, options: LogOptions) -> tuple[Log, dict[str, float]]:
    """The log with the noise models that the option ``noise`` asks for as its own, and its corrections."""
    values = dict(CORRECTIONS)
    if options.noise not in (None, AUTO, BOOK):
        assert options.noise is not None
        numbers, of_file = read_noise(options.noise)
        motion, sensor = NoiseOptions.of(**numbers).models(log.motion, log.sensor)
        if log.controls is None:
            # a noise file of other logs of the robot may correct odometry that this one has not
            of_file = {name: value for name, value in of_file.items() if name.startswith("range")}
        return log.replace(motion=motion, sensor=sensor), values | of_file
    if options.noise is None and _gives_noise(options):
        return log, values
    if options.noise == AUTO and not log.identified:
        # the sensor of the options has the place of the sensor
        log, found = _calibrated(log, options.models(log.motion, log.sensor)[1])
        return log, values if found is None else values | found.corrections
    place = {name: value for name, value in options.of_component("sensor").items() if name in SensorModel.GEOMETRY}
    if place:
        log = log.replace(sensor=replace(log.sensor or SensorModel(), **place))
    try:
        return known_robot(log, None if options.noise is None else str(options.noise)), values
    except (GraphError, LogError) as error:
        return log.replace(notes=(*log.notes, f"noise auto kept {_kept(log)}: {error}")), values


def _gives_noise(options: LogOptions) -> bool:
    """Whether options give noise models, numbers of them, or corrections."""
    numbers = options.of_component("motion") | options.of_component("sensor")
    given = options.motion or options.sensor or any(getattr(options, name) is not None for name in CORRECTIONS)
    return bool(given or numbers.keys() - set(SensorModel.GEOMETRY))


def _kept(log: Log) -> str:
    return "the noise models of the log" if log.motion or log.sensor else "the book's noise models"


def _calibrated(log: Log, sensor: SensorModel) -> tuple[Log, Calibration | None]:
    """The log without ids with noise from its own residuals, and a note that says so or why its checks fail."""
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
                if knows_enough(log)
                else "calibrate with --scale odometry or ranges, and run with that noise file"
            )
    except (GraphError, LogError) as error:
        reason = str(error)
    if found is None or reason:
        return log.replace(notes=(*log.notes, f"noise auto kept {_kept(log)}: {reason}")), None
    numbers = ", ".join(f"{n} {v:.3g}" for n, v in found.numbers.items() if v != CORRECTIONS.get(n, 0.0))
    note = f"{TAKEN}: {numbers}"
    return log.replace(notes=(*log.notes, note), motion=found.motion, sensor=found.sensor), found


def read_log(log: Log | str | PathLike[str] | None, options: ReadingOptions) -> tuple[Log, Path | None]:
    """The log that the reading options ask for, and its file or folder; None for a `Log`."""
    source = None
    if isinstance(log, Log):
        data = log
        for name in OF_FILES:
            if (value := getattr(options, name)) is not None and value is not False:
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
