import numpy as np
import pytest

from graphslam import WORLDS, Graph, GraphError, MotionFaults, SensorFaults, load, sample_log_path, simulate, solve
from graphslam.se2 import wrap
from graphslam.solvers.start import dead_reckoning, rotation_first

PERFECT = {
    "motion_faults": MotionFaults(kicks_per_metre=0, velocity_bias_std=0),
    "sensor_faults": SensorFaults(
        range_noise_rate=0,
        bearing_noise=0,
        orientation_noise=0,
        range_bias_rate_std=0,
        bearing_bias_std=0,
        orientation_bias_std=0,
        oversight=0,
    ),
}


@pytest.mark.parametrize(
    ("edges", "dimensions"),
    [("virtual", 3), ("virtual+motion", 3), ("virtual+motion", 2), ("landmark+motion", 3), ("landmark+motion", 2)],
)
def test_noise_free_logs_are_solved_by_the_start_alone(edges, dimensions):
    log = simulate(WORLDS["garden"], **PERFECT, seed=0)
    graph = Graph.from_log(log, edges=edges, dimensions=dimensions)
    lost = graph.initial + np.random.default_rng(0).normal(size=graph.initial.shape) * 3
    lost[0] = graph.initial[0]
    state = rotation_first(graph.with_initial(lost))
    truth = log.true_poses[graph.steps]
    np.testing.assert_allclose(state[: len(truth), :2], truth[:, :2], atol=1e-7)
    np.testing.assert_allclose(wrap(state[: len(truth), 2] - truth[:, 2]), 0, atol=1e-7)
    assert graph.cost(state) < 1e-8


def test_dead_reckoning_follows_the_motion_edges():
    log = load(sample_log_path())
    graph = Graph.from_log(log)
    lost = np.zeros_like(graph.initial)
    lost[0] = graph.initial[0]
    state = dead_reckoning(graph.with_initial(lost))
    np.testing.assert_allclose(state[:, :2], log.initial_poses[:, :2], atol=1e-9)
    with pytest.raises(GraphError, match="needs motion edges"):
        dead_reckoning(Graph.from_log(log, edges="virtual"))


@pytest.mark.parametrize("edges", ["virtual", "virtual+motion", "landmark+motion"])
def test_auto_is_never_above_the_given_start(edges):
    graph = Graph.from_log(load(sample_log_path()), edges=edges)
    given, auto = solve(graph, initialize="given"), solve(graph, initialize="auto")
    assert auto.converged
    assert auto.cost <= given.cost * (1 + 1e-9)


def test_auto_does_without_headings_where_it_must(book_log):
    # 2-D virtual edges alone measure no heading: auto then starts from the given values
    log = simulate(WORLDS["garden"], max_range=12.0, field_of_view=6.28, **PERFECT, seed=0, orientation=False)
    solution = solve(Graph.from_log(log, edges="virtual"), initialize="auto")
    assert solution.converged
    assert "started given" in solution.reason
