"""Is the uncertainty that comes out the uncertainty there is? ANEES over many simulated logs.

The normalised estimation error squared (NEES) of an estimate x̂ with covariance P is (x̂ - x)' P^-1 (x̂ - x). If P tells the
truth, its average over n independent logs (ANEES), divided by the degrees of freedom d, is 1, and lies in 95 of 100
studies between the quantiles chi2(n d) / (n d). Above the band an estimator is too sure; below, too modest.

Per step d = 3, P is the marginal covariance of the pose. Joint over the trajectory d = 3 T, P^-1 is Omega over the poses,
landmark nodes eliminated; the first pose, which is anchored at the truth, counts in neither.

Source: Bar-Shalom, Li and Kirubarajan, *Estimation with applications to tracking and navigation*, section 5.4.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse.linalg as spla
from scipy.stats import chi2

from fastslam import FastSLAM1, FastSLAM2, ParticleFilter
from graphslam import Graph, GraphError, Log, MotionModel, OptionError, SensorModel, Solution, simulate, solve
from graphslam.checks import check_choice, check_positive
from graphslam.metrics import pose_nees
from graphslam.se2 import Array, wrap

from .results import jsonable
from .shown import Shown
from .solvers import mapping

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.table import Table

#: what can be judged: options of the graph, or a filter
GRAPHS: dict[str, dict[str, Any]] = {
    "landmark nodes": {"edges": "landmark+motion"},
    "marginal": {"weight": "marginal"},
    "tempered": {"weight": "tempered"},
    "pairs": {"weight": "pairs"},
}
FILTERS: dict[str, type[ParticleFilter]] = {"fastslam1": FastSLAM1, "fastslam2": FastSLAM2}
ESTIMATORS = (*GRAPHS, *FILTERS)
PARTICLES = 1000

#: the part of studies in which a truthful estimator lies inside the band
CONFIDENCE = 0.95
#: the least and the most noise, in units of the book's
NOISE = (1e-3, 10.0)


@dataclass(frozen=True, eq=False)
class Consistency:
    """The NEES of one estimator on every log.

    Attributes:
        name: of the estimator.
        per_step: (n, T) NEES / 3 of each pose but the first, on each log; NaN where an estimator failed.
        joint: (n,) NEES / (3 T) of the whole trajectory; None for filters, which have no joint covariance.
    """

    name: str
    per_step: Array
    joint: Array | None

    @property
    def logs(self) -> int:
        """How many logs were solved."""
        return int(np.count_nonzero(np.isfinite(self.per_step[:, 0])))

    @property
    def failed(self) -> int:
        """On how many logs the estimator failed, or did not converge."""
        return len(self.per_step) - self.logs

    @property
    def steps(self) -> Array:
        """ANEES / 3 of each step, (T,)."""
        return np.asarray(np.nanmean(self.per_step, axis=0))

    @property
    def step_band(self) -> tuple[float, float]:
        """The 95 % band of `steps`."""
        return band(3 * self.logs)

    @property
    def steps_inside(self) -> float:
        """The part of the steps inside their band; steps of one log are not independent."""
        low, high = self.step_band
        return float(np.mean((self.steps >= low) & (self.steps <= high)))

    @property
    def anees(self) -> float | None:
        """ANEES / (3 T) of the whole trajectory."""
        return None if self.joint is None else float(np.nanmean(self.joint))

    @property
    def joint_band(self) -> tuple[float, float]:
        """The 95 % band of `anees`."""
        return band(3 * self.per_step.shape[1] * self.logs)

    @property
    def consistent(self) -> bool | None:
        """Whether the joint ANEES lies inside its band."""
        low, high = self.joint_band
        return None if self.anees is None else bool(low <= self.anees <= high)


@dataclass(frozen=True, eq=False)
class ConsistencyStudy(Shown):
    """The outcome of `study_consistency`: what was simulated, and every estimator's NEES."""

    logs: int
    noise: float
    steps: int
    dimensions: int
    seed: int
    sightings_per_landmark: float
    results: tuple[Consistency, ...]

    def to_json(self) -> dict[str, Any]:
        """The study as plain data; see docs/consistency.md."""
        told = {k: v for k, v in asdict(self).items() if k != "results"}
        results = [
            {
                "name": r.name, "logs": r.logs, "failed": r.failed, "anees": r.anees, "band": list(r.joint_band),
                "consistent": r.consistent, "anees_per_step": r.steps, "step_band": list(r.step_band),
                "steps_inside": r.steps_inside,
            }
            for r in self.results
        ]  # fmt: skip
        return jsonable(told | {"estimators": results})

    def figure(self) -> Figure:
        """ANEES over the steps; see `consistency_figure.consistency_figure`."""
        from .consistency_figure import consistency_figure

        return consistency_figure(self)

    def shown(self) -> tuple[list[Table], list[str]]:
        """See `Shown`."""
        from .tables import consistency_remarks, consistency_table

        return [consistency_table(self)], consistency_remarks(self)


