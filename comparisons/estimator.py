"""What an estimator is told and what it answers: the contract of `comparisons.estimators`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fastslam.options import ASSOCIATIONS, RESAMPLING
from graphslam import Log, MotionModel, OptionError, SensorModel
from graphslam.checks import check_choice, check_count, check_positive
from graphslam.edges.robust import KERNELS
from graphslam.graph import EDGES, FRAMES, WEIGHTS
from graphslam.se2 import Array
from graphslam.solvers.solve import INITIALIZE

#: what can be done against wrong sightings
ROBUST = ("none", *KERNELS, "gnc")

#: seconds per iteration above which an estimator is left out unless asked for by name
PATIENCE = 0.5


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """What the estimators may be told.

    Attributes:
        edges: of the graph; None takes what suits the log (see `estimators.default_edges`).
        frame, weight, motion_weight: of the graph, see `graphslam.Graph.from_log`.
        robust: against wrong sightings: none, huber, cauchy, geman-mcclure, or gnc (graduated non-convexity).
        initialize: where the graph's solvers start, see `graphslam.solve`; gtsam starts where "auto" starts first.
        particles: of the particle filters.
        seed: of the particle filters' random numbers.
        resampling: of the particle filters: systematic, stratified, residual or multinomial.
        association: of FastSLAM: known, or maximum-likelihood, which ignores the ids.
        motion, sensor: the noise models of all estimators; None for those of the log, else the book's.

    Raises:
        OptionError: a value is impossible.
    """

    edges: str | None = None
    frame: str = "body"
    weight: str = "pairs"
    motion_weight: float = 1.0
    robust: str = "none"
    initialize: str = "auto"
    particles: int = 1000
    seed: int = 0
    resampling: str = "systematic"
    association: str = "known"
    motion: MotionModel | None = None
    sensor: SensorModel | None = None

    def __post_init__(self) -> None:
        if self.edges is not None:
            check_choice("edges", self.edges, EDGES)
        check_choice("frame", self.frame, FRAMES)
        check_choice("weight", self.weight, WEIGHTS)
        check_choice("robust", self.robust, ROBUST)
        check_choice("initialize", self.initialize, INITIALIZE)
        check_positive(motion_weight=self.motion_weight)
        check_choice("resampling", self.resampling, RESAMPLING)
        check_choice("association", self.association, ASSOCIATIONS)
        check_count(particles=self.particles, seed=self.seed)
        if self.particles < 1:
            raise OptionError(f"particles must be at least 1, not {self.particles}")

    @property
    def kernel(self) -> str | None:
        """The robust kernel of the graph's sightings, by name."""
        return self.robust if self.robust in KERNELS else None


@dataclass(frozen=True, kw_only=True, eq=False)
class EstimatorResult:
    """What one estimator makes of a log.

    Attributes:
        name: of the estimator.
        poses: (T+1, 3) [m, m, rad], headings in [-pi, pi).
        estimated: (T+1,) bool; False where a pose is only the initial guess. Such poses count in no figure.
        seconds: the estimation alone, without reading, setting up or compiling.
        converged: whether the stop rule was met; None where nothing is iterated.
        iterations: how many there were; 0 where nothing is iterated.
        step_norms: (iterations,) the norm of each correction.
        cost: J at the end; None where nothing is minimised.
        costs: J before the first step and after each, as far as the solver tells it.
        landmarks, landmark_covariances: {id: (2,) or (3,)} and {id: (n, n)}; empty where no map is estimated.
        named: whether the ids of the landmarks are the log's; False where they are numbers by discovery, and a
            landmark's true counterpart is known by its place only.
        options: what the estimator was told, for the record.
        reason: why it ended, one sentence.
        notes: what the user should know.
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
    options: Mapping[str, Any] = field(default_factory=dict)
    reason: str = ""
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Estimator:
    """An entry of the registry.

    Attributes:
        run: the function; raises `graphslam.SlamError` where it cannot run on this log.
        uses: the fields of `RunOptions` that make a difference to it, beside the models and the seed; None for all.
        seconds_per_iteration: a forecast for estimators that are slow on large logs, or None.
    """

    run: Callable[[Log, RunOptions], EstimatorResult]
    seconds_per_iteration: Callable[[Log], float] | None = None
    uses: tuple[str, ...] | None = None

    def too_slow(self, log: Log) -> str | None:
        """Why the estimator should be left out unless asked for by name, or None."""
        if self.seconds_per_iteration is None or (seconds := self.seconds_per_iteration(log)) <= PATIENCE:
            return None
        return f"would take about {seconds:.0f} s per iteration on this log; name it in --estimators to run it"
