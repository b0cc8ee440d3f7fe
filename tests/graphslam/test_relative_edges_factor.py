"""Many relative poses and points in one factor: the same numbers as one factor for each edge."""

import gtsam
import numpy as np
import pytest

from graphslam import Graph, OptionError, SensorModel, simulate, solve, solve_with_gtsam
from graphslam.edges.robust import Cauchy, Huber
from graphslam.factors import RelativeEdgesFactor, RelativePointFactor, RelativePoseFactor, describe
from graphslam.solvers.gtsam_solver import to_gtsam, to_values

#: poses 0 to 3 and points 4 and 5
FIRST, SECOND = np.array([0, 1, 2, 0, 3, 1]), np.array([1, 2, 3, 4, 5, 4])


def problem(rng):
    values, state = gtsam.Values(), rng.normal(size=(6, 3)) * [3, 3, 2]
    for key, (x, y, theta) in enumerate(state):
        values.insert(key, gtsam.Pose2(x, y, theta) if key < 4 else gtsam.Point2(x, y))
    root = rng.normal(size=(6, 3, 3))
    return values, rng.normal(size=(6, 3)), root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(3)


@pytest.mark.slow
@pytest.mark.parametrize("frame", ["body", "world"])
@pytest.mark.parametrize("kernel", [None, Huber(), Cauchy(0.7)])
def test_it_is_the_sum_of_single_factors(frame, kernel):
    rng = np.random.default_rng(0)
    for _ in range(50):
        values, z, omega = problem(rng)
        at, robust = rng.normal(size=6), SECOND > 3
        if frame == "world":
            # a relative point has no world frame: leave them out
            z, omega, at, robust = z[:3], omega[:3], at[:3], robust[:3]
        first, second = FIRST[: len(z)], SECOND[: len(z)]
        points = 2 if frame == "body" else 0
        one = RelativeEdgesFactor(
            range(6 - 2 + points), first, second, z, omega,
            points=points, frame=frame, at=at, edge_kernel=kernel, robust=robust,
        )  # fmt: skip
        many = gtsam.NonlinearFactorGraph()
        for i, j, measured, information, heading in zip(first.tolist(), second.tolist(), z, omega, at):
            if j < 4:
                many.add(RelativePoseFactor(i, j, measured, information, frame=frame, at=[0, 0, heading]))
            else:
                many.add(RelativePointFactor(i, j, measured[:2], information[:2, :2], kernel=kernel))
        assert one.error(values) == pytest.approx(many.error(values), rel=1e-10)
        jacobian, rhs = one.linearize(values).jacobian()
        hessian, gradient = many.linearize(values).hessian()
        np.testing.assert_allclose(jacobian.T @ jacobian, hessian, atol=1e-10 * np.abs(hessian).max())
        np.testing.assert_allclose(jacobian.T @ rhs, gradient, atol=1e-10 * np.abs(gradient).max())
        again = describe(one).build()
        assert describe(again) == describe(one) and again.error(values) == one.error(values)


@pytest.mark.parametrize("frame", ["body", "world"])
@pytest.mark.parametrize("dimensions", [3, 2])
@pytest.mark.parametrize("kernel", [None, "huber"])
def test_a_graph_with_them_is_the_graph_of_single_factors(frame, dimensions, kernel):
    log = simulate(seed=2, steps=40, clean=True)
    sensor = SensorModel(offset=(0.3, -0.1))
    graph = Graph.from_log(
        log, edges="landmark+motion", dimensions=dimensions, frame=frame, kernel=kernel, sensor=sensor
    )
    state = graph.initial + np.random.default_rng(1).normal(scale=0.1, size=graph.initial.shape)
    values = to_values(graph, state)
    fast, slow = to_gtsam(graph, state), to_gtsam(graph, state, factors="per-edge")
    assert fast.size() < 10 < slow.size()
    assert fast.error(values) == pytest.approx(slow.error(values), rel=1e-10)
    assert 2 * fast.error(values) == pytest.approx(graph.cost(state), rel=1e-9)
    a, b = (made.linearize(values).hessian() for made in (fast, slow))
    for ours, theirs in zip(a, b):
        np.testing.assert_allclose(ours, theirs, atol=1e-9 * np.abs(theirs).max())


def test_both_kinds_have_the_same_optimum():
    log = simulate(seed=4, steps=30, clean=True)
    graph = Graph.from_log(log, edges="landmark+motion", dimensions=2, kernel="cauchy")
    fast, slow = (solve_with_gtsam(graph, factors=kind) for kind in ("fastest", "per-edge"))
    assert fast.converged and slow.converged
    assert fast.cost == pytest.approx(slow.cost, rel=1e-10) and fast.cost == pytest.approx(solve(graph).cost, rel=1e-9)
    assert "RelativeEdgesFactor" in fast.notes[-1] and "RelativeEdgesFactor" not in slow.notes[-1]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"first": [0, 9]}, "places of keys"),
        ({"first": [0]}, "places of keys"),
        ({"measured": np.zeros((2, 2))}, "measured"),
        ({"information": np.eye(3)}, "arrays"),
        ({"information": -np.tile(np.eye(3), (2, 1, 1))}, "positive definite"),
        ({"frame": "world"}, "at"),
        ({"edge_kernel": "l7"}, "kernel must be"),
        # a place that is rounded, or a flag too few, would give another cost
        ({"first": [0.7, 1]}, "places of keys"),
        ({"second": [0, 2]}, "places of keys"),
        ({"robust": [True], "edge_kernel": "cauchy"}, "robust must be 2 times True or False"),
        ({"robust": ["no", "no"]}, "robust must be"),
        ({"robust": [[True], [True, False]]}, "robust must be"),
        ({"points": 0.5}, "points must be a whole number"),
        ({"frame": "world", "at": [0, 90]}, "the heading of at is 90 rad"),
    ],
    ids=str,
)
def test_impossible_arguments(change, message):
    arguments = {
        "first": [0, 1],
        "second": [1, 2],
        "measured": np.zeros((2, 3)),
        "information": np.tile(np.eye(3), (2, 1, 1)),
    }
    with pytest.raises(OptionError, match=message):
        RelativeEdgesFactor([0, 1, 2], **(arguments | change))
