"""The evidence for an association as a whole: what makes the results of different front ends and hypotheses comparable.

With the graph of labels A solved, Laplace's approximation of log p(Z, A), without what all associations of a log share, is

    E = -J/2 - 1/2 log det(Omega / 2 pi) + sum over sightings with a landmark of [log P_D - log c + 1/2 log det(Q^-1 / 2 pi)]
        + L log rho + (views without a sighting) log(1 - P_D),

where L is the number of landmarks, rho their density and c that of clutter. Sightings that are clutter have the factor 1.
"""

from __future__ import annotations

import numpy as np

from ..log import Log
from .densities import Densities, Field
from .hypotheses import log_volume
from .map_solution import Backbone, MapSolution
from .visibility import Visibility


def evidence(log: Log, backbone: Backbone, solved: MapSolution, field: Field, densities: Densities) -> float:
    """E of a solved graph; only differences between associations of one log, with the same densities, mean anything."""
    d, count = solved.landmarks.shape[1], len(solved.landmarks)
    Q = np.asarray(backbone.places.covariances)[solved.rows]
    sightings = len(solved.rows) * (densities.seen - densities.clutter) - 0.5 * float(np.sum(log_volume(Q)))
    # poses are the same in number for all associations, so their powers of 2 pi are left out
    volume = 0.5 * d * count * np.log(2 * np.pi) - 0.5 * solved.log_determinant
    misses = float(Visibility.of(log, backbone, solved, field).misses(densities).sum())
    return -0.5 * solved.cost + volume + sightings + count * densities.new + misses
