"""Particles after a step, the estimates made of them, their random numbers, and how they are resampled.

`ParticleState` is what a filter has after a step, `FilterResult` its estimate from a log, and `Samples` are whole
trajectories and maps, with their moments, as smoothers return them.

A resampling scheme says how many copies each particle gets. All are unbiased: E[copies_i] = N w_i. Every scheme returns the
ancestors in ascending order. This costs nothing, keeps the copies of one particle together in memory, and lets the genealogy
find distinct ancestors by comparing neighbours.

Gaussian random numbers are a function of a key and an index, so that threads need no common generator. The filter's generator
draws one key per motion. Each of the N particles then has five numbers of its own, which depend only on the key and on the
particle's index (`vmslam/numbers/random.hpp` in the engine).

Rejected: `Generator.standard_normal`, which takes 7 to 8 ns per number in a single thread (here: 2.3 ns), and one
generator per block of particles, which is repeatable but as slow.

Source: Douc, Cappe and Moulines, *Comparison of resampling schemes for particle filtering*, ISPA 2005.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from graphslam import LandmarkMap, MotionModel, OptionError, SensorModel
from graphslam.engine import engine
from graphslam.se2 import Array, difference, wrap
from graphslam.solvers.uncertainty import ids_of, shaped, split

from .options import FilterOptions, index

if TYPE_CHECKING:
    from .filters.particle_filter import ParticleFilter


def draw_key(rng: np.random.Generator) -> int:
    """Draw a new key: one uniform number of the generator with its 53 bits moved to the top."""
    # rng.bytes and rng.integers take 3 to 8 us, as much as a hundred particles
    return int(rng.random() * 2.0**53) << 11


def standard_normals(rng: np.random.Generator, particles: int) -> Array:
    """Draw the five standard normal numbers of each particle for one motion, (N, 5), as the filters use them."""
    normals: Array = engine.standard_normals(draw_key(rng), particles)
    return normals


@dataclass(frozen=True, eq=False, repr=False)
class Samples:
    """Equally weighted samples of the posterior of a log with T motions and J landmarks, from C chains of S samples each.

    Attributes:
        trajectories: (C, S, T + 1, 3) poses of the robot [m, m, rad].
        maps: (C, S, J, 2 or 3) landmarks; ``ids``: (J,) theirs.
    """

    trajectories: Array
    maps: Array
    ids: np.ndarray

    def __repr__(self) -> str:
        chains, each, poses = self.trajectories.shape[:3]
        return f"{type(self).__name__}({chains * each} trajectories of {poses} poses, {len(self.ids)} landmarks)"

    @cached_property
    def poses(self) -> Array:
        """The mean trajectory, (T + 1, 3); headings are directions of the mean of (cos, sin)."""
        return _mean(self.trajectories.reshape(-1, *self.trajectories.shape[2:]))

    def covariance(self, poses: Any = None, landmarks: Any = None, *, joint: bool = False) -> Any:
        """Covariances of the samples about their means: of all poses, (T + 1, 3, 3), or of what the arguments name.

        Shapes and arguments are those of `Solution.covariance`.

        Raises:
            OptionError: there is no such pose or landmark.
        """
        if poses is None and landmarks is None:
            if not joint:
                return _covariances(self.trajectories, self.poses)
            poses = range(len(self.poses))
        steps, ids = ids_of("poses", poses), ids_of("landmarks", landmarks)
        rows = {j: k for k, j in enumerate(self.ids.tolist())}
        unknown = [f"pose {t}" for t in steps if not 0 <= t < len(self.poses)]
        unknown += [f"landmark {j}" for j in ids if j not in rows]
        if unknown:
            raise OptionError(f"there is no {unknown[0]} among the samples")
        marks = np.array(list(self.landmarks.values()))
        parts = (self.trajectories, self.poses, steps), (self.maps, marks, [rows[j] for j in ids])
        together = np.hstack([
            np.zeros((len(self.trajectories) * self.trajectories.shape[1], 0)),
            *(difference(samples[:, :, chosen], means[chosen]).reshape(-1, len(chosen) * means.shape[1])
              for samples, means, chosen in parts if chosen),
        ])  # fmt: skip
        matrix = together.T @ together / len(together)
        return matrix if joint else split(matrix, poses, landmarks, self.maps.shape[-1])

    @cached_property
    def landmarks(self) -> dict[int, Array]:
        """The mean map, {id: (n,)}."""
        return dict(zip(self.ids.tolist(), _mean(self.maps.reshape(-1, *self.maps.shape[2:])), strict=True))

    @cached_property
    def landmark_covariances(self) -> dict[int, Array]:
        """The covariances of the landmarks, {id: (n, n)}."""
        means = np.array(list(self.landmarks.values()))
        return dict(zip(self.ids.tolist(), _covariances(self.maps, means), strict=True))


def _mean(samples: Array) -> Array:
    return weighted_mean(samples, np.full(len(samples), 1 / len(samples)))


def _covariances(samples: Array, mean: Array) -> Array:
    d = difference(samples, mean).reshape(-1, *mean.shape)
    return np.einsum("sti,stj->tij", d, d) / len(d)


@dataclass(frozen=True, eq=False)
class LandmarkEstimate:
    """The Gaussian of a landmark: mean (x, y) or (x, y, heading) [m, m, rad] and covariance (n, n).

    With unknown association a landmark that may still prove to be a false detection is not ``confirmed``.
    """

    mean: Array
    covariance: Array
    confirmed: bool = True


@dataclass(frozen=True, eq=False, repr=False)
class ParticleState:
    """The particles after one step.

    Attributes:
        step: the step, 0 at the first pose.
        poses: (N, 3) [m, m, rad], headings in [-pi, pi); read-only.
        log_weights: (N,), normalised: their exponentials sum to 1; read-only. After resampling all are -log N.
        ess: effective sample size at the last sightings, before resampling.
        resampled: whether this step resampled.
        best: the particle of the largest weight at the last sightings; its first copy if they led to resampling.
    """

    step: int
    poses: Array
    log_weights: Array
    ess: float
    resampled: bool
    best: int
    _filter: ParticleFilter
    _version: int

    def __repr__(self) -> str:
        return f"<ParticleState: step {self.step}, {len(self.poses)} particles, ESS {self.ess:.1f}>"

    @property
    def best_pose(self) -> Array:
        """The pose of the best particle, (3,)."""
        return self.poses[self.best].copy()

    @property
    def mean_pose(self) -> Array:
        """The weighted mean, (3,); the heading is the direction of the weighted mean of (cos, sin)."""
        return weighted_mean(self.poses, np.exp(self.log_weights))

    def covariance(self, poses: Any = None, landmarks: Any = None, *, joint: bool = False) -> Any:
        """Weighted covariances about the means: of the pose (3, 3), or of what the arguments name.

        Shapes and arguments are those of `OnlineSolver.covariance`. Particles have the present pose only, which has the
        number of the step. Landmarks are those of `mixture_map`; with ``joint``, particles count that have all of them.

        These are the covariances of the particles that resampling has left. Where they have few histories in common
        (`FilterResult.ancestors`), they are several times too small. The option ``smoothing`` gives those of all poses and
        landmarks (`FilterResult.smoothed`) without this fault.

        Raises:
            OptionError: a past pose or an unknown landmark is asked for, no particle has all landmarks of a joint covariance,
                or the filter has taken another step.
        """
        if poses is None and landmarks is None:
            poses = self.step
        if past := [step for step in ids_of("poses", poses) if step != self.step]:
            raise OptionError(f"particles have no pose {past[0]}: they have the present one, {self.step}")
        ids, weights = ids_of("landmarks", landmarks), np.exp(self.log_weights)
        mixture = self.mixture_map(provisional=True) if ids else {}
        if unknown := [id for id in ids if id not in mixture]:
            raise OptionError(f"there is no landmark {unknown[0]} on the map")
        times = len(ids_of("poses", poses))
        if not joint:
            own = weighted_covariance(self.poses, self.mean_pose, weights)
            blocks = [mixture[id].covariance for id in ids]
            return shaped(poses, landmarks, [own] * times, blocks, self._filter._coordinates or 2)
        from scipy.linalg import block_diag

        gaussians = [self._current_filter()._gaussians_of(id) for id in ids]
        among = weights * np.all([owned for _, _, owned in gaussians], axis=0) if ids else weights
        if not among.any():
            raise OptionError("no particle has all of these landmarks: name fewer of them, or leave out joint")
        among /= among.sum()
        samples = [self.poses] * times + [means for means, _, _ in gaussians]
        none = np.zeros((len(self.poses), 0))
        away = np.hstack([none, *(difference(points, weighted_mean(points, among)) for points in samples)])
        within = [np.zeros((3, 3))] * times + [np.tensordot(among, inside, 1) for _, inside, _ in gaussians]
        return away.T @ (among[:, None] * away) + block_diag(*within)

    def map(self, particle: int | None = None, *, provisional: bool = False) -> dict[int, LandmarkEstimate]:
        """Return the map of one particle, by default the best, {id: estimate}; on request with unconfirmed landmarks.

        Maps are stored once, not once per step: ask before the filter takes its next step.

        Raises:
            OptionError: there is no such particle, or the filter has taken another step.
        """
        chosen = self.best if particle is None else index("particle", particle, len(self.poses))
        return self._current_filter()._map(chosen, provisional)

    def mixture_map(self, *, provisional: bool = False) -> dict[int, LandmarkEstimate]:
        """Return mean and covariance of the mixture over all particles, {id: estimate}: E[S] + Cov[m].

        If the association is unknown, these are the landmarks that particles of half the weight or more have confirmed (with
        ``provisional``: have at all), over the particles that have them.

        Raises:
            OptionError: the filter has taken another step.
        """
        return self._current_filter()._mixture(np.exp(self.log_weights), provisional)

    def _current_filter(self) -> ParticleFilter:
        if self._filter._version != self._version:
            raise OptionError("the filter has taken another step: ask a state for maps before the next move or observe")
        return self._filter


@dataclass(frozen=True, eq=False, repr=False)
class FilterResult:
    """The estimate of a particle filter from a log of T motions, with its options and models.

    Attributes:
        estimator: the name of the filter's class; ``log``: the name of the log, "" for a filter without one.
        options, motion, sensor: the options and models of the filter.
        poses: (T+1, 3), the history of the best particle [m, m, rad], headings in [-pi, pi).
        mean_poses: (T+1, 3), the weighted mean of the histories of the particles that survived to the end.
        landmarks, landmark_covariances: the map of the best particle, {id: (n,)} and {id: (n, n)}, n = 2 or 3; with
            unknown association its confirmed landmarks. They belong to ``poses``. The covariances are those over all
            particles, about these places. The landmarks of the filter itself are the means of all particles, like its pose.
        log_weights: (N,) at the end, normalised.
        log_evidence: the logarithm of the estimated density of sightings and positions, by which noise models can be
            compared: the sum over all observations of log sum of (weight before * likelihood). A first sighting with a
            known id has the likelihood 1. Steps whose sightings are impossible for all particles do not count.
        ess: (T+1,) effective sample size after each step, before resampling.
        resampled: (T+1,) whether the step resampled.
        ancestors: (T+1,) how many distinct particles of each step have descendants at the end (the depletion curve).
        association: with unknown association, after the whole log, the landmark (M,) of each sighting on the final map of
            the best particle, unconfirmed landmarks included; `graphslam.log.UNIDENTIFIED` for clutter. Otherwise None.
        unconfirmed: (M,) whether that landmark is not confirmed.
        smoothed: trajectories and maps drawn by backward simulation, if the options ask for it (`fastslam.motions`).
        notes: one sentence each: where the estimate contradicts the log (a robot that was lifted or lost; not of
            measurements that were handed in), and up to which
            step all particles have one history, so that covariances are too small (`fastslam.doubts`).
        datum: latitude, longitude [degrees, WGS 84] and height [m] of the origin of poses and landmarks; None where unknown.
    """

    estimator: str
    log: str
    options: FilterOptions
    motion: MotionModel
    sensor: SensorModel
    poses: Array
    mean_poses: Array
    landmarks: Mapping[int, Array]
    landmark_covariances: Mapping[int, Array]
    log_weights: Array
    log_evidence: float
    ess: Array
    resampled: np.ndarray
    ancestors: np.ndarray
    association: np.ndarray | None = None
    unconfirmed: np.ndarray | None = None
    smoothed: Samples | None = None
    notes: tuple[str, ...] = ()
    datum: Array | None = None

    @property
    def map(self) -> LandmarkMap:
        """The map with the covariances of its landmarks, to save, or for another log.

        With ``smoothing`` it is the mean of the maps that are drawn backwards, with their covariances. Without it, it is that
        of the best particle, with covariances over all particles, which are too small where histories have run out.
        """
        made = self if self.smoothed is None else self.smoothed
        uncertain = {j: C for j, C in made.landmark_covariances.items() if np.any(C)}
        return LandmarkMap(made.landmarks, uncertain, correlated=len(uncertain) > 1, datum=self.datum)

    def __repr__(self) -> str:
        drawn = "" if self.smoothed is None else f", {self.smoothed.trajectories.shape[1]} trajectories drawn backwards"
        return (
            f"FilterResult({self.estimator} on {self.log or 'measurements by hand'}: {len(self.log_weights)} particles, "
            f"{len(self.poses)} poses, {len(self.landmarks)} landmarks, smallest ESS {self.ess.min():.1f}, "
            f"{int(self.resampled.sum())} resamplings, histories left from step 0: {self.ancestors[0]}{drawn})"
        )


def weighted_mean(points: Array, weights: Array) -> Array:
    """Return the mean of points (k, ..., 2 or 3) under weights (k,) that sum to 1; a third coordinate is an angle."""
    mean = np.tensordot(weights, points, 1)
    if points.shape[-1] == 3:
        sines, cosines = (np.tensordot(weights, f(points[..., 2]), 1) for f in (np.sin, np.cos))
        mean[..., 2] = wrap(np.arctan2(sines, cosines))
    return mean


def weighted_covariance(points: Array, mean: Array, weights: Array) -> Array:
    """Return the covariance of (k, n) points about a mean under weights that sum to 1; a third coordinate is an angle."""
    away = difference(points, mean)
    return away.T @ (weights[:, None] * away)


Scheme = Callable[[Array, np.random.Generator], np.ndarray]


def systematic(weights: Array, rng: np.random.Generator) -> np.ndarray:
    """N positions 1/N apart with one random offset: one uniform number, the lowest variance of the copies."""
    return engine.evenly_spaced(np.cumsum(weights), rng.random())


def stratified(weights: Array, rng: np.random.Generator) -> np.ndarray:
    """One uniform position in each of N equal strata: N uniform numbers."""
    count = len(weights)
    return engine.at_positions(np.cumsum(weights), (rng.random(count) + np.arange(count)) / count)


def multinomial(weights: Array, rng: np.random.Generator) -> np.ndarray:
    """N independent draws from the weights: N uniform numbers, the highest variance of the copies."""
    return engine.at_positions(np.cumsum(weights), np.sort(rng.random(len(weights))))


def residual(weights: Array, rng: np.random.Generator) -> np.ndarray:
    """floor(N w_i) copies, and multinomial draws from the remainders for the rest: one uniform number per draw."""
    count = len(weights)
    expected = count * weights / weights.sum()
    # the tolerance keeps rounding errors from losing a copy where N w_i is a whole number
    copies = np.floor(expected * (1 + 1e-12)).astype(np.int64)
    if (rest := count - int(copies.sum())) > 0:
        extra = engine.at_positions(np.cumsum(np.maximum(expected - copies, 0.0)), np.sort(rng.random(rest)))
        copies += np.bincount(extra, minlength=count)
    return np.repeat(np.arange(count), copies)


#: the schemes by the names of `options.RESAMPLING`: weights (N,) that sum to about 1, generator -> ancestors (N,)
RESAMPLING_SCHEMES: dict[str, Scheme] = {
    scheme.__name__: scheme for scheme in (systematic, stratified, residual, multinomial)
}


def effective_sample_size(log_weights: Array) -> float:
    """Return ESS = (sum w)² / sum w², between 1 and N, from log weights (N,) that need not be normalised.

    Source: Kong, Liu and Wong, *Sequential imputations and Bayesian missing data problems*, JASA 1994.
    """
    weights = np.exp(log_weights - np.max(log_weights))
    return float(min(weights.sum() ** 2 / (weights @ weights), len(weights)))
