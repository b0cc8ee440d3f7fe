"""Parameters of vehicle and sensor as unknowns of the graph."""

from dataclasses import replace

import numpy as np
import pytest

from graphslam import (
    Drive,
    Graph,
    GraphError,
    Log,
    MotionModel,
    OptionError,
    SensorModel,
    estimate_map,
    load,
    sample_log_path,
    simulate,
    solve,
    solve_online,
    solve_with_gtsam,
)
from graphslam.engine import engine
from graphslam.identification.corrections import (
    controls_at_steps,
    corrected_controls,
    corrected_sensor,
    corrected_sightings,
    motion_slopes,
    moves,
    without_biases,
)
from graphslam.identification.declared import PARAMETERS, ParameterEstimate, parsed
from graphslam.se2 import compose
from graphslam.solvers.joint import JointGraph

MOTION = MotionModel(nn=0.02, no=0.001, on=0.02, oo=0.02, epsilon=1e-6)
SENSOR = SensorModel(range_rate=0.02, bearing_std=0.01, orientation_std=0.01)
#: what is wrong with the logs of `drive`
BIASES = {"wheel_scale": 1.03, "turn_scale": 0.95, "turn_rate_bias": 0.004, "bearing_bias": 0.05, "range_bias": 0.1}


def drive(seed: int = 0, steps: int = 40, **biases: float) -> Log:
    """A clean drive along way points, recorded by a robot with biases."""
    log = simulate(
        seed=seed, steps=steps, clean=True, motion=MOTION, sensor=SENSOR, way_points=((3, -3), (3, 3), (-3, 3), (-3, -3)),
        turn_rate=0.4,
    )  # fmt: skip
    b = {name: parameter.ideal for name, parameter in PARAMETERS.items()} | biases
    assert log.controls is not None
    nu, omega = log.controls.T
    recorded = np.column_stack(
        [b["wheel_scale"] * nu, b["turn_scale"] * omega + b["turn_rate_bias"] + b["curvature_bias"] * nu]
    )
    z = log.sightings * [b["range_scale"], 1, 1] + [b["range_bias"], b["bearing_bias"], 0]
    biased = log.replace(controls=recorded, sightings=z, motion=MOTION, sensor=SENSOR)
    return biased.replace(initial_poses=biased.dead_reckoning())


@pytest.fixture(scope="module")
def biased() -> Log:
    return drive(**BIASES)


ALL = list(PARAMETERS)


def test_derivatives_are_those_of_the_corrections(biased: Log) -> None:
    """At values far from the ideal ones, with motions of several controls."""
    graph = Graph.from_log(biased.at_steps(np.arange(0, 41, 4)), edges="landmark+motion", estimate=ALL, kernel="none")
    assert graph.parameters is not None
    values = np.array([1.1, 0.9, 0.01, 0.02, 1.2, 0.1, 0.1, 0.3, -0.2, 0.0])
    p = graph.parameters.at(values)
    rows = np.arange(len(p.recorded.steps))

    def evaluated(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        here = p.at(v)
        z = corrected_sightings(here, rows, 3)
        facing = corrected_sensor(here).h_inverse(np.zeros(3), z)
        log = p.recorded
        return engine.accumulated_slopes(corrected_controls(here), log.dt, log.control_starts)[0], facing

    _, slopes = motion_slopes(p, corrected_controls(p))
    X = moves(p, corrected_sightings(p, rows, 3), controls_at_steps(p)[p.recorded.steps])
    places = evaluated(values)[1]
    for k in range(len(values)):
        h = 1e-6 * np.eye(len(values))[k]
        (motions, ahead), (before, behind) = evaluated(values + h), evaluated(values - h)
        np.testing.assert_allclose(slopes[:, :, k], (motions - before) / 2e-6, atol=1e-7, err_msg=ALL[k])
        # the same places, seen from a pose that moves
        numeric = (ahead - behind) / 2e-6
        moved = (compose(1e-6 * X[:, :, k], places) - compose(-1e-6 * X[:, :, k], places)) / 2e-6
        np.testing.assert_allclose(moved, numeric, atol=1e-6, err_msg=ALL[k])


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        {"edges": "landmark+motion", "kernel": "cauchy"},
        pytest.param({"edges": "landmark+motion", "frame": "world", "dimensions": 2}, marks=pytest.mark.nightly),
        {"weight": "marginal"},
        pytest.param({"weight": "tempered", "kernel": "huber"}, marks=pytest.mark.nightly),
        {"weight": "pairs", "dimensions": 2},
    ],
    ids=str,
)
def test_both_solvers_end_at_the_same_optimum(options: dict) -> None:
    log = drive(steps=14, **BIASES)
    estimate = ["wheel_scale", "turn_scale:0.2", "bearing_bias", "sensor_ahead:0.1"]
    graph = Graph.from_log(log, estimate=estimate, **options)
    ours, theirs = solve(graph), solve_with_gtsam(graph)
    assert ours.converged and theirs.converged
    np.testing.assert_allclose(ours.parameters.values, theirs.parameters.values, atol=1e-8)
    np.testing.assert_allclose(ours.poses, theirs.poses, atol=1e-8)


