"""Odometry, sightings and truth at their own times become one log."""

import numpy as np
import pytest

from graphslam import Graph, Log, LogError, MotionModel, OptionError, load, save, simulate, solve
from graphslam.io.formats import ReadOptions
from graphslam.log.streams import Stream, divide, synchronize, truth_at
from graphslam.metrics import ate

DRIVE = Stream(np.arange(0.0, 10.01, 0.5), np.column_stack([np.linspace(0.5, 1.5, 21), np.linspace(-1, 1, 21)]))


def seen(*times):
    return Stream(np.array(times), np.tile([2.0, 0.1], (len(times), 1)))


def joined(*times, **changes):
    return synchronize(DRIVE, seen(*times), np.full(len(times), 3), **changes)


def pose_at(time, origin):
    """The pose that the controls lead to from the origin's time on, in tiny steps of Euler's rule."""
    x, t, h = np.zeros(3), origin, 1e-4
    while t < time - h / 2:
        nu, omega = DRIVE.rows[np.searchsorted(DRIVE.times, t + h / 2, side="right") - 1]
        x = x + h * np.array([nu * np.cos(x[2] + omega * h / 2), nu * np.sin(x[2] + omega * h / 2), omega])
        t += h
    return x


def test_motions_between_events_are_integrated_exactly():
    # events between the rows of the odometry, at one, and two in one control
    log = joined(0.25, 2.0, 2.1, 2.2, 7.75)
    assert log.num_poses == 5
    np.testing.assert_allclose(log.times, [0.25, 2.0, 2.1, 2.2, 7.75])
    for pose, time in zip(log.initial_poses, log.times):
        np.testing.assert_allclose(pose, pose_at(time, 0.25), atol=1e-6)


def test_a_control_holds_until_the_next():
    controls, dt, recorded_dt, starts, variances, gaps = divide(DRIVE, np.array([0.2, 0.7, 0.9]))
    np.testing.assert_allclose(dt, [0.3, 0.2, 0.2])
    np.testing.assert_allclose(recorded_dt, 0.5)
    np.testing.assert_allclose(controls, DRIVE.rows[[0, 1, 1]])
    assert (starts.tolist(), variances, gaps) == ([0, 2, 3], None, [])


def test_of_several_rows_with_one_time_the_last_holds():
    odometry = Stream(np.array([0.0, 1.0, 1.0, 2.0]), np.array([[1.0, 0], [2, 0], [3, 0], [4, 0]]))
    controls, dt, *_ = divide(odometry, np.array([0.5, 1.5]))
    np.testing.assert_allclose(controls[:, 0], [1, 3])
    np.testing.assert_allclose(dt, [0.5, 0.5])


def test_sightings_of_one_time_are_of_one_pose_and_those_outside_the_odometry_are_counted():
    log = joined(-1.0, 1.0, 1.0, 3.0, 12.0)
    assert log.steps.tolist() == [0, 0, 1]
    assert "2 of 5 sightings are from before or after the odometry: left out" in log.notes


def test_a_pose_at_least_every_so_often():
    log = joined(1.0, 1.5, 4.0, options=ReadOptions(keep_every=1.0))
    np.testing.assert_allclose(log.times, [1.0, 1.5, 1.5 + 2.5 / 3, 1.5 + 5 / 3, 4.0])
    assert log.steps.tolist() == [0, 1, 4]
    np.testing.assert_allclose(log.initial_poses[[0, 1, 4]], joined(1.0, 1.5, 4.0).initial_poses, atol=1e-12)
    with pytest.raises(OptionError, match="keep_every"):
        ReadOptions(keep_every=0.0)


def test_truth_is_interpolated_where_it_is_dense_and_nan_elsewhere():
    # a quarter turn on the unit circle in half a second, then silence
    truth = Stream(np.array([0.0, 0.5, 9.0]), np.array([[1.0, 0, np.pi / 2], [0, 1, np.pi], [5, 5, 0]]))
    poses = truth_at(np.array([-0.1, 0.0, 0.25, 0.5, 2.0, 9.0, 9.5]), truth)
    half = np.sqrt(0.5)
    expected = [[1, 0, np.pi / 2], [half, half, 3 * np.pi / 4], [0, 1, np.pi], [5, 5, 0]]
    np.testing.assert_allclose(poses[[1, 2, 3, 5]], expected)
    assert np.isnan(poses[[0, 4, 6]]).all()


def test_positions_as_truth_tell_no_heading():
    poses = truth_at(np.array([0.25]), Stream(np.array([0.0, 0.5]), np.array([[0.0, 0], [2, 4]])))
    np.testing.assert_allclose(poses, [[1, 2, np.nan]])


