"""The maps of all particles for sightings without ids: each particle decides which landmark it saw.

Every particle has a map with its own number of landmarks. The maps lie side by side in a pool: place i of slice c is what
particle i knows of landmark c, if it has that landmark. A scan creates at most one landmark per sighting, common to all
particles that take the sighting for a new landmark, so only landmarks created by one sighting share a slice. Resampling
touches nothing; a slice that comes into view is first brought to the current particle indices. Landmarks away from the
sightings, by the bounding box of their means, cost nothing.

Sources: Montemerlo and Thrun, *Simultaneous localization and mapping with unknown data association using FastSLAM*,
ICRA 2003; *Probabilistic Robotics*, section 13.6 (association per particle, evidence and removal of landmarks); Blackman
and Popoli, *Design and Analysis of Modern Tracking Systems*, 1999, section 6.2 (log odds of a track).
"""

from __future__ import annotations

from math import inf, log
from typing import NamedTuple

import numpy as np

from graphslam.association.classes import Classes
from graphslam.models import SensorModel
from graphslam.se2 import Array

from . import association_kernels as kernels
from . import class_kernels
from . import existence_kernels as existence
from .blocks import unpack
from .genealogy import Genealogy
from .kalman import LOG_2PI
from .motions import ControlMotion, GaussianMotion
from .options import FilterOptions
from .proposal import NO_MOTION
from .threads import Threads

#: a landmark is missed only within this share of the limits of the sensor
INSIDE = 0.9
#: a drawn hypothesis may be this much less likely than a new landmark, in logarithms: e^-12 is 6e-6
BELOW = 12.0
#: the odds of its existence at which a landmark is dropped, from which on it is confirmed, and permanent
DROPPED, SURE, FOREVER = 0.1, 100.0, 1e12
#: two landmarks are one within the ellipse that holds all but this share of their differences
MERGED = 0.05
#: the share of the variances of a single sighting by which landmarks that are one may differ in any case
CORRELATED = 0.1


class Evidence(NamedTuple):
    """How the evidence for a landmark counts: what a sighting or a miss changes, and what is needed."""

    first: float
    hit: float
    graded: float
    miss: float
    confirmed: float
    permanent: float


#: sightings minus misses: confirmed when seen twice, permanent when seen three times
COUNTED = Evidence(first=1.0, hit=1.0, graded=0.0, miss=1.0, confirmed=2.0, permanent=3.0)


def log_odds(detection: float, clutter: float) -> Evidence:
    """The log odds of the existence of a landmark, from those at which it is dropped.

    A sighting of no known landmark is of a new one with the odds (1 - clutter) / clutter. Another sighting multiplies the
    odds by detection N(z; h, V) / (clutter w_0), where w_0 is the density of the sightings of no known landmark; a miss
    multiplies them by 1 - detection.
    """
    return Evidence(
        first=max(log((1 - clutter) / clutter / DROPPED), 1e-3),
        hit=log(detection / clutter),
        graded=1.0,
        miss=-log(1 - detection),
        confirmed=log(SURE / DROPPED),
        permanent=log(FOREVER / DROPPED),
    )


