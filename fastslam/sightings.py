"""A log as arrays for the engine, its sightings linearised in the axes of the robot."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from graphslam.engine import engine
from graphslam.log import Log
from graphslam.models import MotionModel, SensorModel
from graphslam.se2 import Array, wrap

from .motions import sensor_motions


@dataclass(frozen=True, eq=False, kw_only=True)
class Sightings:
    """Sightings of the sensor with their linearisation.

    Attributes:
        first: (T + 2,), the sightings of step t are first[t] to first[t + 1]; ``marks``: (K,) their landmarks, 0 to J - 1.
        z, q: (K, 3) the sightings and their variances; without psi the third column is 0 and 1.
        y, C: (K, 3), (K, 6): the sightings as relative places q = (R(theta)' (m - p), m_h - theta) with Gaussian noise.
        ids: (J,) of the landmarks; ``columns``: 2 or 3.
    """

    first: np.ndarray
    marks: np.ndarray
    z: Array
    q: Array
    y: Array
    C: Array
    ids: np.ndarray
    columns: int

    @classmethod
    def taken(
        cls, poses: int, steps: np.ndarray, landmarks: np.ndarray, sightings: Array, sensor: SensorModel, **more: Array
    ) -> Self:
        """Return sightings (K, 2 or 3) of ``landmarks`` (K,) from ``poses`` poses, linearised where they were measured.

        Args:
            steps: (K,), ascending; ``more``: the fields of a class derived from this one.
        """
        ids, marks = np.unique(landmarks, return_inverse=True)
        n, size = sightings.shape[1], len(steps)
        z, q = np.zeros((size, 3)), np.ones((size, 3))
        z[:, :n] = sightings
        q[:, :n] = np.diagonal(sensor.Q(sightings), axis1=-2, axis2=-1)
        taken = cls(
            first=np.searchsorted(steps, np.arange(poses + 1)),
            marks=marks.astype(np.int64).ravel(),
            z=z,
            q=q,
            y=z,
            C=np.zeros((size, 6)),
            ids=ids,
            columns=n,
            **more,
        )
        return taken._linearised(z[:, 0], z[:, 1], wrap(z[:, 1] - z[:, 2]))

    @property
    def steps(self) -> np.ndarray:
        """The step (K,) of each sighting."""
        return np.repeat(np.arange(len(self.first) - 1), np.diff(self.first))

    def _linearised(self, r: Array, bearing: Array, heading: Array) -> Self:
        """Linearise h(q) = (|q|, atan2 q, atan2 q - q_h) at relative places, given by range, bearing and heading.

        y = q + R (z - h(q)) and C = R Q R', with R = dh^-1/dz = [[c, -r s, 0], [s, r c, 0], [0, 1, -1]].
        """
        c, s, zero = np.cos(bearing), np.sin(bearing), np.zeros_like(r)
        third = 1.0 if self.columns == 3 else 0.0
        R = np.array([[c, -r * s, zero], [s, r * c, zero], [zero, zero + third, zero - (1.0 if third else -1.0)]])
        R = np.moveaxis(R, -1, 0)
        residual = self.z - np.stack([r, bearing, third * (bearing - heading)], axis=-1)
        residual[:, 1:] = wrap(residual[:, 1:])
        y = np.stack([r * c, r * s, third * heading], axis=-1) + (R @ residual[..., None])[..., 0]
        y[:, 2] = wrap(y[:, 2])
        C = R @ (self.q[:, :, None] * np.swapaxes(R, 1, 2))
        rows, columns = np.triu_indices(3)
        return replace(self, y=y, C=np.ascontiguousarray(C[:, rows, columns]))

    def in_engine(
        self, motions: Array, information: Array, weights: Array, *, exact: bool = False, degrees: float = 0.0
    ) -> Any:
        """Return the engine's problem with motions (T, 3) of information (T, 6).

        Args:
            weights: (K, 6) the information of the linearised sightings.
            exact, degrees: see `GibbsOptions`; 0 degrees of freedom stand for a Gaussian.
        """
        indices = (np.ascontiguousarray(numbers, dtype=np.int64) for numbers in (self.first, self.marks))
        sightings = (np.ascontiguousarray(part) for part in (self.y, self.C, weights, self.z, self.q))
        return engine.GibbsProblem(
            motions,
            np.ascontiguousarray(information),
            *indices,
            *sightings,
            len(self.ids),
            self.columns,
            exact,
            degrees,
        )

    def linearised_at(self, trajectories: Array, maps: Array) -> Self:
        """Return the same problem, linearised at the mean relative places of samples (S, T + 1, 3) and (S, J, 3)."""
        steps = self.steps
        total, heading = np.zeros((len(steps), 2)), np.zeros(len(steps))
        for x, m in zip(trajectories, maps, strict=True):
            pose, mark = x[steps], m[self.marks]
            d, c, s = mark[:, :2] - pose[:, :2], np.cos(pose[:, 2]), np.sin(pose[:, 2])
            total += np.stack([c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0]], axis=-1)
            heading += wrap(mark[:, 2] - pose[:, 2] - self.y[:, 2])
        place = total / len(trajectories)
        bearing = np.arctan2(place[:, 1], place[:, 0])
        return self._linearised(
            np.maximum(np.hypot(*place.T), 1e-3), bearing, wrap(self.y[:, 2] + heading / len(trajectories))
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Problem(Sightings):
    """The sightings of a log with its motions.

    Attributes:
        motions, information: (T, 3) and the upper triangles (T, 6) of the inverse covariances, of the sensor.
    """

    motions: Array
    information: Array

    @classmethod
    def of(cls, log: Log, motion: MotionModel, sensor: SensorModel) -> Problem:
        """Return a log's problem, the sightings linearised where they were measured."""
        motions, covariances = sensor_motions(sensor, *log.motions(motion))
        rows, columns = np.triu_indices(3)
        return cls.taken(
            log.num_poses,
            log.steps,
            log.landmarks,
            log.sightings,
            sensor,
            motions=np.ascontiguousarray(motions),
            information=np.linalg.inv(covariances)[:, rows, columns],
        )

    def motions_of(self, trajectories: Array) -> Array:
        """Return the mean motions (T, 3) of sampled trajectories (S, T + 1, 3)."""
        d = np.diff(trajectories, axis=1)
        c, s = np.cos(trajectories[:, :-1, 2]), np.sin(trajectories[:, :-1, 2])
        turn = self.motions[:, 2] + wrap(d[..., 2] - self.motions[:, 2]).mean(axis=0)
        along, across = c * d[..., 0] + s * d[..., 1], c * d[..., 1] - s * d[..., 0]
        return np.stack([along.mean(axis=0), across.mean(axis=0), turn], axis=-1)
