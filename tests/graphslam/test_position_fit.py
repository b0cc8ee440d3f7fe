"""Notes on positions whose lever or covariances are wrong, on wheels that slip, and on noise models that are too narrow."""

import numpy as np
import pytest

from comparisons.show.language import translated
from graphslam import AbsolutePositions, Drive, Graph, MotionModel, SensorModel, join_logs, simulate, solve
from graphslam.se2 import mounted

LEVER, NOISE = "the positions fit better", "the errors of the positions"
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
    return [note for note in solution.notes if note.startswith((LEVER, NOISE))]


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


@pytest.mark.parametrize(("sigma", "said"), [(0.3, 0.06), (0.1, 0.5)])
def test_covariances_that_are_wrong_by_five(sigma, said):
    (note,) = notes_on_positions(1, sigma=sigma, said=said, wrong=0.1)
    assert note.startswith(NOISE)
    assert float(note.split()[6]) == pytest.approx(sigma / said, rel=0.4)


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


@pytest.mark.parametrize("shaking", [0.0, 0.03])
def test_an_error_that_the_sightings_of_a_scan_have_in_common(shaking):
    """The estimate takes it for noise of the odometry, and NEES / 3 is 40 and more."""
    log = Drive(seed=4, duration=40.0, place="field", landmarks=60, misread=0.0, parameters={}).simulate()[0]
    common = shaking * np.random.default_rng(0).normal(size=log.num_poses)
    shaken = log.sightings + np.outer(common[log.steps], [0, 1])
    notes = solve(Graph.from_log(log.replace(sightings=shaken))).notes
    assert any("errors of successive turns cancel each other" in note for note in notes) == (shaking > 0)


def test_a_bias_of_joined_drives_is_no_slip():
    """Nothing is known of the motion between them, and the wheels read a tenth too far all the time."""
    drives = []
    for seed in (0, 1):
        log = simulate(seed=seed, steps=150, clean=True, orientation=False, max_range=5.0, **ROBOT)
        drives.append(log.replace(controls=log.controls * [1.1, 1.0], **ROBOT))
    joined = join_logs(drives, placed=True).log
    solution = solve(Graph.from_log(joined, edges="landmark+motion", kernel="cauchy"))
    assert not any(note.startswith("between steps") for note in solution.notes)
