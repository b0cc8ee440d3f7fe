"""Tables of your own robot become a log; every mistake is one sentence with its place and likely cause."""

import gzip

import numpy as np
import pytest

from graphslam import FormatError, Log, LogError, OptionError, load, save
from graphslam.log import UNIDENTIFIED
from graphslam.plausibility import plausibility
from graphslam.tables.columns import plain
from graphslam.tables.recipe import read_recipe

T = np.arange(0, 20.01, 0.1)
NU, OMEGA = 0.5 + 0.1 * np.sin(T), 0.3 * np.cos(T / 3)
SEEN = [(0.2, 3, 2.0, 0.1), (0.2, 4, 3.0, -0.5), (1.0, 3, 1.7, 0.2), (5.0, 4, 2.5, 0.7), (9.0, 5, 1.0, -1.0)]
SEEN += [(9.5, 3, 4.0, 1.2), (12.0, 5, 2.2, 0.3)]
UNSEEN = (
    "the odometry of 0.2 s before the first sighting and 8.0 s after the last sighting is left out: poses are where "
    "something was seen"
)


def text(header, rows, separator=","):
    return "\n".join([header, *(separator.join(map(str, row)) for row in rows)]) + "\n"


@pytest.fixture
def drive(tmp_path):
    """A folder with tables; call it to change one of them."""
    folder = tmp_path / "drive"
    folder.mkdir()

    def change(odometry=None, sightings=None, **others):
        odometry = odometry or text("t,nu,omega", zip(T.tolist(), NU.tolist(), OMEGA.tolist()))
        sightings = sightings or text("t,id,range,bearing", SEEN)
        for name, content in {"odometry": odometry, "sightings": sightings, **others}.items():
            path = folder / (f"{name}.csv" if name != "recipe" else "import.toml")
            path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return folder

    return change


@pytest.fixture
def expected(drive):
    return load(drive())


def test_the_numbers_are_those_of_the_tables(expected):
    assert expected.times.tolist() == pytest.approx([0.2, 1.0, 5.0, 9.0, 9.5, 12.0], abs=1e-9)
    np.testing.assert_array_equal(expected.sightings, [row[2:] for row in SEEN])
    assert expected.landmarks.tolist() == [3, 4, 3, 4, 5, 3, 5]
    np.testing.assert_array_equal(expected.controls[0], [NU[2], OMEGA[2]])
    assert expected.notes == (UNSEEN,)
    assert expected.name == "drive"


def as_deg(rows):
    return [(t, j, r, float(np.rad2deg(b))) for t, j, r, b in rows]


@pytest.mark.parametrize(
    "sightings",
    [
        text("time;landmark;distance;angle", SEEN, ";"),
        text("timestamp\ttag_id\trho\tbearing_rad", SEEN, "\t"),
        text("# t id range bearing", SEEN, " "),
        "\ufeff" + text("Time [s],ID,Range (m),Bearing (rad)", SEEN),
        text("bearing,id,t,range", [(b, j, t, r) for t, j, r, b in SEEN]),
        text("t_ms,id,range_mm,phi", [(t * 1000, j, r * 1000, b) for t, j, r, b in SEEN]),
        text('"t","id","range","bearing"', SEEN),
        text("t,id,range,bearing,comment", [(*row, "seen") for row in SEEN]).replace("'", '"'),
        text("t;id;range;bearing", SEEN, ";").replace(".", ","),
        "\n".join(["t,id,range,bearing", "", "# a comment", *text("", SEEN).splitlines()[1:]]) + "\n\n",
    ],
    ids=["semicolons", "tabs", "comment", "byte-order mark", "order", "units", "quotes", "words", "comma", "blank"],
)
def test_forms_of_the_same_table(drive, expected, sightings):
    log = load(drive(sightings=sightings))
    np.testing.assert_allclose(log.sightings, expected.sightings, rtol=1e-14)
    np.testing.assert_allclose(log.times, expected.times, rtol=1e-12)
    assert log.landmarks.tolist() == expected.landmarks.tolist()


