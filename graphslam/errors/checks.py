"""Options: their declaration as fields of a dataclass, the checks of their values, and the messages of these checks.

A field made by `option` is an option. The command line, TOML files and Python functions read its name, type, default, unit,
limits and help from `declared_in`; `check_options` checks the values of an object.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import MISSING, dataclass, field, fields
from functools import cache
from numbers import Integral, Real
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import ArrayLike

from . import OptionError, quoted, shortened

#: beyond these values numbers are probably in another unit: range [m], speed [m/s], turn rate [rad/s], time of a control [s].
#: Tables with such numbers are refused unless their unit is stated, `log_checks` reports them, and factors refuse turn rates.
FARTHEST, FASTEST, QUICKEST, LONGEST = 1000.0, 100.0, 2 * math.pi, 5.0
#: larger angles [rad] are probably in degrees: of a sighting or a turn, with what printing it to six digits may add; headings
WHOLE_TURN, FOUR_TURNS, SIX_TURNS = 2 * math.pi + 1e-6, 8 * math.pi, 12 * math.pi


def option(default: Any, help: str, unit: str = "", **more: Any) -> Any:
    """A field of an option dataclass: default, one sentence of help, and unit.

    The command line, configuration files and tables read help and unit from the ``metadata`` of
    `dataclasses.fields`, so that an option is declared once.

    Args:
        default: the default value.
        help: one sentence that says what the option does.
        unit: the unit of its value, for example "m/s"; empty where it has none.
        more: further entries of the metadata.
    """
    return field(default=default, metadata={"help": help, "unit": unit, **more})


def check_type(kind: type, **values: object) -> None:
    """Raise `OptionError` unless every keyword's value is None or of this type."""
    for name, value in values.items():
        if value is not None and not isinstance(value, kind):
            article = "an" if kind.__name__[0] in "AEIOU" else "a"
            raise OptionError(f"{name} must be {article} {kind.__name__}, not {quoted(value)}")


def check_choice(name: str, value: str, allowed: Collection[str]) -> None:
    """Raise `OptionError` unless ``value`` is one of ``allowed``."""
    if not isinstance(value, str) or value not in allowed:
        raise OptionError(f"{name} must be one of {', '.join(allowed)}, not {quoted(value)}")


def _is_real(value: object) -> bool:
    """Whether a value is a real number; NumPy's time spans count themselves among the whole numbers."""
    return type(value) is float or (isinstance(value, Real) and not isinstance(value, np.timedelta64))


def _check(values: Mapping[str, Any], holds: Callable[[Any], bool], wanted: str) -> None:
    """Raise `OptionError` for the first value that is no real number, or for which a condition does not hold."""
    for name, value in values.items():
        try:
            sound = _is_real(value) and holds(value)
        except OverflowError:  # a whole number beyond 1e308
            sound = False
        if not sound:
            raise OptionError(f"{name} must be {wanted}, not {quoted(value)}")


def check_positive(**values: float) -> None:
    """Raise `OptionError` unless every keyword's value is a positive finite number."""
    _check(values, lambda value: 0 < float(value) < math.inf, "a positive number")


def check_real(**values: float) -> None:
    """Raise `OptionError` unless every keyword's value is a number, which may be infinite or NaN."""
    _check(values, lambda value: isinstance(float(value), float), "a number")


def check_number(**values: float) -> None:
    """Raise `OptionError` unless every keyword's value is a finite number."""
    _check(values, lambda value: not isinstance(value, bool) and math.isfinite(value), "a finite number")


def check_not_negative(**values: float) -> None:
    """Raise `OptionError` unless every keyword's value is zero or above; infinity is allowed."""
    check_real(**values)
    for name, value in values.items():
        if not value >= 0:
            raise OptionError(f"{name} must not be negative, but is {quoted(value)}")


def check_count(**values: int) -> None:
    """Raise `OptionError` unless every keyword's value is a whole number, 0 or above."""
    _check(values, lambda value: isinstance(value, Integral) and not isinstance(value, bool), "a whole number")
    for name, value in values.items():
        if value < 0:
            raise OptionError(f"{name} must not be negative, but is {quoted(value)}")


