"""Data sets in MATLAB files: small ones written here, whole and damaged."""

from contextlib import suppress

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from graphslam import FormatError, MotionModel, load
from graphslam.io.mat import variables
from graphslam.io.victoria_park import ackermann
from graphslam.log import UNIDENTIFIED

PARAMETERS = """sigv = 0.02;   --- variance on speed noise
sigomega = (4*pi/180); --- variance on turnrate noise
sigr = 0.1; unit: m -- variance on range observation
sigtheta = (1*pi/180); unit: rad -- variance on bearing observation
"""


@pytest.fixture
def huang(tmp_path):
    """Three steps: straight, a turn, straight; two beacons, stored as unsigned numbers."""
    path = tmp_path / "huang"
    path.mkdir()
    speed, turn = np.array([[1.0, 1.0, 2.0]]), np.array([[0.0, 1.0, 0.0]])
    true = [[0, 0, 0]]
    for v, w in zip(speed[0], turn[0]):
        x, y, phi = true[-1]
        true.append([x + 0.3 * v * np.cos(phi + 0.3 * w), y + 0.3 * v * np.sin(phi + 0.3 * w), phi + 0.3 * w])
    variables = {
        "store_speed": speed, "store_turnrate": turn, "store_robotTrue": np.array(true).T,
        "store_beaconsTrue": np.array([[1, 5, 0], [2, 0, 5]], dtype=np.uint16),
        "sensor_data": np.array(
            [[1, 1, 5.0, 2 * np.pi, 0, 0, 0], *(20 * [[4, 2, 5.0, 1.0, 0, 0, 0]]), [4, 1, -0.01, 1.0, 0, 0, 0]]
        ),
    }  # fmt: skip
    for name, value in variables.items():
        savemat(path / f"{name}.mat", {name: value})
    (path / "parameters.txt").write_text(PARAMETERS)
    return path


def test_huang(huang):
    log = load(huang)
    # the robot turns first and then drives straight, as the true poses here do
    np.testing.assert_allclose(log.initial_poses, log.true_poses, atol=1e-12)
    np.testing.assert_allclose(log.times, [0, 0.3, 0.6, 0.9])
    assert log.steps.tolist() == [0, *(20 * [3])]
    np.testing.assert_allclose(log.sightings[0], [5.0, 0.0], atol=1e-12)
    assert log.true_landmarks[2].tolist() == [0.0, 5.0]
    assert "1 of 22 sightings has a negative range: left out (row 22)" in log.notes
    with pytest.raises(FormatError, match="the range is -0.01 m"):
        load(huang, strict=True)
    assert (log.sensor.range_rate, log.sensor.range_std) == (0.0, 0.1)
    assert log.sensor.bearing_std == pytest.approx(np.pi / 180)


def test_huang_noise_of_a_step_is_the_published_one(huang):
    _, covariance = load(huang).motions()
    # the first step drives 0.3 m straight: 0.02 m/s and 4 degrees/s held for 0.3 s
    assert covariance[0, 0, 0] == pytest.approx((0.02 * 0.3) ** 2, rel=1e-3)
    assert covariance[0, 2, 2] == pytest.approx((np.radians(4) * 0.3) ** 2, rel=1e-3)


@pytest.mark.parametrize("name", ["store_speed", "store_turnrate", "sensor_data"])
def test_huang_without_a_file(huang, name):
    (huang / f"{name}.mat").unlink()
    with pytest.raises(FormatError, match=f"{name}.mat: this file of the data set is missing; it would hold the"):
        load(huang)


def test_huang_without_truth_or_noise(huang):
    for name in ("store_robotTrue.mat", "store_beaconsTrue.mat", "parameters.txt"):
        (huang / name).unlink()
    log = load(huang)
    assert (log.true_poses, log.true_landmarks, log.motion, log.sensor) == (None, None, None, None)
    assert len([note for note in log.notes if "missing" in note]) == 3


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("store_turnrate", np.zeros((1, 2)), "'store_turnrate' should be 1 x 3, but is 1 x 2"),
        ("store_speed", np.zeros((3, 1)), "'store_speed' should be 1 x N, but is 3 x 1"),
        ("store_speed", np.array([[1.0, np.nan, 2.0]]), "not finite"),
        ("store_robotTrue", np.zeros((3, 9)), "should be 3 x 4"),
        ("sensor_data", np.zeros((0, 7)), "no sighting of any landmark|should be N x 7"),
        ("sensor_data", np.array([[5, 1, 1.0, 0, 0, 0, 0]]), "steps 1 to 4"),
        ("sensor_data", np.array([["no", "numbers"]]), "should be numbers"),
        ("sensor_data", np.array([[1, 1, -1.0, 0, 0, 0, 0]]), "the range is -1 m, but a range is above zero"),
    ],
)
def test_huang_with_another_content(huang, name, value, message):
    savemat(huang / f"{name}.mat", {name: value})
    with pytest.raises(FormatError, match=message):
        load(huang)