def test_all_kinds_of_sources(drive, expected, tmp_path):
    pandas = pytest.importorskip("pandas")
    folder = drive()
    frames = {name: pandas.read_csv(folder / f"{name}.csv") for name in ("odometry", "sightings")}
    assert Log.from_tables(**frames).equals(expected)
    assert Log.from_tables(**{name: frame.to_dict("list") for name, frame in frames.items()}).equals(expected)
    assert Log.from_tables(**{name: frame.to_numpy() for name, frame in frames.items()}).equals(expected)
    assert Log.from_tables(np.column_stack([T, NU, OMEGA]), str(folder / "sightings.csv")).equals(expected)
    pytest.importorskip("pyarrow")
    for name, frame in frames.items():
        (folder / f"{name}.csv").unlink()
        frame.to_parquet(folder / f"{name}.parquet")
    assert load(folder).equals(expected)


def test_poses_of_odometry_become_the_controls_between_them(drive, expected):
    poses = expected.dead_reckoning()
    from graphslam import MotionModel

    poses = MotionModel().dead_reckoning(np.array([3.0, -1.0, 2.0]), np.column_stack([NU, OMEGA])[:-1], np.diff(T))
    log = load(drive(odometry=text("t,x,y,theta", np.column_stack([T, poses]).tolist())))
    np.testing.assert_allclose(log.controls, expected.controls, atol=1e-12)
    quaternions = np.column_stack(
        [T, poses[:, :2], 0 * T, 0 * T, 0 * T, np.sin(poses[:, 2] / 2), np.cos(poses[:, 2] / 2)]
    )
    log = load(drive(odometry=text("# timestamp tx ty tz qx qy qz qw", quaternions.tolist(), " ")))
    np.testing.assert_allclose(log.controls, expected.controls, atol=1e-12)


def test_cartesian_sightings_in_all_axes(drive, expected):
    forward = [(t, j, r * np.cos(b), r * np.sin(b)) for t, j, r, b in SEEN]
    for axes, cells in {
        "forward-left": lambda x, y: (x, y),
        "forward-right": lambda x, y: (x, -y),
        "right-forward": lambda x, y: (-y, x),
        "left-forward": lambda x, y: (y, x),
    }.items():
        table = text("t,id,x,y", [(t, j, *map(float, cells(x, y))) for t, j, x, y in forward])
        log = load(drive(sightings=table, recipe=f'axes = "{axes}"'))
        np.testing.assert_allclose(log.sightings, expected.sightings, atol=1e-14)


def test_the_place_of_the_sensor(drive):
    folder = drive(recipe="sensor_offset = [0.2, -0.1]\nsensor_yaw = 0.3\n")
    log = load(folder)
    assert log.sensor.offset == (0.2, -0.1)
    np.testing.assert_allclose(log.sightings[:, 1], [row[3] + 0.3 for row in SEEN])
    # the same landmark, measured from the centre of the robot
    centre = Log.from_tables(
        folder / "odometry.csv", folder / "sightings.csv", sensor_offset=(0.2, -0.1), centre="robot"
    )
    np.testing.assert_allclose(
        centre.sensor.h_inverse(np.zeros((len(SEEN), 3)), centre.sightings),
        [(r * np.cos(b), r * np.sin(b)) for _, _, r, b in SEEN],
        atol=1e-12,
    )


def test_stated_columns_units_and_clocks(drive, expected):
    rows = [(j, t * 1000 - 3000, float(np.rad2deg(-b)), r) for t, j, r, b in SEEN]
    recipe = """bearings = "clockwise"
    [sightings]
    t = 2
    angles = "degrees"
    bearing = "col c"
    range = 4
    id = "who"
    time = "ms"
    clock = 3
    """
    log = load(drive(sightings=text("who,when,col c,far", rows), recipe=recipe))
    np.testing.assert_allclose(log.sightings, expected.sightings, rtol=1e-12)
    np.testing.assert_allclose(log.times, expected.times, rtol=1e-12)


