"""The JSON of every verb as typed models. What the verbs write and its schema (docs/schema.json) both come from here.

`document` fills a model from result objects whose attributes have the names of its fields. The docstring of a model and the
descriptions of its fields are those of the schema and of docs/json.md.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec
import numpy as np

from .saving import jsonable

if TYPE_CHECKING:
    from graphslam import Log
    from graphslam.parameters import ParameterEstimate

_MISSING = object()


class Document(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """The base of all models."""


def document(model: type[Document], *sources: object, **values: Any) -> dict[str, Any]:
    """The fields of a model as plain data for JSON, in their order.

    Args:
        model: names the fields.
        sources: objects; a field takes the attribute of its name from the first that has one.
        values: fields that are given here.

    Raises:
        AttributeError: no source has a field that is not given.
    """
    content = {}
    for field in msgspec.structs.fields(model):
        value = values.get(field.name, _MISSING)
        for source in sources:
            if value is _MISSING:
                value = getattr(source, field.name, _MISSING)
        if value is _MISSING:
            raise AttributeError(f"{model.__name__} needs a value for {field.name}")
        content[field.name] = value
    return jsonable(content)


def describe(log: Log, source: Path | None = None) -> dict[str, Any]:
    """A log in a few numbers and with its ground truth, for JSON."""
    return document(
        LogDocument,
        log,
        file=source,
        poses=log.num_poses,
        sightings=len(log.steps),
        landmarks=len(log.landmark_ids),
        dimensions=log.sightings.shape[1],
        has_controls=log.controls is not None,
        controls=None if log.controls is None else len(log.controls),
        poses_covered=int(np.count_nonzero(log.covered)),
    )


def about(text: str) -> msgspec.Meta:
    """The description of a field."""
    return msgspec.Meta(description=text)


Count = Annotated[int, msgspec.Meta(ge=0)]
Id = Annotated[str, msgspec.Meta(pattern="^-?[0-9]+$")]
Dimensions = Annotated[Literal[2, 3], about("columns of a sighting: 2 without, 3 with orientation psi")]
Pose = Annotated[
    list[float | None],
    msgspec.Meta(min_length=3, max_length=3, description="x [m], y [m], heading [rad]; null where unknown"),
]
Position = Annotated[
    list[float | None],
    msgspec.Meta(min_length=2, max_length=3, description="x, y [m] and, where the landmark has one, heading [rad]"),
]
Covariance = Annotated[
    list[list[float]],
    msgspec.Meta(min_length=2, max_length=3, description="n rows of n numbers, n as long as the mean"),
]
CostPerDof = Annotated[
    float | None,
    about("J per degree of freedom: about 1 where the noise models fit, more where they are too small or sightings are "
          "wrong, less where they are too large; null where nothing is minimised"),
]  # fmt: skip
Band = Annotated[list[float], msgspec.Meta(min_length=2, max_length=2, description="lower and upper end")]
Quartiles = Annotated[
    list[float], msgspec.Meta(min_length=3, max_length=3, description="25 %, 50 % and 75 % over the seeds")
]


class LogDocument(Document):
    """The log that the estimators worked on."""

    name: Annotated[str, about("name of the log")]
    file: Annotated[str | None, about("file or folder it was read from")]
    poses: Annotated[Count, about("number of poses, T + 1")]
    sightings: Annotated[Count, about("number of sightings")]
    landmarks: Annotated[Count, about("number of landmarks seen")]
    dimensions: Dimensions
    simulated: Annotated[bool, about("whether `simulate` made it; all others count as real data")]
    has_controls: Annotated[bool, about("whether there is odometry")]
    controls: Annotated[Count | None, about("number of controls")]
    poses_covered: Annotated[Count, about("number of poses whose ground truth is known")]
    true_poses: Annotated[list[Pose] | None, about("the true trajectory")]
    truth_offset: Annotated[
        list[float], about("the point of the robot that `true_poses` are of: ahead and to the left of its pose [m]")
    ]
    true_landmarks: Annotated[dict[Id, Position] | None, about("the true map, by id")]
    notes: Annotated[list[str], about("remarks of the reader")]


class CertificateDocument(Document):
    """Whether the end of a solver is proven to be the global minimum of its cost; see docs/certificate.md."""

    status: Annotated[
        Literal["global", "not proven", "not applicable"],
        about(
            "global: no state has a lower cost, up to `relative_gap`; not applicable: the theory does not cover the graph"
        ),
    ]
    lower_bound: Annotated[float | None, about("no state has a lower cost; null where not applicable")]
    relative_gap: Annotated[float | None, about("(J - lower_bound) / J; null where not applicable")]
    reason: Annotated[str, about("one sentence")]
    seconds: Annotated[float, about("time of the check [s]")]


def certificate_document(certificate: object | None) -> dict[str, Any] | None:
    """A `graphslam.Certificate` as plain data, or None."""
    return None if certificate is None else document(CertificateDocument, certificate)


class AssociationDocument(Document):
    """The ids that an estimator gave sightings itself; what needs true ids is null where there are none."""

    landmarks: Annotated[Count, about("landmarks that some sighting was given to")]
    clutter: Annotated[Count, about("sightings that are of no landmark")]
    precision: Annotated[float | None, about("correct sightings over sightings that were given a landmark")]
    recall: Annotated[float | None, about("correct sightings over sightings that truly are of a landmark")]
    found: Annotated[Count | None, about("true landmarks that are matched with one of the estimate")]
    missed: Annotated[Count | None, about("true landmarks without a match")]
    doubled: Annotated[Count | None, about("further landmarks made of sightings of a true one that is matched already")]
    invented: Annotated[Count | None, about("landmarks made mostly of clutter")]


class ParameterDocument(Document):
    """A parameter of robot or sensor that was estimated with the poses; see docs/parameters.md."""

    value: Annotated[float, about("its estimate")]
    deviation: Annotated[float, about("its standard deviation")]
    prior: Annotated[float | None, about("the standard deviation of its prior; null without one")]


def parameters_document(parameters: ParameterEstimate | None) -> dict[str, Any] | None:
    """Estimated parameters as plain data by name, or None."""
    if parameters is None:
        return None
    priors = {name: deviation for name, (_, deviation) in parameters.priors.items()}
    return {
        name: document(ParameterDocument, value=parameters[name], deviation=deviation, prior=priors.get(name))
        for name, deviation in parameters.deviations.items()
    }


class EstimatorDocument(Document):
    """The result of one estimator. Every metric is null where it cannot be known, or the estimator did not run."""

    name: Annotated[str, about("name of the estimator")]
    converged: Annotated[bool | None, about("whether the stop rule was met; null where nothing is iterated")]
    iterations: Annotated[Count | None, about("number of iterations")]
    step_norms: Annotated[list[float | None] | None, about("norm of the correction of each iteration")]
    cost: Annotated[float | None, about("J at the end")]
    cost_per_dof: CostPerDof
    seconds: Annotated[float | None, about("time of the estimation alone [s]")]
    ate_m: Annotated[float | None, about("absolute trajectory error [m]")]
    rpe_m: Annotated[float | None, about("relative pose error per step [m]")]
    rpe_rad: Annotated[float | None, about("relative pose error per step [rad]")]
    heading_rad: Annotated[float | None, about("error of the headings after alignment [rad]")]
    landmark_rmse_m: Annotated[float | None, about("error of the map in the aligned frame [m]")]
    landmark_errors_m: Annotated[
        dict[Id, float] | None, about("error of each landmark in the aligned frame [m], by id")
    ]
    aligned_by: Annotated[
        Literal["poses", "landmarks"] | None,
        about("what the estimate is aligned to the ground truth by: landmarks where no true poses are known"),
    ]
    nees: Annotated[float | None, about("mean NEES of the poses per degree of freedom; 1: consistent")]
    weighed_down: Annotated[
        Count | None,
        about("number of sightings that a robust kernel gives less than half of their weight; null without one"),
    ]
    association: Annotated[
        AssociationDocument | None, about("ids found for the sightings; null where the ids of the log were used")
    ]
    parameters: Annotated[
        dict[str, ParameterDocument] | None, about("estimated parameters by name; null where none was estimated")
    ]
    poses_counted: Annotated[Count | None, about("number of poses that the metrics are of")]
    poses: Annotated[list[Pose] | None, about("the trajectory, T + 1 poses")]
    estimated: Annotated[list[bool] | None, about("false where a pose is only the initial guess")]
    landmarks: Annotated[dict[Id, Position] | None, about("the map, by id")]
    landmark_covariances: Annotated[dict[Id, Covariance] | None, about("covariances of the map, by id")]
    options: Annotated[dict[str, Any], about("the options that the estimator used")]
    certificate: Annotated[CertificateDocument | None, about("proof of global optimality; null without a graph")]
    reason: Annotated[str, about("why it ended, or why it did not run")]
    notes: Annotated[list[str], about("remarks of the estimator")]


class NoiseDocument(Document):
    """A noise model of the run."""

    source: Annotated[
        Literal["book", "log", "given"],
        about("book: the defaults, those of the book; log: published with the log; given: by options or a noise file"),
    ]
    model: Annotated[dict[str, Any], about("fields of `graphslam.MotionModel` or `graphslam.SensorModel`")]


class RunDocument(Document):
    """`slam-compare run` and `report`, comparison.json."""

    log: LogDocument
    noise: Annotated[dict[str, NoiseDocument], about("the noise models `motion` and `sensor` of all estimators")]
    estimators: Annotated[list[EstimatorDocument], about("in the order of the table")]
    files: Annotated[dict[str, str], about("the files written, by kind or name")]
    notes: Annotated[list[str], about("files that could not be made, one sentence each")]
    warnings: Annotated[list[str], about("what is probably wrong with the log, with the likely cause")]


class SimulateDocument(Document):
    """`slam-compare simulate`."""

    file: Annotated[str, about("the file written")]
    log: LogDocument


class VariantDocument(Document):
    """One graph, solved by both solvers."""

    name: Annotated[str, about("edges, frame, weight, dimensions, factor on the motion edges, kernel")]
    pose_difference: Annotated[float | None, about("largest difference in any x, y [m] or heading [rad]")]
    cost_difference: Annotated[float | None, about("relative difference of J")]
    cost: Annotated[float | None, about("J of the hand-written solver")]
    cost_per_dof: CostPerDof
    iterations: Annotated[Count, about("of the hand-written solver")]
    gtsam_iterations: Annotated[Count, about("of GTSAM")]
    seconds: Annotated[float | None, about("of the hand-written solver [s]")]
    gtsam_seconds: Annotated[float | None, about("of GTSAM [s]")]
    converged: Annotated[bool, about("whether the hand-written solver converged")]
    gtsam_converged: Annotated[bool, about("whether GTSAM converged")]
    certificate: Annotated[CertificateDocument | None, about("proof for the end of the hand-written solver")]
    gtsam_certificate: Annotated[CertificateDocument | None, about("proof for the end of GTSAM")]
    failure: Annotated[str | None, about("why a solver failed")]
    agree: Annotated[bool, about("poses differ by less than 1e-6 and J by less than 1e-9 of it")]


class ReasonDocument(Document):
    """A graph that the log does not determine."""

    name: Annotated[str, about("as in `variants`")]
    reason: Annotated[str, about("why it was left out")]


class SolversDocument(Document):
    """`slam-compare solvers`."""

    variants: Annotated[list[VariantDocument], about("the graphs that were solved")]
    skipped: Annotated[list[ReasonDocument], about("the graphs that the log does not determine, or that took too long")]


class BackendDocument(Document):
    """One solver on one pose graph."""

    file: Annotated[str, about("the pose graph")]
    backend: Annotated[str, about("graphslam, gtsam-lm, gtsam-gn, g2o-gn or g2o-lm")]
    chi2: Annotated[float | None, about("at the end, by one evaluator for all; null where the solver failed")]
    chi2_per_dof: Annotated[
        float | None, about("chi2 per degree of freedom: about 1 where the file's information fits")
    ]
    iterations: Annotated[Count, about("number of iterations")]
    seconds: Annotated[float | None, about("from the initial values to the stop rule [s], median")]
    converged: Annotated[bool, about("whether it met its stop rule")]
    reason: Annotated[str, about("why it ended")]
    certificate: Annotated[
        CertificateDocument | None, about("proof of global optimality; null where the solver failed")
    ]
    native: Annotated[bool, about("false where factors are evaluated in Python, so that the time is that of callbacks")]
    ratio: Annotated[float | None, about("time of graphslam over this time, where both reached the best chi2")]


class BackendsDocument(Document):
    """`slam-compare backends`."""

    rows: Annotated[list[BackendDocument], about("a row for each file and solver")]
    geometric_means: Annotated[
        dict[str, float | None], about("geometric mean of `ratio` over the files, `native` rows only")
    ]


class ParticleRunDocument(Document):
    """One filter, number of particles and random seed."""

    name: Annotated[str, about("name of the filter")]
    particles: Annotated[Count, about("number of particles N")]
    seed: Annotated[Count, about("random seed")]
    ate_m: Annotated[float | None, about("error of the best particle [m]")]
    mean_ate_m: Annotated[float | None, about("error of the weighted mean of the histories [m]")]
    landmark_rmse_m: Annotated[float | None, about("error of the map [m]")]
    ess_share: Annotated[float | None, about("effective sample size over N, mean over the steps")]
    ancestors: Annotated[Count, about("distinct particles half-way that have descendants at the end")]
    seconds: Annotated[float, about("time of the run [s]")]


class ParticleBandDocument(Document):
    """Quartiles over the seeds of one filter and number of particles; null where a metric is not known."""

    name: Annotated[str, about("name of the filter")]
    particles: Annotated[Count, about("number of particles N")]
    ate_m: Quartiles | None
    mean_ate_m: Quartiles | None
    landmark_rmse_m: Quartiles | None
    ess_share: Quartiles | None
    ancestors: Quartiles | None
    seconds: Quartiles | None


class ParticlesDocument(Document):
    """`slam-compare particles`."""

    log: Annotated[str, about("name of the log")]
    runs: Annotated[list[ParticleRunDocument], about("every run")]
    bands: Annotated[list[ParticleBandDocument], about("quartiles over the seeds")]
    notes: Annotated[list[str], about("runs that were stopped at the time limit, one sentence each")]


class ConsistencyEstimatorDocument(Document):
    """The normalised estimation error squared (NEES) of one estimator."""

    name: Annotated[str, about("estimator, or weight of the graph")]
    logs: Annotated[Count, about("number of logs that count")]
    failed: Annotated[Count, about("number of logs on which it failed")]
    anees: Annotated[float | None, about("average NEES of the whole trajectory per degree of freedom")]
    band: Annotated[Band, about("95 % band of `anees`")]
    consistent: Annotated[bool | None, about("whether `anees` lies in `band`")]
    anees_per_step: Annotated[list[float | None], about("average NEES of each pose per degree of freedom")]
    step_band: Annotated[Band, about("95 % band of each entry of `anees_per_step`")]
    steps_inside: Annotated[float | None, about("share of the steps inside `step_band`")]


class ConsistencyDocument(Document):
    """`slam-compare consistency`."""

    logs: Annotated[Count, about("number of simulated logs")]
    noise: Annotated[float, about("factor on the book's noise")]
    steps: Annotated[Count, about("motions of each log")]
    dimensions: Dimensions
    seed: Annotated[Count, about("random seed of the first log")]
    sightings_per_landmark: Annotated[float, about("mean over the logs")]
    estimators: Annotated[list[ConsistencyEstimatorDocument], about("the estimators that were tested")]


class FoundDocument(Document):
    """A log or pose graph that was found and read."""

    path: Annotated[str, about("file or folder")]
    robot: Annotated[int | None, about("the robot, where a folder has several")]
    poses: Annotated[Count, about("number of poses")]
    sightings: Annotated[Count, about("number of sightings; of a pose graph, of all edges")]
    landmarks: Annotated[Count, about("number of landmarks")]
    controls: Annotated[Count | None, about("number of controls")]
    seconds: Annotated[float | None, about("from the first pose to the last [s]")]
    poses_covered: Annotated[Count | None, about("number of poses whose ground truth is known")]
    notes: Annotated[list[str], about("remarks of the reader")]
    error: Annotated[str | None, about("why it cannot be read")]


class DataSetDocument(Document):
    """A known data set."""

    name: Annotated[str, about("short name")]
    title: Annotated[str, about("full name")]
    source: Annotated[str, about("where it is published")]
    terms: Annotated[str, about("terms of use")]
    layout: Annotated[str, about("files that the folder must have")]
    is_graph: Annotated[bool, about("whether it has pose graphs instead of logs")]
    found: Annotated[list[FoundDocument], about("the local copies")]


class DatasetsDocument(Document):
    """`slam-compare datasets`."""

    folder: Annotated[str, about("the folder that was searched")]
    exists: Annotated[bool, about("whether there is such a folder")]
    sets: Annotated[list[DataSetDocument], about("the known data sets")]


class MedianDocument(Document):
    """A median and its bootstrap interval."""

    median: Annotated[float, about("of the values")]
    low: Annotated[float | None, about("lower end of the interval")]
    high: Annotated[float | None, about("upper end of the interval")]
    count: Annotated[Count, about("number of values")]


class MedianFiguresDocument(Document):
    """The median of each metric, see the estimator document; null where it is not known."""

    ate_m: MedianDocument | None
    rpe_m: MedianDocument | None
    rpe_rad: MedianDocument | None
    landmark_rmse_m: MedianDocument | None
    cost_per_dof: MedianDocument | None
    iterations: MedianDocument | None
    seconds: MedianDocument | None


class MethodDocument(Document):
    """One method on one log, or on all logs."""

    log: Annotated[str, about("name of the log")]
    method: Annotated[str, about("estimator and varied options")]
    runs: Annotated[Count, about("number of rows")]
    failed: Annotated[Count, about("number of runs that failed")]
    timeouts: Annotated[Count, about("number of runs that exceeded the time limit")]
    converged: Annotated[float | None, about("share of the runs that converged, of those that iterate")]
    proven: Annotated[
        float | None, about("share of the runs proven to end at the global minimum, of those that the theory covers")
    ]
    figures: Annotated[MedianFiguresDocument, about("medians of the metrics")]


class DifferenceDocument(Document):
    """A method minus the baseline on the same log and random seed."""

    log: Annotated[str, about("name of the log")]
    method: Annotated[str, about("estimator and varied options")]
    baseline: Annotated[str, about("the method it is compared with")]
    figures: Annotated[MedianFiguresDocument, about("medians of the differences")]
    lower: Annotated[dict[str, Count], about("number of pairs in which the method has the lower value, by metric")]


class StudyDocument(Document):
    """`slam-compare study`."""

    database: Annotated[str, about("the SQLite file")]
    study: Annotated[str | None, about("the study file")]
    planned: Annotated[Count, about("number of runs of the study")]
    done: Annotated[Count, about("number of runs that have a row")]
    baseline: Annotated[str | None, about("the method that the others are compared with")]
    methods: Annotated[list[MethodDocument], about("every method on every log, and on all logs")]
    differences: Annotated[list[DifferenceDocument], about("paired differences from the baseline")]
    errors: Annotated[dict[str, Count], about("number of runs that ended with each error")]


class SweepDocument(Document):
    """`slam-compare sweep`."""

    study: Annotated[str, about("the study file")]
    database: Annotated[str, about("the SQLite file")]
    planned: Annotated[Count, about("number of runs of the study")]
    before: Annotated[Count, about("number of rows that existed before")]
    ran: Annotated[Count, about("number of runs done now")]
    failed: Annotated[Count, about("number of these that failed")]
    interrupted: Annotated[bool, about("whether Ctrl-C ended it")]
    missing: Annotated[Count, about("number of runs without a row")]


class AnimateDocument(Document):
    """`slam-compare animate`."""

    file: Annotated[str, about("the file written")]
    log: LogDocument
    estimator: Annotated[str, about("the estimator that is animated")]
    pictures: Annotated[Count, about("number of frames")]
    steps: Annotated[Count, about("number of iterations or steps, the start included")]
    fps: Annotated[float, about("frames per second")]
    bytes: Annotated[Count, about("size of the file")]
    seconds: Annotated[float, about("time of estimation and drawing [s]")]
    notes: Annotated[list[str], about("remarks of the estimator")]
    poses: Annotated[list[Pose], about("the trajectory in the last frame")]


class StreamDocument(Document):
    """A table or topic that was read."""

    kind: Annotated[Literal["odometry", "sightings", "truth"], about("what it holds")]
    source: Annotated[str, about("its file or topic")]
    rows: Annotated[Count, about("number of rows")]
    begin: Annotated[float, about("first time of its clock [s]")]
    end: Annotated[float, about("last time of its clock [s]")]
    rate: Annotated[float | None, about("different times per second")]
    columns: Annotated[list[str], about("which column was taken for what, with its unit")]


class TopicDocument(Document):
    """A topic of a bag."""

    name: Annotated[str, about("name of the topic")]
    type: Annotated[str, about("type of its messages")]
    count: Annotated[Count, about("number of messages")]
    could_be: Annotated[Literal["odometry", "sightings", "truth", ""], about("what it could be; empty: of no use")]
    chosen: Annotated[Literal["odometry", "sightings", "truth", ""], about("what it is read for; empty: it is not")]


class ImportDocument(Document):
    """`slam-compare import`."""

    source: Annotated[str | None, about("the folder or bag; null where each table was named")]
    topics: Annotated[list[TopicDocument], about("the topics of a bag")]
    streams: Annotated[list[StreamDocument], about("the tables or topics that were read")]
    log: Annotated[LogDocument | None, about("the log; null where the topics make none")]
    file: Annotated[str | None, about("the log that was written; null where none was")]
    reason: Annotated[str, about("why there is no log")]
    warnings: Annotated[list[str], about("what is probably wrong with the log, with the likely cause")]


class FindingDocument(Document):
    """Something in a log that is probably a mistake."""

    check: Annotated[str, about("short name of the check")]
    message: Annotated[str, about("one sentence with the likely cause")]


class RateDocument(Document):
    """The times of the poses, controls or sightings of a log, in seconds since its first pose."""

    name: Annotated[Literal["poses", "controls", "sightings"], about("what is counted")]
    count: Annotated[Count, about("their number")]
    rate: Annotated[float | None, about("different times per second, the median")]
    longest_gap: Annotated[float | None, about("longest time between two [s]")]
    gap_at: Annotated[float | None, about("when it begins [s]")]


class SeenDocument(Document):
    """The sightings of one landmark."""

    id: Annotated[int, about("id of the landmark")]
    count: Annotated[Count, about("number of sightings")]
    first: Annotated[float, about("time of the first one since the first pose [s]")]
    last: Annotated[float, about("time of the last one [s]")]
    range: Annotated[float, about("median range [m]")]


class HistogramDocument(Document):
    """How often values lie in each interval."""

    edges: Annotated[list[float], about("limits of the intervals, one more than counts")]
    counts: Annotated[list[Count], about("number of values in each interval")]


class ShowDocument(Document):
    """`slam-compare show`."""

    log: LogDocument
    seconds: Annotated[float | None, about("from the first pose to the last [s]")]
    distance: Annotated[float | None, about("distance driven according to the odometry [m]")]
    turned: Annotated[float | None, about("sum of all turns [rad]")]
    rates: Annotated[list[RateDocument], about("of poses, controls and sightings")]
    landmarks: Annotated[list[SeenDocument], about("by number of sightings")]
    ranges: Annotated[HistogramDocument, about("of the sightings [m]")]
    bearings: Annotated[HistogramDocument, about("of the sightings [rad]")]
    warnings: Annotated[list[FindingDocument], about("what is probably wrong, with the likely cause")]


class CalibrateDocument(Document):
    """`slam-compare calibrate`."""

    source: Annotated[Literal["truth", "residuals"], about("what the noise was estimated from")]
    motion: Annotated[dict[str, Any] | None, about("fields of `graphslam.MotionModel`; null without controls")]
    sensor: Annotated[dict[str, Any], about("fields of `graphslam.SensorModel`")]
    range_scale: Annotated[float, about("measured range = range_scale * range + range_bias")]
    range_bias: Annotated[float, about("the bias of that line [m]")]
    wheel_scale: Annotated[float, about("recorded speed = wheel_scale * speed")]
    turn_rate_bias: Annotated[float, about("recorded turn rate = turn rate + turn_rate_bias [rad/s]")]
    errors: Annotated[dict[str, float | None], about("standard error of each number, by its name; null near zero")]
    bounds: Annotated[
        dict[str, float | None], about("upper 95 % bound of each number near zero; null where the log gives none")
    ]
    degrees: Annotated[dict[str, float | None], about("degrees of freedom of Student's t; null: normal distribution")]
    counts: Annotated[dict[str, Count], about("number of motions and sightings that were used")]
    logs: Annotated[list[str], about("names of the logs")]
    notes: Annotated[list[str], about("remarks of the calibration")]
    doubts: Annotated[list[str], about("why the noise is not recommended; empty where the checks of residuals pass")]


#: the document that each verb writes
DOCUMENTS: dict[str, type[Document]] = {
    "run": RunDocument,
    "simulate": SimulateDocument,
    "solvers": SolversDocument,
    "backends": BackendsDocument,
    "particles": ParticlesDocument,
    "consistency": ConsistencyDocument,
    "datasets": DatasetsDocument,
    "study": StudyDocument,
    "sweep": SweepDocument,
    "animate": AnimateDocument,
    "calibrate": CalibrateDocument,
    "import": ImportDocument,
    "show": ShowDocument,
}
