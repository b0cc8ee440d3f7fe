"""A log with named landmarks as a graph of GTSAM's own factors, solved by GTSAM: the reference row of the tables.

PriorFactorPose2 on the first pose, BetweenFactorPose2 for the motions, BearingRangeFactor2D for the sightings. The
nodes are poses of the sensor, because GTSAM's bearing-range factor knows no offset: with an offset o a motion d becomes
o^-1 d o, and its covariance is carried along.
"""

from __future__ import annotations

import time

import gtsam
import numpy as np

from comparisons.estimators import make_graph
from comparisons.options import RunOptions
from comparisons.results import EstimatorResult
from graphslam import Log, SensorModel
from graphslam.edges.robust import KERNELS
from graphslam.se2 import Array, compose, inverse, rotation
from graphslam.solvers.initialize import starting_state

#: GTSAM's Levenberg-Marquardt stops when a step changes its error by less than this part of it
TOLERANCE = 1e-10


def native_gtsam(log: Log, options: RunOptions, start: Array | None = None) -> EstimatorResult:
    """Solve a log with GTSAM's own factors, landmarks as nodes, from the state that our solver starts from.

    Args:
        log: with controls and ids; psi is left out.
        options: noise models, ``kernel`` and ``initialize`` count.
        start: (T+1 + L, 3) another state to begin from.
    """
    log = log.without_orientation()
    motion, sensor = options.models(log.motion, log.sensor)
    if start is None:
        start = starting_state(make_graph(log, options), options.initialize)
    offset, ids, count = np.array([*sensor.offset, 0.0]), log.landmark_ids, log.num_poses
    factors = _motions(*log.motions(motion), offset)
    first = compose(log.initial_poses[0], offset)
    factors.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*first), gtsam.noiseModel.Isotropic.Sigma(3, 1e-3)))
    _sightings(factors, log, sensor, options.kernel)
    values = gtsam.Values()
    for node, pose in enumerate(compose(start[:count], offset)):
        values.insert(node, gtsam.Pose2(*pose))
    for j, point in enumerate(start[count:, :2]):
        values.insert(count + j, gtsam.Point2(*point))

    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(TOLERANCE)
    parameters.setAbsoluteErrorTol(0.0)
    parameters.setMaxIterations(1000)
    begin = time.perf_counter()
    optimizer = gtsam.LevenbergMarquardtOptimizer(factors, values, parameters)
    reason = "stopped by its own rule"
    try:
        values = optimizer.optimize()
    except RuntimeError as error:
        reason = f"gave up: {str(error).strip().splitlines()[0]}"
    seconds = time.perf_counter() - begin
    poses = compose(gtsam.utilities.extractPose2(values), inverse(offset))
    places = gtsam.utilities.extractPoint2(values)
    return EstimatorResult(
        name="gtsam-native",
        poses=poses,
        estimated=np.ones(count, dtype=bool),
        seconds=seconds,
        converged=reason.startswith("stopped") and optimizer.iterations() < 1000,
        iterations=optimizer.iterations(),
        # GTSAM's error has one half
        cost=2 * factors.error(values),
        landmarks=dict(zip(ids.tolist(), places)),
        reason=reason,
    )


def _motions(motions: Array, covariances: Array, offset: Array) -> gtsam.NonlinearFactorGraph:
    factors = gtsam.NonlinearFactorGraph()
    carried = compose(compose(inverse(offset), motions), offset)
    # where the end of the motion is uncertain in heading, the sensor swings about it
    lever = np.einsum("eij,j->ei", rotation(motions[:, 2]), offset[:2])
    J = np.broadcast_to(np.eye(3), covariances.shape).copy()
    J[:, 0, 2], J[:, 1, 2] = -lever[:, 1], lever[:, 0]
    # GTSAM's residual of a pose lies in the frame of its end, ours in that of its beginning
    turn = np.broadcast_to(np.eye(3), covariances.shape).copy()
    turn[:, :2, :2] = rotation(-motions[:, 2])
    J = turn @ J
    for t, (motion, covariance) in enumerate(zip(carried, J @ covariances @ np.swapaxes(J, 1, 2))):
        noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
        factors.add(gtsam.BetweenFactorPose2(t, t + 1, gtsam.Pose2(*motion), noise))
    return factors


def _sightings(factors: gtsam.NonlinearFactorGraph, log: Log, sensor: SensorModel, kernel: str) -> None:
    names = {"huber": gtsam.noiseModel.mEstimator.Huber, "cauchy": gtsam.noiseModel.mEstimator.Cauchy}
    nodes = log.num_poses + np.searchsorted(log.landmark_ids, log.landmarks)
    # BearingRangeFactor2D has the bearing first
    sigmas = np.sqrt(np.diagonal(sensor.Q(log.sightings), axis1=1, axis2=2))[:, ::-1]
    for t, j, (length, bearing), sigma in zip(log.steps.tolist(), nodes.tolist(), log.sightings.tolist(), sigmas):
        noise = gtsam.noiseModel.Diagonal.Sigmas(sigma)
        if kernel != "none":
            noise = gtsam.noiseModel.Robust.Create(names[kernel].Create(KERNELS[kernel].of_dimension(2).width), noise)
        factors.add(gtsam.BearingRangeFactor2D(t, j, gtsam.Rot2(bearing), length, noise))
