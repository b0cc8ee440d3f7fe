"""The genealogy of the particles: the histories of all living particles, in little memory.

The tree is stored in flat arrays with one row per particle and *level*: the particle's pose, the row of its parent in the
level before, and the particle's index at that level. A level is a step. Resampling copies nothing; it only changes the
row to which each living particle points. Data written elsewhere at a level, by particle index (landmark columns, for
example), can be read through the ancestors.

Rows without living descendants are removed whenever the number of rows has about doubled since the last removal. The
cost is constant per particle and step, and the memory is proportional to the tree of survivors, about T + N log N rows
(Jacob, Murray and Rubenthaler, *Path storage in the particle filter*, Statistics and Computing 2015).

Rejected: one array per step, combined on request, which took 0.4 s for the mean history of 21,000 steps.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from graphslam.errors import OptionError
from graphslam.se2 import Array

from .fast_math import OPTIONS
from .threads import Job

#: rows are numbered with 32 bits
MOST_ROWS = 2**31 - 1
#: rows are removed at the earliest after this many new ones per particle
MINIMUM_GROWTH = 16


class Genealogy:
    """The tree of N particles; ancestors must be in ascending order, as every resampling scheme returns them."""

    def __init__(self, particles: int) -> None:
        self._identity = np.arange(particles)
        self._line = self._identity.copy()  # the row of each living particle
        self._first = np.zeros(65, dtype=np.int64)  # the first row of each level, and the end of the last level
        self._is_step = np.ones(64, dtype=bool)
        self._levels, self._living, self._branched = 0, 0, False
        self._settled = 0  # the number of levels when rows were last removed
        capacity = 4 * particles
        self._poses = np.empty((3, capacity))
        self._parents, self._particles = np.empty(capacity, np.int32), np.empty(capacity, np.int32)
        self._limit = MINIMUM_GROWTH * particles
        self._inherited: dict[int, np.ndarray] = {}
        # the generation before the living one: its first level, and each living particle's ancestor in it
        self._previous, self._parent = 0, self._identity

    @property
    def stored_rows(self) -> int:
        """The number of stored poses."""
        return int(self._first[self._levels])

    def record(self, poses: Array, *, is_step: bool = True) -> None:
        """Add a level with the poses (3, N) of a new step, which are copied."""
        work, arguments = self.recording(poses, is_step=is_step)
        work(0, poses.shape[1], *arguments)

    def recording(self, poses: Array, *, is_step: bool = True) -> Job:
        """Return `record` as a job for `Threads.run_all`, to be done before any other call; poses may still be unwritten."""
        count, rows = poses.shape[1], self.stored_rows
        if rows + count > self._limit:
            self.prune()
            rows = self.stored_rows
        if rows + count > len(self._parents):
            self._grow(rows, 2 * (rows + count))
        if self._levels == len(self._is_step):
            self._first = np.concatenate([self._first, np.zeros_like(self._first)])
            self._is_step = np.concatenate([self._is_step, np.ones_like(self._is_step)])
        end = rows + count
        self._is_step[self._levels] = is_step
        self._levels += 1
        self._first[self._levels] = end
        if self._branched:
            self._living, self._branched = self._levels - 1, False
        return _append, (poses, rows, self._line, self._poses, self._parents, self._particles)

    def amend(self, poses: Array) -> None:
        """Replace the poses (3, N) of the last step, before the next `branch`."""
        self._poses[:, self._first[self._levels - 1] : self.stored_rows] = poses

    def branch(self, ancestors: np.ndarray) -> None:
        """Let particle i descend from particle ancestors[i] from now on; (N,), ascending."""
        self._line = self._line[ancestors]
        self._parent = self._parent[ancestors] if self._branched else ancestors
        self._previous, self._branched = self._living, True
        self._inherited.clear()

    def level(self) -> int:
        """Return the level at which to write by the current particle indices."""
        if self._branched:
            # resampled within this step: the new indices need a level of their own
            self.record(self._poses[:, self._line], is_step=False)
        return self._levels - 1

    def is_living(self, level: int) -> bool:
        """Return whether every particle still has the index that it had at a level."""
        return level >= self._living and not self._branched

    def ancestors(self, level: int) -> np.ndarray:
        """Return the index that each living particle's ancestor had at a level, (N,), ascending."""
        if self.is_living(level):
            return self._identity
        if level >= self._previous:
            # most requests: landmarks that are in view at every step
            return self._parent
        ancestors = self._inherited.get(level)
        if ancestors is None:
            first, second = self._first[level], self._first[level + 1]
            ancestors = _indices(self._parents, self._particles, first, second, self.stored_rows, self._line)
            self._inherited[level] = ancestors
        return ancestors

    def trajectory(self, particle: int) -> Array:
        """Return the history of one living particle, (steps, 3)."""
        rows = _line_of(self._parents, self._levels, self._line[particle])
        return self._poses[:, rows[self._is_step[: self._levels]]].T.copy()

    def summary(self, weights: Array) -> tuple[Array, np.ndarray]:
        """Return the weighted mean of all living histories, for weights (N,) that sum to 1, and the depletion curve.

        Returns:
            Mean poses (steps, 3), the heading as the direction of the mean of (cos, sin), and the number of distinct
            ancestors of the living particles at each step, (steps,).
        """
        self.prune()
        steps = self._is_step[: self._levels]
        levels = np.diff(self._first[: self._levels + 1])
        means = _means(self._poses, self._parents, self._first, self._levels, self._line, weights)
        return means[steps], levels[steps]

    def prune(self) -> None:
        """Remove the rows without living descendants."""
        if self._levels:
            line = self._line.copy()
            _compact(self._poses, self._parents, self._particles, self._first, self._levels, self._settled, line)
            self._line, self._settled = line, self._levels
        self._limit = 2 * self.stored_rows + MINIMUM_GROWTH * len(self._identity)

    def _grow(self, rows: int, capacity: int) -> None:
        if capacity > MOST_ROWS:
            raise OptionError("the histories of so many particles are too long to be stored; take fewer particles")
        more = capacity - rows
        self._poses = np.concatenate([self._poses[:, :rows], np.empty((3, more))], axis=1)
        self._parents = np.concatenate([self._parents[:rows], np.empty(more, np.int32)])
        self._particles = np.concatenate([self._particles[:rows], np.empty(more, np.int32)])


