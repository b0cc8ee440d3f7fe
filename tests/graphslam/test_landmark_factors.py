"""Factors of a landmark: as a node, eliminated, and all pairs at once; Jacobians at 200 states away from the solution."""

import gtsam
import numpy as np
import pytest
from gtsam.utils.numerical_derivative import numericalDerivative11

from graphslam import SensorModel
from graphslam.factors import (
    InverseObservationFactor,
    LandmarkFactor,
    ObservationFactor,
    RelativePointFactor,
    RelativePoseFactor,
    VirtualMotionFactor,
)
from graphslam.se2 import wrap

#: one at the robot's pose, and one ahead and to the left of it, with a constant part in the noise of its range
SENSORS = [SensorModel(), SensorModel(range_std=0.05, offset=(0.4, -0.2))]
sensors = pytest.mark.parametrize("sensor", SENSORS, ids=["centred", "offset"])
STATES = 200


def values_of(*at):
    values = gtsam.Values()
    for key, value in enumerate(at):
        values.insert(key, gtsam.Pose2(*value) if len(value) == 3 else gtsam.Point2(*value))
    return values


def numeric(factor, at, angles):
    """The Jacobian by GTSAM's numerical derivatives of the unwhitened error, key by key; ``angles``: rows that wrap."""
    columns = []
    e = factor.unwhitenedError(values_of(*at))
    for key, value in enumerate(at):

        def error(moved, key=key):
            values = values_of(*at)
            values.update(key, moved)
            off = factor.unwhitenedError(values) - e
            off[angles] = wrap(off[angles])
            return off

        columns.append(
            numericalDerivative11(error, gtsam.Pose2(*value) if len(value) == 3 else gtsam.Point2(*value), 1e-6)
        )
    return np.hstack(columns)


def check(factor, at, angles=()):
    jacobian, rhs = factor.linearize(values_of(*at)).jacobian()
    whiten = factor.noiseModel().R()
    expected = whiten @ numeric(factor, at, list(angles))
    np.testing.assert_allclose(jacobian, expected, atol=1e-6 * max(1.0, np.abs(expected).max()))
    np.testing.assert_allclose(rhs, -whiten @ factor.unwhitenedError(values_of(*at)), rtol=1e-9, atol=1e-9)


def random_poses(rng, count=2):
    return np.column_stack([rng.uniform(-5, 5, (count, 2)), rng.uniform(-np.pi, np.pi, count)])


def random_sightings(rng, count, d):
    return np.column_stack([rng.uniform(0.5, 5, count), rng.uniform(-np.pi, np.pi, (count, 2))])[:, :d]


