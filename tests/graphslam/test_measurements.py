"""Relations and absolute positions: records, edges, frames, both solvers, GTSAM's own factors, step by step, files."""

from __future__ import annotations

import warnings
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from own_tables import SEEN, text, write_tables

import fastslam
from graphslam import (
    AbsolutePositions,
    Graph,
    GraphError,
    LogError,
    MotionModel,
    OnlineSolver,
    PoseRelations,
    load,
    save,
    simulate,
    solve,
    solve_online,
    solve_with_gtsam,
    textbook,
)
from graphslam.association import associate_from
from graphslam.edges import AnchorEdges, PositionEdges, RelationEdges
from graphslam.edges.robust import Cauchy
from graphslam.factors import PositionFactor, RelativePoseFactor, describe
from graphslam.factors.description import FactorDescription
from graphslam.graph.transform import relative_graph
from graphslam.linear.information import BlockSystem
from graphslam.log.continuous_time import with_poses_every
from graphslam.log.measurements import NO_HEADING
from graphslam.online import replay
from graphslam.se2 import between, compose, mounted, wrap

LEVER = (0.3, -0.1)
C = np.diag([0.02, 0.02, 0.01]) ** 2
C_POSITION = np.array([[0.01, 0.002, 0.0], [0.002, 0.02, 0.0], [0.0, 0.0, 4e-4]])


@pytest.fixture(scope="module")
def bare():
    return simulate(seed=3, clean=True)


def measured(log, *, noise=1.0, lever=LEVER, seed=0):
    """The log with 30 relations and with a position at every tenth step, every second one with a heading."""
    rng, truth = np.random.default_rng(seed), log.true_poses
    first = rng.integers(0, log.num_poses - 40, 30)
    second = first + rng.integers(20, 40, 30)
    motions = between(truth[first], truth[second]) + noise * rng.multivariate_normal(np.zeros(3), C, 30)
    steps = np.arange(5, log.num_poses, 10)
    places = mounted(truth[steps], lever) + noise * rng.multivariate_normal(np.zeros(3), C_POSITION, len(steps))
    places[::2, 2] = np.nan
    return log.replace(
        relations=PoseRelations(first=first, second=second, motions=motions, covariances=C),
        positions=AbsolutePositions(steps=steps, places=places, covariances=C_POSITION, levers=lever),
    )


@pytest.fixture(scope="module")
def log(bare):
    return measured(bare)


def distance(solution, log):
    return float(np.sqrt(np.mean(np.sum((solution.poses - log.true_poses)[:, :2] ** 2, axis=1))))


