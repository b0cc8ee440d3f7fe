"""Rows that cannot be are left out and counted; a table with many of them is refused, and every one with ``strict``."""

import numpy as np
import pytest
from typer.testing import CliRunner

import comparisons
from comparisons.cli import app
from comparisons.show.language import translated
from graphslam import FormatError, LogError, OnlineSolver, OptionError, load, sample_log_path, save
from graphslam.log import UNIDENTIFIED

LOG = load(sample_log_path())
TIMES = LOG.times[LOG.steps]
M = len(TIMES)


def table(header, rows):
    return "\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n"


@pytest.fixture
def drive(tmp_path):
    """A folder with the sample log as tables; call it with cells to change: {(row, column): text}."""

    def write(sightings=(), odometry=(), toml=""):
        path = tmp_path / "drive"
        path.mkdir(exist_ok=True)
        ends = np.append(LOG.times, LOG.times[-1] + 1)
        driven = np.vstack([LOG.controls, LOG.controls[-1:], LOG.controls[-1:]])
        for name, header, rows, changes in (
            ("odometry", "t,nu,omega", np.column_stack([ends, driven]), odometry),
            ("sightings", "t,id,range,bearing,psi", np.column_stack([TIMES, LOG.landmarks, LOG.sightings]), sightings),
        ):
            cells = [[repr(value) for value in row] for row in rows.tolist()]
            for (row, column), cell in dict(changes).items():
                cells[row][column] = cell
            (path / f"{name}.csv").write_text(table(header, cells))
        if toml:
            (path / "import.toml").write_text(toml)
        return path

    return write


WRONG = {
    "a negative range": (2, "-0.035", "a negative range", "the range is -0.035 m, but a range is above zero"),
    "a range of 0": (2, "0", "a range of 0", "the range is 0 m, but a range is above zero"),
    "no range": (2, "", "'range' empty, NaN or infinite", "'range' is empty or NaN"),
    "an infinite bearing": (3, "inf", "'bearing' empty, NaN or infinite", "'bearing' is inf"),
    "no psi": (4, "nan", "'psi' empty, NaN or infinite", "'psi' is empty or NaN"),
    "no time": (0, "", "no time", "the time 't' is nan; every row needs a time"),
    "a time of another day": (
        0,
        "86400",
        "a time that is far from those of the rows before and after",
        "the time 't' is",
    ),
    "a time of 1970": (0, "-1000", "a time that is far from those of the rows before and after", "the time 't' is"),
    "an id with decimals": (1, "2.5", "an id that is no whole number of 64 bits", "the id 'id' is 2.5"),
    "an id beyond 64 bits": (1, "1e300", "an id that is no whole number of 64 bits", "the id 'id' is 1e.300"),
}


@pytest.mark.parametrize("case", WRONG)
def test_one_bad_row_never_costs_a_file(case, drive):
    column, cell, has, message = WRONG[case]
    path = drive({(40, column): cell})
    log = load(path)
    assert f"{path}/sightings.csv: 1 of {M} sightings has {has}: left out (line 42)" in log.notes
    expected = load(drive())
    kept = np.arange(M) != 40
    np.testing.assert_array_equal(log.sightings, expected.sightings[kept])
    np.testing.assert_array_equal(log.landmarks, expected.landmarks[kept])
    # a strict reader names it, wherever that is asked for
    drive({(40, column): cell})
    with pytest.raises(FormatError, match=f"sightings.csv:42: {message}"):
        load(path, strict=True)
    with pytest.raises(FormatError, match="sightings.csv:42:"):
        load(drive({(40, column): cell}, toml="strict = true\n"))


def test_strict_on_the_command_line(drive):
    path = drive({(40, 2): "-0.035"})
    for call in (["show", path], ["run", path, "--estimators", "dead-reckoning"], ["import", path]):
        result = CliRunner().invoke(app, [*map(str, call), "--strict"])
        assert result.exit_code == 2 and "sightings.csv:42:" in " ".join(result.output.split()), result.output


