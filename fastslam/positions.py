"""The first poses of particles, absolute positions as weights of particles, and whether both have the same frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from graphslam import Graph, solve
from graphslam.edges import AnchorEdges
from graphslam.errors import GraphError, OptionError
from graphslam.errors.checks import finite_numbers
from graphslam.graph.landmark_map import LandmarkMap
from graphslam.graph.localization import SURE, Fix, first_fix
from graphslam.log import Log
from graphslam.log.measurements import AbsolutePositions
from graphslam.models import MotionModel, SensorModel
from graphslam.se2 import Array, transform, wrap

#: the standard deviations of particles around a first fix, over those of the fix
SPREAD = 2.0
#: from this distance on, in standard deviations, a start is in another frame than the positions; far, because covariances of
#: pairs of sightings, and those of odometry with other noise than its model, are too small
OTHER_FRAME = 10.0


def first_poses(start: ArrayLike | Fix | None, log: Log | None, particles: int, rng: np.random.Generator) -> Array:
    """The first poses of the robot, (N, 3): where `ParticleFilter` has its ``start``, one for all or one per particle."""
    if start is None:
        start = np.zeros(3) if log is None else log.initial_poses[0]
    elif isinstance(start, Fix):
        start = rng.multivariate_normal(start.pose, SPREAD**2 * start.covariance, particles)
    poses = np.empty((particles, 3))
    poses[:] = finite_numbers("start", start, (3,), (particles, 3))
    poses[:, 2] = wrap(poses[:, 2])
    return poses


def in_map(
    start: ArrayLike | Fix | None, log: Log | None, known: LandmarkMap | None, motion: MotionModel, sensor: SensorModel
) -> ArrayLike | Fix | None:
    """A start that is given; else the first fix in a map where the log's own first pose is in another frame, or None.

    As with positions (`in_frame`), the two are compared by the Mahalanobis distance. With positions, `in_frame` finds the
    start. Without a fix, or with one that is not sure, the filter begins at the log's own first pose.
    """
    if start is not None or log is None or known is None or log.positions is not None or not len(log.steps):
        return start
    try:
        # the filter itself refuses a log with impossible numbers
        with np.errstate(all="ignore"):
            fix = first_fix(log, known, motion=motion, sensor=sensor)
    except (GraphError, np.linalg.LinAlgError):
        return None
    way = log.initial_poses[0] - fix.pose
    way[2] = wrap(way[2])
    far = way @ np.linalg.solve(fix.covariance, way) > OTHER_FRAME**2
    return fix if far and fix.odds > SURE else None


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


def in_frame(
    poses: Array, log: Log, motion: MotionModel, sensor: SensorModel, rng: np.random.Generator, given: bool
) -> Array:
    """First poses (N, 3) in the frame of the positions of a log; drawn anew where a start that nobody gave is in another one.

    The graph of the log puts the first pose at x with covariance P; under Cauchy's kernel one wrong position counts little.
    The start m is compared by the Mahalanobis distance (m - x)' (P + C)^-1 (m - x), C the covariance of the poses.

    Raises:
        OptionError: a start that was given contradicts the positions.
    """
    assert log.positions is not None
    if not len(log.positions.steps):
        return poses
    used = log if log.identified else log.with_sightings(np.zeros(len(log.steps), dtype=bool))
    graph = Graph.from_log(
        used.replace(partial_sightings=None, relations=None), motion=motion, sensor=sensor, kernel="cauchy"
    )
    solution = solve(graph)
    x, P = solution.poses[0], solution.covariance(poses=[0])[0]
    mean = np.array([*poses[:, :2].mean(axis=0), np.angle(np.exp(1j * poses[:, 2]).mean())])
    e = np.column_stack([poses[:, :2] - mean[:2], wrap(poses[:, 2] - mean[2])])
    off = np.array([*(mean - x)[:2], wrap(mean[2] - x[2])])
    distance = np.sqrt(off @ np.linalg.solve(P + e.T @ e / len(e), off))
    if distance <= OTHER_FRAME:
        return poses
    if not given:
        poses = rng.multivariate_normal(x, SPREAD**2 * P, len(poses))
        poses[:, 2] = wrap(poses[:, 2])
        return poses
    # the positions may leave the direction open; then the anchor holds that of the odometry, which a start may differ from
    if any(isinstance(family, AnchorEdges) for family in graph.families):
        return poses

    def place(pose: Array) -> str:
        return f"({pose[0]:.2f}, {pose[1]:.2f}) m, {np.degrees(pose[2]):.0f} deg"

    raise OptionError(
        f"the start {place(mean)} is {distance:.0f} standard deviations from {place(x)}, where the positions of {log.name} "
        "put the first pose: give a start in their frame, or none, or leave the positions out by log.replace(positions=None)"
    )
