"""Association of sightings without ids: the search, the evidence, and logs whose answer is known."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graphslam import (
    Graph,
    GraphError,
    Log,
    LogError,
    MotionModel,
    OptionError,
    SensorModel,
    load,
    sample_log_path,
    save,
    simulate,
    solve,
)
from graphslam.association import assignment, associate_from, score
from graphslam.association.ambiguity import readable
from graphslam.association.assignment import Candidates, evidence, log_density
from graphslam.association.map_solution import MapSolution, Places, Problem, seen_from
from graphslam.association.problem import AssociationOptions, Densities
from graphslam.engine import engine
from graphslam.linear.cholesky import analyze
from graphslam.linear.information import BlockSystem
from graphslam.log import UNIDENTIFIED
from graphslam.log.measurements import PartialSightings
from graphslam.metrics import ate
from graphslam.se2 import difference

MOTION = MotionModel(nn=0.095, no=0.0005, on=0.065, oo=0.1, epsilon=2.5e-5)
SENSOR = SensorModel(range_rate=0.07, bearing_std=0.025)


def hidden(log: Log) -> Log:
    return replace(log, landmarks=np.full(len(log.steps), UNIDENTIFIED))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 3), st.integers(1, 3))
def test_search_finds_the_best_of_all_hypotheses(seed: int, items: int, landmarks: int) -> None:
    rng = np.random.default_rng(seed)
    item, landmark = (each.ravel() for each in np.meshgrid(np.arange(items), np.arange(landmarks), indexing="ij"))
    count = len(item)
    A = rng.normal(size=(2 * count, 2 * count))
    S = A @ A.T / count + np.eye(2 * count)
    nu, weights = rng.normal(size=(count, 2)), rng.normal(3.0, 1.0, size=count)
    noise = np.broadcast_to(np.eye(2), (count, 2, 2))
    best = 0.0
    for choice in product(range(-1, landmarks), repeat=items):
        used = [j for j in choice if j >= 0]
        if len(set(used)) < len(used) or not used:
            continue
        rows = [i * landmarks + j for i, j in enumerate(choice) if j >= 0]
        columns = [2 * c + k for c in rows for k in (0, 1)]
        density, _ = log_density(nu[rows].ravel(), S[np.ix_(columns, columns)])
        best = max(best, float(weights[rows].sum() + density))
    candidates, _ = Candidates.of(item, landmark, nu, S, weights, noise)
    chosen, evidence = candidates.best(1 - 1e-15)
    assert evidence == pytest.approx(best, abs=1e-9)
    assert np.count_nonzero(chosen >= 0) <= min(items, landmarks)


@pytest.mark.parametrize("d", [2, 3])
def test_derivatives_of_places_by_finite_differences(d: int) -> None:
    rng = np.random.default_rng(d)
    pose, places = rng.normal(size=3), rng.normal(size=(4, d))
    _, by_pose, by_landmark = seen_from(pose, places)
    for k in range(3):
        step = np.eye(3)[k] * 1e-6
        slope = (seen_from(pose + step, places)[0] - seen_from(pose - step, places)[0]) / 2e-6
        np.testing.assert_allclose(by_pose[:, :, k], slope, atol=1e-8)
    for k in range(d):
        step = np.eye(d)[k] * 1e-6
        slope = (seen_from(pose, places + step)[0] - seen_from(pose, places - step)[0]) / 2e-6
        np.testing.assert_allclose(by_landmark[:, :, k], slope, atol=1e-8)


def test_joint_covariance_is_a_part_of_the_inverse() -> None:
    first, n = np.arange(7), 8
    system = BlockSystem.from_cliques(n, [(np.arange(0, 15, 2), np.column_stack([first, first + 1]).ravel())])
    rng = np.random.default_rng(0)
    system.values[:] = rng.normal(size=system.values.shape) * 0.1
    system.values[system.diagonal_slots] = 3 * np.eye(3)
    inverse = np.linalg.inv(system.to_sparse().toarray()).reshape(n, 3, n, 3)
    nodes = np.array([1, 6, 4])
    for ordering in (None, np.array([0, 2, 3, 5, 7, 1, 6, 4])):
        factor = analyze(system.indptr, system.indices, ordering=ordering).factorize(system.values)
        assert factor.log_determinant == pytest.approx(np.linalg.slogdet(system.to_sparse().toarray())[1])
        part = inverse[np.ix_(nodes, range(3), nodes, range(3))].reshape(9, 9)
        np.testing.assert_allclose(factor.joint_covariance(nodes), part, atol=1e-12)


@pytest.mark.parametrize("psi", [True, False])
def test_evidence_for_one_landmark_instead_of_two_is_that_of_their_distance(psi: bool) -> None:
    log = load(sample_log_path())
    log = log if psi else log.without_orientation()
    problem = Problem.of(log, MotionModel(), log.sensor or SensorModel(), AssociationOptions())
    backbone = problem.backbone
    one = np.unique(log.landmarks, return_inverse=True)[1]
    both = np.where((one == 3) & (np.arange(len(one)) % 2 == 0), one.max() + 1, one)
    # no landmark is ever missed, so that only the landmarks count
    densities = Densities(np.log(0.3), np.log(0.01), -50.0, 0.0)
    a, b = (MapSolution.of(backbone, labels, log.dead_reckoning(MotionModel())) for labels in (one, both))
    problem = replace(problem, densities=densities)
    gained = evidence(problem, a) - evidence(problem, b)
    chosen, d = np.array([3, one.max() + 1]), b.landmarks.shape[1]
    P = b.joint_covariance(chosen)
    S = P[0, :, 0] + P[1, :, 1] - P[0, :, 1] - P[1, :, 0]
    nu = difference(b.landmarks[chosen[0]], b.landmarks[chosen[1]])
    assert nu.shape == (d,)
    assert gained == pytest.approx(float(log_density(nu, S)[0] - densities.new), abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("psi", [True, False])
def test_sample_log_with_hidden_ids(psi: bool) -> None:
    log = load(sample_log_path())
    log = log if psi else log.without_orientation()
    found = associate_from(hidden(log))
    assert found.landmarks == len(log.landmark_ids)
    result = score(found.ids, log.landmarks)
    assert (result.precision, result.recall) == (1.0, 1.0)
    assert (result.found, result.missed, result.doubled, result.invented) == (13, 0, 0, 0)
    assert found.log.identified and "13 landmarks" in found.notes[0]


def cluttered(seed: int) -> Log:
    """A clean drive at half of the noise, without psi, with a tenth of its sightings missing and a tenth of false ones."""
    log = simulate(seed=seed, clean=True, orientation=False, motion=MOTION, sensor=SENSOR)
    rng = np.random.default_rng(seed)
    kept = rng.random(len(log.steps)) > 0.1
    count = int(0.1 * kept.sum())
    false = np.column_stack([rng.uniform(0.6, 6, count), rng.uniform(-1, 1, count)])
    steps = np.concatenate([log.steps[kept], rng.integers(0, log.num_poses, count)])
    order = np.argsort(steps, kind="stable")
    ids = np.concatenate([log.landmarks[kept], np.full(count, UNIDENTIFIED)])
    z = np.concatenate([log.sightings[kept], false])
    return replace(log, steps=steps[order], landmarks=ids[order], sightings=z[order])


def test_a_search_takes_a_limited_number_of_pairs_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """MR.CLAM 6 robot 3 without ids begins with 33,455 pairs of landmarks that may be one: all at once take 33 GiB."""
    log, decided, sizes = load(sample_log_path()), assignment._decided, list[int]()
    whole = associate_from(log)

    def recorded(solved: Any, item: np.ndarray, *rest: Any) -> Any:
        sizes.append(len(item))
        return decided(solved, item, *rest)

    monkeypatch.setattr(assignment, "_decided", recorded)
    associate_from(log)
    assert max(sizes) > 2
    sizes.clear()
    monkeypatch.setattr(assignment, "MOST_PAIRS", 2)
    few = associate_from(log)
    assert max(sizes) == 2
    assert few.landmarks == whole.landmarks == 13 and np.array_equal(few.ids, whole.ids)


@pytest.mark.slow
def test_less_likely_pairs_are_tried_where_the_likely_ones_lead_to_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[tuple[int, ...]] = []

    def nothing(solved: Any, item: np.ndarray, other: np.ndarray, *rest: Any) -> list[assignment.Merge]:
        calls.append(tuple(zip(item.tolist(), other.tolist())))
        return []

    monkeypatch.setattr(assignment, "_decided", nothing)
    log = load(sample_log_path())
    associate_from(log)
    at_once = {pair for call in calls for pair in call}
    calls.clear()
    monkeypatch.setattr(assignment, "MOST_PAIRS", 2)
    associate_from(log)
    assert {pair for call in calls for pair in call} == at_once and max(map(len, calls)) == 2


def test_clutter_and_misses() -> None:
    exact, precise = 0, []
    for seed in range(6):
        log = cluttered(seed)
        found = associate_from(hidden(log), motion=MOTION, sensor=SENSOR)
        exact += found.landmarks == len(log.landmark_ids)
        precise.append(score(found.ids, log.landmarks).precision)
    assert exact == 6 and np.mean(precise) > 0.95


def test_the_gate_of_a_sighting_is_that_of_the_covariance_of_its_landmark() -> None:
    """Along the widest direction of a landmark whose coordinates are correlated."""
    own, gate = np.array([[[1.0, 0.99], [0.99, 1.0]]]), assignment.gates(0.999, 2, 1)[1]
    far = np.sqrt(np.linspace(0.05, 0.99, 20) * gate * (1.99 + 1e-4) / 2)
    seen = Places(np.column_stack([far, far]), np.tile(1e-4 * np.eye(2), (20, 1, 1)))
    chosen, _ = assignment.assign(
        seen, np.arange(20), np.zeros((1, 2)), own, 0.999, lambda item, _: np.full(len(item), 50.0)
    )
    assert np.all(chosen == 0)


def test_each_sighting_by_itself_finds_clear_landmarks() -> None:
    log = load(sample_log_path())
    found = associate_from(log, method="nearest")
    assert found.landmarks == 13 and score(found.ids, log.landmarks).precision == 1


def test_ids_of_the_log_are_not_used() -> None:
    log = load(sample_log_path())
    np.testing.assert_array_equal(associate_from(log).ids, associate_from(hidden(log)).ids)


def test_ids_that_are_found_are_none_of_the_ranges_alone() -> None:
    log = hidden(load(sample_log_path())).without_orientation()
    steps, beacons = np.arange(0, 160, 4), np.arange(40) % 3
    far = np.hypot(*(log.true_poses[steps, :2] - np.array([[9.0, 9.0], [-9.0, 9.0], [0.0, -12.0]])[beacons]).T)
    alone = PartialSightings(steps=steps, landmarks=beacons, ranges=far, bearings=np.full(40, np.nan))
    found = associate_from(log.replace(partial_sightings=alone))
    assert found.landmarks == 13 and np.array_equal(np.unique(found.ids), np.arange(3, 16))
    solution = solve(Graph.from_log(found.log, kernel="none"))
    # with the ids of the beacons for other landmarks J per degree of freedom would be 2.5
    assert len(solution.landmarks) == 16 and solution.cost < solution.graph.degrees_of_freedom


def test_scores() -> None:
    truth = np.array([7, 7, 7, 8, 8, UNIDENTIFIED, 9])
    ids = np.array([0, 0, 1, 2, 2, 3, UNIDENTIFIED])
    result = score(ids, truth)
    assert result.precision == pytest.approx(4 / 6) and result.recall == pytest.approx(4 / 6)
    assert (result.found, result.missed, result.doubled, result.invented) == (2, 1, 1, 1)
    nothing = score(np.full(7, UNIDENTIFIED), truth)
    assert nothing.precision is None and nothing.recall == 0.0 and nothing.missed == 3
    with pytest.raises(OptionError, match="one shape"):
        score(ids, truth[1:])


def test_logs_that_tell_nothing() -> None:
    log = hidden(load(sample_log_path()))
    empty = replace(log, steps=log.steps[:0], landmarks=log.landmarks[:0], sightings=log.sightings[:0])
    with pytest.raises(GraphError, match="no sightings at all"):
        associate_from(empty)
    still = Log(initial_poses=np.zeros((2, 3)), steps=[0], landmarks=[UNIDENTIFIED], sightings=[[1.0, 0.0]])
    with pytest.raises(LogError, match="no controls"):
        associate_from(still)
    for name, value in {
        "method": "guess",
        "gate": "wide",
        "factor": "100",
        "slip": "no",
        "keep_ids": 1,
        "tries": -1,
    }.items():
        with pytest.raises(OptionError, match=f"{name} must .*{value}"):
            associate_from(log, **{name: value})


@pytest.mark.slow
def test_clutter_alone_is_said() -> None:
    """Random sightings agree by chance: the landmarks are few, and a note says so. Where none agree, the log is refused."""
    log, count = hidden(load(sample_log_path())), 40
    for seed in range(6):
        z = np.random.default_rng(seed).uniform([1, -3, -3], [6, 3, 3], (count, 3))
        clutter = replace(log, steps=np.arange(count) * 4, landmarks=log.landmarks[:count], sightings=z)
        found = associate_from(clutter)
        assert found.landmarks <= 5 and found.clutter > count / 2
        assert any("most sightings are of no landmark" in note for note in found.notes)
    # at places 10 m from each other none agree; where few do, but contradict the motions, the graph diverges
    for apart, count, sensor in ((3, 20, SensorModel.constant(0.1, 0.01)), (10, 10, None)):
        z = z[:count]
        z[:, 0] = 5 + apart * np.arange(count)
        few = replace(clutter, steps=clutter.steps[:count], landmarks=clutter.landmarks[:count], sightings=z)
        with pytest.raises(GraphError, match=f"no landmark .* all its {count} sightings may be clutter"):
            associate_from(few.without_orientation(), sensor=sensor)


def test_one_landmark_is_said() -> None:
    log = load(sample_log_path())
    one = log.landmarks == log.landmark_ids[0]
    alone = replace(log, steps=log.steps[one], landmarks=log.landmarks[one], sightings=log.sightings[one])
    found = associate_from(hidden(alone))
    assert found.landmarks == 1
    assert any("one landmark alone" in note for note in found.notes)


def pair_of_cones(apart: float) -> Log:
    """A robot drives past two cones of different classes again and again; a tenth of the classes are wrong."""
    rng = np.random.default_rng(0)
    controls = np.tile([0.3, 0.0], (80, 1))
    controls[:, 0] *= np.repeat([1, -1, 1, -1], 20)
    poses = MotionModel().dead_reckoning(np.zeros(3), controls, 1.0)
    cones = np.array([[8.0, 1.0], [8.0, 1.0 + apart]])
    sensor = SensorModel.constant(0.3, 0.03)
    # one of the two at a time, so that no scan tells that they are two
    which = rng.integers(0, 2, len(poses))
    seen = sensor.h(poses, cones[which]) + rng.normal(size=(len(poses), 2)) * [0.3, 0.03]
    shown = np.where(rng.random(len(poses)) < 0.05, 1 - which, which)
    return Log(
        dt=1.0, controls=controls, steps=np.arange(len(poses)), landmarks=which, sightings=seen, classes=shown, sensor=sensor,
        motion=MotionModel.constant(0.01, 0.003, epsilon=1e-6), initial_poses=poses,
    )  # fmt: skip


def test_classes_keep_neighbours_apart(tmp_path: Path) -> None:
    log = pair_of_cones(0.5)
    assert associate_from(log).landmarks == 2
    assert score(associate_from(log).ids, log.landmarks).precision > 0.85
    without = score(associate_from(replace(log, classes=None)).ids, log.landmarks)
    assert without.precision < score(associate_from(log).ids, log.landmarks).precision - 0.05
    save(log, tmp_path / "cones.npz")
    np.testing.assert_array_equal(load(tmp_path / "cones.npz").classes, log.classes)
    near = log.nearer_than(6.0)
    assert len(near.classes) == len(near.steps) < len(log.steps)
    with pytest.raises(LogError, match="classes must have one entry per sighting"):
        replace(log, classes=log.classes[1:])


def test_starts_compete_until_two_end_alike() -> None:
    log = load(sample_log_path())
    poses = log.dead_reckoning(MotionModel())
    called = []

    def right() -> tuple[np.ndarray, np.ndarray]:
        called.append("right")
        return log.landmarks, poses

    def never() -> tuple[np.ndarray, np.ndarray]:
        raise AssertionError("two starts have ended alike")

    found = associate_from(hidden(log), start=[right, right, never])
    assert called == ["right", "right"] and score(found.ids, log.landmarks).precision == 1.0
    verdict = found.verdict
    assert verdict.reliable and (verdict.starts, verdict.agreeing, verdict.reasons) == (2, 2, ())
    assert any(note.startswith("the map can be relied on: 2 starts") for note in found.notes)
    # the positions of the aligned trajectory are as uncertain as they are wrong
    assert 0.3 < ate(log.true_poses, found.poses) / verdict.deviation < 3
    one = associate_from(hidden(log), start=[right]).verdict
    assert not one.reliable and one.reasons[0].startswith("only one start")
    every = associate_from(hidden(log), start=[right, right, right], agreeing=0).verdict
    assert (every.starts, every.agreeing) == (3, 3)


def test_a_wrong_start_brings_in_the_next_one() -> None:
    """A wrong end is outdone by evidence, and the ends that agree are counted."""
    log = load(sample_log_path()).without_orientation()
    poses = log.dead_reckoning(MotionModel())
    # each landmark is another one in the second round, and no alternative of the drive is tried
    apart = log.landmarks + 100 * (log.steps > 80)
    found = associate_from(hidden(log), start=[(apart, poses + [0, 0, 0.0]), (log.landmarks, poses), None], tries=0)
    assert score(found.ids, log.landmarks).precision == 1.0 and found.verdict.agreeing >= 2


def test_factors_of_evidence_are_readable() -> None:
    assert [readable(np.log(x)) for x in (1.5, 42.0, 12_345.0)] == ["1.5", "42", "12,345"]
    assert readable(206.17) == "10^90"


def test_views_are_counted_in_the_same_field_in_the_engine_and_here():
    """All views of a landmark, and those in which it was seen: a miss is counted where the two differ."""
    rng = np.random.default_rng(0)
    poses, landmarks = rng.uniform(-3, 3, (40, 3)), rng.uniform(-5, 5, (30, 2))
    origin, limits = np.array([0.2, -0.1]), np.array([[0.5, 4.0, np.cos(1.0)], [0.3, 5.0, np.cos(2.0)]])
    pairs = np.array(list(product(range(40), range(30))))
    inside = assignment._inside(poses[pairs[:, 0]], landmarks[pairs[:, 1]], origin, limits)
    counted = engine.count_views(poses, landmarks, origin, limits)
    np.testing.assert_array_equal([np.bincount(pairs[:, 1], each) for each in inside], counted)
    assert 0 < np.sum(counted[0]) < np.sum(counted[1]) < len(pairs)
