"""Tables of your own robot become a log: units, columns, clocks, names and classes."""

from functools import partial

import numpy as np
import pytest
from own_tables import NU, ODOMETRY, OMEGA, SEEN, T, text, write_tables

from graphslam import FormatError, Log, LogError, load, save
from graphslam.log import UNIDENTIFIED
from graphslam.log.table import plain

UNSEEN = (
    "the odometry of 0.2 s before the first sighting and 8.0 s after the last sighting is left out: poses are where "
    "something was seen"
)


@pytest.fixture
def drive(tmp_path):
    """A folder with tables; call it to change one of them."""
    return partial(write_tables, tmp_path / "drive")


@pytest.fixture
def expected(drive):
    return load(drive())


@pytest.mark.parametrize("blank", [" ", "\t", "\x1c"])
def test_lines_of_spaces_are_no_rows(drive, expected, blank):
    lines = text("t,nu,omega", ODOMETRY).splitlines()
    assert load(drive(odometry="\n".join([*lines[:5], blank, *lines[5:], blank]) + "\n")).equals(expected)


def test_the_numbers_are_those_of_the_tables(expected):
    assert expected.times.tolist() == pytest.approx([0.2, 1.0, 5.0, 9.0, 9.5, 12.0], abs=1e-9)
    np.testing.assert_array_equal(expected.sightings, [row[2:] for row in SEEN])
    assert expected.landmarks.tolist() == [3, 4, 3, 4, 5, 3, 5]
    np.testing.assert_array_equal(expected.controls[0], [NU[2], OMEGA[2]])
    assert expected.notes == (UNSEEN,)
    assert expected.name == "drive"


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
        text("t,id,range,bearing", SEEN).encode("utf-16"),
        text("timeStamp,tagId,rangeMillimeters,bearing [rad.]", [(t, j, r * 1000, b) for t, j, r, b in SEEN]),
        text("t,TAGID,range,bearing", SEEN),
        text("t,barCode,range,bearing", SEEN),
        text("t,id,range,bearing,comment", [(*row, "seen") for row in SEEN]).replace("'", '"'),
        text("t;id;range;bearing", SEEN, ";").replace(".", ","),
        "\n".join(["t,id,range,bearing", "", "# a comment", *text("", SEEN).splitlines()[1:]]) + "\n\n",
    ],
    ids=[
        "semicolons",
        "tabs",
        "comment",
        "byte-order mark",
        "order",
        "units",
        "quotes",
        "UTF-16",
        "camel case",
        "capital letters",
        "one word",
        "words",
        "comma",
        "blank",
    ],
)
def test_forms_of_the_same_table(drive, expected, sightings):
    log = load(drive(sightings=sightings))
    np.testing.assert_allclose(log.sightings, expected.sightings, rtol=1e-14)
    np.testing.assert_allclose(log.times, expected.times, rtol=1e-12)
    assert log.landmarks.tolist() == expected.landmarks.tolist()


@pytest.mark.slow
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


def test_true_is_no_place_of_the_sensor(drive):
    with pytest.raises(FormatError, match=r"import.toml:1: sensor_offset must be \(ahead, to the left\) in m"):
        load(drive(recipe="sensor_offset = true\n"))


def test_psi_from_the_centre_of_the_robot_turns_with_the_bearing(drive):
    """psi = theta + phi - m_theta, so that the heading of a landmark is the same from the centre and from the sensor."""
    tables = [drive(sightings=text("t,id,range,bearing,orientation", [(*row, 0.4) for row in SEEN])) / "odometry.csv"]
    tables.append(tables[0].with_name("sightings.csv"))
    ahead = Log.from_tables(*tables, sensor_offset=0.7, centre="robot")
    assert ahead.equals(Log.from_tables(*tables, sensor_offset=np.array([0.7, 0.0]), centre="robot"))
    log = Log.from_tables(*tables, sensor_offset=(0.7, -0.4), centre="robot")
    headings = log.sensor.h_inverse(np.zeros((len(SEEN), 3)), log.sightings)[:, 2]
    np.testing.assert_allclose(headings, [b - 0.4 for *_, b in SEEN], atol=1e-12)


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


