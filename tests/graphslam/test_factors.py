"""The factor types in a GTSAM graph of somebody else, away from the solution."""

import gc
import weakref

import gtsam
import numpy as np
import pytest
from gtsam.utils.numerical_derivative import numericalDerivative11, numericalDerivative21, numericalDerivative22
from hypothesis import assume, given
from hypothesis import strategies as st

from graphslam import MotionModel, OptionError, SensorModel, textbook
from graphslam.edges import freest_turn
from graphslam.factors import AnchorFactor, MotionFactor, PriorFactor, RelativePoseFactor, VirtualMotionFactor
from graphslam.factors.arguments import sighted_covariance
from graphslam.linear.precision import small_inverse
from graphslam.se2 import between, compose, perpendicular, wrap

sensor, motion = SensorModel(), MotionModel(slip=0.05)
x1, x2 = gtsam.symbol("x", 1), gtsam.symbol("x", 2)
# all angles, also those where the heading wraps
angle = st.one_of(st.floats(-np.pi, np.pi), st.sampled_from([-np.pi, np.pi, 0.0]))
position = st.floats(-10, 10)
pose = st.tuples(position, position, angle).map(np.array)
sighting = st.tuples(st.floats(0.3, 8), angle, angle).map(np.array)


def values_of(a, b):
    values = gtsam.Values()
    values.insert(x1, gtsam.Pose2(*a))
    values.insert(x2, gtsam.Pose2(*b))
    return values


def heading_does_not_wrap(e):
    return len(e) < 3 or abs(abs(wrap(e[2])) - np.pi) > 1e-3


def check(factor, a, b):
    """The factor's whitened Jacobian against GTSAM's numerical derivatives of its unwhitened error, whitened."""
    values = values_of(a, b)
    e = factor.unwhitenedError(values)
    assume(heading_does_not_wrap(e))
    linear = factor.linearize(values)
    jacobian, rhs = linear.jacobian()
    whiten = factor.noiseModel().R()

    def error(p, q):
        v = gtsam.Values()
        v.insert(x1, p)
        v.insert(x2, q)
        return factor.unwhitenedError(v)

    p, q = gtsam.Pose2(*a), gtsam.Pose2(*b)
    numeric = np.hstack([numericalDerivative21(error, p, q, 1e-6), numericalDerivative22(error, p, q, 1e-6)])
    scale = np.abs(whiten).max()
    np.testing.assert_allclose(jacobian, whiten @ numeric, atol=1e-6 * scale)
    np.testing.assert_allclose(rhs, -whiten @ e, atol=1e-9 * scale * (1 + np.abs(e).max()))


@given(pose, pose, sighting, sighting, st.sampled_from(["world", "body"]), st.sampled_from([2, 3]), pose, pose)
def test_virtual_motion_jacobians(a, b, z1, z2, frame, d, at1, at2):
    for model in (sensor, SensorModel(offset=(0.4, -0.2))):
        check(VirtualMotionFactor(x1, x2, z1[:d], z2[:d], model, frame=frame, at=(at1, at2)), a, b)


@given(pose, pose, st.floats(-1, 1), st.floats(-1, 1), st.floats(0.1, 3), st.sampled_from(["world", "body"]), pose)
def test_motion_jacobians(a, b, nu, omega, dt, frame, at):
    check(MotionFactor(x1, x2, [nu, omega], dt, motion, frame=frame, at=at), a, b)


@given(pose, pose, pose, pose, st.sampled_from([(3, 3), (2, 3), (3, 2), (2, 2)]))
def test_prior_jacobians(a, b, held_1, held_2, coordinates):
    n = sum(coordinates)
    omega = np.eye(n) + 0.1 * np.add.outer(np.arange(n), np.arange(n))
    factor = PriorFactor([x1, x2], [held_1, held_2], omega @ omega.T, coordinates=coordinates)
    e = factor.unwhitenedError(values_of(a, b))
    assert np.allclose(e[:2], a[:2] - held_1[:2]) and np.allclose(e[coordinates[0] :][:2], b[:2] - held_2[:2])
    assume(all(abs(abs(wrap(x[2] - held[2])) - np.pi) > 1e-3 for x, held in ((a, held_1), (b, held_2))))
    check(factor, a, b)


