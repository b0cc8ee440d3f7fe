"""Edge families, which connect the nodes of a graph: one file for each kind, and the kernels that they share."""

from .anchor import ANCHOR_INFORMATION, AnchorEdges
from .base import ConstantEdges, EdgeFamily, Linearization, Relations
from .cartesian import CartesianObservationEdges
from .marginal import MarginalEdges
from .motion import motion_edges
from .observation import ObservationEdges
from .polar import PolarObservationEdges
from .prior import LandmarkPriors, PriorEdges
from .relative import RelativePointEdges, RelativePoseEdges
from .sightings import LandmarkSightings, SightingEdges
from .virtual_motion import VirtualMotionEdges

__all__ = [
    "ANCHOR_INFORMATION",
    "AnchorEdges",
    "CartesianObservationEdges",
    "ConstantEdges",
    "EdgeFamily",
    "LandmarkPriors",
    "LandmarkSightings",
    "Linearization",
    "MarginalEdges",
    "ObservationEdges",
    "PolarObservationEdges",
    "PriorEdges",
    "RelativePointEdges",
    "RelativePoseEdges",
    "Relations",
    "SightingEdges",
    "VirtualMotionEdges",
    "motion_edges",
]
