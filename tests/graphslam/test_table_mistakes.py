"""Mistakes in tables of your own robot: every one is one sentence with its place and likely cause."""

import gzip
import re
from functools import partial

import numpy as np
import pytest
from own_tables import NU, ODOMETRY, OMEGA, SEEN, T, as_deg, text, write_tables

from graphslam import FormatError, Graph, Log, LogError, MotionModel, OptionError, SensorModel, load, save, solve
from graphslam.io.tables import read_recipe
from graphslam.log_checks import check_log
from graphslam.se2 import wrap


@pytest.fixture
def drive(tmp_path):
    """A folder with tables; call it to change one of them."""
    return partial(write_tables, tmp_path / "drive")


@pytest.fixture
def expected(drive):
    return load(drive())


def test_rows_are_sorted_with_a_note(drive, expected):
    lines = text("t,nu,omega", zip(T.tolist(), NU.tolist(), OMEGA.tolist())).splitlines()
    lines[40], lines[41] = lines[41], lines[40]
    log = load(drive(odometry="\n".join(lines)))
    assert log.equals(expected)
    note, _ = log.notes
    assert "odometry.csv:42: time runs backwards (3.900 s comes after 4.000 s); the rows were sorted" in note


def test_rows_that_come_late_are_sorted(drive, expected):
    """A block of rows that fills a gap is late; the clock was not set back."""
    late = [*ODOMETRY[:100], *ODOMETRY[120:160], *ODOMETRY[100:120], *ODOMETRY[160:]]
    log = load(drive(odometry=text("t,nu,omega", late)))
    assert log.equals(expected) and "the rows were sorted" in log.notes[0]


def test_single_wrong_times_are_left_out_as_before(drive):
    rows = [(t, 3, 2.0, 0.1) for t in TICKS]
    for k in (5, 40, 100, 180):
        rows[k] = (abs(rows[k][0] - 19), 3, 2.0, 0.1) if k != 100 else (0.05 + 21, 3, 2.0, 0.1)
    log = load(drive(sightings=text("t,id,range,bearing", rows)))
    assert not any("sorted" in note for note in log.notes)
    assert any("4 of 200 sightings have a time that is far from those" in note for note in log.notes)


def test_speeds_of_two_wheels_are_no_speed_of_the_robot(drive):
    with pytest.raises(FormatError, match=r"'right_speed' could both be nu; .* omega = \(right - left\) / track"):
        load(drive(odometry=text("t,left_speed,right_speed", ODOMETRY)))


def test_a_truth_that_counts_turns(drive):
    """Headings of many turns are radians where the poses move along them; degrees are refused."""
    theta = 2.0 * T
    arc = np.column_stack([T, np.sin(theta), -np.cos(theta), theta])
    turned = load(drive(truth=text("t,x,y,theta", arc.tolist())))
    wrapped = load(drive(truth=text("t,x,y,theta", np.column_stack([arc[:, :3], wrap(theta)]).tolist())))
    np.testing.assert_allclose(turned.true_poses, wrapped.true_poses, atol=1e-9)
    degrees = np.column_stack([arc[:, :3], np.rad2deg(wrap(theta))])
    for rows in (degrees, np.column_stack([arc[:, 0], 0 * arc[:, :2], theta])):
        with pytest.raises(FormatError, match="does it count many turns, or is it in degrees"):
            load(drive(truth=text("t,x,y,theta", rows.tolist())))


def messages(log, check):
    return [finding.message for finding in check_log(log) if finding.check == check]


def test_a_robot_that_drives_sideways_is_a_doubt(drive, expected):
    rows = list(zip(T.tolist(), NU.tolist(), (0.8 * NU).tolist(), OMEGA.tolist()))
    log = load(drive(odometry=text("t,vx,vy,omega", rows)))
    assert log.equals(expected)
    (message,) = messages(log, "sideways")
    assert "dead reckoning is wrong, and estimates rest on the sightings" in message
    # 0.8 / sqrt(1 + 0.8²)
    assert "odometry.csv: the robot drives sideways ('vy') for 62% of its way" in message
    # it changes the solution, so that this says so, too
    assert message in Graph.from_log(log, motion=MotionModel(), sensor=SensorModel()).notes
    wheels = load(drive(odometry=text("t,vx,vy,omega", [(t, nu, 0.01, omega) for t, nu, _, omega in rows])))
    assert wheels.equals(expected) and not messages(wheels, "sideways")


