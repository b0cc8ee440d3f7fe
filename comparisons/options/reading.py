"""The log that the estimators work on, made from the reading and noise options; `calibrate` estimates the noise of logs.

Several logs of one place become one (`graphslam.join_logs`).
"""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

import graphslam
from graphslam import FormatError, GraphError, Log, LogError, MotionModel, OptionError, SensorModel, estimate_robot
from graphslam.association import known_noise
from graphslam.association.map_states import map_states, session_states
from graphslam.calibration import Calibration
from graphslam.errors import quoted
from graphslam.files import check_file, path_of
from graphslam.graph.build import noise_in_map
from graphslam.identification.corrections import honest_variances, without_biases
from graphslam.identification.declared import CORRECTIONS, of_sensor_alone, one_after_the_other
from graphslam.identification.known import enough_ids, unknown_noise
from graphslam.identification.result import ESTIMATE
from graphslam.identification.robot import with_checked_ids
from graphslam.io.formats import load_robots, robots_in
from graphslam.log.continuous_time import with_poses_every
from graphslam.log.rows import ReadOptions
from graphslam.maps.landmark_map import LandmarkMap, as_map
from graphslam.maps.tracking import in_frame_of
from graphslam.sessions import clock_offsets, join_robots, with_common_noise

from ..results import noted
from . import AUTO, BOOK, MODELS, CalibrationOptions, LogOptions, MapOptions, NoiseOptions, ReadingOptions
from .declaration import options_of
from .toml_files import read_noise

Given = TypeVar("Given", bound=LogOptions)

#: a log, or the file or folder of one; None is the sample log
LogOrPath = Log | str | PathLike[str] | None

#: a noise file does not fit a log that shows biases of so many standard errors after its corrections, or motions with so many
#: times its noise, or an n-th of it
DIFFERENT, TIMES = 6.0, 4.0
#: where noise options are given for a log whose noise is not known
NOT_ESTIMATED = (
    "noise or biases are given by options, so that nothing is estimated from this log; --noise auto estimates the rest"
)
#: options that only a file or folder has; a `Log` has been read already
OF_FILES = ("format", "robot", "strict")


