"""A particle filter with several random seeds: one run is one draw, whose error says little about the filter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from graphslam import Log
from graphslam.metrics import evaluate

from .options import RunOptions
from .results import EstimatorResult

#: the runs of a filter, with the seeds from 0 on, unless the options name a seed
SEEDS = 5
#: particles times motions and sightings, beyond which a filter runs once: about half a second
LARGEST = 1_000_000


def of_several_seeds(run: Callable[[RunOptions], EstimatorResult], log: Log, options: RunOptions) -> EstimatorResult:
    """The run with the median ATE of `SEEDS` runs, with the others' errors as ``seed_errors`` and their range as a note.

    It is one run where the options name a seed, the log has no true poses to measure an error with, or it is too large.
    """
    small = options.filter.particles * (log.num_poses + len(log.steps)) <= LARGEST
    if options.numbers.get("seed") is not None or log.true_poses is None or not small:
        return run(options)
    results = {seed: run(options.with_numbers(seed=seed)) for seed in range(SEEDS)}
    errors = {}
    for seed, result in results.items():
        metrics = evaluate(log.true_poses, log.true_landmarks, log.at_truth(result.poses), result.landmarks,
                           mask=result.estimated, named=result.named)  # fmt: skip
        if metrics.ate_m is None:
            return results[0]
        errors[seed] = metrics.ate_m
    median = sorted(errors, key=lambda seed: errors[seed])[SEEDS // 2]
    note = (
        f"{SEEDS} random seeds have an ATE of {min(errors.values()):.3f} to {max(errors.values()):.3f} m, and its row is the "
        f"median, --seed {median}"
    )
    return replace(results[median], notes=(*results[median].notes, note), seed_errors=errors)
