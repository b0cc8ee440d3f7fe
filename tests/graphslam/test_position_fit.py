"""Notes on positions, relations, slips and noise models that the log contradicts."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import block_diag

from comparisons.show.language import translated
from graphslam import (
    AbsolutePositions,
    Drive,
    Graph,
    LandmarkMap,
    MotionModel,
    PoseRelations,
    SensorModel,
    estimate_robot,
    join_logs,
    simulate,
    solve,
)
from graphslam.edges import SightingEdges
from graphslam.log.geometry import datum_note, on_plane_of
from graphslam.metrics import ate
from graphslam.se2 import between, difference, mounted, turned_by
from graphslam.solvers.uncertainty import Uncertainty

LEVER, NOISE = "the positions fit better", "the errors of the positions"
LASTING = "errors of absolute positions last"
ROBOT = {"motion": MotionModel(nn=0.05, on=0.03, oo=0.05), "sensor": SensorModel(range_rate=0.02, bearing_std=0.02)}


def notes_on_positions(
    seed, *, antenna=(0.0, 0.0), stated=(0.0, 0.0), sigma=0.2, said=0.2, wrong=0.0, kernel="cauchy", turns=0.4
):
    """The notes on positions of an antenna, and the solution; a part of them is metres off."""
    log = simulate(seed=seed, steps=120, clean=True, orientation=False, turn_rate=turns, max_range=5.0, **ROBOT)
    log, rng = log.replace(**ROBOT), np.random.default_rng(seed)
    steps = np.arange(0, log.num_poses, 2)
    places = mounted(log.true_poses[steps], antenna)[:, :2] + sigma * rng.standard_normal((len(steps), 2))
    places[rng.random(len(steps)) < wrong] += 5.0
    positions = AbsolutePositions(steps=steps, places=places, covariances=said**2 * np.eye(2), levers=stated)
    solution = solve(Graph.from_log(log.replace(positions=positions), edges="landmark+motion", kernel=kernel))
    return [note for note in solution.notes if note.startswith((LEVER, NOISE, LASTING))]


@pytest.mark.parametrize("seed", range(5))
def test_right_positions_have_no_note(seed):
    assert notes_on_positions(seed) == []
    assert notes_on_positions(seed, wrong=0.2) == []
    assert notes_on_positions(seed, antenna=(0.5, -0.3), stated=(0.5, -0.3), kernel="none") == []


@pytest.mark.parametrize("kernel", ["none", "cauchy"])
@pytest.mark.parametrize("seed", range(3))
def test_a_lever_that_nobody_has_stated(seed, kernel):
    (note,) = notes_on_positions(seed, antenna=(0.8, -0.4), sigma=0.05, said=0.05, kernel=kernel)
    assert note.startswith(LEVER)
    ahead, left = (float(note.partition(after)[0].split()[-2]) for after in (" ahead and", " left of"))
    assert (ahead, left) == pytest.approx((0.8, -0.4), abs=0.15)


@pytest.mark.parametrize(
    ("shift", "off"), [((0.0, 0.0), 0.0), ((80.0, 60.0), 0.0), ((1.1, -1.4), 0.0), ((0.0, 0.0), 0.3)]
)
@pytest.mark.parametrize("seed", range(2))
def test_positions_in_another_frame_than_the_map(seed, shift, off):
    """The note was on the lever of an antenna, 68 m ahead, on covariances alone, on the map, or on lasting errors."""
    world = {"landmarks": np.random.default_rng(seed).uniform(-7, 7, (14, 2)), "max_range": 8.0, "steps": 60}
    first, log = (
        simulate(seed=seed + k, clean=True, orientation=False, **world, **ROBOT).replace(**ROBOT) for k in (0, 50)
    )
    steps = np.arange(0, log.num_poses, 2)
    places = log.true_poses[steps, :2] + np.random.default_rng(seed).normal(shift, 0.3, (len(steps), 2))
    positions = AbsolutePositions(steps=steps, places=places, covariances=0.09 * np.eye(2))
    known = solve(Graph.from_log(first, edges="landmark+motion")).map
    wrong = {j: place + np.random.default_rng(seed + j).normal(0, off, 2) for j, place in known.items()}
    known = LandmarkMap(wrong, joint=known.joint)
    notes = solve(Graph.from_log(log.replace(positions=positions), map=known, kernel="cauchy")).notes
    assert any(note.startswith("the log contradicts the map") for note in notes) == (off > 0)
    found = [note for note in notes if note.startswith("the positions")]
    assert len(found) == (shift[0] > 0)
    for note in found:
        words = note.split()
        assert (float(words[3]), float(words[8])) == pytest.approx(shift, abs=0.5)
        assert translated(note, "ja") != note


def test_positions_of_another_first_fix_than_that_of_the_map() -> None:
    """They were left where they were, 2 m off: poses were off by up to 0.22 m, and a note doubted the positions."""
    world = {"landmarks": np.random.default_rng(1).uniform(-7, 7, (14, 2)), "max_range": 8.0, "steps": 60}
    here, there = np.array([48.1, 11.7, 500.0]), np.array([48.10002, 11.70001, 503.0])
    logs = []
    for seed, datum in ((1, here), (51, there)):
        log = simulate(seed=seed, clean=True, orientation=False, **world, **ROBOT).replace(**ROBOT)
        steps = np.arange(0, log.num_poses, 2)
        places = on_plane_of(datum, log.true_poses[steps, :2], here) + np.random.default_rng(seed).normal(
            0, 0.1, (31, 2)
        )
        measured = AbsolutePositions(steps=steps, places=places, covariances=0.01 * np.eye(2), datums=datum)
        logs.append(log.replace(positions=measured))
    known = solve(Graph.from_log(logs[0], edges="landmark+motion")).map
    assert known.datum == pytest.approx(here) and known.among(list(known)[:3]).widened(0.1).datum == pytest.approx(here)
    solution = solve(Graph.from_log(logs[1], map=known, kernel="cauchy"))
    assert solution.datum == pytest.approx(here)
    off = solution.poses[:, :2] - logs[1].true_poses[:, :2]
    assert np.sqrt(np.mean(np.sum(off**2, axis=1))) < 0.1
    notes = [note for note in (*solution.graph.log.notes, *solution.notes) if "positions" in note]
    assert notes == [datum_note(here, "the datum of the map")] and translated(notes[0], "ja") != notes[0]


@pytest.mark.parametrize(("sigma", "said"), [(0.3, 0.06), (0.1, 0.5)])
def test_covariances_that_are_wrong_by_five(sigma, said):
    (note,) = notes_on_positions(1, sigma=sigma, said=said, wrong=0.1)
    assert note.startswith(NOISE)
    assert float(note.split()[6]) == pytest.approx(sigma / said, rel=0.4)


@pytest.mark.parametrize(("factor", "seeds", "unknown"), [
    (1.0, range(5), ()), (0.25, (5, 6), ()), (4.0, (7, 8), ()),
    (1.0, range(5), (2,)), (0.25, (5, 6), (2,)), (4.0, (7, 8), (2,)),
    # headings alone that are noisier than the odometry are not checked by it
    (1.0, range(5), (0, 1)), (0.25, (5, 6), (0, 1)),
])  # fmt: skip
@pytest.mark.slow
@pytest.mark.parametrize("kernel", ["none", "cauchy"])
def test_covariances_of_relations_that_are_wrong(factor, seeds, kernel, unknown):
    """A second odometry whose errors are a factor times what it says; a tenth of its relations is wrong.

    Coordinates that it does not measure have a variance of 1e6.
    """
    # those that say too much are checked by a rest that is more exact
    deviations = np.array([0.02, 0.02, 0.01]) * (10 if factor < 1 else 1)
    stated = deviations**2
    stated[list(unknown)] = 1e6
    for seed in seeds:
        log, rng = (
            simulate(seed=seed, steps=120, clean=True, orientation=False, max_range=5.0, **ROBOT),
            np.random.default_rng(seed),
        )
        true, wrong = log.true_poses, rng.random(120) < 0.1 * (kernel != "none")
        motions = (
            between(true[:-1], true[1:]) + factor * deviations * rng.standard_normal((120, 3)) + 0.5 * wrong[:, None]
        )
        relations = PoseRelations(
            first=np.arange(120), second=np.arange(1, 121), motions=motions, covariances=np.diag(stated)
        )
        graph = Graph.from_log(log.replace(relations=relations, **ROBOT), edges="landmark+motion", kernel=kernel)
        found = [note for note in solve(graph).notes if note.startswith("the errors of the relations are")]
        assert len(found) == (factor != 1.0)
        assert all(float(note.split()[6]) == pytest.approx(factor, rel=0.4) for note in found)
        assert not any(translated(note, "ja").startswith("the errors") for note in found)


def test_positions_of_another_frame_are_called_so():
    """A factor of thousands is no noise: multiplying by it would hide the cause."""
    log = simulate(seed=1, steps=60, clean=True, orientation=False, max_range=5.0, **ROBOT).replace(**ROBOT)
    steps = np.arange(0, log.num_poses, 2)
    there = log.true_poses[steps, :2] * [1, -1] + [500.0, 200.0]
    positions = AbsolutePositions(steps=steps, places=there, covariances=0.2**2 * np.eye(2))
    graph = Graph.from_log(log.replace(positions=positions), map=log.true_landmarks, kernel="cauchy")
    (note,) = (note for note in solve(graph).notes if note.startswith(NOISE))
    assert float(note.split()[6]) > 100 and "they are probably in another frame or unit than the map" in note
    assert "別の座標系" in translated(note, "ja")


def with_lasting_errors(seed, correlation, *, sigma=0.3, said=None, seen=True):
    """The solution with a position at each step, whose errors have this correlation from one to the next, and the log."""
    log = simulate(seed=seed, steps=200, clean=True, orientation=False, max_range=5.0, **ROBOT).replace(**ROBOT)
    if not seen:
        log = log.with_sightings(np.zeros(len(log.steps), dtype=bool))
    errors = sigma * np.random.default_rng(seed).standard_normal((log.num_poses, 2))
    for k in range(1, len(errors)):
        errors[k] = correlation * errors[k - 1] + np.sqrt(1 - correlation**2) * errors[k]
    places = log.true_poses[:, :2] + errors + [4.1e5, 5.3e6]
    truth = log.true_poses + [4.1e5, 5.3e6, 0.0]
    positions = AbsolutePositions(
        steps=np.arange(log.num_poses), places=places, covariances=(said or sigma) ** 2 * np.eye(2)
    )
    return solve(Graph.from_log(log.replace(positions=positions), edges="landmark+motion", kernel="cauchy")), truth


def test_errors_of_positions_that_last():
    """With independent errors NEES / 3 would be 5 to 10."""
    nees, counts = [], []
    for seed in range(4):
        solution, truth = with_lasting_errors(seed, 0.85)
        (note,) = (each for each in solution.notes if each.startswith(LASTING))
        assert not any(each.startswith((LEVER, NOISE)) for each in solution.notes)
        assert "絶対位置の誤差は" in translated(note, "ja")
        counts.append(float(note.split("so that ")[1].split()[0]))
        nees.append(np.mean(solution.nees(truth)))
    # (1 + a) / (1 - a)
    assert np.median(counts) == pytest.approx(12.3, rel=0.5)
    assert 0.4 < np.mean(nees) < 2.0


@pytest.mark.parametrize("seed", range(4))
def test_errors_of_positions_that_do_not_last(seed):
    solution, _ = with_lasting_errors(seed, 0.0)
    assert not any(each.startswith((LASTING, LEVER, NOISE)) for each in solution.notes)


def test_errors_of_positions_that_last_without_sightings():
    """Only the odometry tells; with independent errors NEES / 3 would be 4 to 7."""
    nees, counts = [], []
    for seed in range(4):
        solution, truth = with_lasting_errors(seed, 0.85, seen=False)
        (note,) = solution.notes
        assert note.startswith(LASTING)
        counts.append(float(note.split("so that ")[1].split()[0]))
        nees.append(np.mean(solution.nees(truth)))
    assert np.median(counts) == pytest.approx(12.3, rel=0.5)
    assert 0.4 < np.mean(nees) < 2.0


@pytest.mark.parametrize("seed", range(4))
def test_positions_alone_whose_covariances_are_too_large_may_last(seed):
    """Odometry alone does not tell; a factor on the standard deviations would be wrong for errors that last."""
    (note,) = with_lasting_errors(seed, 0.0, said=0.9, seen=False)[0].notes
    assert float(note.split("by ")[1].split()[0]) == pytest.approx(1 / 3, rel=0.2)
    assert "does not tell apart" in note and "区別できません" in translated(note, "ja")
    assert with_lasting_errors(seed, 0.0, seen=False)[0].notes == ()


@pytest.mark.parametrize(("every", "sigma", "models"), [(1, 0.01, {}), (9, 0.3, ROBOT)])
def test_positions_that_the_odometry_does_not_check_have_no_note(every, sigma, models):
    """Exact or rare positions: poses follow their errors, which say nothing."""
    models = {"motion": MotionModel(), "sensor": SensorModel()} | models
    for seed in range(3):
        log = simulate(seed=seed, steps=200, clean=True, orientation=False, **models)
        steps, rng = np.arange(0, log.num_poses, every), np.random.default_rng(seed)
        places = log.true_poses[steps, :2] + sigma * rng.standard_normal((len(steps), 2))
        positions = AbsolutePositions(steps=steps, places=places, covariances=sigma**2 * np.eye(2))
        alone = log.with_sightings(np.zeros(len(log.steps), dtype=bool)).replace(positions=positions, **models)
        notes = solve(Graph.from_log(alone, edges="landmark+motion")).notes
        assert not any("errors of absolute positions" in note for note in notes)


def notes_on_slip(seed, *, speed=1.0, turn=1.0, steps=slice(60, 70), **models):
    """The notes on a drive whose odometry reads so many times the true speed and turn rate during some steps."""
    log = simulate(seed=seed, steps=150, clean=True, orientation=False, max_range=5.0, **ROBOT)
    controls = log.controls.copy()
    controls[steps] *= [speed, turn]
    log = log.replace(controls=controls, **{**ROBOT, **models})
    return solve(Graph.from_log(log, edges="landmark+motion", kernel="cauchy")).notes


@pytest.mark.parametrize("seed", range(5))
def test_right_odometry_has_no_note(seed):
    assert notes_on_slip(seed) == ()
    # a bias on the whole way is no stretch
    assert not any("between steps" in note for note in notes_on_slip(seed, speed=1.1, steps=slice(None)))


@pytest.mark.parametrize(("speed", "turn"), [(1.8, 1.0), (1.0, 3.0)])
@pytest.mark.parametrize("seed", range(3))
def test_a_stretch_on_which_wheels_slip(seed, speed, turn):
    (note,) = (note for note in notes_on_slip(seed, speed=speed, turn=turn) if note.startswith("between steps"))
    first, last = (int(word) for word in note.split()[2:5:2])
    assert 50 <= first < 70 and 60 < last <= 80


def test_noise_models_that_are_too_narrow():
    narrow = SensorModel(range_rate=0.005, bearing_std=0.005)
    (note,) = (note for note in notes_on_slip(0, sensor=narrow) if note.startswith("J is"))
    assert float(note.split()[2]) > 2


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("variance", [1e3, 1e300])
def test_a_motion_of_which_nothing_is_known_is_no_doubt(variance):
    log = simulate(seed=1, steps=60, clean=True)
    variances = np.zeros((60, 3))
    variances[10] = variance
    solution = solve(Graph.from_log(log.replace(control_variances=variances), edges="landmark+motion"))
    assert solution.converged
    assert not solution.notes


@pytest.mark.slow
@pytest.mark.parametrize(
    ("common", "given"), [pytest.param(0.0, False, marks=pytest.mark.nightly), (0.0, True), (0.03, False), (0.03, True)]
)
def test_an_error_that_the_sightings_of_a_scan_have_in_common(common, given):
    """An estimate takes it for noise of the odometry; without it in the covariances NEES / 3 is 10 and more in both cases."""
    nees = []
    for seed in (4, 5, 6):
        drive = Drive(
            seed=seed, duration=40.0, place="field", landmarks=60, misread=0.0, parameters={}, scan_bearing_std=common
        )
        log, truth = drive.simulate()
        models = {"motion": truth.motion, "sensor": truth.sensor} if given else {}
        solution = solve(Graph.from_log(log, **models))
        assert any("an error in common" in note for note in solution.notes) == (common > 0)
        assert np.sqrt(solution.scan_errors[2, 2]) == pytest.approx(common, rel=0.5)
        nees.append(np.nanmean(solution.nees(log.true_poses)))
    assert 0.3 < np.mean(nees) < 3.0


@pytest.mark.parametrize("common", [0.0, 0.03])
def test_errors_of_scans_of_a_short_drive(common):
    log, truth = Drive(
        seed=7, duration=6.0, place="field", landmarks=60, misread=0.0, parameters={}, scan_bearing_std=common
    ).simulate()
    solution = solve(Graph.from_log(log, motion=truth.motion, sensor=truth.sensor))
    assert len(solution.graph.steps) < 75
    assert np.sqrt(solution.scan_errors[2, 2]) == pytest.approx(common, rel=0.5)


@pytest.mark.slow
def test_encoders_with_coarse_ticks():
    """The residuals are those of errors of scans; that speeds have few values tells the odometry is wrong."""
    log = shaken_drive(misread=0.0)
    (note,) = (each for each in solve(Graph.from_log(log)).notes if "an error in common" in each)
    assert translated(note, "ja") != note
    solution = solve(Graph.from_log(log.replace(controls=np.round(log.controls, 1))))
    (note,) = (each for each in solution.notes if "coarse ticks" in each)
    assert translated(note, "ja") != note
    assert not solution.scan_errors.any()


@pytest.mark.nightly
def test_times_of_scans_that_are_inexact():
    """They count as noise of the sensor; poses that follow them have an ATE of 0.054 to 0.060 m."""
    off, nees = [], []
    for seed in (6307, 6331, 6337):
        log = replace(Drive.random(seed), stamp_std=0.05).simulate()[0]
        robot = estimate_robot(log)
        assert 0.02 < robot.of_scans < 0.1
        assert any("an error in common" in sentence for sentence in robot.sentences)
        solution = solve(Graph.from_log(robot.log))
        off.append(ate(log.true_poses, solution.poses))
        nees.append(np.nanmean(solution.nees(log.true_poses)))
    assert max(off) < 0.04
    assert 0.3 < np.mean(nees) < 3.0


def shaken_drive(**options):
    """A drive whose scans have an error of 0.03 rad in common."""
    options = {"seed": 4, "duration": 20.0, "place": "field", "landmarks": 60, "parameters": {}} | options
    return Drive(scan_bearing_std=0.03, **options).simulate()[0]


def follows(solution):
    """Omega^-1 F, dense, F the columns of the poses in the information of sightings."""
    graph, state = solution.graph, solution.state
    sighted = graph.with_families(f for f in graph.families if isinstance(f, SightingEdges))
    F = sighted.information(state).to_sparse().toarray()[:, : 3 * len(graph.steps)]
    return np.linalg.solve(graph.information(state).to_sparse().toarray(), F)


def covariance_by_scans(solution):
    """Omega^-1 + Omega^-1 F diag(C) F' Omega^-1, dense."""
    graph, moved = solution.graph, follows(solution)
    of_errors = block_diag(*turned_by(solution.scan_errors, solution.state[: len(graph.steps), 2]))
    return np.linalg.inv(graph.information(solution.state).to_sparse().toarray()) + moved @ of_errors @ moved.T


