"""Which noise models a log has: those that are given, its own, those estimated from it, or the book's."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..errors import GraphError, LogError, OptionError
from ..errors.checks import check_choice
from ..log import UNIDENTIFIED, Log
from ..log.cells import DOUBTFUL_NOISE, nothing_measured
from ..models import MotionModel, SensorModel
from .result import RobotEstimate
from .robot import FEWEST

if TYPE_CHECKING:
    from ..maps.landmark_map import LandmarkMap

#: how the note begins that says why
BOOKS = "the noise models are the book's"
#: the choices of the option ``noise``: from the log, or the lectures' values
AUTO, BOOK = "auto", "book"


def unknown_noise(log: Log) -> bool:
    """Whether the noise of a log with controls is unknown."""
    if log.simulated or log.motion is not None or log.controls is None:
        return False
    return log.sensor is None or log.sensor.of_book


def enough_ids(log: Log) -> bool:
    """Whether the sightings that have ids may be enough for `estimate_robot`."""
    return bool(log.identified or np.count_nonzero(log.landmarks != UNIDENTIFIED) >= FEWEST["sightings"])


def known_robot(
    log: Log, noise: str | None = None, sensor: SensorModel | None = None, landmarks: LandmarkMap | None = None
) -> tuple[Log, RobotEstimate | None]:
    """The log with the noise of its robot, and the estimate where that is asked for, or where nothing else is known.

    The log has ids; `association.known_noise` is for all logs.

    Args:
        noise: "auto" estimates noise, biases and misread ids; "book" takes the values of the lectures. Default: the models of
            the log where it brings some, the book's for logs of `simulate`, and else "auto" where the noise is identifiable.
        sensor: where the sensor is believed to be, and what it can see; default: as in the log.
        landmarks: a map that the robot is in.

    Raises:
        LogError, GraphError: the log does not determine its noise, and ``noise`` is "auto".
    """
    if noise == BOOK:
        place = {name: getattr(sensor or log.sensor or SensorModel(), name) for name in SensorModel.GEOMETRY}
        return log.replace(motion=MotionModel(), sensor=SensorModel(**place)), None
    if noise is None and not unknown_noise(log):
        return log, None
    # it solves graphs, which ask for this; so it is looked up at the call, by the name that users have
    from .. import estimate_robot

    try:
        found = estimate_robot(log, sensor=sensor, map=landmarks)
    except (GraphError, LogError) as error:
        if noise == AUTO:
            raise
        return with_book(log, error), None
    return with_findings(log, found.log, found), found


def with_findings(log: Log, corrected: Log, found: RobotEstimate, *notes: str) -> Log:
    """The corrected log with what the estimate says as notes, with further ones, and with its doubts.

    Equal ranges of the recorded log are reported here, because corrections make them differ.
    """
    doubts = [(DOUBTFUL_NOISE, each) for each in found.doubts]
    doubts += nothing_measured(log.sightings[:, 0])
    said = (*corrected.notes, *found.sentences, *not_used(log), *notes)
    return corrected.replace(notes=said, doubts=(*corrected.doubts, *doubts))


def noise_of(
    log: Log,
    motion: MotionModel | None,
    sensor: SensorModel | None,
    noise: str | None,
    landmarks: LandmarkMap | None = None,
) -> tuple[Log, MotionModel, SensorModel, RobotEstimate | None]:
    """The log and its noise models, and the estimate of the robot where one of them was not known otherwise.

    Args:
        motion, sensor: the models that are given. Where only one is, it is kept, and the other one is as ``noise`` says; the
            place of the sensor, and what it can see, are those of the estimate.
        noise, landmarks: as for `known_robot`.

    Raises:
        OptionError: there is no such choice of ``noise``, or both models are given beside it.
        LogError, GraphError: as `known_robot`.
    """
    if noise is not None:
        check_choice("noise", noise, (AUTO, BOOK))
        if motion is not None and sensor is not None:
            raise OptionError("noise says which models are taken where motion or sensor is not given: leave it out")
    if motion is not None and sensor is not None:
        return log, *log.noise_models(motion, sensor), None
    # models of another type are refused before the estimate
    log.noise_models(motion, sensor)
    log, robot = known_robot(log, noise, sensor, landmarks)
    if not (motion or sensor):
        return log, *log.noise_models(), robot
    kept, other = ("sensor", "motion") if sensor else ("motion", "sensor")
    if robot is None:
        if any(BOOKS in note for note in log.notes):
            notes = (note.replace(BOOKS, f"the noise of the {other} is the book's") for note in log.notes)
            log = log.replace(notes=tuple(notes))
        return log, *log.noise_models(motion, sensor), None
    note = f"the noise of the {kept} is the given one, and that of the {other} the estimated one"
    if sensor is not None:
        (x, y), (ahead, left) = sensor.offset, robot.sensor.offset
        sensor = replace(sensor, **{name: getattr(robot.sensor, name) for name in SensorModel.GEOMETRY})
        if (x, y) != (ahead, left):
            note += f"; its place, given as ({x:.3g}, {y:.3g}) m, is estimated as ({ahead:.3g}, {left:.3g}) m"
    log = log.replace(notes=(*log.notes, note))
    return log, *log.noise_models(motion, sensor), robot


def with_book(log: Log, error: Exception) -> Log:
    """The log with a note why its noise is the book's."""
    return log.replace(notes=(*log.notes, f"{BOOKS}, because noise cannot be estimated: {error}"))


def not_used(log: Log) -> tuple[str, ...]:
    """A note of what the log has beside sightings and odometry, which say nothing about noise and biases here."""
    # a log without whole sightings is estimated from its ranges and bearings alone
    used = () if len(log.steps) else ("partial_sightings",)
    kinds = ", ".join(name for name in log.measured if name not in used).replace("_", " ")
    return (f"noise and biases were estimated without the {kinds} of the log",) if kinds else ()