def test_landmarks_as_nodes_and_eliminated_are_the_same(biased: Log) -> None:
    nodes = solve(Graph.from_log(biased, edges="landmark+motion", estimate=list(BIASES), kernel="none"))
    marginal = solve(
        Graph.from_log(biased, weight="marginal", estimate=list(BIASES), edges="virtual+motion", kernel="none")
    )
    np.testing.assert_allclose(nodes.parameters.values, marginal.parameters.values, atol=1e-8)
    np.testing.assert_allclose(nodes.parameters.covariance, marginal.parameters.covariance, rtol=1e-6)
    np.testing.assert_allclose(nodes.covariance(20), marginal.covariance(20), rtol=1e-5)
    assert nodes.cost == pytest.approx(marginal.cost, rel=1e-8)


@pytest.mark.slow
def test_known_biases_are_found_with_their_covariance() -> None:
    """e' P^-1 e over the number of parameters is 1 on average; 12 logs with 5 parameters leave it between 0.6 and 1.5."""
    truth, squares = np.array(list(BIASES.values())), []
    for seed in range(12):
        found = solve(
            Graph.from_log(drive(seed, **BIASES), edges="landmark+motion", estimate=list(BIASES), kernel="none")
        ).parameters
        error = found.values - truth
        squares.append(error @ np.linalg.solve(found.covariance, error) / len(error))
    assert 0.6 < np.mean(squares) < 1.5


def test_range_scale_is_found_beside_noise_in_proportion_to_the_range() -> None:
    """With noise and derivatives at the measured ranges these logs give 1.006 in place of 0.95."""
    found = []
    for seed in range(8):
        log = simulate(seed=seed, steps=60, clean=True, motion=MOTION)
        z = log.sightings * [0.95, 1, 1]
        found.append(
            solve(
                Graph.from_log(
                    log.replace(sightings=z),
                    motion=MOTION,
                    edges="landmark+motion",
                    estimate="range_scale",
                    kernel="none",
                )
            )
        )
    values = [solution.parameters["range_scale"] for solution in found]
    deviation = np.mean([solution.parameters.deviations["range_scale"] for solution in found])
    assert abs(np.mean(values) - 0.95) < 3 * deviation / np.sqrt(len(values))