class AnonymousLandmarks:
    """The landmarks of N particles with unknown association; n = 2 or 3 coordinates per landmark.

    Args:
        options: the ``association``; the ``new_landmark_threshold`` p: a sighting of a new landmark has the density of that
            of a perfectly known landmark at the border of the ellipse that holds 1 - p of its sightings; and what else is
            of landmarks whose ids are unknown.
        sensor: its limits of range and bearing say where a landmark can be seen. A limit that it does not have is learned:
            it is that of all sightings so far.
        classes: of the sightings, None where they have none.
    """

    def __init__(
        self, genealogy: Genealogy, threads: Threads, particles: int, coordinates: int, options: FilterOptions,
        sensor: SensorModel, classes: Classes | None = None,
    ) -> None:  # fmt: skip
        from scipy.special import chdtri  # imported here because it takes 0.3 s and known ids do not need it

        self._genealogy, self._threads = genealogy, threads
        self.coordinates, self.sampled = coordinates, options.association == "sampled"
        # the quantile of the chi-squared distribution
        self._border = float(chdtri(coordinates, options.new_landmark_threshold))
        self._evidence = log_odds(options.detection_probability, options.clutter_share) if self.sampled else COUNTED
        below = BELOW if self.sampled else 0.0
        each, self._confusion = self._evidence, class_kernels.confusion_of(classes)
        # the class of a sighting is at most n times as likely as for a new landmark
        self._rule = kernels.Rule(
            self._border + 2 * (below + log(max(1, len(self._confusion)))),
            below,
            self.sampled,
            each.first,
            each.permanent,
            each.hit,
            each.graded,
            options.detection_probability,
            DROPPED,
        )
        self._merge_interval, self._merge_gate = options.merge_interval, float(chdtri(coordinates, MERGED))
        self._blur = 0.0, 0.0
        self._pool = np.empty((0, class_kernels.FIRST + len(self._confusion), particles))
        # for each slice of the pool: its landmark, -1 for none; when it was written last, whether a particle could then drop
        # it, and the box of its means
        self._landmarks, self._levels = np.empty(0, np.int64), np.empty(0, np.int64)
        self._droppable, self._boxes = np.empty(0, np.bool_), np.empty((0, 4))
        self._enlarge(8)
        # by how much the misses of a step change the weights, which the next scan does
        self._misses = np.zeros(particles)
        self._created, self._scans = 0, 0
        # the limits of the sensor, smallest and largest range, largest bearing; NaN for those to be learned
        known = np.array([sensor.min_range, sensor.max_range, sensor.field_of_view / 2])
        self._known = np.where(known == [0.0, np.inf, np.pi], np.nan, known)
        self._limits = self._with_known([np.inf, 0.0, 0.0])

    @property
    def ids(self) -> list[int]:
        """The landmarks that some particle has, numbered in the order of creation."""
        landmarks: list[int] = np.sort(self._landmarks[self._landmarks >= 0]).tolist()
        return landmarks

    @property
    def confirmed(self) -> float:
        """The evidence from which on a landmark is part of the map."""
        return self._evidence.confirmed

    def scan(
        self, belief: Array, poses: Array, sightings: Array, q: Array, step: int, log_likelihood: Array,
        choices: np.uint64, shown: np.ndarray, motion: ControlMotion | GaussianMotion | None = None, exact: bool = True,
    ) -> None:  # fmt: skip
        """Process a scan of sightings (K, n) with variances (K, n) and classes (K,); see `association_kernels.associate`.

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
        log_new = -0.5 * (self._border + np.log(q).sum(axis=1) + n * LOG_2PI)
        self._blur = CORRELATED * float(q[:, 0].mean()), CORRELATED * float(q[:, 1:].sum(axis=1).mean())

        if motion is None:
            draw = False, poses, NO_MOTION, np.uint64(0)
        else:
            draw = exact, motion.poses, motion.weighted() if exact else NO_MOTION, motion.key
        if self.sampled:
            log_likelihood += self._misses
            self._misses[:] = 0.0
        near = self._current(self._within(kernels.places(belief, rows, self._rule.gate)))
        fresh = self._make_room(count)
        self._pool[fresh, kernels.EVIDENCE] = 0.0
        self._threads.run(
            kernels.associate, belief, poses, motion is None, *draw, self._pool, near, fresh, rows, shown, self._confusion,
            float(n == 3), log_new, step, self._rule, choices, log_likelihood,
        )  # fmt: skip
        self._landmarks[fresh] = np.arange(self._created, self._created + count)
        self._created += count
        self._written(np.concatenate([near, fresh]))

    def end_step(self, poses: Array, step: int) -> None:
        """Lower the evidence for landmarks that were in view of these poses (3, N) but in no scan of the step.

        This waits for the end of the step because another scan of the step might still have seen them. Every so many
        steps, landmarks of a particle that are one are merged.
        """
        self._scans += 1
        merges = self._merge_interval > 0 and self._scans % self._merge_interval == 0
        reach = self._limits[1]
        box = np.array(
            [[poses[0].min() - reach, poses[0].max() + reach, poses[1].min() - reach, poses[1].max() + reach]]
        )
        near = self._within(box)
        if not (merges or self.sampled):
            near = near[self._droppable[near]]
        if len(near) == 0:
            return
        near = self._current(near)
        view = self._limits * [1 / INSIDE, INSIDE, INSIDE]
        # a copy: the kernel is compiled for writable arrays, and these may be read-only
        self._threads.run(
            existence.count_misses,
            poses.copy(),
            self._pool,
            near,
            step,
            view,
            self._evidence.miss,
            self._rule,
            self._misses,
        )
        if merges:
            third = float(self.coordinates == 3)
            self._threads.run(existence.merge, self._pool, near, third, self._merge_gate, self._blur, self._rule.kept)
        self._written(near)

    def gaussians(self, landmark: int, particles: slice) -> tuple[Array, Array, Array]:
        """Return means (k, n), covariances (k, n, n) and the evidence for a landmark (k,), 0 for none, in some particles."""
        index = int(np.flatnonzero(self._landmarks == landmark)[0])
        inherited = self._pool[index][:, self._genealogy.ancestors(int(self._levels[index]))[particles]]
        return *unpack(inherited[:9], self.coordinates), inherited[kernels.EVIDENCE]

    def class_probabilities(self, landmark: int, particle: int) -> Array:
        """Return p(c) (n,) of a landmark in a particle that has it; (0,) without classes."""
        index = int(np.flatnonzero(self._landmarks == landmark)[0])
        ancestor = self._genealogy.ancestors(int(self._levels[index]))[particle]
        return self._pool[index, class_kernels.FIRST :, ancestor].copy()

    def _with_known(self, learned: list[float]) -> Array:
        return np.where(np.isnan(self._known), learned, self._known)

    def _written(self, slices: np.ndarray) -> None:
        """Record the level and the extent of slices that were written, and free those that no particle has."""
        owners, droppable, boxes = (
            np.empty(len(slices), np.int64),
            np.empty(len(slices), np.bool_),
            np.empty((len(slices), 4)),
        )
        existence.extents(self._pool, slices, self._evidence.permanent, self._rule.gate, owners, droppable, boxes)
        self._levels[slices], self._droppable[slices], self._boxes[slices] = self._genealogy.level(), droppable, boxes
        self._landmarks[slices[owners == 0]] = -1

    def _within(self, boxes: Array) -> np.ndarray:
        """Return the slices whose box overlaps one of the boxes (K, 4), in the order of creation."""
        used = np.flatnonzero(self._landmarks >= 0)
        left, right, low, high = self._boxes[used].T[:, :, None]
        apart = (left > boxes[:, 1]) | (right < boxes[:, 0]) | (low > boxes[:, 3]) | (high < boxes[:, 2])
        near = used[~apart.all(axis=1)]
        ordered: np.ndarray = near[np.argsort(self._landmarks[near])]
        return ordered

    def _current(self, slices: np.ndarray) -> np.ndarray:
        """Bring slices to the current particle indices, and return them."""
        for index, level in zip(slices.tolist(), self._levels[slices].tolist(), strict=True):
            if not self._genealogy.is_living(level):
                # clip: checked indices would be copied through a buffer
                self._pool[index] = np.take(self._pool[index], self._genealogy.ancestors(level), axis=1, mode="clip")
        return slices

    def _make_room(self, count: int) -> np.ndarray:
        """Return free slices: first those that no living particle has are freed, then the pool is enlarged."""
        free = np.flatnonzero(self._landmarks < 0)
        if len(free) < count:
            for index in range(len(self._pool)):
                level = int(self._levels[index])
                if not np.any(self._pool[index, kernels.EVIDENCE][self._genealogy.ancestors(level)] > 0):
                    self._landmarks[index] = -1
            # more than is needed now, or the search above would be repeated at every scan
            if np.count_nonzero(self._landmarks < 0) < count + len(self._pool) // 4:
                self._enlarge(max(len(self._pool), 2 * count))
            free = np.flatnonzero(self._landmarks < 0)
        return free[:count]

    def _enlarge(self, more: int) -> None:
        self._pool = np.concatenate([self._pool, np.empty((more, *self._pool.shape[1:]))])
        self._landmarks = np.concatenate([self._landmarks, np.full(more, -1)])
        self._levels = np.concatenate([self._levels, np.zeros(more, np.int64)])
        self._droppable = np.concatenate([self._droppable, np.zeros(more, np.bool_)])
        self._boxes = np.concatenate([self._boxes, np.full((more, 4), inf)])