def prepare(
    log: LogOrPath | Sequence[LogOrPath], options: Given, *, together: bool = False
) -> tuple[Log, Path | tuple[Path | None, ...] | None, Given]:
    """The log with the changes that the options ask for, its file or folder, and the options with the noise models filled in.

    Args:
        log: a log, a file or folder, or None for the sample log of the package; or several logs of one place, which are
            joined.
        options: their reading and noise options are applied.
        together: of a data set of several robots, of which none is named, all are joined (`graphslam.sessions`).

    Returns:
        The log; where it came from, None for a `Log`, or that of each of several; the options, whose noise models are those
        of the options, else those of the noise file, else those of the log, else those estimated from it, else the book's.
        Its ``noise`` is `AUTO` where they were estimated, with what was found as its ``calibration`` where there is one log,
        or the noise file; its ``numbers`` are those of filters and smoother. With a map the log is in its
        frame; ``landmark_map`` is the map without the landmarks that have moved, and ``landmark_states`` the state of all.

    Raises:
        FormatError: a file cannot be read.
        LogError: the log lacks what is asked for, or a corrected range would not be above zero.
        OptionError: an option does not apply to this log.
        GraphError: the log does not fit the map, or logs share no landmarks.
    """
    found: Calibration | None = None
    source: Path | tuple[Path | None, ...] | None
    logs: Sequence[Log]
    if isinstance(log, (list, tuple)):
        paths = [path_of(each).absolute() for each in log if isinstance(each, (str, PathLike))]
        if twice := [path for k, path in enumerate(paths) if path in paths[:k]]:
            raise OptionError(f"{twice[0].name} is named twice; its sightings would count twice, so name each log once")
        read = [read_log(each, options) for each in log]
        logs, source = [data for data, _ in read], tuple(path for _, path in read)
        data, values, estimated = _joined(logs, options, _of_one_place)
    elif together and (robots := _robots(log, options)):
        assert isinstance(log, (str, PathLike))
        source = path_of(log).absolute()
        unread: dict[str, Any] = dict.fromkeys(_of_load(options)) | {"strict": False}
        logs = [read_log(each, replace(options, **unread))[0] for each in robots.values()]
        data, values, estimated = _joined(logs, options, partial(_of_robots, robots))
    else:
        data, source = read_log(log, options)
        data, values, found = _with_noise(data, options)
        estimated = found is not None
    given = _given_corrections(options)
    corrected: dict[str, Any] = {n: None if v == CORRECTIONS[n] else v for n, v in (values | given).items()}
    # before an estimate they have been taken out
    values |= {} if options.noise == AUTO else given
    # the place of the sensor that was given is where the estimate began
    numbers = {n: v for n, v in options.numbers.items() if not (estimated and n in SensorModel.GEOMETRY)}
    motion, sensor = replace(options, numbers=numbers).models(data.motion, data.sensor)
    data = without_biases(data, motion=motion, sensor=sensor, **values)
    of_file = options.noise_content is not None or options.noise not in (None, AUTO, BOOK)
    check_ids = (of_file if options.check_ids is None else options.check_ids) and not estimated
    if (of_file or check_ids) and data.controls is not None:
        # a robot that is known has the noise of its estimate and, where rows are rare, how its speeds change within them
        data = data.replace(control_variances=honest_variances(data))
    if check_ids:
        data = _with_checked_ids(data, motion, sensor)
    known_map = _map_of(options)
    # without a file nobody reads the notes: it is the run of a study
    if of_file and options.noise_content is None and data.controls is not None:
        data = _compared_with_estimate(data, motion, sensor, known_map)
    if options.max_range is not None:
        # what is farther away has been left out, so that the sensor does not see it
        least, most, view = sensor.limits
        sensor = sensor.with_limits(least, min(most, options.max_range), view)
    in_map: dict[str, Any] = {}
    if known_map is not None:
        data, kept, notes = in_frame_of(data, known_map, motion=motion, sensor=sensor)
        in_map = {"landmark_map": kept}
        remarks = list(notes)
        with noted(remarks, "whether landmarks of the map have moved is not known"):
            states = map_states(data, known_map, motion=motion, sensor=sensor)
            remarks.append(states.sentence)
            in_map |= {"landmark_map": states.map, "landmark_states": states.landmarks}
        data = data.replace(notes=(*data.notes, *remarks))
    filled: dict[str, Any] = {
        "numbers": {name: number for name, number in options.numbers.items() if name not in options_of(NoiseOptions)},
        "noise": AUTO if estimated else options.noise if of_file else None, "motion": motion, "sensor": sensor,
        "calibration": found, "check_ids": check_ids or None,
    }  # fmt: skip
    return data, source, replace(options, **filled, **corrected, **in_map)


def _map_of(options: LogOptions) -> LandmarkMap | None:
    """The map that options give, used as they say; None without one."""
    if not isinstance(options, MapOptions) or (options.map or options.landmark_map) is None:
        return None
    return as_map(options.landmark_map or options.map).used_as(options.map_use)


def _joined(
    logs: Sequence[Log], options: LogOptions, join: Callable[[list[Log], list[float | None], list[str]], Log]
) -> tuple[Log, dict[str, float], bool]:
    """Several logs as one with the same noise models for all, biases, and whether noise was estimated.

    ``join`` makes one log of several with the factors for correlated errors in their noise, and adds its remarks to a list.
    """
    known, remarks = [_with_noise(each, options) for each in logs], list[str]()
    read = [log for log, _, _ in known]
    if options.noise is None and _gives_noise(options):
        # with the noise that options give logs are joined, and clocks of robots compared
        given = [options.models(log.motion, log.sensor) for log in read]
        read = [log.replace(motion=motion, sensor=sensor) for log, (motion, sensor) in zip(read, given)]
    joined = join(read, [None if found is None else found.inflation for _, _, found in known], remarks)
    # biases of options and of a noise file are the same for all
    estimated = any(found is not None for _, _, found in known)
    return joined.replace(notes=(*joined.notes, *remarks)), known[0][1], estimated


def _of_one_place(logs: list[Log], inflations: list[float | None], remarks: list[str]) -> Log:
    """Logs of one place as one log."""
    sessions = graphslam.join_logs(with_common_noise(logs, inflations))
    joined = sessions.log
    with noted(remarks, "what has changed between the logs is not known"):
        changes = zip(joined.sessions[1:], sessions.states or (session_states(joined) if len(logs) > 1 else ()))
        # begins with no log's name: `run` shows in brief what does
        remarks += [f"compared with the logs before {each.name}, {found.sentence}" for each, found in changes]
    return joined


