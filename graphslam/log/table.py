"""`Table`: what every table has, whether its rows are lines of a file, rows of a data frame, or messages of a bag.

`find` recognises what each column is, by the names that people give to columns and the units that stand in the names.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import timedelta
from types import MappingProxyType
from typing import Any

import numpy as np

from ..errors import FormatError, LogError, OptionError, named, quoted
from ..errors.checks import suggestion
from ..se2 import Array


class Table(ABC):
    """Columns with names.

    Attributes:
        source: what messages call the table: a file, or a topic of a bag.
        names: of the columns; empty where the table has none.
        width: the number of columns.
        notes: what the reader changed, one sentence each.
        units: of columns whose type has one, {number of the column: "ns"}, as dates of pandas and NumPy have.
    """

    source: str
    names: tuple[str, ...]
    width: int
    notes: tuple[str, ...] = ()
    units: Mapping[int, str] = MappingProxyType({})

    @abstractmethod
    def __len__(self) -> int:
        """The number of rows."""

    @abstractmethod
    def numbers(self, columns: Sequence[int]) -> Array:
        """Columns (N, k) as floating-point numbers, which may be NaN.

        Raises:
            LogError: a cell is no number; with its place.
        """

    @abstractmethod
    def words(self, column: int) -> np.ndarray:
        """A column (N,) as text, or as whole numbers where the table has these."""

    def texts(self, column: int) -> np.ndarray:
        """A column (N,) as bytes of ASCII, or as whole numbers where the table has these."""
        words = self.words(column)
        return words if words.dtype.kind in "iu" else np.char.encode(words, "ascii", "replace")

    @abstractmethod
    def error(self, row: int | None, message: str) -> LogError:
        """The error of a row, counted from 0, or of the whole table."""

    def place(self, row: int) -> str:
        """The name of a row in notes."""
        return str(self.error(row, "")).rstrip(": ")

    def title(self, column: int) -> str:
        """The name of a column in messages."""
        return quoted(self.names[column]) if self.names else f"column {column + 1}"


class Columns(Table):
    """A table in memory.

    Args:
        source: its name.
        columns: {name: (N,)}; or without names, an array (N, k).
        rows: what messages call its rows.
    """

    def __init__(self, source: str, columns: Mapping[str, Any] | Array, *, rows: str = "row") -> None:
        self.source, self._rows = source, rows
        if isinstance(columns, Mapping):
            self.names = tuple(map(str, columns))
            self._columns = [_column(column) for column in columns.values()]
        else:
            self.names = ()
            self._columns = list(np.asarray(columns).T)
        self.width = len(self._columns)
        self.units = {k: "ns" for k, column in enumerate(self._columns) if _has_nanoseconds(column)}

    def __len__(self) -> int:
        return len(self._columns[0]) if self._columns else 0

    def numbers(self, columns: Sequence[int]) -> Array:
        numbers = np.empty((len(self), len(columns)))
        for k, column in enumerate(columns):
            values = self._columns[column]
            if column in self.units:
                values = np.where(np.isnat(values), np.nan, self.texts(column))
            try:
                if len(values) != len(self):
                    raise ValueError  # NumPy would repeat a single number
                numbers[:, k] = values
            except (TypeError, ValueError, OverflowError):
                for row, value in enumerate(values):
                    try:
                        float(value)
                    except (TypeError, ValueError, OverflowError):
                        message = f"{self.title(column)} should be a number, not {quoted(str(value))}"
                        raise self.error(row, message) from None
                rows = f"; it has {len(values)}, and the first column {len(self)}" if len(values) != len(self) else ""
                message = f"{self.title(column)} should hold one number in each {self._rows}{rows}"
                raise self.error(None, message) from None
        return numbers

    def words(self, column: int) -> np.ndarray:
        values = self._columns[column]
        return values if values.dtype.kind in "iu" else values.astype(str)

    def texts(self, column: int) -> np.ndarray:
        if column not in self.units:
            return super().texts(column)
        values = self._columns[column]
        return values.astype(f"{values.dtype.kind}8[ns]").astype(np.int64)

    def error(self, row: int | None, message: str) -> LogError:
        if row is None:
            return FormatError(self.source, None, message)
        return FormatError(f"{self.source}, {self._rows} {row + 1}", None, message)


def _column(values: Any) -> np.ndarray:
    """A column as an array; durations of Python, which NumPy keeps as objects, as its own; masked numbers as NaN."""
    if isinstance(values, np.ma.MaskedArray) and np.any(values.mask):
        values = np.ma.filled(values.astype(float), np.nan)
    array = np.asarray(values)
    durations = array.dtype.kind == "O" and array.size and all(isinstance(value, timedelta) for value in array.flat)
    return array.astype("timedelta64[us]") if durations else array


def _has_nanoseconds(column: np.ndarray) -> bool:
    """Whether a column has dates or durations of NumPy that whole nanoseconds in 64 bits can hold."""
    if column.dtype.kind not in "mM" or np.datetime_data(column.dtype)[0] not in ("D", "h", "m", "s", "ms", "us", "ns"):
        return False
    seconds = column[~np.isnat(column)].astype(f"{column.dtype.kind}8[s]").astype(np.int64)
    return bool(np.all(np.abs(seconds) < 2**63 // 10**9))


class Kept(Table):
    """Some rows of a table; errors name the rows of the whole.

    Args:
        table: the whole.
        rows: (N,) numbers of the rows that are kept.
        notes: about what is left out.
    """

    def __init__(self, table: Table, rows: np.ndarray, notes: tuple[str, ...]) -> None:
        self.source, self.names, self.width = table.source, table.names, table.width
        self.notes, self.units = (*table.notes, *notes), table.units
        self._table, self._rows = table, rows

    def __len__(self) -> int:
        return len(self._rows)

    def numbers(self, columns: Sequence[int]) -> Array:
        return self._table.numbers(columns)[self._rows]

    def words(self, column: int) -> np.ndarray:
        return self._table.words(column)[self._rows]

    def texts(self, column: int) -> np.ndarray:
        return self._table.texts(column)[self._rows]

    def error(self, row: int | None, message: str) -> LogError:
        return self._table.error(None if row is None else int(self._rows[row]), message)


#: the columns of the noise of relations and positions: standard deviations, or covariances, in products of the stated
#: units, else [m², m rad, rad²]
DEVIATIONS = ("sigma_x", "sigma_y", "sigma_theta")
COVARIANCES = ("cov_xx", "cov_xy", "cov_xtheta", "cov_yy", "cov_ytheta", "cov_thetatheta")


def _words(text: str) -> tuple[str, ...]:
    """The words of a text."""
    return tuple(text.split())


_NAMES = {
    "t": "t time timestamp stamp ts seconds secs sec header_stamp times timestamps datetime date_time date",
    "date": "date day",
    "nanosec": "nanosec nanosecs nsec nsecs nanoseconds usec usecs microseconds msec msecs milliseconds",
    "nu": (
        "nu v vel velocity speed linear_x linear_velocity forward_velocity forward_speed lin_vel linear vx v_x "
        "v_lin translational_velocity linear_velocity_x"
    ),
    "vy": "vy v_y linear_y lateral_velocity lateral_speed velocity_y speed_y sideways_velocity v_lat",
    "omega": (
        "omega w om angular_z angular_velocity yaw_rate yawrate turn_rate ang_vel angular wz w_z gyro_z v_ang "
        "rotational_velocity omega_z theta_dot yaw_dot angular_velocity_z"
    ),
    "x": "x pos_x px position_x tx rel_x translation_x",
    "y": "y pos_y py position_y ty rel_y translation_y",
    "z": "z pos_z pz position_z tz rel_z translation_z",
    "theta": "theta heading yaw th angle orientation phi",
    "qx": "qx q_x orientation_x rotation_x",
    "qy": "qy q_y orientation_y rotation_y",
    "qz": "qz q_z orientation_z rotation_z",
    "qw": "qw q_w orientation_w rotation_w",
    "id": (
        "id landmark landmark_id lm lm_id tag tag_id marker marker_id beacon beacon_id fiducial_id feature "
        "feature_id barcode label class_id target target_id subject ident number name landmarkid tagid markerid"
    ),
    "class": "class class_name class_label colour color colour_name color_name category class_id kind type",
    "range": "range r distance dist rho l d ranges",
    "bearing": "bearing b phi azimuth angle bearings bearing_angle theta beta",
    "orientation": "orientation psi orient",
    "t1": "t1 time1 t_1 time_1 t_from from_time t_a stamp1",
    "t2": "t2 time2 t_2 time_2 t_to to_time t_b stamp2",
    "dx": "dx delta_x d_x x",
    "dy": "dy delta_y d_y y",
    "dtheta": "dtheta delta_theta d_theta dyaw dheading theta yaw",
    "sigma": "sigma std accuracy horizontal_accuracy hacc sigma_xy std_xy",
    "sigma_x": "sigma_x std_x stddev_x sx x_std sigma_dx",
    "sigma_y": "sigma_y std_y stddev_y sy y_std sigma_dy",
    "sigma_theta": "sigma_theta std_theta sigma_yaw std_yaw theta_std yaw_std sigma_dtheta",
    "cov_xx": "cov_xx cxx var_x c11",
    "cov_xy": "cov_xy cxy c12",
    "cov_xtheta": "cov_xtheta cov_xt cxt cov_x_theta cov_xyaw c13",
    "cov_yy": "cov_yy cyy var_y c22",
    "cov_ytheta": "cov_ytheta cov_yt cyt cov_y_theta cov_yyaw c23",
    "cov_thetatheta": "cov_thetatheta cov_tt ctt var_theta cov_theta_theta var_yaw c33",
    "latitude": "latitude lat",
    "longitude": "longitude lon lng long",
    "altitude": "altitude alt",
    "lever_x": "lever_x lever_ahead antenna_x offset_x",
    "lever_y": "lever_y lever_left antenna_y offset_y",
}
#: what a column can be -> the names it has in other people's tables, after `plain`
NAMES: dict[str, tuple[str, ...]] = {role: _words(names) for role, names in _NAMES.items()}
#: numbers that are neither a place nor a speed ahead
_OTHER_NAMES = _words(
    "angular_x angular_y angular_velocity_x angular_velocity_y gyro_x gyro_y acceleration_x acceleration_y accel_x accel_y "
    "acc_x acc_y"
)
_KNOWN = {name for names in NAMES.values() for name in names}
#: names too short or too general to be recognised at the end of a longer one
WHOLE = _words("v w r l d b kind type std sx sy t1 t2 lat lon lng long")
_UNITS = {
    "s": "s sec secs seconds",
    "ms": "ms msec msecs millis milliseconds",
    "us": "us µs μs usec usecs micros microseconds",
    "ns": "ns nanos nanoseconds",
    "m": "m meter meters metre metres m/s m/sec mps",
    "cm": "cm centimeter centimeters centimetre centimetres cm/s",
    "mm": "mm millimeter millimeters millimetre millimetres mm/s",
    "radians": "rad radian radians rad/s rad/sec radians/s rads",
    "degrees": "deg degs degree degrees deg/s deg/sec degrees/s dps ° °/s",
}
#: units at the end of the name of a column -> the unit
UNITS = {name: unit for unit, names in _UNITS.items() for name in _words(names)}
#: units in brackets that are not converted: a column with one of them would be read by a wrong factor
OTHER_UNITS = frozenset(
    _words(
        "km dm ft feet foot in inch inches yd mi miles km/h kmh kph ft/s mph kn kt knots min minutes h hours days rpm rev/s "
        "deg/min deg/h rad/min m/min mm/min cm/min µm μm hz mrad mrad/s gon grad arcmin arcsec d day days rev/min 1/min "
        "px pixel pixels tick ticks ticks/s count counts counts/s"
    )
)
#: units at the end of a name; range_min and x_in are rather a minimum and an input
_ENDS = UNITS | {unit: unit for unit in OTHER_UNITS.difference(_words("in min mi h hz kn kt grad foot d day px count"))}
#: what is per second
RATES = ("nu", "vy", "omega")
#: what each column measures, a key of `rows.UNITS_OF`
MEASURES = {
    **dict.fromkeys(("t", "t1", "t2"), "time"),
    **dict.fromkeys(_words("nu vy x y z range dx dy sigma sigma_x sigma_y altitude lever_x lever_y"), "lengths"),
    **dict.fromkeys(_words("omega theta bearing orientation dtheta sigma_theta"), "angles"),
}


@dataclass(frozen=True)
class Chosen:
    """A column of a table that is used: its number, and the unit that its name states, if any."""

    column: int
    unit: str | None = None


def plain(name: str) -> tuple[str, str | None]:
    """A column's name in small letters and underscores, without its unit; and the unit, one of `OTHER_UNITS` as it stands."""
    name, unit = name.strip().strip("\"'#").strip(), None
    if match := re.search(r"[\[(]\s*([^\])]*?)\.?\s*[\])]\s*$", name):
        # per second may be "s^-1"
        stated, name = re.sub(r"\s+(s|h|min)\s*\^?[-−]1$", r"/\1", match[1].lower()), name[: match.start()]
        unit = UNITS.get(stated, stated if stated in OTHER_UNITS else None)
    # "sensorId" and "yawRate" are two words, and "timeStamp" and "nSec" are names as they stand
    if name.strip().lower() not in _KNOWN:
        name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name)
    name = name.lower()
    words = [word for word in re.split(r"[^0-9a-z°%µμ]+", name.replace("%", "")) if word]
    if words[-2:] == ["km", "h"]:
        words[-2:] = ["kmh"]
    if len(words) > 1 and unit is None and words[-1] in _ENDS:
        # "v_m_s" and "omega_rad_s" end in two words
        if words[-1] == "s" and len(words) > 2 and UNITS.get(words[-2]) in ("m", "mm", "cm", "radians", "degrees"):
            words, unit = words[:-2], UNITS[words[-2]]
        else:
            words, unit = words[:-1], _ENDS[words[-1]]
    return "_".join(words), unit


