"""Every option of the project, declared once.

An option is a field of one of the dataclasses below: its name, type and default are those of the field, its help, unit,
choices and limits are the field's metadata. The command line, configuration files, study files, the printed next
commands and the keywords of the Python functions all derive from these fields (`options_of`). The numbers of the noise
models are the fields of `graphslam.MotionModel` and `graphslam.SensorModel`, and are not repeated here.

To add an option, add a field here and use it where it takes effect.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, ClassVar, Self, get_args, get_origin, get_type_hints

from fastslam.options import FilterOptions
from graphslam.errors import OptionError
from graphslam.models import MotionModel, SensorModel
from graphslam.sources.simulator import MotionFaults, SensorFaults
from graphslam.sources.worlds import WORLDS, World

#: the noise models: parameter name of an estimator and table of a TOML file -> the model
MODELS: dict[str, type[MotionModel] | type[SensorModel]] = {"motion": MotionModel, "sensor": SensorModel}
#: fields of the models that have another name among the options
_RENAMED = {"offset": "sensor_offset"}

READING, NOISE, GRAPH, FILTER, OUTPUT = "Reading the log", "Noise models", "Graph", "Particle filters", "Output"


def option(
    default: Any, help: str, *, unit: str = "", choices: tuple[str, ...] = (), minimum: float | None = None,
    maximum: float | None = None, positive: bool = False, default_text: str = "", metavar: str = "", alias: str = "",
    panel: str = "", only: str = "",
) -> Any:  # fmt: skip
    """A field of an options dataclass.

    Args:
        default: the value where nothing is given; None where it depends on the log.
        help: one sentence.
        unit: of a number, "" for none.
        choices: the values that a text may have.
        minimum, maximum: the least and the greatest value of a number.
        positive: whether a number must be above zero.
        default_text: how help names the default, where the value itself says too little.
        metavar: how help names the value.
        alias: a second name on the command line.
        panel: the group in the help of a verb.
        only: "python" for a field that is no option of the command line.
    """
    return field(default=default, metadata={
        "help": help, "unit": unit, "choices": choices, "minimum": minimum, "maximum": maximum, "positive": positive,
        "metavar": metavar, "default_text": default_text, "alias": alias, "panel": panel, "only": only,
    })  # fmt: skip


class Points:
    """The kind of options that are a list of points, or their number: 'x,y x,y ...' on the command line."""


@dataclass(frozen=True, kw_only=True)
class Option:
    """One option, as the command line, files and Python see it.

    Attributes:
        name: of the field.
        kind: str, int, float, bool, Path, or for several values of a kind ``tuple``.
        each: the kind of a single value.
        default: where nothing is given.
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
                raise OptionError(f"{self.name} must be {self._wanted}, not {value!r}") from None
        if not isinstance(parts, (list, tuple)) or not (parts or self.name == "figures"):
            raise OptionError(f"{self.name} must be {self._wanted}, at least one, not {value!r}")
        return tuple(dict.fromkeys(map(self._single, parts)) if self.each is str else map(self._single, parts))

    def _points(self, value: Any) -> Any:
        if isinstance(value, str):
            try:
                rows = [tuple(float(number) for number in word.split(",")) for word in value.split()]
                value = int(value) if "," not in value else rows
            except ValueError:
                raise OptionError(f"{self.name} must be points 'x,y x,y ...', not {value!r}") from None
        if not isinstance(value, (int, list, tuple)) or isinstance(value, bool):
            raise OptionError(f"{self.name} must be a list of points, not {value!r}")
        return value if isinstance(value, int) else tuple(tuple(row) for row in value)

    def _single(self, value: Any) -> Any:
        if self.each is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        elif self.each is Path and isinstance(value, str):
            value = Path(value)
        elif self.each in (int, float) and hasattr(value, "item"):
            value = value.item()  # a NumPy number
        checked: Any = value
        if not isinstance(value, self.each) or (isinstance(value, bool) and self.each is not bool):
            raise OptionError(f"{self.name} must be {self._wanted}, not {value!r}")
        if self.choices and value not in self.choices:
            raise OptionError(
                f"{self.name} must be one of {', '.join(self.choices)}, not {value!r}; "
                f"did you mean {nearest(str(value), self.choices)!r}?"
            )
        if isinstance(value, float) and not math.isfinite(value) and value != self.default:
            raise OptionError(f"{self.name} must be a finite number, not {value!r}")
        if self.minimum is not None and checked < self.minimum:
            raise OptionError(f"{self.name} must be at least {self.minimum:g}, not {value}")
        if self.maximum is not None and checked > self.maximum:
            raise OptionError(f"{self.name} must be at most {self.maximum:g}, not {value}")
        if self.positive and checked <= 0:
            raise OptionError(f"{self.name} must be a positive number, not {value!r}")
        return value

    @property
    def _wanted(self) -> str:
        names = {str: "text", int: "a whole number", float: "a number", bool: "true or false", Path: "a path"}
        return f"a list, each {names[self.each]}" if self.kind is tuple else names[self.each]

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

    components: ClassVar[Mapping[str, tuple[type, str]]] = {}
    #: fields of components that are no options here
    hidden: ClassVar[tuple[str, ...]] = ()
    numbers: Mapping[str, Any] = field(default_factory=dict)

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
                raise OptionError(f"there is no option {name!r}; did you mean {nearest(name, known)!r}?")
        numbers = {name: known[name].checked(given.pop(name)) for name in list(given) if known[name].model}
        return cls(**given, numbers=numbers)

    def __post_init__(self) -> None:
        for each in options_of(type(self)).values():
            if not each.model and each.name not in MODELS:
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
    found = {f.name: _option(f, hints[f.name]) for f in fields(group) if "help" in f.metadata}
    components: Mapping[str, tuple[type, str]] = getattr(group, "components", {})
    hidden: tuple[str, ...] = getattr(group, "hidden", ())
    for component, (kind, panel) in components.items():
        for each in options_of(kind).values():
            name = _RENAMED.get(each.name, each.name)
            if name not in found and name not in hidden:
                found[name] = replace(each, name=name, model=component, panel=panel)
    return found


