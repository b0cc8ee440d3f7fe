"""The options of the command line, each declared once.

An option is a field of a dataclass: its name, type and default are those of the field, its help, unit,
choices and limits are the field's metadata (see `options.declaration`). The command line, configuration files, study files,
the printed next commands and the keywords of the Python functions all derive from these fields. Options of
the particle filters are fields of `fastslam.options`, those of edges and noise models fields of `graphslam.models`, and those
of the simulator are in `graphslam.simulation`. All others are declared here.

To add an option, add a field and use it where it takes effect.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from fastslam.options import FilterOptions, FrontEndOptions, GibbsOptions
from graphslam.edges.robust import KERNELS as ROBUST
from graphslam.errors import OptionError, quoted
from graphslam.errors.checks import option
from graphslam.identification.declared import PARAMETERS, parsed
from graphslam.log.rows import ReadOptions
from graphslam.maps.landmark_map import USES, LandmarkMap
from graphslam.metrics import METRICS as ERRORS
from graphslam.models import EDGES, EdgeOptions, MotionModel, SensorModel
from graphslam.simulation.simulator import MotionFaults, SensorFaults
from graphslam.simulation.worlds import WORLDS, World
from graphslam.solvers import INITIALIZE

from .declaration import OUTPUT, EvaluationOptions, ImportOptions, Option, Options, options_of  # noqa: F401

#: the noise models: parameter name of an estimator and table of a TOML file -> the model
MODELS: dict[str, type[MotionModel] | type[SensorModel]] = {"motion": MotionModel, "sensor": SensorModel}

#: robust kernels, and none
KERNELS = ("none", *ROBUST)

#: groups of options in the help of a verb
NOISE, FILTER, GIBBS = "Noise models", "Particle filters", "Particle smoother"


@dataclass(frozen=True, kw_only=True)
class ReadingOptions(Options, ReadOptions):
    """Options of reading a log, those of `graphslam.load` among them, and of the part of it that is kept."""

    panel = "Reading the log"
    format: str | None = option(None, "Format of the log: npz, lnpr, mrclam, huang, ...", default_text="by its content")
    truth_offset: tuple[float, ...] | None = option(
        None, "Point of the robot that the ground truth is of, such as a GPS antenna: forward, left.", unit="m",
        default_text="as the reader says",
    )  # fmt: skip
    stride: int = option(1, "Keep every N-th pose and the sightings from it.", minimum=1, metavar="N")
    max_range: float | None = option(None, "Leave out sightings from farther away.", unit="m", positive=True)
    dimensions: int | None = option(
        None, "3: require the orientation psi; 2: ignore it.", default_text="what the log has", minimum=2, maximum=3
    )


#: the values of ``noise`` that are no files: estimated from the log, and the lectures' values
AUTO, BOOK = Path("auto"), Path("book")
#: J per degree of freedom above this, or below its inverse, says that the noise models do not fit
DOUBTFUL = 2.0


def _correction(name: str) -> Any:
    """The option that takes one of `identification.declared.PARAMETERS` out of a log."""
    known = PARAMETERS[name]
    return option(
        None, f"{known.help}; corrected before anything else.", unit=known.unit, default_text=f"{known.ideal:g}",
        positive=name.endswith("_scale"),
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class NoiseOptions(Options):
    """The noise models. Beside these fields every number of `MotionModel` and `SensorModel` is an option by its name.

    Attributes:
        motion, sensor: whole models, in Python only.
        numbers: single numbers of the models, {"oo": 0.12}; they take precedence over all else.
    """

    panel = NOISE
    components = {name: (model, NOISE) for name, model in MODELS.items()}
    noise: Path | None = option(
        None, "File of noise models (TOML), written by calibrate. Single numbers take precedence over it. auto: estimate "
        "noise, biases and misread ids from this log. book: the values of the lectures.",
        metavar="FILE", default_text="the log's models, else auto where the log can tell",
    )  # fmt: skip
    check_ids: bool | None = option(
        None, "Compare every id with the sightings around it, by the given noise: misread ids get the id of the landmark "
        "that fits, or are left out. What is estimated from the log (--noise auto) includes this.",
        default_text="with a noise file",
    )  # fmt: skip
    wheel_scale: float | None = _correction("wheel_scale")
    turn_scale: float | None = _correction("turn_scale")
    turn_rate_bias: float | None = _correction("turn_rate_bias")
    curvature_bias: float | None = _correction("curvature_bias")
    range_scale: float | None = _correction("range_scale")
    range_bias: float | None = _correction("range_bias")
    bearing_bias: float | None = _correction("bearing_bias")
    sensor_delay: float | None = _correction("sensor_delay")
    noise_content: Any = option(None, "What `read_noise` finds in a noise file, instead of the file.", only="python")
    motion: MotionModel | None = option(None, "The motion model.", only="python")
    sensor: SensorModel | None = option(None, "The sensor model.", only="python")
    # a `Calibration`, whose import takes seconds
    calibration: Any = option(None, "What was estimated from the log; a result of reading.", only="python")

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
    """Options of `reading.prepare`."""


@dataclass(frozen=True, kw_only=True)
class GraphOptions(Options, EdgeOptions):
    """The graph and how it is solved; see `graphslam.Graph.from_log` and `graphslam.solve`."""

    panel = "Graph"
    kernel: str | None = option(
        None, "Robust kernel against wrong sightings; gnc is graduated non-convexity.",
        choices=(*KERNELS, "gnc"), default_text="cauchy on real data, none on logs of simulate",
    )  # fmt: skip
    initialize: str = option("auto", "Where the iteration starts; auto tries several starts.", choices=INITIALIZE)
    estimate: tuple[str, ...] | None = option(
        None, "Parameters of robot and sensor to estimate with the poses, relative to what is recorded: "
        f"{', '.join(PARAMETERS)}. NAME:0.1 gives a prior with this standard deviation.", metavar="NAME[:STD],...",
        default_text="none",
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class MapOptions(Options):
    """A map to localise in; see `graphslam.LandmarkMap`."""

    panel = "Graph"
    map: Path | None = option(
        None, "Map of landmarks to localise in (.csv, .npz, .yaml, .geojson), such as graph-map.npz of an earlier run. "
        "The log needs neither ids nor a start pose.", metavar="FILE", default_text="none",
    )  # fmt: skip
    map_use: str = option(
        USES[0], "Errors of the map: joint, all that it says; own, without correlations; fixed, exact.", choices=USES
    )
    bound: tuple[float, ...] = option(
        (0.5, 5.0), "Bounds on position and heading: with a map, results say how probable it is that a pose is off by more.",
        unit="m, degrees", positive=True, metavar="M,DEGREES",
    )  # fmt: skip
    landmark_map: LandmarkMap | None = option(None, "The map itself, instead of a file.", only="python")
    landmark_states: Any = option(None, "What the log says about its landmarks; a result of reading.", only="python")

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.bound) != 2:
            raise OptionError(f"bound must be two numbers, metres and degrees, such as 0.5,5, not {quoted(self.bound)}")
        if self.map is None and self.landmark_map is None:
            for name in ("map_use", "bound"):
                if getattr(self, name) != getattr(MapOptions, name):
                    raise OptionError(f"{name} is about a map to localise in; name it with map (--map FILE)")


@dataclass(frozen=True, kw_only=True)
class OnlineOptions(Options):
    """The estimator ``online``."""

    panel = "Graph"
    lag: int | None = option(
        None, "Steps after which online marginalises a pose, which is then final.", minimum=1, default_text="never"
    )


@dataclass(frozen=True, kw_only=True)
class AssociationOptions(Options, FrontEndOptions):
    """Options of the association for estimators that solve graphs, where the log has no ids or they are ignored."""

    panel = "Graph"


@dataclass(frozen=True, kw_only=True)
class SmootherOptions(Options):
    """The particle smoother: the fields of `fastslam.GibbsOptions`, whose names begin with ``gibbs_`` here."""

    components = {"gibbs": (GibbsOptions, GIBBS)}

    @property
    def gibbs(self) -> GibbsOptions:
        """The options of the particle smoother."""
        return GibbsOptions(**self.of_component("gibbs"))


@dataclass(frozen=True, kw_only=True)
class RunOptions(MapOptions, OnlineOptions, AssociationOptions, GraphOptions, LogOptions, SmootherOptions):
    """All options of a run: reading, noise, graph, filters and smoother; ``comparisons.run(log, kernel="huber")``."""

    components = LogOptions.components | {"filter": (FilterOptions, FILTER)} | SmootherOptions.components

    def __post_init__(self) -> None:
        super().__post_init__()
        # these check the values
        _ = self.filter, self.gibbs, parsed(self.estimate or ())

    @property
    def filter(self) -> FilterOptions:
        """The options of the particle filters."""
        return FilterOptions(**self.of_component("filter"))


@dataclass(frozen=True, kw_only=True)
class LimitOptions(Options):
    """Time limits."""

    time_limit: float | None = option(
        None, "Stop an estimator, backend, solver variant or filter that takes longer, and go on without it. The work is "
        "then done in processes of its own.", unit="s", positive=True, default_text="none",
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class EstimatorOptions(LimitOptions):
    """Which estimators run, and for how long."""

    estimators: tuple[str, ...] | None = option(
        None, "Estimators to run: dead-reckoning, textbook, graph, graph-marginal, graph-no-kernel, gtsam, online, "
        "isam2, mcl, fastslam1, fastslam2, particle-gibbs.", metavar="NAME,...",
        default_text="all that can run on the log, without graph-no-kernel, online and particle-gibbs",
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class OutputOptions(Options):
    """Output files of a run."""

    panel = OUTPUT
    out: Path | None = option(None, "Folder for the results.", metavar="DIR", default_text="results/<time>")
    figures: tuple[str, ...] = option(("png", "pdf"), "Formats of the figure.", choices=("png", "pdf", "svg"))
    live: bool = option(False, "Before the comparison, draw the map in the terminal while the online solver makes it.")
    html: Path | None = option(
        None, "Also write the interactive report, one HTML file.", metavar="FILE", writes=(".html", ".htm")
    )
    mcap: Path | None = option(
        None, "Also write poses and maps as MCAP with messages of ROS 2, for Foxglove and RViz.", metavar="FILE",
        writes=(".mcap",),
    )  # fmt: skip
    rerun: Path | None = option(
        None, "Also write poses and maps as a recording of Rerun (.rrd).", metavar="FILE", writes=(".rrd",)
    )


@dataclass(frozen=True, kw_only=True)
class JsonOptions(Options):
    """The JSON of every verb."""

    panel = OUTPUT
    json: str | None = option(
        None, "Write the results as JSON to a file; - writes them to standard output, and nothing else there.",
        metavar="FILE",
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class FigureOptions(Options):
    """The figure of a study."""

    panel = OUTPUT
    figure: Path | None = option(
        None, "Also write the figure (.png, .pdf, .svg).", metavar="FILE", writes=(".png", ".pdf", ".svg")
    )


@dataclass(frozen=True, kw_only=True)
class JobsOptions(Options):
    """Parallelism."""

    jobs: int | None = option(
        None, "Local processes; 0 runs everything in this process.", minimum=0, default_text="one for each core"
    )


@dataclass(frozen=True, kw_only=True)
class SolverCheckOptions(LimitOptions, JobsOptions, LogOptions):
    """Which variants `solvers.compare_solvers` solves by hand and with GTSAM."""

    motion_weights: tuple[float, ...] = option(
        (1.0, 10.0), "Factors lambda on the motion edges to try.", positive=True, metavar="LAMBDA,..."
    )
    edges: tuple[str, ...] = option(EDGES, "Kinds of graph to try.", choices=EDGES, metavar="EDGES,...")
    kernel: tuple[str, ...] = option(("none",), "Robust kernels to try.", choices=KERNELS, metavar="KERNEL,...")


@dataclass(frozen=True, kw_only=True)
class BackendOptions(LimitOptions):
    """Options of `backends.compare_backends`, which times pose-graph solvers."""

    backends: tuple[str, ...] | None = option(
        None, "Solvers to time.", choices=("graphslam", "gtsam-lm", "gtsam-gn", "g2o-gn", "g2o-lm"), metavar="NAME,...",
        default_text="all that are installed",
    )  # fmt: skip
    initialize: str = option("auto", "Where graphslam starts.", choices=INITIALIZE)
    same_start: bool = option(False, "All solvers start from the rotation-first state, not from the file's values.")
    repeat: int = option(5, "The time is the median of this many runs.", minimum=1)
    max_iterations: int = option(100, "Maximum number of iterations of every solver.", minimum=1)
    format: str | None = option(
        None, "Format of the files.", choices=("g2o", "toro", "isam"), default_text="by their tags"
    )


@dataclass(frozen=True, kw_only=True)
class ParticleStudyOptions(LimitOptions, JobsOptions, LogOptions):
    """Options of `particles.study_particles`, which varies the number of particles."""

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
class ConsistencyOptions(JobsOptions, SmootherOptions):
    """Options of `consistency.study_consistency`."""

    logs: int = option(200, "Number of simulated logs.", minimum=1)
    noise: float = option(0.1, "Factor on all standard deviations of the book's models.", minimum=1e-3, maximum=10.0)
    steps: int = option(62, "Motions of each log.", minimum=1)
    dimensions: int = option(3, "3: sightings with orientation psi; 2: without.", minimum=2, maximum=3)
    estimators: tuple[str, ...] = option(
        ("landmark nodes", "marginal", "tempered", "pairs"), "Estimators to test.",
        choices=("landmark nodes", "marginal", "tempered", "pairs", "fastslam1", "fastslam2", "particle-gibbs"),
        metavar="NAME,...",
    )  # fmt: skip
    seed: int = option(0, "Random seed of the first log; the others follow.", minimum=0)

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self.gibbs  # checks the values


@dataclass(frozen=True, kw_only=True)
class AnimationOptions(Options):
    """The animation of an estimator."""

    estimator: str = option(
        "graph", "Estimator to animate; association: what was found for sightings without ids.",
        choices=("graph", "association", "fastslam1", "fastslam2", "mcl", "isam2", "particle-gibbs"),
    )  # fmt: skip
    fps: float | None = option(
        None, "Frames per second.", default_text="2 for iterations, 10 for steps and sweeps", positive=True, panel=OUTPUT,
    )  # fmt: skip
    max_frames: int = option(200, "Maximum number of frames; longer runs are thinned evenly.", minimum=2, panel=OUTPUT)


@dataclass(frozen=True, kw_only=True)
class CalibrationOptions(ReadingOptions):
    """Options of `graphslam.calibrate`; of the sensor only its place is given."""

    components = {"sensor": (SensorModel, NOISE)}
    hidden = tuple(f.name for f in fields(SensorModel) if f.name != "offset")

    robots: tuple[int, ...] | None = option(
        None, "Several robots of each data set, all calibrated together.", minimum=0, metavar="N,...",
        panel=ReadingOptions.panel,
    )  # fmt: skip
    source: str = option(
        "auto", "Where the noise is measured: against the ground truth, or from the log alone (residuals). auto "
        "takes the ground truth where there is one; without a true map for the motion only.",
        choices=("auto", "truth", "residuals"),
    )  # fmt: skip
    gaussian: bool = option(
        False,
        "With the ground truth, count every residual fully, those of wrong sightings too; the default is Student's t "
        "distribution.",
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
        kinds = ("motion_faults", "sensor_faults")
        faults = {name: self.components[name][0](**given) for name in kinds if (given := self.of_component(name))}
        noise_given = {name for model in MODELS for name in self.of_component(model)} - {*SensorModel.GEOMETRY}
        if not world.clean and noise_given:
            message = "the noise models have an effect in clean worlds only: add --clean, or set faults instead"
            raise OptionError(message)
        return {"world": world, "seed": self.seed, **noise, **faults}


@dataclass(frozen=True, kw_only=True)
class SweepOptions(JobsOptions):
    """Options of `studies.sweep`."""

    dask: str | None = option(
        None, "Run on the cluster of this Dask scheduler instead, tcp://host:8786.", metavar="ADDRESS"
    )
    retry: bool = option(False, "Repeat the runs that failed or exceeded the time limit.")


#: the figures that studies summarise, and their names in tables and on axes
METRICS = {
    **{name: f"{about['title']} [{about['unit']}]" for name, about in ERRORS.items()},
    "cost_per_dof": "J per degree of freedom",
    "iterations": "iterations",
    "mean_ate_m": "ATE, mean of histories [m]",
    "ess_share": "ESS / N",
    "ancestors": "ancestors half-way",
    "seconds": "time [s]",
}


@dataclass(frozen=True, kw_only=True)
class SummaryOptions(FigureOptions):
    """Options of `studies.summarise`."""

    baseline: str | None = option(
        None, "Method that the others are compared with.", metavar="METHOD", default_text="graph, or the first"
    )
    metric: str = option("ate_m", "Metric of the figure.", choices=tuple(METRICS))
    csv: Path | None = option(None, "Write every run as CSV.", metavar="FILE", writes=(), panel=OUTPUT)
    summary: Path | None = option(
        None, "Write the summary, not the runs: .csv with all digits, or .tex with the printed tables.", metavar="FILE",
        writes=(".csv", ".tex"), panel=OUTPUT,
    )  # fmt: skip
    jsonl: Path | None = option(None, "Write every run as a line of JSON.", metavar="FILE", writes=(), panel=OUTPUT)
