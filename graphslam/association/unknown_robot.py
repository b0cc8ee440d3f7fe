"""The noise of a robot whose sightings have no ids: ids and robot, each found with the other."""

from __future__ import annotations

from ..errors import GraphError, LogError
from ..errors.checks import check_choice
from ..identification.corrections import without_biases
from ..identification.declared import PLACE
from ..identification.result import RobotEstimate, not_used, with_book
from ..identification.robot import AUTO, BOOK, enough_ids, estimate_robot, known_robot, unknown_noise
from ..log import UNIDENTIFIED, Log
from ..models import MotionModel, SensorModel
from .associate import associate_from


def known_noise(
    log: Log, noise: str | None = None, motion: MotionModel | None = None, sensor: SensorModel | None = None
) -> tuple[Log, RobotEstimate | None]:
    """`known_robot` for all logs: where too few sightings have ids, ids and robot are found in turn (`robot_of`).

    The log keeps its sightings without ids; they are corrected by the biases that were found.

    Args:
        noise: as for `known_robot`.
        motion, sensor: the noise with which ids are found first; default: that of the log, else the book's.

    Raises:
        OptionError: there is no such choice of ``noise``.
        LogError, GraphError: the log does not determine its noise, and ``noise`` is "auto".
    """
    if noise is not None:
        check_choice("noise", noise, (AUTO, BOOK))
    if noise == BOOK or (noise is None and not unknown_noise(log)) or enough_ids(log):
        return known_robot(log, noise)
    try:
        found, notes = robot_of(log, motion or log.motion or MotionModel(), sensor or log.sensor or SensorModel())
    except (GraphError, LogError) as error:
        if noise == AUTO:
            raise
        return with_book(log, error), None
    known = _corrected(log, found)
    notes = (*known.notes, *found.sentences, *not_used(log), *notes)
    return known.replace(uncertain=found.log.uncertain, notes=notes), found


def robot_of(log: Log, motion: MotionModel, sensor: SensorModel) -> tuple[RobotEstimate, tuple[str, ...]]:
    """`estimate_robot`, and notes; where too few sightings have ids, ids and robot are found in turn.

    Noise models that are too wide hide wrong ids, and wrong ids change the noise. So ids are found with the noise to begin
    with, then the robot, then ids in the corrected log with the noise that was found, and then the robot again.

    Args:
        log: with controls.
        motion, sensor: the noise with which ids are found first, and where the sensor is believed to be.

    Raises:
        LogError, GraphError: no ids can be found, or the log does not tell the noise.
    """
    if enough_ids(log):
        return estimate_robot(log, sensor=sensor), ()
    named, note = _with_found_ids(log, log, motion, sensor)
    found = estimate_robot(named, sensor=sensor)
    try:
        named, again = _with_found_ids(log, _corrected(log, found), found.motion, found.sensor)
        return estimate_robot(named, sensor=sensor), (again,)
    except (LogError, GraphError) as error:
        return found, (note, f"ids were found only once, because with the noise that was found {error}")


def _corrected(log: Log, found: RobotEstimate) -> Log:
    """The log without the biases that were found, with the noise that was found as its own."""
    biases = {name: value for name, value in zip(found.parameters.names, found.parameters.values) if name not in PLACE}
    corrected = without_biases(log, motion=found.motion, sensor=found.sensor, **biases)
    return corrected.replace(motion=found.motion, sensor=found.sensor, control_variances=found.log.control_variances)


def _with_found_ids(log: Log, corrected: Log, motion: MotionModel, sensor: SensorModel) -> tuple[Log, str]:
    """The log with the ids that `associate_from` finds in the corrected log, without clutter, and a note."""
    found = associate_from(corrected, motion=motion, sensor=sensor)
    kept = found.ids != UNIDENTIFIED
    # landmarks that were found are not those of the true map
    named = log.with_sightings(kept, landmarks=found.ids[kept], initial_poses=found.poses, true_landmarks=None)
    note = f"noise and biases were estimated with {found.landmarks} landmarks that were found in sightings without ids"
    return named, note