@pytest.mark.slow
@sensors
def test_observations_of_landmark_nodes(sensor):
    rng = np.random.default_rng(1)
    for _ in range(STATES // len(SENSORS)):
        x, m = random_poses(rng)
        z = random_sightings(rng, 1, 3)[0]
        if np.hypot(*(m - sensor.mount(x))[:2]) > 0.3:
            check(ObservationFactor(0, 1, z, sensor, residual="polar"), [x, m], angles=[1, 2])
            ours = ObservationFactor(0, 1, z[:2], sensor, residual="polar", scale=1.7)
            check(ours, [x, m[:2]], angles=[1])
            fastest = ours.fastest()
            assert (type(fastest) is gtsam.BearingRangeFactor2D) == sensor.centred
            values = values_of(x, m[:2])
            assert fastest.error(values) == pytest.approx(ours.error(values), rel=1e-9)
            a, b = (factor.linearize(values).augmentedJacobian() for factor in (fastest, ours))
            np.testing.assert_allclose(a.T @ a, b.T @ b, rtol=1e-9, atol=1e-9 * np.abs(b.T @ b).max())
            with_psi = ObservationFactor(0, 1, z, sensor, residual="polar")
            assert with_psi.fastest() is with_psi
        for sighted in (z, z[:2]):
            cartesian = ObservationFactor(0, 1, sighted, sensor)
            check(cartesian, [x, m[: len(sighted)]], angles=[2] if len(sighted) == 3 else [])
            inverse = InverseObservationFactor(0, 1, sighted, sensor)
            values = values_of(x, m[: len(sighted)])
            assert cartesian.error(values) == inverse.error(values)
            assert cartesian.fastest() is cartesian
        for frame in ("world", "body"):
            check(
                InverseObservationFactor(0, 1, z, sensor, frame=frame, at=random_poses(rng, 1)[0]), [x, m], angles=[2]
            )
            check(InverseObservationFactor(0, 1, z[:2], sensor, frame=frame, at=random_poses(rng, 1)[0]), [x, m[:2]])
        check(RelativePointFactor(0, 1, rng.normal(size=2), np.array([[2.0, 0.5], [0.5, 1.0]])), [x, m[:2]])


def test_relative_poses():
    rng = np.random.default_rng(2)
    omega = np.array([[4.0, 1.0, 0.5], [1.0, 3.0, 0.2], [0.5, 0.2, 2.0]])
    for _ in range(STATES):
        a, b = random_poses(rng)
        for frame in ("world", "body"):
            check(RelativePoseFactor(0, 1, rng.normal(size=3), omega, frame=frame, at=a + 0.1), [a, b], angles=[2])


@pytest.mark.slow
@sensors
@pytest.mark.parametrize("frame", ["world", "body"])
@pytest.mark.parametrize("d", [3, 2])
def test_the_landmark_eliminated(frame, d, sensor):
    rng = np.random.default_rng(3)
    for _ in range(STATES // 8):
        poses, mark = random_poses(rng, 4), random_poses(rng, 1)[0]
        node = np.array([0, 1, 2, 3, 1])
        z = sensor.h(poses[node], mark) + rng.normal(scale=0.1, size=(5, 3))
        z[:, 0] = np.abs(z[:, 0]) + 0.1
        at = poses[node] + rng.normal(scale=0.1, size=(5, 3))
        state = poses + rng.normal(scale=0.1, size=poses.shape)
        trust = rng.uniform(0.2, 1, 5)
        check(LandmarkFactor(node, z[:, :d], sensor, frame=frame, weight="marginal", at=at, trust=trust), list(state))


@pytest.mark.slow
@sensors
@pytest.mark.parametrize("frame", ["world", "body"])
@pytest.mark.parametrize("d", [3, 2])
@pytest.mark.parametrize("weight", ["pairs", "tempered"])
def test_all_pairs_in_one_factor(frame, d, weight, sensor):
    """Cost, gradient and Gauss-Newton matrix are those of one factor per pair, in fewer rows."""
    rng = np.random.default_rng(4)
    for _ in range(STATES // 8):
        node = np.array([0, 1, 2, 3, 1, 4])
        poses, z, trust = random_poses(rng, 5), random_sightings(rng, 6, d), rng.uniform(0.2, 1, 6)
        at = random_poses(rng, 6)
        one = LandmarkFactor(node, z, sensor, frame=frame, weight=weight, at=at, trust=trust)
        many = gtsam.NonlinearFactorGraph()
        for a in range(6):
            for b in range(a + 1, 6):
                if node[a] != node[b]:
                    w = trust[a] * trust[b] * (2 / trust.sum() if weight == "tempered" else 1.0)
                    i, j = node[a], node[b]
                    pair_at = (at[a], at[b])
                    many.add(VirtualMotionFactor(i, j, z[a], z[b], sensor, frame=frame, at=pair_at, scale=w))
        values = values_of(*poses)
        assert one.error(values) == pytest.approx(many.error(values), rel=1e-12)
        linear, expected = one.linearize(values), many.linearize(values).hessian()
        jacobian, rhs = linear.jacobian()
        assert len(rhs) == 3 * 5 + 1
        np.testing.assert_allclose(jacobian.T @ jacobian, expected[0], atol=1e-11 * np.abs(expected[0]).max())
        np.testing.assert_allclose(jacobian.T @ rhs, expected[1], atol=1e-11 * np.abs(expected[1]).max())
        assert rhs @ rhs / 2 == pytest.approx(one.error(values), rel=1e-12)


@sensors
@pytest.mark.parametrize("d", [3, 2])
def test_the_marginal_factor_is_the_minimum_over_the_landmark(d, sensor):
    rng = np.random.default_rng(5)
    poses, mark = random_poses(rng, 4), random_poses(rng, 1)[0]
    z = (sensor.h(poses, mark) + rng.normal(scale=0.1, size=(4, 3)))[:, :d]
    nodes = gtsam.NonlinearFactorGraph()
    for k in range(4):
        nodes.add(InverseObservationFactor(k, 4, z[k], sensor))
        nodes.add(gtsam.NonlinearEqualityPose2(k, gtsam.Pose2(*poses[k])))
    start = values_of(*poses, sensor.h_inverse(poses[0], z[0]))
    best = gtsam.LevenbergMarquardtOptimizer(nodes, start).optimize()
    marginal = LandmarkFactor(range(4), z, sensor, weight="marginal")
    assert marginal.error(values_of(*poses)) == pytest.approx(nodes.error(best), rel=1e-9)
