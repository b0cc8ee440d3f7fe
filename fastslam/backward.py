"""Backward simulation: trajectories drawn from all that one run of a particle filter has computed.

The histories of the particles at the end of a run have few ancestors in common steps: resampling has removed the others.
Backward simulation draws the steps one after the other, from the last to the first, among all particles that the filter
ever had. Given the motions d after step t, particle i of step t continues them with the probability

    w_i p(d_{t+1:T}, z_{t+1:T} | history i)
        = w_i p(d_{t+1:T}) prod over landmarks of N(mean_after; q(x_i, mean_i), S_after + S_i).

The motions d are relative to the pose before, and independent a priori, so their density is the same for all particles and
cancels: what is drawn is where the rigid rest of the trajectory is attached, by the landmarks that both sides have seen.
Landmarks are integrated out as in `gibbs.maps`: ``after`` is what the later sightings say of them in the axes of the pose.
A density of the motion is never needed, and a precise motion does not tie the rest to its own ancestor.

Of more than `CANDIDATES` particles, that many are considered at each step: the ancestor in the filter, and draws by weight.
This is a step of a conditional SMC, which leaves the distribution unchanged.

Sources: Godsill, Doucet and West, *Monte Carlo smoothing for nonlinear time series*, JASA 2004; Lindsten and Schön, *Backward
simulation methods for Monte Carlo statistical inference*, 2013, chapter 4, for models that are not Markov; Bunch and
Godsill, *Improved particle approximations to the joint smoothing distribution using Markov chain Monte Carlo*, 2013.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numba import njit

from graphslam.errors import OptionError
from graphslam.models import SensorModel
from graphslam.se2 import Array
from graphslam.threads import available_threads

from .fast_math import OPTIONS
from .gibbs.exact import draw_map
from .gibbs.maps import UNSEEN, absorb, choose, composed, density, fuse, put, relative, six, three, turned
from .gibbs.sightings import Sightings
from .memory import GIGABYTE, available_memory, smoothing_memory
from .motions import robot_poses
from .samples import Samples

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
        J, third = len(seen.ids), float(seen.columns - 2)
        at = np.zeros((J, 3))
        at[:, : marks.shape[1]] = marks
        seen = seen.linearised_at(trajectory[None], at[None])
        events, numbers = _events(seen, T)
        need, there = smoothing_memory(N, T + 1, J, len(events), count), available_memory()
        if there is not None and need > there:
            raise OptionError(
                f"smoothing {N:,} particles over {T} steps by {count:,} trajectories needs {need / GIGABYTE:.3g} GB of "
                f"memory, and {there / GIGABYTE:.2g} GB are available; take fewer particles or trajectories"
            )
        poses, log_weights, parents = particles.recorded()
        rows, slots = np.empty((len(events), N, 9)), np.empty((T + 1, J, N), np.int32)
        _maps(poses, parents, events, numbers, seen.first, seen.marks, seen.y, seen.C, third, rows, slots)
        cumulative = np.cumsum(np.exp(log_weights), axis=1)
        trajectories, maps = np.empty((count, T + 1, 3)), np.empty((count, J, 3))

        def draw(s: int, seed: int) -> None:
            # of its own, so that the result does not depend on the threads
            generator = np.random.default_rng(seed)
            _draw(
                generator, poses, log_weights, cumulative, parents, rows, numbers, slots, seen.first, seen.marks,
                seen.y, seen.C, third, CANDIDATES, trajectories[s],
            )  # fmt: skip
            maps[s] = draw_map(generator, trajectories[s], seen.first, seen.marks, seen.y, seen.C, J, third)

        with ThreadPoolExecutor(threads or available_threads()) as pool:
            list(pool.map(draw, range(count), rng.integers(2**63, size=count).tolist()))
        return Samples(robot_poses(sensor, trajectories)[None], maps[None, ..., : seen.columns], seen.ids)


def _events(seen: Sightings, T: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (step, landmark) of all events, (E, 2), and the number of each landmark's last event so far, (T + 1, J), or -1.

    An event is a step at which a landmark was seen.
    """
    steps = np.repeat(np.arange(T + 1), np.diff(seen.first))
    events = np.unique(np.column_stack([steps, seen.marks]), axis=0)
    numbers = np.full((T + 1, len(seen.ids)), -1)
    numbers[events[:, 0], events[:, 1]] = np.arange(len(events))
    return events, np.maximum.accumulate(numbers, axis=0)


