from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from graphslam import Graph, OptionError, simulate, solve, solve_with_gtsam, textbook
from graphslam.edges import AnchorEdges
from graphslam.se2 import wrap
from graphslam.simulation.worlds import WORLDS
from graphslam.solvers import iteration as gauss_newton
from graphslam.solvers.contradictions import misfit_of_noise
from graphslam.solvers.iteration import Run


def difference(a, b):
    d = np.asarray(a) - np.asarray(b)
    return np.abs(np.column_stack([d[:, :2], wrap(d[:, 2])])).max()


@pytest.mark.parametrize("dimensions", [3, 2])
@pytest.mark.parametrize("edges", ["virtual", "virtual+motion"])
def test_first_step_of_the_world_frame_is_the_textbooks(book_log, clean_log, edges, dimensions):
    if edges == "virtual" and dimensions == 2:
        pytest.skip("not determined; see test_graph")
    for log in (book_log, clean_log):
        book = textbook.solve(log, edges=edges, dimensions=dimensions, max_iterations=1)
        ours = solve(
            Graph.from_log(log, edges=edges, frame="world", dimensions=dimensions, kernel="none"),
            max_iterations=1,
            initialize="given",
        )
        assert difference(ours.poses, book.poses) < 1e-10
        assert ours.step_norms[0] == pytest.approx(book.step_norms[0], rel=1e-10)
        assert ours.costs[0] == pytest.approx(book.costs[0], rel=1e-10)


@pytest.mark.parametrize("dimensions", [3, 2])
def test_world_frame_reaches_its_fixed_point_where_the_textbook_drifts(book_log, dimensions):
    graph = Graph.from_log(book_log, frame="world", dimensions=dimensions, edges="virtual+motion", kernel="none")
    solution = solve(graph)
    assert solution.converged
    # one more plain step, from the solution, must not move it: neither ours nor one with dense algebra
    system, _ = graph.linearize(solution.poses[graph.steps])
    step = np.linalg.solve(system.to_sparse().toarray(), system.xi.ravel())
    assert np.linalg.norm(step) < 1e-9


def test_body_frame_reaches_a_minimum_of_the_cost(book_log):
    graph = Graph.from_log(book_log, edges="virtual+motion", kernel="none")
    solution = solve(graph)
    assert solution.converged
    assert 5 <= solution.iterations <= 15
    rng = np.random.default_rng(0)
    for _ in range(50):
        nearby = solution.poses + rng.normal(size=solution.poses.shape) * 1e-3
        assert graph.cost(nearby) > solution.cost
    # the derivative of J along each coordinate, by differences of the cost alone
    for _ in range(20):
        direction = rng.normal(size=solution.poses.shape)
        slope = graph.cost(solution.poses + 1e-6 * direction) - graph.cost(solution.poses - 1e-6 * direction)
        assert abs(slope) / 2e-6 < 1e-2 * np.sqrt(solution.cost)


@pytest.mark.parametrize("frame", ["world", "body"])
@pytest.mark.parametrize("dimensions", [3, 2])
def test_levenberg_marquardt_finds_the_same(book_log, clean_log, frame, dimensions):
    for log in (book_log, clean_log):
        graph = Graph.from_log(log, frame=frame, dimensions=dimensions, edges="virtual+motion", kernel="none")
        newton, damped = solve(graph), solve(graph, method="levenberg-marquardt")
        assert newton.converged
        assert damped.converged
        assert difference(newton.poses, damped.poses) < 1e-7
        assert damped.cost == pytest.approx(newton.cost, rel=1e-9)


@pytest.mark.parametrize("psi", [True, False])
@pytest.mark.parametrize("seed", [0, 1])
def test_body_solutions_turn_with_the_world(seed, psi):
    log = simulate(seed=seed, orientation=psi)
    turn, shift = 2.5, np.array([10.0, -20.0])
    c, s = np.cos(turn), np.sin(turn)

    def moved(poses):
        return np.column_stack([poses[:, :2] @ np.array([[c, s], [-s, c]]) + shift, poses[:, 2] + turn])

    here = solve(Graph.from_log(log, edges="virtual+motion", kernel="none"))
    there = solve(
        Graph.from_log(log.replace(initial_poses=moved(log.initial_poses)), edges="virtual+motion", kernel="none")
    )
    assert here.converged
    assert difference(there.poses, moved(here.poses)) < 1e-8
    assert there.cost == pytest.approx(here.cost, rel=1e-9)


