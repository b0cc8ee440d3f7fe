"""How many particles are enough? Error, effective sample size, ancestors and time over their number, many seeds.

Pure functions: `study_particles` -> `ParticleStudy`, which makes rows, bands and JSON; `particles_figure` draws it. The verb
``slam-compare particles`` only calls them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from fastslam import FastSLAM1, FastSLAM2, MonteCarloLocalization, ParticleFilter
from graphslam import Log, MotionModel, OptionError, SensorModel
from graphslam.checks import check_choice
from graphslam.metrics import ate, evaluate
from graphslam.se2 import Array

from .display import Displayed

FILTERS: dict[str, type[ParticleFilter]] = {
    "mcl": MonteCarloLocalization,
    "fastslam1": FastSLAM1,
    "fastslam2": FastSLAM2,
}

#: the numbers of particles, 10 to 10^5
NUMBERS = (10, 32, 100, 316, 1000, 3162, 10_000, 31_623, 100_000)

#: what a run is measured by: field of `ParticleRun` -> label of its axis
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
        particles, seed: N, and the seed of the random numbers.
        ate_m, landmark_rmse_m: error of the best particle's history and map [m]; None where the log has no truth. One
            particle is one sample of the posterior: more of them make it no better than a sample.
        mean_ate_m: error of the weighted mean of the surviving histories [m], which more particles do make better.
        ess_share: mean of ESS / N over the steps with sightings, before resampling.
        ancestors: how many distinct particles of the step half-way have descendants at the end.
        seconds: the whole run, without compiling.
    """

    name: str
    particles: int
    seed: int
    ate_m: float | None
    mean_ate_m: float | None
    landmark_rmse_m: float | None
    ess_share: float
    ancestors: int
    seconds: float


@dataclass(frozen=True, eq=False)
class ParticleStudy(Displayed):
    """All runs of a study, and the name of the log."""

    log: str
    runs: tuple[ParticleRun, ...]

    def names(self) -> list[str]:
        """The filters in the order in which they ran."""
        return list(dict.fromkeys(run.name for run in self.runs))

    def bands(self, name: str, figure: str) -> tuple[np.ndarray, Array]:
        """Of one filter and one of `FIGURES`: the numbers of particles (k,), and the quartiles over seeds (3, k).

        Empty where the figure is not known.
        """
        values: dict[int, list[float]] = {}
        for run in self.runs:
            value = getattr(run, figure)
            if run.name == name and value is not None:
                values.setdefault(run.particles, []).append(float(value))
        numbers = sorted(values)
        quartiles = [np.percentile(values[n], (25, 50, 75)) for n in numbers]
        return np.array(numbers, dtype=int), np.array(quartiles).reshape(-1, 3).T

    def rows(self) -> list[dict[str, Any]]:
        """One row per filter and number of particles: the medians over seeds, None where unknown."""
        rows = []
        for name in self.names():
            medians = {figure: dict(zip(*self._medians(name, figure), strict=True)) for figure in FIGURES}
            for particles in medians["seconds"]:
                row = {figure: found.get(particles) for figure, found in medians.items()}
                rows.append({"name": name, "particles": particles, **row})
        return rows

    def to_json(self) -> dict[str, Any]:
        """The study as JSON holds it: every run, and the quartiles over seeds."""
        bands = []
        for row in self.rows():
            band: dict[str, Any] = {"name": row["name"], "particles": row["particles"]}
            for figure in FIGURES:
                numbers, quartiles = self.bands(row["name"], figure)
                at = np.flatnonzero(numbers == row["particles"])
                band[figure] = quartiles[:, at[0]].tolist() if len(at) else None
            bands.append(band)
        return {"log": self.log, "runs": [asdict(run) for run in self.runs], "bands": bands}

    def _medians(self, name: str, figure: str) -> tuple[list[int], list[float]]:
        numbers, quartiles = self.bands(name, figure)
        return numbers.tolist(), quartiles[1].tolist() if len(numbers) else []


def study_particles(
    log: Log,
    *,
    filters: Sequence[str] = ("fastslam1", "fastslam2"),
    particles: Sequence[int] = NUMBERS,
    seeds: int = 10,
    motion: MotionModel | None = None,
    sensor: SensorModel | None = None,
    resampling: str = "systematic",
    association: str = "known",
    threads: int | None = None,
    progress: Callable[[ParticleRun], None] | None = None,
) -> ParticleStudy:
    """Run filters with growing numbers of particles and several seeds on one log.

    Args:
        log: what the robot did and saw; with its truth the errors are known too.
        filters: of `FILTERS`.
        particles: the numbers of particles.
        seeds: how many, 0 to seeds - 1.
        motion, sensor, resampling, association, threads: of the filters (mcl knows its landmarks by their ids).
        progress: called after every run.

    Raises:
        OptionError: an option has an impossible value.
        LogError: the log has no controls.
    """
    if seeds < 1:
        raise OptionError(f"seeds must be at least 1, not {seeds}")
    if not filters or not particles:
        raise OptionError("a study needs at least one filter and one number of particles")
    runs = []
    for name in filters:
        check_choice("filters", name, tuple(FILTERS))
        options: dict[str, Any] = {
            "motion": motion, "sensor": sensor, "resampling": resampling, "threads": threads,
        }  # fmt: skip
        if name != "mcl":
            options["association"] = association
        # the kernels compile at their first call; one run with few particles keeps that out of the times
        FILTERS[name](log, particles=min(10, *particles), **options).run()
        for count in sorted(set(particles)):
            for seed in range(seeds):
                runs.append(_run(log, name, count, seed, options))
                if progress is not None:
                    progress(runs[-1])
    return ParticleStudy(log.name, tuple(runs))


def _run(log: Log, name: str, particles: int, seed: int, options: dict[str, Any]) -> ParticleRun:
    begin = time.perf_counter()
    result = FILTERS[name](log, particles=particles, seed=seed, **options).run()
    seconds = time.perf_counter() - begin
    landmarks = {} if name == "mcl" else result.landmarks
    # where the ids are not looked at, the filter's numbers for landmarks are its own
    named = options.get("association", "known") == "known"
    metrics = evaluate(log.true_poses, log.true_landmarks, result.poses, landmarks, named=named)
    seen = np.unique(log.steps)
    return ParticleRun(
        name=name,
        particles=particles,
        seed=seed,
        ate_m=metrics.ate_m,
        mean_ate_m=None if metrics.ate_m is None or log.true_poses is None else ate(log.true_poses, result.mean_poses),
        landmark_rmse_m=metrics.landmark_rmse_m,
        ess_share=float(np.mean(result.ess[seen]) / particles) if len(seen) else 1.0,
        ancestors=int(result.ancestors[len(result.ancestors) // 2]),
        seconds=seconds,
    )
