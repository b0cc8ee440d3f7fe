"""FastSLAM 1.0: every particle carries a trajectory and, given that, a map of independent Gaussians.

Sources: Murphy, *Bayesian map learning in dynamic environments*, NIPS 1999; Montemerlo, Thrun, Koller and Wegbreit,
*FastSLAM*, AAAI 2002; *Probabilistic Robotics*, section 13.3; Ueda, *LNPR*, chapter 8.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Any

import numpy as np

from graphslam.association import ids_by_map
from graphslam.association.classes import Classes
from graphslam.errors import OptionError
from graphslam.landmark_map import as_map
from graphslam.log import Log
from graphslam.se2 import Array

from .anonymous_maps import AnonymousLandmarks
from .identified_maps import IdentifiedLandmarks
from .noise import draw_key
from .particle_filter import ParticleFilter
from .state import LandmarkEstimate, weighted_covariance, weighted_mean

#: the largest range [m] and standard deviation, whose inverse is the smallest standard deviation: products of three
#: variances and squares of covariances are then finite
LARGEST = 1e50
#: the standard deviation [m, rad] of landmarks that are exact in a map
EXACT = 1e-6


class FastSLAM1(ParticleFilter):
    """FastSLAM 1.0, for sightings with or without psi (with psi landmarks have a heading).

    A first sighting initialises a landmark as N(h^-1(x, z), (H' Q^-1 H)^-1) and does not change the weight. A later one
    multiplies the weight by N(z; h(m), V), V = H S H' + Q, and then updates the landmark with the gain K = S H' V^-1. A
    particle that stands on its landmark (nearer than 1e-9 m) has no bearing to it: its likelihood is 0 and that landmark
    is not updated.

    With the landmark_update "moments" both are integrals instead of linearisations (`refined_kernels`): the posterior is then
    exact as far as it is Gaussian in the landmarks. With "joint" each landmark is integrated over all of its sightings
    at once (`joint_kernels`), which does not need this. With the range_noise "estimated" Q is taken at |m - x|, as in the
    slides, not at the measured range; that of a first sighting is always at the measured range.

    With the association "maximum-likelihood" ids are ignored, and `observe` takes None for them. Each particle assigns
    every sighting to the most likely landmark of its own map, the most likely pair of the scan first, and uses no
    landmark twice. A sighting that is more likely to belong to a new landmark creates one. New landmarks are
    provisional. Their evidence is the number of their sightings minus the number of observed steps in which they should
    have been seen and were not, counted when the step is over. A landmark should be seen well within the limits of the
    sensor (``max_range``, ``field_of_view``); a limit that it does not have is that of all sightings so far. With
    evidence 0 a landmark is dropped, from 2 on it is confirmed, and from 3 on it is permanent. A step is observed if
    `observe` was called in it, even without sightings; a step of a log is observed if it has sightings. Maps number
    landmarks in the order of creation and leave out unconfirmed ones, except on request.

    With the association "sampled" each particle draws the landmark of a sighting in proportion to the evidence of the
    hypotheses, as far as the scan has not used them, and its weight is multiplied by the sum of that evidence. The
    evidence for a landmark is then the log of its odds, and a landmark in view that is not seen changes the weight too.
    Landmarks of a particle that turn out to be one are merged. "auto" uses ids where the log has them, else it is
    `options.WITHOUT_IDS`. See docs/fastslam.md, "Unknown association".

    With ``landmarks``, a map that is known beforehand (`graphslam.landmark_map.as_map` says in which forms), every particle
    begins with its landmarks and their own covariances. Correlations between landmarks are not used, and exact ones have a
    standard deviation of `EXACT`. The ids of the sightings must be those of the map, and its frame that of ``start``.

    All other arguments and errors are those of `ParticleFilter`; all options are fields of `FilterOptions`. The
    new_landmark_threshold p decides when a sighting belongs to a new landmark: where its likelihood under every known
    landmark is below the density at the border of the ellipse that holds 1 - p of the sightings of a perfectly known
    landmark. For each new landmark a particle's weight is multiplied by that density.
    """

    _maps: IdentifiedLandmarks | AnonymousLandmarks | None = None

    def __init__(self, log: Log | None = None, *, landmarks: Any = None, **keywords: Any) -> None:
        super().__init__(log, **keywords)
        self._given = None if landmarks is None else as_map(landmarks)
        if self._given is not None and not self._needs_ids:
            raise OptionError("a map is used by the ids of its landmarks: leave out the option association, or the map")
        if self._given is not None and self.options.smoothing:
            raise OptionError(
                "trajectories that are drawn backwards do not know a map: leave out smoothing, or the map"
            )

    @property
    def _needs_ids(self) -> bool:
        return self.options.uses_ids

    def _check_sightings(self, ids: np.ndarray, columns: int) -> None:  # noqa: ARG002
        if self._maps is not None and columns != self._maps.coordinates:
            raise OptionError(f"sightings so far had {self._maps.coordinates} columns, these have {columns}")

    @cached_property
    def _classes(self) -> Classes | None:
        """The classes of the sightings of the log, where they are used."""
        return None if self.log is None or self._needs_ids else Classes.of(self.log, self.options.class_confusion)

    def _weigh(self, ids: np.ndarray, sightings: Array, q: Array, rows: slice | None = None) -> Array | None:
        # three comparisons first, because this is checked at every step
        if sightings[:, 0].max() > LARGEST or q.min() < LARGEST**-2 or q.max() > LARGEST**2:
            k = int(np.argmax((sightings[:, 0] > LARGEST) | np.any((q < LARGEST**-2) | (q > LARGEST**2), axis=1)))
            raise OptionError(
                f"step {self._step}: sighting {k}, of range {sightings[k, 0]:g} m with noise of standard deviations "
                f"{', '.join(f'{std:g}' for std in np.sqrt(q[k]))}, is beyond floating point; leave it out, or change "
                "the sensor model"
            )
        if self._maps is None:
            shape = self._genealogy, self._threads, self.particles, sightings.shape[1]
            if self._needs_ids:
                estimated = self.options.range_noise == "estimated"
                self._maps = IdentifiedLandmarks(
                    *shape,
                    landmark_update=self.options.landmark_update,
                    range_noise=(self.sensor.range_rate, self.sensor.range_std) if estimated else None,
                )
                self._place_given(self._maps)
            else:
                self._maps = AnonymousLandmarks(*shape, self.options, self.sensor, self._classes)
        if isinstance(self._maps, IdentifiedLandmarks):
            return self._weigh_identified(self._maps, ids, sightings, q)
        if self._classes is None or rows is None:
            # sightings that are handed in are of unknown class
            shown = np.full(len(sightings), 0 if self._classes is None else self._classes.count)
        else:
            shown = self._classes.shown[rows].copy()
        return self._weigh_anonymous(self._maps, sightings, q, shown)

    def _place_given(self, maps: IdentifiedLandmarks) -> None:
        """Put the landmarks of the map that is given into all maps."""
        n = maps.coordinates
        for j, place in (self._given or {}).items():
            if len(place) < n:
                raise OptionError(
                    f"landmark {j} of the map has no heading, and the sightings have psi: use log.without_orientation()"
                )
            assert self._given is not None
            own = self._given.covariances.get(j, np.zeros((3, 3)))[:n, :n]
            maps.place(j, place[:n], own + EXACT**2 * np.eye(n))

    def _weigh_identified(self, maps: IdentifiedLandmarks, ids: np.ndarray, sightings: Array, q: Array) -> Array | None:
        """Weigh sightings with ids, as `_weigh`."""
        log_likelihood = None
        for j, z, variances in zip(ids.tolist(), sightings, q, strict=True):
            if j not in maps:
                maps.initialize(j, self._poses, z, variances)
                continue
            if log_likelihood is None:
                log_likelihood = np.zeros(self.particles)
            maps.update(j, self._poses, z, variances, log_likelihood)
        maps.finish()
        return log_likelihood

    def _weigh_anonymous(self, maps: AnonymousLandmarks, sightings: Array, q: Array, shown: np.ndarray) -> Array:
        """Weigh sightings without ids from the current poses; each particle decides which landmarks they belong to."""
        log_likelihood, belief = np.zeros(self.particles), np.zeros((9, self.particles))
        belief[:3] = self._poses
        # the poses are not written here, but the kernel is compiled for writable ones
        maps.scan(belief, belief[:3], sightings, q, self._step, log_likelihood, self._choices(maps), shown)
        return log_likelihood

    def _association(self, poses: Array) -> dict[str, np.ndarray]:
        if self.log is None or self._needs_ids or self._next < self.log.num_poses:
            return {}
        estimates = self._map(self._best, provisional=True)
        means = {j: estimate.mean for j, estimate in estimates.items()}
        covariances = {j: estimate.covariance for j, estimate in estimates.items()}
        probabilities = {}
        if isinstance(self._maps, AnonymousLandmarks):
            probabilities = {j: self._maps.class_probabilities(j, self._best) for j in estimates}
        ids = ids_by_map(self.log, poses, means, covariances, self.sensor, self._classes, probabilities)
        doubtful = [j for j, estimate in estimates.items() if not estimate.confirmed]
        return {"association": ids, "unconfirmed": np.isin(ids, doubtful)}

    def _choices(self, maps: AnonymousLandmarks) -> np.uint64:
        """The key of the numbers by which the associations of a scan are drawn."""
        return draw_key(self._rng) if maps.sampled else np.uint64(0)

    def _end_step(self) -> None:
        if self._maps is not None:
            self._maps.end_step(self._poses, self._step)

    def _gaussians(self, particles: slice) -> Iterator[tuple[int, Array, Array, Array]]:
        """Yield for every landmark: id, means (k, n), covariances (k, n, n) and evidence (k,), 0 where it is missing."""
        if self._maps is not None:
            for j in self._maps.ids:
                yield j, *self._maps.gaussians(j, particles)

    @property
    def _confirmed(self) -> float:
        """The evidence from which on a landmark is part of the map."""
        return self._maps.confirmed if isinstance(self._maps, AnonymousLandmarks) else 1.0

    def _map(self, particle: int, provisional: bool) -> dict[int, LandmarkEstimate]:
        return {
            j: LandmarkEstimate(means[0], covariances[0], bool(evidence[0] >= self._confirmed))
            for j, means, covariances, evidence in self._gaussians(slice(particle, particle + 1))
            if evidence[0] > 0 and (provisional or evidence[0] >= self._confirmed)
        }

    def _mixture(self, weights: Array, provisional: bool) -> dict[int, LandmarkEstimate]:
        estimates = {}
        for j, means, covariances, evidence in self._gaussians(slice(None)):
            owned = evidence > 0
            share, confirmed = weights @ owned, bool(weights @ (evidence >= self._confirmed) >= 0.5)
            # landmarks of particles with most of the weight, as those particles estimate them
            if share < 0.5 or not (confirmed or provisional):
                continue
            among = np.where(owned, weights / share, 0.0)[owned]
            mean = weighted_mean(means[owned], among)
            within = np.tensordot(among, covariances[owned], 1)
            estimates[j] = LandmarkEstimate(mean, within + weighted_covariance(means[owned], mean, among), confirmed)
        return estimates
