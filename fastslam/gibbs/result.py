"""What particle Gibbs found: samples, their moments, and whether the chains have mixed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from graphslam.models import MotionModel, SensorModel
from graphslam.se2 import Array, wrap

from ..options import GibbsOptions
from .mixing import Mixing, judge


@dataclass(frozen=True, eq=False, repr=False)
class GibbsResult:
    """Samples of the posterior of a log with T motions and J landmarks, from C chains of S sweeps.

    Attributes:
        log: the name of the log; ``options``, ``motion``, ``sensor``: with what it was sampled.
        trajectories: (C, S, T + 1, 3) poses of the robot [m, m, rad].
        maps: (C, S, J, 2 or 3) landmarks; ``ids``: (J,) theirs.
        accepted: the share of renewed stretches that the correction by the exact density accepted; 1 without it.
    """

    log: str
    options: GibbsOptions
    motion: MotionModel
    sensor: SensorModel
    trajectories: Array
    maps: Array
    ids: np.ndarray
    accepted: float

    @cached_property
    def poses(self) -> Array:
        """The mean trajectory, (T + 1, 3); headings are directions of the mean of (cos, sin)."""
        return _mean(self.trajectories.reshape(-1, *self.trajectories.shape[2:]))

    @cached_property
    def pose_covariances(self) -> Array:
        """The covariances of the poses about their means, (T + 1, 3, 3)."""
        return _covariances(self.trajectories, self.poses)

    @cached_property
    def landmarks(self) -> dict[int, Array]:
        """The mean map, {id: (n,)}."""
        means = _mean(self.maps.reshape(-1, *self.maps.shape[2:]))
        return dict(zip(self.ids.tolist(), means, strict=True))

    @cached_property
    def landmark_covariances(self) -> dict[int, Array]:
        """The covariances of the landmarks, {id: (n, n)}."""
        means = np.array(list(self.landmarks.values()))
        return dict(zip(self.ids.tolist(), _covariances(self.maps, means), strict=True))

    @cached_property
    def mixing(self) -> Mixing:
        """R-hat and effective sample size of every coordinate of poses and landmarks, and what they say."""
        poses = self.trajectories[:, :, 1:] - self.poses[1:]
        maps = self.maps - np.array(list(self.landmarks.values()))
        for deviations in (poses, maps):
            if deviations.shape[-1] == 3:
                deviations[..., 2] = wrap(deviations[..., 2])
        names = [f"{c} of step {t}" for t in range(1, len(self.poses)) for c in ("x", "y", "heading")]
        names += [f"{c} of landmark {j}" for j in self.ids for c in ("x", "y", "heading")[: maps.shape[-1]]]
        shape = (*poses.shape[:2], -1)
        return judge(np.concatenate([poses.reshape(shape), maps.reshape(shape)], axis=2), names)

    def __repr__(self) -> str:
        chains, sweeps, poses = self.trajectories.shape[:3]
        return (
            f"GibbsResult({self.log}: {chains} chains of {sweeps} samples, {poses} poses, {len(self.ids)} landmarks; "
            f"{self.mixing.statement})"
        )


def _mean(samples: Array) -> Array:
    mean = samples.mean(axis=0)
    if samples.shape[-1] == 3:
        mean[:, 2] = wrap(np.arctan2(np.sin(samples[..., 2]).mean(axis=0), np.cos(samples[..., 2]).mean(axis=0)))
    return mean


def _covariances(samples: Array, mean: Array) -> Array:
    d = samples.reshape(-1, *mean.shape) - mean
    if mean.shape[1] == 3:
        d[..., 2] = wrap(d[..., 2])
    return np.einsum("sti,stj->tij", d, d) / len(d)