def test_more_than_five_percent_are_refused_with_their_number(drive):
    allowed = int(0.05 * M)
    cells = {(row, 2): "nan" for row in range(3, 3 + allowed)}
    log = load(drive(cells))
    assert len(log.steps) == M - allowed
    assert any(
        f"{allowed} of {M} sightings have 'range' empty, NaN or infinite: left out (the first in line 5)" in n
        for n in log.notes
    )
    # all kinds together count
    cells[60, 2] = "-1"
    with pytest.raises(FormatError, match=r"sightings.csv:62: the range is -1 m"):
        load(drive(cells))
    cells[60, 2] = "nan"
    with pytest.raises(FormatError, match=rf"sightings.csv:5: .*; {allowed + 1} of {M} sightings have 'range' empty"):
        load(drive(cells))


def test_a_control_that_cannot_be_is_left_out(drive):
    log = load(drive(odometry={(10, 1): "nan", (20, 2): "inf", (30, 0): "1e9"}))
    notes = " ".join(log.notes)
    assert "has 'nu' empty, NaN or infinite: left out (line 12)" in notes
    assert "has 'omega' empty, NaN or infinite: left out (line 22)" in notes
    assert "has a time that is far from those of the rows before and after: left out (line 32)" in notes
    # the control before it goes on
    np.testing.assert_array_equal(log.controls[10], LOG.controls[9])


def test_a_speed_that_is_far_beyond_all_others_is_left_out(drive):
    expected = load(drive())
    # as an encoder that miscounts, or a driver that starts, has them; two in a row may be true
    log = load(drive(odometry={(10, 1): "500", (20, 2): "-900"}))
    for title, value, row in (("nu", 500, 10), ("omega", -900, 20)):
        has = f"a value of '{title}' that is far beyond all others"
        assert any(f"has {has}: left out (line {row + 2})" in note for note in log.notes)
        with pytest.raises(
            LogError, match=rf"odometry.csv:{row + 2}: '{title}' is {value}, and those of other rows are at most"
        ):
            load(drive(odometry={(row, 1 + (title == "omega")): str(value)}, toml="strict = true"))
    np.testing.assert_array_equal(np.delete(log.controls, [10, 20], 0), np.delete(expected.controls, [10, 20], 0))
    fast = load(drive(odometry={(10, 1): "9", (11, 1): "9"}))
    np.testing.assert_array_equal(fast.controls[10:12, 0], 9)


def test_an_index_without_a_title_is_ignored(drive, tmp_path):
    expected, folder = load(drive()), drive()
    for path in folder.glob("*.csv"):
        lines = path.read_text().splitlines()
        # as `DataFrame.to_csv` writes it
        path.write_text("\n".join(f"{k - 1 if k else ''},{line}" for k, line in enumerate(lines)))
    log = load(folder)
    np.testing.assert_array_equal(log.sightings, expected.sightings)
    np.testing.assert_array_equal(log.controls, expected.controls)


def test_arrays_of_our_own_format(tmp_path):
    save(LOG, tmp_path / "log.npz")
    content = dict(np.load(tmp_path / "log.npz"))
    content["sightings"][5, 0], content["sightings"][8, 1] = -0.035, np.nan
    np.savez(tmp_path / "bad.npz", **content)
    log = load(tmp_path / "bad.npz")
    assert len(log.steps) == M - 2
    assert f"1 of {M} sightings has a negative range: left out (row 6)" in log.notes
    with pytest.raises(FormatError, match="the range is -0.035 m|bearing is empty or NaN"):
        load(tmp_path / "bad.npz", strict=True)


def test_the_book_format(tmp_path):
    path = tmp_path / "log.txt"
    save(LOG.replace(true_poses=None, true_landmarks=None), path)
    lines = path.read_text().splitlines()
    rows = [k for k, line in enumerate(lines) if line.startswith("z")]
    for k, cell in zip(rows[3:5], ("-0.035", "nan")):
        words = lines[k].split()
        lines[k] = " ".join([*words[:3], cell, *words[4:]])
    path.write_text("\n".join(lines) + "\n")
    log = load(path)
    assert len(log.steps) == M - 2
    assert f"1 of {M} sightings has a negative range: left out (line {rows[3] + 1})" in log.notes
    with pytest.raises(FormatError, match=f":{rows[3] + 1}: the range is -0.035 m, but a range is above zero"):
        load(path, strict=True)