def test_ranges_alone_without_an_id_are_left_out(drive):
    rows = [(*row[:2], row[2], "") if k % 2 else row for k, row in enumerate(SEEN)]
    whole = load(drive(sightings=text("t,id,range,bearing", rows)))
    rows = [(row[0], "", *row[2:]) if row[3] == "" and k == 1 else row for k, row in enumerate(rows)]
    log = load(drive(sightings=text("t,id,range,bearing", rows)))
    assert len(log.partial_sightings) == len(whole.partial_sightings) - 1
    assert any("1 of these" in note and "have no id, which they need" in note for note in log.notes)


def test_drives_one_after_the_other_without_ids_are_not_mixed():
    t = np.arange(0, 60, 0.1)
    times = np.tile(np.arange(0.5, 50, 1.25), 4)
    seen = {"t": times, "range": 2 + np.sin(times), "bearing": 0.5 * np.cos(times)}
    with pytest.raises(LogError, match="the time goes back 3 times"):
        Log.from_tables({"t": t, "nu": np.full(len(t), 0.5), "omega": 0.1 * np.sin(t / 5)}, seen)


def test_a_sensor_that_delivers_late_once_is_sorted(drive):
    """Its rows were missing where they belong, whereas a clock that was set goes through times twice."""
    times = np.round(np.arange(0.5, 19, 0.1), 3)
    late = (times >= 8) & (times < 10)
    seen = [(t, t, 1) for t in times] + [(10 + t / 1e3 if on else t, t + 0.03, 2) for t, on in zip(times, late)]
    lines = [(f"{t:.3f}", landmark, 2.0, 0.1) for _, t, landmark in sorted(seen)]
    log = load(drive(sightings=text("t,id,range,bearing", lines)))
    assert any("the rows were sorted" in note for note in log.notes)


def test_rows_that_come_twice_are_a_doubt(drive, expected, tmp_path):
    log = load(drive(odometry=text("t,nu,omega", [row for row in ODOMETRY for _ in range(2)])))
    assert log.equals(expected)
    (message,) = messages(log, "odometry repeats")
    assert message.endswith(
        "odometry.csv:3: the first of 201 odometry rows (of 402) with the time and numbers of the row before: the rows were "
        "probably written twice, or two files joined"
    )
    log = load(drive(sightings=text("t,id,range,bearing", [*SEEN[:4], *SEEN])))
    (message,) = messages(log, "doubled sightings")
    assert "sightings.csv:6: the first of 4 sightings (of 11) with the time, id and numbers of another row" in message
    # they count twice in a graph, so that its solution says so, too
    models = {"motion": MotionModel(), "sensor": SensorModel()}
    assert message in solve(Graph.from_log(log, edges="landmark+motion", **models)).notes
    assert message not in Graph.from_log(expected, edges="landmark+motion", **models).notes
    save(log, tmp_path / "log.npz")
    assert messages(load(tmp_path / "log.npz"), "doubled sightings") == [message]
    # a log without lines tells the step
    (message,) = messages(log.replace(doubts=()), "doubled sightings")
    assert (
        "4 of 11 sightings repeat another one of the same step, landmark and numbers, the first of landmark 3"
        in message
    )


