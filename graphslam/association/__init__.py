"""Association: which sightings without ids are of the same landmark, and `score`, which compares with the truth."""

from .ambiguity import Ambiguity
from .assignment import ids_by_map
from .associate import Association, AssociationScore, associate_from, known_noise, score
from .problem import AssociationOptions

__all__ = [
    "Association",
    "AssociationOptions",
    "AssociationScore",
    "Ambiguity",
    "associate_from",
    "ids_by_map",
    "known_noise",
    "score",
]
