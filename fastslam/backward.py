"""Backward simulation: trajectories drawn from all that one run of a particle filter has computed.

The histories of the particles at the end of a run have few ancestors in common steps: resampling has removed the others.
Backward simulation draws the steps one after the other, from the last to the first, among all particles that the filter
ever had. The motions are relative to the pose before: what is drawn is where the rigid rest of the trajectory is attached,
by the landmarks that both sides have seen. A density of the motion is never needed, and a precise motion does not tie the
rest to its own ancestor. The engine draws; equations and sources are in ``engine/include/vmslam/gibbs/backward.hpp``.

Of more than `CANDIDATES` particles, that many are considered at each step: the ancestor in the filter, and draws by weight.
This is a step of a conditional SMC, which leaves the distribution unchanged.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from graphslam.engine import engine
from graphslam.errors import OptionError
from graphslam.models import SensorModel
from graphslam.se2 import Array
from graphslam.threads import available_threads

from .memory import GIGABYTE, available_memory, smoothing_memory
from .motions import robot_poses
from .samples import Samples
from .sightings import Sightings

#: the most particles considered at each step
CANDIDATES = 200


class Record:
    """The sightings of a run whose particles the engine keeps."""

    def __init__(self) -> None:
        self._steps: list[int] = []
        self._ids: list[int] = []
        self._sightings: list[Array] = []

    def observe(self, step: int, ids: np.ndarray, sightings: Array) -> None:
        """Add the sightings of a step."""
        self._steps += [step] * len(ids)
        self._ids += ids.tolist()
        self._sightings += list(sightings)

    def smooth(
        self, particles: Any, count: int, rng: np.random.Generator, sensor: SensorModel, trajectory: Array, marks: Array,
        threads: int | None,
    ) -> Samples:  # fmt: skip
        """Return ``count`` trajectories drawn backwards, each with a map drawn given the trajectory.

        Args:
            particles: the engine's filter, with the particles of all steps.
            trajectory, marks: (T + 1, 3) poses of the sensor and (J, 2 or 3) landmarks at which sightings are linearised.

        Raises:
            OptionError: the record needs more memory than there is.
        """
        T, N = len(trajectory) - 1, len(particles.poses)
        steps, ids = np.array(self._steps, dtype=np.int64), np.array(self._ids)
        seen = Sightings.taken(T + 1, steps, ids, np.array(self._sightings), sensor)
        J = len(seen.ids)
        at = np.zeros((J, 3))
        at[:, : marks.shape[1]] = marks
        seen = seen.linearised_at(trajectory[None], at[None])
        # an event is a step at which a landmark was seen
        events = len(np.unique(seen.steps * J + seen.marks))
        need, there = smoothing_memory(N, T + 1, J, events, count), available_memory()
        if there is not None and need > there:
            raise OptionError(
                f"smoothing {N:,} particles over {T} steps by {count:,} trajectories needs {need / GIGABYTE:.3g} GB of "
                f"memory, and {there / GIGABYTE:.2g} GB are available; take fewer particles or trajectories"
            )
        poses, log_weights, parents = particles.recorded()
        problem = seen.in_engine(np.zeros((T, 3)), np.zeros((T, 6)), seen.C)
        sampler = engine.BackwardSampler(poses, log_weights, parents, problem, CANDIDATES)
        trajectories, maps = np.empty((count, T + 1, 3)), np.empty((count, J, 3))

        def draw(s: int, seed: int) -> None:
            # of its own, so that the result does not depend on the threads
            trajectories[s], maps[s] = sampler.draw(np.random.default_rng(seed).bit_generator)

        with ThreadPoolExecutor(threads or available_threads()) as pool:
            list(pool.map(draw, range(count), rng.integers(2**63, size=count).tolist()))
        return Samples(robot_poses(sensor, trajectories)[None], maps[None, ..., : seen.columns], seen.ids)
