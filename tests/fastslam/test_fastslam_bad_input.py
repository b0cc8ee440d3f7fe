from __future__ import annotations

import warnings

import numpy as np
import pytest

from fastslam import FastSLAM1, FastSLAM2, MonteCarloLocalization, VanishedWeightsWarning
from graphslam import (
    Graph,
    Log,
    LogError,
    MotionModel,
    OnlineSolver,
    OptionError,
    SensorModel,
    join_logs,
    simulate,
    solve,
)
from graphslam.log.rows import NO_ID, UNIDENTIFIED
from graphslam.se2 import between

FILTERS = [FastSLAM1, FastSLAM2, MonteCarloLocalization]
SLAM = [FastSLAM1, FastSLAM2]


def make(cls: type, **options: object) -> FastSLAM1 | FastSLAM2 | MonteCarloLocalization:
    if cls is MonteCarloLocalization:
        options.setdefault("map", {0: (2.0, 1.0, 0.5), 1: (3.0, -1.0)})
    return cls(**options)


@pytest.mark.parametrize("cls", FILTERS)
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"particles": 0}, "particles must be at least 1, not 0"),
        ({"particles": -3}, "particles must be at least 1"),
        ({"particles": 10.5}, "particles must be a whole number"),
        ({"resampling": "best"}, "resampling must be one of systematic"),
        ({"ess_threshold": 1.5}, "ess_threshold must lie between 0 and 1, not 1.5"),
        ({"ess_threshold": float("nan")}, "ess_threshold must be a finite number"),
        ({"ess_threshold": "half"}, "ess_threshold must be a number"),
        ({"seed": -1}, "seed must be at least 0, not -1"),
        ({"seed": 1.5}, "seed must be a whole number"),
        ({"seed": "a"}, "seed must be a whole number"),
        ({"log": "sample.npz"}, "log must be a Log, not 'sample.npz'"),
        ({"motion": 0.1}, "motion must be a MotionModel"),
        ({"sensor": 0.1}, "sensor must be a SensorModel"),
        ({"threads": "2"}, "threads must be a whole number"),
        ({"threads": True}, "threads must be a whole number"),
        ({"threads": 0}, "threads must be at least 1"),
        ({"start": "here"}, "start must be 3 finite numbers or 1000 rows of 3"),
        ({"start": ((0.0, 0.0, 0.0), (1.0,))}, "start must be 3 finite numbers or 1000 rows of 3"),
        ({"start": (0.0, 0.0)}, "start must be 3 finite numbers or 1000 rows of 3"),
        ({"start": (0.0, np.nan, 0.0)}, "start must be 3 finite numbers or 1000 rows of 3"),
    ],
)
def test_options(cls: type, options: dict, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        make(cls, **options)


@pytest.mark.parametrize("cls", FILTERS)
def test_log_without_controls(cls: type) -> None:
    log = Log(initial_poses=np.zeros((2, 3)), steps=[0], landmarks=[0], sightings=[[1.0, 0.0]], name="book")
    with pytest.raises(LogError, match="book has no controls"):
        make(cls, log=log)


def test_no_log_to_run() -> None:
    with pytest.raises(OptionError, match="no log"):
        FastSLAM1().run()


@pytest.mark.parametrize("cls", FILTERS)
@pytest.mark.parametrize("control", [(np.nan, 0.0), (0.1, np.inf), (0.1,), ((0.1, 0.2),), "fast", ((1,), (1, 2))])
def test_control(cls: type, control: tuple) -> None:
    with pytest.raises(OptionError, match="control must be 2 finite numbers"):
        make(cls).move(control, 1.0)


@pytest.mark.parametrize("cls", FILTERS)
@pytest.mark.parametrize("sighting", [(1.0, 7.0), (np.nan, -7.0), (1.0, 0.2, 30.0)])
def test_bearings_in_degrees(cls: type, sighting: tuple[float, ...]) -> None:
    with pytest.raises(OptionError, match="beyond 2 pi: is it in degrees"):
        make(cls).observe([0], [sighting])


@pytest.mark.parametrize("cls", FILTERS)
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"control": (0.1, 0.0), "dt": 1.0, "covariance": np.eye(3)}, "covariance belongs to a measured motion"),
        ({"motion": (1.0, 0.0, 90.0), "covariance": np.eye(3)}, "beyond 8 pi: is it in degrees"),
        ({"motion": (1.0, 0.0, 0.1), "covariance": np.eye(3), "dt": 1.0}, "dt belongs to a control"),
        ({"motion": (1.0, 0.0, 0.1)}, "covariance must be 3 rows of 3 finite numbers"),
        ({"motion": (1.0, 0.0), "covariance": np.eye(3)}, "motion must be 3 finite numbers"),
        ({}, "move takes a control and dt"),
    ],
)
def test_moves_that_the_online_solver_refuses(cls: type, arguments: dict, message: str) -> None:
    for robot in (make(cls), OnlineSolver()):
        with pytest.raises(OptionError, match=message):
            robot.move(**arguments)


