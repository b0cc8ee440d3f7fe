"""Axes, meanings of psi and noise of a table's numbers: what a log shows of them, and what it must not be taken for."""

import numpy as np
import pytest

from graphslam import FormatError, Log, LogError, MotionModel, estimate_robot
from graphslam.log_checks import check_log
from graphslam.log_checks.readings import readings_of
from graphslam.se2 import wrap


def drive(seed=0, *, slip=0.0, gyro=0.0, height=0.5, noise=0.01):
    """Tables of a robot that meanders among landmarks: odometry, sightings with psi, and their x, y, z ahead, left, up."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, 120, 0.05)
    u = np.column_stack([0.5 + 0 * t, 0.4 * np.sin(t / 3) + 0.1])
    path = MotionModel().dead_reckoning(np.zeros(3), u[:-1], np.diff(t))
    low, high = path[:, :2].min(axis=0) - 3, path[:, :2].max(axis=0) + 3
    marks = np.column_stack([rng.uniform(low, high, (40, 2)), rng.uniform(-3, 3, 40), rng.uniform(-height, height, 40)])
    rows = []
    for k in range(0, len(t) - 1, 4):
        ahead = marks[:, :2] - path[k, :2]
        distance, bearing = np.hypot(*ahead.T), wrap(np.arctan2(ahead[:, 1], ahead[:, 0]) - path[k, 2])
        for j in np.flatnonzero((distance < 5) & (np.abs(bearing) < 1.1)):
            rows.append((t[k], j, distance[j], bearing[j], path[k, 2] + bearing[j] - marks[j, 2], marks[j, 3]))
    at, ids, length, phi, psi, z = np.array(rows).T
    length, phi, psi = (each + noise * rng.standard_normal(len(each)) for each in (length, phi, psi))
    wheels = slip * rng.standard_normal(u.shape) / np.sqrt(0.05) * np.sqrt(np.abs(u[:, :1])) * [0.2, 2.0]
    u = u + wheels + np.array([0, gyro]) * rng.standard_normal(u.shape)
    odometry = {"t": t, "nu": u[:, 0], "omega": u[:, 1]}
    seen = {"t": at, "id": ids.astype(int), "range": length, "bearing": phi, "orientation": wrap(psi)}
    return odometry, seen, np.column_stack([length * np.cos(phi), length * np.sin(phi), z])


def cartesian(seen, columns, names=("x", "y", "z")):
    return {"t": seen["t"], "id": seen["id"]} | dict(zip(names, np.transpose(columns)))


def findings(log):
    return {finding.check: finding.message for finding in check_log(log) if finding.check != "landmark seen once"}


@pytest.mark.parametrize("names", [("x", "y", "z"), ("tx", "ty", "tz")], ids=["x", "tx"])
def test_the_axes_of_places_with_a_z_are_stated(names):
    odometry, seen, places = drive()
    optical = np.column_stack([-places[:, 1], 0.2 - places[:, 2], places[:, 0]])
    with pytest.raises(LogError, match=r"the sightings have a z: state axes='optical' .* or axes='forward-left'"):
        Log.from_tables(odometry, cartesian(seen, optical, names))
    camera = Log.from_tables(odometry, cartesian(seen, optical, names), axes="optical")
    robot = Log.from_tables(odometry, cartesian(seen, places, names), axes="forward-left")
    np.testing.assert_allclose(camera.sightings, robot.sightings, atol=1e-12)
    assert not findings(camera) and not findings(robot)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("gyro", [2.0, 3.0])
def test_noisy_odometry_is_no_other_unit(gyro, seed):
    odometry, seen, _ = drive(seed, gyro=gyro)
    seen.pop("orientation")
    found = findings(Log.from_tables(odometry, seen))
    assert set(found) == {"odometry noise"}
    assert found["odometry noise"].startswith("over short ways a robot that does not turn fits the sightings better")


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(
    ("factors", "expected"),
    [
        ((1, 180 / np.pi), "the turn rates are in degrees per second"),
        ((1, 30 / np.pi), "the turn rates are in revolutions per minute: multiply their column by 0.1047"),
        ((100, 1), "in cm/s"),
        ((3.6, 1), "in km/h"),
    ],
)
def test_units_are_found_in_noise(factors, expected, seed):
    odometry, seen, _ = drive(seed, slip=0.01, gyro=0.05)
    log = Log.from_tables(odometry, seen)
    assert not findings(log)
    (found,) = readings_of(log.replace(controls=log.controls * factors, initial_poses=None))
    assert expected in found.message


def test_a_robot_that_sees_only_where_it_stands_is_left_alone():
    """It drives away and back, farther than is compared, with an error; as if it had not moved at all it fits better."""
    t = np.arange(0, 400, 0.05)
    phase = t % 20
    moving = phase < 10
    speed = np.where(phase < 5, 0.8, -0.76) * moving
    rng = np.random.default_rng(0)
    odometry = {"t": t, "nu": speed, "omega": 0.07 * moving * rng.standard_normal(len(t))}
    at = t[(phase > 12) & (phase < 18)][::20]
    ids = np.tile(np.arange(4), len(at))
    seen = {"t": np.repeat(at, 4), "id": ids, "range": 2.0 + 0.3 * ids, "bearing": 0.4 * ids - 0.6}
    assert not findings(Log.from_tables(odometry, seen))


MEANINGS = {
    "headings of landmarks in the axes of the robot, m_theta - theta": lambda phi, psi: phi - psi,
    "the opposite sign, m_theta - theta - phi": lambda _phi, psi: -psi,
    "the orientations say nothing": lambda _phi, psi: np.random.default_rng(0).permutation(psi),
    "all orientations are 0 rad": lambda _phi, psi: 0 * psi,
}


@pytest.mark.slow
@pytest.mark.parametrize("expected", MEANINGS, ids=["robot", "sign", "nothing", "zero"])
def test_another_meaning_of_psi_is_found(expected):
    odometry, seen, _ = drive()
    right = Log.from_tables(odometry, seen)
    assert not findings(right)
    # the heading of a landmark may count from another side of it
    assert not findings(Log.from_tables(odometry, seen | {"orientation": wrap(seen["orientation"] + 2)}))
    wrong = seen | {"orientation": wrap(MEANINGS[expected](seen["bearing"], seen["orientation"]))}
    assert expected in findings(Log.from_tables(odometry, wrong))["orientation"]


def test_psi_in_degrees_is_refused():
    odometry, seen, _ = drive()
    right = Log.from_tables(odometry, seen)
    degrees = np.rad2deg(seen.pop("orientation"))
    with pytest.raises(
        FormatError, match=r"beyond 2 pi: is it in degrees\? .*angles='sightings=degrees'.*orientation_deg"
    ):
        Log.from_tables(odometry, seen | {"orientation": degrees})
    named = Log.from_tables(odometry, seen | {"orientation_deg": degrees})
    np.testing.assert_allclose(named.sightings, right.sightings, atol=1e-12)
    # who states the unit is believed by the reader, and told what the log shows
    stated = Log.from_tables(odometry, seen | {"orientation": degrees}, angles={"sightings": "radians"})
    assert "orientation" in findings(stated)


@pytest.mark.slow
def test_an_orientation_noise_beyond_a_radian_is_a_doubt():
    odometry, seen, _ = drive()
    seen["orientation"] = np.random.default_rng(1).uniform(-3, 3, len(seen["t"]))
    robot = estimate_robot(Log.from_tables(odometry, seen))
    assert robot.sensor.orientation_std > 1
    assert any("orientation_std, estimated as" in doubt and "leave out their column" in doubt for doubt in robot.doubts)
