"""Options: the declaration as a field of a dataclass, the check of its values, and the list of all options.

`comparisons.options` declares the options; the command line, TOML files and Python functions read them from `options_of`.

The options of verbs that read tables or bags of one's own: import and evaluate.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, ClassVar, Self, get_args, get_origin, get_type_hints

from fastslam.options import GibbsOptions
from graphslam.errors import OptionError, quoted
from graphslam.errors.checks import option, suggestion
from graphslam.log.table_options import TableOptions

#: fields of components that have another name among the options: (component, field) -> option
_RENAMED = {("sensor", name): f"sensor_{name}" for name in ("offset", "min_range", "max_range", "field_of_view")}
_RENAMED |= {("gibbs", f.name): f"gibbs_{f.name}" for f in fields(GibbsOptions)}

#: the group of the options that say what is written
OUTPUT = "Output"


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
        minimum, maximum, positive: limits of a number.
        default_text: how help names the default, where the value itself says too little.
        metavar: how help names the value.
        alias: a second name on the command line.
        panel: the group in the help of a verb; default: that of the dataclass.
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
    default_text: str = ""
    metavar: str = ""
    alias: str = ""
    panel: str = ""
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
        if value is None:
            return None
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
            value = Path(value)
        elif self.each in (int, float) and hasattr(value, "item"):
            value = value.item()  # a NumPy number
        checked: Any = value
        if not isinstance(value, self.each) or (isinstance(value, bool) and self.each is not bool):
            raise OptionError(f"{self.name} must be {self._wanted}, not {quoted(value)}")
        if self.choices and value not in self.choices:
            message = f"{self.name} must be one of {', '.join(self.choices)}, not {quoted(value)}"
            raise OptionError(message + suggestion(value, self.choices))
        if isinstance(value, float) and not math.isfinite(value) and value != self.default:
            raise OptionError(f"{self.name} must be a finite number, not {quoted(value)}")
        if self.minimum is not None and checked < self.minimum:
            raise OptionError(f"{self.name} must be at least {self.minimum:g}, not {quoted(value)}")
        if self.maximum is not None and checked > self.maximum:
            raise OptionError(f"{self.name} must be at most {self.maximum:g}, not {quoted(value)}")
        if self.positive and checked <= 0:
            raise OptionError(f"{self.name} must be a positive number, not {quoted(value)}")
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


@dataclass(frozen=True, kw_only=True)
class Options:
    """The base of all option dataclasses: makes one from keywords, checks every value, and lists what was changed.

    The fields of a component, which is a dataclass of another package, are options too. Those that are given are kept in
    ``numbers``; `of_component` returns those of one component.
    """

    #: the group of these options in the help of a verb
    panel: ClassVar[str] = ""
    components: ClassVar[Mapping[str, tuple[type, str]]] = {}
    #: fields of components that are no options here
    hidden: ClassVar[tuple[str, ...]] = ()
    numbers: Mapping[str, Any] = field(default_factory=dict, hash=False)

    @classmethod
    def of(cls, **given: Any) -> Self:
        """The options with the values given; None stands for the default.

        Raises:
            OptionError: there is no such option, or a value is impossible.
        """
        known = options_of(cls)
        given |= dict(given.pop("numbers", {}))
        given = {name: value for name, value in given.items() if value is not None}
        for name in given:
            if name not in known:
                raise OptionError(f"there is no option {quoted(name)}" + suggestion(name, known))
        numbers = {name: known[name].checked(given.pop(name)) for name in list(given) if known[name].model}
        return cls(**given, numbers=numbers)

    def __post_init__(self) -> None:
        for each in options_of(type(self)).values():
            if not each.model and each.only != "python":
                object.__setattr__(self, each.name, each.checked(getattr(self, each.name)))

    def changed(self) -> Iterator[tuple[Option, Any]]:
        """The options that differ from their defaults, with their values."""
        known = options_of(type(self))
        for each in known.values():
            if not each.model and getattr(self, each.name) != each.default:
                yield each, getattr(self, each.name)
        yield from ((known[name], value) for name, value in self.numbers.items())

    def with_numbers(self, **numbers: Any) -> Self:
        """The same options with other values of components."""
        return replace(self, numbers={**self.numbers, **numbers})

    def of_component(self, component: str) -> dict[str, Any]:
        """The fields of a component that are given, by the names that they have there."""
        known = options_of(type(self))
        return {known[name].field: value for name, value in self.numbers.items() if known[name].model == component}

    def keywords(self) -> dict[str, Any]:
        """The options that differ from their defaults, as keywords of a function that takes them."""
        return {option.name: value for option, value in self.changed()}


def options_of(group: type) -> dict[str, Option]:
    """The options of a dataclass by name, in their order; those of its components, too."""
    return _options_of(group)


@cache
def _options_of(group: Any) -> dict[str, Option]:
    hints = get_type_hints(group)
    options = {f.name: _option(f, hints[f.name], _panel(group, f.name)) for f in fields(group) if "help" in f.metadata}
    for component, (kind, panel) in getattr(group, "components", {}).items():
        for each in options_of(kind).values():
            name = _RENAMED.get((component, each.name), each.name)
            if name not in options and name not in group.hidden:
                options[name] = replace(each, name=name, model=component, panel=panel)
    return options


def _panel(group: type, name: str) -> str:
    """The panel of the class that declares a field."""
    return next(getattr(kind, "panel", "") for kind in group.__mro__ if name in inspect.get_annotations(kind))


def _option(f: Any, hint: Any, panel: str) -> Option:
    if get_origin(hint) is UnionType:
        hint = next(part for part in get_args(hint) if part is not NoneType)
    kind, each = (tuple, get_args(hint)[0]) if get_origin(hint) is tuple else (hint, hint)
    if get_origin(each) is tuple:
        kind = each = Points
    default = f.default if f.default_factory is MISSING else f.default_factory()
    return Option(name=f.name, field=f.name, kind=kind, each=each, default=default, **{"panel": panel, **f.metadata})


@dataclass(frozen=True, kw_only=True)
class ImportOptions(Options):
    """Options of `importing.import_log`: the tables or topics of a drive, and how they are read."""

    panel = "Tables and topics"
    components = {"tables": (TableOptions, "Units, clocks, columns and axes")}
    odometry: str | None = option(
        None, "Table or topic of the odometry.", metavar="FILE|TOPIC", default_text="found by name and type"
    )
    sightings: str | None = option(None, "Table or topic of the sightings.", metavar="FILE|TOPIC")
    truth: str | None = option(None, "Table or topic of the true poses.", metavar="FILE|TOPIC")
    map: str | None = option(None, "Table of the true landmarks.", metavar="FILE")
    relations: str | None = option(None, "Table of measured relations between two poses.", metavar="FILE")
    positions: str | None = option(None, "Table of measured absolute positions, such as GPS.", metavar="FILE")
    recipe: Path | None = option(
        None, "TOML file with these options, files, topics and columns; see docs/own_robot.md.", metavar="FILE",
        default_text="import.toml in the folder",
    )  # fmt: skip
    keep_every: float | None = option(
        None, "Also keep a pose at least once in this time, even where nothing was seen.", unit="s", positive=True,
        default_text="poses only where something was seen", panel=OUTPUT,
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class EvaluationOptions(Options):
    """How `evaluation.evaluate` compares estimates with the ground truth.

    In the options of tables, truth=... holds for the ground truth, estimates=... for the estimates, and a value without a
    table for all trajectories.
    """

    components = {"tables": (TableOptions, "Tables of trajectories")}
    hidden = ("axes", "centre", "bearings", "sensor_offset", "truth_offset", "sensor_yaw")
    true_map: Path | None = option(
        None, "The true map (.csv, .npz, .yaml, .geojson).", metavar="FILE", default_text="that of a log"
    )
    maps: tuple[Path, ...] | None = option(
        None, "The maps of the estimates, in their order; - for none.", metavar="FILE,..."
    )
    match: str = option(
        "id", "How the error of a map finds pairs of landmarks: by their ids, or by place within the cutoff.",
        choices=("id", "place"),
    )  # fmt: skip
    cutoff: float = option(
        1.0, "A landmark farther than this from every true one is false; of GOSPA.", unit="m", positive=True
    )
    longest_gap: float = option(
        1.0, "The truth is interpolated across gaps that are not longer than this.", unit="s", positive=True
    )
