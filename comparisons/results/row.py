"""`Row`: all that is known of one estimator on one log, declared once for tables, JSON and its schema."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from graphslam import Certificate
from graphslam.metrics import Metrics

from .documents import Count, Covariance, Flags, Numbers, Poses, Position
from .results import EstimatorResult, Figures, Parameter
from .sightings import FoundIds


@dataclass(frozen=True, kw_only=True, eq=False)
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
    skipped: str | None = field(default=None, repr=False)
    result: EstimatorResult | None = field(default=None, repr=False)
    shown: ClassVar = {"expected_ate_m": "expected_ate_m"}

    @property
    def expected_ate_m(self) -> float | None:
        """The ATE that the covariances of a graph let expect [m]; right where the noise models are."""
        return None if self.result is None else self.result.expected_ate_m