def test_covariances_are_in_products_of_the_stated_units(drive):
    """sigma 20 mm and 9 mm, and 3 degrees with a correlation of 0.5."""
    given = {"cov_xx": [400.0], "cov_xtheta": [30.0], "cov_yy": [81.0], "cov_thetatheta": [9.0]}
    where = {"t": [1.0], "x": [500.0], "y": [0.0], "theta": [90.0]}
    tables = {"odometry": drive() / "odometry.csv", "sightings": drive() / "sightings.csv", "positions": where | given}
    log = Log.from_tables(**tables, lengths={"positions": "mm"}, angles={"positions": "degrees"})
    x, y, theta = 0.02, 0.009, np.deg2rad(3)
    expected = [[x**2, 0, x * theta / 2], [0, y**2, 0], [x * theta / 2, 0, theta**2]]
    np.testing.assert_allclose(log.positions.covariances, [expected], atol=1e-15)


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
    cases = (("header.stamp.sec,header.stamp.nanosec", 1e9), ("sec,nSec", 1e9), ("sec,msec", 1e3), ("secs,usecs", 1e6))
    for names, parts in cases:
        rows = [(int(t), round(t % 1 * parts), j, r, b) for t, j, r, b in SEEN]
        log = load(drive(sightings=text(f"{names},id,range,bearing", rows)))
        np.testing.assert_allclose(log.times, expected.times, rtol=1e-12)
    # the times are whole already
    for names in ("time_s,msec", "sec,nsec"):
        rows = [(t, 300, j, r, b) for t, j, r, b in SEEN]
        assert load(drive(sightings=text(f"{names},id,range,bearing", rows))).times.tolist() == expected.times.tolist()


def test_rows_that_arrive_together_are_no_other_unit(drive, expected):
    bursts = [(T[k - k % 3] + 2e-5 * (k % 3), v, w) for k, (_, v, w) in enumerate(ODOMETRY)]
    assert len(load(drive(odometry=text("t,nu,omega", bursts))).steps) == len(expected.steps)


def test_truth_and_map(drive):
    truth = text("t,x,y,theta", [(t, 0.5 * t, 0.1, 0.0) for t in T.tolist()])
    log = load(drive(truth=truth, map="id,x,y\n3,1.0,2.0\n4,0.5,0.5\n"))
    np.testing.assert_allclose(log.true_poses[:, 0], 0.5 * log.times)
    assert {j: m.tolist() for j, m in log.true_landmarks.items()} == {3: [1.0, 2.0], 4: [0.5, 0.5]}
    log = load(drive(truth=truth.replace("2.0,1.0,0.1,0.0", "2.0,nan,nan,nan")))
    assert any("1 of 201 rows have no pose" in note for note in log.notes)
    for names, row in (("t,x,y,theta", "nan,nan,nan"), ("t,x,y", "nan,nan"), ("t,x,y,theta", "1.0,2.0,")):
        unknown = "\n".join([names, *(f"{t},{row}" for t in T.tolist())])
        with pytest.raises(LogError, match="no row has all numbers of a pose; leave out an empty column, or"):
            load(drive(truth=unknown))


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
    with pytest.raises(
        FormatError,
        match=r"map.csv:3: the id 'id' is empty or -1, which means no id; each landmark of the map needs one",
    ):
        load(drive(sightings=seen, map="id,x,y\ntree,5,5\n,1,1\n"))
    with pytest.raises(
        FormatError, match=r"map.csv:3: the heading is 90 rad.* is it in degrees\? Then add angles='map="
    ):
        load(drive(sightings=seen, map="id,x,y,theta\ntree,5,5,0\nlamp,1,1,90\n"))


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
    assert note.endswith("it has t, serial, range, bearing. If one has the ids, say which: columns='sightings.id=NAME'")


def test_columns_that_are_missing_are_said_together(drive):
    missing = (
        r"odometry.csv: no column for t \(.*\) and none for nu \(.*\) and none for omega .* a, b, c. Say which they"
    )
    with pytest.raises(
        LogError, match=missing + " are: columns='odometry.t=NAME,odometry.nu=NAME,odometry.omega=NAME'"
    ):
        load(drive(odometry=text("a,b,c", ODOMETRY)))
    with pytest.raises(LogError, match=r"no column for t .* and none for bearing .* it has moment, id, range, way\."):
        load(drive(sightings=text("moment,id,range,way", SEEN)))


def test_exchanged_tables_are_said(drive):
    with pytest.raises(LogError, match="odometry.csv: it has the columns of sightings: are the two tables exchanged?"):
        load(drive(odometry=text("t,id,range,bearing", SEEN), sightings=text("t,nu,omega", ODOMETRY)))
    moved, seen = {"t": [0, 1], "nu": [1, 1], "omega": [0, 0]}, {"t": [0], "id": [1], "range": [2], "bearing": [0]}
    with pytest.raises(LogError, match="^odometry: it has the columns of sightings"):
        Log.from_tables(seen, moved)


