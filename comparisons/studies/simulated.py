"""The simulator's settings as a study file has them, flat and of plain types, and the log they make."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from graphslam import WORLDS, Log, MotionFaults, SensorFaults, simulate

from ..config import models

#: the settings of `graphslam.simulate` and the types they may have
SETTINGS: dict[str, tuple[type, ...]] = {
    "clean": (bool,), "orientation": (bool,), "steps": (int,), "dt": (float,), "speed": (float,), "turn_rate": (float,),
    "way_points": (list,), "start": (list,), "landmarks": (int, list), "arena": (float,), "min_range": (float,),
    "max_range": (float,), "field_of_view": (float,),
}  # fmt: skip
WHEELS = tuple(f.name for f in fields(MotionFaults))
CAMERA = tuple(f.name for f in fields(SensorFaults))
SETTINGS |= dict.fromkeys((*WHEELS, *CAMERA), (float,))


def simulated_log(settings: Mapping[str, Any], seed: int, name: str = "simulated") -> Log:
    """The log of a world.

    Args:
        settings: "world" (book unless named), the keys of `SETTINGS`, and noise of the clean mode as "motion.nn", ...
        seed: of the simulator's random numbers.
        name: of the log.

    Raises:
        OptionError: a setting has an impossible value.
    """
    world = WORLDS[settings.get("world", "book")]
    told = {key: value for key, value in settings.items() if key in SETTINGS}
    wheels = {key: told.pop(key) for key in WHEELS if key in told}
    camera = {key: told.pop(key) for key in CAMERA if key in told}
    faults: dict[str, Any] = {}
    if wheels:
        faults["motion_faults"] = MotionFaults(**wheels)
    if camera:
        faults["sensor_faults"] = SensorFaults(**camera)
    return simulate(world, **told, **faults, **models(settings), seed=seed, name=name)
