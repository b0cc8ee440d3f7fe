from __future__ import annotations

import numpy as np
import pytest
from evo.core import metrics as evo_metrics
from evo.core.trajectory import PosePath3D
from hypothesis import given
from hypothesis import strategies as st

from graphslam import OptionError
from graphslam.metrics import (  # fmt: skip
    Metrics,
    align,
    alignment_of,
    ate,
    evaluate,
    exchanged,
    heading_rmse,
    landmark_rmse,
    named_by_place,
    position_errors,
    rpe,
)
from graphslam.se2 import Array, compose, transform, wrap

ANGLE = st.floats(-3.14, 3.14)
PLACE = st.floats(-50, 50)
POSE = st.tuples(PLACE, PLACE, ANGLE).map(np.array)


def walk(seed: int, steps: int = 40) -> tuple[Array, Array]:
    """A true trajectory and an estimate of it, in another frame."""
    rng = np.random.default_rng(seed)
    truth = np.cumsum(rng.normal(0.3, 1.0, (steps, 3)), axis=0)
    truth[:, 2] = wrap(truth[:, 2])
    estimate = truth + rng.normal(0, 0.2, truth.shape)
    estimate = compose(rng.uniform(-3, 3, 3), estimate)
    return truth, estimate


def lifted(poses: Array) -> PosePath3D:
    """The planar poses as evo's poses in space."""
    se3 = np.tile(np.eye(4), (len(poses), 1, 1))
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    se3[:, 0, 0], se3[:, 0, 1], se3[:, 1, 0], se3[:, 1, 1] = c, -s, s, c
    se3[:, :2, 3] = poses[:, :2]
    return PosePath3D(poses_se3=list(se3))


