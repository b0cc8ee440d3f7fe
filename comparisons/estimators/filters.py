"""The estimators that are particle filters, the ids that they find, and the memory that they need.

One run is one draw, whose error says little about the filter: on small logs a filter runs with several random seeds.

Where sightings have no ids, these are found once for all estimators that solve graphs.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, replace
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

import fastslam
from fastslam import associate
from fastslam.doubts import ONE_HISTORY
from fastslam.options import GIGABYTE, LOCALISATION, Forecast, available_memory, check_one_drive, forecast
from fastslam.particles import Samples
from graphslam import Log, OptionError, SlamError, first_fix
from graphslam.association import Association
from graphslam.log import UNIDENTIFIED
from graphslam.metrics import evaluate

from ..options import RunOptions, options_of
from ..results import EstimatorResult

Result = TypeVar("Result")

#: what was found for a log, or why nothing was, by what it was found with
_FOUND: WeakKeyDictionary[Log, dict[tuple[object, ...], Association | SlamError]] = WeakKeyDictionary()


def identified(log: Log, options: RunOptions) -> tuple[Log, Association | None]:
    """The log with ids for its sightings, and how they were found; None where it has them and the options use them.

    Raises:
        SlamError: no ids can be found.
    """
    if log.identified and options.filter.uses_ids:
        return log, None
    key = (
        options.motion, options.sensor, options.front_end, options.front_particles,
        str(replace(options.filter, particles=1)), options.estimate,
    )  # fmt: skip
    known = _FOUND.setdefault(log, {})
    if key not in known:
        try:
            known[key] = associate(
                log, motion=options.motion, sensor=options.sensor, filters=options.filter, estimate=options.estimate,
                front_end=options.front_end, front_particles=options.front_particles, keep_ids=options.filter.uses_ids,
                confusion=options.filter.class_confusion,
            )  # fmt: skip
        except SlamError as error:
            known[key] = error
    found = known[key]
    if isinstance(found, SlamError):
        raise found
    return found.log, found


def unused_ids(log: Log) -> str | None:
    """The reason why filters ignore the ids of some sightings; None where all sightings have one, or none has."""
    without = int(np.count_nonzero(log.landmarks == UNIDENTIFIED))
    if not 0 < without < len(log.steps):
        return None
    have, these = ("has", "this one") if without == 1 else ("have", "these")
    return (
        f"{without} of {len(log.steps)} sightings {have} no id, so filters do not use the ids of the others either (remove "
        f"{these} from the log to use them)"
    )


FILTER = tuple(name for name in options_of(fastslam.FilterOptions) if name not in ("seed", "threads"))


def mcl(log: Log, options: RunOptions) -> EstimatorResult:
    """Monte Carlo localisation on the map of the options, else on the true map; it estimates no map.

    Raises:
        OptionError: there is no map, and the log does not have the true one.
    """
    if options.landmark_map is not None:
        known, notes = on_map(log, options)
        result = of_several_seeds("mcl", known, options)
        return replace(result, notes=(*result.notes, *notes))
    if log.true_landmarks is None:
        raise OptionError(
            f"mcl localises on the true map of the landmarks, which {log.name} does not have; name a map with "
            "--map FILE (landmark_map), or take fastslam1 and fastslam2, which estimate one"
        )
    return replace(of_several_seeds("mcl", log, options), knows="true map")


def on_map(log: Log, options: RunOptions) -> tuple[Log, tuple[str, ...]]:
    """The log without sightings of landmarks that are not on the map of the options, and a note; the same without a map."""
    if options.landmark_map is None:
        return log, ()
    known, alone = np.isin(log.landmarks, list(options.landmark_map)), log.partial_sightings
    # sightings with a range or a bearing alone
    single = np.isin([] if alone is None else alone.landmarks, list(options.landmark_map))
    total, outside = len(known) + len(single), int(np.sum(~known) + np.sum(~single))
    if not outside:
        return log, ()
    kept = None if alone is None else alone.among(single)
    left_out = f"{outside} of {total} sightings are of landmarks that are not on the map, and left out"
    return log.with_sightings(known, partial_sightings=kept), (left_out,)


#: the particle filters by the name of their estimator, as names in `fastslam`, which is imported when one is used
FILTERS = {"mcl": "MonteCarloLocalization", "fastslam1": "FastSLAM1", "fastslam2": "FastSLAM2"}


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
    return filter_class(log, options=options.filter, map=known, start=first_fix(log, known, **models), **models)


def timed(work: Callable[[], Result]) -> tuple[Result, float]:
    """The result of a function, and how long it takes [s]."""
    begin = time.perf_counter()
    return work(), time.perf_counter() - begin


def _one_run(name: str, log: Log, options: RunOptions) -> EstimatorResult:
    result, seconds = timed(particle_filter(name, log, options).run)
    # a filter that ignores the ids numbers its landmarks itself
    named = name == "mcl" or result.options.uses_ids
    notes = [] if named else ["landmarks are numbered by discovery, and matched to the true ones by position"]
    if not log.identified:
        why = unused_ids(log) or "the sightings have no ids"
        by_class = ", and heeds the classes of sightings" if log.classes is not None and not named else ""
        notes = [f"{why}: {result.options.association} association finds the landmarks{by_class}"]
    # that histories run out happens on most logs; with ground truth the range of the ATE of several seeds shows it
    notes += [note for note in result.notes if log.true_poses is None or ONE_HISTORY not in note]
    maps = name != "mcl"
    reason = f"processed the log once with {options.filter.particles} particles"
    reported: fastslam.FilterResult | Samples = result
    if result.smoothed is not None:
        reported = result.smoothed
        reason += f", and drew {options.filter.smoothing} trajectories backwards"
    return EstimatorResult(
        name=name, poses=reported.poses, estimated=np.ones(log.num_poses, dtype=bool), seconds=seconds,
        landmarks=dict(reported.landmarks) if maps else {},
        landmark_covariances=dict(reported.landmark_covariances) if maps else {}, named=named, notes=tuple(notes),
        association=result.association,
        options={k: v for k, v in asdict(result.options).items() if k in ("seed", *(FILTER if maps else LOCALISATION))},
        reason=reason, origin=result,
    )  # fmt: skip


#: the runs of a filter, with the seeds from 0 on, unless the options name a seed
SEEDS = 5
#: particles times motions and sightings, beyond which a filter runs once: about half a second
LARGEST = 1_000_000


def of_several_seeds(name: str, log: Log, options: RunOptions) -> EstimatorResult:
    """The run of a filter with the median ATE of `SEEDS`, the errors of all as ``seed_errors``, and their range as a note.

    Trajectory and map are those of the best particle, with ``smoothing`` the means of those drawn backwards.
    It is one run where the options name a seed, the log has no true poses to measure an error with, or it is too large.
    """
    small = options.filter.particles * (log.num_poses + len(log.steps)) <= LARGEST
    if options.numbers.get("seed") is not None or log.true_poses is None or not small:
        return _one_run(name, log, options)
    results = {seed: _one_run(name, log, options.with_numbers(seed=seed)) for seed in range(SEEDS)}
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


#: the memory [bytes] above which a filter announces what it needs
ANNOUNCED = 1e9
#: called with a sentence before work that needs much memory
Announce = Callable[[str], None]


def announce_memory(runs: Iterable[tuple[str, Log, RunOptions]], announce: Announce | None, *, jobs: int = 1) -> None:
    """Say what the largest of several runs needs, where that is much.

    Args:
        runs: estimator, log and options of each run; those of other estimators than particle filters do not count.
        announce: called with one sentence; None to only check.
        jobs: how many runs there are at a time.

    Raises:
        OptionError: a single run has room in the memory there is, but not so many at a time.
    """
    needs: list[tuple[Forecast, str]] = []
    for name, log, options in runs:
        if name in FILTERS:
            need = forecast(log, options.filter, maps=getattr(fastslam, FILTERS[name]).HAS_MAPS)
            needs.append((need, f"{name} with {options.filter.particles:,} particles on {log.name}"))
    if not needs:
        return
    need, what = max(needs, key=lambda entry: entry[0].most)
    jobs, there = min(jobs, len(needs)), available_memory()
    if there is not None and need.least <= there < jobs * need.least:
        raise OptionError(
            f"{what} needs {need} of memory, {jobs} runs at a time need more than the {there / GIGABYTE:.2g} GB that are "
            f"available; use --jobs {int(there / need.least)}"
        )
    if announce is not None and jobs * need.most > ANNOUNCED:
        times = f", and {jobs} runs are executed at a time" if jobs > 1 else ""
        announce(f"{what} needs {need} of memory{times}.")