@pytest.mark.parametrize("cls", FILTERS)
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("a", np.eye(2)), "position must be 2 or 3 finite numbers, not 'a'"),
        ((([1.0], [2.0, 3.0]), np.eye(2)), "position must be 2 or 3 finite numbers"),
        (((1.0,), np.eye(2)), "position must be 2 or 3 finite numbers"),
        (((1.0, 2.0), np.eye(3)), "covariance must be 2 rows of 2 finite numbers"),
        (((1.0, 2.0, 0.1), np.eye(2)), "covariance must be 3 rows of 3 finite numbers"),
        (((1.0, 2.0), -np.eye(2)), "covariance must be a symmetric positive definite 2 x 2 matrix"),
    ],
)
def test_positions_that_the_online_solver_refuses(cls: type, arguments: tuple, message: str) -> None:
    for robot in (make(cls), OnlineSolver()):
        with pytest.raises(OptionError, match=message):
            robot.locate(*arguments)
        with pytest.raises(OptionError, match="lever must be 2 finite numbers"):
            robot.locate((1.0, 2.0), np.eye(2), lever="left")


@pytest.mark.parametrize("dt", [-1.0, np.nan, np.inf, "long", None, [1.0, 2.0]])
def test_negative_time(dt: float) -> None:
    with pytest.raises(OptionError, match="dt must be"):
        FastSLAM1().move((0.1, 0.0), dt)


@pytest.mark.parametrize("cls", FILTERS)
def test_no_time_no_motion(cls: type) -> None:
    slam = make(cls, particles=10, start=(1.0, 2.0, 0.3))
    slam.move((0.5, 0.5), 0.0)
    np.testing.assert_array_equal(slam.state.poses, np.tile([1.0, 2.0, 0.3], (10, 1)))
    assert slam.state.step == 1


def test_no_motion_noise_but_epsilon() -> None:
    """All four noise parameters zero, a degenerate Gaussian of controls: only epsilon is left."""
    slam = FastSLAM1(particles=1000, motion=MotionModel(nn=0, no=0, on=0, oo=0, epsilon=1e-300))
    slam.move((0.5, 0.0), 2.0)
    np.testing.assert_allclose(slam.state.poses, np.tile([1.0, 0.0, 0.0], (1000, 1)), atol=1e-12)


@pytest.mark.parametrize("cls", SLAM)
@pytest.mark.parametrize("epsilon", [1e-300, 1e-30])
def test_no_motion_noise_and_sightings(cls: type, epsilon: float) -> None:
    """The proposal of 2.0 is degenerate too: every particle follows the noise-free motion."""
    slam = cls(particles=20, motion=MotionModel(nn=0, no=0, on=0, oo=0, epsilon=epsilon))
    slam.observe([0], [[2.0, 0.1]])
    slam.move((0.5, 0.1), 1.0)
    slam.observe([0], [[1.4, 0.2]])
    np.testing.assert_allclose(
        slam.state.poses, np.tile(slam.motion.f(np.zeros(3), (0.5, 0.1), 1.0), (20, 1)), atol=1e-12
    )
    # the exact weights of draws from a proposal of 10 nm and 10 nrad, under a sensor of some cm
    np.testing.assert_allclose(slam.state.log_weights, -np.log(20), atol=2e-6)


def test_sensor_without_noise_is_refused() -> None:
    with pytest.raises(OptionError, match="bearing_std must be a positive number"):
        FastSLAM1(sensor=SensorModel(bearing_std=0.0))


@pytest.mark.parametrize("cls", FILTERS)
@pytest.mark.parametrize("missing", [UNIDENTIFIED, NO_ID])
def test_sightings_without_ids_are_no_landmark(cls: type, missing: int) -> None:
    slam = make(cls)
    with pytest.raises(OptionError, match="takes identified landmarks only"):
        slam.observe([0, missing], [[2.0, 0.0], [2.0, 0.1]])
    assert list(slam.landmarks) == list(make(cls).landmarks)
    if cls is not MonteCarloLocalization:  # where ids are ignored, they may be missing
        slam = cls(particles=5, association="maximum-likelihood")
        slam.observe([missing, missing], [[2.0, 0.0], [2.0, 2.0]])
        assert len(slam.state.map(0, provisional=True)) == 2


