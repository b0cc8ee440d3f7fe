"""Odometry of the speeds of two wheels: nu and omega of a track, and what is said where it cannot be read."""

from functools import partial

import numpy as np
import pytest
from own_tables import NU, ODOMETRY, OMEGA, SEEN, T, text, write_tables

from graphslam import Log, LogError, OptionError, load

TRACK = 0.4
LEFT, RIGHT = NU - OMEGA * TRACK / 2, NU + OMEGA * TRACK / 2
WHEELS = list(zip(T.tolist(), LEFT.tolist(), RIGHT.tolist()))


@pytest.fixture
def drive(tmp_path):
    """A folder with tables; call it to change one of them."""
    return partial(write_tables, tmp_path / "drive")


@pytest.fixture
def expected(drive):
    return load(drive())


@pytest.mark.parametrize(
    "header",
    [
        "time,left_speed,right_speed",
        "t,v_left,v_right",
        "t,vl,vr",
        "t,Left wheel velocity [m/s],Right wheel velocity [m/s]",
        "stamp,odom_wheel_speed_left,odom_wheel_speed_right",
        "t,v_l,v_r",
        "t,left_vel,right_vel",
    ],
)
def test_the_speeds_of_two_wheels_are_read(drive, expected, header):
    log = load(drive(odometry=text(header, WHEELS), recipe="track = 0.4\n"))
    np.testing.assert_allclose(log.controls, expected.controls, atol=1e-14)
    assert "those of the left and the right wheel, 0.4 m apart" in log.notes[0]


def test_the_same_in_python_and_with_stated_columns(drive, expected):
    wheels = {"t": T, "a": LEFT * 1000, "b": RIGHT * 1000}
    columns = {"odometry": {"left": "a", "right": "b"}}
    sightings = np.array(SEEN)
    log = Log.from_tables(wheels, sightings, columns=columns, lengths="odometry=mm", track=TRACK)
    np.testing.assert_allclose(log.controls, expected.controls, atol=1e-14)
    with pytest.raises(LogError, match=r"the speed is 560 m/s: is it in mm/s\? Then add lengths='odometry=mm'"):
        Log.from_tables(wheels, sightings, columns=columns, track=TRACK)


def test_a_gyroscope_needs_no_track(drive, expected):
    rows = [(*row, omega) for row, omega in zip(WHEELS, OMEGA.tolist())]
    log = load(drive(odometry=text("t,v_left,v_right,gyro_z", rows)))
    np.testing.assert_allclose(log.controls, expected.controls, atol=1e-14)
    assert log.notes[0].endswith("nu is the mean of the speeds of the left and the right wheel")
    # a track that is stated counts
    other = load(drive(odometry=text("t,v_left,v_right,gyro_z", rows), recipe="track = 0.8\n"))
    np.testing.assert_allclose(other.controls, expected.controls * [1, 0.5], atol=1e-14)


def test_nu_and_omega_come_first(drive, expected):
    rows = [(*row, 9.0, 9.0) for row in ODOMETRY]
    assert load(drive(odometry=text("t,nu,omega,v_left,v_right", rows))).equals(expected)


MISTAKES = {
    "no track": (
        "time,left_speed,right_speed", "",
        "'left_speed' and 'right_speed' seem to be the speeds of the left and the right wheel; add the distance between the "
        "wheels: track=METRES",
    ),
    "the wheels as nu and omega": (
        "time,left_speed,right_speed", '[odometry]\nnu = "left_speed"\nomega = "right_speed"\n',
        "left_speed, right_speed seem to be speeds of .*, and not nu and omega, which are made of them: "
        "columns='odometry.left=left_speed,odometry.right=right_speed', track=METRES",
    ),
    "ticks": (
        "t,Left ticks,Right ticks", "track = 0.4\n",
        "there is a track, but no speeds of two wheels; say which they are: columns='odometry.left=NAME,odometry.right=NAME'",
    ),
    "ticks without a track": (
        "t,Left ticks,Right ticks", "",
        "Left ticks, Right ticks seem to be of the left and the right wheel. If they are speeds, .*; travel and ticks are "
        "not read: make speeds of their differences from row to row",
    ),
    "turn rates of the wheels": (
        "t,v_left_rad_s,v_right_rad_s", "track = 0.4\n", "are turn rates of the wheels; multiply them by the radius",
    ),
    "revolutions": ("t,left_speed_rpm,right_speed_rpm", "track = 0.4\n", "is in rpm, which is not converted"),
    "a track in kilometres": (
        "t,v_left,v_right", "track = 0.0004\n", r"the robot turns by 299 rad/s: is track in metres\?",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes(drive, name):
    header, recipe, message = MISTAKES[name]
    with pytest.raises(LogError, match=f"odometry.csv: .*{message}"):
        load(drive(odometry=text(header, WHEELS), recipe=recipe))


@pytest.mark.parametrize("track", [0, -0.4, 400, "wide", float("nan")])
def test_an_impossible_track(track):
    with pytest.raises(OptionError, match="track must be"):
        Log.from_tables("a.csv", "b.csv", track=track)


def test_speeds_of_four_wheels_beside_the_motion_are_left_alone(drive, expected):
    rows = [(*row, nu, omega, *row[1:]) for row, nu, omega in zip(WHEELS, NU.tolist(), OMEGA.tolist())]
    header = "t,front_left_speed,front_right_speed,nu,omega,rear_left_speed,rear_right_speed"
    log = load(drive(odometry=text(header, rows)))
    np.testing.assert_array_equal(log.controls, expected.controls)
    with pytest.raises(LogError, match="could both be left; say which"):
        load(drive(odometry=text(header, rows), recipe="track = 0.4\n"))
