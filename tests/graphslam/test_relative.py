from dataclasses import replace

import numpy as np
import pytest

from graphslam import Graph, GraphError, SensorModel, load, sample_log_path, simulate, solve, solve_with_gtsam
from graphslam.edges import CartesianObservationEdges
from graphslam.graph.transform import relative_graph
from graphslam.se2 import wrap

AHEAD = SensorModel(offset=(0.3, -0.1))


def omega(graph, state):
    """Omega of all edges as a dense matrix."""
    n = 3 * graph.num_nodes
    total = np.zeros((n, n))
    for family in graph.families:
        edges = family.linearize(state, state)
        for k in range(len(edges.residuals)):
            B = np.zeros((edges.residuals.shape[1], n))
            for nodes, by in zip(edges.nodes, edges.jacobians):
                B[:, 3 * nodes[k] : 3 * nodes[k] + by.shape[2]] += by[k]
            total += B.T @ edges.information[k] @ B
    return total


def noise_free(log, sensor):
    """The log as a perfect sensor would have made it, its initial poses the true ones."""
    seen = np.array([log.true_landmarks[j] for j in log.landmarks.tolist()])
    sightings = sensor.h(log.true_poses[log.steps], seen)
    return replace(log, sightings=sightings, initial_poses=log.true_poses)


@pytest.mark.parametrize("sensor", [SensorModel(), AHEAD], ids=["centred", "offset"])
@pytest.mark.parametrize(
    ("edges", "dimensions", "options"),
    [
        ("virtual+motion", 3, {}),
        ("virtual+motion", 3, {"weight": "tempered", "motion_weight": 5.0}),
        ("virtual", 3, {"frame": "world"}),
        ("landmark+motion", 3, {}),
        ("landmark+motion", 2, {}),
    ],
)
def test_relative_edges_say_the_same_where_sightings_have_no_noise(edges, dimensions, options, sensor):
    log = noise_free(simulate(clean=True, sensor=sensor, seed=3), sensor)
    log = log if dimensions == 3 else log.without_orientation()
    graph = Graph.from_log(log, edges=edges, sensor=sensor, **options)
    relative = relative_graph(graph)
    expected, ours = omega(graph, graph.initial), omega(relative, relative.initial)
    assert np.abs(ours - expected).max() < 1e-9 * np.abs(expected).max()
    assert relative.cost(relative.initial) == pytest.approx(graph.cost(graph.initial), rel=1e-9)


@pytest.mark.parametrize("dimensions", [3, 2])
def test_cartesian_sightings_are_relative_poses_or_points(dimensions):
    log = simulate(steps=20, seed=1)
    graph = Graph.from_log(log, edges="landmark+motion", dimensions=dimensions, sensor=AHEAD, kernel="none")
    relative = relative_graph(graph)
    ours, theirs = solve(graph), solve(relative)
    assert theirs.cost == pytest.approx(ours.cost, rel=1e-12)
    np.testing.assert_allclose(theirs.poses[: log.num_poses], ours.poses, atol=1e-9)


def test_written_graph_read_again_has_the_optimum(tmp_path):
    graph = Graph.from_log(load(sample_log_path()), edges="virtual+motion", kernel="none")
    solution = solve(graph, initialize="auto")
    relative = relative_graph(graph, state=solution.state)
    relative.save_g2o(tmp_path / "sample.g2o")
    again = solve(Graph.from_g2o(tmp_path / "sample.g2o"))
    here = solve(relative)
    assert again.cost == pytest.approx(here.cost, rel=1e-12)
    np.testing.assert_allclose(again.poses, here.poses, atol=1e-9)
    # first order: with the sample's noise the optimum moves by millimetres, not by nothing
    moved = np.abs(here.poses - solution.poses)
    moved[:, 2] = np.abs(wrap(moved[:, 2]))
    assert 0 < moved.max() < 0.02


