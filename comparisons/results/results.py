"""`EstimatorResult`, the result of one estimator on one log, and `Row`, all its numbers for tables, JSON and the schema.

`FoundIds` are the ids that an estimator gave sightings itself, with their precision and recall; `sightings_of` lists the
sightings of each landmark by these ids. A result keeps the object from which it was computed. A part that cannot be computed
becomes a sentence among its notes, and the other parts are still made.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from fastslam.gibbs import GibbsResult
from fastslam.particles import FilterResult, Samples
from graphslam import Certificate, FormatError, Graph, Log, MotionModel, SlamError, Solution
from graphslam.association import Ambiguity, Association, AssociationScore
from graphslam.association.associate import Verdict
from graphslam.edges import EdgeFamily, PositionEdges, RelationEdges
from graphslam.errors import printable, shortened
from graphslam.identification.declared import ParameterEstimate
from graphslam.log import UNIDENTIFIED
from graphslam.maps.stretch import drifted
from graphslam.metrics import Errors, Metrics, mean_nees
from graphslam.se2 import Array
from graphslam.solvers.joint import motion_edges, sighted_edges
from graphslam.solvers.uncertainty import Uncertainty

from .documents import Count, Covariance, Flags, Numbers, Poses, Position

#: the median of chi-square by its degrees of freedom; as numbers, because importing SciPy's functions takes 0.1 s of each run
CHI_SQUARE_MEDIANS = {1: 0.4549364231195727, 2: 1.3862943611198906, 3: 2.3659738843753377}


def sentence(error: BaseException) -> str:
    """An exception in one line: those meant for the user as they are, all others with their type."""
    text = printable(" ".join(str(error).split()))
    return text if isinstance(error, SlamError) else f"{type(error).__name__}: {text}" if text else type(error).__name__


@contextmanager
def noted(notes: list[str], failed: str) -> Iterator[None]:
    """Catch an error of the block, and add "FAILED: the error in one sentence" to the notes.

    A file or folder that cannot be written is no failure of a part: it ends the work.

    Raises:
        FormatError, OSError: the place of the results cannot be written.
    """
    try:
        yield
    except (FormatError, OSError):
        raise
    except Exception as error:
        notes.append(f"{failed}: {sentence(error)}")


@dataclass(frozen=True, kw_only=True, eq=False)
class EstimatorResult:
    """The result of one estimator on one log.

    Attributes:
        name: of the estimator.
        poses: (T+1, 3) [m, m, rad], headings in [-pi, pi).
        estimated: (T+1,) bool; False where a pose is only the initial guess. Such poses count in no metric.
        seconds: the estimation alone, without reading, setting up or loading modules.
        converged: whether the stop rule was met, or the chains of particle Gibbs have mixed; None where nothing is iterated.
        iterations: their number, of particle Gibbs that of the samples of each chain; 0 where nothing is iterated.
        step_norms: (iterations,) the norm of each correction.
        cost: J at the end; None where nothing is minimised.
        costs: J before the first step and after each, as far as the solver reports it.
        landmarks, landmark_covariances: {id: (2,) or (3,)} and {id: (n, n)}; empty where no map is estimated.
        named: whether the ids of the landmarks are those of the log; False where the estimator numbered them itself,
            so that their true counterparts are known by position only.
        association: (M,) the landmark that the estimator gave each sighting of the log, `graphslam.log.UNIDENTIFIED` for
            none; None where it used the ids of the log.
        found: how these ids were found, where `fastslam.associate` found them.
        weighed_down: the number of sightings that a robust kernel gives less than half of their weight; None without one.
        parameters: of robot and sensor, where they were estimated.
        integrity_risk: (T+1,) in a map, the probability that a pose is off by more than the bounds of the options; of the
            estimator online as it was when the robot was there.
        seed_errors: the ATE [m] of each random seed of which this is the run with the median one; None for a single run.
        knows: input that only this estimator has, such as "true map".
        options: the options that it used, for the record.
        reason: why it ended, one sentence.
        notes: what the user should know.
        origin: what all this was computed from: a `Solution`, a `FilterResult`, a `GibbsResult`, or None.
        graph, state: the graph that was solved and the values (n, 3) of its nodes at the end; None without a graph.
        log, motion: what dead reckoning was computed from; None for the other estimators.
    """

    name: str
    poses: Array
    estimated: np.ndarray
    seconds: float
    converged: bool | None = None
    iterations: int = 0
    step_norms: Array = field(default_factory=lambda: np.empty(0))
    cost: float | None = None
    costs: Array = field(default_factory=lambda: np.empty(0))
    landmarks: Mapping[int, Array] = field(default_factory=dict)
    landmark_covariances: Mapping[int, Array] = field(default_factory=dict)
    named: bool = True
    association: np.ndarray | None = field(default=None, repr=False)
    found: Association | None = field(default=None, repr=False)
    weighed_down: int | None = None
    parameters: ParameterEstimate | None = None
    integrity_risk: Array | None = field(default=None, repr=False)
    seed_errors: Mapping[int, float] | None = None
    knows: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    reason: str = ""
    notes: tuple[str, ...] = ()
    origin: Solution | FilterResult | GibbsResult | None = field(default=None, repr=False)
    graph: Graph | None = field(default=None, repr=False)
    state: Array | None = field(default=None, repr=False)
    log: Log | None = field(default=None, repr=False)
    motion: MotionModel | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        cost = "" if self.cost is None else f", J = {self.cost:.6g}"
        return f"EstimatorResult({self.name}: {len(self.poses)} poses, {len(self.landmarks)} landmarks{cost})"

    @property
    def cost_per_dof(self) -> float | None:
        """J per degree of freedom, with J of pairs divided by the times that they count a sighting; see `of_expected`."""
        return None if self.graph is None or self.cost is None else of_expected(self.cost, self.graph)

    @property
    def unconfirmed(self) -> np.ndarray | None:
        """Whether the landmark of each sighting (M,) is uncertain; None where the ids of the log were used.

        After `fastslam.associate` another landmark, or clutter, is nearly as likely; to a filter the landmark itself is not
        confirmed.
        """
        if self.found is not None:
            return self.found.doubtful
        return self.origin.unconfirmed if isinstance(self.origin, FilterResult) else None

    @property
    def _solution(self) -> Solution | None:
        """The solution of a graph that this was computed from; None where it was something else."""
        return self.origin if isinstance(self.origin, Solution) and self.origin.graph is not None else None

    @property
    def certificate(self) -> Certificate | None:
        """Whether the end is proven to be the global minimum of the graph's J; None without a graph."""
        return None if self._solution is None else self._solution.certificate

    @cached_property
    def pose_covariances(self) -> Array | None:
        """The covariances (T+1, 3, 3) of the poses in world axes, NaN where a pose is not estimated.

        Of a solved graph they are the diagonal blocks of Omega^-1 at the end, of dead reckoning the accumulated motion
        noise, of particle Gibbs and of a smoothed filter the covariances of the samples. None where they are not known: a
        filter without smoothing keeps paths and no covariance of past poses, and the edges of a graph may not determine
        its poses.
        """
        samples = self.origin.smoothed if isinstance(self.origin, FilterResult) else self.origin
        if isinstance(samples, Samples):
            covariances: Array = samples.covariance()
            return covariances
        if self.log is not None and self.log.controls is not None:
            return dead_reckoning_covariances(self.log, self.motion)
        return None if isinstance(self._of_graph, str) else self._of_graph

    @cached_property
    def expected_ate_m(self) -> float | None:
        """The ATE [m] that the covariances of a graph predict; None where they are not known."""
        return None if self._solution is None or self.covariance_failure is not None else self._solution.expected_ate

    def _relative_covariances(self, covariances: Array) -> Array | None:
        """The covariances (T+1, 3, 3) of the poses of a graph against its first pose, whose errors move all others along.

        With errors d of the poses in world axes, pose k is off by d_k - J d_0, J = [1, 0, -dy; 0, 1, dx; 0, 0, 1], (dx, dy)
        the way from the first pose. So P = P_kk - J P_0k - P_k0 J' + J P_00 J'.
        """
        if self.graph is None or self.state is None or self._solution is None:
            return None
        J = np.broadcast_to(np.eye(3), covariances.shape).copy()
        J[:, 0, 2], J[:, 1, 2] = self.poses[0, 1] - self.poses[:, 1], self.poses[:, 0] - self.poses[0, 0]
        crossed = np.full(covariances.shape, np.nan)
        crossed[self.graph.steps] = Uncertainty(self.graph, self.state, self._solution.scan_errors).with_pose(0)
        mixed = J @ np.swapaxes(crossed, 1, 2)
        return covariances - mixed - np.swapaxes(mixed, 1, 2) + J @ covariances[0] @ np.swapaxes(J, 1, 2)

    @property
    def covariance_failure(self) -> str | None:
        """The reason why the covariances of the graph's poses cannot be computed; None where they can."""
        return self._of_graph if isinstance(self._of_graph, str) else None

    @cached_property
    def _of_graph(self) -> Array | str | None:
        """The covariances (T+1, 3, 3) of the poses of the graph, or why they cannot be computed; None without a graph."""
        try:
            return None if self._solution is None else self._solution.covariance()
        except Exception as error:
            return f"the covariances are not known: {sentence(error)}"

    def nees(self, truth: Array | None) -> float | None:
        """The mean over the poses of e' P^-1 e / 3; 1 means consistent, above 1 overconfident.

        e is the error of a pose relative to the first pose, so that no alignment is needed, and P its covariance: that of
        the pose where the first one is held, and `_relative_covariances` in a map.

        Args:
            truth: (T+1, 3) true poses, NaN where unknown; or None.

        Returns:
            None where the truth of the first pose, or the covariances, are not known.
        """
        covariances = self.pose_covariances
        if truth is None or not np.isfinite(truth[0]).all() or covariances is None:
            return None
        # those of samples are relative to the first pose, which is the same in all of them, up to rounding
        if self.graph is not None and np.any(covariances[0]):
            covariances = self._relative_covariances(covariances)
        return None if covariances is None else mean_nees(truth, self.poses, covariances)


