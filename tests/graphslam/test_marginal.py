"""Marginal edges: a landmark eliminated is a landmark node, eliminated."""

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graphslam import Graph, SensorModel, simulate, solve
from graphslam.edges import MarginalEdges, PolarObservationEdges, VirtualMotionEdges
from graphslam.edges.robust import Cauchy, GemanMcClure, Huber
from graphslam.factors import LandmarkFactor
from graphslam.linear.information import BlockSystem
from graphslam.se2 import wrap

sensor = SensorModel(range_std=0.1, offset=(0.3, 0.1))
#: a tenth of the book's noise
FINE = SensorModel(range_rate=0.014, bearing_std=0.005, orientation_std=0.005)
seeds = st.integers(0, 2**32 - 1)
kernels = st.sampled_from([None, Huber(), Cauchy(), GemanMcClure(3.0)])


def random_edges(rng, frame, d, kernel=None, trust=True, noise=0.3):
    """Landmarks seen from six poses with noise, one of them twice from the same pose, and the poses."""
    poses = np.column_stack([rng.normal(size=(6, 2)) * 2, rng.uniform(-np.pi, np.pi, 6)])
    groups = [np.array([0, 1, 1, 3]), np.arange(6), np.array([2, 5])]
    starts, nodes = np.array([0, 4, 10, 12]), np.concatenate(groups)
    marks = np.column_stack([rng.normal(size=(3, 2)) * 4 + 6, rng.uniform(-np.pi, np.pi, 3)])
    z = sensor.h(poses[nodes], np.repeat(marks, [4, 6, 2], axis=0)) + noise * sensor.bearing_std * rng.normal(
        size=(12, 3)
    )
    weights = rng.uniform(0.3, 1, 12) if trust else None
    return MarginalEdges(starts, nodes, z[:, :d], sensor, frame=frame, kernel=kernel, trust=weights), poses


def with_landmark_nodes(edges, state, reference, means):
    """Omega, xi over poses and landmarks of the residuals e = m - h^-1(x, z), edge by edge, in world axes."""
    d = edges.sightings.shape[1]
    y, lever = edges.placed(state)
    at = state if edges.frame == "body" else reference
    W = np.linalg.inv(sensor.landmark_covariance(at[edges.nodes], edges.sightings))
    size = 18 + 3 * d
    omega, xi, cost, squares = np.zeros((size, size)), np.zeros(size), 0.0, np.empty(len(edges.nodes))
    for k, node in enumerate(edges.nodes):
        e = means[edges.group[k]][:d] - y[k, :d]
        e[2:] = wrap(e[2:])
        by_pose = -np.eye(3)[:d]
        by_pose[:2, 2] = -lever[k]
        if edges.frame == "body":
            by_pose[:2, 2] += [e[1], -e[0]]
        B = np.zeros((d, size))
        B[:, 3 * node : 3 * node + 3] = by_pose
        at_landmark = 18 + d * edges.group[k]
        B[:, at_landmark : at_landmark + d] = np.eye(d)
        squares[k] = e @ W[k] @ e * edges.trusted[k]
        w = edges.trusted[k] * (1.0 if edges.kernel is None else edges.kernel.weight(squares[k]))
        omega += w * B.T @ W[k] @ B
        xi -= w * B.T @ W[k] @ e
    cost = squares.sum() if edges.kernel is None else edges.kernel.loss(squares).sum()
    return omega, xi, cost


@pytest.mark.slow
@pytest.mark.parametrize("frame", ["world", "body"])
@pytest.mark.parametrize("d", [3, 2])
@given(seed=seeds, kernel=kernels)
def test_omega_and_xi_are_those_of_landmark_nodes_eliminated(frame, d, seed, kernel):
    rng = np.random.default_rng(seed)
    edges, poses = random_edges(rng, frame, d, kernel)
    state = poses + rng.normal(scale=0.05, size=poses.shape)
    reference = state + rng.normal(scale=0.05, size=poses.shape)
    system = BlockSystem.from_cliques(6, [edges.cliques()])
    cost = edges.accumulate(state, reference, system)
    omega, xi, expected = with_landmark_nodes(edges, state, reference, edges.landmarks(state, reference))
    inverse = np.linalg.inv(omega[18:, 18:])
    eliminated = omega[:18, :18] - omega[:18, 18:] @ inverse @ omega[18:, :18]
    assert cost == pytest.approx(expected, rel=1e-9)
    assert edges.cost(state, reference) == pytest.approx(cost, rel=1e-12)
    scale = np.abs(omega[:18, :18]).max()
    np.testing.assert_allclose(system.to_sparse().toarray(), eliminated, atol=1e-9 * scale)
    xi_eliminated = xi[:18] - omega[:18, 18:] @ inverse @ xi[18:]
    np.testing.assert_allclose(system.xi.ravel(), xi_eliminated, atol=1e-9 * (np.abs(xi).max() + scale * 1e-3))
    # the landmarks are where the cost is least: their part of xi is nothing
    np.testing.assert_allclose(xi[18:], 0, atol=1e-8 * scale)