def _option(f: Any, hint: Any) -> Option:
    if get_origin(hint) is UnionType:
        hint = next(part for part in get_args(hint) if part is not NoneType)
    kind, each = (tuple, get_args(hint)[0]) if get_origin(hint) is tuple else (hint, hint)
    if get_origin(each) is tuple:
        kind = each = Points
    default = f.default if f.default_factory is MISSING else f.default_factory()
    return Option(name=f.name, field=f.name, kind=kind, each=each, default=default, **f.metadata)


def nearest(word: str, known: Collection[str]) -> str:
    """The known word that is most like a mistyped one."""
    return difflib.get_close_matches(word, list(known), n=1, cutoff=0.0)[0]


@dataclass(frozen=True, kw_only=True)
class ReadingOptions(Options):
    """How a log is read, and which part of it is kept."""

    format: str | None = option(
        None, "Format of the log: npz, lnpr, mrclam, huang, ...", default_text="by its content", panel=READING
    )
    robot: int | None = option(None, "The robot of a data set that has several.", minimum=0, panel=READING)
    keep_every: float | None = option(
        None, "Also keep a pose at least every so many seconds, even where nothing was seen.", unit="s", positive=True,
        default_text="poses only where something was seen", panel=READING,
    )  # fmt: skip
    stride: int = option(1, "Keep every N-th pose and the sightings from it.", minimum=1, metavar="N", panel=READING)
    max_range: float | None = option(
        None, "Leave out sightings from farther away.", unit="m", positive=True, panel=READING
    )
    dimensions: int | None = option(
        None, "3: require the orientation psi; 2: ignore it.", default_text="what the log has", minimum=2, maximum=3,
        panel=READING,
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class NoiseOptions(Options):
    """The noise models. Beside these fields every number of `MotionModel` and `SensorModel` is an option by its name.

    Attributes:
        motion, sensor: whole models, in Python only.
        numbers: single numbers of the models, {"range_std": 0.12}; they take precedence over all else.
    """

    components = {name: (model, NOISE) for name, model in MODELS.items()}
    noise: Path | None = option(
        None, "File of noise models (TOML), written by calibrate. Single numbers take precedence over it.",
        metavar="FILE", default_text="the log's models, else the book's", panel=NOISE,
    )  # fmt: skip
    range_scale: float | None = option(
        None, "Measured range = scale * range + bias; corrected before anything else.", default_text="1", positive=True,
        panel=NOISE,
    )  # fmt: skip
    range_bias: float | None = option(None, "The bias of the measured range.", unit="m", default_text="0", panel=NOISE)
    motion: MotionModel | None = option(None, "The motion model.", only="python", panel=NOISE)
    sensor: SensorModel | None = option(None, "The sensor model.", only="python", panel=NOISE)

    def models(
        self, motion: MotionModel | None = None, sensor: SensorModel | None = None
    ) -> tuple[MotionModel, SensorModel]:
        """The noise models: those of the options, else those given (of a log), else the book's, with `numbers` in them.

        Raises:
            OptionError: a number is impossible.
        """
        base = (self.motion or motion or MotionModel(), self.sensor or sensor or SensorModel())
        return base[0].changed(**self.of_component("motion")), base[1].changed(**self.of_component("sensor"))


@dataclass(frozen=True, kw_only=True)
class LogOptions(NoiseOptions, ReadingOptions):
    """What `reading.prepare` needs to know of a log."""


@dataclass(frozen=True, kw_only=True)
class GraphOptions(Options):
    """The graph and how it is solved; see `graphslam.Graph.from_log` and `graphslam.solve`."""

    edges: str | None = option(
        None, "Edges of the graph.", choices=("virtual", "virtual+motion", "landmark+motion"),
        default_text="what suits the log", panel=GRAPH,
    )  # fmt: skip
    frame: str = option("body", "Axes of the residuals.", choices=("body", "world"), panel=GRAPH)
    weight: str = option(
        "pairs", "Weight of virtual-motion edges: pairs as in the book; tempered and marginal count each sighting once.",
        choices=("pairs", "tempered", "marginal"), panel=GRAPH,
    )  # fmt: skip
    motion_weight: float = option(1.0, "Factor lambda on the motion edges.", positive=True, panel=GRAPH)
    kernel: str = option(
        "none", "Robust kernel against wrong sightings; gnc is graduated non-convexity.",
        choices=("none", "huber", "cauchy", "geman-mcclure", "gnc"), alias="robust", panel=GRAPH,
    )  # fmt: skip
    initialize: str = option(
        "auto", "Where the iteration starts; auto tries several starts.",
        choices=("auto", "given", "dead-reckoning", "rotation-first"), panel=GRAPH,
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class RunOptions(GraphOptions, LogOptions):
    """All options of a run: reading, noise, graph and filters. In Python: ``comparisons.run(log, kernel="huber")``."""

    components = LogOptions.components | {"filter": (FilterOptions, FILTER)}

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self.filter  # checks the values

    @property
    def filter(self) -> FilterOptions:
        """The options of the particle filters."""
        return FilterOptions(**self.of_component("filter"))


@dataclass(frozen=True, kw_only=True)
class EstimatorOptions(Options):
    """Which estimators run."""

    estimators: tuple[str, ...] | None = option(
        None, "Estimators to run: dead-reckoning, textbook, graph, gtsam, isam2, mcl, fastslam1, fastslam2.",
        metavar="NAME,...", default_text="all that can run on the log",
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class OutputOptions(Options):
    """Where the results of a run go."""

    out: Path | None = option(
        None, "Folder for the results.", metavar="DIR", default_text="results/<time>", panel=OUTPUT
    )
    figures: tuple[str, ...] = option(
        ("png", "pdf"), "Formats of the figure.", choices=("png", "pdf", "svg"), panel=OUTPUT
    )
    html: Path | None = option(None, "Also write the interactive report, one HTML file.", metavar="FILE", panel=OUTPUT)


@dataclass(frozen=True, kw_only=True)
class JsonOptions(Options):
    """The JSON of every verb."""

    json: str | None = option(
        None, "Write the results as JSON to a file; - writes them to standard output, and nothing else there.",
        metavar="FILE", panel=OUTPUT,
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class FigureOptions(Options):
    """The figure of a study."""

    figure: Path | None = option(None, "Also write the figure (.png, .pdf, .svg).", metavar="FILE", panel=OUTPUT)


@dataclass(frozen=True, kw_only=True)
class JobsOptions(Options):
    """How much runs at a time."""

    jobs: int | None = option(
        None, "Local processes; 0 runs everything in this process.", minimum=0, default_text="one for each core"
    )


@dataclass(frozen=True, kw_only=True)
class SolverCheckOptions(JobsOptions, LogOptions):
    """Which variants `solvers.compare_solvers` solves by hand and with GTSAM."""

    motion_weights: tuple[float, ...] = option(
        (1.0, 10.0), "Factors lambda on the motion edges to try.", positive=True, metavar="LAMBDA,..."
    )
    edges: tuple[str, ...] = option(
        ("virtual", "virtual+motion", "landmark+motion"), "Kinds of graph to try.",
        choices=("virtual", "virtual+motion", "landmark+motion"), metavar="EDGES,...",
    )  # fmt: skip
    kernel: tuple[str, ...] = option(
        ("none",), "Robust kernels to try.", choices=("none", "huber", "cauchy", "geman-mcclure"), alias="kernels",
        metavar="KERNEL,...",
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class BackendOptions(Options):
    """How `backends.compare_backends` times pose-graph solvers."""

    backends: tuple[str, ...] | None = option(
        None, "Solvers to time.", choices=("graphslam", "gtsam-lm", "gtsam-gn", "g2o-gn", "g2o-lm"), metavar="NAME,...",
        default_text="all that are installed",
    )  # fmt: skip
    initialize: str = option(
        "auto", "Where graphslam starts.", choices=("auto", "given", "dead-reckoning", "rotation-first")
    )
    same_start: bool = option(False, "All solvers start from the rotation-first state, not from the file's values.")
    repeat: int = option(5, "The time is the median of this many runs.", minimum=1)
    max_iterations: int = option(100, "Maximum number of iterations of every solver.", minimum=1)
    format: str | None = option(
        None, "Format of the files.", choices=("g2o", "toro", "isam"), default_text="by their tags"
    )


@dataclass(frozen=True, kw_only=True)
class ParticleStudyOptions(JobsOptions, LogOptions):
    """How `particles.study_particles` varies the number of particles."""

    components = LogOptions.components | {"filter": (FilterOptions, FILTER)}
    hidden = ("seed",)
    filters: tuple[str, ...] = option(
        ("fastslam1", "fastslam2"), "Filters to run.", choices=("mcl", "fastslam1", "fastslam2"), metavar="NAME,..."
    )
    particles: tuple[int, ...] = option(
        (10, 32, 100, 316, 1000, 3162, 10_000, 31_623, 100_000), "Numbers of particles.", minimum=1, metavar="N,..."
    )
    seeds: int = option(10, "Number of random seeds, starting from 0.", minimum=1)


@dataclass(frozen=True, kw_only=True)
class ConsistencyOptions(JobsOptions):
    """What `consistency.study_consistency` simulates and tests."""

    logs: int = option(200, "Number of simulated logs.", minimum=1)
    noise: float = option(0.1, "Factor on all standard deviations of the book's models.", minimum=1e-3, maximum=10.0)
    steps: int = option(62, "Motions of each log.", minimum=1)
    dimensions: int = option(3, "3: sightings with orientation psi; 2: without.", minimum=2, maximum=3)
    estimators: tuple[str, ...] = option(
        ("landmark nodes", "marginal", "tempered", "pairs"), "Estimators to test.",
        choices=("landmark nodes", "marginal", "tempered", "pairs", "fastslam1", "fastslam2"), metavar="NAME,...",
    )  # fmt: skip
    seed: int = option(0, "Random seed of the first log; the others follow.", minimum=0)


@dataclass(frozen=True, kw_only=True)
class AnimationOptions(Options):
    """The animation of an estimator."""

    estimator: str = option(
        "graph", "Estimator to animate.", choices=("graph", "fastslam1", "fastslam2", "mcl", "isam2")
    )
    fps: float | None = option(
        None, "Frames per second.", default_text="2 for iterations, 10 for steps", positive=True, panel=OUTPUT
    )
    max_frames: int = option(200, "Maximum number of frames; longer runs are thinned evenly.", minimum=2, panel=OUTPUT)


@dataclass(frozen=True, kw_only=True)
class CalibrationOptions(Options):
    """How `graphslam.calibrate` estimates noise."""

    source: str = option(
        "auto", "Where the noise is measured: against the ground truth, or from residuals of the solved graph. auto "
        "takes the ground truth where there is one.", choices=("auto", "truth", "residuals"),
    )  # fmt: skip
    gaussian: bool = option(
        False, "Count every residual fully, those of wrong sightings too; the default is Student's t distribution."
    )


@dataclass(frozen=True, kw_only=True)
class SimulationOptions(Options):
    """A simulated log: a world, the faults of the robot, and the noise models of a clean world."""

    components = {
        "settings": (World, "World"), "motion_faults": (MotionFaults, "Faults of the wheels"),
        "sensor_faults": (SensorFaults, "Faults of the camera"), "motion": (MotionModel, NOISE),
        "sensor": (SensorModel, NOISE),
    }  # fmt: skip
    world: str = option(
        "book", "Named world to start from; other options change it.", choices=tuple(WORLDS), panel="World"
    )
    seed: int = option(0, "Random seed; the same seed gives the same log.", minimum=0)

    def keywords_of_simulate(self) -> dict[str, Any]:
        """The keywords of `graphslam.simulate`.

        Raises:
            OptionError: an option is impossible, or has no effect.
        """
        world = replace(WORLDS[self.world], **self.of_component("settings"))
        noise = {name: model().changed(**self.of_component(name)) for name, model in MODELS.items()}
        faults = {
            n: self.components[n][0](**f) for n in ("motion_faults", "sensor_faults") if (f := self.of_component(n))
        }
        if not world.clean and any(self.of_component(name) for name in MODELS):
            raise OptionError(
                "the noise models have an effect in clean worlds only: add --clean, or set faults instead"
            )
        return {"world": world, "seed": self.seed, **noise, **faults}


@dataclass(frozen=True, kw_only=True)
class SweepOptions(JobsOptions):
    """How `studies.sweep` executes a study."""

    dask: str | None = option(
        None, "Run on the cluster of this Dask scheduler instead, tcp://host:8786.", metavar="ADDRESS"
    )
    retry: bool = option(False, "Repeat the runs that failed or exceeded the time limit.")


@dataclass(frozen=True, kw_only=True)
class SummaryOptions(FigureOptions):
    """What `studies.summarise` compares."""

    baseline: str | None = option(
        None, "Method that the others are compared with.", metavar="METHOD", default_text="graph, or the first"
    )
    metric: str = option(
        "ate_m", "Metric of the figure.",
        choices=("ate_m", "rpe_m", "rpe_rad", "landmark_rmse_m", "iterations", "seconds"),
    )  # fmt: skip
    csv: Path | None = option(None, "Write every run as CSV.", metavar="FILE", panel=OUTPUT)
    jsonl: Path | None = option(None, "Write every run as a line of JSON.", metavar="FILE", panel=OUTPUT)
