"""Monte Carlo localisation on a known map, FastSLAM 1.0 and FastSLAM 2.0.

FastSLAM 1.0: every particle carries a trajectory and, given that, a map of independent Gaussians.

Sources: Murphy, *Bayesian map learning in dynamic environments*, NIPS 1999; Montemerlo, Thrun, Koller and Wegbreit,
*FastSLAM*, AAAI 2002; *Probabilistic Robotics*, section 13.3; Ueda, *LNPR*, chapter 8.

FastSLAM 2.0: the pose is drawn from the motion model, corrected by the sightings of the step.

Sources: Montemerlo, Thrun, Koller and Wegbreit, *FastSLAM 2.0*, IJCAI 2003; *Probabilistic Robotics*, section 13.5 to
13.8.

Monte Carlo localisation: the pose of the robot on a known map. FastSLAM extends it.

Sources: Dellaert, Fox, Burgard and Thrun, *Monte Carlo localization for mobile robots*, ICRA 1999; *Probabilistic
Robotics*, section 8.3; Ueda, *LNPR*, chapter 5.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from graphslam import Log, OptionError
from graphslam.association import ids_by_map
from graphslam.association.problem import Classes
from graphslam.errors import checks
from graphslam.graph.trilateration import WaitingNumbers, edges_of_rows
from graphslam.maps.landmark_map import as_map
from graphslam.se2 import Array

from ..options import JOINT, WITH_IDS
from ..particles import FilterResult, LandmarkEstimate, weighted_covariance, weighted_mean
from .particle_filter import ParticleFilter

#: the largest range [m] and standard deviation, whose inverse is the smallest standard deviation: products of three
#: variances and squares of covariances are then finite
LARGEST = 1e50
#: the standard deviation [m, rad] of landmarks that are exact in a map
HELD_STD = 1e-6
#: two landmarks are one within the ellipse that holds all but this share of their differences
MERGED = 0.05
#: the counter of existence from which on a landmark of unknown id is part of the map: it was seen twice
CONFIRMED = 2.0


class FastSLAM1(ParticleFilter):
    """FastSLAM 1.0, for sightings with or without psi (with psi landmarks have a heading).

    A first sighting initialises a landmark as N(h^-1(x, z), (H' Q^-1 H)^-1) and does not change the weight. A later one
    multiplies the weight by N(z; h(m), V), V = H S H' + Q, and then updates the landmark with the gain K = S H' V^-1. A
    particle that stands on its landmark (nearer than 1e-9 m) has no bearing to it: its likelihood is 0 and that landmark
    is not updated.

    With the landmark_update "joint" each landmark is integrated over all of its sightings at once instead of linearising each
    (`vmslam/particles/joint.hpp` in the engine). With the range_noise "estimated" Q is taken at |m - x|, as in the slides,
    not at the measured range; that of a first sighting is always at the measured range.

    With the association "maximum-likelihood" ids are ignored, and `observe` takes None for them. Each particle assigns
    every sighting to the most likely landmark of its own map, the most likely pair of the scan first, and uses no
    landmark twice. A sighting that is more likely to belong to a new landmark creates one. New landmarks are
    provisional. Their counter of existence is the number of sightings minus that of observed steps in which they should
    have been seen and were not, counted when the step is over. A landmark should be seen well within the limits of the
    sensor (``max_range``, ``field_of_view``); a limit that it does not have is that of all sightings so far. At
    0 a landmark is dropped, from 2 on it is confirmed, and from 3 on it is permanent. A step is observed if
    `observe` was called in it, even without sightings; a step of a log is observed if it has sightings. Maps number
    landmarks in the order of creation and leave out unconfirmed ones, except on request.

    Landmarks of a particle that turn out to be one are merged. "auto" uses ids where the log has them, else it is
    `options.WITHOUT_IDS`. See docs/beyond/fastslam2.md, "Unknown association".

    With ``map``, which is known beforehand (`landmark_map.as_map` says in which forms), every particle
    begins with its landmarks and their own covariances. Correlations between landmarks are not used, and exact ones have a
    standard deviation of `HELD_STD`. The ids of the sightings must be those of the map, and its frame that of ``start``;
    without one, the first fix is taken where the log's own first pose is in another frame.

    A range or a bearing alone updates a landmark as the Kalman filter does. One of a landmark without a place waits until
    single numbers leave one place for the landmark along the trajectory of the heaviest particle, mirror images excluded;
    that place, its covariance increased by that of the particles' positions, is then the landmark of all particles. The
    numbers that waited are not used again. This needs ids, the Kalman update, the measured range noise and no smoothing.

    All other arguments and errors are those of `ParticleFilter`; all options are fields of `FilterOptions`. The
    new_landmark_threshold p decides when a sighting belongs to a new landmark: where its likelihood under every known
    landmark is below the density at the border of the ellipse that holds 1 - p of the sightings of a perfectly known
    landmark. For each new landmark a particle's weight is multiplied by that density.
    """

    def __init__(self, log: Log | None = None, *, map: Any = None, **keywords: Any) -> None:
        self._given = None if map is None else as_map(map)
        super().__init__(log, map=self._given, **keywords)
        self._waiting = WaitingNumbers(self.sensor)
        if self._given is not None and not self._needs_ids:
            raise OptionError("a map is used by the ids of its landmarks: leave out the option association, or the map")
        if self._given is not None and self.options.smoothing:
            why = "trajectories that are drawn backwards do not know a map"
            raise OptionError(f"{why}: leave out smoothing, or the map")
        if self._given is not None:
            # the first sighting says whether headings are used
            self._begin_maps(3 if self._given.oriented else 2)

    def _check_options(self) -> None:
        options = self.options
        given = [name for name, default in WITH_IDS.items() if getattr(options, name) != default]
        if given and not options.uses_ids:
            raise OptionError(
                f"{given[0]} {getattr(options, given[0])} needs the association known, so ids of all sightings; with the "
                f"association {options.association}, which auto is where a log lacks ids, leave out {' and '.join(given)}"
            )

    @property
    def _needs_ids(self) -> bool:
        return self.options.uses_ids

    @property
    def _takes_single_numbers(self) -> bool:
        options = self.options
        plain = options.landmark_update == "kalman" and options.range_noise != "estimated" and not options.smoothing
        return self._needs_ids and plain

    def _with_place(self, ids: np.ndarray, sightings: Array) -> np.ndarray:
        self._begin_if_first(sightings)
        single = np.isnan(sightings).any(axis=1)
        placed = ~single | np.isin(ids, self._engine.landmarks()) | np.isin(ids, ids[~single])
        for k in np.flatnonzero(~placed).tolist():
            self._wait(int(ids[k]), sightings[k])
        return placed

    def _wait(self, id: int, sighting: Array) -> None:
        """Keep a single number of a landmark without a place, and give it one where the numbers so far leave one."""
        row = (self._step, float(sighting[0]), float(sighting[1]))
        if (place := self._waiting.add(id, row, self.trajectory)) is None:
            return
        poses, information = self.trajectory(), np.zeros((2, 2))
        for each in edges_of_rows(id, self._waiting.take(id), self._waiting.sensor, len(poses)):
            linear = each.linearize(np.vstack([poses, [*place, 0.0]]), poses)
            B = linear.jacobians[1][:, :, :2]
            information += np.einsum("eia,eij,ejb->ab", B, linear.information, B)
        weights, particles = np.exp(self._engine.log_weights), self._engine.poses[:, :2]
        spread = weighted_covariance(particles, weighted_mean(particles, weights), weights)
        self._engine.place(id, place, np.linalg.inv(information) + spread)

    def result(self) -> FilterResult:
        """Return the estimate so far, with a note on landmarks that have no place yet."""
        result = super().result()
        if not (without := sorted(self._waiting.rows.keys() - set(self._engine.landmarks().tolist()))):
            return result
        note = f"{checks.listed('landmark', without)} left out: their ranges or bearings alone do not leave one place"
        return replace(result, notes=(*result.notes, note))

    def _check_sightings(self, ids: np.ndarray, columns: int) -> None:  # noqa: ARG002
        if self._coordinates is not None and columns != self._coordinates:
            raise OptionError(f"sightings so far had {self._coordinates} columns, these have {columns}")

    @cached_property
    def _classes(self) -> Classes | None:
        """The classes of the sightings of the log, where they are used."""
        return None if self.log is None or self._needs_ids else Classes.of(self.log, self.options.class_confusion)

    def _weigh(self, ids: np.ndarray, sightings: Array, q: Array, rows: slice | None = None) -> bool:
        # three comparisons first, because this is checked at every step
        if sightings[:, 0].max() > LARGEST or q.min() < LARGEST**-2 or q.max() > LARGEST**2:
            k = int(np.argmax((sightings[:, 0] > LARGEST) | np.any((q < LARGEST**-2) | (q > LARGEST**2), axis=1)))
            raise OptionError(
                f"step {self._step}: sighting {k}, of range {sightings[k, 0]:g} m with noise of standard deviations "
                f"{', '.join(f'{std:g}' for std in np.sqrt(q[k]))}, is beyond floating point; leave it out, or change "
                "the sensor model"
            )
        self._begin_if_first(sightings)
        if self._needs_ids:
            return bool(self._engine.weigh_identified(ids, sightings, q, self._poses_drawn))
        # sightings that are handed in are of unknown class
        shown = np.full(len(sightings), len(self._confusion))
        if self._classes is not None and rows is not None:
            shown = np.minimum(self._classes.shown[rows], len(self._confusion))
        self._engine.weigh_anonymous(sightings, q, shown, self._poses_drawn)
        return True

    @property
    def _poses_drawn(self) -> int:
        """The engine's proposal of poses at a step with sightings: here, their motion only."""
        return 0

    def _begin_if_first(self, sightings: Array) -> None:
        if self._coordinates is None:
            self._coordinates = sightings.shape[1]
            self._begin_maps(self._coordinates)

    def _begin_maps(self, n: int) -> None:
        """Give the particles empty maps of landmarks with n coordinates, or the map that is given."""
        options, sensor = self.options, self.sensor
        if not self._needs_ids:
            from scipy.special import chdtri  # imported here because it takes 0.3 s and known ids do not need it

            # quantiles of the chi-squared distribution
            border, merged = (float(chdtri(n, p)) for p in (options.new_landmark_threshold, MERGED))
            known = np.array([sensor.min_range, sensor.max_range, sensor.field_of_view / 2])
            limits = np.where(known == [0.0, np.inf, np.pi], np.nan, known).tolist()
            self._engine.use_no_ids(n == 3, border, merged, options.merge_interval, limits, self._confusion)
            return
        noise = (sensor.range_rate, sensor.range_std**2) if options.range_noise == "estimated" else None
        self._engine.use_ids(n == 3, JOINT if options.landmark_update == "joint" else 0, noise)
        for j, place in (self._given or {}).items():
            if len(place) < n:
                raise OptionError(
                    f"landmark {j} of the map has no heading, and the sightings have psi: use log.without_orientation()"
                )
            assert self._given is not None
            own = self._given.covariances.get(j, np.zeros((3, 3)))[:n, :n]
            self._engine.place(j, place[:n], own + HELD_STD**2 * np.eye(n))

    @cached_property
    def _confusion(self) -> Array:
        """P(shown k given c), (n, n + 1), of the classes; (0, 1) where there are none."""
        if self._classes is None or self._classes.count == 1:
            return np.empty((0, 1))
        return np.exp(self._classes.log_confusion)

    def _association(self, poses: Array) -> dict[str, Any]:
        if self.log is None or self._needs_ids or self._next < self.log.num_poses:
            return {}
        estimates = self._map(self._engine.best, provisional=True)
        means = {j: estimate.mean for j, estimate in estimates.items()}
        covariances = {j: estimate.covariance for j, estimate in estimates.items()}
        probabilities = {}
        if self._coordinates is not None:
            probabilities = {j: self._engine.class_probabilities(j, self._engine.best) for j in estimates}
        ids = ids_by_map(self.log, poses, means, covariances, self.sensor, self._classes, probabilities)
        doubtful = [j for j, estimate in estimates.items() if not estimate.confirmed]
        return {"association": ids, "unconfirmed": np.isin(ids, doubtful)}

    def _gaussians(self, first: int, count: int) -> Iterator[tuple[int, Array, Array, Array]]:
        """Yield for every landmark, in some particles: id, means (k, n), covariances (k, n, n) and counters (k,).

        The counter of existence is 0 where a particle does not have the landmark, and infinite where its id is known.
        """
        for j in self._engine.landmarks().tolist():
            yield j, *self._engine.landmark(j, first, count)

    def _gaussians_of(self, id: int) -> tuple[Array, Array, np.ndarray]:
        means, covariances, counter = self._engine.landmark(id, 0, self.particles)
        return means, covariances, counter > 0

    @property
    def _confirmed(self) -> float:
        """The counter from which on a landmark is part of the map."""
        return 1.0 if self._needs_ids else CONFIRMED

    def _map(self, particle: int, provisional: bool) -> dict[int, LandmarkEstimate]:
        return {
            j: LandmarkEstimate(means[0], covariances[0], bool(counter[0] >= self._confirmed))
            for j, means, covariances, counter in self._gaussians(particle, 1)
            if counter[0] > 0 and (provisional or counter[0] >= self._confirmed)
        }

    def _mixture(self, weights: Array, provisional: bool) -> dict[int, LandmarkEstimate]:
        estimates = {}
        for j, means, covariances, counter in self._gaussians(0, self.particles):
            owned = counter > 0
            share, confirmed = weights @ owned, bool(weights @ (counter >= self._confirmed) >= 0.5)
            # landmarks of particles with most of the weight, as those particles estimate them
            if share < 0.5 or not (confirmed or provisional):
                continue
            among = np.where(owned, weights / share, 0.0)[owned]
            mean = weighted_mean(means[owned], among)
            within = np.tensordot(among, covariances[owned], 1)
            estimates[j] = LandmarkEstimate(mean, within + weighted_covariance(means[owned], mean, among), confirmed)
        return estimates


#: how the engine draws the poses: corrected by the sightings, with exact weights or with those of the lectures
CORRECTED_EXACT, CORRECTED_LINEARISED = 1, 2


class FastSLAM2(FastSLAM1):
    """FastSLAM 2.0, for sightings with or without psi; arguments and unknown association as in `FastSLAM1`.

    At a step with sightings of known landmarks each particle takes the motion as a Gaussian with mean f(x_{t-1}, u_t)
    and covariance P = A M A' + epsilon I (plus that of a slip), and corrects it by one sighting after the other as a
    Kalman filter: V = H_x P H_x' + H_m S H_m' + Q, K = P H_x' V^-1. The pose is drawn from the result q, and the
    landmarks are updated from that pose as in 1.0. Steps without sightings of known landmarks move as in 1.0, without
    linearisation.

    With the proposal_weight "exact" the weight is multiplied by p(x) / q(x) and by the likelihoods of 1.0 at the drawn
    pose x, so 1.0 and 2.0 have the same posterior
    (`vmslam/particles/proposal.hpp` in the engine). With "linearised", as in the lectures and the original, it
    is multiplied by the likelihoods under the prediction, N(z; h(x, m), V), which is biased where h or f is not linear.

    A landmark seen several times in one step enters the proposal once, with its first sighting. The other sightings use
    the drawn pose and are weighed with the V of 1.0, as are all sightings where nothing moved (the first step, dt = 0).

    `move` draws the motion and `observe` corrects it with the same random numbers, so the poses of a step change when
    sightings arrive. Give all sightings of a step in one call; those of a second call only change the weights, as in
    1.0. With unknown association the landmarks are chosen under the prediction, before any of them corrects it; a step
    with new landmarks only is drawn from the linearised motion.
    """

    # its poses are drawn from the motion corrected by the sightings
    _crosses_logs = True

    def _check_options(self) -> None:
        super()._check_options()
        if self.options.range_noise == "estimated" and self.options.proposal_weight != "exact":
            raise OptionError(
                f"FastSLAM 2.0 with range_noise {self.options.range_noise} needs the proposal_weight exact, not "
                f"{self.options.proposal_weight}, which is that of the measured range: leave out one of them"
            )

    @property
    def _poses_drawn(self) -> int:
        return CORRECTED_EXACT if self.options.proposal_weight == "exact" else CORRECTED_LINEARISED


class MonteCarloLocalization(ParticleFilter):
    """The particle filter on a known map: the weight is multiplied by N(z; h(x, m), Q).

    psi is used where both the sighting and the landmark have a heading, and ignored otherwise.

    Of landmarks with their own covariance C the likelihood is N(z; h(x, m), Q + H C H'). The filter does not learn where they
    are: each sighting counts as if the landmark were off anew, and correlations between landmarks are not used. So where few
    are seen again and again, the covariances of poses stay too small; graph SLAM in the map, or `FastSLAM1` with ``map``,
    does not have this fault.

    Args:
        log: controls and sightings; None for a filter that is used with `move` and `observe`.
        map: {id: (x, y) or (x, y, heading)} [m, m, rad], or what else `landmark_map.as_map` takes; default: the log's true
            landmarks, in whose frame its first initial pose is. In a map that is given, the robot begins at the first fix
            where its initial pose is in another frame.
        keywords: all other arguments of `ParticleFilter`.

    Raises:
        OptionError: an option has an impossible value, there is no map, or the log has sightings of other landmarks.
        LogError: the log has no controls.
    """

    HAS_MAPS = False
    _HOW_WITHOUT_IDS = (
        "by which Monte Carlo localisation knows its landmarks: take FastSLAM, which finds out, or first give the log ids "
        "by fastslam.associate"
    )

    def __init__(self, log: Log | None = None, *, map: Any = None, **keywords: Any) -> None:
        super().__init__(log, map=None if map is None else as_map(map), **keywords)
        if map is None:
            map = getattr(log, "true_landmarks", None)
        if map is None:
            without = "" if log is None else f", and {log.name} has no true landmarks"
            raise OptionError(
                f"Monte Carlo localisation needs a map{without}: give map, {{id: (x, y) or (x, y, heading)}}, or "
                "use FastSLAM, which makes its own"
            )
        self._landmarks = as_map(map)
        if log is not None:
            self._check_sightings(log.landmark_ids, log.sightings.shape[1])
            if log.partial_sightings is not None:
                self._check_sightings(np.unique(log.partial_sightings.landmarks), 2)

    def _check_sightings(self, ids: np.ndarray, columns: int) -> None:  # noqa: ARG002
        for j in ids.tolist():
            if j not in self._landmarks:
                advice = "add it to the map, or use FastSLAM1"
                raise OptionError(f"landmark {j} was seen but is not on the known map: {advice}")

    def _weigh(self, ids: np.ndarray, sightings: Array, q: Array, rows: slice | None = None) -> bool:  # noqa: ARG002
        places, covariances = np.zeros((len(ids), 3)), np.zeros((len(ids), 3, 3))
        oriented = np.zeros(len(ids), dtype=bool)
        for k, j in enumerate(ids.tolist()):
            n = len(self._landmarks[j])
            places[k, :n], covariances[k, :n, :n] = self._landmarks[j], self._covariance_of(j)
            oriented[k] = n == sightings.shape[1] == 3
        self._engine.weigh_known(places, covariances, sightings, q, oriented)
        return True

    def _covariance_of(self, id: int) -> Array:
        n = len(self._landmarks[id])
        return self._landmarks.covariances.get(id, np.zeros((n, n)))

    def _map(self, particle: int, provisional: bool) -> dict[int, LandmarkEstimate]:  # noqa: ARG002
        return {j: LandmarkEstimate(m.copy(), self._covariance_of(j).copy()) for j, m in self._landmarks.items()}

    def _gaussians_of(self, id: int) -> tuple[Array, Array, np.ndarray]:
        m, N = self._landmarks[id], self.particles
        return np.tile(m, (N, 1)), np.tile(self._covariance_of(id), (N, 1, 1)), np.ones(N, dtype=bool)

    def _mixture(self, weights: Array, provisional: bool) -> dict[int, LandmarkEstimate]:  # noqa: ARG002
        return self._map(0, provisional)