def test_doubling_all_noise_quarters_the_cost(book_log):
    from graphslam import MotionModel, SensorModel

    once = Graph.from_log(book_log, motion=MotionModel(epsilon=1e-4), edges="virtual+motion", kernel="none")
    twice = Graph.from_log(
        book_log,
        motion=MotionModel(nn=0.38, no=0.002, on=0.26, oo=0.4, epsilon=4e-4),
        sensor=SensorModel(range_rate=0.28, bearing_std=0.1, orientation_std=0.1),
        edges="virtual+motion",
        kernel="none",
    )
    state = book_log.initial_poses + 0.1
    for one, two in zip(once.families[1:], twice.families[1:]):
        assert two.cost(state, state) == pytest.approx(one.cost(state, state) / 4, rel=1e-10)


def test_renaming_landmarks_changes_nothing(book_log):
    renamed = book_log.replace(landmarks=np.array([40, 7, 3, 99, 5, 1])[book_log.landmarks])
    a, b = (
        solve(Graph.from_log(book_log, edges="virtual+motion", kernel="none")),
        solve(Graph.from_log(renamed, edges="virtual+motion", kernel="none")),
    )
    assert difference(a.poses, b.poses) < 1e-11
    for j, name in enumerate([40, 7, 3, 99, 5, 1]):
        np.testing.assert_allclose(b.landmarks[name], a.landmarks[j], atol=1e-10)


def test_a_noise_free_log_is_solved_exactly():
    from graphslam.simulation.simulator import MotionFaults, SensorFaults

    none = {"range_noise_rate": 0, "bearing_noise": 0, "orientation_noise": 0, "oversight": 0}
    no_bias = {"range_bias_rate_std": 0, "bearing_bias_std": 0, "orientation_bias_std": 0}
    log = simulate(
        seed=1,
        motion_faults=MotionFaults(kicks_per_metre=0, velocity_bias_std=0),
        sensor_faults=SensorFaults(**none, **no_bias),
    )
    lost = log.initial_poses + np.random.default_rng(0).normal(size=log.initial_poses.shape) * 0.1
    lost[0] = log.initial_poses[0]
    solution = solve(Graph.from_log(log.replace(initial_poses=lost), edges="virtual+motion", kernel="none"))
    assert difference(solution.poses, log.true_poses) < 1e-8
    assert solution.cost < 1e-12
    for j, landmark in solution.landmarks.items():
        np.testing.assert_allclose(landmark, log.true_landmarks[j], atol=1e-8)


def test_running_out_of_iterations_is_not_convergence(book_log):
    solution = solve(
        Graph.from_log(book_log, edges="virtual+motion", kernel="none"), max_iterations=2, initialize="given"
    )
    assert not solution.converged
    assert solution.iterations == 2
    assert "max_iterations = 2" in solution.reason
    none = solve(Graph.from_log(book_log, edges="virtual+motion", kernel="none"), max_iterations=0, initialize="given")
    assert not none.converged
    np.testing.assert_allclose(difference(none.poses, book_log.initial_poses), 0, atol=1e-12)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("method", ["gauss-newton", "levenberg-marquardt"])
def test_divergence_is_not_convergence(book_log, method):
    initial = book_log.initial_poses.copy()
    initial[30:, 0] += 1e200
    solution = solve(
        Graph.from_log(book_log, edges="virtual+motion", kernel="none").with_initial(initial),
        method=method,
        initialize="given",
    )
    assert not solution.converged
    assert "diverged" in solution.reason


def test_steps_that_lower_the_cost_little_keep_the_factor(monkeypatch):
    """Half of the factorisations or fewer, and the same end as with a new factor for every step."""
    log = simulate(WORLDS["garden"], steps=100, seed=0)
    graph = Graph.from_log(log, edges="landmark+motion", kernel="none")
    start = solve(graph).state + 0.01
    kept, renewed = (Run(start.copy(), tolerance=1e-9) for _ in range(2))
    gauss_newton.gauss_newton(graph, kept)
    monkeypatch.setattr(gauss_newton, "KEPT", 0.0)
    gauss_newton.gauss_newton(graph, renewed)
    assert kept.converged
    assert kept.factorizations <= len(kept.step_norms) / 2
    assert renewed.factorizations == len(renewed.step_norms)
    np.testing.assert_allclose(kept.state, renewed.state, atol=1e-8)


def test_the_callback_sees_every_step(book_log):
    seen = []
    solution = solve(Graph.from_log(book_log, edges="virtual+motion", kernel="none"), callback=seen.append)
    assert [step.number for step in seen] == list(range(1, solution.iterations + 1))
    np.testing.assert_array_equal([step.step_norm for step in seen], solution.step_norms)
    np.testing.assert_allclose(seen[-1].state[:, :2], solution.poses[:, :2], atol=1e-12)