def woods(**changes):
    """Four times, two landmarks; the truth of the last time is not valid."""
    column = np.ones((4, 1))
    return {
        "t": np.arange(4.0)[:, None] / 10, "v": np.array([[9.0], [1.0], [2.0], [3.0]]), "om": 0 * column,
        "r": np.array([[0, 0], [2.0, 0], [0, 0], [3.0, 1.0]]), "b": np.array([[0, 0], [0.1, 0], [0, 0], [0.2, 0.3]]),
        "d": [[0.2]], "r_var": [[0.01]], "b_var": [[0.04]], "v_var": [[0.09]], "om_var": [[0.16]],
        "x_true": 5 * column, "y_true": 6 * column, "th_true": 0 * column, "true_valid": np.array([[1], [1], [1], [0]]),
        "l": np.array([[1.0, 2.0], [3.0, 4.0]]),
    } | changes  # fmt: skip


def test_lost_in_the_woods(tmp_path):
    savemat(tmp_path / "dataset2.mat", woods())
    for place in (tmp_path, tmp_path / "dataset2.mat"):
        log = load(place)
        # row k drives to time k: the first row, 9 m/s, is nobody's
        np.testing.assert_allclose(log.initial_poses[:, 0], [5.0, 5.1, 5.3, 5.6])
        assert (log.steps.tolist(), log.landmarks.tolist()) == ([1, 3, 3], [0, 0, 1])
        assert log.covered.tolist() == [True, True, True, False]
        assert log.sensor.offset == (0.2, 0.0)
        assert (log.sensor.range_std, log.sensor.bearing_std) == pytest.approx((0.1, 0.2))
        assert (log.motion.sigma_v, log.motion.sigma_omega) == pytest.approx((0.3, 0.4))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"t": np.zeros((4, 1))}, r"two rows have the time t = 0\.000 s"),
        ({"t": np.array([[0.0], [0.1], [5.0], [0.2]])}, r"run backwards in row 4: 0\.200 s comes 4\.800 s too late"),
        ({"l": np.zeros((3, 2))}, "'l' should be 2 x 2, but is 3 x 2"),
        ({"r": np.zeros((4, 2))}, "no sighting of any landmark"),
        ({"b": np.zeros((4, 3))}, "'b' should be 4 x 2, but is 4 x 3"),
        ({"d": [[0.1, 0.2]]}, "'d' should be 1 x 1"),
    ],
)
def test_lost_in_the_woods_with_another_content(tmp_path, changes, message):
    savemat(tmp_path / "dataset2.mat", woods(**changes))
    with pytest.raises(FormatError, match=message):
        load(tmp_path)


def test_rows_of_lost_in_the_woods_that_are_out_of_order_are_sorted(tmp_path):
    order, whole = [0, 2, 1, 3], woods()
    per_time = [name for name, value in whole.items() if len(value) == 4]
    savemat(tmp_path / "dataset2.mat", whole)
    sorted_log = load(tmp_path)
    savemat(tmp_path / "dataset2.mat", whole | {name: np.asarray(whole[name])[order] for name in per_time})
    log = load(tmp_path)
    assert log.notes[0] == "1 row of the data runs backwards, by at most 0.1 s: sorted by time"
    assert log.replace(notes=sorted_log.notes).equals(sorted_log)


def test_a_gap_in_lost_in_the_woods_is_bridged(tmp_path):
    savemat(tmp_path / "dataset2.mat", woods(t=np.array([[0.0], [0.1], [9.1], [9.2]])))
    with pytest.warns(UserWarning, match="1 gap of 9.0 s"):
        log = load(tmp_path)
    assert log.control_variances[:, 0].tolist() == [0.0, pytest.approx(np.mean(np.square([1.0, 2.0, 3.0]))), 0.0]


def test_a_mat_of_another_layout(tmp_path):
    content = woods()
    del content["om_var"]
    savemat(tmp_path / "almost.mat", content)
    with pytest.raises(FormatError, match=r"another layout: expected the variables t, v, .* but 'om_var' is missing"):
        load(tmp_path / "almost.mat")
    savemat(tmp_path / "other.mat", {"a": [[1.0]]})
    with pytest.raises(FormatError, match="not a log in any known format"):
        load(tmp_path / "other.mat")
    whole = (tmp_path / "almost.mat").read_bytes()
    (tmp_path / "cut.mat").write_bytes(whole[:-8])
    with pytest.raises(FormatError, match="was it cut short"):
        load(tmp_path / "cut.mat", format="lost-in-the-woods")
    with pytest.raises(FormatError, match="no such file"):
        load(tmp_path / "absent.mat", format="victoria-park")


@pytest.fixture
def park(tmp_path):
    """One second at 2 m/s of the wheel and a steering angle, three scans of which the first comes too early."""
    scans = np.empty((1, 3), dtype=object)
    scans[0, 0] = np.array([[9.0], [np.pi / 2], [0.3]])
    scans[0, 1] = np.array([[4.0, 5.0], [np.pi / 2, np.pi], [0.2, 0.3]])
    scans[0, 2] = np.zeros((0, 0))
    times = 10 + np.arange(41) / 40
    savemat(
        tmp_path / "trees.mat",
        {"time": times[None], "u": np.full((2, 41), [[2.0], [0.1]]), "TLsr": [[9.9, 10.51, 10.9]], "zt": scans},
    )
    gps = {
        "timeGps": np.array([[10000], [10700], [15000]]),
        "Lo_m": [[0.0], [7.0], [1.0]],
        "La_m": [[0.0], [0.7], [1.0]],
    }
    savemat(tmp_path / "aa3_gpsx.mat", gps)
    return tmp_path