def check_sighted(name: str, angles: Iterable[float]) -> None:
    """Raise `OptionError` where a bearing or an orientation is beyond 2 pi, as those of degrees are."""
    for angle in angles:
        if not abs(angle) <= WHOLE_TURN:
            raise OptionError(
                f"the bearing or orientation of {name} is {angle:g} rad, beyond 2 pi: is it in degrees? Give radians, "
                "np.deg2rad(...); if it is in radians, wrap it to [-pi, pi) with graphslam.se2.wrap"
            )


def check_heading(name: str, headings: ArrayLike) -> None:
    """Raise `OptionError` where a heading is beyond 8 pi, as those of degrees are."""
    if (
        heading := abs(headings) if isinstance(headings, float) else float(np.abs(headings).max(initial=0.0))
    ) > FOUR_TURNS:
        raise OptionError(
            f"the heading of {name} is {heading:g} rad, beyond 8 pi: is it in degrees? Give radians, np.deg2rad(...); if it "
            "is in radians, wrap it to [-pi, pi) with graphslam.se2.wrap"
        )


def check_turn_rate(omega: float, otherwise: str | None = None, most: float = SIX_TURNS) -> None:
    """Raise `OptionError` where a control turns by more than this [rad/s], as degrees per second do.

    Single wrong rates must not end a drive: 2000 degrees per second, the usual full scale of gyroscopes, pass by default.
    """
    if most < abs(omega) < math.inf:
        raise OptionError(
            f"the turn rate of control is {omega:g} rad/s, beyond {most / math.pi:g} pi: is it in degrees per second? "
            "Give radians, np.deg2rad(...); if the robot turns so fast, "
            + (otherwise or "give motion and covariance, as MotionModel.f and covariance do")
        )


def checked_deviations(name: str, value: Any) -> dict[str, float]:
    """Standard deviations by name, {"wheel_scale": 0.03}.

    Raises:
        OptionError: it is no mapping from names to positive finite numbers.
    """
    try:
        found = {str(key): float(real_array(each)) for key, each in dict(value).items()}
        if all(0 < each < np.inf for each in found.values()):
            return found
    except (TypeError, ValueError, OverflowError):
        pass
    raise OptionError(f"{name} must be positive numbers by name, such as {{'wheel_scale': 0.03}}, not {quoted(value)}")


def checked_offset(name: str, value: Any) -> tuple[float, float]:
    """A place on the robot, (ahead, left) [m]; a single number is the distance ahead.

    Raises:
        OptionError: it is neither, or not finite.
    """
    # True is no distance
    offset = None if isinstance(value, bool) else array_or_none(value)
    if offset is not None and offset.size == 1:
        offset = np.array([offset.item(), 0.0])
    if offset is None or offset.shape != (2,) or not np.all(np.isfinite(offset)):
        raise OptionError(f"{name} must be (ahead, to the left) in m, or one number ahead, not {quoted(value)}")
    return float(offset[0]), float(offset[1])


def real_array(value: Any) -> np.ndarray:
    """A value as an array of floating-point numbers; NumPy alone would also turn complex numbers and times into such.

    Raises:
        TypeError, ValueError, OverflowError: it is none.
    """
    array = np.asarray(value)
    if array.dtype.kind in "cmM":
        raise TypeError(f"numbers of the type {array.dtype} are not real")
    return np.asarray(value, dtype=float)


def array_or_none(value: Any) -> np.ndarray | None:
    """A value as an array of floating-point numbers of any shape, not copied where it is one; None where it is none."""
    try:
        return real_array(value)
    except (TypeError, ValueError, OverflowError):
        return None


def array_of(name: str, value: Any) -> np.ndarray:
    """A value as an array of floating-point numbers of any shape.

    Raises:
        OptionError: it is none.
    """
    if (array := array_or_none(value)) is None:
        raise OptionError(f"{name} must be an array of numbers, not {quoted(value)}")
    return array


