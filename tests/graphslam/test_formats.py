from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import comparisons
from graphslam import (
    AbsolutePositions,
    FormatError,
    LandmarkMap,
    Log,
    MotionModel,
    OptionError,
    PoseRelations,
    SensorModel,
    load,
    sample_log_path,
    save,
)
from graphslam.log.measurements import PartialSightings, Session

BOOK = "x 0 0 -3 0\nz 0 1 2.0 0.1 3.0\nx 1 0.5 -2.9 0.2\nz 1 1 1.5 -0.4 3.1\nz 1 4 3.0 0.2 -1.0\n"
WITH_CONTROLS = (
    "delta 3\nu 0 0.2 0.1\nx 0 0 -3 0\nz 0 1 2.0 0.1 3.0\nu 1 0.2 0.1\nx 1 0.5 -2.9 0.2\nz 1 1 1.5 -0.4 3.1\n"
)

number = st.floats(-1e6, 1e6)


@st.composite
def logs(draw, extended=True):
    motions = draw(st.integers(1, 4))
    count = draw(st.integers(0, 5))
    columns = draw(st.sampled_from([2, 3])) if count else 3
    steps = sorted(draw(st.lists(st.integers(0, motions), min_size=count, max_size=count)))
    ids = draw(st.lists(st.integers(0, 10**9), min_size=count, max_size=count, unique=True))
    sightings = draw(hnp.arrays(float, (count, columns), elements=st.floats(1e-3, 3)))
    arguments = {
        "steps": steps,
        "landmarks": ids,
        "sightings": sightings,
        "initial_poses": draw(hnp.arrays(float, (motions + 1, 3), elements=number)),
    }
    if draw(st.booleans()):
        arguments["controls"] = draw(hnp.arrays(float, (motions, 2), elements=number))
        arguments["dt"] = draw(st.floats(1e-3, 100))
    if extended:
        if "controls" in arguments:
            arguments["dt"] = draw(hnp.arrays(float, motions, elements=st.floats(1e-3, 100)))
        arguments["start_time"] = draw(number)
        if draw(st.booleans()):
            arguments["true_poses"] = draw(hnp.arrays(float, (motions + 1, 3), elements=number))
            arguments["true_landmarks"] = {
                3: draw(hnp.arrays(float, 2, elements=number)),
                -7: np.array([1.0, 2.0, 3.0]),
            }
    return Log(**arguments)


@settings(max_examples=50)
@given(log=logs())
def test_npz_keeps_everything(log, tmp_path_factory):
    path = tmp_path_factory.mktemp("npz") / "log.npz"
    save(log, path)
    assert load(path).equals(log)
    # whether it is simulated is no part of the data, but decides about the default kernel of a run
    assert not load(path).simulated
    save(log.replace(simulated=True), path.with_suffix(".NPZ"))
    assert load(path.with_suffix(".NPZ")).simulated


@settings(max_examples=50)
@given(log=logs(extended=False))
def test_book_format_round_trip(log, tmp_path_factory):
    path = tmp_path_factory.mktemp("lnpr") / "log.txt"
    if log.controls is not None:
        # a log in the format of the book, with controls, was made with the noise of the book: one of unknown noise has none
        with pytest.raises(FormatError, match="cannot hold other noise than the book's"):
            save(log, path)
        log = log.replace(motion=MotionModel(), sensor=SensorModel())
    save(log, path)
    assert load(path).equals(log)


@pytest.mark.parametrize("name", ["lnpr/log_for_book.txt", "lnpr/log2_for_book.txt"])
def test_the_books_own_logs(shared_data, tmp_path, name):
    log = load(shared_data(name))
    assert log.has_orientation
    assert log.landmark_ids.tolist() == [0, 1, 2, 3, 4, 5]
    if "log2" in name:
        assert (log.num_poses, len(log.steps), len(log.controls)) == (62, 101, 61)
        assert "u 61" in log.notes[0]
        np.testing.assert_array_equal(log.dt, 3.0)
    else:
        assert (log.num_poses, len(log.steps), log.controls) == (54, 91, None)
    for suffix in ("txt", "npz"):
        save(log, tmp_path / f"log.{suffix}")
        assert load(tmp_path / f"log.{suffix}").equals(log)