@njit(**OPTIONS)
def _maps(
    poses: Array, parents: np.ndarray, events: np.ndarray, numbers: np.ndarray, first: np.ndarray, marks: np.ndarray,
    y: Array, C: Array, third: float, rows: Array, slots: np.ndarray,
) -> None:  # fmt: skip
    """Write the landmarks: ``rows[e, slots[t, j, i]]``, e = numbers[t, j], is landmark j of particle i after step t."""
    T, N, J = len(poses) - 1, poses.shape[1], numbers.shape[1]
    event = 0
    for t in range(T + 1):
        for j in range(J):
            if t > 0 and numbers[t - 1, j] >= 0:
                for i in range(N):
                    slots[t, j, i] = slots[t - 1, j, parents[t, i]]
        while event < len(events) and events[event, 0] == t:
            j = events[event, 1]
            old = numbers[t - 1, j] if t > 0 else -1
            for i in range(N):
                row = rows[event, i]
                if old >= 0:
                    row[:] = rows[old, slots[t, j, i]]
                else:
                    row[3] = UNSEEN
                for k in range(first[t], first[t + 1]):
                    if marks[k] == j:
                        absorb(row, three(poses[t, i]), three(y[k]), six(C[k], 0), third)
                slots[t, j, i] = i
            event += 1


@njit(**OPTIONS)
def _draw(
    rng: np.random.Generator, poses: Array, log_weights: Array, cumulative: Array, parents: np.ndarray, rows: Array,
    numbers: np.ndarray, slots: np.ndarray, first: np.ndarray, marks: np.ndarray, y: Array, C: Array, third: float,
    most: int, path: Array,
) -> None:  # fmt: skip
    """Write a trajectory (T + 1, 3) of the sensor, drawn from the last step to the first."""
    T, N, J = len(poses) - 1, poses.shape[1], numbers.shape[1]
    after, ds, shared = np.empty((J, 9)), np.empty((T + 1, 3)), np.empty(J, np.int64)
    after[:, 3] = UNSEEN
    count = min(N, most)
    candidates, lw = np.empty(count, np.int64), np.empty(count)
    chosen = choose(rng, log_weights[T])
    for t in range(T, -1, -1):
        if t < T:
            ancestor = parents[t + 1, chosen]
            d = relative(three(poses[t, ancestor]), three(poses[t + 1, chosen]))
            ds[t + 1] = d
            common = 0
            for j in range(J):
                if after[j, 3] >= 0:
                    put(after[j], composed(d, three(after[j])), turned(six(after[j], 3), d[2]))
                    if numbers[t, j] >= 0:
                        shared[common] = j
                        common += 1
            for c in range(count):
                if count == N:
                    candidates[c], lw[c] = c, log_weights[t, c]
                elif c == 0:
                    candidates[c], lw[c] = ancestor, 0.0
                else:
                    level = rng.random() * cumulative[t, N - 1]
                    candidates[c], lw[c] = min(np.searchsorted(cumulative[t], level, side="right"), N - 1), 0.0
                i = candidates[c]
                pose = three(poses[t, i])
                for s in range(common):
                    j = shared[s]
                    row = rows[numbers[t, j], slots[t, j, i]]
                    a = after[j]
                    lw[c] += density(
                        three(row), six(row, 3), composed(pose, three(a)), turned(six(a, 3), pose[2]), third
                    )
            chosen = candidates[choose(rng, lw)]
        for k in range(first[t], first[t + 1]):
            fuse(after[marks[k]], three(y[k]), six(C[k], 0), third)
    path[0] = poses[0, chosen]
    for t in range(1, T + 1):
        path[t] = composed(three(path[t - 1]), three(ds[t]))
