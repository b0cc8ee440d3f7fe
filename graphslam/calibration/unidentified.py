"""The robot of a log whose sightings may have no ids."""

from __future__ import annotations

from ..association import associate
from ..errors import GraphError, LogError
from ..identification.result import RobotEstimate
from ..identification.robot import enough_ids, estimate_robot
from ..log import UNIDENTIFIED, Log
from ..models import MotionModel, SensorModel
from ..parameters.corrections import without_biases
from ..parameters.declared import PLACE


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
    biases = {name: value for name, value in zip(found.parameters.names, found.parameters.values) if name not in PLACE}
    try:
        corrected = without_biases(log, motion=found.motion, sensor=found.sensor, **biases)
        named, again = _with_found_ids(log, corrected, found.motion, found.sensor)
        return estimate_robot(named, sensor=sensor), (again,)
    except (LogError, GraphError) as error:
        return found, (note, f"ids were found only once, because with the noise that was found {error}")


def _with_found_ids(log: Log, corrected: Log, motion: MotionModel, sensor: SensorModel) -> tuple[Log, str]:
    """The log with the ids that `associate` finds in the corrected log, without clutter, and a note."""
    found = associate(corrected, motion=motion, sensor=sensor)
    kept = found.ids != UNIDENTIFIED
    # landmarks that were found are not those of the true map
    named = log.with_sightings(kept, landmarks=found.ids[kept], initial_poses=found.poses, true_landmarks=None)
    return named, (
        f"{log.name} has sightings without ids: {found.landmarks} landmarks were found in them; {found.verdict}"
    )
