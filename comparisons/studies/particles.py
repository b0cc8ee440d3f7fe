"""Error, effective sample size, ancestors and time as functions of the number of particles, for many random seeds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product
from os import PathLike
from typing import Any, ClassVar

import numpy as np

from fastslam.particles import FilterResult
from graphslam import Log, SlamError
from graphslam.metrics import ate, evaluate
from graphslam.processes import default_jobs
from graphslam.se2 import Array

from ..estimators import ESTIMATORS
from ..estimators.filters import Announce, announce_memory
from ..options import ParticleStudyOptions, RunOptions
from ..options.reading import prepare
from ..results import Displayed
from ..results.documents import Count, Numbers
from .execute import rows_of

#: the figures of a run: field of `ParticleRun` -> label of its axis
FIGURES = {
    "ate_m": "ATE, best particle [m]",
    "mean_ate_m": "ATE, mean of histories [m]",
    "landmark_rmse_m": "map RMSE, best particle [m]",
    "ess_share": "ESS / N",
    "ancestors": "ancestors half-way",
    "seconds": "time [s]",
}


@dataclass(frozen=True, kw_only=True)
class ParticleRun:
    """One filter on the log with one seed.

    Attributes:
        name: of the filter: mcl, fastslam1 or fastslam2.
        particles, seed: N, and the random seed.
        ate_m, landmark_rmse_m: error of the best particle's history and map [m]; None where the log has no ground truth.
            One particle is one sample of the posterior, and with more particles it is still one sample.
        mean_ate_m: error of the weighted mean of the surviving histories [m], which decreases with more particles; with
            ``smoothing`` that of the mean of the trajectories drawn backwards.
        ess_share: mean of ESS / N over the steps with sightings, before resampling.
        ancestors: how many distinct particles of the step half-way have descendants at the end.
        seconds: the whole run, without loading modules.
    """

    name: str
    particles: Count
    seed: Count
    ate_m: float | None
    mean_ate_m: float | None
    landmark_rmse_m: float | None
    ess_share: float
    ancestors: Count
    seconds: float


@dataclass(frozen=True, eq=False)
class Quartiles:
    """Quartiles (3,) over the seeds of one filter and number of particles; None where a figure is not known."""

    name: str
    particles: Count
    ate_m: Numbers | None
    mean_ate_m: Numbers | None
    landmark_rmse_m: Numbers | None
    ess_share: Numbers | None
    ancestors: Numbers | None
    seconds: Numbers | None


@dataclass(frozen=True, eq=False)
class ParticleStudy(Displayed):
    """All runs of a study.

    Attributes:
        log: the name of the log.
        runs: every run.
        notes: runs that were stopped at the time limit, one sentence each.
    """

    log: str
    runs: tuple[ParticleRun, ...]
    notes: tuple[str, ...] = ()
    shown: ClassVar = {"bands": "quartiles"}

    def names(self) -> list[str]:
        """The filters in the order in which they ran."""
        return list(dict.fromkeys(run.name for run in self.runs))

    def bands(self, name: str, figure: str) -> tuple[np.ndarray, Array]:
        """Of one filter and one of `FIGURES`: the numbers of particles (k,), and the quartiles over seeds (3, k).

        Empty where the figure is not known.
        """
        known = [row for row in self.quartiles if row.name == name and getattr(row, figure) is not None]
        numbers = np.array([row.particles for row in known], dtype=int)
        return numbers, np.array([getattr(row, figure) for row in known]).reshape(-1, 3).T

    @cached_property
    def quartiles(self) -> list[Quartiles]:
        """Quartiles over the seeds, one entry per filter and number of particles."""
        groups: dict[tuple[str, int], list[ParticleRun]] = {}
        for run in self.runs:
            groups.setdefault((run.name, run.particles), []).append(run)
        rows = []
        for (name, particles), runs in groups.items():
            figures = {figure: quartiles([getattr(run, figure) for run in runs]) for figure in FIGURES}
            rows.append(Quartiles(name, particles, **figures))
        return rows


def quartiles(values: Sequence[float | None]) -> Array | None:
    """The first quartile, the median and the third quartile, (3,); None where no value is known."""
    known = [value for value in values if value is not None]
    return np.percentile(known, (25, 50, 75)) if known else None


def study_particles(
    log: Log | str | PathLike[str] | None = None, *, progress: Callable[[ParticleRun], None] | None = None,
    announce: Announce | None = None, **options: Any,
) -> ParticleStudy:  # fmt: skip
    """Run filters with growing numbers of particles and several random seeds on one log.

    Args:
        log: a log, the file or folder of one, or None for the sample log; with the ground truth the errors are known.
        progress: called after every run.
        announce: called before the first run with a sentence, where the runs need much memory.
        options: the fields of `options.ParticleStudyOptions`: filters, particles, seeds, resampling, association, jobs,
            time_limit, and those that read the log. In local processes a filter has one thread; with ``jobs=0`` it has all.

    Raises:
        FormatError: a file cannot be read.
        OptionError: an option has an impossible value.
        LogError: the log has no controls.
        SlamError: no run has ended within the time limit.
    """
    data, _, given = prepare(log, ParticleStudyOptions.of(**options))
    of_run = RunOptions.of(motion=given.motion, sensor=given.sensor, **given.of_component("filter"))
    tasks = list(product(given.filters, sorted(set(given.particles)), range(given.seeds)))
    jobs = default_jobs() if given.jobs is None else max(given.jobs, 1)
    of_tasks = ((name, data, of_run.with_numbers(particles=particles)) for name, particles, _ in tasks)
    announce_memory(of_tasks, announce, jobs=jobs)
    rows = list(rows_of(
        partial(_run, log=data, options=of_run), tasks, jobs=given.jobs, estimators=given.filters, limit=given.time_limit,
        progress=None if progress is None else lambda run: None if isinstance(run, str) else progress(run), instead=_stopped,
    ))  # fmt: skip
    runs = tuple(row for row in rows if isinstance(row, ParticleRun))
    notes = tuple(row for row in rows if isinstance(row, str))
    if not runs:
        raise SlamError(f"no run has a result: {notes[0]}")
    return ParticleStudy(data.name, runs, notes)


def _stopped(task: tuple[str, int, int], reason: str) -> str:
    name, particles, seed = task
    return f"{name} with {particles} particles and seed {seed} has no result: {reason}"


def _run(task: tuple[str, int, int], log: Log, options: RunOptions) -> ParticleRun | str:
    name, particles, seed = task
    estimate = ESTIMATORS[name].run(log, options.with_numbers(particles=particles, seed=seed))
    result = estimate.origin
    assert isinstance(result, FilterResult)
    truth, path = log.true_poses, log.at_truth(result.poses)
    mean = result.mean_poses if result.smoothed is None else result.smoothed.poses
    metrics = evaluate(truth, log.true_landmarks, path, estimate.landmarks, named=estimate.named)
    sighted = np.unique(log.steps)
    return ParticleRun(
        name=name, particles=particles, seed=seed, ate_m=metrics.ate_m,
        mean_ate_m=None if metrics.ate_m is None or truth is None else ate(truth, log.at_truth(mean)),
        landmark_rmse_m=metrics.landmark_rmse_m,
        ess_share=float(np.mean(result.ess[sighted]) / particles) if len(sighted) else 1.0,
        ancestors=int(result.ancestors[len(result.ancestors) // 2]), seconds=estimate.seconds,
    )  # fmt: skip
