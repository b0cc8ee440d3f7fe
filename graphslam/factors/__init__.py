"""GTSAM factor types for your own graphs: virtual motion, motion, relative pose, position, observation, landmark, anchor.

Every factor is a `gtsam.CustomFactor` whose residual and analytic Jacobians are those of the edges of this framework.
They are derived here a second time, so that the two implementations check each other. GTSAM's ``error`` is one half of
e' Omega e, or rho(r) with a robust kernel.
"""

from .base import ResidualFactor
from .description import FactorDescription, describe, load_factors, save_factors
from .landmark import InverseObservationFactor, LandmarkFactor, ObservationFactor, RelativePointFactor
from .priors import AnchorFactor, PositionFactor, PriorFactor
from .relative import MotionFactor, RelativeEdgesFactor, RelativePoseFactor, VirtualMotionFactor

__all__ = [
    "AnchorFactor",
    "FactorDescription",
    "InverseObservationFactor",
    "LandmarkFactor",
    "MotionFactor",
    "ObservationFactor",
    "PositionFactor",
    "PriorFactor",
    "RelativeEdgesFactor",
    "RelativePointFactor",
    "RelativePoseFactor",
    "ResidualFactor",
    "VirtualMotionFactor",
    "describe",
    "load_factors",
    "save_factors",
]