@given(st.lists(pose, min_size=3, max_size=3), pose, st.sampled_from([0, 3]))
def test_a_prior_that_turns_with_its_keys(values, moved, points):
    """Turning all keys about the pivot costs the squared angle, and the Jacobian is that of differences."""
    held = np.array([[0.0, 0, 0], [5, 1, 1], [-2, 4, -1]])
    rows = np.arange(9).reshape(3, 3)[:, : 2 if points else 3].ravel()
    A = np.eye(9) + 0.2 * np.sin(np.add.outer(np.arange(9), 3 * np.arange(9)))
    omega = np.zeros((9, 9))
    omega[np.ix_(rows, rows)] = (A @ A.T)[np.ix_(rows, rows)]
    pivot = freest_turn(held, omega)
    options = {"points": points, "pivot": pivot}
    factor = PriorFactor([1, 2, 3], held, omega[np.ix_(rows, rows)], **options)

    def at(nodes):
        filled = gtsam.Values()
        for key, node in enumerate(nodes, 1):
            filled.insert(key, gtsam.Point2(*node[:2]) if points else gtsam.Pose2(*node))
        return filled

    angle = 0.3 * moved[2]
    turned = compose([*pivot, angle], between([*pivot, 0.0], held))
    turned[:, 2] = held[:, 2] + (0 if points else angle)
    along = np.column_stack([perpendicular(held[:, :2] - pivot), np.full(3, 0.0 if points else 1.0)]).ravel()
    assert factor.error(at(turned)) == pytest.approx(0.5 * angle**2 * along @ omega @ along, abs=1e-9)
    # no other centre costs less
    for other in np.eye(2):
        away = np.column_stack([perpendicular(held[:, :2] - pivot - 0.1 * other), along.reshape(3, 3)[:, 2]]).ravel()
        assert away @ omega @ away > along @ omega @ along
    here = at(turned + 0.1 * np.array(values))
    jacobian, _ = factor.linearize(here).jacobian()
    columns = []
    for column in 1e-6 * np.eye(jacobian.shape[1]):
        change = gtsam.VectorValues()
        back = gtsam.VectorValues()
        for key, part in enumerate(np.split(column, 3), 1):
            change.insert(key, part)
            back.insert(key, -part)
        ahead, behind = (factor.unwhitenedError(here.retract(way)) for way in (change, back))
        columns.append((ahead - behind) / 2e-6)
    np.testing.assert_allclose(jacobian, factor.noiseModel().R() @ np.transpose(columns), atol=1e-6)


def test_a_prior_of_points_can_be_saved_and_says_what_it_needs(tmp_path):
    factor = PriorFactor([7, 9], [[1, 2, 3], [4, 5, 0]], np.diag([1.0, 2, 3, 4, 5]), points=1)
    values = gtsam.Values()
    values.insert(7, gtsam.Pose2(1.5, 2, 3))
    values.insert(9, gtsam.Point2(4, 6))
    # half of 1 * 0.5² + 5 * 1²
    assert factor.error(values) == pytest.approx(0.5 * (0.25 + 5))
    assert factor.description.build().error(values) == factor.error(values)
    with pytest.raises(OptionError, match="2 for points"):
        PriorFactor([7, 9], np.zeros((2, 3)), np.eye(6), coordinates=[3, 3], points=1)


@given(pose, pose)
def test_anchor_jacobian(a, held):
    omega = np.array([[4.0, 1.0, 0.5], [1.0, 3.0, 0.2], [0.5, 0.2, 2.0]])
    factor = AnchorFactor(x1, held, omega)
    values = gtsam.Values()
    values.insert(x1, gtsam.Pose2(*a))
    e = factor.unwhitenedError(values)
    assume(heading_does_not_wrap(e))

    def error(p):
        v = gtsam.Values()
        v.insert(x1, p)
        return factor.unwhitenedError(v)

    jacobian, _ = factor.linearize(values).jacobian()
    numeric = factor.noiseModel().R() @ numericalDerivative11(error, gtsam.Pose2(*a), 1e-6)
    np.testing.assert_allclose(jacobian, numeric, atol=1e-6)
    assert 2 * factor.error(values) == pytest.approx(e @ omega @ e, rel=1e-9)


