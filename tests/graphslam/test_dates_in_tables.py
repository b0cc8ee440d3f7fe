"""Times that are dates, and text files that were joined or are in another encoding."""

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from graphslam import FormatError, Log, LogError, OptionError

HEADER = "t,v,w\n"


def odometry(form: str, first: int = 0) -> str:
    return HEADER + "".join(f"{form.format(k)},0.5,0.1\n" for k in range(first, first + 50))


def read(folder: Path, controls: str, sightings: str) -> Log:
    (folder / "odometry.csv").write_text(controls)
    (folder / "sightings.csv").write_text(sightings)
    return Log.from_tables(folder / "odometry.csv", folder / "sightings.csv")


def seen(form: str) -> str:
    return "t,id,range,bearing\n" + "".join(f"{form.format(k)},{k % 3},2,0.1\n" for k in range(5, 45))


def test_dates_are_seconds(tmp_path):
    plain = read(tmp_path, odometry("{}.125"), seen("{}.25"))
    for controls, sightings in (
        ("2026-11-22T10:00:{:02}.125Z", "2026-11-22T10:00:{:02}.25"),
        ("2026-11-22 10:00:{:02}.125", "2026-11-22T12:30:{:02}.250000+02:30"),
        ("2026-11-22T10:00:{:02}.125+00:00", "2026-11-22 06:30:{:02}.25-0330"),
        ("2026/11/22 10:00:{:02}.125 GMT", "2026-11-22T12:00:{:02}.25+02"),
        ("10:00:{:02}.125", "10:00:{:02}.25"),
    ):
        dated = read(tmp_path, odometry(controls), seen(sightings))
        np.testing.assert_array_equal(dated.steps, plain.steps)
        np.testing.assert_array_equal(dated.dt, plain.dt)
        np.testing.assert_allclose(dated.controls, plain.controls, rtol=1e-15)


def test_dates_and_times_of_day_may_be_two_columns(tmp_path):
    expected = read(tmp_path, odometry("2026-11-22T10:00:{:02}.125Z"), seen("2026-11-22T10:00:{:02}.25Z"))
    controls = odometry("2026-11-22,10:00:{:02}.125").replace("t,", "date,time,")
    sightings = seen("10:00:{:02}.25,2026-11-22").replace("t,id", "Time,Date,id")
    found = read(tmp_path, controls, sightings)
    np.testing.assert_array_equal(found.steps, expected.steps)
    np.testing.assert_array_equal(found.dt, expected.dt)
    with pytest.raises(LogError, match=r"odometry\.csv:12: 'time' should be a date and time .* not '2026-11-22 noon'"):
        read(tmp_path, controls.replace("10:00:10.125", "noon"), sightings)


def test_a_wrong_date_is_named(tmp_path):
    wrong = odometry("2026-11-22T10:00:{:02}Z")
    with pytest.raises(LogError, match=r"odometry\.csv:12: 't' should be a date and time .* not 'noon'"):
        read(tmp_path, wrong.replace("2026-11-22T10:00:10Z", "noon"), seen("{}"))
    with pytest.raises(LogError, match=r"odometry\.csv:12: 't' is no date that exists: '2026-13-22T10:00:10Z'"):
        read(tmp_path, wrong.replace("2026-11-22T10:00:10Z", "2026-13-22T10:00:10Z"), seen("{}"))


def test_dates_of_another_form_are_named(tmp_path):
    with pytest.raises(
        LogError, match=r"odometry\.csv:2: the time 't' should be a number, or a date .* not '22\.11\.2026 10:00'"
    ):
        read(tmp_path, odometry("22.11.2026 10:{:02}"), seen("{}"))


def test_a_header_that_is_repeated_is_named(tmp_path):
    joined = odometry("{}") + odometry("{}", 50)
    with pytest.raises(FormatError, match=r"odometry\.csv:52: .* this line repeats the header"):
        read(tmp_path, joined, seen("{}"))


