"""Warnings about logs, with all their parts, are translated."""

import re

import pytest

from comparisons.show.language import translated, translated_table
from comparisons.show.log_tables import calibration_tables
from graphslam import MotionModel, SensorModel
from graphslam.calibration import Calibration


@pytest.mark.parametrize(
    "message",
    [
        "the bearings, or else the turn rates, have the wrong sign (bearings='clockwise'): read like this, they fit the "
        "odometry 23.0 times better",
        "x and y of the sightings are swapped (axes='left-forward'), or bearings count clockwise from the left "
        "(bearings='clockwise', sensor_yaw=1.5708): read like this, they fit the odometry 3.0 times better",
        "a.csv has 1 sighting from 1 pose; noise and biases are estimated from at least 60 sightings and 20 poses",
        "a.csv has 1 sighting with ids from 2 poses; that takes odometry, 60 sightings and 20 poses",
        "the turn rates are in revolutions per minute: multiply their column by 0.1047: read like this, they fit the "
        "odometry 9.2 times better",
        "the sensor looks about 75 degrees to the right (sensor_yaw=-1.3090): read like this, they fit the odometry 16.3 "
        "times better",
        "the sensor looks 90 degrees to the left (sensor_yaw=1.5708): read like this, they fit the odometry infinitely "
        "many times better",
        "the ranges are in cm, against the other lengths: read like this, they fit the odometry 18.3 times better",
        "the clock of the sightings is about 0.5 s fast (clocks='sightings=-0.5'): read like this, they fit the odometry 2.3 "
        "times better",
        "the odometry turns the other way than the truth; one of them has the wrong sign; or x and y of the truth are "
        "swapped, with the headings",
        "none of the 14 landmarks that are seen (1, 2, 3, ...) is among the 9 of the true map (a, b, ...); the ids of one of "
        "them may be of another list or column",
        "landmarks have other ids from about 31.0 s after the start on (1 becomes 3, 2 becomes 4); a detector may have "
        "counted them anew",
        "wheels.csv:3: the first of 4800 odometry rows (of 9600) with the time and numbers of the row before: the rows were "
        "probably written twice, or two files joined",
        "wheels.csv:3: the first of 4560 odometry rows (of 4800) with the time of the row before and other numbers: the "
        "times were probably rounded to seconds, and one row per time is used",
        "tags.csv:3: the first of 1269 sightings (of 2538) with the time, id and numbers of another row: the rows were "
        "probably written twice, or two files joined, and these sightings count twice",
        "odometry.csv: the robot drives sideways ('vy') for 65% of its way, which controls (nu, omega) leave out: dead "
        "reckoning is wrong, and estimates rest on the sightings; OnlineSolver.move(motion=..., covariance=...) takes "
        "motions in any direction",
        "tags.csv: x, y and z are taken as right, down and ahead, the axes of a camera (axes='optical'), because y seems to "
        "be the height of the landmarks; if z is the height, add axes='forward-left'",
        "tags.csv: axes='optical' is stated, but z rather than y seems to be the height of the landmarks; compare with "
        "axes='forward-left'",
        "the orientations have the opposite sign, m_theta - theta - phi: read like this, the heading of a landmark changes "
        "by 0.037 instead of 0.19 rad over short ways (median); make them psi = theta + phi - m_theta or leave out their "
        "column",
        "orientation_std, estimated as 5.8, is more than usual robots have (at most 1): perhaps orientations are in another "
        "unit, or are not psi = theta + phi - m_theta; correct them or leave out their column",
        "oo, estimated as 0.37, is more than usual robots have (at most 0.15): perhaps the turn rate has another sign or "
        "unit, or bearings count clockwise",
    ],
    ids=lambda message: message[:30],
)
def test_warnings_of_a_log(message: str) -> None:
    shown = translated(f"WARNING: {message}.", "ja")
    assert (
        shown.startswith("警告: ") and shown.endswith("。") and not re.search(r"[a-z]{2,} [a-z]{2,} [a-z]{2,}", shown)
    )


def test_names_of_parameters_stay_as_they_are() -> None:
    """One of them is called "no"."""
    (table,), _ = calibration_tables(Calibration(motion=MotionModel(), sensor=SensorModel()))
    cells = list(translated_table(table, "ja").columns[0].cells)
    assert cells[:4] == ["nn", "no", "on", "oo"]
