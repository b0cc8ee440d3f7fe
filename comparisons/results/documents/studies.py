"""The JSON of many runs: over random seeds, numbers of particles, and whole studies.

The JSON of solvers that are compared on the same graphs.
"""

from __future__ import annotations

from typing import Annotated, Any

import msgspec

from graphslam.metrics import METRICS

from .logs import Band, CostPerDof, Count, Dimensions, Document, Quartiles, about
from .runs import CertificateDocument


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
    failed: Annotated[Count, about("number of logs on which it failed, or its chains did not mix")]
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


class MedianDocument(Document):
    """A median and its bootstrap interval."""

    median: Annotated[float, about("of the values")]
    low: Annotated[float | None, about("lower end of the interval")]
    high: Annotated[float | None, about("upper end of the interval")]
    count: Annotated[Count, about("number of values")]


MedianFiguresDocument: Any = msgspec.defstruct(
    "MedianFiguresDocument",
    [(name, MedianDocument | None) for name in (*METRICS, "cost_per_dof", "iterations", "seconds")],
    bases=(Document,),
    namespace={"__doc__": "The median of each metric, see the estimator document; null where it is not known."},
    kw_only=True,
)


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
