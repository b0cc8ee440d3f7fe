"""MR.CLAM folders: small ones written here, whole and damaged."""

import numpy as np
import pytest

from graphslam import FormatError, OptionError, SlamError, load

HEAD = "# UTIAS Multi-Robot Cooperative Localization and Mapping Dataset\n# Time [s]    what    follows\n"
UNIX = 1248444175.0


def table(rows):
    lines = (" ".join([f"{time:.3f}", *(f"{value:.8f}" for value in values)]) for time, *values in rows)
    return HEAD + "".join(f"{line}\n" for line in lines)


@pytest.fixture
def folder(tmp_path):
    """Robot 2 on a circle of radius 2 m about the origin, at 1 m/s for 4 s, truth for 3 s; landmark 6 at the middle."""
    path = tmp_path / "set"
    path.mkdir()
    times = UNIX + np.arange(0, 4.001, 0.02)
    angle = 0.5 * (times - UNIX)
    (path / "Barcodes.dat").write_text(HEAD + "1 5\n2 14\n6 63\n7 25\n")
    (path / "Landmark_Groundtruth.dat").write_text(HEAD + "6 0.0 0.0 0.0001 0.0001\n7 3.0 0.0 0.0001 0.0001\n")
    (path / "Robot2_Odometry.dat").write_text(table([(t, 1.0, 0.5) for t in times]))
    truth = np.column_stack([times, 2 * np.cos(angle), 2 * np.sin(angle), angle + np.pi / 2])
    (path / "Robot2_Groundtruth.dat").write_text(table(truth[times < UNIX + 3]))
    # the landmark in the middle is 2 m to the left at any time; then another robot, a stranger, and the middle again
    seen = [(UNIX + 0.51, 63, 2.0, np.pi / 2), (UNIX + 1.0, 5, 1.0, 0.0), (UNIX + 1.0, 99, 1.0, 0.0)]
    seen += [(UNIX + 2.515, 63, 2.0, np.pi / 2), (UNIX + 3.5, 63, 2.0, np.pi / 2)]
    (path / "Robot2_Measurement.dat").write_text(table(seen))
    return path


def test_a_folder_is_read_by_what_is_in_it(folder):
    log = load(folder)
    assert log.name == "set-robot2"
    np.testing.assert_allclose(log.times - UNIX, [0.51, 2.515, 3.5], atol=1e-5)
    assert (log.landmarks.tolist(), log.landmark_ids.tolist()) == ([6, 6, 6], [6])
    assert log.covered.tolist() == [True, True, False]
    # the middle is where every sighting puts it, from the true poses and from dead reckoning alike
    for poses in (log.true_poses[:2], log.initial_poses[:2]):
        x, y, theta = poses.T
        np.testing.assert_allclose(x + 2 * np.cos(theta + np.pi / 2), 0, atol=1e-4)
        np.testing.assert_allclose(y + 2 * np.sin(theta + np.pi / 2), 0, atol=1e-4)
    assert sorted(log.true_landmarks) == [6, 7]
    assert "1 of 5 sightings are of other robots: left out" in log.notes
    assert "1 of 5 sightings are of unknown barcodes: left out" in log.notes
    assert "the truth covers 2 of 3 poses" in log.notes


def test_windows_line_ends_change_nothing(folder):
    log = load(folder)
    for path in folder.iterdir():
        path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    assert load(folder).equals(log)


def test_a_pose_every_so_often(folder):
    assert np.diff(load(folder, keep_every=0.5).times).max() <= 0.5 + 1e-6


def test_of_several_robots_one_must_be_named(folder):
    for kind in ("Odometry", "Measurement"):
        (folder / f"Robot4_{kind}.dat").write_bytes((folder / f"Robot2_{kind}.dat").read_bytes())
    with pytest.raises(OptionError, match=r"robots 2, 4: say which \(robot=N\)"):
        load(folder)
    with pytest.raises(OptionError, match="no files of robot 3; its robots are 2, 4"):
        load(folder, robot=3)
    assert load(folder, robot=2, format="mrclam").true_poses is not None
    four = load(folder, robot=4)
    assert four.true_poses is None
    assert any("Robot4_Groundtruth.dat, which would hold the true poses, is missing" in note for note in four.notes)