def test_columns_of_one_name_have_numbers(drive, expected):
    table = text("t,id,d,d", SEEN)
    with pytest.raises(LogError, match="columns 3 and 4 are both called 'd'; for range state the number of one"):
        load(drive(sightings=table, recipe='[sightings]\nrange = "d"\nbearing = 4'))
    log = load(drive(sightings=table, recipe="[sightings]\nrange = 3\nbearing = 4"))
    np.testing.assert_array_equal(log.sightings, expected.sightings)


def test_names_of_columns():
    assert plain(" Bearing (deg) ") == ("bearing", "degrees")
    assert plain("v_m_s") == ("v", "m")
    assert plain("omega_rad_s") == ("omega", "radians")
    assert plain("field.header.stamp") == ("field_header_stamp", None)
    assert plain("%time") == ("time", None)
    assert plain("t_ms") == ("t", "ms")
    assert plain("Speed [m/s]") == ("speed", "m")
    assert plain("yaw_rate (°/s)") == ("yaw_rate", "degrees")
    assert plain("Speed [km/h]") == ("speed", "km/h")
    assert plain("x [map]") == ("x", None)
    assert plain("speed_kmh") == plain("speed km/h") == ("speed", "kmh")
    assert plain("t [µs]") == plain("t_μs") == ("t", "us")  # micro sign, Greek letter
    assert plain("range_min") == ("range_min", None)
    assert plain("speed [km h-1]") == ("speed", "km/h")
    assert plain("turnRate (deg s^-1)") == ("turn_rate", "degrees")
    assert plain("speed [ticks/s]") == ("speed", "ticks/s")
    assert [plain(name)[0] for name in ("nanoSec", "barCode", "TAGID")] == ["nanosec", "barcode", "tagid"]


@pytest.mark.parametrize(
    ("table", "names", "unit", "option"),
    [
        ("odometry", "t,Speed [km/h],omega", "km/h", "lengths='odometry=m'"),
        ("odometry", "t,v_kmh,omega", "kmh", "lengths='odometry=m'"),
        ("sightings", "t,id,range [ft],bearing", "ft", "lengths='sightings=m'"),
        ("sightings", "t,id,range,bearing (mrad)", "mrad", "angles='sightings=radians'"),
        ("sightings", "t [min],id,range,bearing", "min", "time='sightings=s'"),
    ],
)
def test_units_in_names_that_are_not_converted_are_refused(drive, table, names, unit, option):
    """They were dropped, so that km/h were read as m/s."""
    rows = {"odometry": ODOMETRY, "sightings": SEEN}[table]
    with pytest.raises(FormatError, match=f"is in {unit}, which is not converted: units are .*{option}"):
        load(drive(**{table: text(names, rows)}))
    measure, stated = option.removesuffix("'").split("='")
    kind, own = stated.split("=")
    recipe = f'[{kind}]\n{measure} = "{own}"\n'
    load(drive(**{table: text(names, rows)}, recipe=recipe))


@pytest.mark.parametrize(
    "names", ["t,speed_kmh,speed,omega", "t,v_kmh,linear_velocity,omega", "t,v_kmh,odom_speed,omega"]
)
def test_of_two_units_the_one_that_is_converted_is_read(drive, expected, names):
    rows = [(t, 3.6 * v, v, w) for t, v, w in ODOMETRY]
    log = load(drive(odometry=text(names, rows)))
    np.testing.assert_array_equal(log.controls, expected.controls)


@pytest.mark.parametrize("micro", ["µs", "μs"])
def test_times_in_microseconds(drive, expected, micro):
    rows = [(round(t * 1e6), v, w) for t, v, w in ODOMETRY]
    log = load(drive(odometry=text(f"t [{micro}],v,omega", rows)))
    np.testing.assert_allclose(log.dt, expected.dt, atol=1e-9)


