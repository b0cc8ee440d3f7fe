"""How the rows of a data set are read: the options of `graphslam.load`, and which rows are sound.

`ReadOptions` depend on the kind of data set. `TableOptions` are what the numbers of tables and bags do not determine: units,
clocks, columns and axes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import LogError, OptionError, quoted
from ..errors.checks import check_choice, check_options, checked_offset, declared_in, option, suggestion

#: the id of a landmark that the sensor could not identify
UNIDENTIFIED = -(2**63)
#: what many programs write where a landmark was not identified; logs and tables take it for `UNIDENTIFIED`
NO_ID = -1
#: the class of a sighting whose class is not known, where classes are words; `UNIDENTIFIED` where they are numbers
NO_CLASS = ""
#: the most classes that sightings may have: more are no kinds of landmarks
MOST_CLASSES = 100
#: impossible rows are left out up to this share of all; a table with more of them is refused
MOST_LEFT_OUT = 0.05
#: the most poses that ``keep_every`` may make: a tenth of a second of a whole day
MOST_POSES = 1_000_000


def robot_class(number: int) -> str:
    """The class of a sighting of a robot."""
    return f"robot {number}"


@dataclass(frozen=True, kw_only=True)
class ReadOptions:
    """Options of `load`.

    Raises:
        OptionError: an option has an impossible value.
    """

    robot: int | None = option(None, "The robot of a data set that has several.", minimum=0)
    keep_every: float | None = option(
        None, "Also keep a pose at least once in this time, even where nothing was seen.", "s", positive=True,
        default_text="poses only where something was seen",
    )  # fmt: skip
    strict: bool = option(
        False,
        "Refuse a log at the first row that cannot be, such as a negative range, instead of leaving such rows out.",
    )

    def __post_init__(self) -> None:
        check_options(self)


def without_no_id(ids: np.ndarray, noun: str) -> tuple[str, ...]:
    """Replace the ids `NO_ID` of an array by `UNIDENTIFIED`; a note on them, which calls the rows a ``noun``."""
    none = ids == NO_ID
    if not (count := np.count_nonzero(none)):
        return ()
    ids[none] = UNIDENTIFIED
    return (f"{count:,} of {len(ids):,} {noun}{' has' if count == 1 else 's have'} the id -1, taken as no id",)


@dataclass(frozen=True)
class Fault:
    """Rows of a table that cannot be.

    Attributes:
        rows: (N,) bool.
        what: what they have, for the note: "a negative range".
        message: the sentence about one row, for the error.
    """

    rows: np.ndarray
    what: str
    message: Callable[[int], str]


def sound_rows(
    total: int,
    noun: str,
    faults: Sequence[Fault],
    error: Callable[[int, str], LogError],
    *,
    strict: bool = False,
    source: str = "",
) -> tuple[np.ndarray, tuple[str, ...]]:
    """The rows (N,) bool of a table that can be, and notes on those that are left out.

    Args:
        total: N.
        noun: what the rows are, "sightings".
        faults: what is wrong; a row with several counts for the first.
        error: the error of a row.
        strict: refuse the first such row.
        source: what notes call the table.

    Raises:
        LogError: a row is wrong and ``strict`` is set, or more than `MOST_LEFT_OUT` of all are.
    """
    kept = np.ones(total, dtype=bool)
    notes = []
    for fault in faults:
        new = fault.rows & kept
        if not (count := int(np.count_nonzero(new))):
            continue
        first = int(np.argmax(new))
        share = f"{count:,} of {total:,} {noun} {'has' if count == 1 else 'have'} {fault.what}"
        if strict or total - np.count_nonzero(kept & ~new) > MOST_LEFT_OUT * total:
            also = f"; {share}" if count > 1 else ""
            raise error(first, fault.message(first) + also)
        kept &= ~new
        line = getattr(error(first, ""), "line", None)
        place = f"row {first + 1}" if line is None else f"line {line}"
        place = place if count == 1 else f"the first in {place}"
        notes.append(f"{source}: {share}: left out ({place})" if source else f"{share}: left out ({place})")
    return kept, tuple(notes)


def finite_fault(values: np.ndarray, title: str, advice: str = "; remove the row, or repair it") -> Fault:
    """The rows in which a column (N,) is no finite number."""
    return Fault(
        ~np.isfinite(values),
        f"{title} empty, NaN or infinite",
        lambda k: f"{title} is {'empty or NaN' if np.isnan(values[k]) else values[k]}{advice}",
    )


def range_faults(ranges: np.ndarray, bearings: np.ndarray | None = None) -> list[Fault]:
    """The rows whose range (N,) [m] is negative, or zero.

    They may be bearings where what stands for the ``bearings`` (N,) is never negative. One negative number is what some
    sensors give that see nothing.
    """

    def fault(wrong: np.ndarray, what: str, cause: str) -> Fault:
        return Fault(wrong, what, lambda k: f"the range is {ranges[k]:g} m, but a range is above zero: {cause}")

    swapped = bearings is not None and not np.any(bearings < 0) and len(np.unique(ranges[ranges < 0])) > 1
    nothing = "remove rows in which nothing was seen"
    cause = "are range and bearing swapped?" if swapped else f"{nothing}, or repair them"
    return [fault(ranges < 0, "a negative range", cause), fault(ranges == 0, "a range of 0", nothing)]


def sound_sightings(
    sightings: np.ndarray, error: Callable[[int, str], LogError], *, strict: bool
) -> tuple[np.ndarray, tuple[str, ...]]:
    """`sound_rows` of sightings (N, 2 or 3)."""
    faults = range_faults(*sightings[:, :2].T)
    faults += [finite_fault(*column, "") for column in zip(sightings.T, ("range", "bearing", "orientation"))]
    return sound_rows(len(sightings), "sightings", faults, error, strict=strict)


def fix_faults(columns: Mapping[str, np.ndarray]) -> list[Fault]:
    """The rows whose latitude and longitude (N,), if columns have these, are both 0: what receivers give without a fix."""
    if not {"latitude", "longitude"} <= columns.keys():
        return []
    zero = (columns["latitude"] == 0) & (columns["longitude"] == 0)
    message = "latitude and longitude are 0, as of a receiver without a fix: remove such rows"
    return [Fault(zero, "latitude and longitude 0, as of a receiver without a fix", lambda _: message)]


#: a single value is wrong beyond this many times the usual largest one, where no other is above twice that
_SPIKE, _USUAL = 10.0, 2.0


def spike_faults(values: np.ndarray, title: str, role: str) -> list[Fault]:
    """The rows in which a speed or turn rate (N,) is far beyond all others, alone: an encoder that miscounted."""
    sizes = np.abs(values)
    known = sizes[np.isfinite(sizes)]
    usual = float(np.quantile(known, 0.99)) if len(known) else 0.0
    far = sizes > _SPIKE * usual
    neighbours = np.append(far[1:], False) | np.append(False, far[:-1])
    if (
        role not in ("nu", "omega")
        or usual == 0
        or np.any(far & neighbours)
        or np.any((known > _USUAL * usual) & (known <= _SPIKE * usual))
    ):
        return []
    return [
        Fault(
            far, f"a value of {title} that is far beyond all others",
            lambda k: f"{title} is {values[k]:g}, and those of other rows are at most about {usual:.2g}: repair or remove "
            "the row",
        )
    ]  # fmt: skip


#: the tables of a drive, and what each holds
TABLES = {
    "odometry": "the motion of the robot",
    "sightings": "the measured landmarks",
    "truth": "the true poses",
    "map": "the true landmarks",
    "relations": "the measured relations between two poses",
    "positions": "the measured absolute positions",
}
#: metres and radians of each unit
_LENGTHS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_ANGLES = {"radians": 1.0, "degrees": math.pi / 180}
SIZES = _LENGTHS | _ANGLES
#: what columns measure, by the name of the option that states their unit: the units, that of a log first
UNITS_OF = {"time": ("s", "ms", "us", "ns"), "angles": tuple(_ANGLES), "lengths": tuple(_LENGTHS)}
#: from the axes of a sensor to forward, left, up
AXES = {
    "forward-left": np.eye(3),
    "forward-right": np.diag([1.0, -1.0, -1.0]),
    "right-forward": np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
    "left-forward": np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]),
    "optical": np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]),
}
#: the most that a clock is set forward or back, 146 years: nanoseconds and their sums fit into 64 bits
_MOST_SECONDS = 2**62 / 1e9
_PER_TABLE = "; one for all tables, or for each: odometry=..,sightings=.."


@dataclass(frozen=True, kw_only=True)
class TableOptions:
    """The options of the reader of tables and bags. In Python options for single tables are mappings, too.

    Raises:
        OptionError: an option has an impossible value.
    """

    time: str | None = option(
        None, "Unit of the times, s, ms, us or ns" + _PER_TABLE, metavar="UNIT",
        default_text="as the names of the columns say, else s; times since 1970 by their size",
    )  # fmt: skip
    angles: str | None = option(
        None, "Unit of all angles and turn rates, radians or degrees" + _PER_TABLE, metavar="UNIT",
        default_text="as the names of the columns say, else radians",
    )  # fmt: skip
    lengths: str | None = option(
        None, "Unit of all lengths and speeds, m, cm or mm" + _PER_TABLE, metavar="UNIT",
        default_text="as the names of the columns say, else m",
    )  # fmt: skip
    columns: str | None = option(
        None, "Which column is what, by name or by number from 1, such as odometry.nu=speed or sightings.range=4",
        metavar="TABLE.WHAT=COLUMN,...", default_text="by common names",
    )  # fmt: skip
    clocks: str | None = option(
        None, "Seconds to add to the times of a table, where clocks differ: sightings=0.12,truth=-3",
        metavar="TABLE=SECONDS,...",
    )  # fmt: skip
    axes: str | None = option(
        None, "Directions of x and y of Cartesian sightings; optical is x right, z forward", choices=tuple(AXES),
        default_text="forward-left; where there is a z, they must be stated",
    )  # fmt: skip
    centre: str = option(
        "sensor", "Where range and bearing, or x and y, of sightings are measured from", choices=("sensor", "robot")
    )
    bearings: str = option(
        "counterclockwise", "Direction in which bearings and orientations grow",
        choices=("counterclockwise", "clockwise"),
    )  # fmt: skip
    sensor_offset: tuple[float, float] | None = option(
        None, "Position of the sensor on the robot: forward, left", "m", default_text="0,0, or as the bag says",
        metavar="FORWARD,LEFT",
    )  # fmt: skip
    truth_offset: tuple[float, float] | None = option(
        None, "Point of the robot that the truth is of, such as a GPS antenna: forward, left", "m", default_text="0,0",
        metavar="FORWARD,LEFT",
    )  # fmt: skip
    sensor_yaw: float | None = option(
        None, "Direction in which the sensor looks, 0 is forward, positive to the left", "rad",
        default_text="0, or as the bag says",
    )  # fmt: skip
    strict: bool = option(
        False,
        "Refuse a table at the first row that cannot be, such as a negative range, instead of leaving such rows out",
    )

    def __post_init__(self) -> None:
        for name, choices in UNITS_OF.items():
            for unit in self.by_table(name).values():
                check_choice(name, unit, choices)
        for name in ("sensor_offset", "truth_offset"):
            if (offset := getattr(self, name)) is not None:
                object.__setattr__(self, name, checked_offset(name, offset))
        for name in ("axes", "centre", "bearings", "sensor_yaw", "strict"):
            declared_in(TableOptions)[name].checked(getattr(self, name))
        for table in TABLES:
            self.clock(table)
        self._columns()

    def unit(self, name: str, table: str) -> str | None:
        """The unit that is stated for a table, "time", "angles" or "lengths"; None where none is."""
        stated = self.by_table(name)
        return stated.get(table) or stated.get("")

    def clock(self, table: str) -> int:
        """Nanoseconds to add to the times of a table."""
        value = self.by_table("clocks").get(table, 0.0)
        try:
            seconds = float(value)
        except OverflowError:
            seconds = math.inf
        except (TypeError, ValueError):
            seconds = math.nan
        if math.isnan(seconds):
            raise OptionError(f"clocks: {table} should be a number of seconds, not {quoted(value)}")
        if abs(seconds) > _MOST_SECONDS:
            raise OptionError(
                f"clocks: {table} should be at most {_MOST_SECONDS:.2g} seconds (146 years) forward or back, "
                f"not {quoted(value)}"
            )
        return round(seconds * 1e9)

    def columns_of(self, table: str) -> Mapping[str, str | int]:
        """The stated columns of a table, {role: name or number}."""
        return self._columns().get(table, {})

    def by_table(self, name: str) -> dict[str, Any]:
        """The option "time", "angles", "lengths" or "clocks" as {table: value}; "" stands for all tables."""
        value: Any = getattr(self, name)
        entries = {"": value} if isinstance(value, str) and "=" not in value else _entries(name, value)
        for table in entries:
            check_table(name, table, ("", *TABLES) if name != "clocks" else TABLES)
        return entries

    def _columns(self) -> dict[str, dict[str, str | int]]:
        entries: dict[str, dict[str, str | int]] = {}
        for key, value in _entries("columns", self.columns).items():
            table, dot, role = key.partition(".") if isinstance(self.columns, str) else (key, "", "")
            if dot:
                entries.setdefault(table, {})[role] = value
            elif isinstance(value, Mapping):
                entries[table] = dict(value)
            elif isinstance(self.columns, str):
                raise OptionError(f"columns: {quoted(key)} should name a table, too, such as odometry.{key}={value}")
            else:
                raise OptionError(f"columns: {quoted(key)} should be a mapping {{what: column}}, not {quoted(value)}")
        for table, columns in entries.items():
            check_table("columns", table, TABLES)
            for role, column in columns.items():
                if type(column) not in (str, int):
                    message = f"columns: {table}.{role} should be a name or a number from 1, not {quoted(column)}"
                    raise OptionError(message)
        return entries


def check_table(option: str, table: str, known: Collection[str] = tuple(TABLES)) -> None:
    """Raise `OptionError` unless a table has this name."""
    if table not in known:
        hint = suggestion(table, TABLES) or f"; they are {', '.join(TABLES)}"
        raise OptionError(f"{option}: there is no table {quoted(table)}{hint}")


def _entries(option: str, value: Any) -> dict[str, Any]:
    """{"a": "1", "b": "2"} of "a=1,b=2", or a copy of a mapping; empty for None."""
    if isinstance(value, Mapping):
        return dict(value)
    if not isinstance(value, str | None):
        raise OptionError(f"{option} must be text or a mapping, not {quoted(value)}")
    entries = {}
    for part in filter(None, (part.strip() for part in (value or "").split(","))):
        key, equals, text = part.partition("=")
        if not equals or not text.strip():
            raise OptionError(f"{option}: {quoted(part)} should be NAME=VALUE")
        entries[key.strip()] = text.strip()
    return entries
