"""Numbers beyond double precision are refused with one sentence, and no exception of NumPy reaches the user."""

import numpy as np
import pytest

from graphslam import Graph, GraphError, Log, MotionModel, PartialSightings, SensorModel, estimate_map, solve, textbook
from graphslam.linear.cholesky import NotFinite, analyze
from graphslam.linear.precision import inverses


def log_of(scale: float, psi: bool = True) -> Log:
    rng = np.random.default_rng(3)
    z = np.column_stack([scale * rng.uniform(1, 5, 12), rng.uniform(-2, 2, (12, 2))])
    controls = np.column_stack([scale * rng.uniform(0.2, 1, 5), rng.normal(0, 0.3, 5)])
    steps, landmarks = np.repeat(np.arange(6), 2), np.tile([0, 1, 2, 1, 0, 2], 2)
    return Log(dt=1.0, controls=controls, steps=steps, landmarks=landmarks, sightings=z[:, : 3 if psi else 2])


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("scale", [1e-300, 1e-160, 1e-12, 1e-9, 1e9, 1e12, 1e150, 1e300])
@pytest.mark.parametrize("noise", [1e-200, 1e-10, 0.05, 1e10, 1e200])
@pytest.mark.parametrize("edges", ["virtual", "virtual+motion", "landmark+motion"])
def test_extreme_numbers_are_solved_or_refused_in_a_sentence(scale, noise, edges):
    sensor = SensorModel(range_rate=noise, bearing_std=noise, orientation_std=noise)
    for psi in (True, False):
        log = log_of(scale, psi)
        for epsilon in (1e-200, 1e-10, 1e9):
            motion = MotionModel(nn=noise, epsilon=epsilon)
            for run in (solve_with_covariances, textbook_poses):
                try:
                    numbers = run(log, edges, motion, sensor)
                except GraphError as error:
                    assert "\n" not in str(error)
                else:
                    assert np.isfinite(numbers).all()


def solve_with_covariances(log, edges, motion, sensor):
    weight = "marginal" if log.has_orientation and not edges.startswith("landmark") else "pairs"
    solution = solve(
        Graph.from_log(log, edges=edges, motion=motion, sensor=sensor, weight=weight, kernel="none"), max_iterations=20
    )
    covariances = solution.covariance()[solution.estimated]
    return np.concatenate([solution.poses.ravel(), covariances.ravel(), [solution.cost]])


def textbook_poses(log, edges, motion, sensor):
    edges = edges.replace("landmark", "virtual")
    return textbook.solve(log, edges=edges, motion=motion, sensor=sensor, max_iterations=5).poses


def test_the_map_names_what_is_too_extreme(book_log):
    with pytest.raises(GraphError, match=r"noise of sighting 0 is .* along the line of sight"):
        estimate_map(book_log, book_log.initial_poses, sensor=SensorModel(bearing_std=1e-10))
    with pytest.raises(GraphError, match="orientation_std, 1e-10 rad, is too small beside bearing_std"):
        estimate_map(book_log, book_log.initial_poses, sensor=SensorModel(orientation_std=1e-10))
    with pytest.raises(GraphError, match="range_rate of the noise model: 1e\\+30 is too large"):
        estimate_map(book_log, book_log.initial_poses, sensor=SensorModel(range_rate=1e30))


@pytest.mark.parametrize("factor", [1e-180, 1e200])
def test_ranges_alone_have_the_limits_of_others(factor):
    numbers = PartialSightings(
        steps=[0, 1, 1], landmarks=[5] * 3, ranges=[2.0, 2.0 * factor, np.nan], bearings=[np.nan, np.nan, 1.0]
    )
    log = Log(
        dt=[1.0], controls=[[1, 0]], steps=[], landmarks=[], sightings=np.zeros((0, 2)), partial_sightings=numbers
    )
    with pytest.raises(GraphError, match="the ranges alone of log: .* is too (small|large) for double precision"):
        Graph.from_log(log, noise="book")


def test_a_motion_without_noise_names_the_motion_and_epsilon(book_log):
    with pytest.raises(GraphError, match=r"uncertainty of motion \d+ is singular to double precision.*raise epsilon"):
        Graph.from_log(book_log, motion=MotionModel(epsilon=1e-30), edges="virtual+motion", kernel="none")


def test_inverses_keep_metres_and_radians_of_very_different_size():
    scale = np.diag([1e9, 1e9, 1e-8])
    correlation = np.array([[1, 0.5, 0.2], [0.5, 1, -0.3], [0.2, -0.3, 1]])
    inverse = inverses((scale @ correlation @ scale)[None], "motion", "")[0]
    np.testing.assert_allclose(scale @ inverse @ scale, np.linalg.inv(correlation), rtol=1e-12)
    with pytest.raises(GraphError, match="motion 1 is singular"):
        inverses(np.array([np.eye(2), [[1, 1], [1, 1 + 1e-15]]]), "motion", "")
    with pytest.raises(GraphError, match="motion 0 is singular"):
        inverses(np.full((1, 2, 2), np.nan), "motion", "")


def test_a_matrix_that_is_not_finite_becomes_a_sentence_on_the_graph(book_log):
    symbolic = analyze(np.array([0, 1]), np.array([0]))
    with pytest.raises(NotFinite, match="NaN or infinity"):
        symbolic.factorize(np.full((1, 3, 3), np.nan))
    graph = Graph.from_log(book_log, edges="virtual+motion", kernel="none")
    family = graph.families[-1]
    family.information[4] = np.inf
    solution = solve(graph, initialize="given", max_iterations=1)
    assert not solution.converged
    with pytest.raises(GraphError, match="information matrix of the graph is not finite at pose 4"):
        solution.covariance()


def test_numbers_of_a_pose_graph_file_have_limits(tmp_path):
    path = tmp_path / "graph.g2o"
    path.write_text("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1e200 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    with pytest.raises(GraphError, match="1e\\+200 is too large"):
        Graph.from_g2o(path)