@njit(**OPTIONS)
def _append(
    lo: int, hi: int, source: Array, rows: int, line: np.ndarray, poses: Array, parents: np.ndarray,
    particles: np.ndarray,
) -> None:  # fmt: skip
    """Write a level from row ``rows`` on, and let every particle point to its own new row."""
    poses[:, rows + lo : rows + hi] = source[:, lo:hi]
    parents[rows + lo : rows + hi] = line[lo:hi]
    for i in range(lo, hi):
        particles[rows + i] = i
        line[i] = rows + i


@njit(**OPTIONS)
def _compact(
    poses: Array, parents: np.ndarray, particles: np.ndarray, first: np.ndarray, levels: int, settled: int,
    line: np.ndarray,
) -> None:  # fmt: skip
    """Keep only the rows with descendants among the rows of line, in place."""
    end = first[levels]
    alive = np.zeros(end, np.bool_)
    for row in line:
        alive[row] = True
    level = levels - 1
    while level > 0:
        count = 0
        for row in range(first[level], first[level + 1]):
            if alive[row]:
                alive[parents[row]] = True
                count += 1
        if level < settled and count == first[level + 1] - first[level]:
            # no row of this level was lost since the last removal, when every earlier row had a descendant here
            break
        level -= 1
    start = level
    to = np.empty(end - first[start], np.int32)
    base = write = first[start]
    read = first[start]
    for current in range(start, levels):
        stop = first[current + 1]
        for row in range(read, stop):
            to[row - base] = write
            if not alive[row]:
                continue
            for k in range(3):
                poses[k, write] = poses[k, row]
            parent = parents[row]
            parents[write] = to[parent - base] if current > start and parent >= base else parent
            particles[write] = particles[row]
            write += 1
        read = stop
        first[current + 1] = write
    for i in range(len(line)):
        line[i] = to[line[i] - base]


@njit(**OPTIONS)
def _indices(
    parents: np.ndarray, particles: np.ndarray, first: int, second: int, end: int, line: np.ndarray
) -> np.ndarray:
    """Return the index of each row's ancestor at the level of rows first to second, for the rows of line."""
    index = np.empty(end - first, np.int64)
    index[: second - first] = particles[first:second]
    for row in range(second, end):
        index[row - first] = index[parents[row] - first]
    return index[line - first]


@njit(**OPTIONS)
def _line_of(parents: np.ndarray, levels: int, row: int) -> np.ndarray:
    """Return the rows of one history, one per level."""
    rows = np.empty(levels, np.int64)
    for level in range(levels - 1, -1, -1):
        rows[level] = row
        row = parents[row]
    return rows


@njit(**OPTIONS)
def _means(
    poses: Array, parents: np.ndarray, first: np.ndarray, levels: int, line: np.ndarray, weights: Array
) -> Array:  # fmt: skip
    """Return the mean pose of each level; the weight of a row is the sum of the weights of its living descendants."""
    mass = np.zeros(first[levels])
    for i in range(len(line)):
        mass[line[i]] += weights[i]
    means = np.empty((levels, 3))
    for level in range(levels - 1, -1, -1):
        x = y = sine = cosine = 0.0
        for row in range(first[level], first[level + 1]):
            w = mass[row]
            x += w * poses[0, row]
            y += w * poses[1, row]
            sine += w * np.sin(poses[2, row])
            cosine += w * np.cos(poses[2, row])
            if level > 0:
                mass[parents[row]] += w
        means[level, 0], means[level, 1], means[level, 2] = x, y, np.arctan2(sine, cosine)
        if means[level, 2] == np.pi:
            means[level, 2] = -np.pi
    return means
