"""Who descends from whom: the histories of all living particles, in little memory.

A *generation* is what happens between two resamplings. Within it a particle keeps its number; a resampling opens the
next generation and says which particle of the one before each new particle descends from. Whatever a generation
recorded (poses here; landmark columns elsewhere, by the generation's number) is never copied at a resampling: a later
particle finds its inheritance by following its line of descent.

Lines die out. Rows without living descendants are thrown away whenever the rows have doubled since the last time, so
that recording costs a constant per particle and the memory stays proportional to the tree of survivors, about
T + N log N rows (Jacob, Murray and Rubenthaler, *Path storage in the particle filter*, Statistics and Computing 2015).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from graphslam.se2 import Array


@dataclass(slots=True)
class _Generation:
    """One row per particle that still has living descendants, in ascending order of the particles' numbers."""

    parents: np.ndarray  # (n,) rows of the generation before
    particles: np.ndarray  # (n,) the numbers the particles had when the generation lived
    poses: list[Array] = field(default_factory=list)  # one (n, 3) per step


class Genealogy:
    """The tree of N particles. Ancestors have to come in ascending order, as every resampling scheme gives them."""

    def __init__(self, particles: int) -> None:
        everybody = np.arange(particles)
        self._everybody = everybody
        self._generations = [_Generation(everybody, everybody)]
        self._inherited: dict[int, np.ndarray] = {}
        self._rows, self._limit = particles, 16 * particles

    @property
    def generation(self) -> int:
        """The number of the living generation: how often it was resampled."""
        return len(self._generations) - 1

    @property
    def stored_rows(self) -> int:
        """How many poses and links are kept."""
        return self._rows

    def record(self, poses: Array) -> None:
        """Add the poses (N, 3) of a new step; the array is kept, not copied, and must not change any more."""
        self._generations[-1].poses.append(poses)
        self._rows += len(poses)
        if self._rows > self._limit:
            self.prune()

    def branch(self, ancestors: np.ndarray) -> None:
        """Open a new generation in which particle i descends from particle ancestors[i]; (N,), ascending."""
        self._generations.append(_Generation(ancestors, self._everybody))
        self._inherited.clear()
        self._rows += len(ancestors)

    def ancestors(self, generation: int) -> np.ndarray:
        """The number that each living particle's ancestor had in a generation, (N,), ascending."""
        found = self._inherited.get(generation)
        if found is None:
            # from the old end: there the pruned generations are small, only the last links have N rows
            found = self._generations[generation].particles
            for later in self._generations[generation + 1 :]:
                found = found[later.parents]
            self._inherited[generation] = found
        return found

    def trajectory(self, particle: int) -> Array:
        """The history of one living particle, (steps, 3)."""
        row, backwards = particle, []
        for generation in reversed(self._generations):
            backwards.extend([poses[row] for poses in reversed(generation.poses)])
            row = generation.parents[row]
        return np.array(backwards[::-1])

    def walk_back(self, weights: Array) -> Iterator[tuple[Array, Array]]:
        """From the last step to the first: the poses (n, 3) with living descendants and their weights (n,).

        A pose weighs what its living descendants weigh together; n is the number of distinct ancestors at that step.
        """
        self.prune()
        for generation in reversed(self._generations):
            for poses in reversed(generation.poses):
                yield poses, weights
            weights = np.bincount(generation.parents, weights).astype(float, copy=False)

    def prune(self) -> None:
        """Throw away the rows without living descendants."""
        for g in range(self.generation, 0, -1):
            parents, before = self._generations[g].parents, self._generations[g - 1]
            first = np.empty(len(parents), dtype=bool)
            first[0] = True
            np.not_equal(parents[1:], parents[:-1], out=first[1:])
            alive = parents[first]
            if len(alive) == len(before.parents):
                # nobody died here since the last time, so nobody before has lost a descendant
                break
            self._generations[g].parents = np.cumsum(first) - 1
            before.parents, before.particles = before.parents[alive], before.particles[alive]
            before.poses = [poses[alive] for poses in before.poses]
        self._rows = sum(len(g.parents) * (1 + len(g.poses)) for g in self._generations)
        self._limit = 2 * self._rows + 16 * len(self._everybody)
