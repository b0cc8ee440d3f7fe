"""FastSLAM 2.0: the pose is drawn from the motion model, corrected by the sightings of the step.

Sources: Montemerlo, Thrun, Koller and Wegbreit, *FastSLAM 2.0*, IJCAI 2003; *Probabilistic Robotics*, section 13.5 to
13.8.
"""

from __future__ import annotations

import numpy as np

from graphslam.errors import OptionError
from graphslam.se2 import Array

from . import landmark_kernels
from .anonymous_maps import AnonymousLandmarks
from .fastslam1 import FastSLAM1
from .identified_maps import IdentifiedLandmarks
from .motions import draw
from .proposal import draw_all as draw_weighted


class FastSLAM2(FastSLAM1):
    """FastSLAM 2.0, for sightings with or without psi; arguments and unknown association as in `FastSLAM1`.

    At a step with sightings of known landmarks each particle takes the motion as a Gaussian with mean f(x_{t-1}, u_t)
    and covariance P = A M A' + epsilon I (plus that of a slip), and corrects it by one sighting after the other as a
    Kalman filter: V = H_x P H_x' + H_m S H_m' + Q, K = P H_x' V^-1. The pose is drawn from the result q, and the
    landmarks are updated from that pose as in 1.0. Steps without sightings of known landmarks move as in 1.0, without
    linearisation.

    With the proposal_weight "exact" the weight is multiplied by p(x) / q(x) and by the likelihoods of 1.0 at the drawn
    pose x, so 1.0 and 2.0 have the same posterior (`proposal`). With "linearised", as in the lectures and the original, it
    is multiplied by the likelihoods under the prediction, N(z; h(x, m), V), which is biased where h or f is not linear.

    A landmark seen several times in one step enters the proposal once, with its first sighting. The other sightings use
    the drawn pose and are weighed with the V of 1.0, as are all sightings where nothing moved (the first step, dt = 0).

    `move` draws the motion and `observe` corrects it with the same random numbers, so the poses of a step change when
    sightings arrive. Give all sightings of a step in one call; those of a second call only change the weights, as in
    1.0. With unknown association the landmarks are chosen under the prediction, before any of them corrects it; a step
    with new landmarks only is drawn from the linearised motion.
    """

    def _check_options(self) -> None:
        if self.options.range_noise == "estimated" and self.options.proposal_weight != "exact":
            raise OptionError(
                f"FastSLAM 2.0 with range_noise {self.options.range_noise} needs the proposal_weight exact, not "
                f"{self.options.proposal_weight}, which is that of the measured range: leave out one of them"
            )

    def _weigh_identified(self, maps: IdentifiedLandmarks, ids: np.ndarray, sightings: Array, q: Array) -> Array | None:
        # the first sighting of each known landmark
        leading: dict[int, int] = {}
        for k, j in enumerate(ids.tolist()):
            if j in maps:
                leading.setdefault(j, k)
        if self._motion is None or not leading:
            return super()._weigh_identified(maps, ids, sightings, q)
        motion, exact = self._motion, self.options.proposal_weight == "exact"
        log_likelihood, unused = np.zeros(self.particles), np.zeros(self.particles)
        # a leading sighting is weighed once: under the prediction, or exactly at the drawn pose
        predicted, leaders = (unused, log_likelihood) if exact else (log_likelihood, unused)
        belief, poses = np.empty((9, self.particles)), np.empty_like(self._poses)
        proposal = [motion.predict(belief, exact)]
        for j, k in leading.items():
            proposal.append((landmark_kernels.correct, (belief, *maps.read(j), sightings[k], q[k], predicted)))
        if exact:
            arguments = motion.poses, belief, motion.key, motion.weighted(), poses, log_likelihood
            proposal.append((draw_weighted, arguments))
        else:
            proposal.append((draw, (belief, motion.key, poses)))
        for k, j in enumerate(ids.tolist()):
            if j not in maps:
                maps.initialize(j, poses, sightings[k], q[k])
                continue
            maps.update(j, poses, sightings[k], q[k], leaders if leading.get(j) == k else log_likelihood)
        maps.finish(before=proposal)
        self._set_poses(poses)
        return log_likelihood

    def _weigh_anonymous(self, maps: AnonymousLandmarks, sightings: Array, q: Array, shown: np.ndarray) -> Array:
        if self._motion is None:
            return super()._weigh_anonymous(maps, sightings, q, shown)
        log_likelihood = np.zeros(self.particles)
        belief, poses = np.empty((9, self.particles)), np.empty_like(self._poses)
        exact = self.options.proposal_weight == "exact"
        predict, arguments = self._motion.predict(belief, exact)
        self._threads.run(predict, *arguments)
        choices = self._choices(maps)
        maps.scan(belief, poses, sightings, q, self._step, log_likelihood, choices, shown, self._motion, exact)
        self._set_poses(poses)
        return log_likelihood
