"""The posterior that FastSLAM samples, by Gauss-Newton on the full problem with dense matrices: poses and landmarks.

J = sum over motions (x_t - f(x_{t-1}, u_t))' (A M A' + epsilon I)^-1 (...) + sum over sightings (z - h(x, m))' Q^-1 (...),
the first pose known, Q at the measured range, as in the filter. Its minimum and the inverse of its information are the
mean and the covariance of the posterior as far as it is Gaussian.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graphslam import Log, MotionModel, SensorModel
from graphslam.se2 import wrap


@dataclass(frozen=True)
class Posterior:
    """Poses (t+1, 3), landmarks {id: (2,)}, the joint covariance, and where each variable begins in it."""

    poses: np.ndarray
    landmarks: dict[int, np.ndarray]
    covariance: np.ndarray

    def pose_covariance(self, step: int) -> np.ndarray:
        return self.covariance[3 * step - 3 : 3 * step, 3 * step - 3 : 3 * step]

    def landmark_covariance(self, landmark: int) -> np.ndarray:
        at = 3 * len(self.poses) - 3 + 2 * list(self.landmarks).index(landmark)
        return self.covariance[at : at + 2, at : at + 2]


def spread(parts: list[tuple[int, np.ndarray]], size: int) -> np.ndarray:
    """A Jacobian from its blocks and the columns where they begin; a block before column 0 is of the known pose."""
    J = np.zeros((len(parts[0][1]), size))
    for at, block in parts:
        if at >= 0:
            J[:, at : at + block.shape[1]] += block
    return J


def exact_posterior(log: Log, last: int, motion: MotionModel, sensor: SensorModel) -> Posterior:
    """The posterior of poses 0 to ``last`` and of the landmarks seen so far; sightings without psi."""
    used = log.steps <= last
    steps, ids, sightings = log.steps[used], log.landmarks[used], log.sightings[used]
    names = sorted(set(ids.tolist()))
    size = 3 * last + 2 * len(names)
    poses, landmarks = log.initial_poses[: last + 1].copy(), {}
    for t, j, z in zip(steps, ids.tolist(), sightings):
        landmarks.setdefault(j, sensor.h_inverse(poses[t], z))
    landmarks = {j: landmarks[j] for j in names}
    for _ in range(50):
        rows = []  # Jacobian, residual, information of each term
        for t in range(1, last + 1):
            u, dt = log.controls[t - 1], log.dt[t - 1]
            e = poses[t] - motion.f(poses[t - 1], u, dt)
            e[2] = wrap(e[2])
            W = np.linalg.inv(motion.covariance(poses[t - 1], u, dt))
            rows.append((spread([(3 * t - 3, np.eye(3)), (3 * t - 6, -motion.F(poses[t - 1], u, dt))], size), e, W))
        for t, j, z in zip(steps, ids.tolist(), sightings):
            e = sensor.h(poses[t], landmarks[j]) - z
            e[1:] = wrap(e[1:])
            parts = [
                (3 * t - 3, sensor.H_pose(poses[t], landmarks[j])),
                (3 * last + 2 * names.index(j), sensor.H(poses[t], landmarks[j])),
            ]
            rows.append((spread(parts, size), e, np.linalg.inv(sensor.Q(z))))
        Omega = sum(J.T @ W @ J for J, _, W in rows)
        xi = -sum(J.T @ W @ e for J, e, W in rows)
        step = np.linalg.solve(Omega, xi)
        poses[1:] += step[: 3 * last].reshape(-1, 3)
        for k, j in enumerate(names):
            landmarks[j] = landmarks[j] + step[3 * last + 2 * k : 3 * last + 2 * k + 2]
        if np.linalg.norm(step) < 1e-9:
            break
    else:
        raise AssertionError("the exact posterior did not converge")
    return Posterior(poses, landmarks, np.linalg.inv(Omega))