def test_covariances_are_the_inverse_of_the_whole_system(biased: Log) -> None:
    solution = solve(
        Graph.from_log(biased, edges="landmark+motion", estimate=["wheel_scale", "bearing_bias:0.1"], kernel="none")
    )
    graph = solution.graph
    joint = JointGraph(graph)
    border = joint.border(graph, solution.state, solution.state)
    omega = graph.linearize(solution.state)[0].to_sparse().toarray()
    n = len(omega)
    whole = np.zeros((n + 2, n + 2))
    whole[:n, :n], whole[n:, n:] = omega, border.own
    whole[:n, n:] = border.mixed.reshape(n, 2)
    whole[n:, :n] = whole[:n, n:].T
    covariance = np.linalg.inv(whole)
    np.testing.assert_allclose(solution.parameters.covariance, covariance[n:, n:], rtol=1e-6)
    np.testing.assert_allclose(solution.covariance(7), covariance[21:24, 21:24], rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(
        solution.covariance([3, 9], joint=True)[:3, 3:], covariance[9:12, 27:30], rtol=1e-5, atol=1e-10
    )


def test_the_deviation_is_the_curvature_of_the_cost(biased: Log) -> None:
    """J of logs that are corrected by hand, minimised over the nodes, is J* + (p - p*)² / sigma²."""
    solution = solve(Graph.from_log(biased, edges="landmark+motion", estimate="turn_rate_bias", kernel="none"))
    found, sigma = solution.parameters["turn_rate_bias"], solution.parameters.deviations["turn_rate_bias"]
    at = [found - 3 * sigma, found, found + 3 * sigma]
    costs = [
        solve(Graph.from_log(without_biases(biased, turn_rate_bias=b), edges="landmark+motion", kernel="none")).cost
        for b in at
    ]
    # the noise at measured ranges, not at predicted ones, shifts the minimum a little
    assert costs[0] - 2 * costs[1] + costs[2] == pytest.approx(2 * 9, rel=0.03)


def test_the_sample_log_shows_its_biases() -> None:
    """Its notes: turn rate x 1.082, bearing -0.044 rad; speed x 1.035 and range x 0.977 only as a ratio."""
    log = load(sample_log_path())
    graph = Graph.from_log(
        log, edges="landmark+motion", estimate=["range_scale", "turn_scale", "bearing_bias"], kernel="none"
    )
    found = solve(graph).parameters
    for name, truth in {"range_scale": 0.977 * 1.035, "turn_scale": 1 / 1.082, "bearing_bias": -0.044}.items():
        assert abs(found[name] - truth) < 2 * found.deviations[name], name
    assert "turn_scale 0.92" in repr(found)


@pytest.mark.parametrize(
    ("log", "estimate", "words"),
    [
        ("biased", ["wheel_scale", "range_scale"], "wheel_scale and range_scale together.*size of the world"),
        ("biased", ["wheel_scale:0.1", "range_scale:0.1"], "size of the world"),
        ("straight", ["sensor_left"], "tell sensor_left: poses and landmarks can follow"),
        ("straight", ["turn_scale"], "tell turn_scale: nothing that was recorded depends on it"),
        ("circle", ["turn_scale", "turn_rate_bias"], "turn_scale and turn_rate_bias together"),
        ("circle", ["turn_rate_bias", "curvature_bias"], "turn_rate_bias and curvature_bias together"),
        ("noisy", ["turn_scale"], "its standard deviation would be"),
        ("noisy", ["sensor_left"], "sensor_left: its standard deviation would be .* m; "),
    ],
)
def test_what_a_log_does_not_tell_is_refused(biased: Log, log: str, estimate: list[str], words: str) -> None:
    world = {"steps": 20, "clean": True, "motion": MOTION, "sensor": SENSOR}
    straight = {"turn_rate": 0.0, "landmarks": ((1, -4), (2, -1), (5, -4), (8, -1), (11, -4), (13, -1))}
    exact = {
        "motion": MotionModel(nn=1e-9, no=1e-9, on=1e-9, oo=1e-9, epsilon=1e-16),
        "sensor": SensorModel(range_rate=1e-9, bearing_std=1e-9),
    }
    logs = {
        "biased": lambda: biased,
        "straight": lambda: simulate(**(world | exact), **straight),
        "circle": lambda: simulate(**world),
        "noisy": lambda: simulate(**world, **(straight | {"turn_rate": 1e-4})),
    }
    graph = Graph.from_log(
        logs[log](),
        motion=MOTION,
        sensor=SENSOR,
        edges="landmark+motion",
        dimensions=2,
        estimate=estimate,
        kernel="none",
    )
    with pytest.raises(GraphError, match=words):
        solve(graph)
    if log == "biased":
        with pytest.raises(GraphError, match=words):
            solve_with_gtsam(graph)


def test_a_known_lever_tells_the_size_of_the_world() -> None:
    """A sensor at a known place ahead of the robot is a length that both scales can be measured by."""
    far = replace(SENSOR, offset=(1.5, 0.0))
    log = simulate(
        seed=3, steps=60, clean=True, motion=MOTION, sensor=far, turn_rate=0.4,
        way_points=((3, -3), (3, 3), (-3, 3), (-3, -3)),
    )  # fmt: skip
    log = log.replace(sightings=log.sightings * [1.1, 1, 1], motion=MOTION, sensor=far)
    found = solve(
        Graph.from_log(log, edges="landmark+motion", estimate=["wheel_scale", "range_scale"], kernel="none")
    ).parameters
    assert abs(found["range_scale"] - 1.1) < 3 * found.deviations["range_scale"] < 0.3


def test_priors_hold_parameters(biased: Log) -> None:
    free, weak, tight = (
        solve(
            Graph.from_log(
                biased, weight="marginal", estimate={"turn_scale": deviation}, edges="virtual+motion", kernel="none"
            )
        ).parameters
        for deviation in (None, 10.0, 1e-6)
    )
    assert weak["turn_scale"] == pytest.approx(free["turn_scale"], abs=1e-5) and free.priors == {}
    assert tight["turn_scale"] == pytest.approx(1.0, abs=1e-5)
    assert tight.deviations["turn_scale"] < 1e-6 and tight.priors == {"turn_scale": (1.0, 1e-6)}


def test_the_solution_is_that_of_the_corrected_log(biased: Log) -> None:
    solution = solve(
        Graph.from_log(biased, weight="marginal", estimate=list(BIASES), edges="virtual+motion", kernel="none")
    )
    log = solution.graph.log
    np.testing.assert_allclose(log.sightings[:, 1], biased.sightings[:, 1] - solution.parameters["bearing_bias"])
    again = solve(Graph.from_log(log, weight="marginal", edges="virtual+motion", kernel="none"))
    # only the ranges at which the noise is evaluated differ
    plain = solve(Graph.from_log(biased, weight="marginal", edges="virtual+motion", kernel="none"))
    change = np.abs(plain.poses - solution.poses).max()
    assert np.abs(again.poses - solution.poses).max() < 0.05 * change
    assert solution.certificate.applicable
    assert set(solution.landmarks) == set(again.landmarks)


def test_wrong_sightings_are_rejected_at_the_estimated_parameters(biased: Log) -> None:
    wrong = np.arange(len(biased.steps)) % 10 == 0
    z = biased.sightings.copy()
    z[wrong, 0] *= 2
    options = {"edges": "landmark+motion", "estimate": list(BIASES)}
    robust = solve(Graph.from_log(biased.replace(sightings=z), **options), method="gnc")
    assert robust.trust is not None
    assert robust.trust[wrong].max() < 0.5 and np.mean(robust.trust[~wrong]) > 0.95
    clean = solve(Graph.from_log(biased.with_sightings(~wrong), **options)).parameters
    deviations = np.array(list(clean.deviations.values()))
    np.testing.assert_array_less(np.abs(robust.parameters.values - clean.values), deviations)


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"estimate": ["wheel_size"]}, OptionError, "did you mean 'wheel_scale'"),
        ({"estimate": ["wheel_scale:-1"]}, OptionError, "positive standard deviation"),
        ({"estimate": ["wheel_scale:many"]}, OptionError, "positive standard deviation"),
        ({"estimate": "wheel-scale", "edges": "virtual"}, GraphError, "no motion edges"),
        ({"estimate": "range_bias", "edges": "landmark+motion", "residual": "polar"}, GraphError, "cartesian"),
    ],
)
def test_impossible_requests(biased: Log, options: dict, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        Graph.from_log(biased, **options)


def test_names_may_have_hyphens_and_priors() -> None:
    assert parsed("wheel-scale,range_bias:0.1") == {"wheel_scale": np.inf, "range_bias": 0.1}
    assert parsed({"wheel_scale": 0.1, "range_bias": None}) == {"wheel_scale": 0.1, "range_bias": np.inf}


def test_solvers_without_parameters_refuse(biased: Log) -> None:
    graph = Graph.from_log(biased, edges="landmark+motion", estimate="bearing_bias", kernel="none")
    with pytest.raises(GraphError, match="cannot estimate parameters"):
        solve_online(graph)
    with pytest.raises(GraphError, match="cannot estimate parameters"):
        solve_online(biased, backend="isam2", estimate="bearing_bias")


def test_a_landmark_seen_twice_from_a_pose_needs_its_sightings_counted_once(biased: Log) -> None:
    twice = biased.with_sightings(np.sort(np.append(np.arange(len(biased.steps)), 5)))
    with pytest.raises(GraphError, match="seen twice from one pose.*weight='marginal'"):
        solve(Graph.from_log(twice, estimate="bearing_bias", edges="virtual+motion", kernel="none"))
    assert solve(
        Graph.from_log(twice, weight="marginal", estimate="bearing_bias", edges="virtual+motion", kernel="none")
    ).converged


@pytest.mark.parametrize(("wider", "doubted"), [(1, False), (10, True)])
def test_turns_that_may_be_noise_of_sightings_are_doubted(wider: int, doubted: bool) -> None:
    robot = MotionModel.constant(0.05 / wider, 0.05 / wider)
    log = simulate(seed=0, steps=100, clean=True, motion=robot, sensor=SENSOR)
    graph = Graph.from_log(
        log,
        motion=MotionModel.constant(0.05, 0.05),
        sensor=SENSOR,
        edges="landmark+motion",
        estimate="sensor_delay",
        kernel="none",
    )
    doubt = solve(graph).parameters.doubt
    assert ("do not rely on sensor_delay" in doubt) == doubted


def test_scales_need_no_turns(biased: Log) -> None:
    graph = Graph.from_log(
        biased,
        motion=MotionModel.constant(5, 5),
        sensor=SENSOR,
        edges="landmark+motion",
        estimate="bearing_bias",
        kernel="none",
    )
    assert solve(graph).parameters.doubt == ""


@pytest.mark.slow
@pytest.mark.parametrize("bias", [np.pi, np.pi / 2, 0.8, -2.0])
def test_a_sensor_mounted_backwards_or_sideways_is_found(bias: float) -> None:
    log = drive(bearing_bias=bias).without_orientation()
    solution = solve(Graph.from_log(log, edges="landmark+motion", estimate="bearing_bias"))
    off = solution.parameters["bearing_bias"] - bias
    assert abs((off + np.pi) % (2 * np.pi) - np.pi) < 0.02
    assert solution.converged and solution.cost < 2 * solution.graph.degrees_of_freedom
    assert solution.certificate.status == "global with the parameters held"
    assert "held" in solution.certificate.reason


def test_the_cost_includes_the_priors(biased: Log) -> None:
    free = solve(Graph.from_log(biased, weight="marginal", estimate={"bearing_bias": None}))
    held = solve(Graph.from_log(biased, weight="marginal", estimate={"bearing_bias": 0.005}))
    off = held.parameters["bearing_bias"] / 0.005
    edges = sum(family.cost(held.state, held.state) for family in held.graph.families)
    assert held.cost == pytest.approx(edges + off**2) and off**2 > 1 and held.cost > free.cost
    assert held.certificate.relative_gap < 1e-6 and held.certificate.lower_bound <= held.cost


def test_joint_nees_counts_the_uncertainty_of_the_parameters(biased: Log) -> None:
    solution = solve(Graph.from_log(biased, edges="landmark+motion", estimate=["turn_scale", "wheel_scale"]))
    poses = 3 * len(solution.graph.steps)
    omega = solution.graph.information(solution.state).to_sparse().toarray()
    border = JointGraph(solution.graph).border(solution.graph, solution.state, solution.state, scaled=True)
    mixed = border.mixed.reshape(len(omega), -1)
    whole = np.block([[omega, mixed], [mixed.T, border.own]])
    covariance = np.linalg.inv(whole[3:, 3:])[: poses - 3, : poses - 3]
    errors = solution.poses - biased.true_poses
    errors[:, 2] = (errors[:, 2] + np.pi) % (2 * np.pi) - np.pi
    e = errors[1:].ravel()
    expected = e @ np.linalg.solve(covariance, e) / len(e)
    assert solution.joint_nees(biased.true_poses) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(("name", "other"), [("wheel_scale", "range_scale"), ("range_scale", "wheel_scale")])
def test_one_scale_explains_what_the_other_does(name: str, other: str) -> None:
    """J does not tell wheels that are off by 3 % from ranges that are, so the estimate names both."""
    drive = Drive(seed=1001, duration=100.0, misread=0.0, landmarks=16, parameters={"wheel_scale": 1.03})
    log, truth = drive.simulate()
    models = {"motion": truth.motion, "sensor": truth.sensor, "edges": "landmark+motion", "kernel": "none"}
    found = solve(Graph.from_log(log, estimate=[name], **models))
    instead = solve(Graph.from_log(log, estimate=[other], **models))
    assert abs(found.cost - instead.cost) < 4.0 < solve(Graph.from_log(log, **models)).cost - found.cost
    assert f"with {other} {1 / found.parameters[name]:.3f} instead" in found.parameters.doubt
    assert found.parameters[name] * instead.parameters[other] == pytest.approx(1, abs=0.003)


def test_a_scale_of_one_is_not_doubted() -> None:
    log, truth = Drive(seed=1001, duration=100.0, misread=0.0, landmarks=16, parameters={}).simulate()
    graph = Graph.from_log(
        log, motion=truth.motion, sensor=truth.sensor, edges="landmark+motion", estimate=["wheel_scale"]
    )
    assert solve(graph).parameters.doubt == ""


def test_estimates_are_written_with_the_digits_that_are_known() -> None:
    names = ("wheel_scale", "turn_rate_bias", "range_bias")
    found = ParameterEstimate(names, np.array([0.86981, -0.003104, 0.2]), np.diag([0.0171, 0.0046, 0.0]) ** 2, {})
    assert found.sentence == "wheel_scale 0.870 +- 0.017, turn_rate_bias -0.0031 +- 0.0046 rad/s, range_bias 0.2 +- 0 m"


def test_the_map_of_the_recorded_log_has_no_biases(biased: Log) -> None:
    options = {"edges": "virtual+motion", "weight": "marginal", "kernel": "none"}
    solution = solve(Graph.from_log(biased, estimate=list(BIASES), **options))
    found = estimate_map(biased, solution)
    assert all(np.allclose(found[j], place) for j, place in solution.landmarks.items())
