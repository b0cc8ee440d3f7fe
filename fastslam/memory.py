"""The memory that a particle filter needs, and the memory that there is.

The numbers per particle are those of the arrays: 32 bytes for each stored pose of the genealogy, 8 bytes for each number of
a landmark, and about 100 bytes for poses, weights and buffers. How many poses are stored depends on the resampling, so the
forecast has a lower and an upper end.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graphslam.errors import OptionError
from graphslam.log import Log

from .options import FilterOptions

#: bytes of poses, weights and buffers; of one pose of a history; of the history's index of one landmark
BUFFERS, POSE, INDEX = 100, 32, 8
#: numbers of a landmark without and with heading; where the association is unknown a landmark takes several times as much
NUMBERS, ANONYMOUS = {2: 5, 3: 9}, 4
#: stored poses per particle where the filter resamples often, and where it does so rarely
OFTEN, RARELY = 22, 120
#: the most sightings of a landmark that are integrated together, and so the most poses that are kept of it; the engine has
#: room for no more
JOINT = 16
GIGABYTE = 1e9


@dataclass(frozen=True)
class Forecast:
    """The memory [bytes] that a run will need, at least and at most in the usual case."""

    least: float
    most: float

    def __str__(self) -> str:
        least, most = (f"{value / GIGABYTE:.3g}" for value in (self.least, self.most))
        return f"{most} GB" if least == most else f"{least} to {most} GB"


def forecast(log: Log, options: FilterOptions, *, maps: bool) -> Forecast:
    """The memory of a filter on a log; ``maps`` says whether each particle has a map of its own."""
    landmark = 8 * NUMBERS[log.sightings.shape[1]]
    if options.landmark_update == "joint":
        landmark += 8 * (3 * JOINT + 1)
    if not options.uses_ids and log.classes is not None:
        landmark += 8 * len(np.unique(log.classes))
    spare = int(np.bincount(log.steps).max(initial=0)) + 1
    seen = len(log.landmark_ids) * (1 if options.uses_ids else ANONYMOUS) + spare
    fixed = BUFFERS + (seen * landmark + len(log.landmark_ids) * INDEX if maps else 0)
    # arrays that grow are copied into others of twice the size
    often, rarely = (min(count, 2 * log.num_poses) for count in (OFTEN, RARELY))
    if options.ess_threshold == 0:
        often, rarely = log.num_poses, 2 * log.num_poses
    record = 0.0
    if maps and options.smoothing:
        events = len(np.unique(np.column_stack([log.steps, log.landmarks]), axis=0))
        record = smoothing_memory(options.particles, log.num_poses, len(log.landmark_ids), events, options.smoothing)
    return Forecast(*(record + options.particles * (fixed + POSE * poses) for poses in (often, rarely)))


def smoothing_memory(particles: int, poses: int, landmarks: int, events: int, count: int) -> float:
    """The memory [bytes] of backward simulation of ``count`` trajectories; an event is a step that sees a landmark."""
    # the record of the poses and its copy for the sampler
    record = 4.0 * poses * landmarks + 72.0 * events + 84.0 * poses
    # the covariances need another copy of the samples
    return particles * record + 48.0 * count * (poses + landmarks)


def check_memory(log: Log, options: FilterOptions, *, maps: bool) -> None:
    """Raise `OptionError` where a filter on a log needs more memory than there is."""
    need, there = forecast(log, options, maps=maps), available_memory()
    if there is not None and need.least > there:
        most = int(options.particles * there / need.most)
        raise OptionError(
            f"{options.particles:,} particles on {log.name} need {need} of memory, and {there / GIGABYTE:.2g} GB are "
            f"available; take at most {most:,} particles{' or a smaller smoothing' if options.smoothing else ''}"
        )


def available_memory() -> float | None:
    """The memory [bytes] that a process may take without swapping; None where the system does not report it."""
    limits = []
    for line in _lines("/proc/meminfo"):
        name, _, size = line.partition(":")
        if name == "MemAvailable":
            limits.append(1024.0 * int(size.split()[0]))
    # a container's limit
    most, used = (_lines(f"/sys/fs/cgroup/memory.{name}")[:1] for name in ("max", "current"))
    if most and used and most[0].isdigit():
        limits.append(float(most[0]) - float(used[0]))
    if not limits and "SC_PHYS_PAGES" in getattr(os, "sysconf_names", ()):
        limits.append(float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE"))
    return min(limits, default=None)


def _lines(path: str) -> list[str]:
    try:
        return Path(path).read_text(encoding="ascii").splitlines()
    except (OSError, ValueError):
        return []