def test_landmarks_get_ids_of_their_own(tmp_path):
    log = simulate(steps=10, seed=1)
    graph = Graph.from_log(log, edges="landmark+motion", kernel="none")
    relative_graph(graph).save_g2o(tmp_path / "poses.g2o")
    lines = (tmp_path / "poses.g2o").read_text().splitlines()
    ids = [line.split()[1] for line in lines if line.startswith("VERTEX")]
    assert len(ids) == len(set(ids)) == graph.num_nodes
    relative_graph(Graph.from_log(log.without_orientation(), edges="landmark+motion", kernel="none")).save_g2o(
        tmp_path / "points.g2o"
    )
    points = [line for line in (tmp_path / "points.g2o").read_text().splitlines() if line.startswith("VERTEX_XY")]
    assert len(points) == len(graph.landmark_ids)


def test_edges_that_measure_no_relative_pose_are_refused():
    log = simulate(steps=10, seed=1)
    with pytest.raises(GraphError, match="without psi"):
        relative_graph(Graph.from_log(log.without_orientation(), edges="virtual+motion", kernel="none"))
    with pytest.raises(GraphError, match="pairs"):
        relative_graph(Graph.from_log(log, weight="marginal", edges="virtual+motion", kernel="none"))


@pytest.mark.parametrize(
    "options", [{}, {"weight": "tempered"}, {"edges": "landmark+motion"}], ids=["pairs", "tempered", "landmark nodes"]
)
@pytest.mark.parametrize("kernel", ["huber", "cauchy", "geman-mcclure"])
def test_a_kernel_is_exported_as_its_weights(options, kernel, tmp_path):
    """Wrong sightings count in the file as little as in the solution, which solving the file gives again."""
    faultless = SensorModel(range_rate=0.01, bearing_std=0.005, orientation_std=0.005)
    log = simulate(clean=True, sensor=faultless, seed=2, steps=40)
    sightings = log.sightings.copy()
    sightings[::10, 0] *= 2
    log = replace(log, sightings=sightings)
    graph = Graph.from_log(log, sensor=faultless, kernel=kernel, **options)
    solution = solve(graph)
    relative = relative_graph(graph, state=solution.state)
    # the kernel acts once: as the weights
    assert not relative.reweighted
    relative.save_g2o(tmp_path / "robust.g2o")
    again = solve(Graph.from_g2o(tmp_path / "robust.g2o"))
    plain = solve(Graph.from_log(log, sensor=faultless, **options))
    moved, harm = (np.abs(other[:, :2] - solution.poses[:, :2]).max() for other in (again.poses[:41], plain.poses))
    assert moved < 0.1 * harm


@pytest.mark.parametrize("estimate", [None, ["range_scale"]])
def test_parameters_of_the_robot_keep_their_values(estimate):
    log = simulate(seed=3, steps=30, clean=True).replace(uncertain={"range_scale": 0.05})
    found = solve(Graph.from_log(log, edges="landmark+motion", dimensions=2, estimate=estimate))
    again = solve(relative_graph(found.graph, state=found.state), initialize="given")
    assert again.cost == pytest.approx(found.cost)
    np.testing.assert_allclose(again.state, found.state, atol=1e-6)
    # what is unknown of the scale is no part of the edges
    assert np.all(np.diag(found.covariance(20)) > np.diag(again.covariance(20)))


@pytest.mark.parametrize("trusted", [False, True])
def test_points_that_may_be_wrong_are_the_same_for_all_solvers(trusted):
    """GTSAM had them without kernel and trust, and graduated non-convexity ended with a StopIteration."""
    log = simulate(seed=1, steps=30, clean=True, orientation=False)
    graph = Graph.from_log(log, edges="landmark+motion", kernel="cauchy")

    def points(seen):
        return replace(seen.relative, trust=np.linspace(0.2, 1.0, seen.count) if trusted else None)

    other = graph.with_changed(CartesianObservationEdges, points)
    own, theirs = solve(other), solve_with_gtsam(other)
    assert theirs.cost == pytest.approx(own.cost, rel=1e-9)
    assert np.abs(own.poses - theirs.poses).max() < 1e-5
    assert len(solve(other, method="gnc").other_trust["points"]) == len(log.steps)