def study_consistency(
    *,
    logs: int = 200,
    noise: float = 0.1,
    steps: int = 62,
    dimensions: int = 3,
    estimators: Sequence[str] = tuple(GRAPHS),
    seed: int = 0,
    jobs: int = 1,
    progress: Callable[[int], None] | None = None,
) -> ConsistencyStudy:
    """Simulate logs whose noise follows the models, and judge what the estimators say of their own errors.

    Args:
        logs: how many, with the seeds ``seed`` to ``seed`` + logs - 1.
        noise: all standard deviations of the book's motion and sensor times this, within `NOISE`.
        steps: T, the motions of each log.
        dimensions: 3 with psi, 2 without (where pairs and tempered have no constant information, but can be solved).
        estimators: of `ESTIMATORS`.
        jobs: how many logs at a time, each in a process of its own.
        progress: called after each log with how many are done.

    Raises:
        OptionError: an option has an impossible value.
    """
    check_positive(noise=noise)
    if not NOISE[0] <= noise <= NOISE[1]:
        raise OptionError(
            f"noise must lie between {NOISE[0]:g} and {NOISE[1]:g}, not {noise:g}: below, the anchor is less sure than the "
            "sightings, and above nothing is nearly linear"
        )
    for name, value in (("logs", logs), ("steps", steps), ("jobs", jobs)):
        if value < 1:
            raise OptionError(f"{name} must be at least 1, not {value}")
    if dimensions not in (2, 3):
        raise OptionError(f"dimensions must be 2 or 3, not {dimensions!r}")
    if not estimators:
        raise OptionError(f"name at least one estimator: {', '.join(ESTIMATORS)}")
    for name in estimators:
        check_choice("estimators", name, ESTIMATORS)
    estimators = tuple(dict.fromkeys(estimators))
    work = partial(_one_log, noise=noise, steps=steps, dimensions=dimensions, estimators=estimators)
    rows: list[dict[str, tuple[Array, float]]] = []
    seen: list[float] = []
    with mapping(jobs) as run:
        for per_landmark, row in run(work, range(seed, seed + logs)):
            rows.append(row)
            seen.append(per_landmark)
            if progress is not None:
                progress(len(rows))
    results = []
    for name in estimators:
        per_step = np.array([row[name][0] for row in rows])
        joint = np.array([row[name][1] for row in rows]) if name in GRAPHS else None
        results.append(Consistency(name, per_step, joint))
    return ConsistencyStudy(logs, noise, steps, dimensions, seed, float(np.mean(seen)), tuple(results))


def models(noise: float) -> tuple[MotionModel, SensorModel]:
    """The book's models with all standard deviations times ``noise``; epsilon is a variance."""
    m, s = MotionModel(), SensorModel()
    motion = MotionModel(
        nn=m.nn * noise, no=m.no * noise, on=m.on * noise, oo=m.oo * noise, epsilon=m.epsilon * noise**2
    )
    return motion, SensorModel(
        range_rate=s.range_rate * noise, bearing_std=s.bearing_std * noise, orientation_std=s.orientation_std * noise
    )


def band(degrees: int) -> tuple[float, float]:
    """Between which values the average of so many independent squares of unit variance lies in 95 of 100 cases."""
    tail = (1 - CONFIDENCE) / 2
    low, high = chi2.ppf([tail, 1 - tail], degrees) / degrees
    return float(low), float(high)


def joint_nees(solution: Solution, graph: Graph, truth: Array) -> float:
    """e' Omega e / (3 T) over all poses but the first, given it; landmark nodes are eliminated."""
    poses = len(graph.steps)
    error = solution.state[:poses] - truth[graph.steps]
    error[:, 2] = wrap(error[:, 2])
    system, _ = graph.linearize(solution.state)
    omega = system.to_sparse().tocsc()
    e = error[1:].ravel()
    of_poses = omega[3 : 3 * poses, 3 : 3 * poses]
    squares = float(e @ (of_poses @ e))
    if graph.num_nodes > poses:
        across = omega[3 * poses :, 3 : 3 * poses] @ e
        squares -= float(across @ spla.spsolve(omega[3 * poses :, 3 * poses :], across))
    return squares / len(e)


def _one_log(
    seed: int, noise: float, steps: int, dimensions: int, estimators: tuple[str, ...]
) -> tuple[float, dict[str, tuple[Array, float]]]:
    """Sightings per landmark, and per estimator the NEES of each step (T,) and of the trajectory; NaN where it failed."""
    motion, sensor = models(noise)
    log = simulate(seed=seed, steps=steps, clean=True, motion=motion, sensor=sensor, orientation=dimensions == 3)
    assert log.true_poses is not None
    failed = (np.full(steps, np.nan), np.nan)
    row = {}
    for name in estimators:
        if name in FILTERS:
            row[name] = (_filter_nees(name, log, motion, sensor, seed), np.nan)
            continue
        try:
            graph = Graph.from_log(log, motion=motion, sensor=sensor, **GRAPHS[name])
            solution = solve(graph, initialize="auto", max_iterations=500)
            covariances = solution.covariances()
        except GraphError:
            row[name] = failed
            continue
        if not solution.converged:
            row[name] = failed
            continue
        error = solution.poses - log.true_poses
        error[:, 2] = wrap(error[:, 2])
        row[name] = (pose_nees(error[1:], covariances[1:]), joint_nees(solution, graph, log.true_poses))
    return len(log.steps) / max(len(log.landmark_ids), 1), row


def _filter_nees(name: str, log: Log, motion: MotionModel, sensor: SensorModel, seed: int) -> Array:
    """NEES / 3 of the particles' mean and covariance at each step, as it stood then; (T,)."""
    assert log.true_poses is not None
    errors: list[Array] = []
    covariances: list[Array] = []
    for state in FILTERS[name](log, particles=PARTICLES, seed=seed, motion=motion, sensor=sensor):
        truth = log.true_poses[len(errors)]
        weights = np.exp(state.log_weights - np.max(state.log_weights))
        weights /= weights.sum()
        off = state.poses - truth
        off[:, 2] = wrap(off[:, 2])
        mean = weights @ off
        spread = off - mean
        errors.append(mean)
        # a trace of the identity: all particles may descend from one
        covariances.append((weights[:, None] * spread).T @ spread + 1e-12 * np.eye(3))
    return pose_nees(np.array(errors)[1:], np.array(covariances)[1:])
