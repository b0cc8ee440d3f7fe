"""A sensor that is metres from where it is believed to be, as the laser of a car whose poses are those of the rear axle.

The prior of the sensor's place (`PRIORS`) is a few centimetres wide, because lasting errors of a sensor look like a wrong
place. Where the sensor is metres away, this prior ends at a wrong minimum: the sensor near its believed place, its own motion
about the robot as slip, and a turned sensor. With a wide prior the same problem moves to the right one. Both are compared by
the likelihood, which contains the densities of the priors, so that the wide one wins only where the sightings need it.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np

from ..errors import GraphError
from ..log import Log
from .declared import PLACE
from .restricted_likelihood import fit, gain_over
from .unknowns import Unknowns

#: the standard deviation of the wide prior [m], and the gain of the log likelihood per sighting with which it is taken: at
#: least 0.22 with a sensor 0.58 m away or more; lasting errors that look like a wrong place gain up to 0.15 on whole logs,
#: and 0.30 on one half of a log (docs/decisions.md)
ANYWHERE, GAINED = 2.0, 0.2
#: rounds of solving and improving the variances with the usual prior, which start near their end, and with the wide one
ROUNDS = (4, 8)


def is_elsewhere(log: Log, start: Unknowns) -> bool:
    """Whether a log of few, nearly independent sightings shows that the sensor is far from its believed place.

    Args:
        start: a problem of the same drive, solved with the usual prior.
    """
    try:
        usual = fit(Unknowns(log, log.landmarks, start.sensor, start), ROUNDS[0])[0]
        free = fit(with_sensor_anywhere(usual), ROUNDS[1])[0]
        return gain_over(free, usual) > GAINED * len(usual.seen)
    except (GraphError, np.linalg.LinAlgError):
        # sightings that do not tell the place are no reason to doubt it
        return False


def with_sensor_anywhere(unknowns: Unknowns) -> Unknowns:
    """The same problem with the wide prior of the sensor's place."""
    free, p = copy(unknowns), unknowns.parameters
    free.parameters = replace(p, deviations=np.where(np.isin(p.names, PLACE), ANYWHERE, p.deviations))
    return free
