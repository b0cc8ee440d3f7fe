"""`ParticleState`, the particles after a step, and `FilterResult`, the estimate from a log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg import block_diag

from graphslam.errors import OptionError
from graphslam.landmark_map import LandmarkMap
from graphslam.marginals import ids_of, shaped
from graphslam.models import MotionModel, SensorModel
from graphslam.se2 import Array, wrap

from .checks import index
from .options import FilterOptions
from .samples import Samples

if TYPE_CHECKING:
    from .particle_filter import ParticleFilter


@dataclass(frozen=True, eq=False)
class LandmarkEstimate:
    """The Gaussian of a landmark: mean (x, y) or (x, y, heading) [m, m, rad] and covariance (n, n).

    With unknown association a landmark that may still prove to be a false detection is not ``confirmed``.
    """

    mean: Array
    covariance: Array
    confirmed: bool = True


@dataclass(frozen=True, eq=False)
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
    _filter: ParticleFilter = field(repr=False)
    _version: int = field(repr=False)

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

        Raises:
            OptionError: a past pose or an unknown landmark is asked for, or the filter has taken another step.
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
            return shaped(poses, landmarks, [own] * times, [mixture[id].covariance for id in ids])
        gaussians = [self._current_filter()._gaussians_of(id) for id in ids]
        among = weights * np.all([owned for _, _, owned in gaussians], axis=0) if ids else weights
        among /= among.sum()
        samples = [self.poses] * times + [means for means, _, _ in gaussians]
        away = np.hstack([_deviations(points, weighted_mean(points, among)) for points in samples])
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
            unknown association its confirmed landmarks.
        log_weights: (N,) at the end, normalised.
        log_evidence: the logarithm of the estimated density of the sightings, by which noise models for one log can be
            compared: the sum over all observations of log sum of (weight before * likelihood). A first sighting with a
            known id has the likelihood 1. Steps whose sightings are impossible for all particles do not count.
        ess: (T+1,) effective sample size after each step, before resampling.
        resampled: (T+1,) whether the step resampled.
        ancestors: (T+1,) how many distinct particles of each step have descendants at the end (the depletion curve).
        association: with unknown association, after the whole log, the landmark (M,) of each sighting on the final map of
            the best particle, unconfirmed landmarks included; `graphslam.log.UNIDENTIFIED` for clutter. Otherwise None.
        unconfirmed: (M,) whether that landmark is not confirmed.
        smoothed: trajectories and maps drawn by backward simulation, if the options ask for it (`fastslam.backward`).
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

    @property
    def map(self) -> LandmarkMap:
        """The map of the best particle with the covariances of its landmarks, which are those given its path."""
        known = {j: C for j, C in self.landmark_covariances.items() if np.any(C)}
        return LandmarkMap(self.landmarks, known)

    def __repr__(self) -> str:
        drawn = "" if self.smoothed is None else f", {self.smoothed.trajectories.shape[1]} trajectories drawn backwards"
        return (
            f"FilterResult({self.estimator} on {self.log or 'measurements by hand'}: {len(self.log_weights)} particles, "
            f"{len(self.poses)} poses, {len(self.landmarks)} landmarks, smallest ESS {self.ess.min():.1f}, "
            f"{int(self.resampled.sum())} resamplings{drawn})"
        )


def weighted_mean(points: Array, weights: Array) -> Array:
    """Return the mean of (k, 2) or (k, 3) points under weights (k,) that sum to 1; a third coordinate is an angle."""
    mean = weights @ points
    if points.shape[1] == 3:
        mean[2] = wrap(np.arctan2(weights @ np.sin(points[:, 2]), weights @ np.cos(points[:, 2])))
    return mean


def weighted_covariance(points: Array, mean: Array, weights: Array) -> Array:
    """Return the covariance of (k, n) points about a mean under weights that sum to 1; a third coordinate is an angle."""
    difference = _deviations(points, mean)
    return difference.T @ (weights[:, None] * difference)


def _deviations(points: Array, mean: Array) -> Array:
    """The differences of (k, n) points to a mean; a third coordinate is an angle."""
    difference = points - mean
    if points.shape[1] == 3:
        difference[:, 2] = wrap(difference[:, 2])
    return difference
