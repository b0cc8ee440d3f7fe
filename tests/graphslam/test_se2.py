import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graphslam import se2

finite = st.floats(-1e3, 1e3)
poses = st.tuples(finite, finite, st.floats(-30, 30)).map(np.array)


@given(st.floats(-1e9, 1e9))
def test_wrap_is_the_same_angle_in_the_half_open_interval(angle):
    wrapped = float(se2.wrap(angle))
    assert -np.pi <= wrapped < np.pi
    assert np.cos(wrapped) == pytest.approx(np.cos(angle), abs=1e-6)
    assert np.sin(wrapped) == pytest.approx(np.sin(angle), abs=1e-6)


@given(st.floats(-np.pi, np.pi, exclude_max=True))
def test_wrap_leaves_wrapped_angles_bit_for_bit(angle):
    assert se2.wrap(angle) == angle


@pytest.mark.parametrize("angle", [np.pi, -np.pi, np.nextafter(-np.pi, -4), -np.pi - 1e-17, 3 * np.pi, -3 * np.pi])
def test_wrap_at_the_seam(angle):
    assert -np.pi <= se2.wrap(angle) < np.pi


@given(poses, poses)
def test_compose_and_between_agree_with_gtsam(a, b):
    # an independent implementation of the same group
    ours, theirs = se2.compose(a, b), gtsam.Pose2(*a).compose(gtsam.Pose2(*b))
    np.testing.assert_allclose(ours[:2], [theirs.x(), theirs.y()], atol=1e-9)
    assert abs(se2.wrap(ours[2] - theirs.theta())) < 1e-9
    ours, theirs = se2.between(a, b), gtsam.Pose2(*a).between(gtsam.Pose2(*b))
    np.testing.assert_allclose(ours[:2], [theirs.x(), theirs.y()], atol=1e-9)
    assert abs(se2.wrap(ours[2] - theirs.theta())) < 1e-9


@given(poses, poses)
def test_group_laws(a, b):
    np.testing.assert_allclose(se2.compose(a, se2.inverse(a)), 0, atol=1e-9)
    back = se2.compose(a, se2.between(a, b))
    np.testing.assert_allclose(back[:2], b[:2], atol=1e-9)
    assert abs(se2.wrap(back[2] - b[2])) < 1e-9


def test_shapes_are_broadcast():
    many = np.random.default_rng(0).normal(size=(4, 5, 3))
    assert se2.compose(many, many).shape == (4, 5, 3)
    assert se2.transform(many, many[..., :2]).shape == (4, 5, 2)
    np.testing.assert_array_equal(se2.between(many, many), 0)


def test_interpolation_is_the_arc_of_one_twist():
    # half of a quarter turn on the unit circle, from (1, 0) heading up to (0, 1) heading left
    middle = se2.interpolate([1.0, 0.0, np.pi / 2], [0.0, 1.0, np.pi], 0.5)
    np.testing.assert_allclose(middle, [np.sqrt(0.5), np.sqrt(0.5), 3 * np.pi / 4], atol=1e-15)
    # over the seam, and straight where nothing turns
    np.testing.assert_allclose(se2.interpolate([0, 0, 3.0], [0, 0, -3.0], 0.5)[2], np.pi)
    np.testing.assert_allclose(se2.interpolate([0, 0, 1.0], [2, 4, 1.0], 0.25), [0.5, 1.0, 1.0])


def test_interpolation_composes():
    rng = np.random.default_rng(5)
    a, b = rng.normal(size=(100, 3)), rng.normal(size=(100, 3))
    s = rng.uniform(size=100)
    # from there the rest of the way is the same arc
    some, later = se2.interpolate(a, b, s), se2.interpolate(a, b, (s + 1) / 2)
    np.testing.assert_allclose(se2.wrap(se2.interpolate(some, b, np.full(100, 0.5)) - later), 0, atol=1e-12)
    np.testing.assert_allclose(se2.wrap(se2.interpolate(a, b, np.ones(100)) - b), 0, atol=1e-12)


@given(poses, st.tuples(finite, finite).map(np.array))
def test_lever_matrix_is_the_derivative_of_what_a_pose_sees(pose, point):
    def seen(x):
        return np.append(se2.transform(x, point), x[2])

    lever = se2.perpendicular(se2.transform(pose, point) - pose[:2])
    columns = [(seen(pose + h) - seen(pose - h)) / 2e-6 for h in 1e-6 * np.eye(3)]
    np.testing.assert_allclose(se2.lever_matrix(lever), np.stack(columns, axis=1), atol=1e-3)


@given(poses, st.integers(0, 2**32 - 1))
def test_turned_by_keeps_squares_of_turned_vectors(pose, seed):
    rng = np.random.default_rng(seed)
    information, vector = rng.standard_normal((3, 3)), rng.standard_normal(3)
    turned = np.append(se2.transform([0.0, 0.0, pose[2]], vector[:2]), vector[2])
    there = se2.turned_by(information, pose[2])
    assert turned @ there @ turned == pytest.approx(vector @ information @ vector, rel=1e-9, abs=1e-9)