FAMILIES = [
    RelationEdges(
        np.array([0, 3, 2]), np.array([2, 1, 4]), np.ones((3, 3)), np.tile(np.diag([1.0, 2, 3]) + 0.3, (3, 1, 1))
    ),
    PositionEdges(
        np.array([0, 0, 3]), np.ones((3, 2)), np.tile(np.diag([1.0, 2]) + 0.3, (3, 1, 1)), np.full((3, 2), 0.7)
    ),
    PositionEdges(
        np.array([1, 4]), np.ones((2, 3)), np.tile(np.diag([1.0, 2, 3]) + 0.3, (2, 1, 1)), np.full((2, 2), -0.4)
    ),
]


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("kernel", [None, Cauchy()])
def test_jacobians_and_gradient_against_finite_differences(family, kernel):
    state = np.random.default_rng(1).normal(size=(5, 3))
    trust = np.linspace(0.2, 1.0, family.count)
    edges = replace(family, kernel=kernel, trust=trust)
    ends, step = edges.linearize(state, state), 1e-6
    for nodes, jacobians in zip(ends.nodes, ends.jacobians):
        for k in range(3):
            moved = [state.copy(), state.copy()]
            for sign, each in zip((1, -1), moved):
                each[np.unique(nodes), k] += sign * step
            # of an edge with two ends only this one may move
            differences = []
            for e in range(edges.count):
                one = [state.copy(), state.copy()]
                one[0][nodes[e], k] += step
                one[1][nodes[e], k] -= step
                plus, minus = (edges.linearize(x, x).residuals[e] for x in one)
                differences.append((plus - minus) / (2 * step))
            np.testing.assert_allclose(jacobians[:, :, k], differences, atol=1e-7)
    system = BlockSystem.from_cliques(5, [edges.cliques()])
    system.clear()
    edges.accumulate(state, state, system)
    gradient = np.zeros((5, 3))
    for i in range(5):
        for k in range(3):
            plus, minus = state.copy(), state.copy()
            plus[i, k] += step
            minus[i, k] -= step
            gradient[i, k] = (edges.cost(plus, plus) - edges.cost(minus, minus)) / (2 * step)
    np.testing.assert_allclose(-2 * system.xi, gradient, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("factors", "options"), [
    ("fastest", {}), ("fastest", {"edges": "landmark+motion", "kernel": "cauchy"}), ("fastest", {"weight": "marginal"}),
    ("per-edge", {"edges": "landmark+motion", "kernel": "cauchy"}), pytest.param("per-edge", {}, marks=pytest.mark.nightly),
    pytest.param("per-edge", {"weight": "marginal"}, marks=pytest.mark.nightly),
])  # fmt: skip
def test_both_solvers_have_the_same_optimum_which_is_proven(log, options, factors):
    graph = Graph.from_log(log, **options)
    own, other = solve(graph), solve_with_gtsam(graph, factors=factors)
    assert own.converged and other.converged and own.certificate.proven
    assert other.cost == pytest.approx(own.cost, rel=1e-9)
    assert (
        np.abs(wrap(own.poses - other.poses)[:, 2]).max() < 1e-6 and np.abs(own.poses - other.poses)[:, :2].max() < 1e-6
    )


def test_measurements_correct_a_log_without_sightings(bare, log):
    alone = log.with_sightings(np.zeros(0, dtype=int))
    graph = Graph.from_log(alone)
    solution = solve(graph)
    assert solution.certificate.proven and distance(solution, bare) < 0.3
    # chi-square of 102 degrees of freedom, five standard deviations about its mean
    assert abs(solution.cost - graph.degrees_of_freedom) < 5 * np.sqrt(2 * graph.degrees_of_freedom)
    with pytest.raises(GraphError, match="no sightings at all, and no relations or positions"):
        Graph.from_log(alone.replace(relations=None, positions=None))


def test_positions_are_the_frame(bare, log):
    graph = Graph.from_log(log)
    assert not any(isinstance(family, AnchorEdges) for family in graph.families)
    motion = np.array([100.0, -30.0, 2.5])
    places = log.positions.places.copy()
    places[:, :2] = compose(motion, np.nan_to_num(places))[:, :2]
    places[:, 2] += motion[2]
    turn = np.eye(3)
    turn[:2, :2] = [[np.cos(2.5), -np.sin(2.5)], [np.sin(2.5), np.cos(2.5)]]
    covariances = turn @ np.nan_to_num(C_POSITION) @ turn.T
    moved = log.replace(
        positions=AbsolutePositions(steps=log.positions.steps, places=places, covariances=covariances, levers=LEVER)
    )
    one, two = solve(graph), solve(Graph.from_log(moved))
    assert two.cost == pytest.approx(one.cost, rel=1e-6)
    np.testing.assert_allclose(two.poses[:, :2], compose(motion, one.poses)[:, :2], atol=1e-5)


@pytest.mark.parametrize("method", ["gauss-newton", "levenberg-marquardt"])
def test_positions_in_utm_converge_although_rounding_keeps_steps_long(bare, method):
    """A northing of millions of metres is rounded to 1e-9 m, which no step of precise odometry goes below."""
    motion = replace(bare.motion or MotionModel(), epsilon=1e-9)
    steps = np.arange(5, bare.num_poses, 10)
    rng = np.random.default_rng(0)
    places = bare.true_poses[steps, :2] + rng.normal(0, 0.1, (len(steps), 2))
    found = []
    for origin in (np.zeros(2), np.array([450_000.0, 4_200_000.0])):
        positions = AbsolutePositions(
            steps=steps, places=places + origin, covariances=0.01 * np.eye(2), levers=(0.0, 0.0)
        )
        log = with_poses_every(bare.replace(positions=positions, motion=motion), 0.2)
        found.append(solve(Graph.from_log(log, edges="landmark+motion"), method=method))
    here, there = found
    assert there.converged and there.iterations <= 2 * here.iterations
    assert there.cost == pytest.approx(here.cost, rel=1e-7)
    np.testing.assert_allclose(there.poses[:, :2] - origin, here.poses[:, :2], atol=1e-5)


