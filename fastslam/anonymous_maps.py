"""The maps of all particles for sightings without ids: each particle decides which landmark it saw.

Every particle has a map with its own number of landmarks. The maps lie side by side in a pool: place i of slice c is what
particle i knows of landmark c, if it has that landmark. A scan creates at most one landmark per sighting, common to all
particles that take the sighting for a new landmark, so only landmarks created by one sighting share a slice. Resampling
touches nothing; a slice that comes into view is first brought to the current particle indices. Landmarks out of view,
by the bounding box of their means, cost nothing.

Sources: Montemerlo and Thrun, *Simultaneous localization and mapping with unknown data association using FastSLAM*,
ICRA 2003; *Probabilistic Robotics*, section 13.6 (association per particle, evidence and removal of landmarks).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graphslam.models import SensorModel
from graphslam.se2 import Array

from . import association_kernels as kernels
from .blocks import unpack
from .genealogy import Genealogy
from .kalman import LOG_2PI
from .motions import ControlMotion, GaussianMotion
from .proposal import NO_MOTION
from .threads import Threads

#: evidence (sightings minus misses) from which on a landmark is confirmed and part of the map
CONFIRMED = 2.0
#: evidence from which on a landmark is never dropped
PERMANENT = 3.0
#: a landmark is missed only within this share of the limits of the sensor
INSIDE = 0.9


@dataclass(slots=True)
class _Slice:
    index: int  # in the pool
    level: int
    box: tuple[float, ...]  # of the means when last written: smallest x, largest x, smallest y, largest y
    droppable: bool = True  # by some particle, when last written


class AnonymousLandmarks:
    """The landmarks of N particles with unknown association; n = 2 or 3 coordinates per landmark.

    Args:
        new_landmark_threshold: p between 0 and 1. A sighting belongs to a new landmark where its likelihood under every
            landmark known to the particle is below the density of a perfectly known landmark at the border of the ellipse
            that holds 1 - p of its sightings; a new landmark is weighed by that density.
        sensor: its limits of range and bearing say where a landmark can be seen. A limit that it does not have is learned:
            it is that of all sightings so far.
    """

    def __init__(
        self, genealogy: Genealogy, threads: Threads, particles: int, coordinates: int, new_landmark_threshold: float,
        sensor: SensorModel,
    ) -> None:  # fmt: skip
        from scipy.special import chdtri  # imported here because it takes 0.3 s and known ids do not need it

        self._genealogy, self._threads = genealogy, threads
        self.coordinates = coordinates
        # the quantile of the chi-squared distribution
        self._gate = float(chdtri(coordinates, new_landmark_threshold))
        self._pool = np.empty((8, kernels.LAST_STEP + 1, particles))
        self._free = list(range(8))[::-1]
        self._slices: dict[int, _Slice] = {}
        self._created = 0
        # the limits of the sensor, smallest and largest range, largest bearing; NaN for those to be learned
        known = np.array([sensor.min_range, sensor.max_range, sensor.field_of_view / 2])
        self._known = np.where(known == [0.0, np.inf, np.pi], np.nan, known)
        self._limits = self._with_known([np.inf, 0.0, 0.0])

    @property
    def ids(self) -> list[int]:
        """The landmarks that some particle has, numbered in the order of creation."""
        return list(self._slices)

    def scan(
        self, belief: Array, poses: Array, sightings: Array, q: Array, step: int, log_likelihood: Array,
        motion: ControlMotion | GaussianMotion | None = None, exact: bool = True,
    ) -> None:  # fmt: skip
        """Process a scan of sightings (K, n) with variances (K, n); see `association_kernels.associate`.

        Without a motion the poses are those of 1.0. With the motion they are drawn, with exact weights or linearised ones.
        """
        count, n = len(sightings), self.coordinates
        least, most, widest = self._limits
        ranges, bearings = sightings[:, 0], np.abs(sightings[:, 1])
        self._limits = self._with_known(
            [min(least, ranges.min()), max(most, ranges.max()), max(widest, bearings.max())]
        )
        rows = np.zeros((6, count))
        rows[5] = 1.0
        rows[:n], rows[3 : 3 + n] = sightings.T, q.T
        log_new = -0.5 * (self._gate + np.log(q).sum(axis=1) + n * LOG_2PI)

        if motion is None:
            draw = False, poses, NO_MOTION, np.uint64(0)
        else:
            draw = exact, motion.poses, motion.weighted() if exact else NO_MOTION, motion.key
        self._make_room(count + 1)
        near = self._near(belief)
        candidates = self._current(near)
        fresh = [self._free.pop() for _ in range(count)]
        self._pool[fresh, kernels.EVIDENCE] = 0.0
        self._threads.run(
            kernels.associate, belief, poses, motion is None, *draw, self._pool, candidates, np.array(fresh), rows,
            float(n == 3), log_new, self._gate, step, PERMANENT, log_likelihood,
        )  # fmt: skip
        level = self._genealogy.level()
        created = {self._created + k: _Slice(index, level, (0.0,) * 4) for k, index in enumerate(fresh)}
        self._created += count
        self._slices |= created
        self._written([*near, *created])

    def end_step(self, poses: Array, step: int) -> None:
        """Lower the evidence for landmarks that were in view of these poses (3, N) but in no scan of the step.

        This waits for the end of the step because another scan of the step might still have seen them.
        """
        near = [j for j in self._near(poses) if self._slices[j].droppable]
        if not near:
            return
        candidates = self._current(near)
        view = self._limits * [1 / INSIDE, INSIDE, INSIDE]
        # a copy: the kernel is compiled for writable arrays, and these may be read-only
        self._threads.run(kernels.count_misses, poses.copy(), self._pool, candidates, step, view, PERMANENT)
        self._written(near)

    def gaussians(self, landmark: int, particles: slice) -> tuple[Array, Array, Array]:
        """Return means (k, n), covariances (k, n, n) and the evidence for a landmark (k,), 0 for none, in some particles."""
        part = self._slices[landmark]
        inherited = self._pool[part.index][:, self._genealogy.ancestors(part.level)[particles]]
        return *unpack(inherited[:9], self.coordinates), inherited[kernels.EVIDENCE]

    def _with_known(self, learned: list[float]) -> Array:
        return np.where(np.isnan(self._known), learned, self._known)

    def _written(self, landmarks: list[int]) -> None:
        """Record the level and the extent of slices that were written, and free those that no particle has."""
        level = self._genealogy.level()
        for j in landmarks:
            part = self._slices[j]
            owners, droppable, *box = kernels.extent(self._pool[part.index], PERMANENT)
            if owners == 0:
                self._free.append(self._slices.pop(j).index)
            else:
                part.box, part.level, part.droppable = tuple(box), level, droppable

    def _near(self, belief: Array) -> list[int]:
        """Return the landmarks whose box is nearer to the box of the poses than 1.5 times the largest range.

        The margin is for sightings in the tail of the noise, and for poses that the sightings will correct.
        """
        if not self._slices:
            return []
        left, right, low, high = np.array([part.box for part in self._slices.values()]).T
        dx = np.maximum(np.maximum(left - belief[0].max(), belief[0].min() - right), 0.0)
        dy = np.maximum(np.maximum(low - belief[1].max(), belief[1].min() - high), 0.0)
        within = np.hypot(dx, dy) <= 1.5 * self._limits[1]
        return [j for j, near in zip(self._slices, within.tolist(), strict=True) if near]

    def _current(self, landmarks: list[int]) -> np.ndarray:
        """Bring slices to the current particle indices and return their indices in the pool."""
        for part in (self._slices[j] for j in landmarks):
            if not self._genealogy.is_living(part.level):
                ancestors, index = self._genealogy.ancestors(part.level), self._free.pop()
                np.take(self._pool[part.index], ancestors, axis=1, out=self._pool[index], mode="clip")
                self._free.append(part.index)
                part.index = index
        return np.array([self._slices[j].index for j in landmarks], dtype=np.int64)

    def _make_room(self, count: int) -> None:
        """Free at least the given number of slices: first those that no living particle has, then by enlarging the pool."""
        if len(self._free) >= count:
            return
        for j in list(self._slices):
            part = self._slices[j]
            if not np.any(self._pool[part.index, kernels.EVIDENCE][self._genealogy.ancestors(part.level)] > 0):
                self._free.append(self._slices.pop(j).index)
        size = len(self._pool)
        # more than is needed now, or the search above would be repeated at every scan
        if len(self._free) < count + size // 4:
            more = max(size, 2 * count)
            self._pool = np.concatenate([self._pool, np.empty((more, *self._pool.shape[1:]))])
            self._free += range(size + more - 1, size - 1, -1)