@dataclass(frozen=True, kw_only=True)
class Figures(Errors):
    """The numbers of one run of an estimator: columns of tables and of the database of a study; None where not known.

    Attributes:
        converged: whether the stop rule was met, of particle Gibbs whether its chains have mixed; else None.
        iterations: their number.
        cost: J at the end.
        cost_per_dof: J per degree of freedom: about 1 where the noise models fit, more where they are too small or sightings
            are wrong, less where they are too large; None where nothing is minimised.
        seconds: time of the estimation alone.
    """

    converged: bool | None = None
    iterations: Count | None = None
    cost: float | None = None
    cost_per_dof: float | None = None
    seconds: float | None = None


@dataclass(frozen=True)
class Parameter:
    """A parameter of robot or sensor that was estimated with the poses; see docs/parameters.md.

    Attributes:
        value, deviation: its estimate and standard deviation.
        prior: the standard deviation of its prior; None without one.
    """

    value: float
    deviation: float
    prior: float | None


def parameters_of(estimate: ParameterEstimate) -> dict[str, Parameter]:
    """Estimated parameters by name."""
    priors = {name: deviation for name, (_, deviation) in estimate.priors.items()}
    return {n: Parameter(estimate[n], deviation, priors.get(n)) for n, deviation in estimate.deviations.items()}


