"""Association: which sightings without ids are of the same landmark; `associate` finds out, `score` compares with truth."""

from .assignment import ids_by_map
from .associate import Association, associate
from .doubts import Doubt
from .options import AssociationOptions
from .scores import AssociationScore, score

__all__ = ["Association", "AssociationOptions", "AssociationScore", "Doubt", "associate", "ids_by_map", "score"]