@pytest.mark.parametrize("cls", FILTERS)
@pytest.mark.parametrize(
    ("ids", "sightings"),
    [
        ([0], [[1.0]]),
        ([0, 1], [[1.0, 0.0]]),
        ([0.5], [[1.0, 0.0]]),
        ([0], [[np.nan, np.nan]]),
        ([0], [[1.0, np.inf]]),
        ([0], [[0.0, 0.0]]),
        ([0], [[-1.0, 0.0]]),
        ([0], "near"),
        ([0], [[1.0, 0.0], [1.0]]),
        ([[0], [1, 2]], [[1.0, 0.0]]),
    ],
)
def test_sightings(cls: type, ids: list, sightings: list) -> None:
    with pytest.raises(OptionError):
        make(cls).observe(ids, sightings)


@pytest.mark.parametrize("ids", [["a"], [1.5], [None], [True], [2**70]])
def test_ids_of_the_wrong_type(ids: list) -> None:
    with pytest.raises(OptionError, match="ids must be whole numbers, not"):
        FastSLAM1().observe(ids, [[1.0, 0.0]])


def test_a_turn_rate_in_degrees() -> None:
    with pytest.raises(OptionError, match="the turn rate of control is 45 rad/s, .* is it in degrees per second"):
        FastSLAM1().move((1.0, 45.0), 1.0)


def test_numbers_of_numpy_are_numbers() -> None:
    slam = FastSLAM1(particles=np.int64(5), threads=np.int64(2), seed=np.int64(3), ess_threshold=np.float32(0.5))
    slam.move(np.array([0.1, 0.0], dtype=np.float32), np.float32(1.0))
    assert slam.trajectory(np.int32(4)).shape == (2, 3)


@pytest.mark.parametrize("particle", [1.5, "best", True])
def test_particle_indices(particle: object) -> None:
    slam = FastSLAM1(particles=5)
    for ask in (slam.state.map, slam.trajectory):
        with pytest.raises(OptionError, match="particle must be a whole number"):
            ask(particle)


@pytest.mark.parametrize("cls", FILTERS)
def test_nothing_seen(cls: type) -> None:
    slam = make(cls, particles=5)
    before = slam.state.log_weights
    slam.observe([], [])
    np.testing.assert_array_equal(slam.state.log_weights, before)


def test_turn_out_of_range() -> None:
    slam = FastSLAM1()
    with pytest.raises(OptionError, match="turn it by up to 1.0.*e.06 rad; more than 1e.09 m or 100000 rad is refused"):
        slam.move((0.1, 1.0), 1e6)
    assert slam.state.step == 0


@pytest.mark.parametrize("cls", FILTERS)
@pytest.mark.parametrize("offset", [0.0, 0.2])
@pytest.mark.parametrize(("control", "dt"), [((1e308, 0.0), 10.0), ((1e10, 0.0), 1.0), ((1.0, 0.0), 1e-310)])
def test_way_out_of_range(control: tuple, dt: float, offset: float, cls: type) -> None:
    """A way that overflows, one of many times round the Earth, and a time so short that the noise overflows."""
    slam = make(cls, particles=5, sensor=SensorModel(offset=offset))
    with pytest.raises(OptionError, match="step 1: the control and its noise move the robot by up to"):
        slam.move(control, dt)
    assert slam.state.step == 0
    log = Log(
        dt=[1.0, dt], controls=[[0.1, 0.0], control], initial_poses=np.zeros((3, 3)), steps=[0], landmarks=[0],
        sightings=[[1.0, 0.0]],
    )  # fmt: skip
    slam = make(cls, log=log, particles=5, sensor=SensorModel(offset=offset))
    with pytest.raises(OptionError, match="step 2: the control and its noise move the robot by up to"):
        slam.run()
    assert slam.state.step == 1


def test_psi_is_in_all_sightings_or_in_none() -> None:
    slam = FastSLAM1()
    slam.observe([0], [[1.0, 0.0]])
    with pytest.raises(OptionError, match="2 columns, these have 3"):
        slam.observe([0], [[1.0, 0.0, 0.0]])