def test_truth_that_ends_early():
    truth = Stream(np.arange(5) * 0.5, np.zeros((5, 3)) + [1, 2, 3])
    log = joined(0.5, 1.5, 5.0, truth=truth)
    assert log.covered.tolist() == [True, True, False]
    assert "the truth covers 2 of 3 poses" in log.notes
    np.testing.assert_allclose(log.initial_poses[0], [1, 2, 3])  # the known start
    late = joined(4.0, 5.0, truth=truth)
    assert late.true_poses is None and "the truth covers no pose: its times lie before or after the poses" in late.notes
    sparse = joined(0.5, 1.5, truth=Stream(np.arange(4) * 0.97, np.zeros((4, 3))))
    assert (
        "its rows are 0.97 s apart (median), and it is interpolated between rows at most 0.5 s apart"
        in sparse.notes[-1]
    )
    # rows a second apart, of which every second pose has one
    every = joined(0.5, 1.0, 1.5, 2.0, truth=Stream(np.arange(4) * 1.0, np.zeros((4, 3))))
    assert "the truth covers 2 of 4 poses: its rows are 1 s apart (median), " in " ".join(every.notes)


def gapped(length):
    times = np.array([0.0, 0.5, 1.0, 1.0 + length, 1.5 + length])
    controls = np.array([[1.0, 0.0], [1.0, 0.5], [2.0, 0.0], [1.0, 0.0], [1.0, 0.0]])
    return Stream(times, controls)


def test_a_gap_in_the_odometry_is_bridged_with_grown_noise_and_a_warning():
    odometry = gapped(5.0)
    with pytest.warns(
        UserWarning, match="1 gap of 5.0 s in the odometry: bridged, with the noise of a robot that moved"
    ):
        log = synchronize(odometry, seen(0.5, 4.0, 6.2), np.zeros(3))
    # the last control fades: its mean over the time from 0 to 3 s and from 3 to 5 s after it
    faded = [2 * 2 / 3 * (1 - np.exp(-3 / 2)), 2 * 2 / 2 * (np.exp(-3 / 2) - np.exp(-5 / 2))]
    np.testing.assert_allclose(log.controls[:, 0], [1, *faded, 1])
    speed, turn = np.mean(odometry.rows**2, axis=0)
    at_will = np.array([speed, turn, speed])
    np.testing.assert_allclose(log.control_variances, [[0, 0, 0], at_will * 5 / 3, at_will * 5 / 2, [0, 0, 0]])


@pytest.mark.parametrize("length", [5.0, 40.0])
@pytest.mark.parametrize("poses", [0, 1, 7])
def test_in_a_silence_the_robot_may_have_gone_anywhere(length, poses):
    odometry = gapped(length)
    # before the silence it stands still and turns nowhere, so that there is nothing that fades
    odometry.rows[2] = 0.0
    times = [0.5, 1.0, *np.linspace(1.0, 1.0 + length, poses + 2)[1:-1], 1.0 + length, 1.2 + length]
    with pytest.warns(
        UserWarning, match=f"1 gap of {length} s in the odometry: bridged, with the noise of a robot that moved"
    ):
        log = synchronize(odometry, seen(*times), np.zeros(len(times)))
    motions, covariances = log.motions(MotionModel.constant(0.0, 0.0, epsilon=1e-10))
    # give or take the way that it drives in this time at its usual speed, in every direction
    within = slice(1, poses + 2)
    np.testing.assert_allclose(motions[within], 0, atol=1e-12)
    speed, turn = np.sqrt(np.mean(odometry.rows**2, axis=0))
    expected = np.diag([(length * speed) ** 2, (length * speed) ** 2, min(length * turn, np.pi) ** 2])
    np.testing.assert_allclose(covariances[within].sum(axis=0), expected, rtol=1e-6, atol=1e-6)
    # the other motions are as without the silence
    np.testing.assert_allclose(motions[[0, -1]], [[0.5, 0, 0.25], [0.2, 0, 0]], atol=0.07)
    assert log.dt.sum() == pytest.approx(length + 0.7) and log.times[-1] == pytest.approx(length + 1.2)
    # a silence that no motion of the log crosses does not matter
    assert synchronize(odometry, seen(0.5, 0.9), np.zeros(2)).control_variances is None


@pytest.mark.nightly
def test_a_drive_with_a_long_silence_is_solved():
    """Half a minute of odometry is lost; the landmarks are seen again, so that the trajectory is known nevertheless."""
    away = []
    for seed in range(6):
        log = simulate(seed=seed, steps=120, clean=True, motion=MotionModel(nn=0.05, no=0.001, on=0.03, oo=0.05))
        times, silent = log.times, (log.times[:-1] > 40) & (log.times[:-1] < 75)
        assert silent.sum() >= 10
        rows = Stream(np.append(times[:-1][~silent], times[-1]), np.vstack([log.controls[~silent], log.controls[-1]]))
        kept = (times[log.steps] <= 40) | (times[log.steps] >= 76)
        with pytest.warns(UserWarning, match="bridged"):
            found = synchronize(
                rows, Stream(times[log.steps[kept]], log.sightings[kept]), log.landmarks[kept],
                truth=Stream(times, log.true_poses), true_landmarks=log.true_landmarks, motion=log.motion, sensor=log.sensor,
            )  # fmt: skip
        solution = solve(Graph.from_log(found, edges="landmark+motion", kernel="none"))
        assert solution.converged
        away.append(ate(found.true_poses, solution.poses))
    assert max(away) < 0.3


