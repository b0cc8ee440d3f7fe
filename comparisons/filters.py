"""The estimators that are particle filters; on small logs they run with several random seeds.

One run is one draw, whose error says little about the filter.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any

import numpy as np

import fastslam
from fastslam.samples import Samples
from graphslam import GraphError, Log, OptionError, first_fix
from graphslam.metrics import evaluate

from .association import unused_ids
from .option import options_of
from .options import RunOptions
from .results import EstimatorResult

FILTER = tuple(name for name in options_of(fastslam.FilterOptions) if name not in ("seed", "threads"))
#: options that localisation in a given map does not use: those of association, of landmark updates and of the proposal
LOCALISATION = ("particles", "resampling", "ess_threshold", "stage")


def mcl(log: Log, options: RunOptions) -> EstimatorResult:
    """Monte Carlo localisation on the map, else on the true one: what a robot could know that need not map.

    It estimates no map.

    Raises:
        OptionError: there is no map, and the log does not have the true one.
    """
    if options.landmark_map is not None:
        known = np.isin(log.landmarks, list(options.landmark_map))
        result = _particle_filter("mcl", log.with_sightings(known), options)
        if known.all():
            return result
        left_out = f"{np.sum(~known)} of {len(known)} sightings are of landmarks that are not on the map, and left out"
        return replace(result, notes=(*result.notes, left_out))
    if log.true_landmarks is None:
        raise OptionError(
            f"mcl localises on the true map of the landmarks, which {log.name} does not have; fastslam1 and fastslam2 "
            "estimate a map"
        )
    return replace(_particle_filter("mcl", log, options), knows="true map")


def fastslam1(log: Log, options: RunOptions) -> EstimatorResult:
    """FastSLAM 1.0; trajectory and map of the best particle, with ``smoothing`` the means of those drawn backwards."""
    return _particle_filter("fastslam1", log, options)


def fastslam2(log: Log, options: RunOptions) -> EstimatorResult:
    """FastSLAM 2.0, whose proposal is corrected by the sightings; trajectory and map as for `fastslam1`."""
    return _particle_filter("fastslam2", log, options)


#: the particle filters by the name of their estimator, as names in `fastslam`, which is imported when one is used
FILTERS = {"mcl": "MonteCarloLocalization", "fastslam1": "FastSLAM1", "fastslam2": "FastSLAM2"}


def check_one_drive(name: str, log: Log) -> None:
    """Raise `GraphError` where a log consists of several, for an estimator that follows one robot from its start."""
    if log.sessions:
        raise GraphError(
            f"{name} follows one robot from its start, and these are {len(log.sessions)} logs; graph, gtsam and isam2 solve "
            "them together"
        )


def particle_filter(name: str, log: Log, options: RunOptions) -> fastslam.ParticleFilter:
    """A particle filter on a log, with the options that it uses.

    Raises:
        SlamError: it cannot run on this log.
    """
    check_one_drive(name, log)
    filter_class: type[fastslam.ParticleFilter] = getattr(fastslam, FILTERS[name])
    models: dict[str, Any] = {"motion": options.motion, "sensor": options.sensor}
    if (known := options.landmark_map) is None:
        return filter_class(log, options=options.filter, **models)
    if name != "mcl" and log.has_orientation and not known.oriented:
        log = log.without_orientation()
    start = first_fix(log, known, **models)
    return filter_class(log, options=options.filter, landmarks=known, start=start, **models)


def _particle_filter(name: str, log: Log, options: RunOptions) -> EstimatorResult:
    return of_several_seeds(lambda given: _one_run(name, log, given), log, options)


def _one_run(name: str, log: Log, options: RunOptions) -> EstimatorResult:
    particles = particle_filter(name, log, options)
    begin = time.perf_counter()
    result = particles.run()
    seconds = time.perf_counter() - begin
    # a filter that ignores the ids numbers its landmarks itself
    named = name == "mcl" or result.options.uses_ids
    notes = [] if named else ["landmarks are numbered by discovery, and matched to the true ones by position"]
    if not log.identified:
        why = unused_ids(log) or "the sightings have no ids"
        by_class = ", and heeds the classes of sightings" if log.classes is not None and not named else ""
        notes = [f"{why}: {result.options.association} association finds the landmarks{by_class}"]
    maps = name != "mcl"
    reason = f"processed the log once with {options.filter.particles} particles"
    reported: fastslam.FilterResult | Samples = result
    if result.smoothed is not None:
        reported = result.smoothed
        reason += f", and drew {options.filter.smoothing} trajectories backwards"
    return EstimatorResult(
        name=name,
        poses=reported.poses,
        estimated=np.ones(log.num_poses, dtype=bool),
        seconds=seconds,
        landmarks=dict(reported.landmarks) if maps else {},
        landmark_covariances=dict(reported.landmark_covariances) if maps else {},
        named=named,
        notes=tuple(notes),
        association=result.association,
        options={k: v for k, v in asdict(result.options).items() if k in ("seed", *(FILTER if maps else LOCALISATION))},
        reason=reason,
        origin=result,
    )


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