@given(pose, pose, sighting, sighting, st.sampled_from([2, 3]))
def test_error_is_half_of_the_textbooks_cost(a, b, z1, z2, d):
    e, omega, _, _ = textbook.virtual_motion_edge(a, z1[:d], b, z2[:d], sensor)
    for frame in ("world", "body"):
        factor = VirtualMotionFactor(x1, x2, z1[:d], z2[:d], sensor, frame=frame, at=(a, b))
        if frame == "body" and d == 3:
            continue  # its information is its own; test_edges holds it against DESIGN's formula
        assert 2 * factor.error(values_of(a, b)) == pytest.approx(e @ omega @ e, rel=1e-7, abs=1e-9)


@given(pose, pose, st.floats(-1, 1), st.floats(0.01, 1), st.floats(0.1, 3))
def test_motion_error_is_half_of_the_textbooks_cost(a, b, nu, omega, dt):
    e, information, _, _ = textbook.motion_edge(a, b, np.array([nu, omega]), dt, motion)
    for frame in ("world", "body"):
        factor = MotionFactor(x1, x2, [nu, omega], dt, motion, frame=frame, at=a)
        assert 2 * factor.error(values_of(a, b)) == pytest.approx(e @ information @ e, rel=1e-6)


def test_a_graph_of_somebody_else():
    """Our factors between GTSAM's own, as in docs/factors.md."""
    landmark, truth = np.array([2.0, 1.0, 0.3]), [gtsam.Pose2(0, 0, 0), gtsam.Pose2(1, 0.2, 0.4)]
    z = [sensor.h([p.x(), p.y(), p.theta()], landmark) for p in truth]
    graph = gtsam.NonlinearFactorGraph()
    graph.add(gtsam.PriorFactorPose2(x1, truth[0], gtsam.noiseModel.Isotropic.Sigma(3, 1e-3)))
    graph.add(VirtualMotionFactor(x1, x2, z[0], z[1], sensor))
    initial = values_of([0.1, -0.1, 0.05], [0.8, 0.4, 0.2])
    result = gtsam.LevenbergMarquardtOptimizer(graph, initial).optimize()
    assert result.atPose2(x2).equals(truth[1], 1e-6)


def test_what_may_be_given_by_position():
    """Keys, measurements and their models by position; everything else by name, so that no two numbers are confused."""
    z_1, z_2 = [1.0, 0.1, 0.2], [1.5, 0.2, 0.1]
    factor = VirtualMotionFactor(x1, x2, z_1, z_2, sensor, frame="body")
    assert factor.description == VirtualMotionFactor(x1, x2, z_1=z_1, z_2=z_2, sensor=sensor).description
    for make in (
        lambda: VirtualMotionFactor(x1, x2, z_1, z_2, sensor, "body"),
        lambda: MotionFactor(x1, x2, [1, 0], 1.0, motion, "body"),
        lambda: RelativePoseFactor(x1, x2, [1, 0, 0], np.eye(3), "body"),
        lambda: AnchorFactor(x1, [0, 0, 0], np.eye(3), "huber"),
    ):
        with pytest.raises(TypeError, match="positional argument"):
            make()


@given(sighting, angle, st.sampled_from([2, 3]))
def test_the_covariance_of_one_sighting_is_the_sensor_models(z, theta, d):
    model = SensorModel(range_rate=0.1, range_std=0.05)
    covariance = sighted_covariance(theta, z[:d].tolist(), model)
    np.testing.assert_allclose(covariance, model.landmark_covariance([0, 0, theta], z[:d]), atol=1e-14 * z[0] ** 2)


