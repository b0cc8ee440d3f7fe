"""Association: which sightings without ids are of the same landmark; `associate` finds out, `score` compares with truth."""

from .associate import Association, associate
from .options import AssociationOptions
from .scores import AssociationScore, score

__all__ = ["Association", "AssociationOptions", "AssociationScore", "associate", "score"]