def test_unknown_landmark_on_a_known_map() -> None:
    with pytest.raises(OptionError, match="landmark 9 was seen but is not on the known map"):
        make(MonteCarloLocalization).observe([9], [[1.0, 0.0]])
    log = simulate()
    landmarks = {j: m for j, m in log.true_landmarks.items() if j != 3}
    with pytest.raises(OptionError, match="landmark 3"):
        MonteCarloLocalization(log, map=landmarks)


def test_no_map() -> None:
    with pytest.raises(OptionError, match="needs a map, and .* has no true landmarks: give map"):
        MonteCarloLocalization(simulate().replace(true_landmarks=None))
    with pytest.raises(OptionError, match="needs a map"):
        MonteCarloLocalization()
    with pytest.raises(OptionError, match="landmark 2 of the map must be finite"):
        MonteCarloLocalization(map={2: (1.0, np.nan)})
    with pytest.raises(OptionError, match="landmark 2 of the map must be"):
        MonteCarloLocalization(map={2: "there"})
    with pytest.raises(OptionError, match=r"map must be a LandmarkMap, \{id: \(x, y\)\} or the path of a file"):
        MonteCarloLocalization(map=[(1.0, 2.0)])
    with pytest.raises(OptionError, match="the ids of a map are whole numbers"):
        MonteCarloLocalization(map={"door": (1.0, 2.0)})


def test_range_bearing_landmarks_on_the_map_leave_psi_out() -> None:
    log = simulate(seed=3)
    flat = {j: m[:2] for j, m in log.true_landmarks.items()}
    a = MonteCarloLocalization(log, map=flat, particles=50).run()
    b = MonteCarloLocalization(log.without_orientation(), particles=50).run()
    np.testing.assert_array_equal(a.poses, b.poses)


@pytest.mark.parametrize("cls", SLAM)
@pytest.mark.parametrize("columns", [2, 3])
def test_all_particles_on_the_landmark(columns: int, cls: type) -> None:
    """Every particle stands on the landmark: the filter warns, restores the weights and continues."""
    landmark = np.array([1.0, 0.0, 0.0])[:columns]
    slam = cls(particles=30, motion=MotionModel(nn=0, no=0, on=0, oo=0, epsilon=1e-300), start=np.zeros(3))
    slam.observe([0], [[1.0, 0.0, 0.0][:columns]])
    slam.move((0.0, 0.0), 1.0)
    slam.move((1.0, 0.0), 1.0)
    weights, before = slam.state.log_weights, slam.state.map(3)[0]
    np.testing.assert_allclose(before.mean, landmark, atol=1e-15)
    with pytest.warns(VanishedWeightsWarning, match="step 2: its sightings are impossible for all 30 particles"):
        slam.observe([0], [[0.5, 0.2, 0.1][:columns]])
    np.testing.assert_array_equal(slam.state.log_weights, weights)
    np.testing.assert_array_equal(slam.state.map(3)[0].mean, before.mean)
    assert not slam.state.resampled
    slam.move((-1.0, 0.0), 1.0)
    slam.observe([0], [[1.0, 0.0, 0.0][:columns]])
    assert np.all(np.isfinite(slam.state.log_weights))


@pytest.mark.parametrize("scheme", ["systematic", "stratified", "residual", "multinomial"])
def test_one_particle_on_the_landmark(scheme: str) -> None:
    """Only that particle is impossible, and resampling never chooses it."""
    start = np.zeros((20, 3))
    start[7] = [2.0, 1.0, 0.0]
    mcl = make(MonteCarloLocalization, particles=20, start=start, ess_threshold=1.0, resampling=scheme)
    mcl.observe([0], [[np.hypot(2, 1), np.arctan2(1, 2)]])
    assert mcl.state.resampled
    np.testing.assert_array_equal(mcl.state.poses, np.zeros((20, 3)))


def test_all_impossible_on_a_known_map() -> None:
    """The square of the range leaves floating point: impossible for every particle."""
    mcl = make(MonteCarloLocalization, particles=30)
    for extreme in (1e-200, 1e200):
        with pytest.warns(VanishedWeightsWarning):
            mcl.observe([0], [[extreme, 0.0]])
    np.testing.assert_allclose(mcl.state.log_weights, -np.log(30))


