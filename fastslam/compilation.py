"""Compile the kernels before times are measured, by runs of two particles on a log of four steps."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from graphslam.log import Log
from graphslam.models import SensorModel

from .fastslam1 import FastSLAM1
from .fastslam2 import FastSLAM2
from .mcl import MonteCarloLocalization
from .options import ASSOCIATIONS, FilterOptions
from .particle_filter import ParticleFilter
from .resampling import RESAMPLING_SCHEMES


def warm_up(particles: ParticleFilter | None = None) -> None:
    """Compile what a filter needs for its log; without a filter, everything that any filter needs.

    numba compiles a kernel at its first call and caches the result on disk. Where it is cached, this takes some
    milliseconds. The filter itself is not changed.
    """
    if particles is not None:
        log, sensor = particles.log, SensorModel(offset=particles.sensor.offset)
        columns = 3 if log is None else log.sightings.shape[1]
        composite = particles.motion.slip > 0 or (log is not None and log.composite)
        _run(type(particles), columns, composite, sensor, particles.options)
        return
    kinds: tuple[type[ParticleFilter], ...] = (MonteCarloLocalization, FastSLAM1, FastSLAM2)
    for kind, columns, composite, association in product(kinds, (2, 3), (False, True), ASSOCIATIONS[1:]):
        _run(kind, columns, composite, SensorModel(), FilterOptions(association=association))
    for scheme in RESAMPLING_SCHEMES.values():
        scheme(np.array([0.2, 0.8]), np.random.default_rng(0))


def _run(
    kind: type[ParticleFilter], columns: int, composite: bool, sensor: SensorModel, options: FilterOptions
) -> None:
    """Run a filter on four steps with three landmarks, of which the last is out of view for two resamplings."""
    landmarks = {0: np.array([2.0, 0.5, 0.1]), 1: np.array([1.5, -0.5, 0.2]), 2: np.array([2.0, -1.0, 0.3])}
    steps, ids = np.array([0, 0, 0, 1, 1, 2, 2, 3, 3, 3]), np.array([0, 1, 2, 0, 1, 0, 1, 0, 1, 2])
    controls = np.full((6 if composite else 3, 2), 0.01)
    log = Log(
        dt=np.full(len(controls), 0.1),
        controls=controls,
        control_starts=np.arange(0, len(controls) + 1, len(controls) // 3),
        initial_poses=np.zeros((4, 3)),
        steps=steps,
        landmarks=ids,
        sightings=sensor.h(np.zeros(3), np.array([landmarks[j] for j in ids.tolist()])[:, :columns]),
        true_landmarks=landmarks,
    )
    kind(log, options=replace(options, particles=2, seed=0, ess_threshold=1.0, merge_interval=1), sensor=sensor).run()