def test_columns_of_exported_messages(drive, expected):
    """The names that `rostopic echo -p` and PlotJuggler give."""
    names = "%time,field.header.seq,field.twist.twist.linear.x,field.twist.twist.linear.y,field.twist.twist.angular.z"
    place, turn = "field.pose.pose.position", "field.pose.pose.orientation"
    names += ",field.twist.twist.angular.x" + "".join(f",{place}.{axis}" for axis in "xyz")
    names += "".join(f",{turn}.{axis}" for axis in "xyzw")
    rows = [(int(t * 1e9) + 10**18, k, v, 0.0, w, *(8 * [0.5])) for k, (t, v, w) in enumerate(ODOMETRY)]
    log = load(drive(odometry=text(names, rows), recipe="[odometry]\nclock = -1e9\n"))
    np.testing.assert_array_equal(log.controls[:, 1], expected.controls[:, 1])
    tags = text("t,id,pose.position.x,pose.position.y,pose.orientation.x", [(*row, 0.0) for row in SEEN])
    assert load(drive(odometry=text("t,nu,omega", ODOMETRY), sightings=tags, recipe="")).num_poses == 6
    with pytest.raises(LogError, match="no column for nu .* it has t, accel_x, accel_y, yaw"):
        load(drive(odometry=text("t,accel_x,accel_y,yaw", [(*row, 0.0) for row in ODOMETRY])))
    imu = text("t,speed,angular_velocity.x,angular_velocity.z", [(t, v, 9.0, w) for t, v, w in ODOMETRY])
    np.testing.assert_array_equal(load(drive(odometry=imu)).controls, expected.controls)


def test_the_truth_may_be_of_an_antenna(drive):
    folder = drive(truth=text("t,x,y,theta", [(t, 2.0 + t, 1.0, 0.0) for t in (0.0, 0.4, 0.8, 1.2)]))
    tables = [folder / f"{name}.csv" for name in ("odometry", "sightings")]
    log = Log.from_tables(*tables, truth=folder / "truth.csv", truth_offset=(2.0, 1.0))
    assert log.truth_offset == (2.0, 1.0)
    np.testing.assert_allclose(log.true_poses[0, :2], [2.2, 1.0], atol=1e-9)
    np.testing.assert_allclose(log.initial_poses[0], [0.2, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize(("factor", "unit"), [(1e9, "ns"), (1e9, None), (1e6, "us"), (1e3, None)])
def test_times_since_1970_may_be_floating_point_numbers(factor, unit):
    """Pandas makes them of whole numbers where some are missing; their text has exponents."""
    t = np.arange(0, 20, 0.1)
    times, seen = (1.7e9 + each for each in (t, np.array([1.0, 3.0])))
    sightings = {"t": seen * factor, "id": [7, 7], "range": [2.0, 1.0], "bearing": [0.1, 0.2]}
    log = Log.from_tables({"t": times * factor, "nu": 0 * t + 0.5, "omega": 0 * t + 0.3}, sightings, time=unit)
    np.testing.assert_allclose(log.dt.sum(), 2.0, atol=1e-6)


def test_fixes_of_a_receiver_without_one_are_left_out(drive):
    """The plane of the others touched the Earth at latitude and longitude 0, 3,000 km away."""
    rows = [(0.3, 0, 0, 0.1), *(20 * [(7.25, 60.0, 25.0, 0.1)])]
    log = load(drive(positions=text("t,lat,lon,sigma", rows)))
    np.testing.assert_array_equal(log.positions.places[:, :2], 0.0)
    assert any("1 of 21 rows has latitude and longitude 0" in note for note in log.notes)


@pytest.mark.parametrize("names", ["alt [ft]", "gps_alt,baro_alt", "alt", "altitude_mm"])
def test_altitudes_that_cannot_be_read_are_no_obstacle(drive, names):
    cells = {"alt [ft]": (1312,), "gps_alt,baro_alt": (400.0, 410.0), "alt": ("M",), "altitude_mm": (4e5,)}[names]
    rows = [(7.25, 60.0, 25.0, 0.1, *cells), (7.5, 60.0, 25.001, 0.1, *cells)]
    positions = load(drive(positions=text(f"t,lat,lon,sigma,{names}", rows))).positions
    assert positions.datum.tolist() == [60.0, 25.0, 400.0 if names == "altitude_mm" else 0.0]
    # with millimetres as metres it was 59.3
    assert positions.places[1, 0] == pytest.approx(55.8, abs=0.05)


def test_masked_numbers_are_none():
    nu = np.ma.array(NU, mask=np.arange(len(NU)) == 5)
    log = Log.from_tables({"t": T, "nu": nu, "omega": OMEGA}, np.array(SEEN))
    assert "odometry: 1 of 201 rows has 'nu' empty, NaN or infinite: left out (row 6)" in log.notes