def test_a_control_leaves_its_pose(tmp_path):
    path = tmp_path / "log.txt"
    path.write_text(WITH_CONTROLS.replace("u 1 0.2 0.1", "u 1 9 9"))
    np.testing.assert_array_equal(load(path).controls, [[0.2, 0.1]])


@pytest.mark.parametrize(
    ("content", "line", "message"),
    [
        ("", None, "the file is empty"),
        ("  \n\n", None, "the file is empty"),
        (BOOK.replace("z 0", "q 0"), 2, "unknown line tag 'q'"),
        (BOOK.replace("z 0 1 2.0 0.1 3.0", "z 0 1 2.0"), 2, "4 columns"),
        (BOOK.replace("x 1 0.5 -2.9 0.2", "x 1 0.5 -2.9"), 3, "4 columns"),
        (BOOK.replace("x 1 0.5 -2.9 0.2", "x 1 0.5 -2.9 0.2 7"), 3, "6 columns"),
        (BOOK.replace("z 1 1 1.5 -0.4 3.1", "z 1 1 1.5 -0.4"), 4, "this sighting has no PSI, unlike line 2"),
        (BOOK.replace("-0.4", "abc"), 4, "BEARING should be a number, not 'abc'"),
        (BOOK.replace("-0.4", "nan"), 4, "bearing is empty or NaN"),
        (BOOK.replace("-2.9", "inf"), 3, "Y is inf"),
        (BOOK.replace("x 1", "x 2"), 3, "step number jumps: expected 'x 1', found 'x 2'"),
        (BOOK.replace("x 1", "x 0"), 3, "step number repeats"),
        (BOOK + "x 2 0 0 0\nx 0 0 0 0\n", 7, "step number runs backwards"),
        (BOOK + "z 0 2 1 0 0\n", 6, "step number runs backwards"),
        (BOOK.replace("z 1 4", "z 5 4"), 5, "step number jumps"),
        (BOOK.replace("z 1 4", "z 1.5 4"), 5, "step number should be a whole number"),
        (BOOK.replace("z 1 4", "z 1 four"), 5, "ID should be a whole number"),
        (BOOK.replace("1.5", "-1.5"), 4, "the range is -1.5 m, but"),
        (BOOK.replace("z 1 4", "z 1 1"), 5, r"landmark 1 is seen twice in step 1 \(first in line 4\)"),
        (WITH_CONTROLS.replace("delta 3", "delta 0"), 1, "delta is 0"),
        (WITH_CONTROLS.replace("delta 3\n", ""), 1, "a control before any delta line"),
        (WITH_CONTROLS + "delta 3\n", 8, "a second delta line"),
        (WITH_CONTROLS.replace("u 1 0.2 0.1\n", "") + "x 2 0 0 0\n", 7, "3 poses need 2 controls, found 1"),
        ("delta 3\n", 1, "no pose line"),
        ("hello world\nthis is no log\n", 1, "not a log in any known format"),
        ("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n", 1, "this is a pose graph and no log"),
    ],
)
def test_damaged_files_name_the_line(tmp_path, content, line, message):
    path = tmp_path / "log.txt"
    path.write_text(content)
    with pytest.raises(FormatError, match=message) as caught:
        load(path)
    assert caught.value.line == line
    assert str(caught.value).startswith(f"{path}:{line}: " if line else f"{path}: ")


def test_bearings_are_wrapped(tmp_path):
    path = tmp_path / "log.txt"
    path.write_text(BOOK.replace("-0.4", "7.0"))
    assert load(path).sightings[1, 1] == pytest.approx(7.0 - 2 * np.pi)


def test_places_that_cannot_be_read_or_written(tmp_path):
    with pytest.raises(FormatError, match="no such file"):
        load(tmp_path / "absent.txt")
    with pytest.raises(FormatError, match="this is a folder"):
        load(tmp_path)
    log = Log(initial_poses=np.zeros((1, 3)), steps=[], landmarks=[], sightings=[])
    with pytest.raises(FormatError, match="cannot write into"):
        save(log, tmp_path / "absent" / "log.npz")
    with pytest.raises(FormatError, match="suffix"):
        save(log, tmp_path / "log.xyz")
    with pytest.raises(OptionError, match="format must be one of"):
        load(tmp_path / "absent.txt", format="rosbag")