def finite_numbers(name: str, value: Any, *shapes: tuple[int, ...]) -> np.ndarray:
    """A new array of finite numbers that has one of the shapes; its only row may be given as a vector.

    Args:
        name: of the argument, for messages.
        value: numbers, or objects with the methods ``x()``, ``y()`` and perhaps ``theta()``, such as `gtsam.Pose2`.
        shapes: the allowed ones.

    Raises:
        OptionError: the value has another shape, or is not finite.
    """
    try:
        array = real_array(_coordinates(value))
        # for few numbers math.isfinite is faster than NumPy's
        finite = all(map(math.isfinite, array.ravel().tolist())) if array.size < 16 else bool(np.isfinite(array).all())
    except Exception:  # objects that NumPy asks for numbers may raise anything
        finite = False
    if finite and array.shape not in shapes and (1, *array.shape) in shapes:
        array = array[None]
    if not finite or array.shape not in shapes:
        raise OptionError(f"{name} must be {' or '.join(_shaped(shapes))}, not {quoted(value)}")
    return array.copy()


def _coordinates(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [_coordinates(part) for part in value]
    if callable(getattr(value, "x", None)) and callable(getattr(value, "y", None)):
        return [getattr(value, part)() for part in ("x", "y", "theta") if hasattr(value, part)]
    return value


def _shaped(shapes: Iterable[tuple[int, ...]]) -> list[str]:
    """Shapes in words: '2 or 3 finite numbers', '5 rows of 3 finite numbers'."""
    lengths: dict[tuple[int, ...], list[str]] = {}
    for shape in shapes:
        lengths.setdefault(shape[:-1], []).extend(map(str, shape[-1:]))
    texts = []
    for leading, last in lengths.items():
        rows = {1: "{} rows of ", 2: "{} arrays of {} rows of "}.get(len(leading), "").format(*leading)
        texts.append(f"{singular(rows)}{' or '.join(last)} finite numbers" if last else "a finite number")
    return texts


def checked_pose(name: str, value: Any) -> np.ndarray:
    """A pose (3,), or `gtsam.Pose2`, as a new array.

    Raises:
        OptionError: the value is no pose, or its heading is in degrees.
    """
    x = finite_numbers(name, value, (3,))
    check_heading(name, float(x[2]))
    return x


def checked_covariance(covariance: Any, d: int = 3) -> np.ndarray:
    """A covariance (d, d) that has an inverse.

    Raises:
        OptionError: it is not symmetric positive definite.
    """
    P = finite_numbers("covariance", covariance, (d, d))
    if np.abs(P - P.T).max() > 1e-9 * np.abs(P).max() or not np.linalg.eigvalsh(P)[0] > 0:
        message = f"covariance must be a symmetric positive definite {d} x {d} matrix, not {quoted(covariance)}"
        raise OptionError(message)
    return P


def check_move(control: Any, dt: Any, motion: Any, covariance: Any) -> None:
    """Raise `OptionError` unless a robot moves by a control and dt, or by a motion and its covariance."""
    if (control is None) == (motion is None):
        raise OptionError("move takes a control and dt, or a motion and its covariance")
    if motion is None and covariance is not None:
        raise OptionError("a covariance belongs to a measured motion; that of a control comes from the motion model")
    if motion is not None and dt is not None:
        raise OptionError("dt belongs to a control, and a measured motion needs none: leave dt out")


def from_home(path: Path) -> Path:
    """A path whose "~" at the start is replaced by the home folder; that of a user who does not exist stays."""
    with suppress(RuntimeError):
        return path.expanduser()
    return path


def first(wrong: ArrayLike) -> int | None:
    """The first index at which a condition (N,) holds, or None where it never does."""
    wrong = np.asarray(wrong, dtype=bool)
    return int(np.argmax(wrong)) if wrong.any() else None


def singular(text: str) -> str:
    """A text with '1 landmark' where it counts '1 landmarks'."""
    return re.sub(r"(?<![\w.,-])1 ([a-z]+[^\Wis])s\b", r"1 \1", text)


def listed(noun: str, numbers: list[int], most: int = 8) -> str:
    """'pose 3', 'poses 3 and 4', 'poses 1, 2, 3 and 40 more'."""
    if len(numbers) == 1:
        return f"{noun} {numbers[0]}"
    if len(numbers) > most:
        return f"{noun}s {', '.join(map(str, numbers[:most]))} and {len(numbers) - most} more"
    return f"{noun}s {', '.join(map(str, numbers[:-1]))} and {numbers[-1]}"


def suggestion(word: object, known: Collection[str]) -> str:
    """The end of a message about an unknown word: the known word that is spelled like it, if there is one."""
    matches = difflib.get_close_matches(shortened(str(word)), list(known), n=1)
    return f"; did you mean {quoted(matches[0])}?" if matches else ""


def check_known(who: str, given: Collection[str], known: Collection[str], more: str = "") -> None:
    """Raise `OptionError` for the first of the given options that ``who`` does not have; the message ends with ``more``."""
    for name in given:
        if name not in known:
            raise OptionError(f"{who} has no option {quoted(name)}{suggestion(name, known)}{more}")


def make_read_only(owner: object, *names: str) -> None:
    """Replace arrays, and lists of numbers, that are attributes of a frozen dataclass by views that cannot be written to."""
    for name in names:
        if isinstance(array := getattr(owner, name), np.ndarray | list | tuple):
            view = np.asarray(array).view()
            view.flags.writeable = False
            object.__setattr__(owner, name, view)


class Points:
    """The kind of options that are a list of points, or their number: 'x,y x,y ...' on the command line."""


@dataclass(frozen=True, kw_only=True)
class Option:
    """One option, as the command line, files and Python see it. The metadata of its field may have these attributes.

    Attributes:
        name: of the option; that of the field, except for some numbers of the noise models (``sensor_offset``).
        kind: str, int, float, bool or Path; ``tuple`` for several values; `Points` for a list of points.
        each: the kind of a single value.
        default: where nothing is given; None where it depends on the log.
        help, unit: one sentence, and the unit of a number.
        choices: the values that a text may have.
        minimum, maximum, positive, below: limits of a number; it has to be less than ``below``.
        optional: whether it may be None.
        other: types whose values are taken as they are.
        default_text: how help names the default, where the value itself says too little.
        metavar: how help names the value.
        panel: the group in the help of a verb.
        writes: the endings that the name of a file to write may have, () for any; None where nothing is written.
        only: "python" for a field that is no option of the command line.
        model: the component that it belongs to ("motion" and "sensor" for the noise models), else "".
        field: its name there.
    """

    name: str
    kind: type
    each: type
    default: Any
    help: str = ""
    unit: str = ""
    choices: tuple[str, ...] = ()
    minimum: float | None = None
    maximum: float | None = None
    positive: bool = False
    below: float | None = None
    optional: bool = True
    other: tuple[type, ...] = ()
    default_text: str = ""
    metavar: str = ""
    panel: str = ""
    writes: tuple[str, ...] | None = None
    only: str = ""
    model: str = ""
    field: str = ""

    @property
    def flag(self) -> str:
        """The option's name on the command line."""
        return "--" + self.name.replace("_", "-")

    def checked(self, value: Any) -> Any:
        """The value in the option's type, from Python, TOML, or the text of the command line ("a,b" for several).

        Raises:
            OptionError: it has the wrong type, is none of the choices, or is out of range.
        """
        if (value is None and self.optional) or isinstance(value, self.other):
            return value
        if self.kind is Points:
            return self._points(value)
        if self.kind is not tuple:
            return self._single(value)
        parts = value
        if isinstance(value, str):
            words = [word.strip() for word in value.split(",")]
            try:
                parts = [self.each(word) for word in words if word or self.each is not str]
            except ValueError:
                raise OptionError(f"{self.name} must be {self._wanted}, not {quoted(value)}") from None
        if not isinstance(parts, (list, tuple)) or not (parts or self.name == "figures"):
            raise OptionError(f"{self.name} must be {self._wanted}, at least one, not {quoted(value)}")
        return tuple(dict.fromkeys(map(self._single, parts)) if self.each is str else map(self._single, parts))

    def _points(self, value: Any) -> Any:
        if isinstance(value, str):
            try:
                rows = [tuple(float(number) for number in word.split(",")) for word in value.split()]
                value = int(value) if "," not in value else rows
            except ValueError:
                raise OptionError(f"{self.name} must be points 'x,y x,y ...', not {quoted(value)}") from None
        if not isinstance(value, (int, list, tuple)) or isinstance(value, bool):
            raise OptionError(f"{self.name} must be a list of points, not {quoted(value)}")
        if isinstance(value, int):
            return value
        points = tuple(tuple(row) if isinstance(row, (list, tuple)) else (row,) for row in value)
        numbers = [number for point in points for number in point]
        finite = all(isinstance(number, (int, float)) and math.isfinite(number) for number in numbers)
        if len(set(map(len, points))) != 1 or not finite:
            raise OptionError(f"{self.name} must be points of finite numbers, 'x,y x,y ...', not {quoted(value)}")
        return points

    def _single(self, value: Any) -> Any:
        if self.each is float and isinstance(value, int) and not isinstance(value, bool):
            try:
                value = float(value)
            except OverflowError:
                raise OptionError(f"{self.name} must be a number below 1e308, not {quoted(value)}") from None
        elif self.each is Path and isinstance(value, str):
            value = from_home(Path(value))
        elif self.each in (int, float) and getattr(value, "size", 0) == 1 and value.dtype != "timedelta64":
            value = value.item()  # a NumPy number
        checked: Any = value
        if not isinstance(value, self.each) or (isinstance(value, bool) and self.each is not bool):
            raise OptionError(f"{self.name} must be {self._wanted}, not {quoted(value)}")
        if self.choices and value not in self.choices:
            message = f"{self.name} must be one of {', '.join(self.choices)}, not {quoted(value)}"
            raise OptionError(message + suggestion(value, self.choices))
        if isinstance(value, float) and not math.isfinite(value) and value != self.default:
            raise OptionError(f"{self.name} must be a finite number, not {quoted(value)}")
        for limit, broken in (
            (f"must be at least {_number(self.minimum)}", self.minimum is not None and checked < self.minimum),
            (f"must be at most {_number(self.maximum)}", self.maximum is not None and checked > self.maximum),
            (f"must be below {_number(self.below)}", self.below is not None and checked >= self.below),
            ("must be a positive number", self.positive and checked <= 0),
        ):
            if broken:
                share = 1 in (self.maximum, self.below)
                raise OptionError(f"{self.name} {'must lie between 0 and 1' if share else limit}, not {quoted(value)}")
        return value

    @property
    def _wanted(self) -> str:
        names = {str: "text", int: "a whole number", float: "a number", bool: "true or false", Path: "a path"}
        several = {str: "names", int: "whole numbers", float: "numbers"}
        return several[self.each] if self.kind is tuple else names[self.each]

    def text(self, value: Any) -> str:
        """The value as one word of a command line."""
        if self.kind is Points and isinstance(value, tuple):
            return " ".join(",".join(f"{number:g}" for number in row) for row in value)
        return ",".join(map(str, value)) if isinstance(value, (tuple, list)) else str(value)


def _number(limit: float | None) -> str:
    return f"{limit:,}" if isinstance(limit, int) else f"{limit or 0:g}"


@cache
def declared_in(kind: Any) -> dict[str, Option]:
    """The options that are fields of a dataclass, by name."""
    hints = get_type_hints(kind)
    return {f.name: _option(f, hints[f.name]) for f in fields(kind) if "help" in f.metadata}


def _option(f: Any, hint: Any) -> Option:
    parts = get_args(hint) if get_origin(hint) is UnionType else (hint,)
    hint, *other = (part for part in parts if part is not NoneType)
    kind, each = (tuple, get_args(hint)[0]) if get_origin(hint) is tuple else (hint, hint)
    if get_origin(each) is tuple:
        kind = each = Points
    default = f.default if f.default_factory is MISSING else f.default_factory()
    return Option(
        name=f.name, field=f.name, kind=kind, each=each, default=default, optional=NoneType in parts, other=tuple(other),
        **f.metadata,
    )  # fmt: skip


def check_options(owner: Any) -> None:
    """Check the options of a frozen dataclass and put them into their types.

    Raises:
        OptionError: one has the wrong type, is none of the choices, or is out of range.
    """
    kind: Any = type(owner)
    for option in declared_in(kind).values():
        if option.only != "python":
            object.__setattr__(owner, option.name, option.checked(getattr(owner, option.name)))