def test_times_that_are_rounded_are_a_doubt(drive):
    rows, models = (
        [(float(np.floor(t)), *row) for t, *row in ODOMETRY],
        {"motion": MotionModel(), "sensor": SensorModel()},
    )
    log = load(drive(odometry=text("t,nu,omega", rows)))
    (message,) = messages(log, "odometry repeats")
    # nine of ten rows are not used
    assert message in Graph.from_log(log, **models).notes
    assert (
        "odometry.csv:3: the first of 180 odometry rows (of 201) with the time of the row before and other" in message
    )
    assert "the times were probably rounded to seconds, and one row per time is used" in message
    times = np.repeat(np.arange(1.0, 9.0), 4) + np.tile(np.arange(4) / 10, 8)
    rows = [(t, 3 + k % 2, 2.0 + t / 10, 0.1) for k, t in enumerate(times.tolist())]
    rounded = [(float(np.floor(t)), *row) for t, *row in rows]
    log = load(drive(sightings=text("t,id,range,bearing", rounded)))
    (message,) = messages(log, "duplicate ids")
    assert message in Graph.from_log(log, **models).notes
    assert "sightings.csv:4: the first of 16 sightings (of 32) with the time and id of another row" in message
    assert "the times were probably rounded to seconds, ids were misread, or several objects have one id" in message
    assert not check_log(load(drive(sightings=text("t,id,range,bearing", [*rows, (9.0, 4, 1.0, 0.1)]))))