def test_victoria_park(park):
    log = load(park)
    assert log.num_poses == 1
    assert log.landmarks.tolist() == [UNIDENTIFIED] * 2
    # straight ahead, and a quarter to the left
    np.testing.assert_allclose(log.sightings, [[4.0, 0.0], [5.0, np.pi / 2]], atol=1e-12)
    assert "1 of 3 sightings are from before or after the odometry: left out" in log.notes
    # GPS comes 0.7 s apart, farther than it is interpolated over
    assert log.true_poses is None
    assert load(park, keep_every=0.1).num_poses == 1


def test_rows_of_victoria_park_that_are_out_of_order_are_sorted(park):
    content, swapped = loadmat(park / "trees.mat"), np.arange(41)
    plain = load(park)
    swapped[[30, 31]] = 31, 30
    drive = {"time": content["time"][:, swapped], "u": content["u"][:, swapped]}
    scans = {"TLsr": content["TLsr"][:, [0, 2, 1]], "zt": content["zt"][:, [0, 2, 1]]}
    savemat(park / "trees.mat", drive | scans)
    log = load(park)
    # the scan of 10.9 s is empty, so that only the odometry has a row out of order
    assert [note for note in log.notes if "sorted" in note] == [
        "1 row of the odometry runs backwards, by at most 0.025 s: sorted by time"
    ]
    assert log.replace(notes=plain.notes).equals(plain)


def test_steps_of_huang_need_no_order(huang):
    plain = load(huang)
    seen = loadmat(huang / "sensor_data.mat")["sensor_data"]
    savemat(huang / "sensor_data.mat", {"sensor_data": np.roll(seen, -1, axis=0)})
    assert load(huang).equals(plain)


def test_victoria_park_without_gps(park):
    (park / "aa3_gpsx.mat").unlink()
    assert any("aa3_gpsx.mat" in note for note in load(park / "trees.mat").notes)


def test_the_car_turns_about_its_rear_axle():
    # with the wheels turned by alpha the rear axle's middle runs on a circle of radius L / tan(alpha), to the left
    nu, omega = ackermann(np.array([2.0]), np.array([0.3]))[0]
    radius = 2.83 / np.tan(0.3)
    assert nu / omega == pytest.approx(radius)
    # the encoder is on the inner wheel, 0.76 m nearer to the centre, and turns as fast
    assert 2.0 / (radius - 0.76) == pytest.approx(omega)
    end = MotionModel().f([0.0, 0.0, 0.0], [nu, omega], np.pi / omega)
    np.testing.assert_allclose(end[:2], [0.0, 2 * radius], atol=1e-12)


def test_victoria_park_with_another_content(park):
    savemat(park / "trees.mat", {"time": [[1.0, 2.0]], "u": np.zeros((2, 3)), "TLsr": [[1.5]], "zt": np.zeros((1, 1))})
    with pytest.raises(FormatError, match="'u' should be 2 x 2, but is 2 x 3"):
        load(park)


def test_the_reader_of_matlab_files_agrees_with_scipy_and_survives_damage(tmp_path):
    rng = np.random.default_rng(0)
    cells = np.empty((1, 3), dtype=object)
    cells[:] = [[np.eye(2), np.zeros((0, 0)), np.arange(4.0)[None]]]
    content = {
        "a": rng.normal(size=(3, 4)), "whole": np.arange(6, dtype=np.int32).reshape(2, 3), "small": np.array([[7]], np.uint8),
        "cells": cells, "text": "abc", "structure": {"x": 1.0}, "cube": rng.normal(size=(2, 3, 4)), "empty": np.zeros((0, 2)),
    }  # fmt: skip
    for compressed in (False, True):
        path = tmp_path / "x.mat"
        savemat(path, content, do_compression=compressed)
        data, expected = path.read_bytes(), loadmat(path)
        found = variables(data)
        assert found.keys() == content.keys()
        for name in ("a", "whole", "small", "cube", "empty"):
            np.testing.assert_array_equal(found[name], expected[name])
        for ours, theirs in zip(found["cells"].ravel(), expected["cells"].ravel(), strict=True):
            np.testing.assert_array_equal(ours, theirs)
        assert found["text"].dtype == found["structure"].dtype == object
        assert variables(data, names_only=True).keys() == content.keys()
        for _ in range(1500):
            # SciPy's reader ends the process on some of these
            damaged = bytearray(data)
            for at in rng.integers(len(data), size=int(rng.integers(1, 4))):
                damaged[at] ^= 1 << int(rng.integers(8))
            del damaged[int(rng.integers(len(data))) if rng.random() < 0.2 else len(data) :]
            with suppress(ValueError):
                variables(bytes(damaged))