def test_times_since_1970_are_exact_to_a_nanosecond(drive):
    ns = 1_716_000_000_123_456_789 + np.arange(200) * 100_000_001
    seen = 1_716_000_001_000_000_003
    words = [f"{t // 10**9}.{t % 10**9:09d}" for t in ns.tolist()]
    odometry = "t,nu,omega\n" + "".join(f"{word},0.5,0.1\n" for word in words)
    for cells in ((f"{seen // 10**9}.{seen % 10**9:09d}", "1716000005.5"), (str(seen), "1716000005500000000")):
        log = load(drive(odometry=odometry, sightings="t,id,range,bearing\n{},1,2,0.1\n{},1,2,0.2\n".format(*cells)))
        following = ns[np.searchsorted(ns, seen)]
        assert round(log.dt[0] * 1e9) == following - seen
        assert abs(log.start_time - seen / 1e9) < 1e-6
        assert round(log.dt[1] * 1e9) == 100_000_001


def test_two_columns_of_a_stamp(drive, expected):
    rows = [(int(t), round(t % 1 * 1e9), j, r, b) for t, j, r, b in SEEN]
    log = load(drive(sightings=text("header.stamp.sec,header.stamp.nanosec,id,range,bearing", rows)))
    np.testing.assert_allclose(log.times, expected.times, rtol=1e-12)


def test_truth_and_map(drive):
    truth = text("t,x,y,theta", [(t, 0.5 * t, 0.1, 0.0) for t in T.tolist()])
    log = load(drive(truth=truth, map="id,x,y\n3,1.0,2.0\n4,0.5,0.5\n"))
    np.testing.assert_allclose(log.true_poses[:, 0], 0.5 * log.times)
    assert {j: m.tolist() for j, m in log.true_landmarks.items()} == {3: [1.0, 2.0], 4: [0.5, 0.5]}
    log = load(drive(truth=truth.replace("2.0,1.0,0.1,0.0", "2.0,nan,nan,nan")))
    assert any("1 of 201 rows have no pose" in note for note in log.notes)


def test_rows_are_sorted_with_a_note(drive, expected):
    lines = text("t,nu,omega", zip(T.tolist(), NU.tolist(), OMEGA.tolist())).splitlines()
    lines[40], lines[41] = lines[41], lines[40]
    log = load(drive(odometry="\n".join(lines)))
    assert log.equals(expected)
    note, _ = log.notes
    assert "odometry.csv:42: time runs backwards (3.900 s comes after 4.000 s); the rows were sorted" in note


def messages(log, check):
    return [finding.message for finding in plausibility(log) if finding.check == check]


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
    save(log, tmp_path / "log.npz")
    assert messages(load(tmp_path / "log.npz"), "doubled sightings") == [message]
    # a log without lines tells the step
    (message,) = messages(log.replace(doubts=()), "doubled sightings")
    assert (
        "4 of 11 sightings repeat another one of the same step, landmark and numbers, the first of landmark 3"
        in message
    )


def test_times_that_are_rounded_are_a_doubt(drive):
    rows = [(float(np.floor(t)), *row) for t, *row in ODOMETRY]
    (message,) = messages(load(drive(odometry=text("t,nu,omega", rows))), "odometry repeats")
    assert (
        "odometry.csv:3: the first of 180 odometry rows (of 201) with the time of the row before and other" in message
    )
    assert "the times were probably rounded to seconds, and one row per time is used" in message
    times = np.repeat(np.arange(1.0, 9.0), 4) + np.tile(np.arange(4) / 10, 8)
    rows = [(t, 3 + k % 2, 2.0 + t / 10, 0.1) for k, t in enumerate(times.tolist())]
    rounded = [(float(np.floor(t)), *row) for t, *row in rows]
    (message,) = messages(load(drive(sightings=text("t,id,range,bearing", rounded))), "duplicate ids")
    assert "sightings.csv:4: the first of 16 sightings (of 32) with the time and id of another row" in message
    assert "the times were probably rounded to seconds, or several objects have one id" in message
    assert not plausibility(load(drive(sightings=text("t,id,range,bearing", [*rows, (9.0, 4, 1.0, 0.1)]))))


