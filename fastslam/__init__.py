"""Particle filters on the framework's logs and models: Monte Carlo localisation and FastSLAM.

`fastslam.textbook` is the lectures' pseudocode, particle by particle; the classes here do the same with arrays.
Names are imported at their first use. Kernels are compiled at their first call and cached on disk.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .compilation import warm_up as warm_up
    from .fastslam1 import FastSLAM1 as FastSLAM1
    from .fastslam2 import FastSLAM2 as FastSLAM2
    from .mcl import MonteCarloLocalization as MonteCarloLocalization
    from .options import FilterOptions as FilterOptions
    from .particle_filter import ParticleFilter as ParticleFilter
    from .particle_filter import VanishedWeightsWarning as VanishedWeightsWarning
    from .resampling import RESAMPLING_SCHEMES as RESAMPLING_SCHEMES
    from .resampling import effective_sample_size as effective_sample_size
    from .state import FilterResult as FilterResult
    from .state import LandmarkEstimate as LandmarkEstimate
    from .state import ParticleState as ParticleState

_MODULE_OF = {
    "FastSLAM1": "fastslam1",
    "FastSLAM2": "fastslam2",
    "FilterOptions": "options",
    "FilterResult": "state",
    "LandmarkEstimate": "state",
    "MonteCarloLocalization": "mcl",
    "ParticleFilter": "particle_filter",
    "ParticleState": "state",
    "RESAMPLING_SCHEMES": "resampling",
    "VanishedWeightsWarning": "particle_filter",
    "effective_sample_size": "resampling",
    "warm_up": "compilation",
}
__all__ = list(_MODULE_OF)


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_MODULE_OF[name]}", __name__), name)


def __dir__() -> list[str]:
    return __all__
