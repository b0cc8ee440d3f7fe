"""Every edge family against finite differences, and its fast summation against its edges one by one."""

import inspect
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from graphslam import MotionModel, SensorModel, textbook
from graphslam.edges import (
    AnchorEdges,
    CartesianObservationEdges,
    EdgeFamily,
    MarginalEdges,
    PolarObservationEdges,
    RelativePointEdges,
    RelativePoseEdges,
    VirtualMotionEdges,
    motion_edges,
)
from graphslam.edges.robust import Cauchy, GemanMcClure, Huber
from graphslam.linear.information import BlockSystem
from graphslam.se2 import wrap

seeds = st.integers(0, 2**32 - 1)
#: each example has four to nine random edges, and there are 32 families
MOST = settings.default.max_examples
frames = ["world", "body"]
SEEING = [f"{name}-{d}d" for name in ("virtual", "cartesian", "polar") for d in (3, 2)]
FAMILIES = ["anchor", "relative", "motion", *SEEING, *(f"{name}-offset" for name in SEEING), "point"]
motion, sensor = MotionModel(slip=0.05), SensorModel()
ahead = SensorModel(range_rate=0.05, range_std=0.2, offset=(0.7, -0.3))


def random_information(rng, count):
    factor = rng.normal(size=(count, 3, 3))
    return factor @ np.swapaxes(factor, 1, 2) + 0.1 * np.eye(3)


def virtual(rng, frame, d, num_nodes=6, sensor=sensor):
    """Three landmarks, seen from random nodes, also twice from one; angles anywhere, -pi included."""
    groups = [np.sort(rng.integers(0, num_nodes, size=k)) for k in (2, 3, 4)]
    starts = np.concatenate([[0], np.cumsum([len(g) for g in groups])])
    z = np.column_stack([rng.uniform(0.5, 5, starts[-1]), rng.uniform(-np.pi, np.pi, (starts[-1], 2))])
    z[rng.random(z.shape) < 0.2] = -np.pi
    z[:, 0] = np.abs(z[:, 0])
    trust, tempered = rng.uniform(0.5, 1, starts[-1]), bool(rng.integers(2))
    return VirtualMotionEdges(
        starts, np.concatenate(groups), z[:, :d], sensor, frame=frame, trust=trust, tempered=tempered
    )


def factor_of(edges, a, b, g):
    """The factor on the information of the pair of sightings a and b of landmark g."""
    K = edges.trust[edges.starts[g] : edges.starts[g + 1]].sum()
    return edges.trust[a] * edges.trust[b] * (2 / K if edges.tempered else 1.0)


def family(name, rng, frame):
    if name == "anchor":
        return AnchorEdges(np.array([0, 2, 2]), rng.normal(size=(3, 3)) * 4, random_information(rng, 3))
    if name == "relative":
        first = rng.integers(0, 6, 8)
        second = (first + rng.integers(1, 6, 8)) % 6
        return RelativePoseEdges(first, second, rng.normal(size=(8, 3)) * 3, random_information(rng, 8), frame=frame)
    if name == "motion":
        controls = np.column_stack([rng.normal(size=5), rng.choice([0.0, 1e-9, 0.3, -1.0], 5)])
        return motion_edges(np.arange(6), controls, rng.uniform(0.1, 2, 5), motion, frame=frame, scale=3.0)
    if name.startswith(("cartesian", "polar", "point")):
        # poses 0 to 3 see landmarks 4 and 5; or, for the kernels, the other way round
        poses, landmarks = rng.integers(0, 4, 8), rng.integers(4, 6, 8)
        if frame == "body":
            poses, landmarks = poses + 2, landmarks - 4
        if name == "point":
            return RelativePointEdges(
                poses, landmarks, rng.normal(size=(8, 2)) * 3, random_information(rng, 8)[:, :2, :2]
            )
        z = np.column_stack([rng.uniform(0.5, 5, 8), rng.uniform(-np.pi, np.pi, (8, 2))])
        seen = (poses, landmarks, z[:, : 3 if "3d" in name else 2], sensor_of(name))
        noise = {"trust": rng.uniform(0.5, 1, 8), "noise_at": seen[2] * rng.uniform(0.8, 1.2, (8, 1))}
        if name.startswith("polar"):
            return PolarObservationEdges(*seen, **noise)
        return CartesianObservationEdges(*seen, **noise, frame=frame)
    return virtual(rng, frame, 3 if "3d" in name else 2, sensor=sensor_of(name))


def sensor_of(name):
    return ahead if name.endswith("offset") else sensor


def random_state(rng):
    state = rng.normal(size=(6, 3)) * [3, 3, 4]
    state[rng.random(6) < 0.3, 2] = np.pi  # where angles wrap
    return state


