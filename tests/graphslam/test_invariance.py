"""The answer does not depend on how a graph is written down: numbers of nodes, order and direction of edges, ordering."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graphslam import Graph, solve
from graphslam.edges import RelativePoseEdges
from graphslam.linear.cholesky import analyze
from graphslam.se2 import between, inverse, rotation, wrap


def random_graph(seed, nodes=12):
    """A ring with chords around a known trajectory, noise of a tenth; node 0 is held."""
    rng = np.random.default_rng(seed)
    truth = np.column_stack([rng.normal(size=(nodes, 2)) * 5, rng.uniform(-np.pi, np.pi, nodes)])
    pairs = {(k, (k + 1) % nodes) for k in range(nodes)} | {
        tuple(rng.choice(nodes, 2, replace=False)) for _ in range(10)
    }
    first, second = np.array(sorted(pairs)).T
    measured = between(truth[first], truth[second]) + rng.normal(size=(len(first), 3)) * [0.1, 0.1, 0.02]
    factor = rng.normal(size=(len(first), 3, 3))
    information = factor @ np.swapaxes(factor, 1, 2) + np.eye(3)
    initial = truth + rng.normal(size=truth.shape) * [0.2, 0.2, 0.05]
    return graph_of(initial, first, second, measured, information)


def graph_of(initial, first, second, measured, information, fixed=0):
    edges = RelativePoseEdges(np.asarray(first), np.asarray(second), measured, information)
    steps = np.arange(len(initial))
    return Graph(initial, families=(edges,), steps=steps, trajectory=initial, pose_ids=steps, fixed=np.array([fixed]))


def same(a, b, tolerance=1e-9):
    d = a - b
    d[:, 2] = wrap(d[:, 2])
    np.testing.assert_allclose(d, 0, atol=tolerance)


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1))
def test_against_dense_algebra(seed):
    graph = random_graph(seed)
    system, _ = graph.linearize(graph.initial)
    dense = system.to_sparse().toarray()
    ours = system.factorize().solve(system.xi)
    np.testing.assert_allclose(ours.ravel(), np.linalg.solve(dense, system.xi.ravel()), rtol=1e-9, atol=1e-9)


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1))
def test_renumbered_nodes(seed):
    graph = random_graph(seed)
    edges, n = graph.families[0], graph.num_nodes
    new = np.random.default_rng(seed).permutation(n)  # node k becomes node new[k]
    initial = np.empty_like(graph.initial)
    initial[new] = graph.initial
    renamed = graph_of(
        initial, new[edges.first], new[edges.second], edges.measured, edges.information, fixed=int(new[0])
    )
    ours, theirs = solve(graph), solve(renamed)
    assert ours.converged == theirs.converged
    if ours.converged:
        same(theirs.state[new], ours.state)
        assert theirs.cost == pytest.approx(ours.cost, rel=1e-9)


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1))
def test_reversed_and_shuffled_edges(seed):
    graph = random_graph(seed)
    edges = graph.families[0]
    rng = np.random.default_rng(seed)
    order = rng.permutation(edges.count)
    shuffled = graph_of(
        graph.initial, edges.first[order], edges.second[order], edges.measured[order], edges.information[order]
    )
    state = graph.initial + rng.normal(size=graph.initial.shape) * 0.01
    assert shuffled.cost(state) == pytest.approx(graph.cost(state), rel=1e-12)
    same(solve(shuffled).state, solve(graph).state)
    # z_ji = z_ij^-1: on exact measurements the reversed edge has the same zero, and the same information turned
    exact = between(state[edges.first], state[edges.second])
    there = graph_of(state + 0.05, edges.first, edges.second, exact, edges.information)
    turn = np.broadcast_to(np.eye(3), edges.information.shape).copy()
    turn[:, :2, :2] = rotation(-exact[:, 2])
    back = graph_of(
        state + 0.05, edges.second, edges.first, inverse(exact), turn @ edges.information @ np.swapaxes(turn, 1, 2)
    )
    for one in (there, back):
        solution = solve(one)
        assert solution.cost < 1e-16
        same(between(solution.state[:1], solution.state), between(state[:1], state), 1e-8)


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1))
def test_any_ordering_gives_the_same_step(seed):
    graph = random_graph(seed)
    system, _ = graph.linearize(graph.initial)
    expected = system.factorize().solve(system.xi)
    order = np.random.default_rng(seed).permutation(graph.num_nodes).astype(np.int32)
    for ordering in (np.arange(graph.num_nodes), order):
        factor = analyze(system.indptr, system.indices, ordering=ordering).factorize(system.values)
        np.testing.assert_allclose(factor.solve(system.xi), expected, rtol=1e-9, atol=1e-9)
