"""Maps whose landmarks have no names: each particle decides which landmark it saw, or that it is a new one.

Every particle has a map of its own in every sense, with its own number of landmarks. They lie side by side in a pool:
slice c, place i is what particle i believes of landmark c, if it has that at all. A scan gives birth to at most one
landmark per sighting, in all particles that find it new, so landmarks of different particles that stem from one
sighting share a slice, and nobody else. As in `LandmarkColumns`, resampling touches nothing; a slice that comes into
view is first brought to the particles' present numbers. What is out of view, by the box of its means, costs nothing.

Sources: Montemerlo and Thrun, *Simultaneous localization and mapping with unknown data association using FastSLAM*,
ICRA 2003; *Probabilistic Robotics*, section 13.6 (association per particle, evidence and removal of landmarks).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from graphslam.se2 import Array

from . import association_kernels as kernels
from .crew import Crew
from .fusion import LOG_2PI
from .genealogy import Genealogy

#: evidence (sightings minus the times it should have been seen and was not) at which a landmark is confirmed: maps have it
CONFIRMED = 2.0
#: evidence at which it stays for good
KEPT = 3.0
#: how far inside the borders of what the sensor has seen so far a landmark must be to be missed
INSIDE = 0.9


@dataclass(slots=True)
class _Slice:
    index: int  # in the pool
    level: int
    box: tuple[float, float, float, float]  # of the means when last written: least x, most x, least y, most y
    losable: bool = True  # by some particle, when last written


class AnonymousLandmarks:
    """The maps of N particles with unknown association; n = 2 or 3 coordinates per landmark.

    Args:
        new_landmark_threshold: p between 0 and 1. A sighting is taken to be of a new landmark where its likelihood
            under every landmark known to the particle is below log N at the rim of the ellipse that holds 1 - p of
            the sightings of a perfectly known one, and a new landmark weighs that much.
    """

    def __init__(
        self, genealogy: Genealogy, crew: Crew, particles: int, coordinates: int, new_landmark_threshold: float
    ) -> None:
        self._genealogy, self._crew, self._particles = genealogy, crew, particles
        self.coordinates = coordinates
        self._gate = float(chi2.isf(new_landmark_threshold, coordinates))
        self._pool = np.empty((8, kernels.SEEN + 1, particles))
        self._free = list(range(8))[::-1]
        self._slices: dict[int, _Slice] = {}
        self._births = 0
        # what the sensor has been seen to see: least and most range, most bearing
        self._seen = np.array([np.inf, 0.0, 0.0])

    @property
    def ids(self) -> list[int]:
        """The landmarks that some particle has, numbered by birth."""
        return list(self._slices)

    def scan(
        self, belief: Array, poses: Array, drawn: bool, key: np.uint64, sightings: Array, q: Array, step: int,
        log_likelihood: Array,
    ) -> None:  # fmt: skip
        """Fold a scan of sightings (K, n) with variances (K, n) in; see `association_kernels.associate`."""
        count, oriented = len(sightings), self.coordinates == 3
        ranges, bearings = sightings[:, 0], np.abs(sightings[:, 1])
        self._seen = np.array(
            [min(self._seen[0], ranges.min()), max(self._seen[1], ranges.max()), max(self._seen[2], bearings.max())]
        )
        z, variances = np.zeros((count, 3)), np.ones((count, 3))
        z[:, : self.coordinates], variances[:, : self.coordinates] = sightings, q
        log_new = -0.5 * (self._gate + np.log(variances).sum(axis=1) + self.coordinates * LOG_2PI)

        self._make_room(count + 1)
        near = self._near(belief)
        for j in near:
            self._bring_up(self._slices[j])
        fresh = [self._free.pop() for _ in range(count)]
        self._pool[fresh, kernels.EVIDENCE] = 0.0
        candidates = np.array([self._slices[j].index for j in near], dtype=np.int64)
        self._crew.run(
            kernels.associate, belief, poses, drawn, key, self._pool, candidates, np.array(fresh), z, variances,
            1.0 if oriented else 0.0, log_new, self._gate, step, KEPT, log_likelihood,
        )  # fmt: skip
        born = {self._births + k: _Slice(index, self._genealogy.level(), (0.0,) * 4) for k, index in enumerate(fresh)}
        self._births += count
        self._slices |= born
        self._written([*near, *born])

    def end_step(self, poses: Array, step: int) -> None:
        """Count against landmarks that may still be lost that they were in view of these poses (3, N) and no scan saw them.

        Only now: another scan of the step might have seen them.
        """
        near = [j for j in self._near(poses) if self._slices[j].losable]
        if not near:
            return
        for j in near:
            self._bring_up(self._slices[j])
        candidates = np.array([self._slices[j].index for j in near], dtype=np.int64)
        view = self._seen * [1 / INSIDE, INSIDE, INSIDE]
        # a copy: the kernel is compiled for writable arrays, and these may be either
        self._crew.run(kernels.charge, poses.copy(), self._pool, candidates, step, view, KEPT)
        self._written(near)

    def gaussians(self, landmark: int, particles: np.ndarray | slice = slice(None)) -> tuple[Array, Array, Array]:
        """Means (k, n) and covariances (k, n, n) of a landmark in some particles, and their evidence for it (k,)."""
        part, n = self._slices[landmark], self.coordinates
        inherited = self._pool[part.index][:, self._genealogy.ancestors(part.level)[particles]]
        rows, columns = np.triu_indices(3)
        covariances = np.empty((inherited.shape[1], 3, 3))
        covariances[:, rows, columns] = covariances[:, columns, rows] = inherited[3:9].T
        return inherited[:n].T.copy(), covariances[:, :n, :n].copy(), inherited[kernels.EVIDENCE]

    def _written(self, landmarks: list[int]) -> None:
        """Note of slices at the particles' present numbers what has become of them, and free those that nobody has."""
        level = self._genealogy.level()
        for j in landmarks:
            part = self._slices[j]
            owners, losable, *box = kernels.extent(self._pool[part.index], KEPT)
            if owners == 0:
                self._free.append(self._slices.pop(j).index)
            else:
                part.box, part.level, part.losable = (box[0], box[1], box[2], box[3]), level, losable

    def _near(self, belief: Array) -> list[int]:
        """The landmarks whose box comes nearer to the box of the poses than the sensor has seen, and half as much more.

        The half is for sightings in the tail of the noise, and for poses that the sightings will correct.
        """
        if not self._slices:
            return []
        left, right, low, high = np.array([part.box for part in self._slices.values()]).T
        dx = np.maximum(np.maximum(left - belief[0].max(), belief[0].min() - right), 0.0)
        dy = np.maximum(np.maximum(low - belief[1].max(), belief[1].min() - high), 0.0)
        within = np.hypot(dx, dy) <= 1.5 * self._seen[1]
        return [j for j, near in zip(self._slices, within.tolist(), strict=True) if near]

    def _bring_up(self, part: _Slice) -> None:
        """Bring a slice to the particles' present numbers."""
        if self._genealogy.is_living(part.level):
            return
        slots, index = self._genealogy.ancestors(part.level), self._free.pop()
        np.take(self._pool[part.index], slots, axis=1, out=self._pool[index])
        self._free.append(part.index)
        part.index = index

    def _make_room(self, count: int) -> None:
        """See that so many slices are free: first those whose owners' lines have died out of view, then new ones."""
        if len(self._free) >= count:
            return
        for j in list(self._slices):
            part = self._slices[j]
            if not np.any(self._pool[part.index, kernels.EVIDENCE][self._genealogy.ancestors(part.level)] > 0):
                self._free.append(self._slices.pop(j).index)
        size = len(self._pool)
        # not just enough, or the search above would come back at every scan
        if len(self._free) < count + size // 4:
            more = max(size, 2 * count)
            self._pool = np.concatenate([self._pool, np.empty((more, *self._pool.shape[1:]))])
            self._free += range(size + more - 1, size - 1, -1)