@pytest.mark.slow
@pytest.mark.parametrize("frame", frames)
@pytest.mark.parametrize("name", FAMILIES)
@settings(max_examples=MOST // 3)
@given(seed=seeds)
def test_jacobians_against_finite_differences(name, frame, seed):
    rng = np.random.default_rng(seed)
    edges, state, reference = family(name, rng, frame), random_state(rng), random_state(rng)
    if name.startswith("polar"):
        # the bearing of a landmark next to the robot changes faster than a finite difference can follow
        assume(np.all(np.linalg.norm(state[edges.first, :2] - state[edges.second, :2], axis=1) > 0.1))
    at = edges.linearize(state, reference)
    step = 1e-6
    numeric = [np.full_like(jacobians, np.nan) for jacobians in at.jacobians]
    for node, component in product(range(len(state)), range(3)):
        moved = state.copy()
        moved[node, component] += step
        plus = edges.linearize(moved, reference).residuals
        moved[node, component] -= 2 * step
        difference = plus - edges.linearize(moved, reference).residuals
        angles = slice(1 if name.startswith("polar") else 2, None)
        difference[:, angles] = wrap(difference[:, angles])
        for end, nodes in enumerate(at.nodes):
            numeric[end][nodes == node, :, component] = difference[nodes == node] / (2 * step)
    for end, jacobians in enumerate(at.jacobians):
        np.testing.assert_allclose(jacobians, numeric[end], atol=1e-6, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("frame", frames)
@pytest.mark.parametrize("name", FAMILIES)
@settings(max_examples=MOST // 2)
@given(seed=seeds, kernel=st.sampled_from([None, Huber(), Cauchy(), GemanMcClure(2.0)]))
def test_the_fast_sums_are_the_sums_over_edges(name, frame, seed, kernel):
    rng = np.random.default_rng(seed)
    edges, state, reference = family(name, rng, frame), random_state(rng), random_state(rng)
    system = BlockSystem.from_cliques(6, [edges.cliques()])
    at = edges.linearize(state, reference)
    weight, loss = np.ones(edges.count), at.mahalanobis
    if kernel is not None and hasattr(edges, "kernel"):
        edges = replace(edges, kernel=kernel)
        # a kernel acts on a pair before it is tempered
        factor = edges.group_weights[edges.pairs()[2]] if name.startswith("virtual") else 1.0
        squares = at.mahalanobis / factor
        weight, loss = edges.kernel.weight(squares), factor * edges.kernel.loss(squares)
    cost = edges.accumulate(state, reference, system)
    omega, xi = np.zeros((18, 18)), np.zeros((6, 3))
    for k in range(edges.count):
        for i, b_i in zip(at.nodes, at.jacobians):
            xi[i[k]] -= weight[k] * b_i[k].T @ at.information[k] @ at.residuals[k]
            for j, b_j in zip(at.nodes, at.jacobians):
                rows, columns = slice(3 * i[k], 3 * i[k] + 3), slice(3 * j[k], 3 * j[k] + 3)
                omega[rows, columns] += weight[k] * b_i[k].T @ at.information[k] @ b_j[k]
    scale = np.abs(omega).max() + 1
    assert cost == pytest.approx(loss.sum(), rel=1e-10)
    assert edges.cost(state, reference) == pytest.approx(cost, rel=1e-10)
    np.testing.assert_allclose(system.to_sparse().toarray(), omega, atol=1e-11 * scale)
    np.testing.assert_allclose(system.xi, xi, atol=1e-10 * (np.abs(xi).max() + 1))


@given(seed=seeds)
def test_world_frame_edges_are_the_textbooks(seed):
    rng = np.random.default_rng(seed)
    state = random_state(rng)
    for d in (3, 2):
        edges = virtual(rng, "world", d)
        at = edges.linearize(state, state)
        a, b, group = edges.pairs()
        for k in range(edges.count):
            x1, x2 = state[edges.nodes[a[k]]], state[edges.nodes[b[k]]]
            e, omega, b1, b2 = textbook.virtual_motion_edge(
                x1, edges.sightings[a[k]], x2, edges.sightings[b[k]], sensor
            )
            difference = at.residuals[k] - e
            difference[2:] = wrap(difference[2:])
            np.testing.assert_allclose(difference, 0, atol=1e-12)
            factor = factor_of(edges, a[k], b[k], group[k])
            np.testing.assert_allclose(at.information[k], factor * omega, rtol=1e-8, atol=1e-8)
            np.testing.assert_allclose(at.jacobians[0][k], b1, atol=1e-12)
            np.testing.assert_allclose(at.jacobians[1][k], b2, atol=1e-12)
    u, dt = np.array([0.7, 0.4]), 1.5
    edges = motion_edges(np.arange(2), u[None], np.array([dt]), motion, frame="world")
    at = edges.linearize(state[:2], state[:2])
    e, omega, b1, b2 = textbook.motion_edge(state[0], state[1], u, dt, motion)
    np.testing.assert_allclose(wrap(at.residuals[0] - e), 0, atol=1e-11)
    np.testing.assert_allclose(at.information[0], omega, rtol=1e-7, atol=1e-6)
    np.testing.assert_allclose(at.jacobians[0][0], b1, atol=1e-11)
    np.testing.assert_allclose(at.jacobians[1][0], b2, atol=1e-12)


@given(seed=seeds)
def test_cartesian_sightings_are_the_lectures_inverse_observation(seed):
    """e = m - h^-1(x, z) with R Q R', in world axes at the reference; turned into the robot's axes the same numbers."""
    rng = np.random.default_rng(seed)
    state, reference = random_state(rng), random_state(rng)
    for name in ("cartesian-3d-offset", "cartesian-2d"):
        for frame, at in (("world", reference), ("body", state)):
            edges = family(name, rng, frame)
            d = edges.sightings.shape[1]
            x, m = state[edges.first], state[edges.second, :d]
            e = m - edges.sensor.h_inverse(x, edges.sightings)
            e[:, 2:] = wrap(e[:, 2:])
            # in the body frame the information turns with the pose itself
            covariance = edges.sensor.landmark_covariance(at[edges.first], edges.noisy)
            expected = edges.trust * np.einsum("ki,kij,kj->k", e, np.linalg.inv(covariance), e)
            np.testing.assert_allclose(edges.linearize(state, reference).mahalanobis, expected, rtol=1e-8)
            assert edges.state_dependent_information == (frame == "world")


@given(seed=seeds)
def test_both_forms_agree_near_the_sighting(seed):
    """To first order the Cartesian residual is L times the polar one: the costs differ by the third order of the noise."""
    rng = np.random.default_rng(seed)
    state = random_state(rng)
    for d in (3, 2):
        first, second = np.zeros(4, dtype=int), np.arange(1, 5)
        z = np.column_stack([rng.uniform(1, 5, 4), rng.uniform(-np.pi, np.pi, (4, 2))])[:, :d]
        state[1:5, :d] = ahead.h_inverse(state[0], z)
        state[1:5, :d] += 1e-5 * rng.normal(size=(4, d))
        cartesian, polar = (
            kind(first, second, z, ahead).linearize(state, state).mahalanobis
            for kind in (CartesianObservationEdges, PolarObservationEdges)
        )
        np.testing.assert_allclose(cartesian, polar, rtol=1e-3)


@given(seed=seeds)
def test_body_frame_is_the_designs_formula(seed):
    # DESIGN: residual turned into the first sighting's axes, Omega^-1 = L(l1, 0) Q1 L' + L(l2, psi2 - psi1) Q2 L'
    rng = np.random.default_rng(seed)
    edges, state = virtual(rng, "body", 3), random_state(rng)
    at = edges.linearize(state, random_state(rng))
    a, b, group = edges.pairs()

    def lever(length, angle):
        c, s = np.cos(angle), np.sin(angle)
        return np.array([[c, -length * s, 0], [s, length * c, 0], [0, 1, -1]])

    for k in range(edges.count):
        z1, z2, x1 = edges.sightings[a[k]], edges.sightings[b[k]], state[edges.nodes[a[k]]]
        e = sensor.h_inverse(state[edges.nodes[b[k]]], z2) - sensor.h_inverse(x1, z1)
        c, s = np.cos(x1[2] + z1[1]), np.sin(x1[2] + z1[1])
        e = np.array([c * e[0] + s * e[1], -s * e[0] + c * e[1], wrap(e[2])])
        l1, l2 = lever(z1[0], 0.0), lever(z2[0], z2[2] - z1[2])
        omega = np.linalg.inv(l1 @ sensor.Q(z1) @ l1.T + l2 @ sensor.Q(z2) @ l2.T)
        omega *= factor_of(edges, a[k], b[k], group[k])
        assert at.mahalanobis[k] == pytest.approx(e @ omega @ e, rel=1e-8, abs=1e-8)


@pytest.mark.parametrize(
    "family",
    [
        AnchorEdges,
        CartesianObservationEdges,
        PolarObservationEdges,
        RelativePointEdges,
        RelativePoseEdges,
        MarginalEdges,
    ],
)
def test_every_public_method_has_a_docstring_perhaps_inherited(family):
    public = [name for name in vars(EdgeFamily) if not name.startswith("_")]
    assert all(inspect.getdoc(getattr(family, name)) for name in public)


def test_count_leaves_out_pairs_within_one_node():
    starts, nodes = np.array([0, 4, 6]), np.array([0, 0, 1, 2, 3, 3])
    z = np.tile([1.0, 0.0, 0.0], (6, 1))
    edges = VirtualMotionEdges(starts, nodes, z, sensor)
    assert edges.count == 5
    assert len(edges.pairs()[0]) == 5
    # each pair measures three numbers, so that this is the mean cost at the true state
    assert edges.numbers[1] == pytest.approx(3 * 5)
    assert replace(edges, tempered=True).numbers[1] == pytest.approx(3 * 5 * 2 / 4)
