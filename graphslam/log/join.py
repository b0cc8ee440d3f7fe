"""`Log.from_tables`: the streams of a drive, each with its own clock, as one log; and two drives as one log.

`relations_of` and `positions_of` read the tables of other sensors: relations between two poses, and absolute positions, each
with its noise. Latitude and longitude become places in the plane that touches the Earth at the first of them (`local_plane`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import LogError, OptionError, quoted
from ..errors.checks import FOUR_TURNS, WHOLE_TURN, check_known, check_type, first
from ..models import ANYWHERE, SensorModel, additional_variances
from ..se2 import Array, wrap
from .cells import COVERED, DOUBTFUL_NOISE, Doubt, ids_of, seconds
from .drive import TURNED, Reader, Timed, odometry_of, sightings_of, truth_of
from .geometry import datum_note, local_plane
from .log import Log
from .measurements import MEASURED, NOT_POSITIVE, Measured, Session, checked_landmarks, cut_headings, not_positive
from .rows import NO_CLASS, SIZES, UNIDENTIFIED, UNITS_OF, ReadOptions, TableOptions
from .streams import Stream, synchronize
from .table import COVARIANCES, Table, ordered
from .text_table import table_of

#: the coordinates of the noise
_AXES = ("x", "y", "theta")


def relations_of(table: Table, options: TableOptions) -> Timed:
    """The relations: rows (N, 12), the motions (dx, dy, dtheta or NaN) and their covariances, with the times of both poses.

    Raises:
        LogError: a column is missing, a number is none, or a covariance is not positive definite.
    """
    reader = Reader("relations", table, options)
    counting = ["step", "steps", "first", "second", "step1", "step2", "from", "to"]
    steps = [name for name in table.names if name.lower() in counting]
    counts = f", and {steps[0]!r} counts steps, which tables do not have: give the time of both poses" if steps else ""
    reader.need("t1", instead=counts)
    reader.need("t2", "dx", "dy", "dtheta")
    table = reader.leave_out("t1", "t2", "dx", "dy")
    ns, ends = reader.times("t1"), reader.times("t2")
    if (k := first(ns == ends)) is not None:
        message = f"the relation goes from {ns[k] / 1e9:.3f} s to the same time; it needs two different times"
        raise table.error(k, message)
    # an empty cell: the heading is not known there
    motions = np.column_stack([reader.numbers("dx", "dy"), reader.numbers("dtheta", finite=False)])
    reader.refuse("dtheta", motions[:, 2], WHOLE_TURN, "the turn is {:g} rad, beyond 2 pi: is it in degrees?")
    motions[:, 2] = wrap(motions[:, 2])
    rows = np.column_stack([motions, _noise(reader, np.isfinite(motions[:, 2])).reshape(-1, 9)])
    order = np.argsort(ns, kind="stable")
    return Timed(table, ns[order], rows[order], reader.described(), ends=ends[order])


def positions_of(table: Table, options: TableOptions) -> Timed:
    """The absolute positions: rows (N, 17), (x, y, theta or NaN), covariances with NaN likewise, levers, and datums or NaN.

    Latitude and longitude become metres east and north of the first fix, the datum, at its altitude (`local_plane`).

    Raises:
        LogError: a column is missing, a number is none, or a covariance is not positive definite.
    """
    reader, plane = Reader("positions", table, options), tuple[str, ...]()
    columns = ("latitude", "longitude") if reader.has("latitude", "longitude") and not reader.has("x") else ("x", "y")
    reader.need("t", *columns)
    table = reader.leave_out(*columns)
    ns = reader.times()
    plain, datum = reader.numbers(*columns), np.full(3, np.nan)

    def given(role: str) -> Array:
        return reader.numbers(role) if reader.has(role) else np.zeros((len(plain), 1))

    if columns[0] == "latitude":
        if (k := first(np.abs(plain[:, 0]) > 90)) is not None:
            raise table.error(k, f"{plain[k, 0]:g} is no latitude in degrees; are latitude and longitude exchanged?")
        datum = np.column_stack([plain, _altitudes(reader)])[np.argmin(ns)]
        plain, plane = local_plane(plain, datum), (datum_note(datum, f"the first fix of {table.source}"),)
    places = np.column_stack([plain, _headings(reader)])
    covariances = _noise(reader, np.isfinite(places[:, 2]))
    rows = [places, covariances.reshape(-1, 9), given("lever_x"), given("lever_y"), np.tile(datum, (len(ns), 1))]
    ns, order, notes = ordered(reader.table, ns)
    return Timed(table, ns, np.hstack(rows)[order], reader.described(), notes=(*notes, *plane))


def _altitudes(reader: Reader) -> Array:
    """The altitudes (N,) [m]; 0 where they are not known, as with words or feet: 100 m move positions by 1 part in 60,000."""
    if reader.has("altitude"):
        try:
            return np.nan_to_num(reader.numbers("altitude", finite=False)[:, 0], posinf=0.0, neginf=0.0)
        except LogError:
            reader.used.pop("altitude", None)
    return np.zeros(len(reader.table))


def _headings(reader: Reader) -> Array:
    """The headings (N,), wrapped; NaN where a cell is empty, or all of them where there is no such column."""
    if not reader.has("theta"):
        return np.full(len(reader.table), np.nan)
    headings = reader.numbers("theta", finite=False)[:, 0]
    reader.refuse("theta", headings, FOUR_TURNS, TURNED)
    return np.asarray(wrap(headings))


def _noise(reader: Reader, oriented: np.ndarray) -> Array:
    """The covariances (N, 3, 3) of rows; those of headings are NaN where these are not measured, (N,) bool ``oriented``."""
    d, covariances = 3 if oriented.any() else 2, np.zeros((len(oriented), 3, 3))
    if reader.has("cov_xx"):
        reader.need("cov_xx", "cov_yy", *(("cov_thetatheta",) if d == 3 else ()))
        for role, i, j in zip(COVARIANCES, *np.triu_indices(3)):
            if reader.has(role) and j < d:
                covariances[:, i, j] = covariances[:, j, i] = reader.numbers(role, finite=bool(j < 2))[:, 0]
        length, angle = (SIZES[reader.options.unit(m, reader.kind) or UNITS_OF[m][0]] for m in ("lengths", "angles"))
        covariances *= np.outer(sizes := [length, length, angle], sizes)
    else:
        roles = ("sigma", "sigma") if reader.has("sigma") and not reader.has("sigma_x") else ("sigma_x", "sigma_y")
        reader.need(*roles, instead=", and none for cov_xx, cov_yy instead of standard deviations")
        deviations = reader.numbers(*roles)
        if d == 3:
            deviations = np.column_stack([deviations, reader.numbers("sigma_theta", finite=False)])
        for axis, column in enumerate(deviations.T):
            used = np.ones(len(column), dtype=bool) if axis < 2 else oriented
            if (k := first(used & ~(column > 0))) is not None:
                advice = "but it must be above zero: how far off the sensor usually is"
                raise reader.table.error(k, f"the standard deviation of {_AXES[axis]} is {column[k]:g}, {advice}")
            covariances[:, axis, axis] = column**2
    cut_headings(covariances, ~oriented)
    if (k := first(not_positive(np.nan_to_num(covariances)))) is not None:
        raise reader.table.error(k, f"the covariance {NOT_POSITIVE}")
    covariances[~oriented, 2] = covariances[~oriented, :, 2] = np.nan
    return covariances


@dataclass(frozen=True)
class Drive:
    """The streams of one drive that have been read, each with its own clock.

    Attributes:
        odometry, sightings, truth, relations, positions: times in nanoseconds, rows in metres and radians.
        landmarks: the true map.
        sensor_offset: position of the sensor on the robot [m], None where nothing says it.
        notes: about the whole drive, one sentence each.
        truth_offset: the point of the robot that the truth is of [m], as in `Log`; None for its pose.
    """

    odometry: Timed
    sightings: Timed
    truth: Timed | None = None
    landmarks: Mapping[int, Array] | None = None
    sensor_offset: tuple[float, float] | None = None
    notes: tuple[str, ...] = ()
    truth_offset: tuple[float, float] | None = None
    relations: Timed | None = None
    positions: Timed | None = None

    @property
    def streams(self) -> dict[str, Timed]:
        """The streams by the name of their table."""
        names = ("odometry", "sightings", *READERS)
        return {name: stream for name in names if (stream := getattr(self, name)) is not None}

    def _covered(self) -> list[Doubt]:
        """A doubt where the sightings cover little of the odometry."""
        spans = [float(stream.times[-1] - stream.times[0]) for stream in (self.odometry, self.sightings)]
        if len(self.sightings.times) < 2 or spans[1] > _FEW * spans[0]:
            return []
        share = f"{spans[1] / 1e9:.1f} s of the {spans[0] / 1e9:.1f} s of the odometry"
        message = f"the sightings cover {share}; the times of one of them may be in another unit, or count rows"
        return [(COVERED, message)]

    def log(self, reading: ReadOptions, name: str) -> Log:
        """The log of this drive.

        Raises:
            LogError: the clocks do not overlap, or the streams cannot be joined.
        """
        origin, streams = int(self.odometry.times[0]), dict[str, Any]()
        for kind, stream in self.streams.items():
            if kind != "odometry":
                check_overlap(self.odometry, stream, kind)
            rows = stream.rows
            if stream.ends is not None:
                rows = np.column_stack([seconds(stream.ends, origin), rows])
            streams[kind] = Stream(seconds(stream.times, origin), rows)
        remarks = [note for stream in self.streams.values() for note in (*stream.table.notes, *stream.notes)]
        doubts = self._covered() + [doubt for stream in self.streams.values() for doubt in stream.doubts]
        return synchronize(
            **streams,
            landmarks=self.sightings.ids,
            options=reading,
            truth_offset=self.truth_offset or (0.0, 0.0),
            true_landmarks=self.landmarks,
            classes=self.sightings.classes,
            origin=origin / 1e9,
            name=name,
            notes=(*self.notes, *remarks),
            doubts=tuple(doubts),
            sensor=None if self.sensor_offset is None else SensorModel(offset=self.sensor_offset),
        )


def read_drive(
    odometry: Any, sightings: Any, *, options: TableOptions | None = None, map: Any = None, **others: Any
) -> Drive:
    """Read the tables of a drive; the arguments are those of `Log.from_tables`.

    Raises:
        LogError: a table lacks a column or has an impossible value.
    """
    options = options or TableOptions()
    moved = odometry_of(table_of(odometry, "odometry"), options)
    seen = sightings_of(table_of(sightings, "sightings"), options)
    read: dict[str, Any] = {}
    for kind, table in others.items():
        if table is not None:
            read[kind] = READERS[kind](table_of(table, kind), options)
    if isinstance(map, Mapping) and all(isinstance(j, int | np.integer) for j in map):
        landmarks: dict[int, Array] | None = checked_landmarks(map)
    else:
        landmarks = None if map is None else map_of(table_of(map, "map"), options, seen.names)
    return Drive(
        moved, seen, landmarks=landmarks, sensor_offset=options.sensor_offset, truth_offset=options.truth_offset, **read
    )


#: the time between two drives [s]. `estimate_robot` and checks judge by time what belongs together: with a second between
#: drives 13 of 20 joined logs had 1.5 to 4.8 times the noise of their sensor, and with 10 to 1000 s at most one
APART = 60.0


#: the readers of tables that a drive need not have
READERS = {"truth": truth_of, "relations": relations_of, "positions": positions_of}


def from_tables(
    odometry: Any,
    sightings: Any,
    *,
    truth: Any = None,
    map: Any = None,
    relations: Any = None,
    positions: Any = None,
    name: str = "log",
    keep_every: float | None = None,
    options: TableOptions | None = None,
    **changes: Any,
) -> Log:
    """The log of tables that each have their own times, for example of CSV files of your own robot.

    A table is the path of a file (CSV, TSV, text, Parquet), a data frame of pandas or the like, a mapping of columns,
    or an array. Columns are recognised by common names; without names their order is the one given here.

    Args:
        odometry: t, nu, omega; or t, x, y, theta, whose differences become controls.
        sightings: t, id, range, bearing[, orientation]; or, by name only, t, id, x, y[, z] in the axes of the sensor.
        truth: t, x, y, theta; or the columns of TUM, t, x, y, z, qx, qy, qz, qw; or t, x, y.
        map: id, x, y[, theta]; or {id: (x, y) or (x, y, heading)}.
        relations: t1, t2, dx, dy, dtheta and their noise, sigma_x, sigma_y, sigma_theta or cov_xx, cov_xy, ...
        positions: t, x, y[, theta] and their noise, sigma or sigma_x, sigma_y[, sigma_theta] or cov_xx, cov_xy, ...,
            and lever_x, lever_y, the point of the robot that is measured. docs/other_sensors.md has both tables.
        name: of the log.
        keep_every: the greatest time between poses [s]; default: poses only where something was seen.
        options, changes: units, clocks and axes: a `graphslam.log.rows.TableOptions`, or its fields, for example
            ``angles="degrees"``, ``time={"odometry": "ms"}``, ``columns={"sightings": {"range": "dist"}}``.

    Raises:
        LogError: a table lacks a column or has an impossible value; the message names file and line.
        OptionError: an option is impossible.
    """
    check_type(TableOptions, options=options)
    if options is not None and changes:
        raise OptionError(f"give {next(iter(changes))} as a field of options, or leave out options")
    check_known("from_tables", changes, [f.name for f in fields(TableOptions)], "; see TableOptions")
    tables = {"truth": truth, "map": map, "relations": relations, "positions": positions}
    drive = read_drive(odometry, sightings, **tables, options=options or TableOptions(**changes))
    return drive.log(ReadOptions(keep_every=keep_every), name)


Log.from_tables = staticmethod(from_tables)


#: sightings or truth are refused that last longer than the odometry by more than the second factor, and have less than the
#: first share of their rows within its time
_FEW, _LONGER = 0.1, 20.0


def check_overlap(odometry: Timed, other: Timed, kind: str) -> None:
    """Raise `LogError` where two clocks have no time in common; the message has both intervals and the likely cause."""
    begin, end = int(odometry.times[0]), int(odometry.times[-1])
    first, last = int(other.times[0]), int(other.times[-1])
    whole, others = (f"{t[0] / 1e9:.3f} to {t[-1] / 1e9:.3f} s" for t in (odometry.times, other.times))
    if len(odometry.times) == 1:
        raise odometry.table.error(None, "there is one row, but motion takes two")
    if begin == end:
        message = f"all {len(odometry.times)} rows have the time {begin / 1e9:.3f} s: are times in another column?"
        raise odometry.table.error(None, message)
    if first <= end and last >= begin:
        inside = int(np.sum((other.times >= begin) & (other.times <= end)))
        longer = (last - first) / (end - begin)
        if inside < _FEW * len(other.times) and longer > _LONGER:
            lasts = f"{_name(other)} lasts {longer:.0f} times as long as {_name(odometry)}"
            rows = f"only {inside} of {len(other.times)} rows are within its time ({whole})"
            advice = f"are its times in another unit? Then add time='{kind}={_finer_unit(other, longer) or 'ms'}'"
            raise LogError(f"{lasts}, and {rows}: {advice}")
        return
    offset = (begin - first) / 1e9
    hours = offset / 3600
    remedy = f"clocks='{kind}={f'{offset:.3f}'.rstrip('0').rstrip('.')}' lets both begin together"
    finer, which, ratio = odometry, "odometry", (end - begin) / (last - first or end - begin)
    if ratio < 1:
        finer, which, ratio = other, kind, (last - first) / (end - begin)
    if min(begin, first) < 1e16 < max(begin, first):
        cause = "one counts from 1970 and the other from its own start"
    elif unit := _finer_unit(finer, ratio):
        cause, remedy = f"the times of {_name(finer)} seem to be in another unit", f"if so, add time='{which}={unit}'"
    elif abs(hours) >= 0.9 and abs(hours - round(hours)) < 0.05 and abs(hours) < 26:
        cause = f"they differ by about {abs(round(hours))} h, as two time zones do"
    else:
        cause = "they are of different drives, or one clock was not set"
    names = f"{_name(odometry)} ({whole}) and {_name(other)} ({others})"
    raise LogError(f"the clocks of {names} do not overlap: {cause}; {remedy}")


def _finer_unit(stream: Timed, ratio: float) -> str | None:
    """The unit that times seem to have that last so many times as long as others; None where no unit explains it.

    Sightings, or the odometry, may cover a tenth of the other.
    """
    units, steps = UNITS_OF["time"], round(np.log10(ratio) / 3)
    read = next((k for k, unit in enumerate(units) if stream.columns[0].endswith(f"[{unit}]")), 0)
    return units[read + steps] if steps > 0 and 0.1 < ratio / 1000**steps < 10 and read + steps < len(units) else None


def _name(stream: Timed) -> str:
    """The table without its folder: a sentence with two paths is hard to read."""
    path, colon, topic = stream.table.source.partition(": ")
    return f"{Path(path).name}{colon}{topic}"


def end_to_end(first: Log, second: Log) -> Log:
    """The log of both, with controls; the second is in the frame of the first.

    From the last pose of the first to the first pose of the second leads a control of `APART` seconds with the displacements
    of `ANYWHERE`. The noise models are those of the first.
    """
    a, b = first, second
    assert a.controls is not None and b.controls is not None and a.dt is not None and b.dt is not None
    poses, pieces = a.num_poses, len(a.controls) + 1
    of_first, of_second = (additional_variances(each.control_variances, len(each.controls)) for each in (a, b))  # type: ignore[arg-type]

    def both(name: str) -> Array | None:
        one, other = getattr(a, name), getattr(b, name)
        return None if one is None or other is None else np.concatenate([one, other])

    def with_unknown(name: str, sizes: Sequence[int]) -> Array | None:
        """Rows of both, NaN for the one that has none."""
        rows = [getattr(each, name) for each in (a, b)]
        if all(each is None for each in rows):
            return None
        return np.concatenate([np.full((n, 3), np.nan) if each is None else each for each, n in zip(rows, sizes)])

    moved = {name: each.moved(lambda steps: steps + poses) for name, each in b.measured.items()}
    recorded = [each.dt if each.recorded_dt is None else each.recorded_dt for each in (a, b)]
    # where one of them has true poses and no path, there is none of both
    has_path = all(each.true_path is not None for each in (a, b) if each.true_poses is not None)
    doubts = dict.fromkeys(doubt for each in (a, b) for doubt in _doubts_of(each))
    return a.replace(
        dt=np.concatenate([a.dt, [APART], b.dt]), controls=np.concatenate([a.controls, np.zeros((1, 2)), b.controls]),
        control_starts=np.concatenate([a.control_starts, pieces + b.control_starts]),
        control_variances=np.concatenate([of_first, [np.array(ANYWHERE) / APART**2], of_second]),
        recorded_dt=np.concatenate([recorded[0], [APART], recorded[1]]),
        steps=np.concatenate([a.steps, poses + b.steps]), landmarks=both("landmarks"), sightings=both("sightings"),
        classes=_classes(a, b), initial_poses=both("initial_poses"),
        true_poses=with_unknown("true_poses", (poses, b.num_poses)),
        true_path=with_unknown("true_path", (pieces, len(b.controls) + 1)) if has_path else None,
        true_landmarks={**(b.true_landmarks or {}), **(a.true_landmarks or {})} or None,
        **{name: joined_rows(getattr(a, name), moved.get(name)) for name in MEASURED},
        notes=(*_of_each(a, a.notes), *_of_each(b, b.notes)),
        # a unit counts as stated that is stated for both
        doubts=tuple(each for each in doubts if each[1] or all(each in one.doubts for one in (a, b))),
        sessions=(*_sessions(a), *(replace(each, start=poses + each.start) for each in _sessions(b))),
        name=f"{a.sessions[0].name} and {len(a.sessions)} more" if a.sessions else f"{a.name} and {b.name}",
    )  # fmt: skip


def joined_rows(first: Measured | None, second: Measured | None) -> Measured | None:
    """The rows of two kinds of the same measurements; None where neither has any."""
    if first is None or second is None:
        return second if first is None else first
    rows = {f.name: np.concatenate([getattr(first, f.name), getattr(second, f.name)]) for f in fields(second)}
    return replace(second, **rows)  # type: ignore[arg-type]


def _classes(*logs: Log) -> np.ndarray | None:
    """The classes of the sightings of logs, as words where one has words; unknown for a log that has none."""
    if all(each.classes is None for each in logs):
        return None
    rows = [np.full(len(each.steps), UNIDENTIFIED) if each.classes is None else each.classes for each in logs]
    if any(own.dtype.kind == "U" for own in rows):
        rows = [np.where(each.classified, own.astype(str), NO_CLASS) for each, own in zip(logs, rows)]
    return np.concatenate(rows)


def _sessions(log: Log) -> tuple[Session, ...]:
    return log.sessions or (Session(log.name, 0, log.start_time),)


def _of_each(log: Log, remarks: Iterable[str]) -> Iterator[str]:
    """Remarks about a log, with its name; those about logs that were joined have it already."""
    yield from remarks if log.sessions else (f"{log.name}: {remark}" for remark in remarks)


def _doubts_of(log: Log) -> Iterator[Doubt]:
    """The doubts of a log; those about its noise name steps, and so get its name, see `_of_each`."""
    for check, text in log.doubts:
        yield check, next(_of_each(log, [text])) if check == DOUBTFUL_NOISE else text


def map_of(table: Table, options: TableOptions, names: Mapping[str, int] | None = None) -> dict[int, Array]:
    """The landmarks of a map, {id: (x, y) or (x, y, heading)}; ``names`` are those of the sightings, None without any.

    An empty cell of the heading says that it is not known.

    Raises:
        LogError: a column is missing, a number is none, or two rows have one id.
    """
    reader = Reader("map", table, options)
    reader.need("id")
    column = reader.found["id"].column
    found = ids_of(table, column, names)
    ids = found.numbers
    if (k := first(ids == UNIDENTIFIED)) is not None:
        message = f"the id {table.title(column)} is empty or -1, which means no id; each landmark of the map needs one"
        raise table.error(k, message)
    if names is None and found.names:
        words = f"the ids are words, such as {quoted(next(iter(found.names)))}; a log numbers its own words"
        advice = (
            "so those of a map by itself would be other landmarks: give the landmarks of both the same whole numbers"
        )
        raise table.error(None, f"{words}, {advice}")
    places, headings = reader.numbers("x", "y"), _headings(reader)
    if (k := first(~np.isin(np.arange(len(ids)), np.unique(ids, return_index=True)[1]))) is not None:
        name = next((name for name, number in (names or {}).items() if number == ids[k]), ids[k])
        raise table.error(k, f"landmark {name} is in the map twice; each landmark has one place")
    rows = zip(ids.tolist(), places, headings.tolist())
    return {j: place if np.isnan(heading) else np.append(place, heading) for j, place, heading in rows}
