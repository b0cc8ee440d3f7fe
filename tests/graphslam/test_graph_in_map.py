"""Graphs with a map: both solvers agree, localisation by hand, and the joint prior is all that a session knows."""

from itertools import product

import numpy as np
import pytest
from scipy.optimize import least_squares
from sessions import joint_graph, sessions

from graphslam import (
    Graph,
    GraphError,
    LandmarkMap,
    MotionModel,
    OnlineSolver,
    SensorModel,
    estimate_map,
    first_fix,
    simulate,
    solve,
    solve_many,
    solve_online,
    solve_with_gtsam,
)
from graphslam.graph.transform import relative_graph
from graphslam.se2 import compose, wrap

BOOK = {"motion": MotionModel(), "sensor": SensorModel()}


def maps_of(log):
    """The true map of a log in all its uses: exact, with own and joint priors, with headings and without, a part of it."""
    true = LandmarkMap(log.true_landmarks)
    flat = {j: m[:2] for j, m in true.items()}
    A = np.random.default_rng(0).normal(size=(18, 18))
    joint = 0.01 * A @ A.T / 18 + 0.001 * np.eye(18)
    own = {j: np.diag([0.01, 0.02, 0.03]) for j in true}
    some = dict(list(true.items())[:4])
    return {
        "exact": true,
        "exact, without headings": LandmarkMap(flat),
        "some exact": LandmarkMap(some),
        "own": LandmarkMap(true, own),
        "own, without headings": LandmarkMap(flat, {j: C[:2, :2] for j, C in own.items()}),
        "some own, some exact": LandmarkMap(true, {j: own[j] for j in list(true)[:3]}),
        "joint": LandmarkMap(true, joint=joint),
        "joint, without headings": LandmarkMap(flat, joint=joint[:12, :12]),
        "some joint, some exact": LandmarkMap(true, joint=joint[:9, :9], joint_ids=list(true)[:3]),
        "of other landmarks, too": LandmarkMap({**true, 77: (1.0, 1.0, 0.0), 99: (2.0, 2.0)}, {99: 0.1 * np.eye(2)}),
    }


LOG = simulate(seed=1)
KINDS = list(maps_of(LOG))


def variants():
    """Each map with and without psi, with a kernel and without; half of them at night, in which any two occur, too."""
    for number, kind in enumerate(KINDS):
        for oriented, kernel in product([True, False], ["none", "cauchy"]):
            marks = [pytest.mark.nightly] * ((number + oriented + (kernel == "none")) % 2)
            yield pytest.param(kind, oriented, kernel, marks=marks)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "oriented", "kernel"), list(variants()))
def test_both_solvers_have_one_solution(kind, oriented, kernel):
    log = LOG if oriented else LOG.without_orientation()
    graph = Graph.from_log(log, map=maps_of(LOG)[kind], kernel=kernel)
    ours, theirs = solve(graph), solve_with_gtsam(graph)
    assert ours.converged and theirs.converged
    difference = ours.state - theirs.state
    difference[:, 2] = wrap(difference[:, 2])
    assert np.abs(difference).max() < 1e-8
    assert ours.cost == pytest.approx(theirs.cost, rel=1e-10)
    for j, place in maps_of(LOG)[kind].items():
        if j not in maps_of(LOG)[kind].covariances and j in ours.landmarks:
            assert np.array_equal(ours.landmarks[j][:2], place[:2])


