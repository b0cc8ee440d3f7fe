"""Nested dissection: separators of the size that SciPy's maximum flow gives, and orders that save flops."""

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.csgraph import maximum_flow

from graphslam.engine import engine

#: graphs of so many nodes, whose order by minimum degree takes so many flops for each node and entry, are dissected; nodes
#: with more than so many times the root of all as neighbours come last
LIMITS, DENSE = (5_000, 10_000.0), 10.0


def adjacency(n, first, second):
    """List pointers and lists of an undirected graph."""
    graph = sp.coo_matrix((np.ones(len(first)), (first, second)), shape=(n, n))
    graph = ((graph + graph.T) > 0).tocsr()
    graph.setdiag(False)
    graph.eliminate_zeros()
    return graph.indptr.astype(np.int64), graph.indices.astype(np.int32)


def upper(n, first, second):
    """The pattern in upper CSC with the diagonal."""
    low, high = np.minimum(first, second), np.maximum(first, second)
    pattern = sp.coo_matrix(
        (np.ones(len(low) + n), (np.r_[low, np.arange(n)], np.r_[high, np.arange(n)])), shape=(n, n)
    ).tocsc()
    pattern.sort_indices()
    return pattern.indptr.astype(np.int64), pattern.indices.astype(np.int64)


def grid(rows, columns):
    """The edges of a grid of nodes with diagonals."""
    k = np.arange(rows * columns).reshape(rows, columns)
    pairs = [(k[1:], k[:-1]), (k[:, 1:], k[:, :-1]), (k[1:, 1:], k[:-1, :-1]), (k[1:, :-1], k[:-1, 1:])]
    return tuple(np.concatenate([pair[side].ravel() for pair in pairs]) for side in (0, 1))


def smallest_cut(pointer, neighbours, side):
    """The size of a smallest separator of sides 0 and 2, by SciPy's flow on the graph with every node split."""
    n = len(pointer) - 1
    first = np.repeat(np.arange(n), np.diff(pointer))
    ends, starts = np.flatnonzero(side == 0), np.flatnonzero(side == 2)
    source, sink, large = 2 * n, 2 * n + 1, n + 1
    rows = np.r_[2 * np.arange(n), 2 * first + 1, np.full(len(ends), source), 2 * starts + 1]
    columns = np.r_[2 * np.arange(n) + 1, 2 * neighbours, 2 * ends, np.full(len(starts), sink)]
    capacity = np.r_[np.ones(n), np.full(len(rows) - n, large)].astype(np.int32)
    return maximum_flow(sp.csr_matrix((capacity, (rows, columns)), shape=(2 * n + 2,) * 2), source, sink).flow_value


@pytest.mark.parametrize("seed", range(12))
def test_separators_are_smallest(seed):
    rng = np.random.default_rng(seed)
    n = 120
    place = rng.uniform(0, 1, (n, 2))
    distance = np.linalg.norm(place[:, None] - place[None], axis=2) + 9 * np.tri(n)
    first, second = np.nonzero((distance < 0.16) | (rng.uniform(size=(n, n)) < 0.002) & (distance < 9))
    pointer, neighbours = adjacency(n, first, second)
    order, side = np.argsort(place[:, 0]), np.ones(n, np.int8)
    side[order[:40]], side[order[-40:]] = 0, 2
    expected = smallest_cut(pointer, neighbours, side)
    given = side.copy()
    assert engine.separate(pointer, neighbours, side) == expected == np.sum(side == 1)
    owner = side[np.repeat(np.arange(n), np.diff(pointer))]
    assert not np.any((owner == 0) & (side[neighbours] == 2))
    # a node of one end never changes to the other
    assert not np.any((given == 0) & (side == 2) | (given == 2) & (side == 0))


def test_the_separators_of_a_grid_separate():
    n, edges = 40 * 50, grid(40, 50)
    pointer, neighbours = adjacency(n, *edges)
    depth = engine.separator_depths(pointer, neighbours, n)
    assert np.sum(depth == 0) in (40, 50)  # one of the straight cuts
    rest = depth < 0
    first = np.repeat(np.arange(n), np.diff(pointer))
    inside = rest[first] & rest[neighbours]
    graph = sp.csr_matrix((np.ones(inside.sum()), (first[inside], neighbours[inside])), shape=(n, n))
    _, part = sp.csgraph.connected_components(graph)
    assert np.bincount(part[rest]).max() <= 400


def test_dissection_saves_flops_in_a_large_field():
    n, pattern = 200 * 200, upper(200 * 200, *grid(200, 200))
    order = engine.fill_reducing(*pattern, *LIMITS)
    assert np.array_equal(np.sort(order), np.arange(n))
    assert engine.flops_of(*pattern, order) < 0.75 * engine.flops_of(*pattern, engine.minimum_degree(*pattern, DENSE))


@pytest.mark.parametrize("shape", ["path", "hub", "clique", "pieces", "two nodes"])
def test_unusual_graphs_are_ordered(shape):
    n = {"clique": 450, "two nodes": 2}.get(shape, 6000)
    k = np.arange(n - 1)
    first, second = (np.zeros(n - 1, int), k + 1) if shape == "hub" else (k, k + 1)
    if shape == "clique":
        first, second = np.triu_indices(n, 1)
    if shape == "pieces":
        first, second = (np.concatenate([a + 1500 * piece for piece in range(4)]) for a in grid(30, 50))
    if shape == "hub":  # a grid whose nodes all see one landmark
        first, second = (
            np.r_[a + 1, b] for a, b in zip(grid(59, 100), (np.zeros(5900, int), np.arange(1, 5901)), strict=True)
        )
    pattern = upper(n, first, second)
    order = engine.fill_reducing(*pattern, 0, 0.0)
    assert np.array_equal(np.sort(order), np.arange(n))
    assert engine.flops_of(*pattern, order) <= engine.flops_of(*pattern, engine.minimum_degree(*pattern, DENSE))


def test_dissection_is_tried_only_where_it_may_pay():
    # a strip is cheap by minimum degree; the order is then that of minimum degree
    pattern = upper(8000, *grid(10, 800))
    assert np.array_equal(engine.fill_reducing(*pattern, *LIMITS), engine.minimum_degree(*pattern, DENSE))