def of_expected(cost: float, graph: Graph) -> float | None:
    """J at the end over what it would be if the noise models were right, `Graph.expected_cost`.

    It is about 1 where they are, above 1 where the noise is larger or sightings are wrong, and below 1 where the noise is
    smaller. None where the graph has no more measurements than unknowns.
    """
    return cost / graph.expected_cost if graph.degrees_of_freedom > 0 else None


def dead_reckoning_covariances(log: Log, motion: MotionModel | None = None) -> Array:
    """The accumulated motion noise (T+1, 3, 3) along a drive from a start that is known exactly; see `drifted`."""
    return drifted(log.initial_poses[0], *log.motions(motion))[1]


def typical_costs(result: EstimatorResult) -> dict[str, float]:
    """The medians of squared Mahalanobis norms over those of chi-square, of "sightings", "motions", "relations", "positions".

    A median does not see single wrong ones. With the right noise it is about 1 or less, because the solution follows
    the noise, most of all that of the motions. Results without a graph have none.
    """
    if result.graph is None or result.state is None:
        return {}
    kinds: dict[str, list[EdgeFamily | None]] = {
        "sightings": [sighted_edges(result.graph)],
        "motions": [motion_edges(result.graph)],
        "relations": [f for f in result.graph.families if isinstance(f, RelationEdges)],
        "positions": [f for f in result.graph.families if isinstance(f, PositionEdges)],
    }
    found = {}
    for name, families in kinds.items():
        if linear := [f.linearize(result.state, result.state) for f in families if f is not None and f.count]:
            ratios = [edges.mahalanobis / CHI_SQUARE_MEDIANS[edges.residuals.shape[1]] for edges in linear]
            found[name] = float(np.median(np.concatenate(ratios)))
    return found


