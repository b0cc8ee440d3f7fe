"""Edge families: what ties the nodes of a graph together, one file each."""

from .anchor import ANCHOR_INFORMATION, AnchorEdges
from .base import EdgeFamily, Linearization, Relations
from .landmark import ObservationEdges, RelativePointEdges
from .marginal import MarginalEdges
from .motion import motion_edges
from .relative_pose import RelativePoseEdges
from .sightings import LandmarkSightings
from .virtual_motion import VirtualMotionEdges

__all__ = [
    "ANCHOR_INFORMATION",
    "AnchorEdges",
    "EdgeFamily",
    "LandmarkSightings",
    "Linearization",
    "MarginalEdges",
    "ObservationEdges",
    "RelativePointEdges",
    "RelativePoseEdges",
    "Relations",
    "VirtualMotionEdges",
    "motion_edges",
]
