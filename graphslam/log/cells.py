"""What the cells of a table say: times, ids, classes and headings; and rows that can be read, but are probably mistakes.

`nanoseconds` makes whole numbers of times: seconds since 1970 with nine decimals do not fit into a floating-point number.
`ids_of` and `classes_of` read whole numbers, words, or nothing where a landmark was not identified. `checked_heading` turns
quaternions into headings. `repeated_times` and `repeated_sightings` find rows that come twice, and times that several rows
share.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from ..errors import LogError, checks, decimals, named, quoted, shortened
from ..se2 import Array
from .rows import MOST_CLASSES, NO_CLASS, UNIDENTIFIED, Fault, without_no_id
from .table import Table
from .text_table import MISSING

#: nanoseconds of each unit
UNITS = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1000, "ns": 1}
#: floating-point numbers of seconds resolve nanoseconds up to here, with their rounding and that of the product
_RESOLVED = 2.0**51
#: whole nanoseconds in 64 bits are below this
_LARGEST = 2.0**63
#: date and time of day as in ISO 8601, with the hours and minutes by which it is ahead of UTC
_DATE = re.compile(
    r"(\d{4}[-/]\d\d[-/]\d\d)[T ](\d\d:\d\d:\d\d(?:[.,]\d{1,9})?) ?(?:Z|UTC|GMT|([+-]\d\d):?(\d\d)?)?", re.IGNORECASE
)
#: the time of day, where the date has a column of its own, or all rows are of one day
_DAY_TIME = re.compile(r"\d\d:\d\d:\d\d.*")
#: a single time this far [s] outside those of both neighbours is wrong
STRAY = 10


def nanoseconds(table: Table, column: int, unit: str | None, kind: str, day: int | None = None) -> np.ndarray:
    """A column of times (N,) as whole nanoseconds.

    Args:
        table: whose column it is.
        column: its number.
        unit: "s", "ms", "us" or "ns"; None: by the size of the numbers, as `by_size`.
        kind: what the table holds, such as "odometry".
        day: the number of the column of the date, where the table has one; it counts where the times are times of day.

    Dates with the time of day (ISO 8601, "2026-11-22T10:00:00.5Z") are counted from 1970, in UTC where they name no zone, and
    times of day alone from midnight.

    Raises:
        LogError: a time is neither a finite number nor a date, or has no place in 64 bits (before 1678 or after 2262).
    """
    try:
        values = table.numbers([column])[:, 0]
    except LogError:
        if (dates := _of_dates(table, column, kind, day)) is not None:
            return dates
        word = str(table.words(column)[0])
        if re.fullmatch(r"[\d.,eE+-]*", word):
            # the first time is a number, so that a later one is the mistake
            raise
        date = "or a date with the time of day as in 2026-11-22T10:00:00.5Z (or in two columns, date and time)"
        message = f"the time {table.title(column)} should be a number, {date}, not {quoted(word)}"
        raise table.error(0, message) from None
    if (bad := np.flatnonzero(~np.isfinite(values))).size:
        raise table.error(int(bad[0]), f"the time {table.title(column)} is {values[bad[0]]}; every row needs a time")
    factor = UNITS[unit or by_size(values)]
    if (beyond := np.flatnonzero(np.abs(values) >= _LARGEST / factor)).size:
        raise _beyond(table, int(beyond[0]), column, kind)
    if np.all(np.abs(values) * factor < _RESOLVED):
        return np.rint(values * factor).astype(np.int64)
    words = table.texts(column)
    if words.dtype.kind in "iu":
        return words.astype(np.int64) * factor
    if np.any(np.char.find(np.char.lower(words), b"e") >= 0):
        # with exponents, as floating-point numbers from 1e16 on have them
        return np.rint(values * factor).astype(np.int64)
    digits = len(str(factor))
    whole, _, fraction = np.moveaxis(np.char.partition(np.char.strip(words, b" +-"), b"."), -1, 0)
    try:
        # one digit more than nanoseconds have, which is rounded
        beneath = np.char.ljust(fraction, digits, b"0").astype(f"S{digits}").astype(np.int64)
        found = whole.astype(np.int64) * factor + (beneath + 5) // 10
    except (ValueError, OverflowError):
        return np.rint(values * factor).astype(np.int64)
    return np.where(values < 0, -found, found)


def time_faults(values: np.ndarray, title: str, unit: str | None, stray: float = STRAY) -> list[Fault]:
    """The rows whose time (N,) is no number, or lies more than ``stray`` [s] outside the times of both its neighbours.

    A clock that continues from a wrong time is handled in `drive`.
    """
    finite = np.isfinite(values)
    known = np.flatnonzero(finite)
    alone = np.zeros(len(values), dtype=bool)
    t = values[known]
    if len(t) > 2:
        far = stray * UNITS["s"] / UNITS[unit or by_size(t)]
        before, after = np.append(t[1], t[:-1]), np.append(t[1:], t[-2])
        # without the row its neighbours are in order
        ordered = after >= before
        ordered[0], ordered[-1] = t[2] >= t[1], t[-2] >= t[-3]
        late, early = t > np.maximum(before, after) + far, t < np.minimum(before, after) - far
        # the first row may be far before, and the last far after the others: a pause
        late[-1], early[0] = False, False
        alone[known] = (late | early) & ordered
    return [
        Fault(~finite, "no time", lambda k: f"{title} is {values[k]}; every row needs a time"),
        Fault(
            alone, "a time that is far from those of the rows before and after",
            lambda k: f"{title} is {decimals(values[k])}, far from those of the rows before and after it; "
            "repair or remove the row, or sort the rows by their time",
        ),
    ]  # fmt: skip


def _of_dates(table: Table, column: int, kind: str, day_column: int | None) -> np.ndarray | None:
    """Times (N,) of dates, or of dates and times of day in two columns; None where the first is none."""
    ns = np.empty(len(table), np.int64)
    words = [str(word) for word in table.words(column)]
    if words and _DAY_TIME.fullmatch(words[0]):
        days = ["1970-01-01"] * len(words) if day_column is None else table.words(day_column)
        words = [f"{date} {word}" for date, word in zip(days, words)]
    for row, word in enumerate(words):
        if (match := _DATE.fullmatch(word)) is None:
            if row == 0:
                return None
            message = f"{table.title(column)} should be a date and time as in the rows above, not {quoted(word)}"
            raise table.error(row, message)
        day, clock, hours, minutes = match.groups()
        try:
            whole, _, fraction = clock.replace(",", ".").partition(".")
            # nanoseconds as numpy has them wrap without a word
            instant = int(np.datetime64(f"{day.replace('/', '-')}T{whole}", "s").astype(np.int64))
            moment = instant * UNITS["s"] + int(fraction.ljust(9, "0"))
        except ValueError as error:
            raise table.error(row, f"{table.title(column)} is no date that exists: {quoted(word)} ({error})") from None
        ahead = 60 * int(hours) + int(hours[0] + (minutes or "0")) if hours else 0
        moment -= ahead * 60 * UNITS["s"]
        if abs(moment) >= _LARGEST:
            raise _beyond(table, row, column, kind)
        ns[row] = moment
    return ns


def is_dated(table: Table, column: int) -> bool:
    """Whether times say themselves which unit they have: dates, or durations."""
    return column in table.units or any(form.fullmatch(str(table.words(column)[0])) for form in (_DATE, _DAY_TIME))


def _beyond(table: Table, row: int, column: int, kind: str) -> LogError:
    """The error of a time that does not fit."""
    given = f"the time {table.title(column)} is {shortened(str(table.words(column)[row]))}"
    limits = "but times are whole nanoseconds in 64 bits, from 1678 to 2262"
    advice = f"is its unit stated rightly (s, ms, us or ns)? For nanoseconds add time='{kind}=ns'"
    return table.error(row, f"{given}, {limits}: {advice}")


def added(table: Table, column: int, times: np.ndarray, more: np.ndarray | int, kind: str) -> np.ndarray:
    """Times (N,) plus others [ns].

    Raises:
        LogError: a sum does not fit into 64 bits, or times are so far apart that their difference does not.
    """
    total = times.astype(float) + np.asarray(more, dtype=float)
    if (beyond := np.flatnonzero(np.abs(total) >= _LARGEST)).size:
        raise _beyond(table, int(beyond[0]), column, kind)
    if np.ptp(total) >= _LARGEST:
        raise table.error(int(np.argmax(total)), f"the times {table.title(column)} are more than 292 years apart")
    return times + more


def by_size(values: np.ndarray) -> str:
    """The unit of times since 1970 in a year after 1988, which their size tells; s for others."""
    largest = float(np.max(np.abs(values), initial=0.0))
    for unit, least in (("ns", 6e17), ("us", 6e14), ("ms", 6e11)):
        if largest >= least:
            return unit
    return "s"


#: rows of odometry that are closer in time [s] are probably in minutes, hours or days
SHORTEST = 1e-4


def check_spacing(table: Table, column: int, ns: np.ndarray) -> None:
    """Raise `LogError` where times (N,) [ns] of odometry, whose unit is not stated, are as far apart as in another unit."""
    apart, units = np.diff(ns) / 1e9, list(UNITS)
    # messages may have the time at which several of them arrived
    middle, long = np.quantile(apart[apart > 0], [0.5, 0.9]) if (apart > 0).any() else (1.0, 1.0)
    if (long >= SHORTEST and middle <= checks.LONGEST) or is_dated(table, column):
        return
    used = by_size(table.numbers([column]))
    spacing = f"neighbouring rows are {middle:g} s apart (median)"
    stated = f"if they are in {used}, add time='odometry={used}'"
    if middle > checks.LONGEST:
        finer = 1 + (middle > 1e3 * checks.LONGEST) + (middle > 1e6 * checks.LONGEST)
        unit = units[min(units.index(used) + finer, len(units) - 1)]
        raise table.error(None, f"{spacing}: are the times in {unit}? Then add time='odometry={unit}'; {stated}")
    cause = "are the times in minutes, hours or days? Then make seconds of them"
    raise table.error(None, f"{spacing}: {cause}; {stated}")


def seconds(nanoseconds: np.ndarray, origin: int) -> np.ndarray:
    """Times in seconds after an origin, exact to less than a nanosecond within months."""
    return (nanoseconds - origin) / 1e9


#: cells without an id or a class, in small letters
EMPTY = (*(cell.decode() for cell in MISSING), "nan", "<na>")

#: the most digits with which every whole number fits into 64 bits
_MOST_DIGITS = 18


@dataclass(frozen=True)
class Ids:
    """The ids of the rows of a table.

    Attributes:
        numbers: (N,) of the landmarks; `UNIDENTIFIED` where the cell is empty.
        names: {name: number} where the names of landmarks contain no number.
        notes: one sentence each.
    """

    numbers: np.ndarray
    names: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def ids_of(table: Table, column: int, known: Mapping[str, int] | None = None) -> Ids:
    """The ids in a column of a table.

    Args:
        table: of sightings, or of the true map.
        column: its number.
        known: numbers of landmarks that have names in another table, which stay.

    Raises:
        LogError: an id is a number, but not a whole one.
    """
    try:
        values = table.numbers([column])[:, 0]
    except LogError:
        words = table.words(column)
        empty = np.isin(np.char.lower(words), EMPTY)
        numbers, names = _of_names(words[~empty], known or {})
    else:
        names, empty = {}, np.isnan(values)
        fault = id_fault(table, column, values)
        if (k := checks.first(fault.rows)) is not None:
            raise table.error(k, fault.message(k))
        numbers = _whole(table, column, values)[~empty]
    ids = np.full(len(table), UNIDENTIFIED)
    ids[~empty] = numbers
    notes = [f"{empty.sum()} of {len(table)} rows have no id"] * bool(empty.any())
    notes += without_no_id(ids, "row")
    if names:
        listed = named(f"{number} = {name}" for name, number in names.items())
        notes.append(f"landmarks have names, ids count them: {listed}")
    return Ids(ids, names, tuple(f"{table.source}: {note}" for note in notes))


def id_fault(table: Table, column: int, values: np.ndarray) -> Fault:
    """The rows whose id (N,), NaN where it is empty, is no whole number of 64 bits."""
    order = "" if table.names else ": is the order of the columns t, id, range, bearing?"
    wrong = ~np.isnan(values) & ((values % 1 != 0) | (np.abs(values) >= 2.0**63))
    return Fault(
        wrong, "an id that is no whole number of 64 bits",
        lambda k: f"the id {table.title(column)} is {values[k]:g}, "
        + ("but ids are whole numbers of less than 64 bits or words" if abs(values[k]) >= 2.0**63
           else f"but ids are whole numbers or words{order}"),
    )  # fmt: skip


def _whole(table: Table, column: int, values: Array) -> np.ndarray:
    """The whole numbers (N,) of a column of ids whose floating-point numbers are ``values``; 0 where it is NaN."""
    whole = np.where(np.isnan(values), 0.0, values).astype(np.int64)
    if (large := np.flatnonzero(np.abs(values) >= 2.0**53)).size:
        # their last digits are in the text only
        words = table.words(column)[large]
        for k, word in zip(large.tolist(), words.tolist()):
            with suppress(ValueError, OverflowError):  # 1e17, and what rounds up to 2^63
                whole[k] = int(word)
    return whole


def _of_names(words: np.ndarray, known: Mapping[str, int]) -> tuple[np.ndarray, dict[str, int]]:
    """Numbers (N,) of landmarks that have names, and their names where these contain no number.

    They are the number at the end of each name where these differ, and else count the names. Names that are known keep
    their number, and others get the next ones.
    """
    unique, which = np.unique(words, return_inverse=True)
    listed = [str(name) for name in unique]
    ends = [name[len(name.rstrip("0123456789")) :] for name in listed]
    short = all(0 < len(end) <= _MOST_DIGITS for end in ends)
    if not known and short and len({int(end) for end in ends}) == len(listed):
        return np.array([int(end) for end in ends], dtype=np.int64)[which], {}
    begin = max(known.values(), default=-1) + 1
    new = {name: begin + k for k, name in enumerate(name for name in listed if name not in known)}
    names = {**known, **new}
    return np.array([names[name] for name in listed], dtype=np.int64)[which], names


def classes_of(table: Table, column: int, *, stated: bool) -> tuple[np.ndarray | None, tuple[str, ...]]:
    """The class (N,) of each sighting as words, or as integers where all are whole numbers; and notes.

    Args:
        table: of the sightings.
        column: the number of the column.
        stated: whether the user says that it holds classes; else one that cannot is left out, with a note.

    Raises:
        LogError: a stated column holds no classes.
    """
    words = table.words(column)
    if words.dtype.kind not in "iu":
        words = np.char.strip(words)
        words = np.where(np.isin(np.char.lower(words), EMPTY), NO_CLASS, words)
    names, which = np.unique(words, return_inverse=True)
    numbers = _numbers([name for name in names.tolist() if name != NO_CLASS])
    known = np.ones(len(words), dtype=bool) if words.dtype.kind in "iu" else words != NO_CLASS
    reason = ""
    if not known.any():
        reason = "all its cells are empty"
    elif numbers is not None and np.any(numbers % 1 != 0):
        reason = f"it holds numbers that are not whole, such as {numbers[np.argmax(numbers % 1 != 0)]:g}"
    elif len(names) > MOST_CLASSES:
        reason = f"it has {len(names)} different entries, more than {MOST_CLASSES}"
    if reason:
        message = f"{table.title(column)} holds no classes of sightings: {reason}"
        if stated:
            raise table.error(None, message)
        return None, (f"{table.source}: {message}; it is left out",)
    notes: tuple[str, ...] = ()
    if not known.all():
        notes = (f"{table.source}: {np.sum(~known)} of {len(known)} sightings have no class, and may be of any",)
    if numbers is None:
        return words, notes
    of_names = np.full(len(names), UNIDENTIFIED)
    of_names[len(names) - len(numbers) :] = numbers.astype(np.int64)
    return of_names[which], notes


def _numbers(names: list[str | int]) -> np.ndarray | None:
    """The names as numbers, None where one is none."""
    try:
        numbers = np.array([float(name) for name in names])
    except ValueError:
        return None
    return numbers if np.all(np.abs(numbers) < 2.0**53) else None


#: quaternions may be this far from length 1; a robot may be tilted by at most this angle [rad]
_LENGTH, _TILT = 0.02, np.deg2rad(45)


def checked_heading(table: Table, quaternions: Array) -> Array:
    """The headings (N,) of the quaternions (N, 4) of a table, x, y, z, w, of a robot that stands on the ground.

    Raises:
        LogError: a quaternion is not of length 1, or tilts the robot.
    """
    length = np.linalg.norm(quaternions, axis=1)
    if (k := checks.first(np.abs(length - 1) > _LENGTH)) is not None:
        cause = "no orientation was measured" if length[k] == 0 else "are its columns x, y, z, w in this order?"
        raise table.error(k, f"the quaternion has length {length[k]:.3g}, but a rotation has length 1: {cause}")
    x, y, _, _ = (quaternions / length[:, None]).T
    if (k := checks.first(1 - 2 * (x * x + y * y) < np.cos(_TILT))) is not None:
        tilt = np.rad2deg(np.arccos(np.clip(1 - 2 * (x[k] ** 2 + y[k] ** 2), -1, 1)))
        message = f"the quaternion tilts the robot by {tilt:.0f} degrees: are its columns x, y, z, w in this order?"
        raise table.error(k, message)
    # the direction of the x axis in the plane
    x, y, z, w = quaternions.T
    return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


#: name of the check and sentence of something that is probably a mistake, see `Log.doubts`
Doubt = tuple[str, str]
#: rows of odometry or truth, and sightings of one landmark, that share a time and are a larger part of all are a doubt
_SHARE = 0.01
#: the checks that find odometry with many rows of the time of the row before, and sightings that cover little of it
REPEATED, COVERED = "odometry repeats", "covered"
#: the check that finds landmarks that have moved between logs that were joined
MOVED_BETWEEN = "moved between logs"
#: what the estimate of noise and biases doubts (`RobotEstimate.doubts`)
DOUBTFUL_NOISE = "doubtful noise"
#: the largest range stands for no measurement where, of at least the first number of sightings, at least the second have it,
#: and it is longer than the next one by at least this factor
_ENOUGH, _EQUAL, _BEYOND = 20, 3, 1.2
#: it is the limit of the sensor, reported for all that is farther, where more than this part of the sightings have it, and so
#: many times as many as any other range. In Lost in the Woods 4 % have it: they are 4 cm too long, and the ATE is 2 % smaller
#: without them
_CLIPPED, _OFTEN = 0.05, 5


def repeated_times(
    kind: str, table: Table, ns: np.ndarray, rows: Array, numbers: np.ndarray
) -> tuple[tuple[str, ...], tuple[Doubt, ...]]:
    """Notes and doubts about a table in which one row per time belongs: odometry or truth.

    Args:
        kind: of the table.
        table: for messages.
        ns: times (N,) [ns], not decreasing.
        rows: (N, k).
        numbers: (N,) of the rows in the table.
    """
    same = np.diff(ns) == 0
    if not same.any():
        return (), ()
    count = int(np.sum(same))
    which = f"{_first(table, numbers[1:][same], f'{kind} row')} (of {len(ns)}) with the time"
    if 2 * np.sum(same & np.all(rows[1:] == rows[:-1], axis=1)) > count:
        message = f"{which} and numbers of the row before: the rows were probably written twice, or two files joined"
    else:
        message = (
            f"{which} of the row before and other numbers: the times were probably rounded{_rounded(ns)}, and one row per "
            "time is used"
        )
    return ((), ((f"{kind} repeats", message),)) if count > _SHARE * len(ns) else ((message,), ())


#: the checks that find sightings whose rows are there twice, and other sightings with one time and id
DOUBLED, SHARED = "doubled sightings", "duplicate ids"


def repeated_sightings(
    table: Table, ns: np.ndarray, ids: np.ndarray, rows: Array, numbers: np.ndarray
) -> tuple[Doubt, ...]:
    """Doubts about sightings that are there twice, or are of one landmark at one time; the arguments as above, ids (N,)."""
    order = np.lexsort((numbers, *rows.T[::-1], ids, ns))
    ns, ids, rows, numbers = ns[order], ids[order], rows[order], numbers[order]
    same = (np.diff(ns) == 0) & (np.diff(ids) == 0)
    missing = np.isnan(rows)
    twice = same & np.all((rows[1:] == rows[:-1]) | (missing[1:] & missing[:-1]), axis=1)
    doubts: list[Doubt] = []
    if twice.any():
        which = f"{_first(table, numbers[1:][twice], 'sighting')} (of {len(ns)}) with the time, id and numbers of another row"
        cause = "the rows were probably written twice, or two files joined, and these sightings count twice"
        doubts.append((DOUBLED, f"{which}: {cause}"))
    # a range and a bearing alone may come from two sensors
    alike = np.any(~missing[1:] & ~missing[:-1], axis=1)
    other = same & ~twice & alike & (ids[1:] != UNIDENTIFIED)
    if np.sum(other) > _SHARE * len(ns) and np.ptp(ids) > 0:
        later = np.maximum(numbers[1:], numbers[:-1])[other]
        which = f"{_first(table, later, 'sighting')} (of {len(ns)})"
        which += " with the time and id of another row and other numbers"
        cause = "several objects have one id, ids were misread, or the times were rounded"
        if rounded := _rounded(ns):
            cause = f"the times were probably rounded{rounded}, ids were misread, or several objects have one id"
        doubts.append((SHARED, f"{which}: {cause}"))
    return tuple(doubts)


def _first(table: Table, rows: np.ndarray, what: str) -> str:
    """The place of the first of some rows, and their number in words."""
    number = f"the only {what}" if len(rows) == 1 else f"the first of {len(rows)} {what}s"
    return f"{table.place(int(rows.min()))}: {number}"


def _rounded(ns: np.ndarray) -> str:
    """ " to seconds" where times (N,) [ns] are whole seconds."""
    return " to seconds" if not np.any(ns % 1_000_000_000) else ""


def nothing_measured(ranges: Array) -> Iterator[Doubt]:
    """The largest range (of N), where it repeats exactly and no other range is near: 9999 or 65.535, for example.

    Or where it repeats far more often than others do: a sensor that reports its limit for landmarks beyond it.
    """
    values, counts = np.unique(ranges, return_counts=True)
    enough = len(ranges) >= _ENOUGH and len(values) > 1 and counts[-1] >= _EQUAL
    if enough and values[-1] > _BEYOND * values[-2]:
        message = f"{counts[-1]} sightings have the same range of {values[-1]:g} m, and all others are below"
        cause = "the sensor may report it where it measures nothing. Remove these rows"
        yield "range without measurement", f"{message} {values[-2]:.3g} m; {cause}"
    elif enough and counts[-1] > max(_CLIPPED * len(ranges), _OFTEN * counts[:-1].max()):
        message = f"{counts[-1]} of {len(ranges)} sightings have the same range of {values[-1]:g} m, and none is longer"
        cause = "the sensor may report it for all that is farther away. Remove these rows"
        yield "range limit", f"{message}; {cause}"