def test_a_callback_may_end_a_solve(book_log):
    """What it leaves behind, such as second derivatives in Omega, does not change the next one of the same graph."""
    graph = Graph.from_log(book_log, edges="landmark+motion", kernel="cauchy", noise="book")

    def stop(step):
        if step.number == expected.iterations - 2:
            raise KeyboardInterrupt

    expected = solve(graph, initialize="given")
    assert "with second derivatives" in expected.reason
    with pytest.raises(KeyboardInterrupt):
        solve(graph, initialize="given", callback=stop)
    np.testing.assert_array_equal(solve(graph, initialize="given").step_norms, expected.step_norms)


@pytest.mark.parametrize("expected", [1, 3, 10, 30, 300])
def test_chance_is_not_noise(expected):
    """Where little was measured, J is often some times its expected value."""
    assert misfit_of_noise(chi2.isf(1e-4, expected), expected) == ""
    assert misfit_of_noise(float("inf"), expected) == ""
    assert "times what the noise models predict" in misfit_of_noise(
        max(chi2.isf(1e-6, expected), 2.1 * expected), expected
    )


def test_a_high_cost_is_said_without_convergence(book_log):
    """Also where the iterations are used up, unless J still falls."""
    ids = book_log.landmarks.copy()
    ids[::3] = ids[::-3]
    graph = Graph.from_log(book_log.replace(landmarks=ids), kernel="none")
    for steps, said in ((0, False), (1, False), (30, True)):
        solution = solve(
            graph, method="levenberg-marquardt", initialize="dead-reckoning", max_iterations=steps, tolerance=1e-300
        )
        assert not solution.converged
        assert any("times what the noise models predict" in note for note in solution.notes) == said


def test_covariance_is_the_diagonal_block_of_the_inverse(book_log):
    graph = Graph.from_log(book_log, edges="virtual+motion", kernel="none")
    solution = solve(graph)
    system, _ = graph.linearize(solution.poses)
    inverse = np.linalg.inv(system.to_sparse().toarray())
    for step in (0, 17, 61):
        block = inverse[3 * step : 3 * step + 3, 3 * step : 3 * step + 3]
        np.testing.assert_allclose(solution.covariance(step), block, rtol=1e-8, atol=1e-16)
    with pytest.raises(
        OptionError, match="there is no pose 62; the ids of the poses are the steps of the log, 0 to 61"
    ):
        solution.covariance(62)


def test_poses_that_are_no_nodes_have_no_covariance(book_log):
    solution = solve(Graph.from_log(book_log, edges="virtual", kernel="none"))
    unseen = int(np.flatnonzero(~solution.estimated)[0])
    np.testing.assert_allclose(wrap(solution.poses[unseen] - book_log.initial_poses[unseen]), 0, atol=1e-12)
    with pytest.raises(OptionError, match="not part of the graph"):
        solution.covariance(unseen)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "newton"}, "method must be one of"),
        ({"initialize": "zero"}, "initialize must be one of"),
        ({"tolerance": 0}, "tolerance must be a positive"),
        ({"max_iterations": -1}, "max_iterations must not be negative"),
    ],
)
def test_impossible_options(book_log, options, message):
    with pytest.raises(OptionError, match=message):
        solve(Graph.from_log(book_log, edges="virtual+motion", kernel="none"), **options)


@pytest.mark.parametrize(
    "options",
    [{"max_iterations": 2.5}, {"max_iterations": "3"}, {"max_iterations": float("nan")}, {"max_iterations": True},
     {"tolerance": "a"}, {"cost_tolerance": "a"}, {"cost_tolerance": float("nan")}],
)  # fmt: skip
def test_options_that_are_no_such_numbers(book_log, options):
    for solver in (solve, solve_with_gtsam) if "cost_tolerance" not in options else (solve,):
        with pytest.raises(OptionError, match=next(iter(options))):
            solver(Graph.from_log(book_log, edges="virtual+motion", kernel="none"), **options)


def test_a_step_number_is_whole(book_log):
    with pytest.raises(OptionError, match="poses must be an id"):
        solve(Graph.from_log(book_log, edges="virtual+motion", kernel="none")).covariance(1.0)


def test_a_family_derived_from_one_of_the_engine_may_have_its_own_sums(book_log):
    class Heavier(AnchorEdges):
        """An anchor that costs 1 more than it should."""

        def accumulate(self, state, reference, system):
            return super().accumulate(state, reference, system) + 1.0

    graph = Graph.from_log(book_log, edges="virtual+motion", kernel="none")
    anchor = next(family for family in graph.families if isinstance(family, AnchorEdges))
    heavier = Heavier(anchor.nodes, anchor.values, anchor.information)
    changed = replace(graph, families=tuple(heavier if family is anchor else family for family in graph.families))
    plain, costlier = (solve(each, initialize="given") for each in (graph, changed))
    np.testing.assert_allclose(costlier.costs, np.array(plain.costs) + 1, rtol=1e-9)
    np.testing.assert_allclose(costlier.state, plain.state, atol=1e-9)