def test_a_single_row_that_comes_twice_is_a_note(drive, expected):
    log = load(drive(odometry=text("t,nu,omega", [*ODOMETRY[:5], *ODOMETRY[4:]])))
    assert log.equals(expected) and not messages(log, "odometry repeats")
    assert "odometry.csv:7: the only odometry row (of 202) with the time and numbers of the row before" in log.notes[0]


def test_truth_that_comes_twice_is_a_doubt(drive):
    truth = [(t, 0.5 * t, 0.1, 0.0) for t in T.tolist() for _ in range(2)]
    (message,) = messages(load(drive(truth=text("t,x,y,theta", truth))), "truth repeats")
    assert "truth.csv:3: the first of 201 truth rows (of 402) with the time and numbers of the row before" in message


def test_landmarks_with_names(drive):
    log = load(drive(sightings=text("t,tag,range,bearing", [(t, f"tag36h11:{j}", r, b) for t, j, r, b in SEEN])))
    assert log.landmarks.tolist() == [row[1] for row in SEEN]
    names = {3: "pole", 4: "door", 5: "cone"}
    log = load(drive(sightings=text("t,name,range,bearing", [(t, names[j], r, b) for t, j, r, b in SEEN])))
    assert log.landmarks.tolist() == [{3: 2, 4: 1, 5: 0}[row[1]] for row in SEEN]
    assert "0 = cone, 1 = door, 2 = pole" in log.notes[0]


COLOURS = ["blue", "yellow", "blue, large", "", "yellow", "nan", "blue"]


def test_landmarks_with_names_in_the_map(drive):
    """Names count once for both tables, whichever landmarks each of them has."""
    seen = text("t,id,range,bearing", [(t, {3: "door", 4: "lamp", 5: "tree"}[j], r, b) for t, j, r, b in SEEN])
    log = load(drive(sightings=seen, map="id,x,y\ntree,5,5\nbox,1,1\nlamp,4,4\n"))
    of_names = dict(zip(("door", "lamp", "tree"), log.landmarks[[0, 1, 4]].tolist()))
    assert {j: place[0] for j, place in log.true_landmarks.items()} == {of_names["tree"]: 5, of_names["lamp"]: 4, 3: 1}
    with pytest.raises(FormatError, match=r"map.csv:4: landmark tree is in the map twice"):
        load(drive(sightings=seen, map="id,x,y\ntree,5,5\nbox,1,1\ntree,4,4\n"))
    with pytest.raises(FormatError, match=r"map.csv:3: the id 'id' is empty; each landmark of the map needs one"):
        load(drive(sightings=seen, map="id,x,y\ntree,5,5\n,1,1\n"))


@pytest.mark.parametrize("names", [{3: 3, 4: "", 5: 5}, {3: "door", 4: "", 5: "tree"}, {3: 2**60 + 1, 4: "", 5: 5}])
def test_sightings_that_have_ids_in_part(drive, names):
    log = load(drive(sightings=text("t,id,range,bearing", [(t, names[j], r, b) for t, j, r, b in SEEN])))
    np.testing.assert_array_equal(log.landmarks == UNIDENTIFIED, [j == 4 for _, j, *_ in SEEN])
    assert log.notes[0].endswith("sightings.csv: 2 of 7 rows have no id")
    assert log.landmarks[0] == (0 if names[3] == "door" else names[3])


def test_an_id_that_may_mean_none_is_told(drive):
    log = load(drive(sightings=text("t,id,range,bearing", [(t, -1 if j == 4 else j, r, b) for t, j, r, b in SEEN])))
    assert log.notes[0].endswith("sightings.csv: 2 of 7 rows have the id -1, taken as no id")
    np.testing.assert_array_equal(log.landmarks == UNIDENTIFIED, [j == 4 for _, j, *_ in SEEN])