def test_another_encoding_is_named(tmp_path):
    (tmp_path / "odometry.csv").write_bytes((HEADER + "0,0.5,0.1 # né\n").encode("latin-1"))
    with pytest.raises(FormatError, match="save it as UTF-8"):
        Log.from_tables(tmp_path / "odometry.csv", tmp_path / "odometry.csv")


@pytest.mark.parametrize(
    "word",
    [
        "2263-01-01T00:00:{:02}Z",
        "9999-12-31T23:59:{:02}.5",
        "1600-01-01T00:00:{:02}",
        # within 64 bits in UTC, beyond them in the zone
        "2262-04-11T23:47:{:02}-01:00",
        "1{:02}e20",
        "99999999999999{:02}999999",
        "-92233720368547758{:02}.5",
    ],
)
def test_times_beyond_64_bits_are_refused(tmp_path, word):
    """Nanoseconds since 1970 end in 2262; they wrapped without a word, so that a drive went back to 1678."""
    with pytest.raises(LogError, match=r"odometry\.csv:\d+: .*the time 't' is .* from 1678 to 2262: is its unit"):
        read(tmp_path, odometry(word), seen(word))
    # the unit is wrong in one table alone
    with pytest.raises(LogError, match=r"sightings\.csv:\d+: .*For nanoseconds add time='sightings=ns'"):
        read(tmp_path, odometry("{}"), seen(word))


def test_times_are_used_up_to_2262_and_not_farther_apart(tmp_path):
    form = "2262-04-11T23:46:{:02}.5"
    plain = read(tmp_path, odometry("{}.5"), seen("{}.5"))
    np.testing.assert_array_equal(read(tmp_path, odometry(form), seen(form)).dt, plain.dt)
    lines = odometry("1700-01-01T00:00:{:02}") + "2200-01-01T00:00:00,0.5,0.1\n"
    with pytest.raises(LogError, match=r"odometry\.csv:52: the times 't' are more than 292 years apart"):
        read(tmp_path, lines, seen("1700-01-01T00:00:{:02}"))


@pytest.mark.parametrize(
    ("header", "time", "message"),
    [
        (HEADER, lambda t: f"{46347 + t / 86400:.11f}", "neighbouring rows are .*e-06 s apart .*: are the times in minutes"),
        # as milliseconds since 1970 these are of 1989, and as microseconds of the year 2001
        (HEADER, lambda t: f"{6e11 + 1e9 * t:.0f}", "neighbouring rows are 100000 s apart .*: are the times in ns"),
        (HEADER, lambda t: f"{1e11 + 1e9 * t:.0f}", "the time 't' is 100000000000, .*is its unit stated rightly"),
        ("sec,nsec,v,w\n", lambda t: f"{t:.0f},{1e9 * t:.0f}", "'nsec' is 1000000000, and no part .* columns='odometry.t=2'"),
    ],
)  # fmt: skip
def test_other_units_of_time_are_named(tmp_path, header, time, message):
    """Days of a spreadsheet were seconds, a clock's nanoseconds milliseconds, and a whole time the part of a second."""
    rows = "".join(f"{time(k / 10)},0.5,0.1\n" for k in range(100))
    with pytest.raises(LogError, match=rf"odometry\.csv(:\d+)?: {message}"):
        read(tmp_path, header + rows, seen("{}"))


def test_a_clock_may_not_lead_beyond_64_bits(tmp_path):
    (tmp_path / "odometry.csv").write_text(odometry("{}"))
    (tmp_path / "sightings.csv").write_text(seen("{}"))
    with pytest.raises(
        OptionError, match="clocks: odometry should be at most 4.6e.09 seconds .146 years. forward or back"
    ):
        Log.from_tables(tmp_path / "odometry.csv", tmp_path / "sightings.csv", clocks={"odometry": 1e10})


