"""FastSLAM 2.0: the pose is drawn from the motion already corrected by what is seen.

Sources: Montemerlo, Thrun, Koller and Wegbreit, *FastSLAM 2.0*, IJCAI 2003; *Probabilistic Robotics*, section 13.5 to
13.8.
"""

from __future__ import annotations

import numpy as np

from graphslam.se2 import Array

from . import proposal_kernels
from .association import AnonymousLandmarks
from .crew import Job
from .landmark_columns import LandmarkColumns
from .particle_filter import Leap, Motion
from .slam_filter import FastSLAM


class FastSLAM2(FastSLAM):
    """FastSLAM 2.0, on sightings with or without psi. Arguments and unknown association as in `FastSLAM1`.

    At a step that sees known landmarks each particle takes the motion as a Gaussian, mean f(x_{t-1}, u_t), covariance
    P = A M A' + epsilon I, and corrects it by one sighting after the other as a Kalman filter would,
    V = H_x P H_x' + H_m S H_m' + Q, K = P H_x' V^-1; the weight is multiplied by each N(z; h(x, m), V) on the way, the
    likelihood under the prediction. Then the pose is drawn from the result and the landmarks are updated from there,
    as in 1.0. Steps that see nothing known move as in 1.0, without linearisation.

    A landmark seen several times in one step enters the proposal once, with its first sighting; the others find the
    pose drawn and weigh with the V of 1.0. So do all sightings where nothing moved (the first step, dt = 0).

    `move` draws the motion and `observe` bends it, with the same random numbers: the poses of a step change when
    sightings come in. Hand in all sightings of a step in one call; those of a second call only weigh, as in 1.0.
    With unknown association the landmarks are chosen under the prediction, before any of them corrects it; a step that
    sees only new ones is drawn from the linearised motion.
    """

    def _weigh_known(self, columns: LandmarkColumns, ids: np.ndarray, sightings: Array, q: Array) -> Array | None:
        weighed = False
        log_likelihood, spent = np.zeros(self.particles), np.zeros(self.particles)
        leading: dict[int, int] = {}
        if self._motion is not None:
            for k, j in enumerate(ids.tolist()):
                if j in columns:
                    leading.setdefault(j, k)
        if leading:
            weighed = True
            bending, poses = self._bending(
                columns, [(j, sightings[k], q[k]) for j, k in leading.items()], log_likelihood
            )
        else:
            bending, poses = [], self._poses
        for k, j in enumerate(ids.tolist()):
            if j not in columns:
                columns.initialize(j, poses, sightings[k], q[k])
            elif leading.get(j) == k:
                # weighed already
                columns.update(j, poses, sightings[k], q[k], spent)
            else:
                weighed = True
                columns.update(j, poses, sightings[k], q[k], log_likelihood)
        columns.finish(before=bending)
        if leading:
            self._set_poses(poses)
        return log_likelihood if weighed else None

    def _weigh_anonymous(self, landmarks: AnonymousLandmarks, sightings: Array, q: Array) -> Array:
        if self._motion is None:
            return super()._weigh_anonymous(landmarks, sightings, q)
        log_likelihood = np.zeros(self.particles)
        belief, poses = np.empty((9, self.particles)), np.empty_like(self._poses)
        predict, arguments = self._prediction(self._motion, belief)
        self._crew.run(predict, *arguments)
        landmarks.scan(belief, poses, False, self._motion.key, sightings, q, self._step, log_likelihood)
        self._set_poses(poses)
        return log_likelihood

    def _prediction(self, motion: Motion | Leap, belief: Array) -> Job:
        """The prediction of the poses as Gaussians, as a job for the crew."""
        if isinstance(motion, Leap):
            covariance = tuple(motion.covariance[np.triu_indices(3)].tolist())
            return proposal_kernels.predict_leap, (motion.poses, motion.mean, covariance, belief)
        variances = motion.nu_std**2, motion.omega_std**2
        return proposal_kernels.predict, (
            motion.poses, motion.nu, motion.omega, *variances, motion.dt, self.motion.epsilon, belief,
        )  # fmt: skip

    def _bending(
        self, columns: LandmarkColumns, seen: list[tuple[int, Array, Array]], log_likelihood: Array
    ) -> tuple[list[Job], Array]:
        """Jobs that draw this step's poses again, corrected by sightings (id, z, q) of known landmarks; and the poses."""
        motion = self._motion
        assert motion is not None
        belief, poses = np.empty((9, self.particles)), np.empty_like(self._poses)
        jobs: list[Job] = [self._prediction(motion, belief)]
        for j, z, q in seen:
            jobs.append((proposal_kernels.correct, (belief, *columns.read(j), z, q, log_likelihood)))
        jobs.append((proposal_kernels.draw, (belief, motion.key, poses)))
        return jobs, poses
