"""Ids for logs whose sightings have none, as calibration needs them."""

from __future__ import annotations

from collections.abc import Mapping

from ..association import associate
from ..log import UNIDENTIFIED, Log
from ..models import MotionModel, SensorModel


def with_found_ids(
    log: Log, motion: MotionModel, sensor: SensorModel, corrections: Mapping[str, float] | None = None
) -> tuple[Log, str]:
    """The log with the ids that `associate` finds, without clutter, and a note; the log itself where it has ids.

    Noise models that are too wide hide wrong ids, and wrong ids change the residuals. So `calibrate` finds ids with the
    models that it begins with, the noise of that log, ids with this noise, and the noise again.

    Args:
        log: with controls.
        motion, sensor: the noise models.
        corrections: the arguments of `Log.corrected`, of the log in which ids are sought; default: none.

    Raises:
        LogError: no ids can be found.
    """
    if log.identified:
        return log, ""
    found = associate(log.corrected(**(corrections or {})), motion=motion, sensor=sensor)
    kept = found.ids != UNIDENTIFIED
    # landmarks that were found are not those of the true map
    named = log.with_sightings(kept, landmarks=found.ids[kept], initial_poses=found.poses, true_landmarks=None)
    return named, (
        f"{log.name} has sightings without ids: {found.landmarks} landmarks were found in them; {found.verdict}"
    )