@dataclass(frozen=True, kw_only=True, eq=False)
class FoundIds:
    """The ids that an estimator gave sightings itself; what needs true ids is None where there are none.

    Attributes:
        landmarks: landmarks that some sighting was given to.
        clutter: sightings that are of no landmark.
        precision, recall, found, missed, doubled, invented, matches: see `graphslam.association.AssociationScore`.
        classes: the class that most sightings of a landmark show, by id; None where none is known.
        unconfirmed: sightings for which another landmark, or clutter, is nearly as likely, or a filter's is not confirmed.
        evidence: logarithm of the evidence for the ids; compares associations of one log; None for filters.
        ambiguities: places that may be others; None for filters.
        verdict: whether the map can be relied on; None for filters.
    """

    landmarks: Count
    clutter: Count
    precision: float | None = None
    recall: float | None = None
    found: Count | None = None
    missed: Count | None = None
    doubled: Count | None = None
    invented: Count | None = None
    matches: Mapping[int, int] | None = None
    classes: Mapping[int, int | str | None] | None = None
    unconfirmed: Count | None = None
    evidence: float | None = None
    ambiguities: tuple[Ambiguity, ...] | None = None
    verdict: Verdict | None = None


#: what a sighting is to an estimator that gave it an id itself
CONFIRMED, UNCONFIRMED, CLUTTER = "confirmed", "unconfirmed", "clutter"


@dataclass(frozen=True, eq=False)
class SeenLandmark:
    """A landmark and its sightings: ``rows`` (k,) of the log, the class that most of them show, and the share that do.

    Where no class of a sighting is known both are None.
    """

    landmark: int
    rows: np.ndarray
    of_class: int | str | None
    share: float | None


def sightings_of(log: Log, ids: np.ndarray) -> list[SeenLandmark]:
    """The landmarks to which sightings with ids (M,) belong, in the order of the ids."""
    found = []
    for j in np.setdiff1d(ids, [UNIDENTIFIED]).tolist():
        rows = np.flatnonzero(ids == j)
        of_class, share = None, None
        if log.classes is not None and np.any(known := log.classified[rows]):
            names, counts = np.unique(log.classes[rows[known]], return_counts=True)
            of_class, share = names[np.argmax(counts)].item(), float(counts.max() / len(rows))
        found.append(SeenLandmark(j, rows, of_class, share))
    return found


