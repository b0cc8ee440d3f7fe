"""The log of a simulated world that a study file describes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from graphslam import Log, simulate

from ..options import SimulationOptions


def simulated_log(settings: Mapping[str, Any], seed: int, name: str = "simulated") -> Log:
    """The log of a world.

    Args:
        settings: options of `SimulationOptions`, flat.
        seed: random seed of the simulator.
        name: of the log.

    Raises:
        OptionError: a setting has an impossible value.
    """
    return simulate(**SimulationOptions.of(**{**settings, "seed": seed}).keywords_of_simulate(), name=name)