@pytest.mark.slow
def test_a_map_by_hand():
    """The poses on an exact map, and a landmark that is not on it, by SciPy from the definitions in the lectures."""
    log = simulate(seed=2, steps=12, clean=True, orientation=False)
    known = {j: m[:2] for j, m in log.true_landmarks.items() if j != 0}
    solution = solve(Graph.from_log(log, map=known, kernel="none"))
    motion, sensor = MotionModel(), SensorModel()
    assert log.controls is not None

    def residuals(state):
        poses, added = state[:-2].reshape(-1, 3), state[-2:]
        rows = []
        for t, j, (r, phi) in zip(log.steps, log.landmarks, log.sightings):
            x, y, theta = poses[t]
            c, s = np.cos(theta), np.sin(theta)
            dx, dy = known.get(j, added) - (x, y)
            e = np.array([c * dx + s * dy - r * np.cos(phi), -s * dx + c * dy - r * np.sin(phi)])
            L = np.array([[np.cos(phi), -r * np.sin(phi)], [np.sin(phi), r * np.cos(phi)]])
            C = L @ np.diag([(r * sensor.range_rate) ** 2, sensor.bearing_std**2]) @ L.T
            rows.append(np.linalg.solve(np.linalg.cholesky(C), e))
        for t, (u, dt) in enumerate(zip(log.controls, log.dt)):
            x, y, theta = poses[t]
            reached = motion.f(np.zeros(3), u, dt)
            c, s = np.cos(theta), np.sin(theta)
            dx, dy, turn = poses[t + 1] - poses[t]
            e = np.array([c * dx + s * dy - reached[0], -s * dx + c * dy - reached[1], wrap(turn - reached[2])])
            rows.append(np.linalg.solve(np.linalg.cholesky(motion.covariance(np.zeros(3), u, dt)), e))
        return np.concatenate(rows)

    start = np.append(log.true_poses.ravel(), log.true_landmarks[0][:2])
    by_hand = least_squares(residuals, start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    poses = by_hand.x[:-2].reshape(-1, 3)
    assert np.allclose(solution.poses[:, :2], poses[:, :2], atol=1e-6)
    assert np.abs(wrap(solution.poses[:, 2] - poses[:, 2])).max() < 1e-6
    assert np.allclose(solution.landmarks[0], by_hand.x[-2:], atol=1e-6)
    assert solution.cost == pytest.approx(2 * by_hand.cost, rel=1e-9)
    covariance = np.linalg.inv(by_hand.jac.T @ by_hand.jac)
    assert np.allclose(solution.covariance(5), covariance[15:18, 15:18], rtol=1e-3, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("orientation", [True, False])
@pytest.mark.parametrize(("noise", "sigmas", "spread"), [(1.0, 0.03, 0.01), (0.1, 5e-4, 1e-3), (0.01, 2e-5, 2e-4)])
def test_the_map_of_a_session_is_all_that_the_next_one_needs(noise, sigmas, spread, orientation):
    """Session 1 as a joint prior of session 2 is the graph of both, the more exactly the more linear they are."""
    first, second = sessions(noise, orientation=orientation)
    options = {"edges": "landmark+motion", "kernel": "none"}
    known = solve(Graph.from_log(first, **options)).map
    placed = Graph.from_log(second, map=known, **options)
    session = solve(placed)
    both = solve(joint_graph(first, second, placed))
    P, Q = first.num_poses, second.num_poses
    difference = both.state[P : P + Q] - session.state[:Q]
    difference[:, 2] = wrap(difference[:, 2])
    deviations = np.sqrt(np.diagonal(session.covariance(), axis1=1, axis2=2))
    assert np.abs(difference / deviations).max() < sigmas
    jointly = np.sqrt([np.diagonal(both.covariance(P + k)) for k in range(Q)])
    assert np.abs(jointly / deviations - 1).max() < spread
    # the next map is that of both
    d = placed.landmark_dimension
    deviations = np.sqrt(np.diagonal(session.map.joint)).reshape(-1, d)
    assert np.abs((both.state[P + Q :, :d] - session.state[Q:, :d]) / deviations).max() < sigmas


def test_the_joint_map_of_a_graph_without_landmark_nodes_is_that_of_one_with_them():
    log = simulate(seed=5, clean=True)
    nodes = solve(Graph.from_log(log, edges="landmark+motion", kernel="none")).map
    marginal = solve(Graph.from_log(log, edges="virtual+motion", weight="marginal", kernel="none")).map
    assert list(nodes) == list(marginal)
    assert np.allclose(nodes.joint, marginal.joint, rtol=1e-5, atol=1e-9)
    assert np.allclose(np.array(list(nodes.values())), np.array(list(marginal.values())), atol=1e-7)
    # not only the covariances given the poses
    given = estimate_map(log, solve(Graph.from_log(log, edges="landmark+motion", kernel="none")).poses)
    assert all(np.trace(nodes.covariances[j]) > 1.5 * np.trace(given.covariances[j]) for j in nodes)


def test_joint_covariances_may_be_those_of_landmarks_that_the_log_does_not_see():
    known = {**LOG.true_landmarks, 900: (50.0, 50.0), 901: (52.0, 50.0)}
    joint = LandmarkMap(known, joint=1e-4 * np.eye(4) + 1e-5, joint_ids=[900, 901])
    poses = [solve(Graph.from_log(LOG, map=each)).poses for each in (joint, LandmarkMap(known))]
    assert np.allclose(*poses, atol=1e-6)


def test_the_next_map_keeps_what_the_log_did_not_see():
    known = maps_of(LOG)["of other landmarks, too"]
    after = solve(Graph.from_log(LOG, map=known)).map
    assert list(after) == list(known)
    assert all(np.array_equal(after[j], known[j]) for j in known)
    assert list(after.covariances) == [99] and np.allclose(after.covariances[99], known.covariances[99])
    some = LandmarkMap(dict(list(known.items())[:3]), classes={0: "red"})
    more = solve(Graph.from_log(LOG, map=some)).map
    assert set(more) == set(LOG.landmark_ids.tolist()) and more.classes == {0: "red"}
    assert set(more.covariances) == set(more) - set(some)


def test_the_start_of_the_log_does_not_matter_and_the_map_can_be_anywhere():
    frame = np.array([30.0, -20.0, 2.0])
    moved = LOG.replace(initial_poses=compose(np.array([-5.0, 5.0, -3.0]), LOG.initial_poses))
    here = solve(Graph.from_log(LOG, map=LOG.true_landmarks))
    there = solve(Graph.from_log(moved, map={j: compose(frame, m) for j, m in LOG.true_landmarks.items()}))
    expected = compose(frame, here.poses)
    assert np.allclose(there.poses[:, :2], expected[:, :2], atol=1e-6)
    assert there.cost == pytest.approx(here.cost, rel=1e-9)


def test_localisation_on_an_exact_map_is_certified_and_a_joint_prior_is_not():
    assert solve(Graph.from_log(LOG, map=maps_of(LOG)["exact"])).certificate.status == "global"
    assert solve(Graph.from_log(LOG, map=maps_of(LOG)["own"])).certificate.applicable
    joint = solve(Graph.from_log(LOG, map=maps_of(LOG)["joint"])).certificate
    assert joint.status == "not applicable" and "joint prior of a map" in joint.reason


def test_degrees_of_freedom_count_what_the_map_says():
    plain = Graph.from_log(LOG, edges="landmark+motion")
    d, count = 3, len(LOG.landmark_ids)
    assert Graph.from_log(LOG, map=maps_of(LOG)["exact"]).degrees_of_freedom == plain.degrees_of_freedom - 3 + d * count
    for kind in ("own", "joint"):
        assert (
            Graph.from_log(LOG, map=maps_of(LOG)[kind]).degrees_of_freedom == plain.degrees_of_freedom - 3 + d * count
        )


@pytest.mark.slow
@pytest.mark.parametrize("initialize", ["given", "dead-reckoning", "rotation-first", "grow"])
@pytest.mark.parametrize("kind", ["exact", "own", "joint"])
def test_every_start_leads_to_the_solution(kind, initialize):
    log = simulate(seed=3, clean=True, **BOOK)
    graph = Graph.from_log(log, map=maps_of(log)[kind])
    assert solve(graph, initialize=initialize).cost == pytest.approx(solve(graph).cost, rel=1e-6)


def test_misread_ids_are_no_part_of_the_solution():
    log = simulate(seed=4, clean=True)
    ids = log.landmarks.copy()
    rng = np.random.default_rng(0)
    misread = rng.random(len(ids)) < 0.1
    ids[misread] = (ids[misread] + rng.integers(1, 6, misread.sum())) % 6
    clean = solve(Graph.from_log(log, map=log.true_landmarks))
    for solved in (
        solve(Graph.from_log(log.replace(landmarks=ids), map=log.true_landmarks, kernel="geman-mcclure")),
        solve(Graph.from_log(log.replace(landmarks=ids), map=log.true_landmarks), method="gnc"),
    ):
        deviations = np.sqrt(np.diagonal(clean.covariance(), axis1=1, axis2=2))
        error = solved.poses - clean.poses
        error[:, 2] = wrap(error[:, 2])
        assert np.sqrt(np.mean((error / deviations) ** 2)) < 1.0


@pytest.mark.slow
@pytest.mark.parametrize(("oriented", "above", "sigmas"), [(False, 1e-6, 1e-3), (True, 1e-4, 0.05)])
@pytest.mark.parametrize("kind", ["exact", "own", "joint", "some joint, some exact", "of other landmarks, too"])
def test_step_by_step_the_solution_is_the_same(kind, oriented, above, sigmas):
    """Priors of landmarks with headings are linearised where the map has them, so that J ends a little higher."""
    log = LOG if oriented else LOG.without_orientation()
    graph = Graph.from_log(log, map=maps_of(LOG)[kind])
    costs = []
    batch, steps = solve(graph), solve_online(graph, callback=lambda solver: costs.append(solver.cost))
    assert steps.cost == pytest.approx(batch.cost, rel=above)
    # with the priors of the map, and without that of the first pose
    assert costs[-1] == pytest.approx(steps.cost, rel=1e-6)
    difference = steps.poses - batch.poses
    difference[:, 2] = wrap(difference[:, 2])
    deviations = np.sqrt(np.diagonal(batch.covariance(), axis1=1, axis2=2))
    assert np.abs(difference / deviations).max() < sigmas


def test_an_online_solver_begins_with_a_map():
    log, known = LOG.without_orientation(), {j: m[:2] for j, m in LOG.true_landmarks.items()}
    fix = first_fix(log, known)
    solver = OnlineSolver(fix.pose, map=known, start_covariance=4 * fix.covariance)
    assert set(solver.landmarks) == set(known)
    for t in range(log.num_poses):
        seen = log.steps == t
        here = {"ids": log.landmarks[seen], "sightings": log.sightings[seen]}
        if t == 0:
            solver.observe(**here)
        else:
            solver.move(log.controls[t - 1], log.dt[t - 1])
            solver.observe(**here)
    batch = solve(Graph.from_log(log, map=known, kernel="cauchy"))
    error = solver.poses[-1] - batch.poses[-1]
    assert np.all(np.abs(error) < 0.1 * np.sqrt(np.diagonal(batch.covariance(log.num_poses - 1))))
    assert np.allclose(solver.covariance(), batch.covariance(log.num_poses - 1), rtol=0.05, atol=1e-7)
    assert np.allclose(solver.landmarks[0], known[0], atol=1e-4)


def test_many_graphs_with_maps_are_solved_alike():
    graphs = [Graph.from_log(LOG, map=maps_of(LOG)[kind]) for kind in ("exact", "own", "joint")]
    for one, graph in zip(solve_many(graphs), graphs):
        assert one.cost == pytest.approx(solve(graph).cost, rel=1e-9)


@pytest.mark.parametrize("oriented", [True, False])
def test_an_exact_map_is_kept_by_g2o_files(oriented, tmp_path):
    log = LOG if oriented else LOG.without_orientation()
    solution = solve(Graph.from_log(log, map=LOG.true_landmarks))
    relative_graph(solution.graph, state=solution.state).save_g2o(tmp_path / "map.g2o")
    again = solve(Graph.from_g2o(tmp_path / "map.g2o"))
    assert again.cost == pytest.approx(solution.cost, rel=1e-9)
    with pytest.raises(GraphError, match="no line for the priors of a map"):
        relative_graph(Graph.from_log(log, map=maps_of(LOG)["own"]))


@pytest.mark.slow
def test_a_map_needs_landmark_nodes_motions_and_ids():
    with pytest.raises(GraphError, match=r"use edges='landmark\+motion'"):
        Graph.from_log(LOG, map=LOG.true_landmarks, edges="virtual+motion")
    with pytest.raises(GraphError, match="no controls"):
        Graph.from_log(LOG.replace(controls=None, dt=None), map=LOG.true_landmarks)
    with pytest.raises(GraphError, match="without ids"):
        Graph.from_log(LOG.replace(landmarks=np.full(len(LOG.steps), -1)), map=LOG.true_landmarks)


@pytest.mark.parametrize("name", ["bearing_bias", "range_scale", "sensor_ahead", "wheel_scale"])
@pytest.mark.parametrize("method", [solve, solve_with_gtsam])
def test_an_exact_map_tells_the_parameters_of_the_robot(name, method):
    log = simulate(seed=1, steps=20, clean=True)
    log = log.replace(sightings=log.sightings + [0, 0.1, 0.1])
    flat = {j: m[:2] for j, m in log.true_landmarks.items()}
    nearly = LandmarkMap(flat, dict.fromkeys(flat, 1e-9 * np.eye(2)))
    exact, other = (method(Graph.from_log(log, map=known, dimensions=2, estimate=[name])) for known in (flat, nearly))
    assert exact.converged
    assert exact.cost == pytest.approx(other.cost, rel=1e-5)
    assert exact.parameters[name] == pytest.approx(other.parameters[name], abs=1e-5)
    assert exact.parameters.deviations[name] == pytest.approx(other.parameters.deviations[name], rel=1e-4)
    assert all(np.array_equal(exact.landmarks[j], flat[j]) for j in flat)


@pytest.mark.parametrize("use", ["joint", "own", "fixed"])
def test_the_map_of_a_log_without_psi_keeps_the_headings_of_the_given_map(use):
    """They turn with the places as the map correlates them: the posterior of all coordinates by what the log says of x, y."""
    known = solve(Graph.from_log(simulate(seed=1))).map.used_as(use)
    found = solve(Graph.from_log(simulate(seed=2).without_orientation(), map=known, edges="landmark+motion")).map
    assert all(len(place) == 3 for place in found.values())
    if use == "fixed":
        assert found == known
        return
    ids, before = list(known), np.concatenate(list(known.values()))
    C, after = known.between(ids).transpose(0, 2, 1, 3).reshape(3 * len(ids), -1), np.concatenate(list(found.values()))
    xy = np.flatnonzero(np.arange(len(C)) % 3 < 2)
    P = found.joint[np.ix_(xy, xy)]
    said = np.zeros_like(C)
    said[np.ix_(xy, xy)] = np.linalg.inv(P) - np.linalg.inv(C[np.ix_(xy, xy)])
    expected = np.linalg.inv(np.linalg.inv(C) + said)
    np.testing.assert_allclose(found.joint, expected, rtol=1e-4, atol=1e-7)
    moved = expected[:, xy] @ np.linalg.solve(P, after[xy] - before[xy])
    np.testing.assert_allclose(wrap(after - before - moved), 0.0, atol=1e-6)