@pytest.mark.parametrize(
    ("name", "holds"),
    [
        ("Barcodes.dat", "which barcode each robot and landmark has"),
        ("Robot2_Odometry.dat", "the velocities of the robot"),
        ("Robot2_Measurement.dat", "the ranges and bearings that the robot measured"),
    ],
)
def test_a_missing_file_is_named_with_what_it_would_hold(folder, name, holds):
    (folder / name).unlink()
    with pytest.raises(FormatError, match=f"{name}: this file of the data set is missing; it would hold {holds}"):
        load(folder)


def test_a_missing_map_is_said(folder):
    (folder / "Landmark_Groundtruth.dat").unlink()
    log = load(folder)
    assert log.true_landmarks is None
    assert any("Landmark_Groundtruth.dat" in note for note in log.notes)


@pytest.mark.parametrize(
    ("name", "line", "message"),
    [
        ("Robot2_Odometry.dat", "1248444175.000 1.0", r":204: expected 3 columns \(time, velocity, .*\), found 2"),
        ("Robot2_Odometry.dat", "1248444179.500 fast 0.5", ":204: 'velocity' should be a number, not 'fast'"),
        ("Robot2_Odometry.dat", "\n".join(["1248444179.500 nan 0.5"] * 20), ":204: velocity is .*NaN.*; 20 of 221 rows"),
        (
            "Robot2_Odometry.dat", "1248444170.000 1.0 0.5\n1248444170.100 1.0 0.5",
            r":204: time runs backwards: 1248444170\.000 s comes after",
        ),
        ("Robot2_Measurement.dat", "1248444170.000 63 1.0 0.5", ":8: the time is 1248444170.000, far from those"),
        ("Robot2_Odometry.dat", "-1e300 1.0 0.5\n-1e300 1.0 0.5", "-1e.300"),
        ("Robot2_Measurement.dat", "1248444178.900 63 0.0 0.5", ":8: the range is 0 m, but a range is above zero"),
        ("Robot2_Measurement.dat", "1248444178.900 63.7 1.0 0.5", ":8: the barcode should be a whole number, not 63.7"),
        ("Barcodes.dat", "9 1e308", "Barcodes.dat:7: expected two whole numbers, subject and barcode, not 9 and 1e.308"),
        ("Barcodes.dat", "9 63", "two subjects have the same barcode"),
    ],
)  # fmt: skip
def test_damaged_lines_are_blamed(folder, name, line, message):
    with (folder / name).open("a") as stream:
        stream.write(line + "\n")
    with pytest.raises(FormatError, match=message):
        load(folder)


def test_large_numbers_are_written_with_an_exponent(folder):
    path = folder / "Robot2_Odometry.dat"
    lines = path.read_text().splitlines()
    lines[7] = "1e300 1.0 0.5"
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(FormatError, match=r":8: the time is 1e\+300, far from those"):
        load(folder, strict=True)
    with pytest.raises(OptionError, match="no files of robot 1") as raised:
        load(folder, robot=10**400)
    assert len(str(raised.value)) < 200 + len(str(folder))


def test_a_robot_that_saw_no_landmark(folder):
    (folder / "Robot2_Measurement.dat").write_text(table([(UNIX + 1.0, 5, 1.0, 0.0)]))
    with pytest.raises(FormatError, match="no sighting of any landmark"):
        load(folder)
    (folder / "Robot2_Measurement.dat").write_text(HEAD)
    with pytest.raises(FormatError, match="no sighting of any landmark"):
        load(folder)


def test_files_that_are_not_text(folder):
    (folder / "Barcodes.dat").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FormatError, match="not a readable text file in UTF-16; was it cut short"):
        load(folder)
    (folder / "Barcodes.dat").write_bytes(b"\xe4")
    with pytest.raises(FormatError, match="not a text file in UTF-8; if it is in another encoding"):
        load(folder)


def test_options_for_the_wrong_format(folder, tmp_path):
    with pytest.raises(SlamError, match="a folder"):
        load(folder / "Barcodes.dat", format="mrclam")
    (tmp_path / "log.txt").write_text("x 0 0 0 0\n")
    with pytest.raises(OptionError, match="robot does not apply to logs of the format 'lnpr'"):
        load(tmp_path / "log.txt", robot=1)
    with pytest.raises(FormatError, match="not that of a known data set"):
        load(tmp_path)


def test_a_byte_order_mark_is_no_number(folder):
    for path in folder.glob("*.dat"):
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert load(folder).num_poses > 1
