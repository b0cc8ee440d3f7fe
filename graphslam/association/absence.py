"""The time that landmarks were out of sight, in steps; long stretches without useful sightings count as more steps.

Within a moment of this clock, odometry says well enough where landmarks that were just seen must be.
"""

from __future__ import annotations

import numpy as np

from .densities import Densities, Field
from .map_solution import Backbone
from .options import AssociationOptions

#: a stretch is blind if it leaves landmarks a standard deviation above this part of their distance from each other
CERTAIN = 1 / 6
#: at most so many moments in a drive
MOST_MOMENTS = 150


def moment_of(backbone: Backbone, options: AssociationOptions) -> int:
    """The length of a moment [steps]."""
    return max(options.window, -(-backbone.log.num_poses // MOST_MOMENTS))


def clock(backbone: Backbone, field: Field, densities: Densities, moment: int) -> np.ndarray:
    """The time (T+1,) of each pose: its step, plus two moments for each blind stretch before it."""
    log = backbone.log
    noise = np.linalg.inv(backbone.motions.information)
    variance = np.linalg.norm(noise[:, :2, :2], 2, axis=(1, 2)) + noise[:, 2, 2] * (field.farthest / 2) ** 2
    total = np.concatenate([[0.0], np.cumsum(variance)])
    scans = np.unique(log.steps)
    per_area = densities.new + (np.log(2 * np.pi) if log.has_orientation else 0.0)
    blind = np.sqrt(np.diff(total[scans])) > CERTAIN * np.exp(-0.5 * per_area)
    leaps = np.zeros(log.num_poses, dtype=np.int64)
    leaps[scans[1:][blind]] = 2 * moment
    return np.arange(log.num_poses) + np.cumsum(leaps)
