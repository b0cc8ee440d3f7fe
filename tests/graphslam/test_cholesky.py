"""Tests of the sparse block Cholesky factorisation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graphslam.engine import engine
from graphslam.linear import cholesky
from graphslam.linear.cholesky import SingularPivot, analyze


def block_csc(n, edges, rng, *, anchor=True, full_diagonal=False):
    """Random positive definite matrix of a graph: sum of J' J over edges, plus the anchor on every diagonal."""
    blocks = {(i, i): np.zeros((3, 3)) for i in range(n)}
    for i, j in edges:
        i, j = min(i, j), max(i, j)
        a, b = rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
        blocks[i, i] = blocks[i, i] + a.T @ a
        blocks[j, j] = blocks[j, j] + b.T @ b
        blocks[i, j] = blocks.get((i, j), 0) + a.T @ b
    if anchor:
        for i in range(n):
            blocks[i, i] = blocks[i, i] + 0.5 * np.eye(3)
    keys = sorted(blocks, key=lambda k: (k[1], k[0]))
    indptr = np.zeros(n + 1, np.int64)
    for _, j in keys:
        indptr[j + 1] += 1
    values = np.array([blocks[k] for k in keys])
    return np.cumsum(indptr), np.array([k[0] for k in keys], np.int64), values


def to_dense(indptr, indices, values):
    n = indptr.size - 1
    a = np.zeros((3 * n, 3 * n))
    for j in range(n):
        for p in range(indptr[j], indptr[j + 1]):
            i = indices[p]
            a[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = values[p]
            a[3 * j : 3 * j + 3, 3 * i : 3 * i + 3] = values[p].T
    return a


def blocks_of(a):
    n = a.shape[0] // 3
    return np.array([a[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] for i in range(n)])


def pose_graph(n, edges, anchored):
    """Omega of a real planar pose graph, the first pose of ``anchored`` pieces held."""
    blocks = {(i, i): np.zeros((3, 3)) for i in range(n)}
    rng = np.random.default_rng(n)
    weight = np.diag([50.0, 50.0, 100.0])
    for i, j in edges:
        x, y, t = rng.normal(size=3)
        c, s = np.cos(t), np.sin(t)
        a = np.array([[-c, -s, y], [s, -c, -x], [0, 0, -1]])
        blocks[i, i] = blocks[i, i] + a.T @ weight @ a
        blocks[j, j] = blocks[j, j] + weight
        blocks[i, j] = a.T @ weight
    for i in anchored:
        blocks[i, i] = blocks[i, i] + 1e3 * np.eye(3)
    keys = sorted(blocks, key=lambda k: (k[1], k[0]))
    indptr = np.zeros(n + 1, np.int64)
    for _, j in keys:
        indptr[j + 1] += 1
    return np.cumsum(indptr), np.array([k[0] for k in keys]), np.array([blocks[k] for k in keys])


@st.composite
def graphs(draw, most=40):
    n = draw(st.integers(1, most))
    seed = draw(st.integers(0, 2**31))
    rng = np.random.default_rng(seed)
    m = draw(st.integers(0, 4 * n))
    pairs = {(min(i, j), max(i, j)) for i, j in rng.integers(0, n, (m, 2)) if i != j}
    if draw(st.booleans()):
        pairs |= {(i, i + 1) for i in range(n - 1)}
    return block_csc(n, sorted(pairs), rng)


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(graphs(), st.sampled_from(["amd", "natural", "random"]), st.sampled_from([0, 1, 2, 3, 7, 8, 9, 17]))
def test_against_dense(graph, ordering, k):
    indptr, indices, values = graph
    n = indptr.size - 1
    a = to_dense(*graph)
    rng = np.random.default_rng(n)
    order = {"amd": None, "natural": np.arange(n), "random": rng.permutation(n)}[ordering]
    symbolic = analyze(indptr, indices, ordering=order)
    assert sorted(symbolic.order) == list(range(n))
    factor = symbolic.factorize(values)
    rhs = rng.normal(size=(n, 3, k))
    x = factor.solve(rhs)
    expected = np.linalg.solve(a, rhs.reshape(3 * n, k)).reshape(n, 3, k)
    assert x.shape == rhs.shape
    assert np.abs(x - expected).max(initial=0.0) <= 1e-9 * np.abs(expected).max(initial=1.0)
    column = rng.normal(size=(n, 3, 2))[:, :, 0]
    assert np.array_equal(factor.solve(column), factor.solve(np.ascontiguousarray(column)))
    inverse = np.linalg.inv(a)
    scale = np.abs(inverse).max()
    before = factor.covariance(0, n - 1)
    assert np.abs(factor.diagonal_covariances() - blocks_of(inverse)).max() <= 1e-9 * scale
    for _ in range(10):
        i, j = rng.integers(0, n, 2)
        exact = inverse[3 * i : 3 * i + 3, 3 * j : 3 * j + 3]
        assert np.abs(factor.covariance(i, j) - exact).max() <= 1e-9 * scale
    assert np.allclose(before, factor.covariance(0, n - 1), rtol=0, atol=1e-9 * scale)


@settings(max_examples=30, deadline=None)
@given(graphs(), st.floats(0, 10))
def test_damping(graph, damping):
    indptr, indices, values = graph
    n = indptr.size - 1
    a = to_dense(*graph)
    a += damping * np.diag(np.diag(a))
    copy = values.copy()
    factor = analyze(indptr, indices).factorize(values, damping=damping)
    assert np.array_equal(copy, values)
    rhs = np.random.default_rng(0).normal(size=(n, 3))
    x = factor.solve(rhs)
    assert np.abs(a @ x.reshape(-1) - rhs.reshape(-1)).max() < 1e-9


@settings(max_examples=60, deadline=None)
@given(graphs(most=80))
def test_amd_is_a_permutation_with_the_dense_rule_on_and_off(graph):
    indptr, indices, _ = graph
    n = indptr.size - 1
    for dense in (10.0, 0.0, -1.0):
        assert sorted(engine.minimum_degree(indptr, indices, dense)) == list(range(n))


@pytest.mark.parametrize("seed", range(3))
def test_permuting_the_nodes_permutes_the_solution(seed):
    rng = np.random.default_rng(seed)
    n = 120
    edges = sorted({(min(i, j), max(i, j)) for i, j in rng.integers(0, n, (300, 2)) if i != j})
    indptr, indices, values = block_csc(n, edges, rng)
    a = to_dense(indptr, indices, values)
    p = rng.permutation(n)  # new node k is old node p[k]
    scalar = (3 * p[:, None] + np.arange(3)).reshape(-1)
    b = a[np.ix_(scalar, scalar)]
    where = np.argsort(p)
    keys = sorted(
        {(min(where[i], where[j]), max(where[i], where[j])) for i, j in edges} | {(i, i) for i in range(n)},
        key=lambda k: (k[1], k[0]),
    )
    permuted = np.array([b[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] for i, j in keys])
    pointer = np.r_[0, np.cumsum(np.bincount([j for _, j in keys], minlength=n))]
    rhs = rng.normal(size=(n, 3))
    x = analyze(indptr, indices).factorize(values).solve(rhs)
    y = analyze(pointer, np.array([i for i, _ in keys])).factorize(permuted).solve(rhs[p])
    assert np.abs(x[p] - y).max() < 1e-9
    z = analyze(indptr, indices, ordering=p).factorize(values).diagonal_covariances()
    assert np.abs(z - analyze(indptr, indices).factorize(values).diagonal_covariances()).max() < 1e-9


def test_refactorize_reuses_the_memory():
    rng = np.random.default_rng(1)
    edges = [(i, i + 1) for i in range(99)] + [(i, i + 20) for i in range(0, 80, 3)]
    indptr, indices, values = block_csc(100, edges, rng)
    symbolic = analyze(indptr, indices)
    factor = symbolic.factorize(values)
    first = factor.diagonal_covariances()
    assert factor.refactorize(4 * values) is factor
    assert np.allclose(factor.diagonal_covariances(), first / 4, rtol=1e-12)
    rhs = rng.normal(size=(100, 3))
    assert np.allclose(factor.solve(rhs), symbolic.factorize(values).solve(rhs) / 4, rtol=1e-9)


def test_only_the_upper_triangle_of_diagonal_blocks_is_read():
    rng = np.random.default_rng(2)
    indptr, indices, values = block_csc(20, [(i, i + 1) for i in range(19)], rng)
    a = to_dense(indptr, indices, values)
    values = values.copy()
    for j in range(20):
        values[indptr[j + 1] - 1][np.tril_indices(3, -1)] = np.nan
    rhs = rng.normal(size=(20, 3))
    x = analyze(indptr, indices).factorize(values).solve(rhs)
    assert np.abs(a @ x.reshape(-1) - rhs.reshape(-1)).max() < 1e-9


@pytest.mark.parametrize("ordering", ["amd", "natural", "random"])
def test_floating_piece(ordering):
    n = 60  # nodes 40 to 59 are tied to nothing that is held
    edges = [(i, i + 1) for i in range(39)] + [(0, 20), (5, 33)] + [(i, i + 1) for i in range(40, 59)] + [(41, 55)]
    indptr, indices, values = pose_graph(n, edges, [0])
    order = {"amd": None, "natural": np.arange(n), "random": np.random.default_rng(0).permutation(n)}[ordering]
    with pytest.raises(SingularPivot) as caught:
        analyze(indptr, indices, ordering=order).factorize(values)
    error = caught.value
    assert isinstance(error, ValueError)
    assert 40 <= error.node < 60 and error.component in (0, 1, 2)
    vector = error.null_vector
    assert vector.shape == (n, 3)
    assert np.abs(vector).max() == 1.0
    assert vector[error.node, error.component] != 0.0
    assert np.abs(vector[:40]).max() == 0.0
    assert np.abs(vector[40:]).max(axis=1).min() > 1e-3  # the whole piece moves
    a = to_dense(indptr, indices, values)
    assert np.abs(a @ vector.reshape(-1)).max() < 1e-9 * np.abs(a).max()
    factor = analyze(indptr, indices).factorize(values, damping=1e-3)
    assert np.isfinite(factor.solve(np.ones((n, 3)))).all()


def test_unconstrained_heading():
    rng = np.random.default_rng(3)
    n = 30
    indptr, indices, values = block_csc(n, [(i, i + 1) for i in range(n - 1)], rng)
    values = values.copy()
    node = 17
    for j in range(n):
        for p in range(indptr[j], indptr[j + 1]):
            if j == node:
                values[p][:, 2] = 0.0
            if indices[p] == node:
                values[p][2, :] = 0.0
    with pytest.raises(SingularPivot) as caught:
        analyze(indptr, indices).factorize(values)
    assert (caught.value.node, caught.value.component) == (node, 2)
    expected = np.zeros((n, 3))
    expected[node, 2] = 1.0
    assert np.abs(caught.value.null_vector - expected).max() < 1e-12


def test_negative_pivot_and_failed_factor():
    indptr, indices = np.array([0, 1, 3]), np.array([0, 0, 1])
    values = np.array([np.eye(3), 2 * np.eye(3), np.eye(3)])
    symbolic = analyze(indptr, indices)
    factor = symbolic.factorize(values * np.array([1, 0, 1])[:, None, None])
    with pytest.raises(SingularPivot):
        factor.refactorize(values)
    with pytest.raises(ValueError, match="no valid factorisation"):
        factor.solve(np.ones((2, 3)))
    assert np.allclose(factor.refactorize(values, damping=3.0).solve(np.ones((2, 3))), 1 / 6)


@pytest.mark.parametrize("scale", [1e-12, 1e12])
def test_the_pivot_rule_is_scale_aware(scale):
    edges = [(i, i + 1) for i in range(29)]
    indptr, indices, values = pose_graph(30, edges, [0])
    analyze(indptr, indices).factorize(scale * values)
    indptr, indices, values = pose_graph(30, edges, [])
    with pytest.raises(SingularPivot):
        analyze(indptr, indices).factorize(scale * values)


def check_residual(indptr, indices, values, **options):
    n = indptr.size - 1
    rhs = np.random.default_rng(0).normal(size=(n, 3))
    factor = analyze(indptr, indices, **options).factorize(values)
    x = factor.solve(rhs)
    column = np.repeat(np.arange(n), np.diff(indptr))
    out = np.zeros((n, 3))
    np.add.at(out, indices, np.einsum("pij,pj->pi", values, x[column]))
    off = indices != column
    np.add.at(out, column[off], np.einsum("pji,pj->pi", values[off], x[indices[off]]))
    assert np.linalg.norm(out - rhs) < 1e-10 * np.linalg.norm(rhs)
    return factor


def shape(n, low, high):
    """Upper CSC of given edges with blocks that make it diagonally dominant."""
    i, j = np.minimum(low, high), np.maximum(low, high)
    rows, columns = np.r_[i, np.arange(n)], np.r_[j, np.arange(n)]
    order = np.lexsort((rows, columns))
    values = np.tile(0.3 * np.eye(3) + 0.1, (i.size + n, 1, 1))
    degree = np.bincount(np.r_[i, j], minlength=n)
    values[i.size :] = np.eye(3) * (1.0 + 0.7 * degree)[:, None, None]
    indptr = np.r_[0, np.cumsum(np.bincount(columns, minlength=n))]
    return indptr, rows[order], values[order]


def test_path_of_100000():
    k = np.arange(99_999)
    for ordering in (None, np.arange(100_000)):
        factor = check_residual(*shape(100_000, k, k + 1), ordering=ordering)
    assert factor.symbolic.blocks == 199_999
    assert np.isfinite(factor.diagonal_covariances()).all()


@pytest.mark.parametrize("chained", [False, True])
def test_hub_of_100000(chained):
    k = np.arange(1, 100_000)
    low, high = np.zeros(99_999, int), k
    if chained:
        low, high = np.r_[low, k[:-1]], np.r_[high, k[1:]]
    factor = check_residual(*shape(100_000, low, high))
    assert factor.symbolic.blocks <= 400_000
    assert factor.symbolic.structure.numbers < 10_000_000
    assert np.isfinite(factor.diagonal_covariances()).all()


def test_clique():
    low, high = np.triu_indices(700, 1)
    check_residual(*shape(700, low, high))


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 8, 16, 17, 33, 64, 65, 80])
def test_clique_of_every_panel_shape(n):
    rng = np.random.default_rng(n)
    indptr, indices, values = block_csc(n + 3, list(zip(*np.triu_indices(n, 1), strict=True)) + [(0, n)], rng)
    a = to_dense(indptr, indices, values)
    factor = check_residual(indptr, indices, values)
    inverse = np.linalg.inv(a)
    assert np.abs(factor.diagonal_covariances() - blocks_of(inverse)).max() < 1e-9 * np.abs(inverse).max()


