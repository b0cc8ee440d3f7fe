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
        "the orientations have the opposite sign, m_theta - theta - phi: read like this, the heading of a landmark changes "
        "by 0.037 instead of 0.19 rad over short ways (median); make them psi = theta + phi - m_theta or leave out their "
        "column",
        "orientation_std, estimated as 5.8, is more than usual robots have (at most 1): perhaps orientations are in another "
        "unit, or are not psi = theta + phi - m_theta; correct them or leave out their column",
        "sightings have heavy tails (5.1 degrees of freedom): the values describe typical sightings, without the outliers, "
        "so run with a robust kernel (kernel='cauchy', or huber)",
        "motions have heavy tails (2.9 degrees of freedom): the values describe typical motions, without the outliers",
        "the logs disagree beyond chance on range_bias (0.1, 0.2)",
        "no true poses with headings are known: all numbers are from residuals",
        "with the map, wheel_scale would be 0.9956, 5.7 standard deviations from what the log says without it: the map or "
        "the ranges have a wrong scale, landmarks have moved, or ids are wrong. Biases are those of the log without the map",
        "covariances do not contain what is unknown of the biases taken out of the log: wheel_scale, turn_scale",
        "a: 1277 of 5627 sightings are of other robots: left out",
        "the log does not tell turn_scale, bearing_bias and turn_rate_bias together: they can change so that poses and "
        "landmarks follow exactly; estimate all but one of them",
        "parameters are estimated with residual='cartesian' only, and not with 'polar'",
        "6 variants (pairs 2-D, ...) left out: without psi one landmark does not fix a pose: poses 5, 6 and 46 "
        "more share only one with the rest; use edges='virtual+motion' or a sensor with psi",
        "the noise models say less noise than this log shows, so that the noise of odometry and that of sightings cannot "
        "both be right: J per degree of freedom of graph is 20.1, and should be about 1; in the median it is 21.2 for "
        "sightings and 3.1 for motions. Perhaps the robot slips, or the sightings of several landmarks are wrong together",
        "b: positions are metres east and north of latitude 48.0, longitude 11.0 degrees (WGS 84), the first fix of an "
        "earlier log",
        "Not recommended: b: the log has only 98 sightings with ids, which tell the noise roughly: the trajectory may be "
        "several times less accurate than with the true noise, which motion and sensor models, or --noise FILE, give",
        "of the ids 25% contradict the other sightings; is the column of the ids right, and did the odometry neither slip "
        "nor jump?",
        "graph did not converge: max_iterations = 100 reached (started rotation-first, gauss-newton)",
        "graph did not converge: stuck: no step lowers the cost 1553.27, however short",
        "graph did not converge: the last step lowered J by less than 1e-09 of it (started rotation-first, gauss-newton; J "
        "falls at every step, because all other ends are above the values there)",
        "a.g2o: gtsam-lm did not reach the best chi2: the cost changed by less than 1e-09 of it",
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


SEEN = "63 sightings of landmarks 0, 7 and 8 of the map "


@pytest.mark.parametrize(
    "message",
    [
        SEEN + "fit it no better than that of another place (odds 5.2e-07): is it that, or are more sightings of other "
        "landmarks needed?",
        SEEN + "leave open where d heads at its first pose (standard deviation 50 degrees); more sightings of other "
        "landmarks are needed",
        SEEN
        + "fit several first poses of d alike, such as (1.00, 2.00) m and (2.00, 3.00) m; more sightings are needed",
        SEEN + "fit no first pose of d: at the best place 3 of them agree; is it the map of another place, are ids "
        "misread, or has the noise of the sensor another size?",
        "1 sighting of landmark 0 of the map fit no first pose of d: at the best place 0 of them agree; they would with the "
        "map with ids one lower: do the ids of one count from 0, and of the other from 1?",
        "d sees only landmark 3 of the map, and one landmark without a heading does not say where the robot is: two are "
        "needed",
        "d has sightings without ids, and they do not say surely where in the map it begins: (-3.88, -1.42) m, 83 degrees "
        "with probability 0.6; (3.88, -1.42) m, 9 degrees with probability 0.3; more sightings are needed, or give it the "
        "pose",
        "d has sightings without ids, which do not say where in the map it begins; they would with the map in feet: give "
        "it in metres",
        "graph: found 10 landmarks in sightings without ids; 0 of 304 sightings are of no landmark (clutter), J per degree "
        "of freedom is 1.00",
        "d: 9 poses, 8 sightings (3 without an id) of 7 landmarks",
        "d: 9 poses, 1 sighting and 8 with a range or a bearing alone of 7 landmarks",
        "d: 9 poses, 8 sightings (3 without an id) and 8 with a range or a bearing alone of 7 landmarks",
        "particle-gibbs left out: d has no sightings of range and bearing: particle Gibbs would only repeat its noise model",
    ],
)
def test_other_sentences_of_a_run_are_japanese(message: str) -> None:
    assert not re.search(r"[a-z]{2,} [a-z]{2,}", translated(message, "ja"))


def test_names_of_parameters_stay_as_they_are() -> None:
    """One of them is called "no"."""
    (table,), _ = calibration_tables(Calibration(motion=MotionModel(), sensor=SensorModel()))
    cells = list(translated_table(table, "ja").columns[0].cells)
    assert cells[:4] == ["nn", "no", "on", "oo"]


def test_notes_of_a_log_whose_name_is_words() -> None:
    assert translated("my own robot: 5627 of 9000 sightings are of other robots: left out.", "ja").startswith(
        "my own robot: 9000個のセンサ値のうち5627個"
    )
    assert translated("Animation:           slam-compare animate 'my own robot' a.gif", "ja").startswith(
        "アニメーション"
    )
