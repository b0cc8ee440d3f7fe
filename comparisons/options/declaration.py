"""Options: the declaration as a field of a dataclass, the check of its values, and the list of all options.

`comparisons.options` declares the options; the command line, TOML files and Python functions read them from `options_of`.

`ImportOptions` and `EvaluationOptions` are those of the two verbs that read your own tables or bags: import and evaluate.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Self

from fastslam.options import GibbsOptions
from graphslam.errors import OptionError, quoted
from graphslam.errors.checks import Option, check_options, declared_in, option, suggestion
from graphslam.log.rows import ReadOptions, TableOptions
from graphslam.models import SensorModel

#: fields of components that have another name among the options: (component, field) -> option
_RENAMED = {("sensor", name): f"sensor_{name}" for name in SensorModel.GEOMETRY}
_RENAMED |= {("gibbs", f.name): f"gibbs_{f.name}" for f in fields(GibbsOptions)}

#: the group of the options that say what is written
OUTPUT = "Output"


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
        check_options(self)

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
    options = {n: replace(each, panel=each.panel or _panel(group, n)) for n, each in declared_in(group).items()}
    for component, (kind, panel) in getattr(group, "components", {}).items():
        for each in options_of(kind).values():
            name = _RENAMED.get((component, each.name), each.name)
            if name not in options and name not in group.hidden:
                options[name] = replace(each, name=name, model=component, panel=panel)
    return options


def _panel(group: type, name: str) -> str:
    """The panel of the class that declares a field, or of the first class of options that derives from it."""
    declares = next(kind for kind in group.__mro__ if name in inspect.get_annotations(kind))
    heirs = (kind for kind in reversed(group.__mro__) if issubclass(kind, declares))
    return next((str(heir.panel) for heir in heirs if hasattr(heir, "panel")), "")


@dataclass(frozen=True, kw_only=True)
class ImportOptions(Options):
    """Options of `importing.import_log`: the tables or topics of a drive, and how they are read."""

    panel = "Tables and topics"
    components = {"tables": (TableOptions, "Units, clocks, columns and axes"), "reading": (ReadOptions, OUTPUT)}
    hidden = ("robot",)
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
    map: tuple[Path, ...] | None = option(
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
