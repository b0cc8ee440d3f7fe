"""The backbone: the hand-written solver against GTSAM, the same graph, every variant."""

import numpy as np
import pytest

from graphslam import WORLDS, Graph, GraphError, MotionModel, load, sample_log_path, simulate, solve, solve_with_gtsam
from graphslam.se2 import wrap
from graphslam.solvers.gtsam_solver import to_gtsam, to_values

#: a fifth of the book's motion noise, so that both solvers end in the same minimum of the landmark graphs
GENTLE = MotionModel(nn=0.04, no=0.0002, on=0.026, oo=0.04)
LOGS = {
    "book": None,
    "sample": lambda: load(sample_log_path()),
    "clean": lambda: simulate(seed=4, clean=True),
    "faulty": lambda: simulate(WORLDS["garden"], steps=80, seed=11),
}


LANDMARK_LOGS = [("book", 3), ("book", 2), ("gentle", 3), ("gentle", 2)]


@pytest.mark.parametrize(("name", "dimensions"), LANDMARK_LOGS)
def test_landmark_nodes_agree(book_log, name, dimensions):
    log = book_log if name == "book" else simulate(WORLDS["garden"], seed=5, clean=True, motion=GENTLE)
    graph = Graph.from_log(log, edges="landmark+motion", dimensions=dimensions)
    ours, theirs = solve(graph), solve_with_gtsam(graph)
    assert ours.converged
    assert theirs.converged
    difference = ours.state - theirs.state
    difference[:, 2] = wrap(difference[:, 2])
    assert np.abs(difference).max() < 1e-6
    assert theirs.cost == pytest.approx(ours.cost, rel=1e-9)
    assert 2 * to_gtsam(graph, graph.initial).error(to_values(graph, graph.initial)) == pytest.approx(
        graph.cost(graph.initial), rel=1e-10
    )


def test_pose_graphs_with_points_and_fixed_nodes_agree(shared_data):
    graph = Graph.from_g2o(shared_data("posegraph/simulation-pose-landmark.g2o"))
    ours, theirs = solve(graph), solve_with_gtsam(graph)
    difference = ours.state - theirs.state
    difference[:, 2] = wrap(difference[:, 2])
    assert np.abs(difference).max() < 1e-6
    assert theirs.cost == pytest.approx(ours.cost, rel=1e-9)


def variants():
    for name in LOGS:
        for dimensions in (3, 2):
            for edges in ("virtual", "virtual+motion"):
                for frame in ("world", "body"):
                    if dimensions == 2 and frame == "world" and name in ("sample", "clean"):
                        continue  # the slowest by far, and nothing new: slam-compare solvers runs it
                    yield name, dimensions, edges, frame


@pytest.mark.parametrize(("name", "dimensions", "edges", "frame"), list(variants()))
def test_poses_and_cost_agree(book_log, name, dimensions, edges, frame):
    log = book_log if name == "book" else LOGS[name]()
    weight = "tempered" if name == "faulty" else "pairs"
    motion_weight = 3.0 if name == "faulty" else 1.0
    options = {
        "edges": edges,
        "frame": frame,
        "dimensions": dimensions,
        "motion_weight": motion_weight,
        "weight": weight,
    }
    try:
        graph = Graph.from_log(log, **options)
    except GraphError as error:
        # 2-D virtual edges alone: refused by both, because the graph itself is
        assert (dimensions, edges) == (2, "virtual") and "one landmark does not fix a pose" in str(error)
        return
    ours, theirs = solve(graph), solve_with_gtsam(graph)
    assert ours.converged
    assert theirs.converged
    difference = ours.poses - theirs.poses
    difference[:, 2] = wrap(difference[:, 2])
    assert np.abs(difference).max() < 1e-6
    assert theirs.cost == pytest.approx(ours.cost, rel=1e-9)
    for j, landmark in ours.landmarks.items():
        np.testing.assert_allclose(wrap(landmark - theirs.landmarks[j]), 0, atol=1e-6)


@pytest.mark.parametrize("frame", ["world", "body"])
@pytest.mark.parametrize("dimensions", [3, 2])
def test_cost_is_twice_gtsams_error(book_log, frame, dimensions):
    graph = Graph.from_log(book_log, frame=frame, dimensions=dimensions)
    rng = np.random.default_rng(0)
    for scale in (0.0, 0.1, 2.0):
        state = graph.initial + scale * rng.normal(size=graph.initial.shape)
        reference = graph.initial + 0.1 * rng.normal(size=graph.initial.shape)
        error = to_gtsam(graph, reference).error(to_values(graph, state))
        assert graph.cost(state, reference) == pytest.approx(2 * error, rel=1e-10)
    solution = solve(graph)
    error = to_gtsam(graph, solution.poses).error(to_values(graph, solution.state))
    assert solution.cost == pytest.approx(2 * error, rel=1e-10)


def test_gtsam_too_runs_out_of_iterations(book_log):
    for frame in ("world", "body"):
        solution = solve_with_gtsam(Graph.from_log(book_log, frame=frame), max_iterations=2)
        assert not solution.converged
        assert "max_iterations = 2" in solution.reason