def with_column(name, values):
    return text(f"t,id,{name},range,bearing", [(t, j, f'"{v}"', r, b) for (t, j, r, b), v in zip(SEEN, values)])


@pytest.mark.parametrize("name", ["class", "class_name", "Colour", "cone_color", "kind", "type"])
def test_classes_are_words(drive, expected, tmp_path, name):
    log = load(drive(sightings=with_column(name, COLOURS)))
    assert log.classes.tolist() == ["blue", "yellow", "blue, large", "", "yellow", "", "blue"]
    assert log.classified.tolist() == [True, True, True, False, True, False, True]
    assert log.notes[0].endswith("sightings.csv: 2 of 7 sightings have no class, and may be of any")
    assert log.replace(classes=None).equals(expected)
    # the whole log is kept, and parts of it
    save(log, tmp_path / "log.npz")
    assert load(tmp_path / "log.npz").equals(log) and not log.equals(expected)
    assert log.at_steps([1, 4]).classes.tolist() == ["blue, large", ""]


def test_classes_are_whole_numbers(drive, expected):
    log = load(drive(sightings=with_column("class", [1, 2, "", 2, 1, 7, 1])))
    assert log.classes.dtype == np.int64 and log.classified.tolist() == [True, True, False, True, True, True, True]
    assert log.classes[log.classified].tolist() == [1, 2, 2, 1, 7, 1]
    # the id has the first right to a name that may be either, and rows are sorted by time with their classes
    rows = [(t, j % 2, j, r, b) for t, j, r, b in SEEN]
    rows[4], rows[5] = rows[5], rows[4]
    log = load(drive(sightings=text("t,class,class_id,range,bearing", rows)))
    assert log.replace(classes=None).equals(expected)
    assert log.classes.tolist() == (log.landmarks % 2).tolist()
    stated = '[sightings]\nclass = "class_id"'
    log = load(drive(sightings=text("t,class_id,range,bearing", SEEN), recipe=stated))
    assert log.classes.tolist() == expected.landmarks.tolist() and len(log.landmark_ids) == 0
    drive(recipe="")
    assert load(drive(sightings=text("t,class_id,range,bearing", SEEN))).equals(expected)
    frame = (
        {"t": T, "nu": NU, "omega": OMEGA},
        {"t": [1.0, 2.0], "range": [1, 1], "bearing": [0, 0], "kind": [np.nan, 3]},
    )
    assert Log.from_tables(*frame).classes.tolist() == [UNIDENTIFIED, 3]


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ([""] * 7, "all its cells are empty"),
        ([1, 2, 0.5, 1, 2, 1, 1], "it holds numbers that are not whole, such as 0.5"),
        (None, "it has 120 different entries, more than 100"),
    ],
)
def test_a_column_that_holds_no_classes_is_left_out(drive, values, reason):
    if values is None:
        rows = [(0.1 * k, 3, f"name {k}", 1.0, 0.0) for k in range(120)]
        table = text("t,id,class,range,bearing", rows)
    else:
        table = with_column("class", values)
    log = load(drive(sightings=table))
    assert log.classes is None
    assert log.notes[0].endswith(f"sightings.csv: 'class' holds no classes of sightings: {reason}; it is left out")
    with pytest.raises(LogError, match=f"holds no classes of sightings: {reason}$"):
        load(drive(sightings=table, recipe='[sightings]\nclass = "class"'))


ODOMETRY = list(zip(T.tolist(), NU.tolist(), OMEGA.tolist()))


def changed(rows, row, column, value):
    rows = [list(each) for each in rows]
    rows[row][column] = value
    return rows


