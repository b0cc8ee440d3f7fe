"""Edge families, which connect the nodes of a graph: one file for each kind, and the kernels that they share."""

from .anchor import ANCHOR_INFORMATION, AnchorEdges
from .base import ConstantEdges, EdgeFamily, Linearization, Relations
from .marginal import MarginalEdges
from .observation import CartesianObservationEdges, ObservationEdges, PolarObservationEdges
from .prior import LandmarkPriors, PriorEdges
from .relative import RelativePointEdges, RelativePoseEdges, motion_edges
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
