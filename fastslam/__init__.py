"""Particle filters on the framework's logs and models: Monte Carlo localisation and FastSLAM.

`fastslam.textbook` is the lectures' pseudocode, particle by particle; the classes here do the same with arrays.
Names are imported at their first use. The engine (`engine/include/vmslam/particles`) has the algorithms.
"""
# ruff: noqa: F401

from typing import TYPE_CHECKING

from graphslam.lazy import lazy_names

if TYPE_CHECKING:
    from .fastslam1 import FastSLAM1
    from .fastslam2 import FastSLAM2
    from .gibbs.chains import ParticleGibbs
    from .gibbs.result import GibbsResult
    from .mcl import MonteCarloLocalization
    from .options import FilterOptions, GibbsOptions
    from .particle_filter import ParticleFilter, VanishedWeightsWarning
    from .resampling import RESAMPLING_SCHEMES, effective_sample_size
    from .samples import Samples
    from .state import FilterResult, LandmarkEstimate, ParticleState

#: the public names, by the module that defines them
_PUBLIC = {
    "fastslam1": "FastSLAM1",
    "fastslam2": "FastSLAM2",
    "gibbs.chains": "ParticleGibbs",
    "gibbs.result": "GibbsResult",
    "mcl": "MonteCarloLocalization",
    "options": "FilterOptions GibbsOptions",
    "particle_filter": "ParticleFilter VanishedWeightsWarning",
    "resampling": "RESAMPLING_SCHEMES effective_sample_size",
    "samples": "Samples",
    "state": "FilterResult LandmarkEstimate ParticleState",
}
__getattr__, __dir__, __all__ = lazy_names(__name__, _PUBLIC)