@pytest.mark.parametrize("frame", ["world", "body"])
@pytest.mark.parametrize("d", [3, 2])
@given(seed=seeds, kernel=kernels)
def test_xi_is_minus_half_the_gradient(frame, d, seed, kernel):
    rng = np.random.default_rng(seed)
    edges, poses = random_edges(rng, frame, d, kernel)
    state = poses + rng.normal(scale=0.05, size=poses.shape)
    system = BlockSystem.from_cliques(6, [edges.cliques()])
    edges.accumulate(state, state, system)
    step, scale = 1e-6, np.abs(system.values).max()
    for node, component in rng.integers(0, [6, 3], size=(4, 2)):
        moved = np.zeros_like(state)
        moved[node, component] = step
        slope = (edges.cost(state + moved, state) - edges.cost(state - moved, state)) / (2 * step)
        assert system.xi[node, component] == pytest.approx(-slope / 2, abs=1e-6 * scale)


@given(seed=seeds)
def test_without_noise_it_is_the_landmark_nodes_of_the_sensor(seed):
    """Residual m - h^-1(x, z) and residual h(x, m) - z have the same Omega where both are zero."""
    rng = np.random.default_rng(seed)
    for d in (3, 2):
        edges, poses = random_edges(rng, "body", d, trust=False, noise=0.0)
        system = BlockSystem.from_cliques(6, [edges.cliques()])
        edges.accumulate(poses, poses, system)
        nodes = PolarObservationEdges(edges.nodes, 6 + edges.group, edges.sightings, sensor)
        state = np.concatenate([poses, edges.landmarks(poses, poses)])
        whole = BlockSystem.from_cliques(9, [nodes.cliques()])
        nodes.accumulate(state, state, whole)
        omega = whole.to_sparse().toarray()
        if d == 2:
            omega[20::3, 20::3] = np.eye(3)
        eliminated = omega[:18, :18] - omega[:18, 18:] @ np.linalg.solve(omega[18:, 18:], omega[18:, :18])
        scale = np.abs(omega[:18, :18]).max()
        np.testing.assert_allclose(system.to_sparse().toarray(), eliminated, atol=1e-9 * scale)


def test_tempered_equals_marginal_where_all_sightings_are_alike():
    """Four poses around a landmark that is seen alike from each: the two weights have the same Omega."""
    heading = np.arange(4) * np.pi / 2
    poses = np.column_stack([-2 * np.cos(heading), -2 * np.sin(heading), heading])
    starts, nodes = np.array([0, 4]), np.arange(4)
    # a sensor whose noise is the same in all directions: l sigma_l = l sigma_phi
    isotropic = SensorModel(range_rate=0.05, bearing_std=0.05, orientation_std=0.05)
    z = np.column_stack([np.full(4, 2.0), np.zeros(4)])
    dense = []
    for edges in (
        VirtualMotionEdges(starts, nodes, z, isotropic, frame="world", tempered=True),
        MarginalEdges(starts, nodes, z, isotropic, frame="world"),
    ):
        system = BlockSystem.from_cliques(4, [edges.cliques()])
        edges.accumulate(poses, poses, system)
        dense.append(system.to_sparse().toarray())
    np.testing.assert_allclose(dense[0], dense[1], atol=1e-9 * np.abs(dense[1]).max())


@pytest.mark.parametrize("dimensions", [3, 2])
def test_marginal_and_landmark_nodes_agree_up_to_curvature(dimensions):
    log = simulate(seed=4, clean=True, sensor=FINE)
    marginal = solve(
        Graph.from_log(
            log, weight="marginal", sensor=FINE, dimensions=dimensions, edges="virtual+motion", kernel="none"
        ),
        initialize="auto",
    )
    nodes = solve(
        Graph.from_log(log, edges="landmark+motion", sensor=FINE, dimensions=dimensions, kernel="none"),
        initialize="auto",
    )
    assert marginal.converged and nodes.converged
    std = np.sqrt(np.diagonal(nodes.covariance()[1:], axis1=1, axis2=2))
    off = marginal.poses[1:] - nodes.poses[1:]
    off[:, 2] = wrap(off[:, 2])
    assert np.max(np.abs(off) / std) < 0.25
    ratio = np.sqrt(np.diagonal(marginal.covariance()[1:], axis1=1, axis2=2)) / std
    assert np.all(np.abs(ratio - 1) < 0.1)


def test_pairs_are_too_sure_by_about_half_the_sightings():
    log = simulate(seed=4)
    pairs, marginal = (
        solve(Graph.from_log(log, weight=weight, edges="virtual+motion", kernel="none"))
        for weight in ("pairs", "marginal")
    )
    _, count = np.unique(log.landmarks, return_counts=True)
    ratio = np.trace(marginal.covariance()[-1]) / np.trace(pairs.covariance()[-1])
    assert ratio > 0.2 * count.mean() / 2


def test_a_landmark_seen_once_costs_nothing():
    one = MarginalEdges(np.array([0, 1]), np.array([0]), np.array([[2.0, 0.1, 0.2]]), sensor)
    system = BlockSystem.from_cliques(1, [one.cliques()])
    assert one.accumulate(np.zeros((1, 3)), np.zeros((1, 3)), system) == 0.0
    np.testing.assert_allclose(system.values, 0, atol=1e-10)