@given(st.floats(-2, 2), st.one_of(st.floats(-2, 2), st.sampled_from([0.0, 1e-9, 0.19999, 0.2])), st.floats(0.01, 3))
def test_the_motion_from_the_origin_is_the_motion_models(nu, omega, dt):
    model = MotionModel(slip=0.05, sigma_v=0.02, sigma_omega=0.01)
    moved, covariance = model.moved([nu, omega], dt)
    np.testing.assert_allclose(moved, model.f([0, 0, 0], [nu, omega], dt), atol=1e-14)
    np.testing.assert_allclose(covariance, model.covariance([0, 0, 0], [nu, omega], dt), rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(small_inverse(covariance) @ covariance, np.eye(3), atol=1e-8)


def test_the_inverse_of_one_matrix():
    """Lengths of very different size lose no digits, and what is not positive definite has none."""
    scale = np.diag([1e-9, 1.0, 1e9])
    matrix = scale @ [[2.0, 0.3, 0.1], [0.3, 1.0, -0.4], [0.1, -0.4, 3.0]] @ scale
    exact = np.linalg.inv([[2.0, 0.3, 0.1], [0.3, 1.0, -0.4], [0.1, -0.4, 3.0]])
    np.testing.assert_allclose(scale @ small_inverse(matrix.tolist()) @ scale, exact, rtol=1e-13)
    for wrong in ([[1.0, 2.0], [2.0, 1.0]], [[0.0, 0.0], [0.0, 1.0]], [[1.0, 1.0], [1.0, 1.0]], [[np.nan, 0], [0, 1]]):
        assert small_inverse(wrong) is None


def test_factors_are_collected():
    class Canary(SensorModel):
        pass

    canary = Canary()
    gone = weakref.ref(canary)
    factor = VirtualMotionFactor(x1, x2, [1.0, 0.1, 0.2], [1.5, 0.2, 0.1], canary)
    graph = gtsam.NonlinearFactorGraph()
    graph.add(factor)
    graph.error(values_of(np.zeros(3), np.ones(3)))
    del factor, graph, canary
    gc.collect()
    assert gone() is None


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: VirtualMotionFactor(x1, x2, [1, 0], [1, 0, 0]), "must both have psi"),
        (lambda: VirtualMotionFactor(x1, x2, [1, np.nan, 0], [1, 0, 0]), "z_1 must be 2 or 3 finite numbers"),
        (lambda: VirtualMotionFactor(x1, x2, [1, 0], [1, 0]), r"without psi .* in frame='body', too: pass at=poses"),
        (
            lambda: VirtualMotionFactor(x1, x2, [1, 0, 0], [1, 0, 0], frame="world"),
            "pass at=poses, or take frame='body'",
        ),
        (lambda: VirtualMotionFactor(x1, x2, [1, 0, 0], [1, 0, 0], frame="robot"), "frame must be one of"),
        (lambda: VirtualMotionFactor(x1, x2, [0, 0, 0], [1, 0, 0]), "range of z_1 must be above zero"),
        (lambda: VirtualMotionFactor(x1, x2, [1, 0, 0], [1, 0, 0], scale=0), "scale must be a positive"),
        (lambda: MotionFactor(x1, x2, [1, 0, 0], 1.0), "control must be 2 finite numbers"),
        (lambda: MotionFactor(x1, x2, [1, 0], 0.0), "dt must be a positive number"),
        (lambda: MotionFactor(x1, x2, [1, 0], 1.0, frame="world"), "pass at=pose, or take frame='body'"),
        (lambda: AnchorFactor(x1, [0, 0]), "pose must be 3 finite numbers"),
        (lambda: AnchorFactor(x1, [0, 0, 0], np.diag([1.0, 1.0, -1.0])), "positive definite"),
        (lambda: RelativePoseFactor(x1, x2, [0, 0, 0], np.ones((3, 3))), "positive definite"),
    ],
)
def test_impossible_factors(make, message):
    with pytest.raises(OptionError, match=message):
        make()
