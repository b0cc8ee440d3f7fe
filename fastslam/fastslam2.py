"""FastSLAM 2.0: the pose is drawn from the motion model, corrected by the sightings of the step.

Sources: Montemerlo, Thrun, Koller and Wegbreit, *FastSLAM 2.0*, IJCAI 2003; *Probabilistic Robotics*, section 13.5 to
13.8.
"""

from __future__ import annotations

from graphslam.errors import OptionError

from .fastslam1 import FastSLAM1

#: how the engine draws the poses: corrected by the sightings, with exact weights or with those of the lectures
CORRECTED_EXACT, CORRECTED_LINEARISED = 1, 2


class FastSLAM2(FastSLAM1):
    """FastSLAM 2.0, for sightings with or without psi; arguments and unknown association as in `FastSLAM1`.

    At a step with sightings of known landmarks each particle takes the motion as a Gaussian with mean f(x_{t-1}, u_t)
    and covariance P = A M A' + epsilon I (plus that of a slip), and corrects it by one sighting after the other as a
    Kalman filter: V = H_x P H_x' + H_m S H_m' + Q, K = P H_x' V^-1. The pose is drawn from the result q, and the
    landmarks are updated from that pose as in 1.0. Steps without sightings of known landmarks move as in 1.0, without
    linearisation.

    With the proposal_weight "exact" the weight is multiplied by p(x) / q(x) and by the likelihoods of 1.0 at the drawn
    pose x, so 1.0 and 2.0 have the same posterior
    (`vmslam/particles/proposal.hpp` in the engine). With "linearised", as in the lectures and the original, it
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

    @property
    def _poses_drawn(self) -> int:
        return CORRECTED_EXACT if self.options.proposal_weight == "exact" else CORRECTED_LINEARISED
