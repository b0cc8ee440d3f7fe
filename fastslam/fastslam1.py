"""FastSLAM 1.0: every particle carries a trajectory and, given that, a map of independent Gaussians.

Sources: Murphy, *Bayesian map learning in dynamic environments*, NIPS 1999; Montemerlo, Thrun, Koller and Wegbreit,
*FastSLAM*, AAAI 2002; *Probabilistic Robotics*, section 13.3; Ueda, *LNPR*, chapter 8.
"""

from __future__ import annotations

import numpy as np

from graphslam.se2 import Array

from .identified_maps import IdentifiedLandmarks
from .slam_filter import FastSLAM


class FastSLAM1(FastSLAM):
    """FastSLAM 1.0, for sightings with or without psi (with psi landmarks have a heading).

    A first sighting initialises a landmark as N(h^-1(x, z), (H' Q^-1 H)^-1) and does not change the weight. A later one
    multiplies the weight by N(z; h(m), V), V = H S H' + Q, and then updates the landmark with the gain K = S H' V^-1. A
    particle that stands on its landmark (nearer than 1e-9 m) has no bearing to it: its likelihood is 0 and that landmark
    is not updated.

    With the association "maximum-likelihood" ids are ignored, and `observe` takes None for them. Each particle assigns
    every sighting to the most likely landmark of its own map, the most likely pair of the scan first, and uses no
    landmark twice. A sighting that is more likely to belong to a new landmark creates one. New landmarks are
    provisional. Their evidence is the number of their sightings minus the number of observed steps in which they should
    have been seen and were not, counted when the step is over. A landmark should be seen well within the ranges and
    bearings at which anything was seen so far, because the sensor model has no limits. With evidence 0 a landmark is
    dropped, from 2 on it is confirmed, and from 3 on it is permanent. A step is observed if `observe` was called in it,
    even without sightings; a step of a log is observed if it has sightings. Maps number landmarks in the order of
    creation and leave out unconfirmed ones, except on request.

    Arguments and errors are those of `ParticleFilter`; all options are fields of `FilterOptions`. The
    new_landmark_threshold p decides when a sighting belongs to a new landmark: where its likelihood under every known
    landmark is below the density at the border of the ellipse that holds 1 - p of the sightings of a perfectly known
    landmark. For each new landmark a particle's weight is multiplied by that density.
    """

    def _weigh_identified(self, maps: IdentifiedLandmarks, ids: np.ndarray, sightings: Array, q: Array) -> Array | None:
        log_likelihood = None
        for j, z, variances in zip(ids.tolist(), sightings, q, strict=True):
            if j not in maps:
                maps.initialize(j, self._poses, z, variances)
                continue
            if log_likelihood is None:
                log_likelihood = np.zeros(self.particles)
            maps.update(j, self._poses, z, variances, log_likelihood)
        maps.finish()
        return log_likelihood