def test_clique_with_tails_in_wide_supernodes():
    rng = np.random.default_rng(5)
    low, high = np.triu_indices(150, 1)
    tail = np.arange(150, 400)
    low, high = np.r_[low, tail, rng.integers(0, 150, 250)], np.r_[high, (tail + 1) % 400, tail]
    keep = low != high
    indptr, indices, values = block_csc(400, sorted(set(zip(low[keep], high[keep], strict=True))), rng)
    for ordering in (None, np.arange(400)):
        factor = check_residual(indptr, indices, values, ordering=ordering)
        inverse = np.linalg.inv(to_dense(indptr, indices, values))
        assert np.abs(factor.diagonal_covariances() - blocks_of(inverse)).max() < 1e-9 * np.abs(inverse).max()


def test_isolated_nodes_and_a_single_node():
    n = 7
    indptr, indices, values = np.arange(n + 1), np.arange(n), np.tile(np.diag([1.0, 2.0, 4.0]), (n, 1, 1))
    for m in (n, 1):
        factor = analyze(indptr[: m + 1], indices[:m]).factorize(values[:m])
        assert np.allclose(factor.solve(np.ones((m, 3))), [1, 0.5, 0.25])
        assert np.allclose(factor.diagonal_covariances(), np.diag([1, 0.5, 0.25]))
        assert np.allclose(factor.covariance(0, m - 1), np.diag([1, 0.5, 0.25]) if m == 1 else 0)