@pytest.mark.parametrize("seed", range(8))
def test_ate_is_evos_ape_after_alignment(seed: int) -> None:
    truth, estimate = walk(seed)
    reference, other = lifted(truth), lifted(estimate)
    other.align(reference, correct_scale=False)
    ape = evo_metrics.APE(evo_metrics.PoseRelation.translation_part)
    ape.process_data((reference, other))
    assert ate(truth, estimate) == pytest.approx(ape.get_statistic(evo_metrics.StatisticsType.rmse), rel=1e-10)
    np.testing.assert_allclose(position_errors(truth, estimate), ape.error, atol=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_rpe_is_evos_rpe_between_neighbours(seed: int) -> None:
    truth, estimate = walk(seed)
    figures = []
    for relation in (evo_metrics.PoseRelation.translation_part, evo_metrics.PoseRelation.rotation_angle_rad):
        metric = evo_metrics.RPE(relation, delta=1, delta_unit=evo_metrics.Unit.frames)
        metric.process_data((lifted(truth), lifted(estimate)))
        figures.append(metric.get_statistic(evo_metrics.StatisticsType.rmse))
    assert rpe(truth, estimate) == pytest.approx(tuple(figures), rel=1e-9)


def test_ate_by_hand() -> None:
    # a square of side 2 seen as one of side 3: every corner is off by half a diagonal, (0.5, 0.5)
    corners = np.array([[1.0, 1], [-1, 1], [-1, -1], [1, -1]])
    truth = np.column_stack([corners, np.zeros(4)])
    estimate = np.column_stack([1.5 * corners, np.zeros(4)])
    np.testing.assert_allclose(align(truth, estimate), 0, atol=1e-15)
    assert ate(truth, estimate) == pytest.approx(np.sqrt(0.5))


def test_rpe_by_hand() -> None:
    truth = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    estimate = np.array([[5.0, 5, np.pi / 2], [5, 6.1, np.pi / 2], [5, 7.1, np.pi / 2 + 0.2]])
    # the first step is 0.1 m too long, the second turns 0.2 rad too far
    assert rpe(truth, estimate) == pytest.approx((np.sqrt(0.1**2 / 2), np.sqrt(0.2**2 / 2)))


@given(POSE, st.integers(0, 1000))
def test_no_rigid_motion_of_the_estimate_changes_any_figure(motion: Array, seed: int) -> None:
    truth, estimate = walk(seed, steps=6)
    moved = compose(motion, estimate)
    assert ate(truth, moved) == pytest.approx(ate(truth, estimate), abs=1e-9)
    assert rpe(truth, moved) == pytest.approx(rpe(truth, estimate), abs=1e-9)
    assert ate(truth, compose(motion, truth)) == pytest.approx(0, abs=1e-9)


@given(st.integers(0, 1000), POSE)
def test_no_other_motion_lays_the_estimate_closer(seed: int, other: Array) -> None:
    truth, estimate = walk(seed, steps=6)
    moved = transform(0.01 * other, transform(align(truth, estimate), estimate[:, :2]))
    assert np.sqrt(np.mean(np.sum((moved - truth[:, :2]) ** 2, axis=1))) >= ate(truth, estimate) - 1e-12


def test_the_plane_is_never_turned_over() -> None:
    truth, _ = walk(3)
    mirrored = truth * [1, -1, -1]
    # in space the mirror image fits exactly after half a turn about the x axis; a robot in the plane cannot do that
    assert ate(truth, mirrored) > 1.0


def test_steps_that_are_not_estimated_count_nowhere() -> None:
    truth, estimate = walk(5, steps=9)
    mask = np.array([True, True, False, True, True, True, False, True, False])
    spoiled = np.where(mask[:, None], estimate, 1e6)
    assert ate(truth, spoiled, mask=mask) == pytest.approx(ate(truth[mask], estimate[mask]))
    assert np.isnan(position_errors(truth, spoiled, mask=mask)[~mask]).all()
    # of the neighbours only 0-1, 3-4 and 4-5 are both estimated
    parts = [rpe(truth[a : a + 2], estimate[a : a + 2]) for a in (0, 3, 4)]
    by_hand = np.sqrt(np.mean(np.square([part for part in parts if part is not None]), axis=0))
    assert rpe(truth, spoiled, mask=mask) == pytest.approx(tuple(by_hand))


def test_headings_count_after_the_alignment_of_positions() -> None:
    truth = np.array([[0.0, 0, 0], [1, 0, 0.5], [1, 2, 3.1], [4, 2, -1.0]])
    turned = compose(np.array([3.0, -1.0, 2.5]), truth)
    assert heading_rmse(truth, turned) == pytest.approx(0, abs=1e-12)
    # across the cut at pi, and only where a heading is known
    turned[2, 2] += 0.2
    assert heading_rmse(truth, turned) == pytest.approx(0.1)
    truth[[0, 1, 3], 2] = np.nan
    assert heading_rmse(truth, turned) == pytest.approx(0.2)
    truth[2, 2] = np.nan
    assert heading_rmse(truth, turned) is None


def test_rpe_needs_neighbours() -> None:
    truth, estimate = walk(1, steps=4)
    assert rpe(truth, estimate, mask=np.array([True, False, True, False])) is None
    assert rpe(truth[:1], estimate[:1]) is None


def test_one_place_has_no_best_heading() -> None:
    truth, estimate = np.array([[1.0, 2, 0.3]] * 3), np.array([[4.0, 6, 0.5]] * 3)
    np.testing.assert_allclose(align(truth, estimate), [-3, -4, 0])
    # the means of these are rounded
    truth, estimate = np.array([[0.1, 0.2, 0.3]] * 3), np.array([[0.7, 0.2, 0.3]] * 3)
    np.testing.assert_allclose(align(truth, estimate), [-0.6, 0, 0], atol=1e-15)


def test_the_map_is_judged_in_the_frame_of_the_trajectory() -> None:
    truth, estimate = walk(2)
    alignment = align(truth, estimate)
    landmarks = {3: np.array([1.0, 2]), 7: np.array([4.0, -5, 0.3]), 9: np.array([0.0, 0])}
    back = {j: transform(_inverse(alignment), m[:2]) for j, m in landmarks.items()}
    assert landmark_rmse(landmarks, back, alignment) == pytest.approx(0, abs=1e-12)
    # one landmark of two is off by 3-4-5; the third is on one map only and does not count
    shifted = {3: back[3], 7: transform(_inverse(alignment), landmarks[7][:2] + [3, 4]), 8: back[9]}
    assert landmark_rmse(landmarks, shifted, alignment) == pytest.approx(np.sqrt(25 / 2))
    assert landmark_rmse(landmarks, {1: np.zeros(2)}, alignment) is None


def _inverse(pose: Array) -> Array:
    from graphslam.se2 import inverse

    return inverse(pose)


def test_a_map_without_names_is_matched_by_place() -> None:
    """Ids shuffled, the whole turned with the trajectory, one phantom and one landmark missing: the same error."""
    rng = np.random.default_rng(2)
    truth = dict(enumerate(rng.uniform(-5, 5, (6, 2))))
    poses = np.column_stack([rng.uniform(-5, 5, (9, 2)), rng.uniform(-3, 3, 9)])
    estimate = {j: place + [0.03, -0.04] for j, place in truth.items() if j != 4}
    motion = np.array([3.0, -2.0, 1.0])
    anonymous = {17 - 3 * j: transform(motion, place) for j, place in estimate.items()} | {40: np.array([90.0, 90.0])}
    moved = compose(motion, poses)
    found = named_by_place(truth, anonymous, align(poses, moved))
    # the phantom is the nearest there is to the landmark that nobody found
    assert found.keys() == truth.keys()
    np.testing.assert_array_equal(found.pop(4), [90.0, 90.0])
    for j, place in found.items():
        np.testing.assert_array_equal(place, anonymous[17 - 3 * j])
    del anonymous[40]
    assert evaluate(poses, truth, moved, anonymous, named=False).landmark_rmse_m == pytest.approx(0.05)
    assert named_by_place(truth, {}, np.zeros(3)) == {}


def test_evaluate_says_none_where_the_truth_is_silent() -> None:
    truth, estimate = walk(4)
    landmarks = {0: np.zeros(2)}
    assert evaluate(None, landmarks, estimate, landmarks) == Metrics()
    assert evaluate(truth, None, estimate, landmarks).landmark_rmse_m is None
    assert evaluate(truth, None, estimate, landmarks).ate_m == ate(truth, estimate)
    assert evaluate(truth, landmarks, estimate, {}).landmark_rmse_m is None
    # a single pose always fits
    alone = np.arange(len(truth)) == 3
    assert evaluate(truth, landmarks, estimate, landmarks, mask=alone) == Metrics()


@pytest.mark.parametrize(
    ("truth", "estimate", "mask"),
    [
        (np.zeros((3, 3)), np.zeros((4, 3)), None),
        (np.zeros((3, 3)), np.zeros((3, 2)), None),
        (np.zeros(3), np.zeros(3), None),
        (np.zeros((3, 3)), np.zeros((3, 3)), [True]),
        (np.zeros((3, 3)), np.zeros((3, 3)), [False] * 3),
    ],
)
def test_shapes_are_checked(truth: Array, estimate: Array, mask: list[bool] | None) -> None:
    with pytest.raises(OptionError):
        ate(truth, estimate, mask=mask)


def test_rpe_wants_headings() -> None:
    with pytest.raises(OptionError, match=r"\(T\+1, 3\)"):
        rpe(np.zeros((3, 2)), np.zeros((3, 2)))


def test_without_true_poses_the_map_is_aligned_by_the_landmarks():
    truth = {1: np.array([0.0, 0.0]), 2: np.array([4.0, 0.0]), 3: np.array([8.0, 0.0]), 9: np.array([8.0, 8.0])}
    turned = {j: transform([5.0, -2.0, 0.7], place) for j, place in truth.items() if j != 9}
    poses = np.zeros((2, 3))
    metrics = evaluate(None, truth, poses, turned)
    assert metrics.aligned_by == "landmarks" and metrics.ate_m is None
    assert metrics.landmark_rmse_m == pytest.approx(0, abs=1e-12)
    assert set(metrics.landmark_errors_m) == {1, 2, 3}
    # landmark 2 is 0.3 m too far along the line of all three: the mean takes a third of it, nothing turns
    shifted = turned | {2: transform([5.0, -2.0, 0.7], [4.3, 0.0])}
    metrics = evaluate(None, truth, poses, shifted)
    assert metrics.landmark_rmse_m == pytest.approx(
        np.sqrt(np.mean(np.square(list(metrics.landmark_errors_m.values()))))
    )
    assert metrics.landmark_errors_m == pytest.approx({1: 0.1, 2: 0.2, 3: 0.1})
    # a single landmark could be aligned without error, and arbitrary numbers name no true landmark
    assert evaluate(None, truth, poses, {1: [0, 0]}) == Metrics()
    assert evaluate(None, truth, poses, turned, named=False) == Metrics()


def test_two_swapped_landmarks_show():
    rng = np.random.default_rng(3)
    truth = dict(enumerate(rng.uniform(-10, 10, (12, 2))))
    estimate = {j: place + rng.normal(0, 0.05, 2) for j, place in truth.items()}
    assert exchanged(truth, estimate, np.zeros(3)) == []
    swapped = truth | {3: truth[8], 8: truth[3]}
    metrics = evaluate(None, swapped, np.zeros((2, 3)), estimate)
    assert sorted(metrics.landmark_errors_m, key=metrics.landmark_errors_m.get)[-2:] in ([3, 8], [8, 3])
    alignment, _ = alignment_of(None, swapped, np.zeros((2, 3)), estimate)
    assert exchanged(swapped, estimate, alignment) == [(3, 8)]