@pytest.mark.parametrize(
    ("odometry", "sightings", "message"),
    [
        (DRIVE, seen(3.5, 2.0), r"times of the sightings run backwards in row 2"),
        (Stream(DRIVE.times[::-1], DRIVE.rows), seen(1.0), "times of the odometry run backwards"),
        (Stream(DRIVE.times[:1], DRIVE.rows[:1]), seen(0.0), "motion takes two"),
        (DRIVE, seen(), "no landmark is seen"),
        (DRIVE, seen(11.0), "no landmark is seen"),
    ],
)
def test_data_that_make_no_log(odometry, sightings, message):
    with pytest.raises(LogError, match=message):
        synchronize(odometry, sightings, np.zeros(len(sightings)))


def test_rows_that_run_backwards_a_little_are_sorted_and_said():
    # one row of the odometry 0.1 s too early in the file, as in a published set, and two sightings out of order
    order = np.array([0, 1, 2, 4, 3, *range(5, len(DRIVE))])
    times = DRIVE.times.copy()
    times[4] = times[3] + 0.1
    straight = Stream(times, DRIVE.rows)
    mixed = Stream(times[order], DRIVE.rows[order])
    expected = synchronize(straight, seen(1.0, 2.0, 2.5), np.array([7, 8, 9]))
    log = synchronize(mixed, seen(1.0, 2.5, 2.0), np.array([7, 9, 8]))
    assert log.equals(expected)
    (unseen,) = expected.notes
    assert unseen.startswith(
        "the odometry of 1.0 s before the first sighting and 7.5 s after the last sighting is left out"
    )
    assert log.notes == (
        "1 row of the odometry runs backwards, by at most 0.1 s: sorted by time",
        "1 row of the sightings runs backwards, by at most 0.5 s: sorted by time",
        unseen,
    )


CONSTANT = MotionModel.constant(0.1, 0.3, epsilon=1e-12)


def cut(every: float) -> Log:
    """The same minute of odometry at 10 Hz, with a sighting of nothing in particular at each multiple of a time."""
    t = np.arange(0.0, 60.05, 0.1)
    odometry = Stream(t, np.column_stack([np.full(len(t), 0.2), 0.1 * np.sin(t)]))
    times = np.append(np.arange(0.0, 60.0, every), 60.0)
    seen = Stream(times, np.tile([5.0, 0.0], (len(times), 1)))
    return synchronize(odometry, seen, np.zeros(len(times), dtype=int), name="cut")


def heading_variance(log: Log) -> float:
    return float(np.sum(log.motions(CONSTANT)[1][:, 2, 2]))


def test_cutting_controls_changes_neither_their_noise_nor_their_motion():
    """600 controls of 0.1 s: a heading variance of 600 (0.3 rad/s 0.1 s)², 0.73 rad, however often something is seen."""
    whole = cut(60.0)
    assert whole.recorded_dt is None and whole.composite
    for every in (0.03, 0.07, 1.05):
        log = cut(every)
        assert len(log.controls) > 600
        assert heading_variance(log) == pytest.approx(600 * 0.03**2, rel=1e-6)
        # and so for whatever part of the pieces is joined to one motion
        joined = log.at_steps(np.arange(0, log.num_poses, 7))
        assert heading_variance(joined) == pytest.approx(np.sum(joined.recorded_dt * joined.dt) * 0.3**2, rel=1e-6)
        # the noise along the way, too, up to the shape of the arcs
        end, (P,) = whole.motions(CONSTANT)[0], whole.motions(CONSTANT)[1]
        start, (Q,) = (at[-1:] for at in (log.at_steps([0, log.num_poses - 1]).motions(CONSTANT)))
        np.testing.assert_allclose(start, end, atol=1e-6)
        np.testing.assert_allclose(Q, P, rtol=0.01, atol=1e-4)


def test_pieces_of_controls_in_files_and_in_errors(tmp_path):
    log = cut(0.07)
    save(log, tmp_path / "cut.npz")
    assert load(tmp_path / "cut.npz").equals(log)
    assert log.replace(controls=log.controls[:10], dt=log.dt[:10], initial_poses=None, steps=[], landmarks=[],
                       sightings=np.zeros((0, 2)), true_poses=None).recorded_dt is None  # fmt: skip
    with pytest.raises(LogError, match="a piece of it"):
        log.replace(recorded_dt=log.dt / 2)


def test_positions_need_no_datum():
    t = np.arange(6.0)
    rows = np.column_stack(
        [t, 0 * t, np.full(6, np.nan), np.tile(np.eye(3).ravel(), (6, 1)), np.tile([0.1, 0.2], (6, 1))]
    )
    motion, seen = Stream(t, np.full((6, 2), 0.5)), Stream(t, np.full((6, 2), 1.0))
    positions = synchronize(motion, seen, np.arange(6) % 2, positions=Stream(t[1:5], rows[1:5])).positions
    assert positions.datum is None and positions.levers[0].tolist() == [0.1, 0.2]
