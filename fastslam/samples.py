"""Samples of whole trajectories and maps, and their moments: what smoothers return."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from graphslam.errors import OptionError
from graphslam.marginals import ids_of, split
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

    def covariance(self, poses: Any = None, landmarks: Any = None, *, joint: bool = False) -> Any:
        """Covariances of the samples about their means: of all poses, (T + 1, 3, 3), or of what the arguments name.

        Shapes and arguments are those of `Solution.covariance`.

        Raises:
            OptionError: there is no such pose or landmark.
        """
        steps, ids = ids_of("poses", poses), ids_of("landmarks", landmarks)
        rows = {j: k for k, j in enumerate(self.ids.tolist())}
        for what, unknown in (
            ("pose", [t for t in steps if not 0 <= t < len(self.poses)]),
            ("landmark", [j for j in ids if j not in rows]),
        ):
            if unknown:
                raise OptionError(f"there is no {what} {unknown[0]} among the samples")
        if poses is None and landmarks is None:
            if not joint:
                return _covariances(self.trajectories, self.poses)
            steps = list(range(len(self.poses)))
        marks = np.array(list(self.landmarks.values()))
        away = [
            _deviations(samples[:, :, chosen], means[chosen]).reshape(-1, len(chosen) * means.shape[1])
            for samples, means, chosen in (
                (self.trajectories, self.poses, steps),
                (self.maps, marks, [rows[j] for j in ids]),
            )
            if chosen
        ]
        together = np.hstack(away)
        matrix = together.T @ together / len(together)
        return matrix if joint else split(matrix, poses, landmarks)

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
    d = _deviations(samples, mean).reshape(-1, *mean.shape)
    return np.einsum("sti,stj->tij", d, d) / len(d)


def _deviations(samples: Array, mean: Array) -> Array:
    d = samples - mean
    if mean.shape[1] == 3:
        d[..., 2] = wrap(d[..., 2])
    return d
