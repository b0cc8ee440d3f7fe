"""The streams of one drive from its tables: columns, units, clocks and their checks.

A check refuses what is almost certainly a mistake, in one sentence with the place and the likely cause. Whoever states
the unit silences the check of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from ..errors import LogError, named
from ..errors.checks import FARTHEST, FASTEST, FOUR_TURNS, QUICKEST, WHOLE_TURN, first
from ..se2 import Array, wrap
from . import cells, geometry
from .rows import (
    AXES,
    MOST_LEFT_OUT,
    SIZES,
    UNIDENTIFIED,
    UNITS_OF,
    Fault,
    TableOptions,
    finite_fault,
    fix_faults,
    range_faults,
    sound_rows,
    spike_faults,
)  # fmt: skip
from .table import COVARIANCES, DEVIATIONS, MEASURES, NAMES, OTHER_UNITS, RATES, Kept, Table, find, ordered, part_unit

TURNED = "the heading is {:g} rad: does it count many turns, or is it in degrees?"
_POSE = ("x", "y", "theta", "qx", "qy", "qz", "qw")
ROLES = {
    "odometry": ("t", "date", "nanosec", "nu", "vy", "omega", *_POSE),
    "sightings": ("t", "date", "nanosec", "id", "class", "range", "bearing", "orientation", "x", "y", "z"),
    "truth": ("t", "date", "nanosec", *_POSE),
    "map": ("id", "x", "y", "theta"),
    "relations": ("t1", "t2", "dx", "dy", "dtheta", *DEVIATIONS, *COVARIANCES),
    "positions": (
        *("t", "date", "nanosec", "x", "y", "theta", "latitude", "longitude", "altitude"),
        *("sigma", *DEVIATIONS, *COVARIANCES, "lever_x", "lever_y"),
    ),
}
_TUM = ("t", "x", "y", "", "qx", "qy", "qz", "qw")
#: columns of tables without names, by their number
ORDERS: dict[str, dict[int, tuple[str, ...]]] = {
    "odometry": {3: ("t", "nu", "omega"), 4: ("t", "x", "y", "theta"), 8: _TUM},
    "sightings": {4: ("t", "id", "range", "bearing"), 5: ("t", "id", "range", "bearing", "orientation")},
    "truth": {3: ("t", "x", "y"), 4: ("t", "x", "y", "theta"), 8: _TUM},
    "map": {3: ("id", "x", "y"), 4: ("id", "x", "y", "theta")},
    "relations": {8: ("t1", "t2", "dx", "dy", "dtheta", *DEVIATIONS)},
    "positions": {4: ("t", "x", "y", "sigma")},
}


@dataclass(frozen=True)
class Timed:
    """A table that has been read: times (N,) in nanoseconds, not decreasing, and rows (N, k); of sightings ids and classes.

    ``names`` are the ids of landmarks that have names, {name: id}.
    ``ends`` (N,), of relations, are the times of their second poses.
    ``columns`` says which column was taken for what, and in which unit; ``notes`` and ``doubts`` are those of a `Log`.
    """

    table: Table
    times: np.ndarray
    rows: Array
    columns: tuple[str, ...]
    ids: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    notes: tuple[str, ...] = ()
    doubts: tuple[cells.Doubt, ...] = ()
    classes: np.ndarray | None = None
    names: Mapping[str, int] = field(default_factory=dict)
    ends: np.ndarray | None = None


class Reader:
    """The columns of one table, in metres, radians and nanoseconds."""

    def __init__(self, kind: str, table: Table, options: TableOptions) -> None:
        self.kind, self.table, self.options = kind, table, options
        self.used: dict[str, None] = {}
        # receivers may tell several heights
        self.found = find(kind, table, ROLES[kind], options.columns_of(kind), ORDERS[kind], ("altitude",))
        if len(table) == 0:
            raise table.error(None, f"there is no row of {kind} in it")
        for role, chosen in self.found.items():
            if chosen.column in table.units and MEASURES.get(role, "time") != "time":
                message = f"{table.title(chosen.column)} holds dates or durations, but {role} is a number: convert it"
                raise table.error(None, f"{message}, or state another column: columns='{kind}.{role}=NAME'")

    def has(self, *roles: str) -> bool:
        return all(role in self.found for role in roles)

    def need(self, *roles: str, instead: str = "") -> None:
        """Raise an error that lists the columns unless these are there."""
        if missing := [role for role in roles if role not in self.found]:
            raise self.table.error(None, self.missing(*dict.fromkeys(missing), consequence=instead))
        self.used |= dict.fromkeys(roles)

    def missing(self, *roles: str, consequence: str = "") -> str:
        """The sentence about columns that are not there, with those that are."""
        have = named(self.table.names) if self.table.names else f"{self.table.width} columns without names"
        names = (" or ".join(dict.fromkeys((role, *NAMES[role][:3]))) for role in roles)
        named_so = " and none for ".join(f"{role} (named {each}, ...)" for role, each in zip(roles, names))
        state = f"columns='{','.join(f'{self.kind}.{role}=NAME' for role in roles)}'"
        which = f"Say which it is: {state}" if len(roles) == 1 else f"Say which they are: {state}"
        if roles == ("id",):
            # many sensors have no ids, so that only a column without another use is asked about
            if not self.unused:
                return f"no column for {named_so}{consequence}"
            which = f"If one has the ids, say which: {state}"
        return f"no column for {named_so}{consequence}; it has {have}. {which}"

    @property
    def unused(self) -> list[str]:
        """The names of the columns that have no role."""
        taken = {chosen.column for chosen in self.found.values()}
        return [name for column, name in enumerate(self.table.names) if name and column not in taken]

    def described(self) -> tuple[str, ...]:
        """The columns that were used, "range = 'dist' [m]"."""
        parts = []
        for role in self.used:
            chosen, unit = self.found[role], ""
            if role in MEASURES:
                unit = self._unit(role) or UNITS_OF[MEASURES[role]][0]
                unit += "/s" if role in RATES else ""
            name = self.table.names[chosen.column] if self.table.names else f"column {chosen.column + 1}"
            parts.append((role if name == role else f"{role} = {name}") + (f" [{unit}]" if unit else ""))
        return tuple(parts)

    def stated(self, role: str) -> bool:
        """Whether the unit of a column is known from the options or its name."""
        return self._unit(role) is not None

    def _unit(self, role: str) -> str | None:
        """The unit of a column: that of its type, else the stated one, else that of its name where it is one of this measure.

        Raises:
            LogError: the name has a unit that is not converted, and none is stated.
        """
        measure, named = MEASURES[role], self.found[role].unit
        if measure == "time" and (typed := self.table.units.get(self.found[role].column)) is not None:
            return typed
        if (stated := self.options.unit(measure, self.kind)) is not None:
            return stated
        if named in OTHER_UNITS:
            own, per = UNITS_OF[measure], "/s" if role in RATES else ""
            column, units = self.table.names[self.found[role].column], ", ".join(unit + per for unit in own)
            advice = f"Convert it; if its numbers are in {own[0]}{per} after all, add {measure}='{self.kind}={own[0]}'"
            message = f"the column {column} is in {named}, which is not converted: units are {units}. {advice}"
            raise self.table.error(None, message)
        return named if named in UNITS_OF[measure] else None

    def leave_out(self, *roles: str) -> Table:
        """The table without the rows in which a number of these columns, a time, an id or a range cannot be.

        A column of words stays unchanged: the function that reads it raises the error.

        Raises:
            LogError: there are more of them than may be left out, or the options are strict.
        """
        columns: dict[str, Array] = {}
        for role in ("t", *roles):
            if role in self.found:
                with suppress(LogError):
                    columns[role] = self.table.numbers([self.found[role].column])[:, 0]
        faults, of_psi = list[Fault](), None
        for role, values in columns.items():
            title = self.table.title(self.found[role].column)
            if MEASURES.get(role) == "time":
                faults += cells.time_faults(values, f"the time {title}", self._unit(role))
            elif role == "id":
                faults.append(cells.id_fault(self.table, self.found[role].column, values))
            else:
                fault = finite_fault(values, title)
                if {"range", "bearing"} <= {*columns} and role in ("range", "bearing") and "orientation" not in columns:
                    # with one empty cell the sighting has the other number alone
                    number = columns["bearing" if role == "range" else "range"]
                    fault = replace(fault, rows=fault.rows & ~(np.isnan(values) & np.isfinite(number)))
                faults.append(fault)
                of_psi = fault if role == "orientation" else of_psi
                faults += (
                    range_faults(values, columns.get("bearing"))
                    if role == "range"
                    else spike_faults(values, title, role)
                )
        if "x" in columns and self.kind == "sightings":
            other = "z" if self.options.axes == "optical" else "y"
            faults += range_faults(np.hypot(columns["x"], columns.get(other, np.ones(len(self.table)))))
        faults += fix_faults(columns)
        kept, notes = sound_rows(
            len(self.table), "sightings" if self.kind == "sightings" else "rows", faults, self.table.error,
            strict=self.options.strict, source=self.table.source,
        )  # fmt: skip
        if not kept.all():
            others = np.any([each.rows for each in faults if each is not of_psi], axis=0)
            notes += self._without_orientation(~kept & ~others)
            self.table = Kept(self.table, np.flatnonzero(kept), notes)
        return self.table

    def _without_orientation(self, rows: np.ndarray) -> tuple[str, ...]:
        """A note on rows (N,) bool that are left out for nothing but their orientation, if there are any."""
        if not (rows.any() and self.has("orientation")):
            return ()
        what = f"nothing but {self.table.title(self.found['orientation'].column)} leaves out {np.count_nonzero(rows):,} of "
        advice = "remove that column if the ranges and bearings of all sightings say more"
        return (f"{self.table.source}: {what}{len(rows):,} sightings: {advice}",)

    def without_empty(self, role: str) -> tuple[str, ...]:
        """Do without a column of which more cells are empty than rows may be left out; returns a note on that."""
        if not self.has(role) or self.options.strict:
            return ()
        column, count = self.found[role].column, 0
        # a column of words has its error where it is read
        with suppress(LogError):
            count = int(np.count_nonzero(np.isnan(self.table.numbers([column])[:, 0])))
        if count <= MOST_LEFT_OUT * len(self.table):
            return ()
        self.found = {other: chosen for other, chosen in self.found.items() if other != role}
        rows = f"{count:,} of {len(self.table):,} rows have no {self.table.title(column)}"
        return (f"{self.table.source}: {rows}, so that this column is not used",)

    def times(self, role: str = "t") -> np.ndarray:
        """The times (N,) of a column in nanoseconds, by the clock of the table."""
        self.need(role)
        column = self.found[role].column
        day = self.found["date"].column if self.has("date") else None
        ns = cells.nanoseconds(self.table, column, self._unit(role), self.kind, day)
        # times with decimals have their parts of a second
        if self.has("nanosec") and not np.any(ns % cells.UNITS["s"]):
            self.need("nanosec")
            beside = self.found["nanosec"].column
            more = cells.nanoseconds(self.table, beside, part_unit(self.table, beside), self.kind)
            if (k := first((more < 0) | (more >= cells.UNITS["s"]))) is not None:
                what = f"{self.table.title(beside)} is {self.table.words(beside)[k]}, and no part of a second beside "
                what += f"seconds: if it is the whole time, state columns='{self.kind}.t={beside + 1}'"
                raise self.table.error(k, what)
            ns = cells.added(self.table, column, ns, more, self.kind)
        if (unit := self.options.unit("time", self.kind)) is not None and cells.is_dated(self.table, column):
            note = f"{self.table.title(column)} holds dates or durations: the stated unit {unit} is not used"
            self.table.notes = tuple(dict.fromkeys((*self.table.notes, f"{self.table.source}: {note}")))
        return cells.added(self.table, column, ns, self.options.clock(self.kind), self.kind)

    def numbers(self, *roles: str, finite: bool = True) -> Array:
        """Columns (N, k) in metres and radians."""
        self.need(*roles)
        values = self.table.numbers([self.found[role].column for role in roles])
        bad = ~np.isfinite(values)
        if finite and bad.any():
            row, column = np.argwhere(bad)[0]
            title = self.table.title(self.found[roles[column]].column)
            raise self.table.error(int(row), finite_fault(values[:, column], title).message(row))
        for k, role in enumerate(roles):
            if role in MEASURES:
                values[:, k] *= SIZES[self._unit(role) or UNITS_OF[MEASURES[role]][0]]
        return values

    def single_number(self) -> str | None:
        """ "range" or "bearing" where a table of sightings has that number alone, and no column that may be the other."""
        measured = [role for role in ("range", "bearing") if self.has(role)]
        others = self.unused or any(self.has(role) for role in ("orientation", "x", "y", "z"))
        alone = len(measured) == 1 and self.table.names and not others
        return measured[0] if alone else None

    def classes(self) -> tuple[np.ndarray | None, tuple[str, ...]]:
        """The classes (N,) of sightings, None where no column has any; and notes."""
        if not self.has("class"):
            return None, ()
        stated = "class" in self.options.columns_of(self.kind)
        classes, notes = cells.classes_of(self.table, self.found["class"].column, stated=stated)
        if classes is not None:
            self.need("class")
        return classes, notes

    def poses(self, *, finite: bool = True) -> Array:
        """x, y and heading (N, 3), or x and y (N, 2) where there is no heading."""
        position = self.numbers("x", "y", finite=finite)
        if self.has("theta"):
            return np.column_stack([position, self.numbers("theta", finite=finite)])
        if self.has("qz", "qw"):
            quaternions, there = np.zeros((len(position), 4)), [role for role in _POSE[3:] if self.has(role)]
            quaternions[:, [_POSE[3:].index(role) for role in there]] = self.numbers(*there, finite=finite)
            known = np.isfinite(quaternions).all(axis=1)
            # rows keep their numbers in messages
            quaternions[~known] = (0, 0, 0, 1)
            return np.column_stack([position, np.where(known, cells.checked_heading(self.table, quaternions), np.nan)])
        return position

    def answered(self, **checks: str) -> tuple[cells.Doubt, ...]:
        """The checks {role: name} of units that the options state: such a doubt has no sentence."""
        found = {role: check for role, check in checks.items() if self.has(role)}
        return tuple((check, "") for role, check in found.items() if self.options.unit(MEASURES[role], self.kind))

    def refuse(
        self, role: str, values: Array, limit: float, message: str, measure: str = "", *, also: str = ""
    ) -> None:
        """Raise an error for the first value beyond a limit, probably in another unit, unless that is stated.

        ``measure`` is that of the role, if none is given; ``also`` ends the message.
        """
        if not self.stated(role) and (k := first(np.abs(values) > limit)) is not None:
            measure = measure or MEASURES[role]
            likely, own = {"angles": "degrees'", "lengths": "mm' (or cm)"}[measure], UNITS_OF[measure][0]
            advice = f"Then add {measure}='{self.kind}={likely}; if not, add {measure}='{self.kind}={own}'"
            raise self.table.error(k, f"{message.format(values[k])} {advice}{also}")

    def refuse_many(self, role: str, values: Array, limit: float, message: str, measure: str = "") -> None:
        """`refuse` values of which more than one in twenty is above what robots reach; single ones may be outliers."""
        if len(values) and np.quantile(values, 0.95) > limit:
            self.refuse(role, values, limit, message, measure)


def odometry_of(table: Table, options: TableOptions) -> Timed:
    """The odometry: controls (nu, omega) (N, 2), or poses whose differences become controls.

    Raises:
        LogError: a column is missing, a number is none, or the unit is almost certainly another one.
    """
    reader = Reader("odometry", table, options)
    motion = ("x", "y") if reader.has("x", "y") and not reader.has("nu", "omega") else ("nu", "omega")
    needed = motion if "x" not in motion or reader.has("qz", "qw") else (*motion, "theta")
    seen = find("sightings", table, ROLES["sightings"], {}, {}, ROLES["sightings"]).keys()
    if not reader.has(*needed) and {"id", "range", "bearing"} <= seen:
        raise table.error(None, "it has the columns of sightings: are the two tables exchanged?")
    instead = ", and none for x, y and theta instead of nu and omega"
    reader.need("t", *needed, instead="" if "x" in motion or reader.has(*motion) else instead)
    table = reader.leave_out(*(_POSE if "x" in motion else motion))
    ns = reader.times()
    if "x" not in motion:
        rows = reader.numbers(*motion)
        reader.refuse_many("nu", np.abs(rows[:, 0]), FASTEST, "the speed is {:g} m/s: is it in mm/s?")
        sideways = _sideways_speed(reader, rows[:, 0])
    else:
        rows = reader.poses()
    ns, order, notes = ordered(reader.table, ns)
    rows = rows[order]
    more, doubts = cells.repeated_times("odometry", table, ns, rows, np.arange(len(ns))[order])
    notes += more
    if not reader.stated("t"):
        cells.check_spacing(table, reader.found["t"].column, ns)
    if rows.shape[1] == 3:
        rows, ns, sideways = _controls(reader, rows, ns)
    else:
        message = "the turn rate is {:g} rad/s: is it in degrees per second?"
        reader.refuse_many("omega", np.abs(rows[:, 1]), QUICKEST, message)
    speed, turn = "speed unit", "turn rate unit"
    doubts += sideways + reader.answered(t="time unit", nu=speed, x=speed, omega=turn, theta=turn)
    return Timed(table, ns, rows, reader.described(), notes=notes, doubts=doubts)


def _sideways_speed(reader: Reader, speed: Array) -> tuple[cells.Doubt, ...]:
    """A doubt where a column has speeds sideways of a robot with speeds (N,) ahead."""
    if not reader.has("vy"):
        return ()
    lateral = reader.numbers("vy", finite=False)[:, 0]
    # it is no column of the controls
    del reader.used["vy"]
    return geometry.sideways_speed(reader.table, reader.table.title(reader.found["vy"].column), speed, lateral)


def _controls(reader: Reader, poses: Array, ns: np.ndarray) -> tuple[Array, np.ndarray, tuple[cells.Doubt, ...]]:
    """The controls between poses of odometry, their times, and doubts."""
    # of several rows with one time the last holds
    last = np.append(np.diff(ns) > 0, True)
    poses, ns = poses[last], ns[last]
    controls, sideways = geometry.controls_between(poses, np.diff(ns) / 1e9)
    speed, turn = np.abs(controls[:-1]).T
    heading = "theta" if reader.has("theta") else "x"
    reader.refuse_many(heading, turn, QUICKEST, "the headings turn by {:g} rad/s: are they in degrees?", "angles")
    reader.refuse_many("x", speed, FASTEST, "the poses move by {:g} m/s: are they in mm?")
    return controls, ns, geometry.sideways_poses(reader.table, sideways)


def sightings_of(table: Table, options: TableOptions) -> Timed:
    """The sightings (range, bearing[, orientation]) in the axes of the sensor turned to those of the robot.

    They have ids and, where there is a column of them, classes.

    Raises:
        LogError: a column is missing, a number is none, or the unit is almost certainly another one.
    """
    reader = Reader("sightings", table, options)
    cartesian = (reader.has("x", "y") or reader.has("x", "z")) and not reader.has("range")
    others = [role for role in ("range", "bearing") if not cartesian and not reader.has(role)]
    # what is missing, as far as there are columns that may be it
    reader.need("t", *(others if not reader.has("t") and len(reader.unused) > len(others) else ()))
    if cartesian:
        axes = geometry.chosen_axes(reader.table, reader.found, options.axes)
        options = reader.options = replace(options, axes=axes)
    plane = ("x", "z") if options.axes == "optical" else ("x", "y")
    measured = plane if cartesian else ("range", "bearing")
    # psi may be that of some landmarks alone
    empty = reader.without_empty("orientation")
    # ids first: columns in another order show there
    table = reader.leave_out("id", *measured, "orientation")
    ns = reader.times()
    found = _ids(reader)
    single = reader.single_number()
    if cartesian:
        rows = geometry.polar(reader.numbers(*plane) @ AXES[axes][:2, ["xyz".index(axis) for axis in plane]].T)
    elif single:
        rows = np.full((len(table), 2), np.nan)
        rows[:, ("range", "bearing").index(single)] = reader.numbers(single)[:, 0]
    else:
        instead = ", and none for x and y instead of range and bearing"
        if reader.has("range") != reader.has("bearing"):
            instead += " (a sensor that measures one of them has an empty column of the other)"
        reader.need("range", "bearing", instead=instead)
        rows = reader.numbers("range", "bearing", finite=reader.has("orientation"))
    if reader.has("bearing"):
        reader.refuse("bearing", rows[:, 1], WHOLE_TURN, "the bearing is {:g} rad, beyond 2 pi: is it in degrees?")
    if np.nanmedian([*rows[:, 0], 0.0]) > FARTHEST:
        role = "range" if reader.has("range") else "x"
        reader.refuse(role, rows[:, 0], FARTHEST, "the range is {:g} m: is it in mm?")
    sign = -1.0 if options.bearings == "clockwise" else 1.0
    rows[:, 1] = sign * rows[:, 1] + (options.sensor_yaw or 0.0)
    if reader.has("orientation"):
        psi, beyond = reader.numbers("orientation"), "the orientation is {:g} rad, beyond 2 pi: is it in degrees?"
        rename = "; if it alone is in degrees, name its column orientation_deg instead"
        reader.refuse("orientation", psi[:, 0], WHOLE_TURN, beyond, also=rename)
        rows = np.column_stack([rows, sign * psi])
    if options.centre == "robot" and options.sensor_offset not in (None, (0.0, 0.0)):
        if (alone_at := np.flatnonzero(np.isnan(rows[:, :2]).any(axis=1))).size:
            message = "a range or a bearing alone from the robot's centre says nothing about the sensor at its offset"
            advice = "give it as the sensor measured it, with centre='sensor'"
            raise table.error(int(alone_at[0]), f"{message}: {advice}")
        rows = geometry.seen_from(options.sensor_offset, rows)
    ns, order, more = ordered(reader.table, ns)
    ids, rows = found.numbers[order], rows[order]
    rows[:, 1:] = wrap(rows[:, 1:])
    doubts = cells.repeated_sightings(table, ns, ids, rows, np.arange(len(ns))[order])
    doubts += reader.answered(range="range unit", x="range unit")
    classes, remarks = reader.classes()
    classes = None if classes is None else classes[order]
    notes = (*found.notes, *empty, *more, *remarks)
    return Timed(table, ns, rows, reader.described(), ids, notes, doubts, classes, found.names)


def _ids(reader: Reader) -> cells.Ids:
    """The ids of the sightings; `UNIDENTIFIED` where there is no column of them."""
    table = reader.table
    if not reader.has("id"):
        missing = reader.missing("id", consequence=", so no landmark is identified")
        return cells.Ids(np.full(len(table), UNIDENTIFIED), notes=(f"{table.source}: {missing}",))
    reader.need("id")
    return cells.ids_of(table, reader.found["id"].column)


def truth_of(table: Table, options: TableOptions) -> Timed:
    """The true poses (N, 3) or positions (N, 2); rows that are not known are left out.

    Raises:
        LogError: a column is missing, or a number is none.
    """
    reader = Reader("truth", table, options)
    reader.need("t", "x", "y")
    table = reader.leave_out()
    ns, rows = reader.times(), reader.poses(finite=False)
    known = np.asarray(np.isfinite(rows).all(axis=1))
    if not known.any():
        raise table.error(None, "no row has all numbers of a pose; leave out an empty column, or the ground truth")
    few = f"{table.source}: {np.sum(~known)} of {len(known)} rows have no pose and are left out"
    notes = (few,) * (not known.all())
    if rows.shape[1] == 3 and not reader.has("qz") and not geometry.counts_turns(rows[known]):
        reader.refuse("theta", rows[:, 2], FOUR_TURNS, TURNED)
    rows[:, 2:] = wrap(rows[:, 2:])
    kept = np.flatnonzero(known)
    ns, order, more = ordered(reader.table, ns[kept], kept)
    rows = rows[kept][order]
    again, doubts = cells.repeated_times("truth", table, ns, rows, kept[order])
    return Timed(table, ns, rows, reader.described(), notes=(*notes, *more, *again), doubts=doubts)