def test_the_books_log_without_and_with_trust(book_log):
    graph = Graph.from_log(book_log, weight="marginal", edges="virtual+motion", kernel="none")
    family = next(f for f in graph.families if isinstance(f, MarginalEdges))
    untouched = family.with_trust(np.ones(family.count))
    state = graph.initial
    assert untouched.cost(state, state) == family.cost(state, state)
    doubted = family.with_trust(np.zeros(family.count))
    assert doubted.cost(state, state) == pytest.approx(1e-9 * family.cost(state, state))


@pytest.mark.parametrize("turned", [np.pi, 2.9, 2.0])
def test_the_landmark_does_not_depend_on_which_sighting_comes_first(turned):
    """A heading that wraps: the cost is that of m̂, and the same in every order of the sightings."""
    rng = np.random.default_rng(5)
    K, costs = 6, []
    state = np.column_stack([rng.normal(size=(K, 2)), rng.uniform(-np.pi, np.pi, K)])
    landmark = np.array([3.0, 1.0, 0.4])
    sensor = SensorModel()
    z = sensor.h(state, np.broadcast_to(landmark, (K, 3))) + rng.normal(size=(K, 3)) * [0.1, 0.05, 0.05]
    z[2, 2] += turned
    gradients = []
    for order in [np.roll(np.arange(K), k) for k in range(K)]:
        edges = MarginalEdges(np.array([0, K]), order, z[order], sensor)
        costs.append(edges.cost(state, state))
        e = edges.linearize(state, state)
        assert np.abs(e.residuals[:, 2]).max() <= np.pi
        step, moved = 1e-6, np.zeros(K)
        for k in range(K):
            turn = np.zeros((K, 3))
            turn[k, 2] = step
            moved[k] = (edges.cost(state + turn, state) - edges.cost(state - turn, state)) / (2 * step)
        gradients.append(moved)
    np.testing.assert_allclose(costs, costs[0], rtol=1e-12)
    np.testing.assert_allclose(gradients, [gradients[0]] * K, rtol=1e-5, atol=1e-4)
    factor = LandmarkFactor([gtsam.symbol("x", k) for k in range(K)], z, sensor, weight="marginal")
    values = gtsam.Values()
    for k in range(K):
        values.insert(gtsam.symbol("x", k), gtsam.Pose2(*state[k]))
    assert 2 * factor.error(values) == pytest.approx(costs[0], rel=1e-12)
    linear = factor.linearize(values)
    A, b = linear.jacobian()
    # turning a pose is the third of its own coordinates
    np.testing.assert_allclose((-2 * A.T @ b)[2::3], gradients[0], rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("d", [3, 2])
@pytest.mark.parametrize("kernel", [Huber(), Cauchy(), GemanMcClure()], ids=lambda kernel: kernel.name)
def test_the_robust_mean_is_found_to_rounding(kernel, d):
    """300 landmarks, three of ten sightings wrong: another re-weighting moves none of them."""
    rng = np.random.default_rng(0)
    count, seen, sensor = 300, 12, SensorModel()
    poses = np.column_stack([rng.normal(size=(seen, 2)) * 3, rng.uniform(-np.pi, np.pi, seen)])
    marks = np.column_stack([rng.normal(size=(count, 2)) * 5 + 4, rng.uniform(-np.pi, np.pi, count)])
    nodes, starts = np.tile(np.arange(seen), count), np.arange(0, count * seen + 1, seen)
    z = sensor.h(poses[nodes], np.repeat(marks, seen, axis=0)) + rng.normal(scale=0.05, size=(len(nodes), 3))
    z[:, 0] *= 1 + rng.normal(scale=0.14, size=len(nodes))
    wrong = np.flatnonzero(rng.random(len(nodes)) < 0.3)
    # psi stays: a heading that wraps makes the cost jump, see `_search`
    z[wrong, :2] = np.column_stack([rng.uniform(1, 10, len(wrong)), rng.uniform(-np.pi, np.pi, len(wrong))])
    z[wrong, 2] = (poses[nodes, 2] + z[:, 1] - np.repeat(marks[:, 2], seen))[wrong] + rng.uniform(-1, 1, len(wrong))
    z = np.column_stack([np.abs(z[:, 0]) + 0.1, z[:, 1:d]])
    edges = MarginalEdges(starts, nodes, z, sensor, kernel=kernel)
    y, W = sensor.h_inverse(poses[nodes], z), np.linalg.inv(sensor.landmark_covariance(poses[nodes], z))
    e = np.repeat(edges.landmarks(poses, poses)[:, :d], seen, axis=0) - y
    e[:, 2:] = wrap(e[:, 2:])
    weighted = W * edges.kernel.weight(np.einsum("ki,kij,kj->k", e, W, e))[:, None, None]
    pull = np.add.reduceat(np.einsum("kij,kj->ki", weighted, e), starts[:-1], axis=0)
    step = np.linalg.solve(np.add.reduceat(weighted, starts[:-1], axis=0), pull[:, :, None])
    np.testing.assert_allclose(step, 0, atol=1e-12)
