"""The particle filters: Monte Carlo localisation, FastSLAM 1.0 and 2.0."""

from .filters import FastSLAM1, FastSLAM2, MonteCarloLocalization

__all__ = ["FastSLAM1", "FastSLAM2", "MonteCarloLocalization"]