def test_the_home_folder_is_known_as_in_a_shell(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    log = load(sample_log_path())
    save(log, "~/log.npz")
    assert (tmp_path / "log.npz").exists() and load("~/log.npz").equals(log)
    LandmarkMap({1: (1.0, 2.0)}).save("~/map.csv")
    assert LandmarkMap.load(Path("~/map.csv")).keys() == {1}
    assert comparisons.run("~/log.npz", estimators=["dead-reckoning"]).source == tmp_path / "log.npz"
    with pytest.raises(FormatError, match="^~nobody-has-this-name/log.npz: there is no such file"):
        load("~nobody-has-this-name/log.npz")


def test_archives_that_are_not_logs(tmp_path):
    path = tmp_path / "log.npz"
    np.savez(path, a=np.zeros(3))
    with pytest.raises(FormatError, match="not a log"):
        load(path)
    np.savez(path, format="graphslam-log-1", steps=[])
    with pytest.raises(FormatError, match="lacks the array 'landmarks'"):
        load(path)
    path.write_bytes(b"PK\x03\x04 cut short")
    with pytest.raises(FormatError, match="not a readable .npz archive"):
        load(path)


def test_what_the_book_format_cannot_hold_is_refused_and_leaves_no_file(tmp_path):
    path = tmp_path / "log.txt"
    base = {
        "steps": [0, 0],
        "landmarks": [1, 2],
        "sightings": [[1.0, 0.0], [2.0, 0.0]],
        "initial_poses": np.zeros((3, 3)),
    }
    for changes, what in [
        ({"true_poses": np.zeros((3, 3))}, "the truth"),
        ({"dt": [1.0, 2.0], "controls": np.ones((2, 2))}, "steps of different length"),
        ({"start_time": 5.0}, "a start time"),
        ({"landmarks": [1, 1]}, "two sightings of one landmark"),
        ({"classes": ["cone", "tree"]}, "the classes of sightings"),
        ({"relations": PoseRelations(first=[0], second=[2], motions=[[1, 0, 0]], covariances=np.eye(3))}, "relations"),
        ({"positions": AbsolutePositions(steps=[0], places=[[1, 2]], covariances=np.eye(2))}, "positions"),
        (
            {"partial_sightings": PartialSightings(steps=[1], landmarks=[1], ranges=[2.0], bearings=[np.nan])},
            "partial sightings",
        ),
        ({"sessions": (Session("first", 0, 0.0), Session("second", 2, 5.0))}, "several sessions"),
        ({"uncertain": {"range_bias": 0.1}}, "biases that were taken out"),
    ]:
        with pytest.raises(FormatError, match=what):
            save(Log(**(base | changes)), path)
    assert list(tmp_path.iterdir()) == []


def test_a_failed_write_keeps_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "log.npz"
    log = Log(initial_poses=np.zeros((1, 3)), steps=[], landmarks=[], sightings=[])
    save(log, path)
    before = path.read_bytes()

    def broken(*_args, **_kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np.lib.format, "write_array", broken)
    with pytest.raises(FormatError, match="No space left"):
        save(log, path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["log.npz"]


def test_the_datum_of_positions_is_the_first_fix_with_its_altitude_and_kept_by_files(tmp_path):
    odometry = {"t": [0.0, 1.0, 2.0], "nu": [1.0, 1.0, 1.0], "omega": [0.0, 0.0, 0.0]}
    sightings = {"t": [0.0, 1.0, 2.0], "id": [1, 1, 1], "range": [3.0, 2.0, 1.0], "bearing": [0.0, 0.0, 0.0]}
    fixes = {"t": [0.0, 2.0], "lat": [60.0, 60.001], "lon": [25.0, 25.0], "alt": [2000.0, 2010.0], "sigma": [1.0, 1.0]}
    log = Log.from_tables(odometry, sightings, positions=fixes)
    assert np.array_equal(log.positions.datums, [[60.0, 25.0, 2000.0]] * 2)
    # an arc of the meridian, longer by the height
    low = Log.from_tables(odometry, sightings, positions={**fixes, "alt": [0.0, 0.0]})
    assert log.positions.places[1, 1] - low.positions.places[1, 1] == pytest.approx(2000 * np.deg2rad(0.001), rel=1e-4)
    save(log, tmp_path / "log.npz")
    assert load(tmp_path / "log.npz").positions.equals(log.positions)