def part_unit(table: Table, column: int) -> str:
    """The unit of a column of parts of a second, beside one of seconds: that which its name is, else ns."""
    return UNITS.get(plain(table.names[column])[0], "ns") if table.names else "ns"


def find(
    kind: str, table: Table, roles: Sequence[str], stated: Mapping[str, str | int], orders: Mapping[int, Sequence[str]],
    dispensable: Collection[str] = (),
) -> dict[str, Chosen]:  # fmt: skip
    """The columns of a table, by role.

    Args:
        kind: what the table holds, "odometry" for example, for messages.
        table: the table.
        roles: what its columns can be, keys of `NAMES`; of two roles that a name fits, the first takes it.
        stated: {role: name or number of its column, from 1}, what the user says.
        orders: for tables without names: the roles of the columns by their number.
        dispensable: roles that are left out where a name fits two columns.

    Raises:
        LogError: a stated column does not exist, or a name fits two columns.
        OptionError: there is no such role.
    """
    found: dict[str, Chosen] = {}
    for role, column in stated.items():
        if role not in roles:
            known = ", ".join(roles)
            raise OptionError(f"columns: there is no {quoted(role)} in the table of {kind}; its columns can be {known}")
        found[role] = _stated(table, role, column)
    if not table.names:
        order = orders.get(table.width, ()) if not stated else ()
        return found | {role: Chosen(k) for k, role in enumerate(order) if role}
    taken = {chosen.column for chosen in found.values()}
    names = [plain(name) for name in table.names]
    other = {k for k, (_, unit) in enumerate(names) if unit in OTHER_UNITS}
    # beside a column whose unit is converted, one of another unit is left alone, whatever it is called
    for tail, left_alone in ((False, other), (True, other), (False, set[int]()), (True, set[int]())):
        for role in roles:
            if role in found:
                continue
            others = [*_OTHER_NAMES, *(each for other, names_of in NAMES.items() if other != role for each in names_of)]
            for name in NAMES[role]:
                # orientation_x is no x
                longer = tuple(f"_{each}" for each in others if each.endswith(f"_{name}"))
                fits = [
                    k
                    for k, (own, _) in enumerate(names)
                    if k not in taken | left_alone
                    and (own == name or (tail and name not in WHOLE and own.endswith(f"_{name}")))
                    and not f"_{own}".endswith(longer)
                ]
                if len(fits) > 1 and role in dispensable:
                    break
                if len(fits) > 1:
                    titles = " and ".join(table.title(k) for k in fits[:2])
                    which = f"say which: columns='{kind}.{role}=NAME'"
                    if table.names[fits[0]] == table.names[fits[1]]:
                        which = f"say which by its number: columns='{kind}.{role}={fits[0] + 1}'"
                    if role == "nu" and {"left", "right"} <= {word for k in fits for word in names[k][0].split("_")}:
                        which = (
                            "are they of two wheels? Make nu = (right + left) / 2 and omega = (right - left) / track"
                        )
                    raise table.error(None, f"{titles} could both be {role}; {which}")
                if fits:
                    found[role] = Chosen(fits[0], names[fits[0]][1])
                    taken.add(fits[0])
                    break
    return found