def test_strict_is_about_files():
    with pytest.raises(OptionError, match="strict applies when a file is read"):
        comparisons.run(LOG, strict=True)


def test_minus_one_is_no_id(drive, tmp_path):
    """As an argument, in a table, in an archive, and in what uses logs."""
    ids = LOG.landmarks.copy()
    ids[[3, 50]] = -1
    logs = [
        LOG.replace(landmarks=ids),
        load(drive({(3, 1): "-1", (50, 1): "-1"})),
    ]
    save(LOG, tmp_path / "log.npz")
    np.savez(tmp_path / "none.npz", **(dict(np.load(tmp_path / "log.npz")) | {"landmarks": ids}))
    logs.append(load(tmp_path / "none.npz"))
    for log in logs:
        np.testing.assert_array_equal(np.flatnonzero(log.landmarks == UNIDENTIFIED), [3, 50])
        assert not log.identified and -1 not in log.landmark_ids
        assert sum("have the id -1, taken as no id" in note for note in log.notes) == 1
    # so that associate and filters treat it as they treat other logs without ids
    assert logs[0].equals(LOG.replace(landmarks=np.where(ids == -1, UNIDENTIFIED, ids)))
    # told once, not again for every copy
    assert logs[0].replace(name="other").notes == logs[0].notes
    with pytest.raises(LogError, match="true_landmarks has the id -1"):
        LOG.replace(true_landmarks={-1: (0.0, 0.0)})
    with pytest.raises(OptionError, match="identified landmarks only"):
        OnlineSolver().observe([-1], [[1.0, 0.0]])


def test_range_and_bearing_swapped_are_not_taken_for_degrees(drive):
    swapped = {(row, 2): repr(z[1]) for row, z in enumerate(LOG.sightings.tolist())}
    swapped |= {(row, 3): repr(z[0] + 3) for row, z in enumerate(LOG.sightings.tolist())}
    with pytest.raises(FormatError, match="a range is above zero: are range and bearing swapped") as caught:
        load(drive(swapped))
    assert "degrees" not in str(caught.value)


def test_an_orientation_of_some_landmarks_alone_is_not_used(drive):
    # a missing orientation is no reason to lose the range and the bearing
    path = drive({(row, 4): "" for row in range(0, M, 2)})
    log = load(path)
    assert log.equals(load(drive()).without_orientation())
    assert f"sightings.csv: {(M + 1) // 2} of {M} rows have no 'psi', so that this column is not used" in log.notes[0]
    with pytest.raises(FormatError, match="'psi' is empty or NaN"):
        load(drive({(row, 4): "" for row in range(0, M, 2)}), strict=True)


def test_sightings_that_are_left_out_for_their_orientation_alone_are_counted(drive):
    """Three have range and bearing; a fourth has no range either."""
    log = load(drive({(row, 4): "" for row in (3, 8, 20, 30)} | {(30, 2): "nan"}))
    assert len(log.steps) == M - 4
    (note,) = (each for each in log.notes if "nothing but" in each)
    assert f"sightings.csv: nothing but 'psi' leaves out 3 of {M} sightings: remove that column" in note
    assert f"{M}個のセンサ値のうち3個は" in translated(note, "ja")
    assert not any("nothing but" in each for each in load(drive({(30, 2): "nan"})).notes)


def test_a_sensor_that_gives_minus_one_where_it_sees_nothing(drive):
    """Range and bearing are not swapped, whatever the signs of the bearings are."""
    cells = {(row, 2): "-1" for row in range(M)} | {
        (row, 3): repr(abs(z[1])) for row, z in enumerate(LOG.sightings.tolist())
    }
    with pytest.raises(
        FormatError, match="the range is -1 m, but a range is above zero: remove rows in which nothing was"
    ):
        load(drive(cells))
