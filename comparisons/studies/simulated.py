"""The settings of simulated worlds as a study file has them, flat and of plain types, and the log they make."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from types import NoneType
from typing import Any, get_args, get_type_hints

from graphslam import WORLDS, Log, MotionFaults, SensorFaults, simulate

from ..options import NoiseOptions, options_of


def _types(hint: Any) -> tuple[type, ...]:
    """The types that a TOML file may have for a setting with this type hint; arrays are lists there."""
    parts = get_args(hint) if NoneType in get_args(hint) or int in get_args(hint) else (hint,)
    return tuple(part if part in (bool, int, float) else list for part in parts if part is not NoneType)


_FAULTS: dict[str, Any] = {"motion_faults": MotionFaults, "sensor_faults": SensorFaults}
_OTHERS = (*_FAULTS, "motion", "sensor", "seed", "name", "return")
#: the settings of a world and of its faults, and the types that each may have
SETTINGS: dict[str, tuple[type, ...]] = {
    name: _types(hint) for name, hint in get_type_hints(simulate).items() if name not in _OTHERS
} | {f.name: (float,) for faults in _FAULTS.values() for f in fields(faults)}


def simulated_log(settings: Mapping[str, Any], seed: int, name: str = "simulated") -> Log:
    """The log of a world.

    Args:
        settings: "world" (default "book"), the keys of `SETTINGS`, and the numbers of the noise models of a clean world.
        seed: random seed of the simulator.
        name: of the log.

    Raises:
        OptionError: a setting has an impossible value.
    """
    options = {key: value for key, value in settings.items() if key in SETTINGS}
    for keyword, faults in _FAULTS.items():
        given = {f.name: options.pop(f.name) for f in fields(faults) if f.name in options}
        if given:
            options[keyword] = faults(**given)
    numbers = {n: settings[n] for n, each in options_of(NoiseOptions).items() if each.model and n in settings}
    motion, sensor = NoiseOptions.of(**numbers).models()
    world = WORLDS[settings.get("world", "book")]
    return simulate(**(world | options), motion=motion, sensor=sensor, seed=seed, name=name)
