"""Times as whole nanoseconds: seconds since 1970 with nine decimals do not fit into a floating-point number."""

from __future__ import annotations

import re

import numpy as np

from ..errors import LogError, decimals, quoted, shortened
from ..reading import Fault
from .table import Table

#: nanoseconds of each unit
UNITS = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1000, "ns": 1}
#: floating-point numbers hold nanoseconds up to here
_EXACT = 2.0**53
#: whole nanoseconds in 64 bits are below this
_LARGEST = 2.0**63
#: date and time of day as in ISO 8601, with the hours and minutes by which it is ahead of UTC
_DATE = re.compile(r"(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d:\d\d(?:[.,]\d{1,9})?) ?(?:Z|UTC|([+-]\d\d):?(\d\d))?")
#: a single time this far [s] outside those of both neighbours is wrong
STRAY = 10
#: 64 bits hold powers of ten up to here
_LARGEST_POWER = 18


def nanoseconds(table: Table, column: int, unit: str | None) -> np.ndarray:
    """A column of times (N,) as whole nanoseconds.

    Args:
        table: whose column it is.
        column: its number.
        unit: "s", "ms", "us" or "ns"; None: by the size of the numbers, which is certain for times since 1970, else s.

    Dates with the time of day (ISO 8601, "2026-11-22T10:00:00.5Z") are counted from 1970, in UTC where they name no zone.

    Raises:
        LogError: a time is neither a finite number nor a date, or has no place in 64 bits (before 1678 or after 2262).
    """
    if (parts := table.decimals(column)) is not None and (exact := _of_decimals(*parts, unit)) is not None:
        return exact
    try:
        values = table.numbers([column])[:, 0]
    except LogError:
        if (dates := _of_dates(table, column)) is None:
            word = str(table.words(column)[0])
            if not _is_number(word):
                raise table.error(
                    0,
                    f"the time {table.title(column)} should be a number, or a date with the time of day as in "
                    f"2026-11-22T10:00:00.5Z, not {quoted(word)}",
                ) from None
            raise
        return dates
    if (bad := np.flatnonzero(~np.isfinite(values))).size:
        raise table.error(int(bad[0]), f"the time {table.title(column)} is {values[bad[0]]}; every row needs a time")
    factor = UNITS[unit or by_size(values)]
    if (beyond := np.flatnonzero(np.abs(values) >= _LARGEST / factor)).size:
        raise _beyond(table, int(beyond[0]), column)
    if np.all(np.abs(values) * factor < _EXACT):
        return np.rint(values * factor).astype(np.int64)
    words = table.texts(column)
    if words.dtype.kind in "iu":
        return words.astype(np.int64) * factor
    digits = len(str(factor)) - 1
    whole, _, fraction = np.moveaxis(np.char.partition(words, b"."), -1, 0)
    try:
        beneath = np.char.ljust(fraction, digits, b"0").astype(f"S{digits}") if digits else np.full(len(whole), b"0")
        return whole.astype(np.int64) * factor + beneath.astype(np.int64)
    except (ValueError, OverflowError):
        # with exponents
        return np.rint(values * factor).astype(np.int64)


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
            "repair or remove the row",
        ),
    ]  # fmt: skip


def _of_dates(table: Table, column: int) -> np.ndarray | None:
    """Times (N,) of dates; None where the first is none."""
    ns = np.empty(len(table), np.int64)
    for row, word in enumerate(map(str, table.words(column))):
        if (match := _DATE.fullmatch(word)) is None:
            if row == 0:
                return None
            raise table.error(
                row, f"{table.title(column)} should be a date and time as in the rows above, not {quoted(word)}"
            )
        day, clock, hours, minutes = match.groups()
        try:
            whole, _, fraction = clock.replace(",", ".").partition(".")
            # nanoseconds as numpy has them wrap without a word
            moment = int(np.datetime64(f"{day}T{whole}", "s").astype(np.int64)) * UNITS["s"] + int(
                fraction.ljust(9, "0")
            )
        except ValueError as error:
            raise table.error(row, f"{table.title(column)} is no date that exists: {quoted(word)} ({error})") from None
        ahead = 60 * int(hours) + int(hours[0] + minutes) if hours else 0
        moment -= ahead * 60 * UNITS["s"]
        if abs(moment) >= _LARGEST:
            raise _beyond(table, row, column)
        ns[row] = moment
    return ns


def _beyond(table: Table, row: int, column: int) -> LogError:
    """The error of a time that does not fit."""
    word = shortened(str(table.words(column)[row]))
    return table.error(
        row,
        f"the time {table.title(column)} is {word}, but times are whole nanoseconds in 64 bits, from 1678 to 2262: is its "
        "unit stated rightly (s, ms, us or ns)?",
    )


def added(table: Table, column: int, times: np.ndarray, more: np.ndarray | int) -> np.ndarray:
    """Times (N,) plus others [ns].

    Raises:
        LogError: a sum does not fit into 64 bits, or times are so far apart that their difference does not.
    """
    total = times.astype(float) + np.asarray(more, dtype=float)
    if (beyond := np.flatnonzero(np.abs(total) >= _LARGEST)).size:
        raise _beyond(table, int(beyond[0]), column)
    if np.ptp(total) >= _LARGEST:
        raise table.error(int(np.argmax(total)), f"the times {table.title(column)} are more than 292 years apart")
    return times + more


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _of_decimals(whole: np.ndarray, places: np.ndarray, unit: str | None) -> np.ndarray | None:
    """Times (N,) of m / 10^k, rounded to nanoseconds; None where they do not fit into 64 bits."""
    factor = UNITS[unit or by_size(whole / 10.0**places)]
    exponents = len(str(factor)) - 1 - places
    up, down = max(0, int(exponents.max())), max(0, -int(exponents.min()))
    if down > _LARGEST_POWER or np.abs(whole).max() > (2**63 - 1 - 10**down) // 10**up:
        return None
    divisors = 10 ** np.maximum(-exponents, 0)
    return (whole * 10 ** np.maximum(exponents, 0) + divisors // 2) // divisors


def by_size(values: np.ndarray) -> str:
    """The unit of times, where their size excludes all others: no log lasts three thousand years."""
    largest = float(np.max(np.abs(values), initial=0.0))
    for unit, least in (("ns", 1e17), ("us", 1e14), ("ms", 1e11)):
        if largest >= least:
            return unit
    return "s"


def seconds(nanoseconds: np.ndarray, origin: int) -> np.ndarray:
    """Times in seconds after an origin, exact to less than a nanosecond within months."""
    return (nanoseconds - origin) / 1e9