def test_a_range_and_a_bearing_alone_of_one_time_are_two_sensors(drive):
    """They were said to be several objects with one id, and so were ranges alone that are there twice."""
    times = np.repeat(np.arange(1.0, 9.0, 0.2), 2).tolist()
    rows = [(t, 3 + k // 2 % 2, *((2.0 + t / 10, "") if k % 2 else ("", 0.1))) for k, t in enumerate(times)]
    assert not load(drive(sightings=text("t,id,range,bearing", rows))).doubts
    twice = [row for row in rows if row[3] == "" for _ in range(2)]
    assert len(messages(load(drive(sightings=text("t,id,range,bearing", twice))), "doubled sightings")) == 1


def test_a_single_row_that_comes_twice_is_a_note(drive, expected):
    log = load(drive(odometry=text("t,nu,omega", [*ODOMETRY[:5], *ODOMETRY[4:]])))
    assert log.equals(expected) and not messages(log, "odometry repeats")
    assert "odometry.csv:7: the only odometry row (of 202) with the time and numbers of the row before" in log.notes[0]


def test_truth_that_comes_twice_is_a_doubt(drive):
    truth = [(t, 0.5 * t, 0.1, 0.0) for t in T.tolist() for _ in range(2)]
    (message,) = messages(load(drive(truth=text("t,x,y,theta", truth))), "truth repeats")
    assert "truth.csv:3: the first of 201 truth rows (of 402) with the time and numbers of the row before" in message


#: times of sightings
TICKS = np.round(np.arange(0.0, 20.0, 0.1), 3).tolist()
#: odometry at 400 Hz: milliseconds that were read as seconds are still no pause
FAST = [(t, 0.5, 0.1) for t in np.arange(0.1, 20.0, 0.0025).tolist()]


def changed(rows, row, column, value):
    rows = [list(each) for each in rows]
    rows[row][column] = value
    return rows


#: what is wrong -> the tables, and what the message must say
MISTAKES = {
    "degrees": (
        {"sightings": text("t,id,range,bearing", as_deg(SEEN))},
        r"sightings.csv:3: the bearing is -28.6479 rad, beyond 2 pi: is it in degrees\? Then add "
        "angles='sightings=degrees'",
    ),
    "degrees per second": (
        {"odometry": text("t,nu,omega", [(t, v, np.rad2deg(w).item()) for t, v, w in ODOMETRY])},
        r"odometry.csv:2: the turn rate is 17.1887 rad/s: is it in degrees per second\? Then add angles='odometry=deg",
    ),
    "millimetres": (
        {"sightings": text("t,id,range,bearing", [(t, j, 1000 * r, b) for t, j, r, b in SEEN])},
        r"sightings.csv:2: the range is 2000 m: is it in mm\? Then add lengths='sightings=mm'",
    ),
    "millimetres per second": (
        {"odometry": text("t,nu,omega", [(t, 1000 * v, w) for t, v, w in ODOMETRY])},
        r"odometry.csv:2: the speed is 500 m/s: is it in mm/s\? Then add lengths='odometry=mm'",
    ),
    "milliseconds": (
        {"odometry": text("t,nu,omega", [(1000 * t, v, w) for t, v, w in ODOMETRY])},
        r"odometry.csv: neighbouring rows are 100 s apart \(median\): are the times in ms\? Then add "
        "time='odometry=ms'",
    ),
    "microseconds": (
        {"odometry": text("t,nu,omega", [(1e6 * t, v, w) for t, v, w in ODOMETRY])},
        r"odometry.csv: neighbouring rows are 100000 s apart \(median\): are the times in us\?",
    ),
    "milliseconds of the sightings alone": (
        {"sightings": text("t,id,range,bearing", [(1000 * t, *row) for t, *row in SEEN])},
        r"sightings.csv \(200.000 to 12000.000 s\) do not overlap: the times of sightings.csv seem to be in another "
        r"unit; if so, add time='sightings=ms'$",
    ),
    "microseconds of sightings of a tenth of the drive, stated as milliseconds": (
        {"sightings": text("t_ms,id,range,bearing", [(5e6 + 1e5 * k, 3, 2.0, 0.1) for k in range(40)])},
        r"the times of sightings.csv seem to be in another unit; if so, add time='sightings=us'$",
    ),
    "milliseconds of the odometry alone": (
        {"odometry": text("t,nu,omega", [(1000 * t + 50, *row) for t, *row in FAST])},
        r"do not overlap: the times of odometry.csv seem to be in another unit; if so, add time='odometry=ms'$",
    ),
    "milliseconds that begin at zero": (
        {"sightings": text("t,id,range,bearing", [(0, 3, 2.0, 0.1), *((1000 + 999 * k, 3, 2.0, 0.1) for k in range(19))])},
        r"sightings.csv lasts 949 times as long as .*odometry.csv, and only 1 of 20 rows are within its time \(0.000 to "
        r"20.000 s\): are its times in another unit\? Then add time='sightings=ms'",
    ),
    "one time for all rows": (
        {"odometry": text("t,nu,omega", [(5.0, v, w) for _, v, w in ODOMETRY])},
        "odometry.csv: all 201 rows have the time 5.000 s",
    ),
    "order of columns": (
        {"sightings": "\n".join(",".join(map(repr, (t, r, b, j))) for t, j, r, b in changed(SEEN, 0, 2, 2.5))},
        r"sightings.csv:1: the id column 2 is 2.5, but ids are whole numbers or words: is the order of the columns t, id, "
        "range, bearing?",
    ),
    "range and bearing swapped": (
        {"sightings": text("t,id,bearing,range", SEEN)},
        r"sightings.csv:3: the range is -0.5 m, but a range is above zero: are range and bearing swapped\?",
    ),
    "a range of zero": (
        {"sightings": text("t,id,range,bearing", changed(SEEN, 2, 2, 0.0))},
        "sightings.csv:4: the range is 0 m, but a range is above zero: remove rows in which nothing was seen",
    ),
    "a missing column": (
        {"sightings": text("t,id,range,way", [(*row[:3], 0.0) for row in SEEN])},
        r"sightings.csv: no column for bearing \(named bearing or b or phi, ...\), and none for x and y instead of range "
        r"and bearing \(a sensor that measures one of them has an empty column of the other\); "
        r"it has t, id, range, way. Say which it is: columns='sightings.bearing=NAME'",
    ),
    "a range from the robot's centre": (
        {
            "sightings": text("t,id,range", [row[:3] for row in SEEN]),
            "recipe": 'centre = "robot"\nsensor_offset = [0.2, 0.0]\n',
        },
        r"sightings.csv:2: a range or a bearing alone from the robot's centre says nothing about the sensor at its offset",
    ),
    "two columns of one meaning": (
        {"odometry": text("t,nu,omega,v_left,v_right", [(*row, 0.1, 0.2) for row in ODOMETRY]).replace("nu", "speed", 1)
         .replace("omega", "speed", 1)},
        "'speed' and 'speed' could both be nu; say which by its number: columns='odometry.nu=2'",
    ),
    "a clock that restarts": (
        {"odometry": text("t,nu,omega", [*ODOMETRY, *ODOMETRY])},
        r"odometry.csv:203: the time goes back by 20 s: does the table hold two drives",
    ),
    "a clock that was set back": (
        {"odometry": text("t,nu,omega", [(t - 2.0 * (t > 12), v, w) for t, v, w in ODOMETRY])},
        r"odometry.csv:123: the time goes back by 1.9 s: does the table hold two drives, or a clock that was set",
    ),
    "a sensor whose clock was set back": (
        {"sightings": text("t,id,range,bearing", [(t - 4.0 * (t > 8), 3, 2.0, 0.1) for t in T[1:].tolist()])},
        r"sightings.csv:82: the time goes back by 3.9 s",
    ),
    "a truth whose clock was set back": (
        {"truth": text("t,x,y,theta", [(t - 4.0 * (t > 8), t, 0.0, 0.0) for t in T.tolist()])},
        r"truth.csv:83: the time goes back by 3.9 s",
    ),
    "a clock that starts anew again and again": (
        {"sightings": text("t,id,range,bearing", [(t, k % 3, 2.0, 0.1) for k, t in enumerate(4 * TICKS)])},
        r"sightings.csv:202: the time goes back 3 times: sort the rows by their time if they are of one drive",
    ),
    "rows in the order of their ids, beyond the odometry": (
        {"sightings": text("t,id,range,bearing", [(t, j, 2.0, 0.1) for j in range(4) for t in range(1, 39)])},
        r"sightings.csv:40: the time goes back 3 times: sort the rows by their time if they are of one drive",
    ),
    "many wrong times": (
        {"sightings": text("t,id,range,bearing", [(19 - t if k % 9 == 8 else t, 3, 2.0, 0.1) for k, t in enumerate(TICKS)])},
        r"sightings.csv:10: the time 't' is 18.200, far from those of the rows before and after it",
    ),
    "disjoint clocks": (
        {"odometry": text("t,nu,omega", [(t + 1_716_000_000, v, w) for t, v, w in ODOMETRY])},
        r"odometry.csv \(1716000000.000 to 1716000020.000 s\) and .*sightings.csv \(0.200 to 12.000 s\) do not overlap: "
        r"one counts from 1970 and the other from its own start; clocks='sightings=1715999999.8' lets",
    ),
    "time zones": (
        {"sightings": text("t,id,range,bearing", [(t + 7200, *row) for t, *row in SEEN])},
        "do not overlap: they differ by about 2 h, as two time zones do; clocks='sightings=-7200.2'",
    ),
    "no overlap with the truth": (
        {"truth": text("t,x,y,theta", [(t + 500, 0.0, 0.0, 0.0) for t in T.tolist()])},
        r"odometry.csv \(0.000 to 20.000 s\) and .*truth.csv \(500.000 to 520.000 s\) do not overlap: .*clocks='truth=-500'",
    ),
    "NaN": (
        {"odometry": text("t,nu,omega", ((t, "nan" if k % 9 == 6 else v, w) for k, (t, v, w) in enumerate(ODOMETRY)))},
        "odometry.csv:8: 'nu' is empty or NaN; remove the row, or repair it; 22 of 201 rows have 'nu' empty, NaN or infinite",
    ),
    "an empty cell": (
        {"sightings": re.sub(r",1\.7,[^\n]*", ",,", text("t,id,range,bearing", SEEN), count=1)},
        "sightings.csv:4: 'range' is empty or NaN",
    ),
    "a time that is missing": (
        {"sightings": text("t,id,range,bearing", SEEN) + ",3,1.0,0.1\n"},
        "sightings.csv:9: the time 't' is nan; every row needs a time",
    ),
    "an empty file": ({"odometry": "\n"}, "odometry.csv: the file is empty"),
    "a header alone": ({"odometry": "t,nu,omega\n"}, "odometry.csv:1: there is a header, but no row below it"),
    "a word": (
        {"odometry": text("t,nu,omega", ODOMETRY).replace(repr(NU[6].item()), "fast", 1)},
        "odometry.csv:8: 'nu' should be a number, not 'fast'",
    ),
    "a wrong separator": (
        {"odometry": text("t/nu/omega", ODOMETRY, "/")},
        "odometry.csv: cannot find columns in '0.0/.*separate them by commas, semicolons, tabs or spaces",
    ),
    "decimal commas between commas": (
        {"sightings": text("t,id,range,bearing", SEEN) + "13,0,5,0,2,0,0,1\n"},
        r"sightings.csv:9: expected 4 columns \(t, id, range, bearing\), found 8; does the file have decimal commas\?",
    ),
    "a file cut short": (
        {"odometry": text("t,nu,omega", ODOMETRY)[:-25]},
        "odometry.csv:202: expected 3 columns .*in the last line; was the file cut short?",
    ),
    "commas between thousands": (
        {"odometry": text("t_ms;nu;omega", [(f"{1000 * t:,.0f}", v, w) for t, v, w in ODOMETRY], ";")},
        "odometry.csv: numbers such as 1,000 seem to have a mark between thousands: write them without it",
    ),
    "points between thousands": (
        {"sightings": text("t;id;range_mm;bearing", [(t, j, f"{1000 * r:,.0f}", b) for t, j, r, b in SEEN], ";")
         .replace(".", "!").replace(",", ".").replace("!", ",")},
        "sightings.csv: numbers such as 2.000 seem to have a mark between thousands: write them without it",
    ),
    "a landmark twice in the map": (
        {"map": "id,x,y\n3,1,2\n4,1,2\n3,4,4\n"},
        "map.csv:4: landmark 3 is in the map twice; each landmark has one place",
    ),
    "quaternions not normalised": (
        {"truth": text("t,x,y,z,qx,qy,qz,qw", [(t, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0) for t in T.tolist()])},
        r"truth.csv:2: the quaternion has length 1.41, but a rotation has length 1: are its columns x, y, z, w in this "
        "order?",
    ),
    "quaternions with w first": (
        {"truth": text("t,x,y,z,qx,qy,qz,qw", [(t, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0) for t in T.tolist()])},
        r"truth.csv:2: the quaternion tilts the robot by 180 degrees: are its columns x, y, z, w in this order\?",
    ),
    "a missing file": (
        {"recipe": '[sightings]\nfile = "tags.csv"\n'},
        "tags.csv: there is no such file",
    ),
    "a wrong key of the recipe": (
        {"recipe": '[sightings]\nrnge = "dist"\n'},
        "import.toml:2: unknown key 'rnge' in .sightings.; did you mean 'range'?",
    ),
    "a wrong column of the recipe": (
        {"recipe": '[sightings]\nrange = "distanze"\n', "sightings": text("t,id,distance,bearing", SEEN)},
        "sightings.csv: there is no column 'distanze' for range; did you mean 'distance'?",
    ),
    "a wrong unit": ({"recipe": 'angles = "grad"\n'}, "import.toml:1: angles must be one of radians, degrees"),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes(drive, name):
    tables, message = MISTAKES[name]
    with pytest.raises(LogError, match=message) as caught:
        load(drive(**tables))
    assert "\n" not in str(caught.value)


def test_what_is_stated_is_not_refused(drive):
    rows = [(t, j, r, b + 8 * np.pi) for t, j, r, b in SEEN]
    log = load(drive(sightings=text("t,id,range,bearing", rows), recipe='angles = "radians"'))
    np.testing.assert_allclose(log.sightings[:, 1], [row[3] for row in SEEN], atol=1e-12)
    far = text("t,id,range,bearing", [(t, j, 1e3 * r, b) for t, j, r, b in SEEN])
    units = {each.check for each in check_log(load(drive(sightings=far, recipe='lengths = "m"')))}
    assert "range unit" not in units


def test_poses_that_move_sideways_are_a_doubt(drive):
    poses = MotionModel().dead_reckoning(np.zeros(3), np.column_stack([NU, OMEGA])[:-1], np.diff(T))
    poses[:, 2] += np.pi / 2
    log = load(drive(odometry=text("t,x,y,theta", np.column_stack([T, poses]).tolist())))
    (finding,) = (each for each in check_log(log) if each.check == "sideways")
    assert "odometry.csv: the poses move sideways for 99% of their way" in finding.message.replace("100%", "99%")


def test_wrong_arguments():
    with pytest.raises(OptionError, match=r"from_tables has no option 'angle'; did you mean 'angles'\?"):
        Log.from_tables("a.csv", "b.csv", angle="degrees")
    with pytest.raises(LogError, match="odometry should be the path of a table, a data frame, a mapping of columns"):
        Log.from_tables(3.0, "b.csv")
    with pytest.raises(OptionError, match=r"columns: there is no table 'sighting'; did you mean 'sightings'\?"):
        Log.from_tables("a.csv", "b.csv", columns={"sighting": {"range": 3}})
    with pytest.raises(OptionError, match="columns: 'range' should name a table, too, such as odometry.range=3"):
        Log.from_tables("a.csv", "b.csv", columns="range=3")
    with pytest.raises(OptionError, match="clocks: truth should be a number of seconds, not 'soon'"):
        Log.from_tables("a.csv", "b.csv", clocks="truth=soon")
    with pytest.raises(FormatError, match="a.csv: there is no such file"):
        Log.from_tables("a.csv", "b.csv")
    with pytest.raises(LogError, match="odometry, row 2: 'nu' should be a number, not 'fast'"):
        Log.from_tables({"t": [0, 1], "nu": [1.0, "fast"], "omega": [0, 0]}, "b.csv")


def test_a_folder_without_sightings(drive):
    folder = drive()
    (folder / "sightings.csv").unlink()
    with pytest.raises(FormatError, match=r"sightings.csv: this file is missing; it would hold the measured landmarks"):
        load(folder)


def test_tables_that_are_compressed(drive):
    folder = drive()
    packed = gzip.compress((folder / "odometry.csv").read_bytes())
    (folder / "odometry.csv").unlink()
    (folder / "odometry.csv.gz").write_bytes(packed)
    message = r"odometry.csv.gz: the file is compressed as a whole; unpack it first: gunzip odometry.csv.gz"
    with pytest.raises(FormatError, match=message):
        load(folder)
    with pytest.raises(FormatError, match=message):
        Log.from_tables(folder / "odometry.csv.gz", folder / "sightings.csv")


def test_a_recipe_is_checked(tmp_path):
    path = tmp_path / "import.toml"
    path.write_text("sensor_offset = [1, 2, 3]\n")
    with pytest.raises(FormatError, match=r"import.toml:1: sensor_offset must be \(ahead, to the left\) in m"):
        read_recipe(path)


def test_a_header_with_another_separator(tmp_path):
    (tmp_path / "odometry.csv").write_text("t;nu;omega\n" + "".join(f"1,700,000,00{k}.5;0.5;0.1\n" for k in range(9)))
    (tmp_path / "sightings.csv").write_text("t,id,range,bearing\n1700000001.0,1,2,0.1\n1700000003.3,1,1.5,0.1\n")
    with pytest.raises(LogError, match="odometry.csv:1: the header has ';' between its columns"):
        load(tmp_path)


def test_times_in_a_column_date(tmp_path):
    rows = "".join(f"2026-11-29T13:00:0{k}+03:00,0.5,0.1\n" for k in range(5))
    (tmp_path / "odometry.csv").write_text("Date,v,yaw_rate\n" + rows)
    (tmp_path / "sightings.csv").write_text(
        "datetime,id,range,bearing\n2026-11-29 10:00:01,1,2,0.1\n2026-11-29 10:00:03,1,1,0.1\n"
    )
    assert load(tmp_path).times.tolist() == [1795946401.0, 1795946403.0]