def _robots(log: LogOrPath | Sequence[LogOrPath], options: LogOptions) -> dict[int, Log]:
    """The logs of a data set of several robots of which none is named; empty for other logs."""
    if options.robot is not None or not isinstance(log, (str, PathLike)):
        return {}
    if len(robots_in(log, format=options.format)) < 2:
        return {}
    with warnings.catch_warnings(action="ignore", category=UserWarning):
        return load_robots(log, **{name: each for name, each in _of_load(options).items() if name != "robot"})


def _of_robots(numbers: Iterable[int], logs: list[Log], _inflations: list[float | None], remarks: list[str]) -> Log:
    """The logs of several robots, whose sensors may differ, as one log, on the clock of the first."""
    robots, offsets = dict(zip(numbers, logs)), None
    with noted(remarks, "whether the clocks of the robots agree is not known"):
        offsets = clock_offsets(robots)
    return (join_robots(robots) if offsets is None else offsets.joined(robots)).log


def _with_noise(log: Log, options: LogOptions) -> tuple[Log, dict[str, float], Calibration | None]:
    """The log with the noise models that the option ``noise`` asks for as its own, its biases, and what was estimated.

    A log from which noise was estimated has no biases left.
    """
    values, content = dict(CORRECTIONS), options.noise_content
    if options.noise is not None and options.noise not in (AUTO, BOOK):
        content = read_noise(options.noise)
    if content is not None:
        motion, sensor = NoiseOptions.of(**content).models(log.motion, log.sensor)
        of_file = {name: value for name, value in content.items() if name in CORRECTIONS}
        if log.controls is None:
            # a noise file of other logs of the robot may correct odometry that this one has not
            of_file = of_sensor_alone(of_file)
        return log.replace(motion=motion, sensor=sensor), values | of_file, None
    if options.noise is None and _gives_noise(options):
        return (log.replace(notes=(*log.notes, NOT_ESTIMATED)) if unknown_noise(log) else log), values, None
    given = _given_corrections(options) if options.noise == AUTO else {}
    motion, sensor = options.models(log.motion, log.sensor)
    log = without_biases(log, motion=motion, sensor=sensor, **given)
    try:
        place = {name: value for name, value in options.of_component("sensor").items() if name in SensorModel.GEOMETRY}
        if place:
            log = log.replace(sensor=replace(log.sensor or SensorModel(), **place))
        noise = None if options.noise is None else str(options.noise)
        if (landmarks := _map_of(options)) is None:
            known, estimate = known_noise(log, noise, motion, sensor)
        else:
            known, *_, estimate = noise_in_map(log, landmarks, None, None, noise)
        # the ids of ranges and bearings alone are never checked
        if options.check_ids is False and estimate is not None and len(log.steps) and enough_ids(log):
            advice = "to run without that check, name the noise: --noise FILE or --noise book"
            raise OptionError(f"the estimate of the noise always checks ids; {advice}")
        found = None if estimate is None else Calibration.of(estimate)
        return known, values, found and replace(found, **one_after_the_other(given, found.corrections))
    except (GraphError, LogError) as error:
        return log.replace(notes=(*log.notes, f"noise auto kept {_kept(log)}: {error}")), values, None


def _with_checked_ids(log: Log, motion: MotionModel, sensor: SensorModel) -> Log:
    """The log of a robot that is known from a noise file, with misread ids corrected."""
    try:
        return with_checked_ids(log, motion, sensor)
    except (GraphError, LogError) as error:
        return log.replace(notes=(*log.notes, f"the ids were not checked, because {str(error).rstrip('.')}"))


