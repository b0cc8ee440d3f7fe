"""Particle filters on the framework's logs and models: Monte Carlo localisation and FastSLAM.

The lectures' pseudocode, particle by particle, is in `fastslam.textbook`; the classes here do the same with arrays.
Importing this package compiles nothing: the kernels are compiled at their first call and cached on disk.
"""

from .fastslam1 import FastSLAM1
from .fastslam2 import FastSLAM2
from .mcl import MonteCarloLocalization
from .particle_filter import ParticleFilter, VanishedWeightsWarning
from .resampling import RESAMPLING_SCHEMES, effective_sample_size
from .state import FilterResult, LandmarkEstimate, ParticleState

__all__ = [
    "FastSLAM1",
    "FastSLAM2",
    "FilterResult",
    "LandmarkEstimate",
    "MonteCarloLocalization",
    "ParticleFilter",
    "ParticleState",
    "RESAMPLING_SCHEMES",
    "VanishedWeightsWarning",
    "effective_sample_size",
]