@pytest.mark.parametrize("kind", ["datetime64[ns]", "datetime64[us]", "datetime64[ms]", "timedelta64[ms]"])
def test_dates_of_numpy_and_pandas_have_the_unit_of_their_type(kind):
    """Also near 1970, where the size of the numbers would be taken for that of another unit."""
    t = np.arange(50) * 250
    odometry = {"t": t / 1000, "v": np.full(50, 0.5), "w": np.full(50, 0.1)}
    sightings = {"t": t[5:45] / 1000, "id": np.arange(40) % 3, "range": np.full(40, 2.0), "bearing": np.full(40, 0.1)}
    expected = Log.from_tables(odometry, sightings)
    dated = [
        table | {"t": (1000 * table["t"]).astype(f"{kind[:-4]}[ms]").astype(kind)} for table in (odometry, sightings)
    ]
    found = Log.from_tables(*dated)
    np.testing.assert_array_equal(found.steps, expected.steps)
    np.testing.assert_array_equal(found.dt, expected.dt)
    dated[1]["t"][7] = "NaT"
    left = Log.from_tables(*dated)
    assert len(left.steps) == 39 and "1 of 40 sightings has no time: left out (row 8)" in left.notes[0]


def test_dates_that_nanoseconds_cannot_hold_are_named():
    t = np.array(["2500-01-01T10:00:00", "2500-01-01T10:00:01"], "datetime64[s]")
    odometry = {"t": t, "v": [0.5, 0.5], "w": [0.1, 0.1]}
    with pytest.raises(LogError, match="from 1678 to 2262"):
        Log.from_tables(odometry, {"t": t, "id": [1, 1], "range": [2.0, 2.0], "bearing": [0.1, 0.1]})


def tables(**changes):
    t = 0.25 * np.arange(50)
    odometry = {"t": t, "v": np.full(50, 0.5), "w": np.full(50, 0.1)}
    sightings = {"t": t[5:45], "id": np.arange(40) % 3, "range": np.full(40, 2.0), "bearing": np.full(40, 0.1)}
    return odometry, sightings | changes


@pytest.mark.parametrize(
    "make", [lambda t: timedelta(seconds=t), lambda t: datetime(2026, 1, 1) + timedelta(seconds=t)]
)
def test_dates_and_durations_of_python_have_no_unit_to_state(make):
    plain = tables()
    dated = [{**table, "t": [make(float(t)) for t in table["t"]]} for table in plain]
    found = Log.from_tables(*dated)
    np.testing.assert_array_equal(found.dt, Log.from_tables(*plain).dt)
    stated = Log.from_tables(*dated, time={"sightings": "ms"})
    np.testing.assert_array_equal(stated.dt, found.dt)
    (note,) = set(stated.notes) - set(found.notes)
    assert note == "sightings: 't' holds dates or durations: the stated unit ms is not used"


@pytest.mark.parametrize("values", [np.full(40, 2, "timedelta64[s]"), [timedelta(seconds=2)] * 40])
def test_durations_are_no_ranges(values):
    message = "sightings: 'range' holds dates or durations, but range is a number: convert it, or state another column"
    with pytest.raises(LogError, match=message):
        Log.from_tables(*tables(range=values))


def test_a_single_number_is_not_repeated_for_all_rows():
    with pytest.raises(LogError, match="'range' should hold one number in each row; it has 1, and the first column 40"):
        Log.from_tables(*tables(range=[2.0]))


def test_times_that_pandas_has_as_index_and_a_map_by_ids():
    pandas = pytest.importorskip("pandas")
    frames = [pandas.DataFrame(table) for table in tables()]
    found = Log.from_tables(*(frame.set_index("t") for frame in frames), map={0: (1, 2), 1: (3, 4, 0.5)})
    assert found.replace(true_landmarks=None).equals(Log.from_tables(*frames))
    assert found.true_landmarks is not None and found.true_landmarks[1].tolist() == [3, 4, 0.5]