def test_very_unlikely_is_not_impossible() -> None:
    """A landmark on the wrong side at a thousand standard deviations underflows as a number, not as a logarithm."""
    exact = SensorModel(range_rate=0.001, bearing_std=0.001, orientation_std=0.001)
    mcl = make(MonteCarloLocalization, particles=100, sensor=exact)
    mcl.move((0.2, 0.1), 1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mcl.observe([0], [[2.0, -2.5]])
    assert np.exp(mcl.state.log_weights).sum() == pytest.approx(1)


@pytest.mark.parametrize("cls", SLAM)
@pytest.mark.parametrize("columns", [2, 3])
def test_two_hundred_sightings_in_a_step(columns: int, cls: type) -> None:
    rng = np.random.default_rng(0)
    landmarks = np.column_stack([rng.uniform(-10, 10, (200, 2)), rng.uniform(-3, 3, 200)])[:, :columns]
    slam = cls(particles=100)
    for _ in range(3):
        slam.observe(np.arange(200), slam.sensor.h(slam.state.mean_pose, landmarks))
        slam.move((0.2, 0.1), 1.0)
    assert len(slam.state.map()) == 200
    assert 1 <= slam.state.ess <= 100
    assert np.all(np.isfinite(slam.state.poses))


def test_maps_of_an_earlier_state() -> None:
    slam = FastSLAM1()
    slam.observe([0], [[1.0, 0.0]])
    state = slam.state
    assert state.map(5).keys() == {0}
    with pytest.raises(OptionError, match="no particle 1000"):
        state.map(1000)
    slam.move((0.1, 0.0), 1.0)
    with pytest.raises(OptionError, match="taken another step"):
        state.map()
    with pytest.raises(OptionError, match="taken another step"):
        state.mixture_map()
    with pytest.raises(OptionError, match="no particle -1"):
        slam.trajectory(-1)
    with pytest.raises(ValueError, match="read-only"):
        state.poses[0] = 0.0


@pytest.mark.parametrize("cls", SLAM)
@pytest.mark.parametrize("association", ["known", "maximum-likelihood"])
def test_numbers_beyond_floating_point(association: str, cls: type) -> None:
    """A range of 1e200 m, or noise whose variance is no number, is refused before anything changes."""
    slam = cls(particles=20, association=association)
    slam.observe([0], [[2.0, 0.1]])
    state = slam.state
    for extreme in (1e200, 1e60, 1e-200):
        with pytest.raises(OptionError, match=r"step 0: sighting 1, of range .* is beyond floating point"):
            slam.observe([0, 1], [[2.0, 0.1], [extreme, 0.1]])
    assert state.map(provisional=True).keys() == {0}
    for std in (1e-200, 1e-60):
        sharp = cls(particles=20, association=association, sensor=SensorModel(bearing_std=std))
        with pytest.raises(OptionError, match="beyond floating point"):
            sharp.observe([0], [[2.0, 0.1]])


@pytest.mark.parametrize("cls", SLAM)
@pytest.mark.parametrize("association", ["known", "maximum-likelihood"])
@pytest.mark.parametrize("size", [1e-40, 1e-12])
def test_almost_no_noise(size: float, association: str, cls: type) -> None:
    """At the limit of small noise a standing robot maps its landmarks exactly, and far ones stay finite."""
    sensor = SensorModel(range_rate=size, bearing_std=size)
    slam = cls(particles=20, association=association, sensor=sensor, ess_threshold=0.0)
    for _ in range(4):
        slam.observe([0, 1], [[2.0, 0.0], [1e30, 0.5]])
        slam.move((0.0, 0.0), 0.0)
    landmarks = slam.state.mixture_map()
    np.testing.assert_allclose(landmarks[0].mean, [2.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(landmarks[1].mean, 1e30 * np.array([np.cos(0.5), np.sin(0.5)]))
    np.testing.assert_allclose(slam.state.log_weights, -np.log(20))


def test_joined_logs_are_for_filters_that_draw_poses_with_the_sightings():
    whole = simulate(seed=11, steps=90, clean=True)
    first, second = (whole.at_steps(steps) for steps in (np.arange(45), np.arange(45, whole.num_poses)))
    elsewhere = second.replace(initial_poses=between(second.initial_poses[0], second.initial_poses))
    joined = join_logs([first, elsewhere]).log
    for cls in (FastSLAM1, MonteCarloLocalization):
        with pytest.raises(OptionError, match=f"{cls.__name__} follows one robot .* these are 2 logs; FastSLAM2 finds"):
            cls(joined)
    best = solve(Graph.from_log(joined, edges="landmark+motion"))
    assert np.abs(FastSLAM2(joined, particles=100).run().poses - best.poses)[:, :2].max() < 2.0