def _stated(table: Table, role: str, column: str | int) -> Chosen:
    if isinstance(column, int) or (column.isdigit() and column not in table.names):
        number = int(str(column)[:9])  # nobody has that many columns
        if not 1 <= number <= table.width:
            raise table.error(None, f"{role} should be column {number}, but there are columns 1 to {table.width}")
        return Chosen(number - 1, plain(table.names[number - 1])[1] if table.names else None)
    if column not in table.names:
        known = f"its columns are {named(table.names)}" if table.names else "its columns have no names: give numbers"
        message = f"there is no column {quoted(column)} for {role}{suggestion(column, table.names) or f'; {known}'}"
        raise table.error(None, message)
    first, *others = (k for k, name in enumerate(table.names, start=1) if name == column)
    if others:
        message = (
            f"columns {first} and {others[0]} are both called {quoted(column)}; for {role} state the number of one"
        )
        raise table.error(None, message)
    return Chosen(first - 1, plain(column)[1])


#: times that were gone through twice have more than this many times the usual number of rows
TWICE = 1.5


def ordered(
    table: Table, ns: np.ndarray, rows: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray | slice, tuple[str, ...]]:
    """The times in order, their order, and notes; ``rows`` are the rows of the table, where it has others, too.

    Raises:
        LogError: the clock starts again within the table, or its rows are in another order.
    """
    back = np.diff(ns) < 0
    if not back.any():
        return ns, slice(None), ()
    rows = np.arange(len(ns)) if rows is None else rows
    k = int(np.argmax(back))
    times = f"{ns[k + 1] / 1e9:.3f} s comes after {ns[k] / 1e9:.3f} s"
    reached = np.maximum.accumulate(ns)
    restarts = (reached - ns > 0.5 * (reached - ns[0])) & (reached - ns > 10_000_000_000)
    jumps = np.flatnonzero(np.diff(ns) < -1_000_000_000) + 1
    if restarts.any() or _set_back(ns, jumps):
        k = int(np.argmax(restarts)) if restarts.any() else int(jumps[0])
        cause = "does the table hold two drives, or a clock that was set? Import each part alone"
        how = f"by {(reached[k] - ns[k]) / 1e9:.3g} s: {cause}"
        if (count := np.count_nonzero(back)) > 2:
            cause = "sort the rows by their time if they are of one drive, or import each drive alone"
            how = f"{count} times: {cause}"
        raise table.error(int(rows[k]), f"the time goes back {how}")
    note = f"{table.place(int(rows[k + 1]))}: time runs backwards ({times}); the rows were sorted"
    order = np.argsort(ns, kind="stable")
    return ns[order], order, (note,)


def _set_back(ns: np.ndarray, jumps: np.ndarray) -> bool:
    """Whether times (N,) go back once or twice, at the rows ``jumps``, and then run again through times that there were.

    Where a clock was set, these times have twice as many rows as others (rows of one time count once). Rows that came late,
    all of them or those of one of several sensors, were missing there before. A block that fills a gap does not run in turns
    with the rows before it.
    """
    part = np.searchsorted(jumps, np.argsort(ns, kind="stable"), side="right")
    if not 0 < len(jumps) <= 2 or np.count_nonzero(np.diff(part)) <= 10:
        return False
    scans, reached = ns[np.diff(ns, prepend=ns[0] - 1) != 0], np.maximum.accumulate(ns)
    for k in jumps.tolist():
        lasting = reached[k] - ns[k]
        again = np.count_nonzero((scans >= ns[k]) & (scans <= reached[k]))
        usual = (len(scans) - again) / max(np.ptp(ns) - lasting, 1)
        if again > TWICE * usual * lasting:
            return True
    return False