def test_clear_errors():
    rng = np.random.default_rng(0)
    indptr, indices, values = block_csc(5, [(0, 1), (1, 3), (3, 4)], rng)
    with pytest.raises(ValueError, match="at least the diagonal"):
        analyze(np.array([0, 1, 3, 3, 5]), np.array([0, 0, 1, 1, 3]))
    with pytest.raises(ValueError, match="column"):
        analyze(np.array([0, 1, 3]), np.array([0, 1, 0]))
    with pytest.raises(ValueError, match="at least one node"):
        analyze(np.array([0, 1, 9]), np.array([0, 0, 1]))
    with pytest.raises(ValueError, match="at least one node"):
        analyze(np.array([0]), np.array([], dtype=int))
    with pytest.raises(ValueError, match="permutation"):
        analyze(indptr, indices, ordering=np.array([0, 1, 2, 3, 3]))
    symbolic = analyze(indptr, indices)
    with pytest.raises(ValueError, match="shape"):
        symbolic.factorize(values[:-1])
    with pytest.raises(ValueError, match="damping"):
        symbolic.factorize(values, damping=-1.0)
    with pytest.raises(ValueError, match="damping"):
        symbolic.factorize(values, damping=float("nan"))
    factor = symbolic.factorize(values)
    with pytest.raises(ValueError, match="rhs must have shape"):
        factor.solve(np.ones(15))
    with pytest.raises(ValueError, match="NaN or infinity"):
        factor.solve(np.full((5, 3), np.inf))
    with pytest.raises(IndexError):
        factor.covariance(0, 5)
    for node in (-1, 5, 2**33):
        with pytest.raises(IndexError, match=f"no node {node}: the graph has 5"):
            factor.joint_covariance(np.array([2, node]))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite(bad):
    rng = np.random.default_rng(0)
    indptr, indices, values = block_csc(5, [(0, 1), (1, 3), (3, 4)], rng)
    for p in range(values.shape[0]):
        for c in range(3):
            broken = values.copy()
            broken[p, 0, c] = bad
            with pytest.raises(ValueError, match=rf"block \({indices[p]}, ") as caught:
                analyze(indptr, indices).factorize(broken)
            assert not isinstance(caught.value, SingularPivot)


