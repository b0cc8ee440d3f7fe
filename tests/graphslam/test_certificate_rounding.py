"""What rounding and very unequal information may not prove, and random graphs against the certificate."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from certified_graphs import GivenEdges, pose_graph, ring

from graphslam import Graph, certify, solve
from graphslam.edges import AnchorEdges, RelativePoseEdges
from graphslam.engine import engine
from graphslam.linear.information import BlockSystem
from graphslam.solvers.certificate import prove_edges


@pytest.mark.parametrize("seed", range(30))
def test_hermitian_factorisation(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 12))
    pairs = np.sort(rng.integers(0, n, (2 * n, 2)), axis=1)
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    system = BlockSystem.from_cliques(n, [(np.arange(0, 2 * len(pairs) + 1, 2), pairs.ravel())])
    A = np.zeros((2 * n, 2 * n), dtype=complex)
    for i, j in pairs:
        B = np.zeros((2, 2 * n), dtype=complex)
        for k in (i, j):
            B[:, 2 * k : 2 * k + 2] = rng.standard_normal((2, 2)) + 1j * rng.standard_normal((2, 2))
        A += B.conj().T @ B
    A += (0.1 if seed % 2 else -0.3) * np.eye(2 * n)
    values = np.zeros((len(system.indices), 2, 2), dtype=complex)
    for j in range(n):
        for p in range(system.indptr[j], system.indptr[j + 1]):
            i = system.indices[p]
            values[p] = A[2 * i : 2 * i + 2, 2 * j : 2 * j + 2]
    pattern, order = (system.indptr, system.indices), rng.permutation(n).astype(np.int32)
    symbolic = engine.for_proof(engine.analyze(*pattern, order, threads=1))
    factor = engine.HermitianFactor(symbolic)
    bad = factor.factorize(values, 0.0)
    if np.linalg.eigvalsh(A)[0] < 0:
        v = factor.null_vector(bad).ravel()
        assert np.vdot(v, A @ v).real < 0
        return
    rhs = rng.standard_normal((n, 2)) + 1j * rng.standard_normal((n, 2))
    exact, solved = np.linalg.solve(A, rhs.ravel()), np.empty_like(rhs)
    factor.solve(rhs, solved)
    np.testing.assert_allclose(solved.ravel(), exact, rtol=1e-9)
    rounding, parts, square = engine.rounding_bounds(factor, rhs)
    # the bound on rounding errors is one for every matrix with entries of at most min(c_i, c_j) (|L| |L|')_ij
    rows = (2 * symbolic.order[:, None] + [0, 1]).ravel()
    L, c = np.abs(np.linalg.cholesky(A[np.ix_(rows, rows)])), np.repeat(rounding, 2)
    error = np.repeat(parts, 2) * np.diag(A).real[rows]
    worst = np.minimum(c[:, None], c) * (L @ L.T) / np.sqrt(np.outer(error, error))
    assert 0.05 < np.linalg.eigvalsh(worst)[-1] <= 1
    # solving with L has rounding errors, too
    assert square == pytest.approx(np.vdot(rhs.ravel(), exact).real, rel=0.01)
    assert square > np.vdot(rhs.ravel(), exact).real


def test_very_unequal_information_is_proven_with_its_rounding():
    rng = np.random.default_rng(8)
    poses = rng.standard_normal((8, 3)) * [3.0, 3.0, 1.0]
    pairs = [(k, (k + 1) % 8) for k in range(8)] + [(0, 4), (2, 6)]
    graph = pose_graph(poses, pairs, np.diag([1e10, 1.0, 100.0]), noise=1e-3, rng=rng)
    solution = solve(graph, initialize="given")
    assert solution.certificate.status in ("global", "not proven")
    assert solution.certificate.lower_bound <= solution.cost


@pytest.fixture(scope="module")
def benchmark():
    path = Path(__file__).parents[2] / "benchmarks" / "certificate.py"
    spec = importlib.util.spec_from_file_location("certificate_benchmark", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_far_pose_with_strong_information_does_not_hide_a_wrong_minimum():
    """What counts as zero is the rounding of each edge, not that of the largest coordinate of the graph."""
    wrong = ring(12, windings=3)
    far = np.array([[1e7, 0.0, 0.0], [1e7 + 1.0, 0.0, 0.0]])
    strong = RelativePoseEdges(
        np.array([12]), np.array([13]), np.array([[1.0, 0.0, 0.0]]), np.diag([1e18, 1e18, 1e18])[None]
    )
    poses = np.concatenate([solve(wrong, initialize="given").state, far])
    graph = replace(
        wrong, initial=poses, families=(*wrong.families, strong), steps=np.arange(14), trajectory=poses,
        pose_ids=np.arange(14),
    )  # fmt: skip
    assert certify(graph, poses).status == "not proven"


def test_coordinates_so_large_that_their_rounding_costs_much_are_not_proven():
    poses = np.array([[1e12, 1e12, 0.0], [1e12 + 1.0, 1e12, 0.0]])
    graph = pose_graph(poses, [(0, 1)], 1e9 * np.eye(3))
    graph.families[0].measured[0, 0] += 1e-5
    assert graph.cost(poses) > 0.05
    assert certify(graph, poses).status == "not proven"


@pytest.mark.parametrize(("information", "words"), [
    (np.diag([1.0, 1.0, -1.0]), "the nodes 0 and 1 is not positive semi-definite"),
    (np.diag([1.0, -1e-3, 1.0]), "not positive semi-definite"),
    (np.array([[1.0, 0.0, 1.1], [0.0, 1.0, 0.0], [1.1, 0.0, 1.0]]), "not positive semi-definite"),
])  # fmt: skip
def test_information_that_is_no_information_stands_outside(information, words):
    graph = ring(4)
    graph.families[0].information[0] = information
    proof = certify(graph, graph.initial)
    assert proof.status == "not applicable"
    assert words in proof.reason
    assert np.isnan(proof.lower_bound) and np.isnan(proof.relative_gap)


def test_information_that_is_not_symmetric():
    """J depends on its symmetric part, which is proven; edges in their constant form must be symmetric."""
    proofs = []
    for across in ([0.5, 0.0], [0.25, 0.25]):
        graph = ring(4)
        graph.families[0].measured[0] += 0.1
        graph.families[0].information[0] = [[2.0, across[0], 0.0], [across[1], 1.0, 0.0], [0.0, 0.0, 1.0]]
        proofs.append(solve(graph).certificate)
    assert proofs[0].status == "global" and proofs[0].lower_bound > 1e-3
    assert proofs[0].lower_bound == proofs[1].lower_bound
    graph = ring(4)
    edges = graph.families[0].constant(graph.initial)
    edges.information[0, 0, 1] += 0.5
    proof = prove_edges([GivenEdges(edges)], graph.initial, graph.fixed, graph.cost(graph.initial))
    assert proof.status == "not applicable" and "not symmetric" in proof.reason


def test_information_that_is_singular_up_to_rounding_is_inside():
    rng = np.random.default_rng(0)
    poses = rng.standard_normal((6, 3))
    axes = rng.standard_normal((3, 2))
    graph = pose_graph(poses, [(k, (k + 1) % 6) for k in range(6)], np.eye(3), noise=0.1, rng=rng)
    graph.families[0].information[0] = axes @ axes.T
    proof = certify(graph, solve(graph, initialize="given").state)
    assert proof.status == "not proven" and "singular information" in proof.reason


def test_a_negative_eigenvalue_of_the_size_of_rounding_proves_nothing():
    """An eigenvalue of -6.7e-15 of the largest: far out, the cost falls below that of the state."""
    size, part = 2.0**36, 30 * 2.0**-52
    tilted = size * np.array([[1, 1 + part, 0], [1 + part, 1, 0], [0, 0, 1]])
    holding = np.diag([1.02 * size * part, 1.02 * size * part, 1.0])
    measured = np.array([[0.0, 0, 0], [64, -64, 0], [0, 0, 0], [30, 0, 0]])
    information = np.array([tilted, holding, np.eye(3), np.eye(3)])
    edges = RelativePoseEdges(np.zeros(4, int), np.array([1, 1, 2, 2]), measured, information)
    state = np.array([[0.0, 0, 0], [64, -64, 0], [15, 0, 0]])
    graph = Graph(
        state, families=(edges,), steps=np.arange(3), trajectory=state, pose_ids=np.arange(3), fixed=np.array([0])
    )
    far = np.array([[0.0, 0, 0], [3264, -3264, 0], [15, 0, 0]])
    assert graph.cost(far) < 0.6 * graph.cost(state)
    assert certify(graph, state).status == "not proven"


def test_anchors_have_symmetric_information():
    """Read from one triangle, this anchor would hold y; in J it does not."""
    information = np.array([[1e11, 0, 0], [99.0, 1e-8, 0], [0, 0, 1.0]])
    anchor = AnchorEdges(np.array([0]), np.zeros((1, 3)), information[None])
    pair = RelativePoseEdges(
        np.array([0, 0]), np.array([1, 1]), np.array([[0.0, 0, 0], [3, 0, 0]]), np.array([np.eye(3)] * 2)
    )
    state = np.array([[0.0, 0, 0], [1.5, 0, 0]])
    graph = Graph(
        state,
        families=(anchor, pair),
        steps=np.arange(2),
        trajectory=state,
        pose_ids=np.arange(2),
        fixed=np.array([], int),
    )
    assert certify(graph, state).status != "global"


def test_no_false_proofs_on_random_graphs(benchmark):
    """Random graphs with very unequal information, wrong loop closures, poses in one place and turns of half a circle."""
    tried = proven = above = 0
    for seed in range(25):
        rng = np.random.default_rng(seed)
        graph = benchmark.random_graph(rng)
        states = list(benchmark.candidates(graph, rng, 6))
        proofs = [certify(graph, state) for state in states]
        costs = [graph.cost(state) for state in states]
        assert list(benchmark.faults(graph, states, proofs, rng)) == [], seed
        tried, above = tried + len(states), above + sum(cost > min(costs) * (1 + 1e-6) for cost in costs)
        proven += sum(proof.status == "global" for proof in proofs)
    assert tried > 100 and proven > 10 and above > 50


def test_a_grid_over_all_headings_contradicts_no_proof(benchmark, capsys):
    benchmark.global_search(6)
    outcome = capsys.readouterr().out
    assert "'contradicted': 0" in outcome and "'solve above the search': 0" in outcome and "solve global" in outcome


def test_the_split_leaves_a_positive_semidefinite_rest(benchmark):
    """diag(beta, beta, kappa) <= Omega, in exact rational arithmetic."""
    rng = np.random.default_rng(0)
    for _ in range(400):
        omega = benchmark.random_information(rng, 3, float(rng.choice([0, 2, 4, 6])))
        if rng.random() < 0.3:
            omega[:2, :2] = np.eye(2) * np.trace(omega[:2, :2])
        share = float(rng.choice([0.02, 0.3, 0.95]))
        upper = omega[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
        beta, kappa = engine.split_information(upper, share)
        if beta <= 0 or kappa <= 0:
            continue
        rest = [[Fraction(value) for value in row] for row in omega.tolist()]
        for k, part in enumerate((beta, beta, kappa)):
            rest[k][k] -= Fraction(part)
        (a, b, c), (_, d, e), (_, _, f) = rest
        assert a >= 0 and d >= 0 and f >= 0
        assert a * d - b * b >= 0 and a * f - c * c >= 0 and d * f - e * e >= 0
        assert a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d) >= 0
