"""What other sensors measure: relations between two poses, absolute positions, and ranges or bearings of landmarks alone.

A relation is a pose measured from another one: by scan matching, a loop closure, or the odometry of a second source. An
absolute position is the place of a point of the robot in the world: by GPS, motion capture, or a total station.

Functions such as `finite_floats` and `whole_numbers` check the arguments of a `Log`, and `checked_sightings` those of an
observation: wrong shapes, wrong types and impossible values are refused in one sentence.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from ..errors import LogError, OptionError, quoted, shortened
from ..errors.checks import array_of, array_or_none, check_heading, check_sighted, first, real_array
from ..se2 import Array, wrap
from .rows import NO_ID, UNIDENTIFIED


def length_of(value: Any) -> int | None:
    """The number of rows of an array or a list; None of what has none."""
    try:
        return len(value)
    except TypeError:
        return None


def _array_or_none(value: Any) -> np.ndarray | None:
    """A value as an array of any type; None for rows of different lengths."""
    try:
        return np.asarray(value)
    except ValueError:
        return None


def checked_starts(value: np.ndarray, controls: int) -> np.ndarray:
    """The first control of each motion, and the number of controls, (T+1,)."""
    starts = _array_or_none(value)
    whole = starts is not None and starts.ndim == 1 and len(starts) > 0 and starts.dtype.kind in "iu"
    if starts is None or not whole or starts[0] != 0 or starts[-1] != controls or np.any(np.diff(starts) <= 0):
        wanted = f"whole numbers, one per pose, that increase from 0 to the number of controls, {controls}"
        raise LogError(f"control_starts must be {wanted}")
    return starts.astype(np.int64)


def checked_truth(value: ArrayLike, shape: tuple[int, ...], name: str = "true_poses") -> Array:
    """True poses; each row is complete, a position with an unknown heading, or unknown."""
    array = array_of(name, value)
    unknown = np.isnan(array)
    known = finite_floats(name, np.where(unknown, 0.0, array) if array.shape == shape else array, shape)
    if (k := first((unknown[:, 0] != unknown[:, 1]) | (unknown[:, 0] & ~unknown[:, 2]))) is not None:
        raise LogError(f"{name}[{k}] is {array[k]}; a row must be complete, (x, y, NaN) or all NaN")
    known[unknown] = np.nan
    return known


def checked_classes(value: ArrayLike, length: int) -> np.ndarray:
    """Classes as words, or as whole numbers."""
    array = _array_or_none(value)
    if array is not None and array.dtype.kind == "O" and all(isinstance(each, str) for each in array.flat):
        array = array.astype(str)
    if array is None or array.dtype.kind != "U":
        return whole_numbers("classes", value, length, "words, or whole numbers")
    if array.shape != (length,):
        raise LogError(f"classes must have one entry per sighting, shape ({length},), not {array.shape}")
    return np.char.strip(array)


def checked_landmarks(value: Any) -> dict[int, Array]:
    """The true map, {id: (x, y) or (x, y, heading)}."""
    if not isinstance(value, Mapping):
        raise OptionError(f"true_landmarks must be a mapping {{id: (x, y) or (x, y, heading)}}, not {quoted(value)}")
    for j in value:
        if not isinstance(j, (int, float, np.integer)) or j % 1 != 0 or not -(2**63) <= j < 2**63:
            raise OptionError(f"the ids of true_landmarks must be whole numbers of at most 64 bits, not {quoted(j)}")
    landmarks = {int(j): finite_floats(f"true_landmarks[{j}]", m, (None,)) for j, m in value.items()}
    for j, m in landmarks.items():
        if len(m) not in (2, 3):
            raise LogError(f"true_landmarks[{j}] must be (x, y) or (x, y, heading), not of shape {m.shape}")
        check_heading(f"true_landmarks[{j}]", m[2:])
    return landmarks


def _floats(name: str, value: ArrayLike) -> Array:
    """A copy of an array of floating-point numbers of any shape."""
    try:
        return real_array(value).copy()
    except (TypeError, ValueError, OverflowError) as error:
        raise LogError(f"{name} must be an array of numbers: {shortened(str(error))}") from None


def _for_each(name: str, value: ArrayLike, count: tuple[int, ...], shape: tuple[int, ...]) -> Array:
    """A copy of an array of floating-point numbers, of which one of this shape is repeated for all rows, (*count, *shape)."""
    array = _floats(name, value)
    return np.broadcast_to(array, (*count, *shape)).copy() if array.shape == shape else array


def finite_floats(name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> Array:
    """A copy of an array of finite numbers of a shape, in which None stands for any length."""
    array = _floats(name, value)
    if array.ndim != len(shape) or any(want is not None and want != have for want, have in zip(shape, array.shape)):
        wanted = ", ".join("any" if want is None else str(want) for want in shape) + "," * (len(shape) == 1)
        raise LogError(f"{name} must have shape ({wanted}), not {array.shape}")
    if not np.all(np.isfinite(array)):
        where = np.argwhere(~np.isfinite(array))[0].tolist()
        raise LogError(f"{name}{where} is {array[tuple(where)]}; all numbers must be finite")
    return array


def whole_numbers(
    name: str, value: ArrayLike, length: int, wanted: str = "whole numbers", noun: str = "sighting"
) -> np.ndarray:
    """A copy of an array (length,) of whole numbers of 64 bits, one for each ``noun``."""
    if (array := _array_or_none(value)) is None:
        raise LogError(f"{name} must be {wanted}, one per {noun}, not {quoted(value)}")
    if array.size == 0:
        array = array.astype(np.int64).reshape(-1)
    if array.shape != (length,):
        raise LogError(f"{name} must have one entry per {noun}, shape ({length},), not {array.shape}")
    try:
        with np.errstate(invalid="ignore"):
            if array.dtype.kind in "cmM":
                raise TypeError
            whole = array.astype(np.int64)
    except (TypeError, ValueError, OverflowError):  # of a word, or None
        raise LogError(f"{name} must be {wanted}, not such as {quoted(array[0])}") from None
    if not np.array_equal(whole, array):
        raise LogError(f"{name} must be {wanted}")
    return whole.copy()


@dataclass(frozen=True)
class Session:
    """One of the drives, or robots, that a log was joined from: its name, its first step, and the time of that [s].

    ``clock_offset`` and ``clock_deviation`` are what is added to its times so that they are those of the first robot, and the
    standard error [s] (`graphslam.sessions.clocks`); None where that was not estimated.
    """

    name: str
    start: int
    start_time: float
    clock_offset: float | None = None
    clock_deviation: float | None = None


def check_sessions(sessions: Sequence[Session], poses: int) -> None:
    """Raise `LogError` unless the first steps of sessions, if there are any, increase from 0 and are below ``poses``."""
    starts = [each.start for each in sessions]
    if starts and (starts[0] != 0 or np.any(np.diff([*starts, poses]) <= 0)):
        raise LogError(f"sessions start at the steps {starts}; these must increase from 0 and be below {poses}")


#: the variance [rad²] of the heading of a relation that does not measure it: it adds at most 1e-5 to J
NO_HEADING = 1e6


class _Records:
    """Rows that belong together, in arrays that cannot be written to."""

    #: the fields that hold steps
    ENDS: tuple[str, ...]

    def __len__(self) -> int:
        return len(getattr(self, self.ENDS[0]))

    def among(self, rows: np.ndarray) -> Self:
        """Some of the rows, given by their numbers or a mask."""
        return type(self)(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})  # type: ignore[arg-type]

    def within(self, steps: np.ndarray) -> Self:
        """The rows whose steps are all among increasing ``steps``, with the places of these in them as new steps."""
        kept = self.among(np.all([np.isin(getattr(self, end), steps) for end in self.ENDS], axis=0))
        return kept.moved(lambda own: np.searchsorted(steps, own))

    def moved(self, step: Callable[[np.ndarray], np.ndarray]) -> Self:
        """The same with other steps, a function of its own."""
        return replace(self, **{end: step(getattr(self, end)) for end in self.ENDS})  # type: ignore[type-var]

    def equals(self, other: object) -> bool:
        """Whether the other holds exactly the same numbers."""
        return type(other) is type(self) and all(
            np.array_equal(getattr(self, f.name), getattr(other, f.name), equal_nan=f.name not in self.ENDS)
            for f in fields(self)  # type: ignore[arg-type]
        )

    def check_steps(self, name: str, poses: int) -> None:
        """Raise `LogError` where a step is none of a log with so many poses."""
        for end in self.ENDS:
            steps = getattr(self, end)
            if (k := first((steps < 0) | (steps >= poses))) is not None:
                which = f"{end.removesuffix('s')} {steps[k]}, but the log has steps 0 to {poses - 1}"
                raise LogError(f"row {k} of {name} has {which}: are these times? A step counts poses from 0")

    def _set(self, **values: Array) -> None:
        for name, value in values.items():
            value.flags.writeable = False
            object.__setattr__(self, name, value)


@dataclass(frozen=True, eq=False, kw_only=True)
class PoseRelations(_Records):
    """R measured relations between two poses of a log each. All arrays are copied, checked and made read-only.

    The motion z = (dx, dy, dtheta) is the pose at ``second`` in the axes of the pose at ``first``, with the residual
    e = (R(theta_1)' (p_2 - p_1) - (dx, dy), theta_2 - theta_1 - dtheta) and the information C^-1.

    Args:
        first, second: (R,) the steps of both poses; ``second`` may come before ``first``.
        motions: (R, 3) [m, m, rad]; headings are wrapped to [-pi, pi), and NaN where they are not measured.
        covariances: C (R, 3, 3) of the motions in the axes of the first pose [m², m rad, rad²]; one matrix is for all. Rows
            and columns of a heading that is not measured are not used: it becomes 0 with the variance `NO_HEADING`.

    Raises:
        LogError: an array has another shape, a relation ties a pose to itself, or a covariance is not positive definite.
        OptionError: a heading is beyond 8 pi, as in degrees.
    """

    ENDS = ("first", "second")

    first: np.ndarray
    second: np.ndarray
    motions: Array
    covariances: Array

    def __post_init__(self) -> None:
        motions = _floats("the motions of relations", self.motions)
        covariances = _for_each("the covariances of relations", self.covariances, motions.shape[:1], (3, 3))
        if motions.shape[1:] == (3,) and covariances.shape == (len(motions), 3, 3):
            unknown = np.isnan(motions[:, 2])
            motions[unknown, 2] = 0.0
            cut_headings(covariances, unknown, NO_HEADING)
        motions = finite_floats("the motions of relations", motions, (None, 3))
        check_heading("relations", motions[:, 2])
        motions[:, 2] = wrap(motions[:, 2])
        count, ends = len(motions), dict[str, np.ndarray]()
        for end in self.ENDS:
            ends[end] = whole_numbers(f"the steps {end} of relations", getattr(self, end), count, noun="relation")
        if (k := first(ends["first"] == ends["second"])) is not None:
            raise LogError(f"relation {k} goes from step {ends['first'][k]} to itself; it needs two different steps")
        self._set(**ends, motions=motions, covariances=checked_covariances("relations", covariances, count, 3))


@dataclass(frozen=True, eq=False, kw_only=True)
class AbsolutePositions(_Records):
    """N measured places of a point of the robot in the world. All arrays are copied, checked and made read-only.

    The residual is e = p + R(theta) a - (x, y), with a the lever, and theta - theta_z where the heading is measured, too.

    Args:
        steps: (N,) the step of each.
        places: (N, 2) x and y [m], or (N, 3) with the heading of the robot [rad], NaN where it is not measured.
        covariances: (N, 2, 2) or (N, 3, 3) in world axes [m², m rad, rad²]; one matrix is for all. Rows and columns of a
            heading that is not measured are not used.
        levers: a (N, 2), the point of the robot that is measured, (ahead, left) [m] of its pose; one point is for all.
        datums: (N, 3) latitude and longitude [degrees, WGS 84] and height [m] of the origin of the places, which are metres
            east and north of it; NaN where it is not known. One is for all.

    Raises:
        LogError: an array has another shape, a covariance is not positive definite, or a latitude is beyond 90 degrees.
        OptionError: a heading is beyond 8 pi, as in degrees.
    """

    ENDS = ("steps",)

    steps: np.ndarray
    places: Array
    covariances: Array
    levers: Array = field(default_factory=lambda: np.zeros(2))
    datums: Array = field(default_factory=lambda: np.full(3, np.nan))

    def __post_init__(self) -> None:
        given = _floats("the places of positions", self.places)
        oriented = given.ndim == 2 and given.shape[1] == 3
        headings = given[:, 2] if oriented else np.full(len(given) if given.ndim else 0, np.nan)
        unknown, count = np.isnan(headings), len(headings)
        xy = finite_floats("the places of positions", given[:, :2] if oriented else given, (None, 2))
        check_heading("positions", finite_floats("the headings of positions", headings[~unknown], (None,)))
        places = np.column_stack([xy, wrap(headings)])
        steps = whole_numbers("the steps of positions", self.steps, count, noun="position")
        C, covariances = _floats("the covariances of positions", self.covariances), np.tile(np.eye(3), (count, 1, 1))
        d = 3 if C.shape[-1:] == (3,) else 2
        if d == 2 and not unknown.all():
            raise LogError("positions with headings need covariances (N, 3, 3), of x, y and heading")
        if C.shape not in ((d, d), (count, d, d)):
            wanted = f"({count}, 2, 2) or ({count}, 3, 3)"
            raise LogError(f"the covariances of positions must have shape {wanted}, not {C.shape}")
        covariances[:, :d, :d] = C
        cut_headings(covariances, unknown)
        covariances = checked_covariances("positions", covariances, count, 3)
        covariances[unknown, 2] = covariances[unknown, :, 2] = np.nan
        levers = _for_each("the levers of positions", self.levers, (count,), (2,))
        levers = finite_floats("the levers of positions", levers, (count, 2))
        datums = _for_each("the datums of positions", self.datums, (count,), (3,))
        known = finite_floats("the datums of positions", datums[~np.isnan(datums).all(axis=-1)], (None, 3))
        if (k := first(np.abs(known[:, 0]) > 90)) is not None:
            raise LogError(f"a datum of positions has the latitude {known[k, 0]:g}, which is beyond 90 degrees")
        self._set(steps=steps, places=places, covariances=covariances, levers=levers, datums=datums)

    @property
    def datum(self) -> Array | None:
        """The first datum (3,) that is known; None where none is."""
        known = self.datums[np.isfinite(self.datums[:, 0])]
        return known[0] if len(known) else None

    @property
    def oriented(self) -> np.ndarray:
        """Whether the heading is measured, too, (N,) bool."""
        return np.isfinite(self.places[:, 2])


@dataclass(frozen=True, eq=False, kw_only=True)
class PartialSightings(_Records):
    """K sightings of landmarks with one number, a range or a bearing. All arrays are copied, checked and made read-only.

    `edges.observation` has the residuals. The noise is that of the sensor model.

    Args:
        steps: (K,) the step of each.
        landmarks: (K,) the ids; there are none without an id.
        ranges: (K,) [m], NaN where the bearing was measured.
        bearings: (K,) [rad], NaN where the range was measured; wrapped to [-pi, pi).

    Raises:
        LogError: an array has another shape, a row has both numbers or none, or no id, or a range is not above zero.
    """

    ENDS = ("steps",)

    steps: np.ndarray
    landmarks: np.ndarray
    ranges: Array
    bearings: Array

    def __post_init__(self) -> None:
        ranges = _floats("the ranges of sightings", self.ranges)
        bearings = _floats("the bearings of sightings", self.bearings)
        count = len(ranges) if ranges.ndim == 1 else 0
        if ranges.shape != (count,) or bearings.shape != (count,):
            raise LogError(f"ranges and bearings must have shape (K,), not {ranges.shape} and {bearings.shape}")
        if (k := first(np.isnan(ranges) == np.isnan(bearings))) is not None:
            neither, both = "neither range nor bearing", "both range and bearing: it is a whole sighting"
            raise LogError(f"partial sighting {k} has {neither if np.isnan(ranges[k]) else both}")
        measured = ~np.isnan(ranges)
        if (k := first(measured & ~((ranges > 0) & (ranges < np.inf)))) is not None:
            raise LogError(f"partial sighting {k} has range {ranges[k]:g} m; a range must be finite and above zero")
        bearings[~measured] = wrap(finite_floats("the bearings of partial sightings", bearings[~measured], (None,)))
        noun = "partial sighting"
        steps = whole_numbers("the steps of partial sightings", self.steps, count, noun=noun)
        landmarks = whole_numbers("the landmarks of partial sightings", self.landmarks, count, noun=noun)
        if (k := first(np.isin(landmarks, (UNIDENTIFIED, NO_ID)))) is not None:
            raise LogError(f"partial sighting {k} has no id, which a range or a bearing alone needs: leave it out")
        self._set(steps=steps, landmarks=landmarks, ranges=ranges, bearings=bearings)

    @property
    def ranged(self) -> np.ndarray:
        """Whether the range is measured, and not the bearing, (K,) bool."""
        return np.isfinite(self.ranges)


def cut_headings(covariances: Array, rows: np.ndarray, variance: float = 1.0) -> None:
    """Give the headings of some rows of covariances (N, 3, 3) this variance, and no covariance with x and y."""
    covariances[rows, 2], covariances[rows, :, 2] = 0.0, 0.0
    covariances[rows, 2, 2] = variance


def checked_covariances(name: str, value: Any, count: int, d: int) -> Array:
    """Covariances (count, d, d) that are symmetric and positive definite; one matrix is for all.

    Raises:
        LogError: they are not; the message calls them those of ``name``.
    """
    what = f"the covariances of {name}"
    covariances = finite_floats(what, _for_each(what, value, (count,), (d, d)), (count, d, d))
    if (k := first(not_positive(covariances))) is not None:
        raise LogError(f"the covariance of row {k} of {name} {NOT_POSITIVE}")
    return (covariances + np.swapaxes(covariances, 1, 2)) / 2


def symmetric(upper: Array, places: Sequence[tuple[int, int]] | None = None) -> Array:
    """Symmetric matrices (N, d, d) from their upper triangles (N, d (d + 1) / 2), by rows or at these (row, column)."""
    d = int((2 * upper.shape[1]) ** 0.5)
    i, j = np.triu_indices(d) if places is None else np.transpose(places)
    whole = np.empty((len(upper), d, d))
    whole[:, i, j] = whole[:, j, i] = upper
    return whole


#: what is wrong with a covariance, and what to do
NOT_POSITIVE = (
    "is not symmetric and positive definite: its diagonal holds variances, above zero, and a covariance between two "
    "coordinates is smaller than the product of their standard deviations; are these correlations, or columns in another "
    "order?"
)


def not_positive(covariances: Array) -> np.ndarray:
    """Which of the covariances (N, d, d) are not symmetric and positive definite to double precision, (N,) bool."""
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    size = np.sqrt(np.where(variances > 0, variances, 1.0))
    unit = covariances / (size[:, :, None] * size[:, None, :])
    wrong = np.any(variances <= 0, axis=1) | np.any(np.abs(unit - np.swapaxes(unit, 1, 2)) > 1e-6, axis=(1, 2))
    smallest = np.linalg.eigvalsh(unit)[:, 0] if len(unit) else np.zeros(0)
    return np.asarray(wrong | ~(smallest > 1e-13))


Measured = PoseRelations | AbsolutePositions | PartialSightings
#: what a log may hold beside its sightings, by the names of its arguments
MEASURED: dict[str, type[Measured]] = {
    "relations": PoseRelations, "positions": AbsolutePositions, "partial_sightings": PartialSightings,
}  # fmt: skip


def checked_steps(steps: ArrayLike, poses: int) -> np.ndarray:
    """Increasing steps (K,) int64 of a log with so many poses, or a `LogError`."""
    kept = array_of("steps", steps)
    increasing = kept.ndim == 1 and len(kept) > 0 and not np.any(kept % 1) and np.all(np.diff(kept) > 0)
    if not increasing or kept[0] < 0 or kept[-1] >= poses:
        raise LogError(f"steps to keep must increase and lie between 0 and {poses - 1}")
    return kept.astype(np.int64)


def same(a: Any, b: Any) -> bool:
    """Whether two values of a log are exactly the same, arrays and mappings compared element by element."""
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, Measured):
        return a.equals(b)
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return np.array_equal(a, b, equal_nan=a.dtype.kind == b.dtype.kind == "f")
    return bool(a == b) if type(a) is type(b) else False


def checked_sightings(ids: Any, sightings: Any, refused: Collection[int], advice: str) -> tuple[np.ndarray, Array]:
    """Ids (k,) and sightings (k, 2 or 3) that are handed in one observation at a time, as new arrays.

    One of range and bearing may be NaN, which was not measured then, if the sightings have no psi.

    Args:
        ids: None stands for k times `UNIDENTIFIED`.
        refused: ids that stand for none, where an id is needed; the message is the ``advice``.

    Raises:
        OptionError: a value is impossible.
    """
    z = array_or_none(sightings)
    if z is not None and z.ndim == 1 and z.size:
        z = z[None]
    if ids is None:
        ids = np.full(len(z) if z is not None and z.ndim else 0, UNIDENTIFIED)
    numbers = np.zeros((0, 0)) if (given := _array_or_none(ids)) is None else np.atleast_1d(given)
    if z is not None and z.size == numbers.size == 0:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    if numbers.dtype.kind == "f" and np.all(np.abs(numbers) < 2**53) and not np.any(numbers % 1):
        numbers = numbers.astype(np.int64)  # a column of an array of numbers
    if numbers.ndim != 1 or (numbers.size and numbers.dtype.kind not in "iu"):
        raise OptionError(f"ids must be whole numbers, not {quoted(ids)}")
    if numbers.size and numbers.max() >= 2**63:
        raise OptionError(f"ids must be below 2^63, not {quoted(int(numbers.max()))}")
    numbers = numbers.astype(np.int64)
    if any(id in refused for id in numbers.tolist()):
        raise OptionError(advice)
    if z is None or z.ndim != 2 or z.shape[1] not in (2, 3) or not all(map(_is_sighting, z.tolist())):
        wanted = "(range, bearing) or with psi, finite and with ranges above zero"
        alone = "without psi NaN stands for a range or a bearing that was not measured"
        raise OptionError(f"sightings must be {wanted}; {alone}. They are {quoted(sightings)}")
    check_sighted("sightings", [angle for angle in z[:, 1:].ravel().tolist() if not math.isnan(angle)])
    if len(z) != len(numbers):
        message = f"each sighting needs the id of its landmark: there are {len(z)} sightings, ids {quoted(ids)}"
        raise OptionError(message)
    return numbers, z.copy()


def _is_sighting(row: list[float]) -> bool:
    """Whether the numbers of a sighting are possible; for so few, NumPy takes several times as long."""
    missing = sum(map(math.isnan, row))
    return missing <= (len(row) == 2) and not any(map(math.isinf, row)) and not row[0] <= 0
