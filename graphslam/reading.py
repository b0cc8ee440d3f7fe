"""How a log is read: the options of `graphslam.load` that depend on the kind of data set."""

from __future__ import annotations

from dataclasses import dataclass

from .checks import check_count, check_positive, option

#: the id of a landmark that the sensor could not identify
UNIDENTIFIED = -(2**63)
#: the class of a sighting whose class is not known, where classes are words; `UNIDENTIFIED` where they are numbers
NO_CLASS = ""
#: the most classes that sightings may have: more are no kinds of landmarks
MOST_CLASSES = 100
#: the most poses that ``keep_every`` may make: a tenth of a second of a whole day
MOST_POSES = 1_000_000


@dataclass(frozen=True, kw_only=True)
class ReadOptions:
    """Options of `load`. The metadata "needs" names the property of a `formats.base.Format` that an option requires.

    Raises:
        OptionError: an option has an impossible value.
    """

    robot: int | None = option(None, "Number of the robot, for data sets with several", needs="several_robots")
    keep_every: float | None = option(
        None, "Keep a pose at least this often; default: the poses of the log, or where a landmark was seen", "s"
    )

    def __post_init__(self) -> None:
        if self.robot is not None:
            check_count(robot=self.robot)
        if self.keep_every is not None:
            check_positive(keep_every=self.keep_every)
