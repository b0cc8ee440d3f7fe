"""FastSLAM 1.0: every particle carries a trajectory and, given that, a map of independent Gaussians.

Sources: Murphy, *Bayesian map learning in dynamic environments*, NIPS 1999; Montemerlo, Thrun, Koller and Wegbreit,
*FastSLAM*, AAAI 2002; *Probabilistic Robotics*, section 13.3; Ueda, *LNPR*, chapter 8.
"""

from __future__ import annotations

import numpy as np

from graphslam.se2 import Array

from .landmark_columns import LandmarkColumns
from .slam_filter import FastSLAM


class FastSLAM1(FastSLAM):
    """FastSLAM 1.0, on sightings with or without psi (with it landmarks have a heading).

    A first sighting starts a landmark at N(h^-1(x, z), (H' Q^-1 H)^-1) and does not weigh. A later one multiplies the
    weight by N(z; h(m), V), V = H S H' + Q, and then moves the landmark by K = S H' V^-1. A particle that stands
    on its landmark (nearer than 1e-9 m) cannot tell the bearing: its likelihood is 0 and that landmark stays as it is.

    With ``association="maximum-likelihood"`` ids are not looked at, and `observe` takes None for them. Each particle
    gives every sighting to the landmark of its own map under which it is likeliest, the likeliest pair of the scan
    first, no landmark twice. A sighting that is likelier to be of a new landmark starts one. New landmarks are
    provisional: each sighting counts one for them, each time they should have been seen and were not (well within
    the ranges and bearings at which anything was seen so far: the sensor model has no limits) one against, counted once
    a step, when the step is over; at 0 they are dropped, from 2 on they are confirmed, at 3 they stay. What is out of view
    costs them nothing. A step counts if `observe` was called in it, even with nothing seen; of a log, if it has sightings.
    Maps number landmarks by birth and leave out, unless asked, what is not confirmed.

    Args:
        log: what the robot did and saw; None to feed the filter by hand.
        particles: their number N.
        seed: of the random numbers, or a generator.
        motion, sensor: the models; default: the book's.
        resampling: "systematic", "stratified", "residual" or "multinomial".
        ess_threshold: resample after sightings when ESS <= ess_threshold * N; 1 is the lectures' way, after every step
            with sightings of known landmarks.
        start: the known first pose (3,), or one per particle (N, 3); default: the log's first initial pose.
        association: "known" or "maximum-likelihood".
        new_landmark_threshold: p between 0 and 1: a sighting is of a new landmark where its likelihood under every
            known one is below that at the rim of the ellipse that holds 1 - p of the sightings of a perfectly known
            landmark; and a particle's weight is multiplied by that much for each new landmark.
        threads: how many; None for all cores where there are particles enough. The result is the same.

    Raises:
        OptionError: an option has an impossible value.
        LogError: the log has no controls.
    """

    def _weigh_known(self, columns: LandmarkColumns, ids: np.ndarray, sightings: Array, q: Array) -> Array | None:
        log_likelihood = None
        for j, z, variances in zip(ids.tolist(), sightings, q, strict=True):
            if j not in columns:
                columns.initialize(j, self._poses, z, variances)
                continue
            if log_likelihood is None:
                log_likelihood = np.zeros(self.particles)
            columns.update(j, self._poses, z, variances, log_likelihood)
        columns.finish()
        return log_likelihood