def status_of(result: EstimatorResult) -> np.ndarray:
    """Whether the landmark that an estimator gave each sighting (M,) is confirmed, unconfirmed, or none (clutter)."""
    assert result.association is not None
    doubtful = np.zeros(len(result.association), dtype=bool) if result.unconfirmed is None else result.unconfirmed
    given = result.association != UNIDENTIFIED
    return np.where(given, np.where(doubtful, UNCONFIRMED, CONFIRMED), CLUTTER)


def found_ids(log: Log, result: EstimatorResult, scores: AssociationScore | None) -> FoundIds | None:
    """The ids that an estimator gave sightings itself; None where it used those of the log."""
    if result.association is None:
        return None
    given, found = result.association != UNIDENTIFIED, result.found
    classes = {each.landmark: each.of_class for each in sightings_of(log, result.association)}
    return FoundIds(
        landmarks=len(classes), clutter=int(np.sum(~given)), classes=None if log.classes is None else classes,
        unconfirmed=None if result.unconfirmed is None else int(np.sum(result.unconfirmed & given)),
        evidence=None if found is None else found.evidence, ambiguities=None if found is None else found.ambiguities,
        verdict=None if found is None else found.verdict, **({} if scores is None else vars(scores)),
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Row(Figures, Metrics):
    """All that is known of one estimator: a line of the table, and an entry of the JSON. None where it cannot be known.

    Attributes:
        name: of the estimator.
        step_norms: norm of the correction of each iteration.
        nees: mean NEES of the poses per degree of freedom, see `EstimatorResult.nees`; 1: consistent.
        seed_errors: ATE [m] of each random seed of a particle filter, by seed; the other fields are of the run with the
            median one. null for a single run: the options name a seed, no true poses are known, or the log is large.
        knows: what it was given that others do not have, such as the true map; else empty.
        weighed_down: number of sightings that a robust kernel gives less than half of their weight; null without one.
        association: ids found for the sightings; null where the ids of the log were used.
        parameters: estimated parameters by name; null where none was estimated.
        poses: the trajectory, T + 1 poses.
        estimated: false where a pose is only the initial guess.
        landmarks: the map, by id.
        landmark_covariances: covariances of the map, by id.
        integrity_risk: in a map, the probability of each pose to be off by more than the bounds [m, degrees] of the options;
            of online as it was when the robot was there, of others after the drive.
        options: the options that the estimator used.
        certificate: whether the end is proven to be the global minimum of J; null without a graph.
        reason: why it ended, or why it did not run.
        notes: remarks of the estimator.
        skipped: the reason of an estimator that did not run.
        result: from which this was computed.
    """

    name: str
    step_norms: Numbers | None = None
    nees: float | None = None
    seed_errors: Mapping[int, float] | None = None
    knows: str | None = None
    weighed_down: Count | None = None
    association: FoundIds | None = None
    parameters: Mapping[str, Parameter] | None = None
    poses: Poses | None = None
    estimated: Flags | None = None
    landmarks: Mapping[int, Position] | None = None
    landmark_covariances: Mapping[int, Covariance] | None = None
    integrity_risk: Numbers | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    certificate: Certificate | None = None
    reason: str = ""
    notes: tuple[str, ...] = ()
    # the JSON leaves out what is not for a repr
    skipped: str | None = field(default=None, repr=False)
    result: EstimatorResult | None = field(default=None, repr=False)
    shown: ClassVar = {"expected_ate_m": "expected_ate_m"}

    def __repr__(self) -> str:
        figures = {"ATE": (self.ate_m, " m"), "J": (self.cost, "")}
        known = [f"{name} = {value:.6g}{unit}" for name, (value, unit) in figures.items() if value is not None]
        return f"<Row {self.name}: {', '.join(known) or shortened(self.skipped or 'no figures')}>"

    @property
    def expected_ate_m(self) -> float | None:
        """The ATE that the covariances of a graph predict [m]; right where the noise models are."""
        return None if self.result is None else self.result.expected_ate_m
