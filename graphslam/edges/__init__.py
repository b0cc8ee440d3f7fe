"""Edge families, which connect the nodes of a graph: one file for each kind, and the kernels that they share."""

from .anchor import ANCHOR_INFORMATION, AnchorEdges
from .base import ConstantEdges, EdgeFamily, Linearization, Relations
from .doubted import DoubtedEdges, SingleEdges
from .marginal import MarginalEdges
from .observation import CartesianObservationEdges, ObservationEdges, PolarObservationEdges
from .partial import BearingEdges, PartialEdges, RangeEdges
from .position import PositionEdges
from .prior import LandmarkPriors, PriorEdges
from .relative import RelationEdges, RelativePointEdges, RelativePoseEdges, motion_edges
from .sightings import LandmarkSightings, SightingEdges
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
    "motion_edges",
]