def _compared_with_estimate(log: Log, motion: MotionModel, sensor: SensorModel, known_map: LandmarkMap | None) -> Log:
    """The log, corrected by a noise file, with a note of how well this predicts, and a doubt where it shows biases.

    With a map, biases are those that both show: a log alone does not tell the scale of ranges from that of the wheels.
    """
    try:
        found = estimate_robot(log, sensor=sensor, given=(motion, sensor), map=known_map)
    except (GraphError, LogError):
        # a short log does not tell its noise
        return log
    if found.left_out.sentence is not None:
        log = log.replace(notes=(*log.notes, found.left_out.sentence))
    p = found.parameters
    away = zip(p.names, p.values.tolist())
    shown = []
    if left := [name for name, value in away if abs(value - p.priors[name][0]) > DIFFERENT * p.deviations[name]]:
        shown.append(f"{p.sentence_of(left)} after its corrections")
    kinds = {
        "scales of the odometry that differ between two directions, which files do not correct": found.uneven,
        "bearings that are off by a part of their size, which files do not correct": found.lens,
        "a sensor that was turned during the drive, which files do not correct": found.turns,
    }
    shown += [kind for kind, errors in kinds.items() if errors]
    # standard deviations of the usual motion, (x, y, heading), and which of them differ
    found_by, of_file = (np.diagonal(log.motions(each)[1], axis1=1, axis2=2) for each in (found.motion, motion))
    ratios = np.sqrt(np.median(found_by / of_file, axis=0))
    # where nothing was left out, nothing says that the noise of the estimate is better than that of the file
    if found.left_out.count and found.left_out.best == ESTIMATE and not found.nearly_exact:
        differ = {name: r for name, r in zip(("distance", "heading"), ratios[[0, 2]].tolist()) if max(r, 1 / r) > TIMES}
        which = " and ".join(f"{ratio:.2g} times that of the file in the {name}" for name, ratio in differ.items())
        shown += [f"noise of the motion that is {which}"] if differ else []
    if not shown:
        return log
    doubt = (
        f"the noise file does not fit this log, which shows {' and '.join(shown)}. Is the file of another robot, or has the "
        "robot changed? Compare with --noise auto"
    )
    return log.replace(doubts=(*log.doubts, ("another robot's noise", doubt)))


def _gives_noise(options: LogOptions) -> bool:
    """Whether options give noise models, numbers of them, or corrections."""
    numbers = {name for each in given_models(options).values() for name in each}
    return bool(_given_corrections(options) or numbers - set(SensorModel.GEOMETRY))


def _given_corrections(options: LogOptions) -> dict[str, float]:
    """The biases that options give."""
    return {name: value for name in CORRECTIONS if (value := getattr(options, name)) is not None}


def given_models(options: LogOptions) -> dict[str, dict[str, Any]]:
    """The numbers of the noise models that options give, by model: all numbers of a whole model."""
    given = {}
    for name in MODELS:
        model, numbers = getattr(options, name), options.of_component(name)
        if numbers := numbers if model is None else asdict(model.changed(**numbers)):
            given[name] = numbers
    return given


def _kept(log: Log) -> str:
    return "the noise models of the log" if log.motion or log.sensor else "the book's noise models"


def read_log(log: LogOrPath | Sequence[LogOrPath], options: ReadingOptions) -> tuple[Log, Path | None]:
    """The log that the reading options ask for, and its file or folder; None for a `Log`."""
    source = None
    if isinstance(log, Log):
        data = log
        for name in OF_FILES:
            if (value := getattr(options, name)) is not None and value is not False:
                message = f"{name} applies when a file is read, and {quoted(log.name)} is a Log that has been read"
                raise OptionError(message)
        if options.keep_every is not None:
            data = with_poses_every(data, options.keep_every)
    elif log is not None and not isinstance(log, (str, PathLike)):
        raise OptionError(f"a log is a Log, or the path of its file or folder, not {type(log).__name__}: {quoted(log)}")
    else:
        path = graphslam.sample_log_path() if log is None else path_of(log)
        # the warnings of a reader are also notes of the log, which are shown
        with warnings.catch_warnings(action="ignore", category=UserWarning):
            data = graphslam.load(path, **_of_load(options))
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


def _of_load(options: ReadingOptions) -> dict[str, Any]:
    """The options of `graphslam.load`."""
    return {name: getattr(options, name) for name in ("format", *options_of(ReadOptions))}


def sha256_of(path: Path, *others: Path) -> str:
    """The SHA-256 of a file's content, in hexadecimal digits; of a folder, of the names and contents of its files.

    That of several is the SHA-256 of theirs, one a line.

    Raises:
        FormatError: a file cannot be read.
    """
    if others:
        return hashlib.sha256("".join(f"{sha256_of(each)}\n" for each in (path, *others)).encode()).hexdigest()
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
