"""The first poses of particles, absolute positions as weights of particles, and whether both have the same frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from graphslam.errors import OptionError
from graphslam.graph.defaults import position_edges
from graphslam.graph.localization import Fix
from graphslam.log import Log
from graphslam.log.measurements import AbsolutePositions
from graphslam.models import MotionModel
from graphslam.se2 import Array, compose, perpendicular, transform, turn_matrix, wrap

from .options import finite

#: the standard deviations of particles around a first fix, over those of the fix
SPREAD = 2.0
#: how many positions at the beginning of a log are compared with the odometry
FIRST = 10
#: from this distance on, in standard deviations, positions and odometry have different frames: half of the first positions
#: are as far from dead reckoning
OTHER_FRAME = 10.0


def first_poses(start: ArrayLike | Fix | None, log: Log | None, particles: int, rng: np.random.Generator) -> Array:
    """The first poses of the robot, (N, 3): where `ParticleFilter` has its ``start``, one for all or one per particle."""
    if start is None:
        start = np.zeros(3) if log is None else log.initial_poses[0]
    elif isinstance(start, Fix):
        start = rng.multivariate_normal(start.pose, SPREAD**2 * start.covariance, particles)
    poses = np.empty((particles, 3))
    expected = f"a finite pose (3,) or one per particle ({particles}, 3)"
    poses[:] = finite("start", start, expected, [(3,), (particles, 3)])
    poses[:, 2] = wrap(poses[:, 2])
    return poses


def one_position(position: ArrayLike, covariance: ArrayLike, lever: ArrayLike) -> AbsolutePositions:
    """A position (x, y) or (x, y, theta) as the only row of positions, checked."""
    places, covariances = np.array([position], dtype=float), np.asarray(covariance, dtype=float)
    steps = np.zeros(1, dtype=np.int64)
    return AbsolutePositions(steps=steps, places=places, covariances=covariances, levers=np.asarray(lever, dtype=float))


def log_likelihoods(positions: AbsolutePositions, poses: Array) -> Array:
    """The sums over positions of log N(e; 0, C), e = p + R(theta) a - (x, y), for poses (N, 3); (N,).

    Where the heading is measured, theta - theta_z is the third number of e.
    """
    total = np.zeros(len(poses))
    for z, C, lever, oriented in zip(positions.places, positions.covariances, positions.levers, positions.oriented):
        d = 3 if oriented else 2
        e = np.column_stack([transform(poses, lever) - z[:2], wrap(poses[:, 2] - z[2])])[:, :d]
        root = np.linalg.cholesky(C[:d, :d])
        # einsum adds in one order, whatever the number of threads
        whitened = np.einsum("ij,nj->ni", np.linalg.inv(root), e)
        total -= 0.5 * np.sum(whitened**2, axis=1) + np.log(np.diag(root)).sum() + d / 2 * np.log(2 * np.pi)
    return total


def check_frame(log: Log, motion: MotionModel, start: Array) -> None:
    """Raise `OptionError` where the first positions of a log contradict its odometry from the first poses (N, 3).

    Positions are compared with dead reckoning, whose covariance is J (F C F' + G P G') J' + that of the position; C is that
    of the first poses, P that of the motion. Their median counts, so that a wrong one is no contradiction.
    """
    assert log.positions is not None
    order = np.argsort(log.positions.steps, kind="stable")[:FIRST]
    if not len(order):
        return
    mean = np.array([*start[:, :2].mean(axis=0), np.angle(np.exp(1j * start[:, 2]).mean())])
    away = start - mean
    away[:, 2] = wrap(away[:, 2])
    first = away.T @ away / len(start)
    poses, covariances = np.tile(mean, (len(order), 1)), np.tile(first, (len(order), 1, 1))
    turned = turn_matrix(mean[2])
    for k, step in enumerate(log.positions.steps[order].tolist()):
        if step == 0:
            continue
        motions, of_motion = log.at_steps([0, step]).motions(motion)
        poses[k] = compose(mean, motions[0])
        F = np.eye(3)
        F[:2, 2] = perpendicular(poses[k, :2] - mean[:2])
        covariances[k] = F @ first @ F.T + turned @ of_motion[0] @ turned.T
    distances = []
    for edges in position_edges(log.positions.among(order), np.arange(len(order))):
        linear = edges.linearize(poses, poses)
        B, e = linear.jacobians[0], linear.residuals
        S = B @ covariances[edges.nodes] @ np.swapaxes(B, 1, 2) + np.linalg.inv(linear.information)
        distances.append(np.einsum("ka,ka->k", e, np.linalg.solve(S, e[..., None])[..., 0]))
    off = float(np.sqrt(np.median(np.concatenate(distances))))
    if off > OTHER_FRAME:
        raise OptionError(
            f"the first positions of {log.name} are {off:.0f} standard deviations from the odometry that begins at the first "
            "pose, which a particle filter expects in the frame of the positions: give start, such as "
            "solve(Graph.from_log(log)).poses[0], or leave the positions out by log.replace(positions=None)"
        )
