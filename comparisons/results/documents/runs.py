"""The JSON of estimators that ran on one log."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

from .logs import (
    CalibrateDocument,
    CostPerDof,
    Count,
    Covariance,
    Document,
    ErrorsDocument,
    Id,
    LogDocument,
    Pose,
    Position,
    about,
    document,
)

if TYPE_CHECKING:
    from graphslam.identification.declared import ParameterEstimate


class CertificateDocument(Document):
    """Whether the end of a solver is proven to be the global minimum of its cost; see docs/certificate.md."""

    status: Annotated[
        Literal[
            "global",
            "global for its weights",
            "global with the parameters held",
            "global for its weights with the parameters held",
            "not proven",
            "not applicable",
        ],
        about(
            "global: no state has a lower cost, up to `relative_gap`; global for its weights: the same with the weights of "
            "the robust kernel held, which is necessary for a global minimum and not sufficient; with the parameters held: "
            "the same with the estimated parameters held at their values; not applicable: the theory does not cover the graph"
        ),
    ]
    lower_bound: Annotated[
        float | None,
        about(
            "no state has a lower cost; 0 where nothing better is known, as with a kernel; null where not applicable"
        ),
    ]
    relative_gap: Annotated[
        float | None,
        about(
            "(J - lower_bound) / J, with a kernel that of the cost with its weights held; null where no bound is known"
        ),
    ]
    reason: Annotated[str, about("one sentence")]
    seconds: Annotated[float, about("time of the check [s]")]


def certificate_document(certificate: object | None) -> dict[str, Any] | None:
    """A `graphslam.Certificate` as plain data, or None."""
    return None if certificate is None else document(CertificateDocument, certificate)


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


class DoubtDocument(Document):
    """A place that may be another one; see docs/association.md."""

    step: Annotated[Count, about("where the landmarks come into sight again, or first")]
    last: Annotated[Count, about("the last step before in which one of them, or else any landmark, was seen")]
    landmarks: Annotated[list[int], about("their ids")]
    others: Annotated[
        list[int], about("the landmarks that they may be instead; empty where they may never have been seen before")
    ]
    new: Annotated[bool, about("whether they were taken for landmarks that had never been seen before")]
    log_factor: Annotated[
        float, about("logarithm of the evidence for `landmarks` over that for the other account of the drive")
    ]


class VerdictDocument(Document):
    """Whether a map that was found without ids can be relied on; see docs/association.md."""

    reliable: Annotated[bool, about("whether the ids are unlikely to have led to a wrong trajectory")]
    reasons: Annotated[list[str], about("why not; empty where it is reliable")]
    lead: Annotated[
        float | None,
        about(
            "logarithm of the evidence over that for the best rival with another trajectory; null where none was found"
        ),
    ]
    starts: Annotated[Count, about("starts of the search that were used")]
    agreeing: Annotated[Count, about("starts that ended with this trajectory")]
    deviation: Annotated[float, about("standard deviation of the positions of the aligned trajectory [m]")]


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
    matches: Annotated[dict[Id, int] | None, about("the true landmark of each that is matched, by id")]
    classes: Annotated[
        dict[Id, int | str | None] | None,
        about("the class that most sightings of a landmark show, by id; null where none is known"),
    ]
    unconfirmed: Annotated[
        Count | None,
        about("sightings for which another landmark, or clutter, is nearly as likely, or a filter's is not confirmed"),
    ]
    evidence: Annotated[
        float | None, about("logarithm of the evidence for the ids; compares associations of one log; null for filters")
    ]
    doubts: Annotated[list[DoubtDocument] | None, about("places that may be others; null for filters")]
    verdict: Annotated[VerdictDocument | None, about("whether the map can be relied on; null for filters")]


class EstimatorDocument(ErrorsDocument):
    """The result of one estimator. Every metric is null where it cannot be known, or the estimator did not run."""

    name: Annotated[str, about("name of the estimator")]
    converged: Annotated[
        bool | None, about("whether the stop rule was met, of particle Gibbs whether its chains have mixed; else null")
    ]
    iterations: Annotated[Count | None, about("number of iterations")]
    step_norms: Annotated[list[float | None] | None, about("norm of the correction of each iteration")]
    cost: Annotated[float | None, about("J at the end")]
    cost_per_dof: CostPerDof
    seconds: Annotated[float | None, about("time of the estimation alone [s]")]
    expected_ate_m: Annotated[
        float | None, about("the ATE that the covariances of a graph let expect [m]; right where the noise models are")
    ]
    landmark_errors_m: Annotated[
        dict[Id, float] | None, about("error of each landmark in the aligned frame [m], by id")
    ]
    aligned_by: Annotated[
        Literal["poses", "landmarks"] | None,
        about("what the estimate is aligned to the ground truth by: landmarks where no true poses are known"),
    ]
    nees: Annotated[float | None, about("mean NEES of the poses per degree of freedom; 1: consistent")]
    seed_errors: Annotated[
        dict[Id, float] | None,
        about(
            "ATE [m] of each random seed of a particle filter, by seed; the other fields are of the run with the median "
            "one. null for a single run: the options name a seed, no true poses are known, or the log is large"
        ),
    ]
    knows: Annotated[str | None, about("what it was given that others do not have, such as the true map; else empty")]
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
        Literal["book", "log", "file", "estimated", "given"],
        about(
            "book: the lectures' values; log: those of the log or its reader; file: a noise file; estimated: from this log; "
            "given: by options"
        ),
    ]
    model: Annotated[dict[str, Any], about("fields of `graphslam.MotionModel` or `graphslam.SensorModel`")]


class SessionErrorsDocument(ErrorsDocument):
    """The errors of one estimator in one of several logs, aligned alone; null where the ground truth is not known."""

    together_m: Annotated[float | None, about("the ATE after the common alignment of all logs [m]")]
    poses_counted: Annotated[Count | None, about("number of poses that the metrics are of")]


class SessionDocument(Document):
    """One of several logs of a place that were solved as one."""

    name: Annotated[str, about("name of the log")]
    file: Annotated[str | None, about("file or folder it was read from")]
    start: Annotated[Count, about("its first step among those of all logs")]
    start_time: Annotated[float, about("the time of that by its own clock [s]")]
    poses: Annotated[Count, about("number of its poses")]
    sightings: Annotated[Count, about("number of its sightings")]
    landmarks: Annotated[Count, about("number of landmarks it has seen")]
    shared: Annotated[Count, about("number of these that another log has seen, too")]
    estimators: Annotated[dict[str, SessionErrorsDocument], about("the errors of every estimator, by name")]


class LandmarkStateDocument(Document):
    """What the log says about one landmark of the map; see docs/maps.md."""

    id: Annotated[int, about("of the landmark")]
    state: Annotated[Literal["agrees", "moved", "vanished", "not in view", "new"], about("the state")]
    probability: Annotated[float, about("of this state; of `not in view` that it is still there")]
    moved: Annotated[float | None, about("probability that it has moved; null if it was not seen, or is new")]
    vanished: Annotated[float | None, about("probability that it is gone; null if it is new")]
    shift: Annotated[list[float] | None, about("from its place in the map to that in the log [m]")]
    chi_square: Annotated[float | None, about("of the shift")]
    views: Annotated[Count | None, about("number of scans in which it should have been seen")]
    seen: Annotated[Count, about("number of its sightings")]


class RunDocument(Document):
    """`slam-compare run` and `report`, comparison.json."""

    log: LogDocument
    noise: Annotated[dict[str, NoiseDocument], about("the noise models `motion` and `sensor` of all estimators")]
    sessions: Annotated[
        list[SessionDocument] | None, about("the logs, where several were solved as one; null for one log")
    ]
    robot: Annotated[
        CalibrateDocument | None, about("noise and biases that were estimated from the log; null where none were")
    ]
    map_states: Annotated[
        list[LandmarkStateDocument] | None, about("the landmarks of the map and new ones; null without a map")
    ]
    estimators: Annotated[list[EstimatorDocument], about("in the order of the table")]
    files: Annotated[dict[str, str], about("the files written, by kind or name")]
    notes: Annotated[list[str], about("files that could not be made, one sentence each")]
    warnings: Annotated[list[str], about("what is probably wrong with the log, with the likely cause")]


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


class EvaluatedDocument(ErrorsDocument):
    """The errors of one estimate; null where they cannot be known."""

    name: Annotated[str, about("name of the estimate")]
    poses: Annotated[Count, about("number of its poses")]
    compared: Annotated[Count, about("poses at whose time the truth is known")]
    most_m: Annotated[float, about("largest position error after alignment [m]")]
    nees: Annotated[float | None, about("mean NEES of the poses per degree of freedom; 1: consistent")]
    landmarks: Annotated[Count | None, about("number of landmarks of the map")]
    missed: Annotated[Count | None, about("true landmarks without a partner within the cutoff")]
    false: Annotated[Count | None, about("landmarks without a true one within the cutoff")]
    gospa_m: Annotated[float | None, about("GOSPA distance of the maps [m], p = 2, alpha = 2")]


class EvaluateDocument(Document):
    """`slam-compare evaluate`."""

    truth: Annotated[str, about("name of the ground truth")]
    true_poses: Annotated[Count, about("number of true poses")]
    true_landmarks: Annotated[Count | None, about("number of true landmarks; null without a true map")]
    cutoff_m: Annotated[float, about("`--cutoff` [m]")]
    estimates: Annotated[list[EvaluatedDocument], about("one for each estimate, in the order of the command")]
    notes: Annotated[list[str], about("remarks of the readers")]
