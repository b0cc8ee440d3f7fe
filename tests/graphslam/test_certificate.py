"""The proof of global optimality: what it proves, what it must not prove, and the mathematics behind it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from certified_graphs import GivenEdges, pose_graph, ring

from comparisons.datasets import data_folder
from graphslam import (
    AbsolutePositions,
    Graph,
    GraphError,
    MotionModel,
    OptionError,
    certify,
    load,
    sample_log_path,
    simulate,
    solve,
)
from graphslam.edges import AnchorEdges, ConstantEdges, RelativePointEdges, RelativePoseEdges
from graphslam.se2 import between, compose, wrap
from graphslam.simulation.simulator import SensorFaults
from graphslam.solvers import auto
from graphslam.solvers.certificate import _problem, prove, prove_edges


@pytest.fixture(scope="module")
def sample():
    return load(sample_log_path())


@pytest.mark.parametrize("edges", ["virtual", "virtual+motion"])
@pytest.mark.parametrize("weight", ["pairs", "tempered", "marginal"])
def test_the_sample_log_is_proven(sample, edges, weight):
    solution = solve(Graph.from_log(sample, edges=edges, weight=weight, kernel="none"))
    proof = solution.certificate
    assert proof.status == "global"
    assert 0 <= proof.relative_gap < 1e-9
    assert proof.lower_bound == pytest.approx(solution.cost, rel=1e-9)
    assert proof.lower_bound <= solution.cost
    assert proof.seconds > 0
    assert solution.certificate is proof


@pytest.mark.parametrize("kernel", ["none", "cauchy"])
def test_a_proof_of_the_search_is_not_repeated(sample, kernel, monkeypatch):
    graph, calls = Graph.from_log(sample, kernel=kernel), []
    monkeypatch.setattr(auto, "prove", lambda *a, **options: calls.append(prove(*a, **options)) or calls[-1])
    found = solve(graph)
    monkeypatch.setattr("graphslam.solvers.solution.prove", lambda *_: pytest.fail("a second proof"))
    assert found.certificate in calls
    again = prove(graph, found.state)
    assert found.certificate.status == again.status
    assert found.certificate.reason == again.reason
    assert found.certificate.lower_bound == pytest.approx(again.lower_bound, rel=1e-9)


def test_marginal_edges_without_psi_are_proven(sample):
    assert (
        solve(
            Graph.from_log(sample, weight="marginal", dimensions=2, edges="virtual+motion", kernel="none")
        ).certificate.status
        == "global"
    )


def test_a_wrong_winding_is_not_proven():
    graph, right = ring(12, windings=3), ring(12)
    wrong = solve(graph, initialize="given")
    best = solve(right, initialize="given")
    assert wrong.converged
    assert wrong.cost > best.cost + 1
    proof = wrong.certificate
    assert proof.status == "not proven"
    assert proof.lower_bound <= best.cost
    assert proof.direction.shape == (12, 2)
    assert best.certificate.status == "global"


@pytest.mark.slow
def test_the_function_stays_below_the_cost_and_touches_it(sample):
    rng = np.random.default_rng(4)
    for graph in (
        Graph.from_log(sample, edges="virtual+motion", kernel="none"),
        Graph.from_log(sample, weight="marginal", edges="virtual+motion", kernel="none"),
    ):
        state = solve(graph).state
        problem = _problem(graph.families, state, graph.fixed, graph.system.structure)
        parts = [family.constant(state) for family in graph.families]
        nodes = np.concatenate([state, *(part.landmarks for part in parts)])
        for share in (0.3, 0.1):
            values, gradient = problem.proof.function_of(share)
            cost = problem.proof.cost
            S = hermitian(problem.structure, values)
            assert cost == pytest.approx(graph.cost(state), rel=1e-12)
            base = variables(nodes)
            for size in (1e-3, 0.1, 1.0, 10.0):
                moved = nodes + size * rng.standard_normal(nodes.shape)
                x = variables(moved) - base
                # S is the matrix of the function with its multipliers, which add nothing where abs(z) = 1
                below = cost + 2 * np.vdot(gradient.ravel(), x).real + np.vdot(x, S @ x).real
                assert below <= cost_of(graph, parts, moved) + 1e-6


def variables(state):
    x = np.empty(2 * len(state), dtype=complex)
    x[0::2], x[1::2] = np.exp(1j * state[:, 2]), state[:, 0] + 1j * state[:, 1]
    return x


def cost_of(graph, parts, state):
    """J with the landmarks of marginal edges where the state has them, computed from the edges in their constant form."""
    total = 0.0
    for part in parts:
        for k, (first, second) in enumerate(zip(part.first, part.second)):
            a, b = np.zeros(3) if first < 0 else state[first], state[second]
            c, s = np.cos(b[2]), np.sin(b[2])
            reached = b[:2] + [c * part.end[k, 0] - s * part.end[k, 1], s * part.end[k, 0] + c * part.end[k, 1]]
            e = between(a, np.append(reached, 0.0))[:2] - part.start[k]
            if part.turn is not None:
                e = np.append(e, wrap(b[2] - a[2] - part.turn[k]))
            total += e @ part.information[k] @ e
    if graph.num_nodes == len(state):
        assert total == pytest.approx(graph.cost(state), rel=1e-9)
    return total


def hermitian(structure, values):
    """The whole matrix (2N, 2N) of upper blocks."""
    n = len(structure.indptr) - 1
    S = np.zeros((2 * n, 2 * n), dtype=complex)
    for j in range(n):
        for p in range(structure.indptr[j], structure.indptr[j + 1]):
            i = structure.indices[p]
            S[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] = values[p]
            S[2 * j : 2 * j + 2, 2 * i : 2 * i + 2] = values[p].conj().T
    return S


@pytest.mark.parametrize(("frame", "weight", "dimensions", "kernel", "words"), [
    ("world", "pairs", 3, None, "world frame"),
    ("world", "marginal", 3, None, "world frame"),
    ("world", "marginal", 3, "huber", "world frame"),
    ("body", "pairs", 2, None, "without psi"),
])  # fmt: skip
def test_what_stands_outside_is_named(sample, frame, weight, dimensions, kernel, words):
    graph = Graph.from_log(
        sample, frame=frame, weight=weight, dimensions=dimensions, kernel=kernel, edges="virtual+motion"
    )
    proof = certify(graph, graph.initial)
    assert proof.status == "not applicable"
    assert words in proof.reason
    assert np.isnan(proof.lower_bound) and np.isnan(proof.relative_gap)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_landmark_nodes_are_proven_like_the_marginal_edges(sample, dimensions):
    nodes = solve(Graph.from_log(sample, edges="landmark+motion", dimensions=dimensions, kernel="none"))
    eliminated = solve(
        Graph.from_log(sample, edges="virtual+motion", weight="marginal", dimensions=dimensions, kernel="none")
    )
    assert nodes.certificate.status == eliminated.certificate.status == "global"
    assert nodes.certificate.lower_bound == pytest.approx(eliminated.certificate.lower_bound, rel=1e-9)


def test_range_and_bearing_of_landmark_nodes_stand_outside(sample):
    graph = Graph.from_log(sample, edges="landmark+motion", residual="polar", kernel="none")
    proof = certify(graph, graph.initial)
    assert proof.status == "not applicable" and "h(x, m) - z" in proof.reason


def test_a_solution_that_has_not_converged_is_not_proven(sample):
    solution = solve(
        Graph.from_log(sample, edges="virtual+motion", kernel="none"), initialize="dead-reckoning", max_iterations=2
    )
    assert not solution.converged
    assert solution.certificate.status == "not proven"


def test_a_state_that_is_not_stationary_has_a_bound_below_the_optimum(sample):
    graph = Graph.from_log(sample, edges="virtual+motion", kernel="none")
    best = solve(graph)
    moved = best.state + 1e-3 * np.random.default_rng(0).standard_normal(best.state.shape)
    proof = certify(graph, moved)
    assert proof.lower_bound <= best.cost
    assert proof.status == "not proven"
    if proof.lower_bound > 0:
        assert proof.relative_gap == pytest.approx((graph.cost(moved) - proof.lower_bound) / graph.cost(moved))
    else:
        # no bound is known, so that there is no gap to name
        assert np.isnan(proof.relative_gap)


def test_residuals_of_half_a_turn_are_not_proven():
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    information = np.diag([1.0, 1.0, 1.0])
    graph = pose_graph(poses, [(0, 1), (0, 1)], information)
    edges = graph.families[0]
    edges.measured[:, 2] = [np.pi / 2, -np.pi / 2]
    # two optima at 0 and pi with equal costs
    for heading in (0.0, np.pi):
        state = poses.copy()
        state[1, 2] = heading
        proof = certify(graph, state)
        assert proof.lower_bound <= graph.cost(state) * (1 + 1e-12)
    half = replace(edges, measured=np.column_stack([edges.measured[:, :2], np.full(2, np.pi)]))
    graph, state = replace(graph, families=(half,)), poses.copy()
    proof = certify(graph, state)
    assert proof.status == "not proven"
    assert "half a turn" in proof.reason


def test_a_single_pose_and_no_edges():
    poses = np.array([[1.0, 2.0, 0.5]])
    alone = Graph(poses, families=(), steps=np.arange(1), trajectory=poses, pose_ids=np.arange(1))
    assert certify(alone, poses).status == "global"
    anchor = AnchorEdges(np.zeros(1, dtype=int), poses + 1.0, 1e6 * np.eye(3)[None])
    held = Graph(poses, families=(anchor,), steps=np.arange(1), trajectory=poses, pose_ids=np.arange(1))
    assert certify(held, poses + 1.0).status == "global"
    assert certify(held, poses).status == "not proven"
    fixed = Graph(
        poses, families=(), steps=np.arange(1), trajectory=poses, pose_ids=np.arange(1), fixed=np.zeros(1, int)
    )
    assert certify(fixed, poses).status == "global"


def test_pieces_of_a_graph_are_proven_one_by_one():
    rng = np.random.default_rng(3)
    poses = rng.standard_normal((6, 3))
    pairs = [(0, 1), (1, 2), (0, 2), (3, 4), (4, 5), (3, 5)]
    graph = pose_graph(poses, pairs, np.eye(3), noise=0.1, rng=rng)
    # hold one pose of the second piece only to solve; the proof does not need it
    both = replace(graph, fixed=np.array([0, 3]))
    solution = solve(both, initialize="given")
    assert solution.converged
    assert certify(graph, solution.state).status == "global"


def test_no_anchor_and_no_fixed_pose():
    rng = np.random.default_rng(5)
    poses = rng.standard_normal((5, 3))
    graph = pose_graph(poses, [(0, 1), (1, 2), (2, 3), (3, 4), (4, 0)], np.eye(3), noise=0.1, rng=rng)
    state = solve(graph, initialize="given").state
    free = replace(graph, fixed=np.zeros(0, dtype=int))
    assert certify(free, compose(np.array([3.0, -2.0, 1.0]), state)).status == "global"


def test_noise_free_graphs_are_proven():
    poses = np.random.default_rng(1).standard_normal((5, 3))
    graph = pose_graph(poses, [(0, 1), (1, 2), (2, 3), (3, 4), (4, 0)], np.eye(3))
    assert certify(graph, poses).status == "global"


def test_landmarks_without_heading():
    rng = np.random.default_rng(2)
    poses = rng.standard_normal((6, 3))
    points = rng.standard_normal((3, 2)) * 3
    first, second = np.repeat(np.arange(6), 3), 6 + np.tile(np.arange(3), 6)
    measured = between(poses[first], np.column_stack([points[second - 6], np.zeros(18)]))[:, :2]
    edges = RelativePointEdges(
        first, second, measured + 0.05 * rng.standard_normal((18, 2)), np.tile(np.diag([400.0, 100.0]), (18, 1, 1))
    )
    initial = np.concatenate([poses, np.pad(points, ((0, 0), (0, 1)))])
    graph = Graph(
        initial, families=(edges,), steps=np.arange(6), trajectory=poses, pose_ids=np.arange(6),
        landmark_ids=np.arange(3), fixed=np.zeros(1, dtype=int),
    )  # fmt: skip
    solution = solve(graph, initialize="given")
    assert solution.certificate.status == "global"


def test_small_epsilon_of_motion_edges():
    log = simulate(seed=1)
    graph = Graph.from_log(log, edges="virtual+motion", motion=MotionModel(epsilon=1e-8), kernel="none")
    assert solve(graph).certificate.status == "global"


def test_poses_of_a_trajectory_and_wrong_shapes(sample):
    graph = Graph.from_log(sample, edges="virtual+motion", kernel="none")
    solution = solve(graph)
    assert certify(graph, solution.poses).status == "global"
    assert certify(graph, solution) is solution.certificate
    with pytest.raises(OptionError, match="must have shape"):
        certify(graph, np.zeros((3, 3)))


def test_an_edge_from_a_pose_to_itself_is_refused():
    with pytest.raises(GraphError, match="from node 1 to itself"):
        RelativePoseEdges(np.array([0, 1]), np.array([1, 1]), np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1)))


def test_an_edge_from_a_pose_to_itself_is_a_constant():
    """A family may have edges that no state changes: they are part of the bound, and not of S."""
    graph = ring(5)
    state = solve(graph, initialize="given").state
    edges = graph.families[0].constant(state)
    alone = prove_edges([GivenEdges(edges)], state, graph.fixed, graph.cost(state))
    loop = ConstantEdges(
        np.ones(1, int), np.ones(1, int), np.ones((1, 2)), np.zeros((1, 2)), np.zeros(1), np.diag([2.0, 3.0, 4.0])[None]
    )
    both = prove_edges([GivenEdges(edges), GivenEdges(loop)], state, graph.fixed, graph.cost(state) + 5.0)
    assert alone.status == both.status == "global"
    assert both.lower_bound == pytest.approx(alone.lower_bound + 5.0, rel=1e-12)


def test_a_state_that_moves_a_fixed_pose_is_not_proven():
    graph = ring(6)
    state = solve(graph, initialize="given").state
    assert certify(graph, state).status == "global"
    turned = state.copy()
    turned[0, 2] += 2 * np.pi
    assert certify(graph, turned).status == "global"
    both = replace(graph, fixed=np.array([0, 3]), initial=state)
    moved = state.copy()
    moved[3] += [0.1, 0.0, 0.0]
    proof = certify(both, moved)
    assert proof.status == "not proven"
    assert proof.lower_bound == 0.0
    assert "moves pose 3" in proof.reason


def test_a_constant_form_with_another_cost_is_not_proven():
    class Wrong(RelativePoseEdges):
        def constant(self, state):
            edges = super().constant(state)
            return replace(edges, information=edges.information / 2)

    graph = ring(6, windings=2)
    edges = graph.families[0]
    graph = replace(graph, families=(Wrong(edges.first, edges.second, edges.measured, edges.information),))
    proof = certify(graph, solve(graph, initialize="given").state)
    assert proof.status == "not proven" and "constant form" in proof.reason


def test_edges_choose_their_splits():
    """One split for all edges does not prove this log; choosing by edge does."""
    folder = data_folder() / "mrclam6"
    if not folder.exists():
        pytest.skip(f"needs {folder}")
    graph = Graph.from_log(load(folder, robot=3), edges="landmark+motion", kernel="none", noise="book")
    solution = solve(graph)
    quick = prove(graph, solution.state, thorough=False)
    assert quick.status == "not proven" and quick.direction is not None
    assert solution.certificate.status == "global"


def test_a_robust_fit_with_fixed_weights_is_proven():
    log = simulate(seed=2, sensor_faults=SensorFaults(phantom=0.05))
    solution = solve(Graph.from_log(log, edges="virtual+motion", weight="marginal", kernel="none"), method="gnc")
    assert solution.converged
    assert solution.certificate.status == "global"


@pytest.mark.slow
def test_a_perfect_graph_is_global_although_rounding_leaves_a_residue():
    """1,500 poses with information of 1e6: J is tiny, and the residuals are a little above their rounding errors."""
    rng, n = np.random.default_rng(2), 1500
    poses = np.cumsum(rng.normal(0, 1, (n, 3)), axis=0)
    first, second = np.arange(n - 1), np.arange(1, n)
    first, second = np.append(first, rng.integers(0, 499, n)), np.append(second, rng.integers(500, n, n))
    edges = RelativePoseEdges(
        first, second, between(poses[first], poses[second]), np.tile(1e6 * np.eye(3), (len(first), 1, 1))
    )
    parts = {"families": (edges,), "steps": np.arange(n), "trajectory": poses, "pose_ids": np.arange(n)}
    graph = Graph(poses, fixed=np.array([0]), **parts)
    moved = poses + rng.normal(0, 1e-12, poses.shape)
    moved[0] = poses[0]
    proof = certify(graph, moved)
    assert 0 < graph.cost(moved) < 1e-6
    assert proof.status == "global" and proof.relative_gap == 0
    # a small J alone proves nothing: with information of 1e-12 a wrong minimum has a small one, too
    weak = replace(edges, information=edges.information * 1e-18)
    wrong = poses.copy()
    wrong[750:, 2] += 1.0
    assert graph.cost(wrong) > 1 and replace(graph, families=(weak,)).cost(wrong) < 1e-6
    assert certify(replace(graph, families=(weak,)), wrong).status == "not proven"


def test_a_drive_in_utm_coordinates_is_proven() -> None:
    """Bounds on rounding grew with the coordinates, so that nothing was proven millions of metres from the origin."""
    log = simulate(seed=0, clean=True, orientation=False)
    assert log.true_poses is not None
    steps = np.arange(0, log.num_poses, 4)
    places = log.true_poses[steps, :2] + [5e5, 5.4e6] + 0.1 * np.random.default_rng(0).normal(size=(len(steps), 2))
    positions = AbsolutePositions(steps=steps, places=places, covariances=0.01 * np.eye(2))
    solution = solve(Graph.from_log(log.replace(positions=positions), edges="landmark+motion", kernel="none"))
    assert solution.certificate.status == "global" and solution.certificate.relative_gap < 1e-10
