"""Noise of the sensor at the sightings that a state predicts: `Graph.with_noise_at` and the factors' ``noise_at``."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from graphslam import (
    Graph,
    OptionError,
    SensorModel,
    Solution,
    estimate_map,
    simulate,
    solve,
    solve_many,
    solve_with_gtsam,
)
from graphslam.factors import InverseObservationFactor, LandmarkFactor, ObservationFactor, VirtualMotionFactor, describe
from graphslam.metrics import ate
from graphslam.se2 import difference
from graphslam.simulation.drives import Drive
from graphslam.solvers.gtsam_factors import eliminated_landmarks, to_gtsam, to_values
from graphslam.solvers.iteration import Iteration

GRAPHS: dict[str, dict[str, Any]] = {
    "pairs": {"edges": "virtual+motion"},
    "pairs, world frame": {"edges": "virtual+motion", "frame": "world"},
    "tempered pairs": {"edges": "virtual+motion", "weight": "tempered"},
    "pairs with a kernel": {"edges": "virtual+motion", "kernel": "huber"},
    "marginal": {"edges": "virtual+motion", "weight": "marginal"},
    "marginal with a kernel": {"edges": "virtual+motion", "weight": "marginal", "kernel": "cauchy"},
    "landmark nodes": {"edges": "landmark+motion"},
    "polar landmark nodes": {"edges": "landmark+motion", "residual": "polar"},
}


@pytest.mark.slow
@pytest.mark.parametrize("factors", ["fastest", "per-edge"])
@pytest.mark.parametrize("orientation", [True, False])
@pytest.mark.parametrize("kind", GRAPHS)
def test_factors_have_the_cost_of_the_graph(kind: str, orientation: bool, factors: str) -> None:
    log = simulate(seed=3, steps=30, orientation=orientation)
    measured = Graph.from_log(log, **({"kernel": "none"} | GRAPHS[kind]))
    graph = measured.with_noise_at(solve(measured).state)
    state = graph.initial + np.random.default_rng(0).normal(0, 0.02, graph.initial.shape)
    if not orientation:
        state[len(graph.steps) :, 2] = 0
    values = to_values(graph, state)
    values.insert(eliminated_landmarks(graph, state))
    error = 2 * to_gtsam(graph, state, factors=factors).error(values)
    assert error == pytest.approx(graph.cost(state), rel=1e-9)
    assert error != pytest.approx(measured.cost(state), rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("kind", GRAPHS)
def test_both_solvers_agree(kind: str) -> None:
    graph = Graph.from_log(simulate(seed=4, steps=30), **({"kernel": "none"} | GRAPHS[kind]))
    ours, theirs = solve(graph, range_noise="estimated"), solve_with_gtsam(graph, range_noise="estimated")
    assert ours.converged and theirs.converged
    assert ours.graph is not None
    noisy = ours.graph.with_noise_at(ours.state)
    assert noisy.cost(ours.state) == pytest.approx(ours.cost, rel=1e-6)
    assert np.abs(difference(ours.state, theirs.state)).max() < 1e-7


@pytest.mark.nightly
def test_a_robot_whose_noise_is_estimated_has_it_at_estimated_ranges() -> None:
    sensor = SensorModel(range_rate=0.1, range_std=0.0, bearing_std=0.015, max_range=6.0)
    log, _ = Drive(seed=3, duration=150.0, misread=0, sensor=sensor).simulate()
    graph = Graph.from_log(log)
    default, measured, estimated = (solve(graph, range_noise=each) for each in ("auto", "measured", "estimated"))
    assert np.array_equal(default.state, estimated.state) and np.array_equal(default.state, solve(graph).state)
    assert np.abs(difference(default.state, solve_with_gtsam(graph).state)).max() < 1e-6
    found = graph.log
    assert found is not None
    errors = [ate(found.true_poses, found.at_truth(each.poses)) for each in (default, measured)]
    assert errors[0] < errors[1]
    # noise that is given, and that of the lectures, is taken as in the lectures
    given = Graph.from_log(log, motion=found.motion, sensor=found.sensor)
    assert np.array_equal(solve(given).state, solve(given, range_noise="measured").state)
    # which is said
    assert any("range_noise='estimated' does not" in note for note in solve(given).notes)
    assert not any(
        "range_noise=" in note for each in (solve(graph), solve(given, range_noise="measured")) for note in each.notes
    )


@pytest.mark.slow
def test_maps_of_clean_robots_keep_their_size() -> None:
    """Short readings no longer weigh more than long ones, which makes maps too small by some per cent."""
    sizes, errors = [], []
    for seed in range(9300, 9320):
        log = simulate(seed=seed, steps=100, clean=True)
        graph = Graph.from_log(log, edges="landmark+motion")
        assert log.true_poses is not None
        solutions = [solve(graph, range_noise=noise) for noise in ("measured", "estimated")]
        sizes.append([np.std(each.poses[:, :2]) / np.std(log.true_poses[:, :2]) for each in solutions])
        errors.append([ate(log.true_poses, each.poses) for each in solutions])
    before, after = np.median(errors, axis=0)
    assert after < 0.95 * before
    before, after = np.mean(sizes, axis=0)
    assert before < 0.98 < after < 1.01


@pytest.mark.parametrize(
    ("uncertain", "estimate"), [(None, None), (None, ["range_scale:0.05"]), ({"range_scale": 0.05}, None)]
)
def test_maps_of_eliminated_landmarks_are_those_of_landmark_nodes(
    uncertain: dict[str, float] | None, estimate: list[str] | None
) -> None:
    log = simulate(seed=1, steps=40, clean=True).replace(uncertain=uncertain)
    nodes, marginal = (
        solve(Graph.from_log(log, dimensions=2, edges=edges, weight=weight, estimate=estimate), range_noise="estimated")
        for edges, weight in (("landmark+motion", "pairs"), ("virtual+motion", "marginal"))
    )
    again = estimate_map(log.without_orientation(), marginal)
    for j, place in nodes.landmarks.items():
        np.testing.assert_allclose(marginal.landmarks[j], place, atol=1e-6)
        np.testing.assert_allclose(marginal.map[j], place, atol=1e-6)
        if estimate is None:
            np.testing.assert_allclose(again[j], place, atol=1e-6)
    np.testing.assert_allclose(marginal.map.joint, nodes.map.joint, rtol=1e-5)


@pytest.mark.parametrize("method", ["levenberg-marquardt", "gnc"])
def test_every_method_has_estimated_ranges(method: str) -> None:
    graph = Graph.from_log(simulate(seed=4, steps=30), edges="landmark+motion", kernel="none")
    expected = solve(graph, range_noise="estimated")
    found = solve(graph, method=method, range_noise="estimated")
    assert np.abs(difference(found.state, expected.state)).max() < 1e-6
    many = next(iter(solve_many([graph], range_noise="estimated")))
    assert isinstance(many, Solution)
    assert np.array_equal(many.state, expected.state)


@pytest.mark.parametrize("initialize", ["auto", "given"])
def test_a_callback_counts_the_steps_of_all_passes(initialize: str) -> None:
    graph = Graph.from_log(simulate(seed=4, steps=30), edges="landmark+motion")
    steps: list[Iteration] = []
    last = solve(graph, range_noise="estimated", initialize=initialize, callback=steps.append)
    assert [step.number for step in steps] == list(range(1, len(steps) + 1))
    assert len(steps) > 2 * last.iterations
    assert [step.step_norm for step in steps[-last.iterations :]] == last.step_norms.tolist()


def test_impossible_range_noise() -> None:
    graph = Graph.from_log(simulate(seed=4, steps=10))
    with pytest.raises(OptionError, match="state"):
        graph.with_noise_at(graph.initial[:5])
    for solver in (solve, solve_with_gtsam):
        with pytest.raises(OptionError, match="range_noise must be one of auto, measured, estimated"):
            solver(graph, range_noise="true")  # type: ignore[operator]


def test_noise_at_is_an_argument_of_the_factors() -> None:
    z, other, sensor = [3.0, 0.2, 1.0], [2.5, 0.25, 1.1], SensorModel()
    for factor in (
        ObservationFactor(0, 1, z, sensor, noise_at=other),
        ObservationFactor(0, 1, z, sensor, residual="polar", noise_at=other),
        ObservationFactor(0, 1, z[:2], sensor, residual="polar", noise_at=other[:2]).fastest(),
        InverseObservationFactor(0, 1, z, sensor, noise_at=other),
        LandmarkFactor([0, 1], [z, z], sensor, noise_at=[other, other]),
        VirtualMotionFactor(0, 1, z, z, sensor, noise_at=(other, other)),
    ):
        noise = factor.noiseModel()
        assert noise is not None
        if type(factor).__module__.startswith("graphslam"):
            again = describe(factor).from_dict(describe(factor).to_dict()).build()
            assert np.array_equal(again.noiseModel().R(), noise.R())
    seen = ObservationFactor(0, 1, z, sensor, noise_at=other)
    assert np.array_equal(seen.noiseModel().R(), ObservationFactor(0, 1, other, sensor).noiseModel().R())
    native = ObservationFactor(0, 1, z[:2], sensor, residual="polar", noise_at=other[:2]).fastest()
    assert np.allclose(np.diag(native.noiseModel().covariance()), np.diag(sensor.Q(np.array(other[:2])))[::-1])
    between = VirtualMotionFactor(0, 1, z, z, sensor, noise_at=(other, other)).to_between()
    assert not np.allclose(
        between.noiseModel().R(), VirtualMotionFactor(0, 1, z, z, sensor).to_between().noiseModel().R()
    )


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ObservationFactor(0, 1, [3, 0.2, 1], noise_at=[3, 0.2]), "noise_at must be a sighting of 3 numbers"),
        (lambda: InverseObservationFactor(0, 1, [3, 0.2], noise_at=[-3, 0.2]), "range of noise_at must be above zero"),
        (
            lambda: VirtualMotionFactor(0, 1, [3, 0, 0], [3, 0, 0], noise_at=[[3, 0, 0]]),
            "noise_at must be two sightings",
        ),
        (lambda: LandmarkFactor([0, 1], [[3, 0, 0]] * 2, noise_at=[[3, 0]] * 2), "noise_at must be 2 rows of 3"),
    ],
)
def test_impossible_noise_at(make: Any, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        make()
