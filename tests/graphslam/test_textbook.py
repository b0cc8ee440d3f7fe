"""The oracle itself, against what the book's own program computed."""

import json

import numpy as np
import pytest

from graphslam import GraphError, OptionError, SensorModel, load, sample_log_path, textbook

CASES = [
    {"edges": "virtual", "threshold": 0.01},
    {"edges": "virtual+motion", "threshold": 0.02},
    {"edges": "virtual+motion", "threshold": 0.02, "dimensions": 2, "motion_copies": 100},
]


@pytest.fixture(scope="module")
def golden(shared_data):
    return json.loads(shared_data("lnpr/golden.json").read_text())["cases"]


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(CASES)))
def test_the_books_program(golden, shared_data, number):
    case = golden[number]
    result = textbook.solve(load(shared_data(f"lnpr/{case['log']}")), **CASES[number])
    assert result.converged
    assert result.iterations == case["iterations"]
    np.testing.assert_allclose(result.step_norms, case["step_norms"], rtol=1e-9)
    np.testing.assert_allclose(result.poses, case["poses"], rtol=1e-9, atol=1e-12)
    assert result.num_edges == case.get("edges", result.num_edges)
    for j, landmark in case.get("landmarks", {}).items():
        np.testing.assert_allclose(result.landmarks[int(j)], landmark, rtol=0, atol=1e-9)


def test_without_motion_edges_poses_that_saw_nothing_keep_their_numbers(book_log):
    result = textbook.solve(book_log, edges="virtual", threshold=0.1)
    unseen = np.setdiff1d(np.arange(book_log.num_poses), book_log.steps)
    assert len(unseen) > 0
    np.testing.assert_array_equal(np.flatnonzero(~result.estimated), unseen)
    np.testing.assert_array_equal(result.poses[unseen], book_log.initial_poses[unseen])


@pytest.mark.nightly
def test_run_to_convergence_the_textbook_drifts(book_log):
    # the anchor is missing from xi, so that every step moves the whole graph on
    norms = textbook.solve(book_log, edges="virtual", threshold=1e-12, max_iterations=40).step_norms
    assert norms[-1] > 1e-6
    assert norms[-1] == pytest.approx(norms[-6], rel=1e-2)


def test_impossible_requests(book_log, shared_data):
    with pytest.raises(GraphError, match="no controls"):
        textbook.solve(load(shared_data("lnpr/log_for_book.txt")), edges="virtual+motion")
    with pytest.raises(OptionError, match="edges must be one of"):
        textbook.solve(book_log, edges="landmark")
    with pytest.raises(OptionError, match="dimensions"):
        textbook.solve(book_log.without_orientation(), dimensions=3)
    with pytest.raises(OptionError, match="threshold must not be negative, but is -1"):
        textbook.solve(book_log, threshold=-1)
    for wrong in ({"motion_copies": 1.5}, {"max_iterations": -1}, {"max_iterations": "9"}, {"dimensions": 2.0}):
        (name,) = wrong
        with pytest.raises(OptionError, match=f"{name} must "):
            textbook.solve(book_log, **wrong)
    # which never ends before max_iterations
    assert len(textbook.solve(book_log, threshold=0.0, max_iterations=1).step_norms) == 1
    with pytest.raises(OptionError, match="log must be a Log, not 'drive.npz'; graphslam.load"):
        textbook.solve("drive.npz")


def test_poses_that_one_landmark_leaves_open_are_refused():
    # rounding made the pivots 1e-16 in place of 0, and the steps 1e15 m
    with pytest.raises(GraphError, match="the edges do not determine every pose"):
        textbook.solve(load(sample_log_path()).without_orientation(), edges="virtual")


@pytest.mark.slow
def test_by_default_the_threshold_is_that_of_the_books_program():
    # the program with motion edges stops at 0.02; at 0.01 it would drift for 100 iterations
    result = textbook.solve(load(sample_log_path()), edges="virtual+motion")
    assert result.converged
    assert result.iterations < 12
    assert result.threshold == 0.02
    assert "0.02" in result.reason


@pytest.mark.nightly
def test_a_drift_above_the_threshold_ends_the_program_and_is_named(book_log):
    # with precise sensors the drift, 0.036, is greater than the book's threshold
    sensor = SensorModel(range_rate=0.03, bearing_std=0.01, orientation_std=0.01)
    result = textbook.solve(book_log, edges="virtual", sensor=sensor)
    assert not result.converged
    assert result.iterations < 40
    assert "drifts" in result.reason
    # with a threshold that is given it goes on
    most = result.iterations + 1
    given = textbook.solve(book_log, edges="virtual", sensor=sensor, threshold=result.threshold, max_iterations=most)
    assert given.iterations == most
    assert f"max_iterations = {most}" in given.reason
    assert "not converged" in repr(result)
