"""The oracle itself, against what the book's own program computed."""

import json

import numpy as np
import pytest

from graphslam import GraphError, OptionError, load, textbook

CASES = [
    {"edges": "virtual", "threshold": 0.01},
    {"edges": "virtual+motion", "threshold": 0.02},
    {"edges": "virtual+motion", "threshold": 0.02, "dimensions": 2, "motion_copies": 100},
]


@pytest.fixture(scope="module")
def golden(shared_data):
    return json.loads(shared_data("lnpr/golden.json").read_text())["cases"]


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
