"""Edge families, which connect the nodes of a graph: one file for each kind, and the kernels that they share."""

from .base import ConstantEdges, EdgeFamily, Linearization, Relations
from .observation import (
    BearingEdges,
    CartesianObservationEdges,
    ObservationEdges,
    PartialEdges,
    PolarObservationEdges,
    RangeEdges,
)
from .priors import ANCHOR_INFORMATION, AnchorEdges, LandmarkPriors, PositionEdges, PriorEdges, Way, freest_turn
from .relative import RelationEdges, RelativePointEdges, RelativePoseEdges, motion_edges
from .robust import DoubtedEdges, SingleEdges
from .sightings import LandmarkSightings, MarginalEdges, SightingEdges
from .virtual_motion import VirtualMotionEdges

__all__ = [
    "ANCHOR_INFORMATION",
    "AnchorEdges",
    "BearingEdges",
    "CartesianObservationEdges",
    "ConstantEdges",
    "DoubtedEdges",
    "EdgeFamily",
    "LandmarkPriors",
    "LandmarkSightings",
    "Linearization",
    "MarginalEdges",
    "ObservationEdges",
    "PartialEdges",
    "PolarObservationEdges",
    "PositionEdges",
    "PriorEdges",
    "RangeEdges",
    "RelationEdges",
    "RelativePointEdges",
    "RelativePoseEdges",
    "Relations",
    "SightingEdges",
    "SingleEdges",
    "VirtualMotionEdges",
    "Way",
    "freest_turn",
    "motion_edges",
]