#: what is wrong -> the tables, and what the message must say
MISTAKES = {
    "degrees": (
        {"sightings": text("t,id,range,bearing", as_deg(SEEN))},
        r"sightings.csv:3: the bearing is -28.6479 rad, beyond 2 pi: is it in degrees\? Then add --angles "
        "sightings=degrees",
    ),
    "degrees per second": (
        {"odometry": text("t,nu,omega", [(t, v, np.rad2deg(w).item()) for t, v, w in ODOMETRY])},
        r"odometry.csv:2: the turn rate is 17.1887 rad/s: is it in degrees per second\? Then add --angles odometry=deg",
    ),
    "millimetres": (
        {"sightings": text("t,id,range,bearing", [(t, j, 1000 * r, b) for t, j, r, b in SEEN])},
        r"sightings.csv:2: the range is 2000 m: is it in mm\? Then add --lengths sightings=mm",
    ),
    "millimetres per second": (
        {"odometry": text("t,nu,omega", [(t, 1000 * v, w) for t, v, w in ODOMETRY])},
        r"odometry.csv:2: the speed is 500 m/s: is it in mm/s\? Then add --lengths odometry=mm",
    ),
    "milliseconds": (
        {"odometry": text("t,nu,omega", [(1000 * t, v, w) for t, v, w in ODOMETRY])},
        r"odometry.csv: neighbouring rows are 100 s apart \(median\): are the times in milliseconds\? Then add --time "
        "odometry=ms",
    ),
    "microseconds": (
        {"odometry": text("t,nu,omega", [(1e6 * t, v, w) for t, v, w in ODOMETRY])},
        r"odometry.csv: neighbouring rows are 100000 s apart \(median\): are the times in microseconds\?",
    ),
    "milliseconds of the sightings alone": (
        {"sightings": text("t,id,range,bearing", [(1000 * t, *row) for t, *row in SEEN])},
        r"sightings.csv \(200.000 to 12000.000 s\) do not overlap: one seems to be in units 1000 times as large",
    ),
    "milliseconds that begin at zero": (
        {"sightings": text("t,id,range,bearing", [(0, 3, 2.0, 0.1), *((1000 + 999 * k, 3, 2.0, 0.1) for k in range(19))])},
        r"sightings.csv lasts 949 times as long as .*odometry.csv, and only 1 of 20 rows are within its time \(0.000 to "
        r"20.000 s\): are its times in milliseconds\? Then add --time sightings=ms",
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
        {"sightings": text("t,id,range", [row[:3] for row in SEEN])},
        r"sightings.csv: no column for bearing \(named bearing or b or phi, ...\), and none for x and y instead of range "
        r"and bearing; it has t, id, range. Say which it is: --columns sightings.bearing=NAME",
    ),
    "two columns of one meaning": (
        {"odometry": text("t,nu,omega,v_left,v_right", [(*row, 0.1, 0.2) for row in ODOMETRY]).replace("nu", "speed", 1)
         .replace("omega", "speed", 1)},
        "'speed' and 'speed' could both be nu; say which: --columns odometry.nu=NAME",
    ),
    "a clock that restarts": (
        {"odometry": text("t,nu,omega", [*ODOMETRY, *ODOMETRY])},
        r"odometry.csv:203: the time goes back by 20 s: does the table hold two drives",
    ),
    "disjoint clocks": (
        {"odometry": text("t,nu,omega", [(t + 1_716_000_000, v, w) for t, v, w in ODOMETRY])},
        r"odometry.csv \(1716000000.000 to 1716000020.000 s\) and .*sightings.csv \(0.200 to 12.000 s\) do not overlap: "
        r"one counts from 1970 and the other from its own start; --clocks sightings=1715999999.8 lets",
    ),
    "time zones": (
        {"sightings": text("t,id,range,bearing", [(t + 7200, *row) for t, *row in SEEN])},
        "do not overlap: they differ by about 2 h, as two time zones do; --clocks sightings=-7200",
    ),
    "no overlap with the truth": (
        {"truth": text("t,x,y,theta", [(t + 500, 0.0, 0.0, 0.0) for t in T.tolist()])},
        r"odometry.csv \(0.000 to 20.000 s\) and .*truth.csv \(500.000 to 520.000 s\) do not overlap: .*--clocks truth=-500",
    ),
    "NaN": (
        {"odometry": text("t,nu,omega", ((t, "nan" if k % 9 == 6 else v, w) for k, (t, v, w) in enumerate(ODOMETRY)))},
        "odometry.csv:8: 'nu' is empty or NaN; remove the row, or repair it; 22 of 201 rows have 'nu' empty, NaN or infinite",
    ),
    "an empty cell": (
        {"sightings": text("t,id,range,bearing", SEEN).replace(",1.7,", ",,", 1)},
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
    "UTF-16": ({"odometry": text("t,nu,omega", ODOMETRY).encode("utf-16")}, "odometry.csv: .*UTF-8"),
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


def test_sightings_without_ids_are_remarked(drive):
    log = load(drive(sightings=text("t,range,bearing", [(t, r, b) for t, _, r, b in SEEN])))
    assert not log.identified
    note, _ = log.notes
    assert note.endswith(
        "sightings.csv: no column for id (named id or landmark or landmark_id, ...), so no landmark is identified"
    )


def test_a_column_that_may_have_the_ids_is_asked_for(drive):
    rows = [(t, "a", r, b) for t, _, r, b in SEEN]
    log = load(drive(sightings=text("t,serial,range,bearing", rows)))
    note, _ = log.notes
    assert note.endswith("it has t, serial, range, bearing. If one has the ids, say which: --columns sightings.id=NAME")


def test_poses_that_move_sideways_are_a_doubt(drive):
    from graphslam import MotionModel

    poses = MotionModel().dead_reckoning(np.zeros(3), np.column_stack([NU, OMEGA])[:-1], np.diff(T))
    poses[:, 2] += np.pi / 2
    log = load(drive(odometry=text("t,x,y,theta", np.column_stack([T, poses]).tolist())))
    (finding,) = (each for each in plausibility(log) if each.check == "sideways")
    assert "odometry.csv: the poses move sideways for 99% of their way" in finding.message.replace("100%", "99%")


def test_names_of_columns():
    assert plain(" Bearing (deg) ") == ("bearing", "degrees")
    assert plain("v_m_s") == ("v", "m")
    assert plain("omega_rad_s") == ("omega", "radians")
    assert plain("field.header.stamp") == ("field_header_stamp", None)
    assert plain("%time") == ("time", None)
    assert plain("t_ms") == ("t", "ms")
    assert plain("Speed [m/s]") == ("speed", "m")
    assert plain("yaw_rate (°/s)") == ("yaw_rate", "degrees")


def test_columns_of_exported_messages(drive, expected):
    """The names that `rostopic echo -p` and PlotJuggler give."""
    names = "%time,field.header.seq,field.twist.twist.linear.x,field.twist.twist.linear.y,field.twist.twist.angular.z"
    rows = [(int(t * 1e9) + 10**18, k, v, 0.0, w) for k, (t, v, w) in enumerate(ODOMETRY)]
    log = load(drive(odometry=text(names, rows), recipe="[odometry]\nclock = -1e9\n"))
    np.testing.assert_array_equal(log.controls[:, 1], expected.controls[:, 1])


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
    path.write_text("sensor_offset = [1]\n")
    with pytest.raises(FormatError, match="import.toml:1: sensor_offset should be a list of two numbers"):
        read_recipe(path)


def test_the_truth_may_be_of_an_antenna(drive):
    folder = drive(truth=text("t,x,y,theta", [(t, 2.0 + t, 1.0, 0.0) for t in (0.0, 0.4, 0.8, 1.2)]))
    tables = [folder / f"{name}.csv" for name in ("odometry", "sightings")]
    log = Log.from_tables(*tables, truth=folder / "truth.csv", truth_offset=(2.0, 1.0))
    assert log.truth_offset == (2.0, 1.0)
    np.testing.assert_allclose(log.true_poses[0, :2], [2.2, 1.0], atol=1e-9)
    np.testing.assert_allclose(log.initial_poses[0], [0.2, 0.0, 0.0], atol=1e-9)
