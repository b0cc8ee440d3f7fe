"""Samples of whole trajectories and maps, and their moments: what smoothers return."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from graphslam.se2 import Array, wrap


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
