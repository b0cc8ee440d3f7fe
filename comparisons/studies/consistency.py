"""A consistency test of the covariances of estimators: ANEES over many simulated logs.

The normalised estimation error squared (NEES) of an estimate x̂ with covariance P is (x̂ - x)' P^-1 (x̂ - x). If P is
consistent, its average over n independent logs (ANEES), divided by the degrees of freedom d, is 1, and lies in 95 of 100
studies between the quantiles chi2(n d) / (n d). Above the band an estimator is overconfident, below it is underconfident.

Per step d = 3, P is the marginal covariance of the pose. Joint over the trajectory d = 3 T, P^-1 is Omega over the poses,
landmark nodes eliminated; the first pose, which is anchored at the ground truth, counts in neither.

Source: Bar-Shalom, Li and Kirubarajan, *Estimation with applications to tracking and navigation*, section 5.4.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields, replace
from functools import partial
from itertools import count
from typing import Annotated, Any, ClassVar

import numpy as np
from scipy.special import gammaincinv

from graphslam import GraphError, Log, MotionModel, SensorModel, Solution, World, simulate
from graphslam.metrics import pose_nees
from graphslam.se2 import Array, difference

from ..estimators import ESTIMATORS
from ..estimators.attempt import rows_of
from ..estimators.filters import FILTERS, particle_filter
from ..options import ConsistencyOptions, RunOptions
from ..results import Band, Count, Displayed, Numbers, one_of

#: the graphs that can be tested, by name: options of the estimator ``graph``
GRAPHS: dict[str, dict[str, Any]] = {
    "landmark nodes": {"edges": "landmark+motion"},
    **{weight: {"edges": "virtual+motion", "weight": weight} for weight in ("marginal", "tempered", "pairs")},
}
PARTICLES = 1000

#: the share of studies in which a consistent estimator lies inside the band
CONFIDENCE = 0.95


@dataclass(frozen=True, eq=False)
class Consistency:
    """The NEES of one estimator on every log.

    Attributes:
        name: of the estimator.
        per_step: (n, T) NEES / 3 of each pose but the first, on each log; NaN where an estimator failed.
        joint: (n,) NEES / (3 T) of the whole trajectory; NaN for filters, which have no joint covariance.
    """

    name: str
    per_step: Array = field(repr=False)
    joint: Array = field(repr=False)
    shown: ClassVar = {
        "logs": "logs", "failed": "failed", "anees": "anees", "band": "joint_band", "consistent": "consistent",
        "anees_per_step": "steps", "step_band": "step_band", "steps_inside": "steps_inside",
    }  # fmt: skip

    @property
    def logs(self) -> Count:
        """The number of logs that were solved."""
        return int(np.count_nonzero(np.isfinite(self.per_step[:, 0])))

    @property
    def failed(self) -> Count:
        """The number of logs on which the estimator failed, or did not converge."""
        return len(self.per_step) - self.logs

    @property
    def steps(self) -> Numbers:
        """ANEES / 3 of each step, (T,)."""
        if self.logs == 0:
            return np.full(self.per_step.shape[1], np.nan)
        return np.asarray(np.nanmean(self.per_step, axis=0))

    @property
    def step_band(self) -> Band:
        """The 95 % band of `steps`."""
        return band(3 * self.logs)

    @property
    def steps_inside(self) -> float | None:
        """The share of the steps inside their band, None without a log; steps of one log are not independent."""
        if self.logs == 0:
            return None
        low, high = self.step_band
        return float(np.mean((self.steps >= low) & (self.steps <= high)))

    @property
    def anees(self) -> float | None:
        """ANEES / (3 T) of the whole trajectory."""
        return None if np.isnan(self.joint).all() else float(np.nanmean(self.joint))

    @property
    def joint_band(self) -> Band:
        """The 95 % band of `anees`."""
        return band(3 * self.per_step.shape[1] * self.logs)

    @property
    def consistent(self) -> bool | None:
        """Whether the joint ANEES lies inside its band."""
        low, high = self.joint_band
        return None if self.anees is None else bool(low <= self.anees <= high)


@dataclass(frozen=True, eq=False)
class ConsistencyStudy(Displayed):
    """The simulated logs and the NEES of every estimator.

    Attributes:
        logs: number of simulated logs.
        noise: factor on the book's noise.
        steps: motions of each log.
        dimensions: columns of a sighting: 2 without, 3 with orientation psi.
        seed: random seed of the first log.
        sightings_per_landmark: mean over the logs.
        results: the estimators that were tested.
    """

    logs: Count
    noise: float
    steps: Count
    dimensions: Annotated[int, one_of(2, 3)]
    seed: Count
    sightings_per_landmark: float
    results: tuple[Consistency, ...] = field(repr=False)
    shown: ClassVar = {"estimators": "results"}


def study_consistency(*, progress: Callable[[int], None] | None = None, **options: Any) -> ConsistencyStudy:
    """Simulate logs whose noise follows the models, and test the covariances of the estimators against their errors.

    Args:
        progress: called after each log with the number of logs that are done.
        options: the fields of `options.ConsistencyOptions`: logs, noise, steps, dimensions, estimators, seed, jobs.

    Raises:
        OptionError: an option has an impossible value.
    """
    given = ConsistencyOptions.of(**options)
    warm, done = ("graph", *(name for name in given.estimators if name in FILTERS)), count(1)
    seeds, work = range(given.seed, given.seed + given.logs), partial(_one_log, options=given)
    report = None if progress is None else lambda _: progress(next(done))
    sightings, rows = zip(*rows_of(work, seeds, jobs=given.jobs, progress=report, estimators=warm))
    outcome = (Consistency(name, *map(np.array, zip(*(row[name] for row in rows)))) for name in given.estimators)
    common = {f.name for f in fields(ConsistencyStudy)} & {f.name for f in fields(given)}
    same = {name: getattr(given, name) for name in common}
    return ConsistencyStudy(**same, sightings_per_landmark=float(np.mean(sightings)), results=tuple(outcome))


def models(noise: float) -> tuple[MotionModel, SensorModel]:
    """The book's models with all standard deviations times ``noise``; epsilon is a variance."""
    motion, sensor = MotionModel(), SensorModel()
    scaled = {name: value * (noise**2 if name == "epsilon" else noise) for name, value in asdict(motion).items()}
    numbers: dict[str, Any] = {n: value * noise for n, value in asdict(sensor).items() if n not in SensorModel.GEOMETRY}
    return replace(motion, **scaled), replace(sensor, **numbers)