def test_one_position_leaves_the_direction_to_the_anchor(bare):
    one = AbsolutePositions(steps=[10], places=[[5.0, 5.0]], covariances=0.01 * np.eye(2), levers=(1.0, 0.0))
    graph = Graph.from_log(bare.replace(positions=one))
    assert [f.information[0].diagonal().tolist() for f in graph.families if isinstance(f, AnchorEdges)] == [[0, 0, 1e6]]
    plain, own, other = solve(Graph.from_log(bare)), solve(graph), solve_with_gtsam(graph)
    # nothing is measured twice, so that the cost is the same, and the point is where it was measured
    assert own.cost == pytest.approx(plain.cost, rel=1e-9) == other.cost
    np.testing.assert_allclose(mounted(own.poses[10], (1.0, 0.0))[:2], [5.0, 5.0], atol=1e-6)
    assert graph.degrees_of_freedom == Graph.from_log(bare).degrees_of_freedom


@pytest.mark.parametrize("backend", ["own", "isam2"])
def test_one_position_leaves_the_direction_to_the_anchor_step_by_step(bare, backend):
    one = AbsolutePositions(steps=[10], places=[[5.0, 5.0]], covariances=0.01 * np.eye(2))
    log = bare.replace(positions=one)
    batch = solve(Graph.from_log(log, edges="landmark+motion"))
    solver = list(replay(log, backend=backend, edges="landmark+motion"))[-1]
    solver.relinearize()
    np.testing.assert_allclose(solver.poses, batch.poses, atol=1e-4)
    # the loose hold on the place, 1 km, is all that differs from the graph
    np.testing.assert_allclose(solver.covariance(), batch.covariance()[-1], rtol=1e-3, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("epsilon", [1e-6, pytest.param(1e-9, marks=pytest.mark.nightly), 1e-10])
def test_a_free_start_is_determined_step_by_step_however_precise_the_odometry_is(bare, epsilon):
    """Until the first position, or landmark of a map, what a free start says was below rounding errors."""
    motion = replace(bare.motion or MotionModel(), epsilon=epsilon)
    steps = np.arange(5, bare.num_poses, 10)
    places = bare.true_poses[steps, :2] + np.random.default_rng(0).normal(0, 0.1, (len(steps), 2))
    positions = AbsolutePositions(steps=steps, places=places, covariances=0.01 * np.eye(2), levers=(0.0, 0.0))
    # short motions, whose covariances have rank 2 but for epsilon
    log = with_poses_every(bare.replace(positions=positions, motion=motion), 0.01)
    graph = Graph.from_log(log.at_steps(np.arange(2500)), edges="landmark+motion")
    online, batch = solve_online(graph), solve(graph)
    assert online.converged
    np.testing.assert_allclose(online.poses, batch.poses, atol=1e-3)
    late = log.replace(positions=None).with_sightings(log.steps > 40).at_steps(np.arange(2500))
    graph = Graph.from_log(late, map=bare.true_landmarks)
    online, batch = solve_online(graph), solve(graph)
    assert online.converged
    np.testing.assert_allclose(online.poses, batch.poses, atol=1e-3)
    assert online.cost == pytest.approx(batch.cost, rel=1e-4)


@pytest.mark.slow
def test_wrong_ones_are_rejected(bare, log):
    motions, places = log.relations.motions.copy(), log.positions.places.copy()
    motions[:8, :2] += 3.0
    places[1, :2] += 4.0
    wrong = log.replace(
        relations=replace(log.relations, motions=motions), positions=replace(log.positions, places=places)
    )
    options = {"edges": "landmark+motion"}
    right = distance(solve(Graph.from_log(log, **options)), bare)
    found = solve(Graph.from_log(wrong, **options, kernel="none"), method="gnc")
    in_relations, in_positions = found.other_trust["relations"], found.other_trust["positions"]
    assert np.all(in_relations[:8] < 0.5) and in_positions[1] < 0.5
    # one of a hundred right ones is rejected: with 27 of them more than two in 0.3 % of the cases
    assert np.sum(in_relations[8:] < 0.5) + np.sum(np.delete(in_positions, 1) < 0.5) <= 2
    assert (
        f"{np.sum(in_relations < 0.5)} of 30 relations and" in found.notes[-1] and found.trust.shape == bare.steps.shape
    )
    kernel = distance(solve(Graph.from_log(wrong, **options, kernel="cauchy")), bare)
    plain = distance(solve(Graph.from_log(wrong, **options)), bare)
    assert distance(found, bare) < 2 * right and kernel < 2 * right < plain


def test_factors_cost_what_gtsams_own_cost():
    values = gtsam.Values()
    values.insert(0, gtsam.Pose2(1.0, 2.0, 0.5))
    values.insert(1, gtsam.Pose2(2.0, 1.0, -0.5))
    W = np.array([[2.0, 0.3], [0.3, 5.0]])
    position = PositionFactor(0, [1.3, 2.1], W)
    native = position.fastest()
    assert type(native) is gtsam.PoseTranslationPrior2D
    assert native.error(values) == pytest.approx(position.error(values), rel=1e-12)
    assert PositionFactor(0, [1.3, 2.1], W, lever=(1, 0)).fastest().error(values) != native.error(values)
    # with the heading measured exactly the logarithm is the difference itself
    relation = RelativePoseFactor(0, 1, [0.3, -1.2, -1.0], np.diag([2.0, 3.0, 4.0]))
    assert relation.to_between().error(values) == pytest.approx(relation.error(values), rel=1e-12)
    lever = PositionFactor(0, [1.3, 2.1, 0.4], np.eye(3), lever=(1.0, 2.0), kernel="cauchy")
    again = FactorDescription.from_dict(describe(lever).to_dict()).build()
    assert again.error(values) == lever.error(values)


@pytest.mark.slow
def test_step_by_step_is_the_batch_solution(bare, log):
    related = log.replace(positions=None)
    for backend, each in (("own", related), ("own", log), ("isam2", related), ("isam2", log)):
        online = solve_online(each, backend=backend, edges="landmark+motion", relinearize=True)
        batch = solve(Graph.from_log(each, edges="landmark+motion"))
        assert online.cost == pytest.approx(batch.cost, rel=1e-6)
        assert np.abs(online.poses - batch.poses)[:, :2].max() < 1e-3
    # without linearising everything again at the end, and with a robust kernel on relations and positions, too
    for kernel in ("none", "cauchy"):
        online = solve_online(log, edges="landmark+motion", kernel=kernel)
        batch = solve(Graph.from_log(log, edges="landmark+motion", kernel=kernel))
        assert batch.cost * (1 - 1e-9) <= online.cost <= batch.cost * (1 + 1e-6)
        assert not online.notes or "without a robust kernel" not in online.notes[-1]
        found, known = online.covariance(poses=[0, 60]), batch.covariance(poses=[0, 60])
        np.testing.assert_allclose(found, known, rtol=0.02, atol=1e-9)


@pytest.mark.parametrize("backend", ["own", "isam2"])
@pytest.mark.parametrize("direction", [0.0, 2.0, 3.1])
def test_positions_say_where_a_drive_from_nowhere_is(bare, backend, direction):
    # the world of the positions is far away, and turned against that of the first pose, which nobody has said
    far = np.array([4.2e5, 5.1e6, direction])
    rng, solver = np.random.default_rng(1), OnlineSolver(backend=backend, motion=bare.motion)
    truth, lever = compose(far, bare.true_poses), np.array(LEVER)
    for t in range(bare.num_poses):
        if t:
            solver.move(bare.controls[t - 1], bare.dt[t - 1])
        if t % 4 == 0:
            solver.locate(mounted(truth[t], LEVER)[:2] + 0.05 * rng.standard_normal(2), 0.0025 * np.eye(2), lever=lever)
    solver.relinearize()
    errors = solver.poses - truth
    # five standard deviations of a position
    assert np.hypot(*errors[::4, :2].T).max() < 0.25
    errors[:, 2] = wrap(errors[:, 2])
    # 3 x 63 numbers, chi-square with a standard deviation of 19 if they were independent
    P = solver.covariance(poses=list(range(bare.num_poses)))
    assert np.einsum("ti,tij,tj->", errors, np.linalg.inv(P), errors) < 3 * 63 + 4 * 19


@pytest.mark.slow
@pytest.mark.parametrize(
    ("backend", "options"),
    [
        ("own", {"lag": 5}),
        ("own", {}),
        ("isam2", {}),
        ("isam2", {"edges": "virtual+motion", "weight": "marginal"}),
    ],
    ids=str,
)
def test_the_first_position_moves_final_poses_too(log, backend, options):
    """A position in another frame in the middle of a drive; the steps after it work on the factors that are there."""
    solver = OnlineSolver(backend=backend, motion=log.motion, sensor=log.sensor, **options)
    away = np.array([100.0, 50.0])
    for t in range(log.num_poses):
        if t:
            solver.move(log.controls[t - 1], log.dt[t - 1])
        seen = log.steps == t
        solver.observe(log.landmarks[seen], log.sightings[seen])
        if t == 30:
            before = solver.poses
            solver.locate(log.true_poses[t, :2] + away, 0.01 * np.eye(2))
            # without a heading it moves all poses alike
            np.testing.assert_allclose(solver.poses[:, :2] - before[:, :2], np.tile(away, (31, 1)), atol=6)
            assert np.ptp(solver.poses - before, axis=0).max() < 0.02
        elif t > 30 and t % 5 == 0:
            solver.locate(log.true_poses[t, :2] + away, 0.01 * np.eye(2))
    solver.relinearize()
    assert solver.converged
    errors = np.hypot(*(solver.poses[:, :2] - log.true_poses[:, :2] - away).T)
    # final poses cannot be corrected
    assert errors[-20:].max() < 0.5 and errors.max() < 2.0


def test_a_first_position_with_a_heading_is_met():
    for backend in ("own", "isam2"):
        solver = OnlineSolver(backend=backend)
        solver.move(motion=[1.0, 0.0, 0.2], covariance=1e-4 * np.eye(3))
        solver.locate([3.0, 4.0, 1.0], 1e-4 * np.eye(3), lever=LEVER)
        np.testing.assert_allclose(mounted(solver.pose, LEVER), [3.0, 4.0, 1.0], atol=1e-6)
        np.testing.assert_allclose(between(solver.poses[0], solver.pose), [1.0, 0.0, 0.2], atol=1e-6)
        # a start that is given is exact
        held = OnlineSolver([0.0, 0.0, 0.0], backend=backend)
        held.locate([3.0, 4.0, 1.0], np.eye(3))
        np.testing.assert_allclose(held.pose, 0.0, atol=1e-5)


@pytest.mark.slow
def test_whoever_does_not_use_them_says_so(log):
    with pytest.warns(UserWarning, match="a particle filter does not use the relations of the log"):
        fastslam.FastSLAM1(log, particles=5, seed=0)
    with pytest.warns(UserWarning, match="the lectures' program does not use"):
        textbook.solve(log)
    left = log.at_steps(np.arange(10))
    assert any("relations are left out with their poses" in note for note in left.notes)
    assert len(associate_from(log).log.relations) == 30


def test_round_trips(bare, log, tmp_path):
    save(log, tmp_path / "log.npz")
    assert load(tmp_path / "log.npz").equals(log) and not log.equals(bare)
    finer = with_poses_every(log, 0.4)
    np.testing.assert_allclose(finer.times[finer.positions.steps], log.times[log.positions.steps], atol=1e-9)
    graph = Graph.from_log(measured(bare, lever=(0.0, 0.0)), edges="landmark+motion", kernel="none")
    written = relative_graph(graph)
    written.save_g2o(tmp_path / "graph.g2o")
    read = Graph.from_g2o(tmp_path / "graph.g2o")
    assert read.cost(read.initial) == pytest.approx(written.cost(written.initial), rel=1e-12)
    assert solve(read).cost == pytest.approx(solve(written).cost, rel=1e-9)
    with pytest.raises(GraphError, match="positions with a lever cannot be written"):
        relative_graph(Graph.from_log(log, kernel="none")).save_g2o(tmp_path / "lever.g2o")


RELATIONS = text(
    "t1,t2,dx,dy,dtheta,sigma_x,sigma_y,sigma_theta",
    [(0.2, 1.0, 0.4, 0, 0.1, 0.02, 0.02, 0.01), (3.5, 9.5, 1, 2, 0.3, 0.02, 0.02, 0.01)],
)
POSITIONS = text(
    "t,x,y,theta,sigma,sigma_theta,lever_x,lever_y",
    [(0.2, 1, 2, "", 0.1, "", 0.3, 0), (7.25, 3, 2, 0.4, 0.1, 0.02, 0.3, 0), (40, 3, 2, 0.4, 0.1, 0.02, 0.3, 0)],
)


def test_tables_give_poses_at_the_times_of_measurements(tmp_path):
    log = load(write_tables(tmp_path / "drive", relations=RELATIONS, positions=POSITIONS))
    times = sorted({*(row[0] for row in SEEN), 0.2, 1.0, 3.5, 9.5, 7.25})
    np.testing.assert_allclose(log.times, times, atol=1e-12)
    np.testing.assert_allclose(log.times[log.relations.second], [1.0, 9.5])
    np.testing.assert_allclose(log.times[log.positions.steps], [0.2, 7.25])
    np.testing.assert_allclose(log.positions.levers, [[0.3, 0], [0.3, 0]])
    np.testing.assert_allclose(log.positions.covariances[1].diagonal(), [0.01, 0.01, 4e-4])
    assert log.positions.oriented.tolist() == [False, True]
    assert "1 of 3 positions are from before or after the odometry: left out" in log.notes


def test_an_empty_heading_of_a_relation_is_not_known(tmp_path):
    for name, relations in {"of two": RELATIONS, "of one": "\n".join(RELATIONS.splitlines()[:2])}.items():
        found = load(write_tables(tmp_path / name, relations=relations.replace("0.4,0,0.1,", "0.4,0,,"))).relations
        assert found.covariances[0, 2, 2] == NO_HEADING
        np.testing.assert_allclose(found.covariances[1:, 2, 2], 1e-4)
        np.testing.assert_allclose(found.motions[0], [0.4, 0, 0])


def test_latitude_and_longitude_are_metres_from_the_first_fix(tmp_path):
    # a minute of arc in the latitude is 1,852 m within a hundredth, in the longitude cos(60 degrees) of it
    rows = [(7.25, 60 + 0.01 / 60, 25.0, 0.1), (0.2, 60.0, 25.0, 0.1), (9.5, 60.0, 25 + 0.01 / 60, 0.1)]
    log = load(write_tables(tmp_path / "drive", positions=text("t,lat,lon,sigma", rows)))
    np.testing.assert_allclose(log.positions.places[:, :2], [[0, 0], [0, 18.52], [9.26, 0]], atol=0.1)
    assert any("metres east and north of latitude 60.00000000, longitude 25.00000000" in note for note in log.notes)
    wrong = text("t,latitude,longitude,sigma", [(0.2, 125.0, 60.0, 0.1), (7.25, 125.0, 60.0, 0.1)])
    with pytest.raises(
        LogError, match=r"positions.csv:2: 125 is no latitude in degrees; are latitude and longitude exch"
    ):
        load(write_tables(tmp_path / "exchanged", positions=wrong))


@pytest.mark.parametrize(
    ("table", "old", "new", "message"),
    [
        ("relations", "0.1,0.02", "0.1,-0.02", r"relations.csv:2: the standard deviation of x is -0.02"),
        ("relations", "t1,t2", "from,to", r"'from' counts steps, which tables do not have"),
        ("relations", "0.2,1.0", "1.0,1.0", r"relations.csv:2: the relation goes from 1.000 s to the same time"),
        ("relations", "0.3,0.02", "170,0.02", r"relations.csv:3: the turn is 170 rad, beyond 2 pi: is it in degrees"),
        ("relations", "0.2,1.0", "0.2,101.0", r"1 of 2 relations are from before or after the odometry"),
        ("relations", "sigma_x", "spread", r"no column for sigma_x .* and none for cov_xx, cov_yy instead"),
        ("positions", "0.2,1,2,,0.1", "0.2,1,2,,0", r"positions.csv:2: the standard deviation of x is 0"),
        ("positions", "sigma_theta", "other", r"no column for sigma_theta"),
        ("positions", "7.25,3", "7.25,east", r"positions.csv:3: 'x' should be a number, not 'east'"),
    ],
)  # fmt: skip
def test_mistakes_in_tables_are_one_sentence(tmp_path, table, old, new, message):
    tables = {"relations": RELATIONS, "positions": POSITIONS}
    tables[table] = tables[table].replace(old, new, 1)
    folder = write_tables(tmp_path / "drive", **tables)
    if "left out" in message or "before or after" in message:
        assert any(message in note for note in load(folder).notes)
        return
    with pytest.raises(LogError, match=message):
        load(folder)


def test_covariances_and_clocks_that_cannot_be(tmp_path):
    header = "t1,t2,dx,dy,dtheta,cov_xx,cov_xy,cov_yy,cov_thetatheta"
    folder = write_tables(tmp_path / "a", relations=text(header, [(0, 1, 1, 0, 0, 0.01, 0.02, 0.01, 0.01)]))
    with pytest.raises(LogError, match=r"relations.csv:2: the covariance is not symmetric and positive definite"):
        load(folder)
    folder = write_tables(tmp_path / "b", positions="t,x,y,sigma\n50,1,1,1\n51,1,2,1\n")
    with pytest.raises(LogError, match=r"clocks='positions=-50' lets both begin together"):
        load(folder)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: AbsolutePositions(steps=[500], places=[[1, 2]], covariances=np.eye(2)), "the log has steps 0 to"),
        (lambda: AbsolutePositions(steps=[5], places=[[1, 2]], covariances=-np.eye(2)), "not symmetric and positive"),
        (lambda: AbsolutePositions(steps=[5], places=[[1, 2, 3]], covariances=np.eye(2)), "need covariances"),
        (lambda: AbsolutePositions(steps=[5], places=[1, 2], covariances=np.eye(2)), "must have shape"),
        (
            lambda: PoseRelations(first=[1], second=[1], motions=[[1, 0, 0]], covariances=np.eye(3)),
            "two different steps",
        ),
        (lambda: PoseRelations(first=[1.5], second=[2], motions=[[1, 0, 0]], covariances=np.eye(3)), "whole numbers"),
    ],
)
def test_impossible_records(bare, make, message):
    with pytest.raises(LogError, match=message):
        bare.replace(positions=make())


def test_closures_of_a_pose_graph(bare, tmp_path):
    graph = Graph.from_log(measured(bare).replace(positions=None), edges="virtual+motion", kernel="none")
    relative_graph(graph).save_g2o(tmp_path / "graph.g2o")
    plain = Graph.from_g2o(tmp_path / "graph.g2o")
    closures = plain.with_closures()
    assert closures.cost(plain.initial) == pytest.approx(plain.cost(plain.initial), rel=1e-12)
    assert Graph.from_g2o(tmp_path / "graph.g2o", kernel="huber").reweighted
    relations = next(f for f in closures.families if isinstance(f, RelationEdges))
    bad = relations.measured.copy()
    bad[::5] = [8.0, -7.0, 2.0]
    families = tuple(replace(f, measured=bad) if f is relations else f for f in closures.families)
    found = solve(replace(closures, families=families), method="gnc")
    assert np.all(found.other_trust["relations"][::5] < 0.5) and found.other_trust["relations"].mean() > 0.7
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert solve(plain).converged