@pytest.mark.parametrize("threads", [2, 3, 200])
def test_threads_change_no_bit(threads, monkeypatch):
    k = np.arange(70 * 70).reshape(70, 70)
    low = np.concatenate([k[1:].ravel(), k[:, 1:].ravel(), k[1:, 1:].ravel()])
    high = np.concatenate([k[:-1].ravel(), k[:, :-1].ravel(), k[:-1, :-1].ravel()])
    indptr, indices, values = shape(k.size, low, high)
    rhs, bad = np.random.default_rng(0).normal(size=(k.size, 3)), values.copy()
    bad[indptr[1:][[99, 4000]] - 1] = 0.0
    results = []
    for count in (1, threads):
        monkeypatch.setattr(cholesky, "available_threads", lambda count=count: count)
        symbolic = analyze(indptr, indices)
        factor = symbolic.factorize(values)
        assert symbolic.structure.parts == (1 if count == 1 else count + 1)
        results.append([factor.solve(rhs), factor.diagonal_covariances(), factor.covariance(3, 4001)])
        with pytest.raises(SingularPivot) as caught:
            symbolic.factorize(bad)
        results[-1].append(np.array([caught.value.node, caught.value.component]))
    assert all(np.array_equal(one, several) for one, several in zip(*results, strict=True))