def band(degrees: int) -> tuple[float, float]:
    """The interval in which the mean of this number of independent squares of unit variance lies in 95 of 100 cases.

    The quantiles of chi2(d) / d; that of chi2 at probability p is twice the inverse of the regularised incomplete gamma
    function P(d / 2, x) at p.
    """
    if degrees == 0:
        return np.nan, np.nan
    tail = (1 - CONFIDENCE) / 2
    low, high = 2 * gammaincinv(degrees / 2, [tail, 1 - tail]) / degrees
    return float(low), float(high)


def _one_log(seed: int, options: ConsistencyOptions) -> tuple[float, dict[str, tuple[Array, float]]]:
    """Sightings per landmark, and the NEES of each estimator."""
    motion, sensor = models(options.noise)
    world = World(steps=options.steps, clean=True, orientation=options.dimensions == 3)
    log = simulate(world, seed=seed, motion=motion, sensor=sensor)
    of_run = RunOptions.of(motion=motion, sensor=sensor, seed=seed, particles=PARTICLES, **options.numbers)
    row = {name: _nees(name, log, of_run) for name in options.estimators}
    return len(log.steps) / max(len(log.landmark_ids), 1), row


def _nees(name: str, log: Log, options: RunOptions) -> tuple[Array, float]:
    """NEES / 3 of each step, (T,), and NEES / (3 T) of the trajectory.

    Those of a filter are of mean and covariance of its particles at each step, as it stood then, those of others are given
    the whole log. NaN where an estimator failed or has not converged: covariances of chains that have not mixed are those of
    their start.
    """
    truth, joint = log.robot_truth, np.nan
    assert truth is not None
    if name in FILTERS:
        states = particle_filter(name, log, options)
        poses, covariances = map(np.array, zip(*((state.mean_pose, state.covariance()) for state in states)))
        # a little of the identity: all particles may descend from one
        covariances = covariances + 1e-12 * np.eye(3)
    else:
        poses, covariances = truth, np.full((len(truth), 3, 3), np.nan)
        with suppress(GraphError):
            result = ESTIMATORS["graph" if name in GRAPHS else name].run(log, replace(options, **GRAPHS.get(name, {})))
            if result.converged and result.pose_covariances is not None:
                poses, covariances = result.poses, result.pose_covariances
                joint = result.origin.joint_nees(truth) if isinstance(result.origin, Solution) else np.nan
    return pose_nees(difference(poses, truth)[1:], covariances[1:]), joint
