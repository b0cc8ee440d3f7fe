"""Certificates of GTSAM graphs of our factors."""

from __future__ import annotations

import numpy as np
import pytest

from graphslam import Graph, MotionModel, OptionError, certify, solve
from graphslam.se2 import between


@pytest.mark.parametrize("farther", [None, 1.3])
def test_gtsam_graphs_of_our_factors(farther):
    """Also where the noise is evaluated at sightings that are farther away."""
    gtsam = pytest.importorskip("gtsam")
    from graphslam import SensorModel
    from graphslam.factors import (
        AnchorFactor,
        LandmarkFactor,
        MotionFactor,
        ObservationFactor,
        RelativeEdgesFactor,
        RelativePointFactor,
        RelativePoseFactor,
        VirtualMotionFactor,
    )

    rng = np.random.default_rng(0)
    sensor, motion = SensorModel(), MotionModel()
    poses = [np.array([0.0, 0.0, 0.0])]
    for _ in range(3):
        poses.append(motion.f(poses[-1], (0.5, 0.3), 1.0))
    landmark = np.array([2.0, 1.0, 0.3])
    z = [sensor.h(x, landmark) + 0.02 * rng.standard_normal(3) for x in poses]
    at = [None if farther is None else each * [farther, 1.0, 1.0] for each in z]

    def noise(*which):
        return None if farther is None else [at[k] for k in which]

    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(AnchorFactor(0, poses[0]))
    for k in range(3):
        graph.add(MotionFactor(k, k + 1, (0.5, 0.3), 1.0, motion, scale=2.0))
        graph.add(VirtualMotionFactor(k + 1, k, z[k + 1], z[k], sensor, scale=0.5, noise_at=noise(k + 1, k)))
    graph.add(LandmarkFactor([0, 2, 3], [z[0], z[2], z[3]], sensor, weight="marginal", noise_at=noise(0, 2, 3)))
    graph.add(LandmarkFactor([3, 2, 0], [z[3], z[2], z[0]], sensor, weight="tempered", noise_at=noise(3, 2, 0)))
    graph.add(RelativePoseFactor(0, 3, between(poses[0], poses[3]), np.diag([4.0, 9.0, 16.0])))
    graph.add(RelativePointFactor(0, 10, [2.0, 1.1], np.diag([4.0, 9.0])))
    for k in range(4):
        graph.add(ObservationFactor(k, 10, z[k][:2], sensor, noise_at=None if farther is None else at[k][:2]))
        values.insert(k, gtsam.Pose2(*poses[k]))
    values.insert(10, gtsam.Point2(2.0, 1.0))
    end = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    proof = certify(graph, end)
    assert proof.status == "global"
    assert proof.lower_bound == pytest.approx(2 * graph.error(end), rel=1e-6)
    # many edges in one factor, and a factor that was removed
    graph.add(RelativeEdgesFactor(
        [0, 1, 3, 10], [0, 1, 0], [1, 2, 3], [between(poses[0], poses[1]), between(poses[1], poses[3]), [2.0, 1.1, 0.0]],
        np.array([np.eye(3)] * 3), points=1,
    ))  # fmt: skip
    graph.add(AnchorFactor(0, [5.0, 5.0, 1.0]))
    graph.remove(graph.size() - 1)
    again = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    proof = certify(graph, again)
    assert proof.status == "global"
    assert proof.lower_bound == pytest.approx(2 * graph.error(again), rel=1e-6)
    held = gtsam.NonlinearFactorGraph(graph)
    held.add(gtsam.BetweenFactorPose2(0, 1, gtsam.Pose2(), gtsam.noiseModel.Unit.Create(3)))
    refused = certify(held, end)
    assert refused.status == "not applicable"
    assert "logarithm" in refused.reason
    with pytest.raises(OptionError, match="nothing at the key"):
        certify(graph, gtsam.Values())


def test_landmarks_that_are_held_are_certified(clean_log):
    pytest.importorskip("gtsam")
    from graphslam.solvers.gtsam_factors import to_gtsam, to_values

    log = clean_log.without_orientation()
    known = {j: place[:2] for j, place in log.true_landmarks.items()}
    graph = Graph.from_log(log, edges="landmark+motion", kernel="none", map=known)
    solution = solve(graph)
    ours, theirs = solution.certificate, certify(to_gtsam(graph), to_values(graph, solution.state))
    assert theirs.status == ours.status
    assert theirs.lower_bound == pytest.approx(ours.lower_bound, rel=1e-6)


def test_gtsam_graph_with_a_fixed_pose_and_a_kernel():
    gtsam = pytest.importorskip("gtsam")
    from graphslam.factors import RelativePoseFactor

    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in range(3):
        graph.add(RelativePoseFactor(k, (k + 1) % 3, [1.0, 0.1, 2.1], np.eye(3)))
        values.insert(k, gtsam.Pose2(0.0, 0.0, 2.1 * k))
    free = gtsam.NonlinearFactorGraph(graph)
    graph.add(gtsam.NonlinearEqualityPose2(0, values.atPose2(0)))
    end = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    assert certify(graph, end).status == "global"
    violated = gtsam.NonlinearFactorGraph(graph)
    violated.add(gtsam.NonlinearEqualityPose2(1, gtsam.Pose2(0.0, 0.0, 1.0)))
    proof = certify(violated, end)
    assert proof.status == "not proven" and "violates a constraint" in proof.reason
    free.add(gtsam.NonlinearEqualityPose2(0, values.atPose2(0), 10.0))
    assert "error gain" in certify(free, end).reason
    graph.add(RelativePoseFactor(0, 1, [1.0, 0.1, 2.1], np.eye(3), kernel="huber"))
    assert "kernel" in certify(graph, end).reason
