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
from dataclasses import asdict, dataclass, field, fields, replace
from functools import partial
from itertools import count
from typing import Annotated, Any, ClassVar

import numpy as np
from scipy.special import gammaincinv

from fastslam import ParticleGibbs
from fastslam.options import GibbsOptions
from graphslam import Graph, GraphError, Log, MotionModel, SensorModel, World, simulate, solve
from graphslam.metrics import pose_nees
from graphslam.se2 import Array, difference

from ..estimators.filters import FILTERS, particle_filter
from ..options import ConsistencyOptions, RunOptions
from ..results import Displayed
from ..results.documents import Band, Count, Numbers, one_of
from .execute import rows_of

#: the graphs that can be tested, by name: keywords of `Graph.from_log`
GRAPHS: dict[str, dict[str, Any]] = {
    "landmark nodes": {"edges": "landmark+motion"},
    "marginal": {"weight": "marginal"},
    "tempered": {"weight": "tempered"},
    "pairs": {"weight": "pairs"},
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
        joint: (n,) NEES / (3 T) of the whole trajectory; None for filters, which have no joint covariance.
    """

    name: str
    per_step: Array = field(repr=False)
    joint: Array | None = field(repr=False)
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
        return None if self.joint is None or np.isnan(self.joint).all() else float(np.nanmean(self.joint))

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
    outcome = []
    for name in given.estimators:
        joint = np.array([row[name][1] for row in rows]) if name in GRAPHS else None
        outcome.append(Consistency(name, np.array([row[name][0] for row in rows]), joint))
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
    """Sightings per landmark, and per estimator the NEES of each step (T,) and of the trajectory; NaN where it failed."""
    motion, sensor = models(options.noise)
    noise = {"motion": motion, "sensor": sensor}
    world = World(steps=options.steps, clean=True, orientation=options.dimensions == 3)
    log = simulate(world, seed=seed, motion=motion, sensor=sensor)
    truth = log.robot_truth
    assert truth is not None
    row = {}
    for name in options.estimators:
        if name == "particle-gibbs":
            row[name] = (_smoother_nees(log, truth, seed, options.gibbs, noise), np.nan)
        elif name in FILTERS:
            row[name] = (_filter_nees(name, log, truth, seed, noise), np.nan)
        else:
            row[name] = _graph_nees(log, truth, GRAPHS[name] | noise) or (np.full(options.steps, np.nan), np.nan)
    return len(log.steps) / max(len(log.landmark_ids), 1), row


def _graph_nees(log: Log, truth: Array, keywords: dict[str, Any]) -> tuple[Array, float] | None:
    """NEES / 3 of each step, (T,), and NEES / (3 T) of the trajectory; None where the solver failed."""
    try:
        solution = solve(Graph.from_log(log, **keywords), initialize="auto", max_iterations=500)
        covariances = solution.covariance()
    except GraphError:
        return None
    if not solution.converged:
        return None
    return pose_nees(difference(solution.poses, truth)[1:], covariances[1:]), solution.joint_nees(truth)


def _smoother_nees(log: Log, truth: Array, seed: int, options: GibbsOptions, noise: dict[str, Any]) -> Array:
    """NEES / 3 of the mean and covariance of the samples of particle Gibbs at each step, given the whole log; (T,).

    NaN where its chains have not mixed, as their covariances are then those of the start.
    """
    result = ParticleGibbs(log, seed=seed, threads=1, options=options, **noise).run()
    if not result.mixing.mixed:
        return np.full(log.num_poses - 1, np.nan)
    return pose_nees(difference(result.poses, truth)[1:], result.covariance()[1:])


def _filter_nees(name: str, log: Log, truth: Array, seed: int, noise: dict[str, Any]) -> Array:
    """NEES / 3 of the particles' mean and covariance at each step, as it stood then; (T,)."""
    states = particle_filter(name, log, RunOptions.of(particles=PARTICLES, seed=seed, **noise))
    means, covariances = map(np.array, zip(*((state.mean_pose, state.covariance()) for state in states)))
    # a little of the identity: all particles may descend from one
    return pose_nees(difference(means, truth)[1:], covariances[1:] + 1e-12 * np.eye(3))
