"""Particle filters on the framework's logs and models: Monte Carlo localisation and FastSLAM.

`fastslam.textbook` is the lectures' pseudocode, particle by particle; the classes here do the same with arrays.
Names are imported at their first use. The engine (`engine/include/vmslam/particles`) has the algorithms.
"""
# ruff: noqa: F401

from typing import TYPE_CHECKING

from graphslam.lazy import lazy_names

if TYPE_CHECKING:
    from .association import associate
    from .filters import FastSLAM1, FastSLAM2, MonteCarloLocalization
    from .filters.particle_filter import ParticleFilter, VanishedWeightsWarning
    from .gibbs import GibbsResult, ParticleGibbs
    from .options import FilterOptions, GibbsOptions
    from .particles import (
        RESAMPLING_SCHEMES,
        FilterResult,
        LandmarkEstimate,
        ParticleState,
        Samples,
        effective_sample_size,
    )

__getattr__, __dir__, __all__ = lazy_names(__name__)