def test_what_the_error_of_a_scan_does_to_the_solution():
    """Omega^-1 F times the error, as the solution of the log with this error shows."""
    log, truth = Drive(seed=3, duration=5.0, place="field", landmarks=30, misread=0.0, parameters={}).simulate()
    solutions, error = [], 1e-4
    for turned in (0.0, error):
        sightings = log.sightings.copy()
        sightings[log.steps == log.steps[len(log.steps) // 2], 1] += turned
        graph = Graph.from_log(
            log.replace(sightings=sightings),
            motion=truth.motion,
            sensor=truth.sensor,
            edges="landmark+motion",
            kernel="none",
        )
        solutions.append(solve(graph, tolerance=1e-12))
    first = solutions[0]
    k = int(np.searchsorted(first.graph.steps, log.steps[len(log.steps) // 2]))
    found = follows(first)[: 3 * len(first.graph.steps), 3 * k + 2].reshape(-1, 3)
    # bearings that are too large turn the pose back
    expected = difference(*(each.poses[first.graph.steps] for each in solutions)) / error
    np.testing.assert_allclose(found, expected, atol=0.01 * np.abs(expected).max())


@pytest.mark.slow
@pytest.mark.parametrize("position", [None, pytest.param(0.01, marks=pytest.mark.nightly), 1e-6])
def test_covariances_with_errors_of_scans(position, monkeypatch):
    """Each error of a scan moves the whole solution; an anchor and positions hold their poses against it."""
    draws = 4000
    monkeypatch.setattr("graphslam.solvers.uncertainty.SAMPLES", draws)
    log = shaken_drive()
    if position is not None:
        log = log.replace(
            positions=AbsolutePositions(
                steps=np.array([3]), places=log.true_poses[3:4, :2], covariances=position * np.eye(2)
            )
        )
    solution = solve(Graph.from_log(log))
    # the parameters of this robot are known
    solution = replace(solution, graph=replace(solution.graph, held=None))
    steps, marks, C = solution.graph.steps, list(solution.landmarks), solution.scan_errors
    joint = solution.covariance(poses=steps, landmarks=marks, joint=True)
    np.testing.assert_allclose(joint, joint.T, atol=1e-12)
    assert np.linalg.eigvalsh(joint)[0] > 0
    of_marks = 3 * (len(steps) + np.arange(len(marks)))[:, None] + np.arange(2)
    rows = np.concatenate([np.arange(3 * len(steps)), of_marks.ravel()])
    expected = covariance_by_scans(solution)[np.ix_(rows, rows)]
    # the mean of products of draws has a standard deviation of at most size / sqrt(draws)
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.max(np.abs(joint - expected) / size) < 6 * draws**-0.5
    blocks = solution.covariance()[steps]
    at = np.arange(3 * len(steps)).reshape(-1, 3)
    np.testing.assert_allclose(joint[at[:, :, None], at[:, None, :]], blocks, rtol=1e-9, atol=1e-15)
    crossed = Uncertainty(solution.graph, solution.state, C).with_pose(0)
    np.testing.assert_allclose(crossed, joint[at[:, :, None], at[0]], rtol=1e-6, atol=1e-12)
    # the error of the first scan turns all later ones together, so that their headings share its variance
    assert np.all(blocks[5:, 2, 2] > 1.8 * C[2, 2])
    assert np.median(joint[at[1:-1, 2], at[2:, 2]]) > 0.85 * C[2, 2]


@pytest.mark.nightly
def test_errors_of_scans_do_not_see_the_way_between_drives():
    """Nothing is known of the motion from one drive to the next."""
    log = shaken_drive(duration=80.0, misread=0.0)
    cuts = np.linspace(0, log.num_poses, 4).astype(int).tolist()
    joined = join_logs([log.at_steps(np.arange(*ends)) for ends in pairwise(cuts)], placed=True).log
    one, three = (solve(Graph.from_log(each)).scan_errors for each in (log, joined))
    np.testing.assert_allclose(three, one, rtol=0.1, atol=0.02 * one[2, 2])


@pytest.mark.nightly
def test_errors_of_scans_without_landmark_nodes_and_in_joined_drives():
    drives = [
        Drive(
            seed=4, duration=20.0, place="field", landmarks=60, misread=0.0, parameters={}, scan_bearing_std=0.03
        ).simulate()[0]
        for _ in range(2)
    ]
    solutions = [
        solve(Graph.from_log(drives[0], edges=edges, weight="marginal"))
        for edges in ("landmark+motion", "virtual+motion")
    ]
    of_scan = solutions[0].scan_errors
    assert np.sqrt(of_scan[2, 2]) == pytest.approx(0.03, rel=0.3)
    np.testing.assert_allclose(solutions[1].scan_errors, of_scan, rtol=0.1, atol=1e-6)
    # nothing is known of the motion between two drives, so that it says nothing of C
    joined = solve(Graph.from_log(join_logs(drives, mean_noise=True).log))
    np.testing.assert_allclose(joined.scan_errors, of_scan, rtol=0.2, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [6321, 6331, 6335])
def test_times_that_make_motions_short(seed):
    """Where two stamps nearly coincide, the motion between them has little noise, and the same error as others."""
    log = replace(Drive.random(seed), stamp_std=0.08, duration=60.0, misread=0.0).simulate()[0]
    robot = estimate_robot(log)
    assert robot.of_scans > 0.02
    assert np.nanmean(solve(Graph.from_log(robot.log)).nees(log.true_poses)) < 2.5


def test_a_bias_of_joined_drives_is_no_slip():
    """Nothing is known of the motion between them, and the wheels read a tenth too far all the time."""
    drives = []
    for seed in (0, 1):
        log = simulate(seed=seed, steps=150, clean=True, orientation=False, max_range=5.0, **ROBOT)
        drives.append(log.replace(controls=log.controls * [1.1, 1.0], **ROBOT))
    joined = join_logs(drives, placed=True).log
    solution = solve(Graph.from_log(joined, edges="landmark+motion", kernel="cauchy"))
    assert not any(note.startswith("between steps") for note in solution.notes)
