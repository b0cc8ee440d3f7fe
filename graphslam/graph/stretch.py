"""`Stretch`: what a robot has measured between two moments, as its search in a map needs it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..log import UNIDENTIFIED, Log
from ..models import MotionModel, SensorModel
from ..se2 import Array, between, compose, lever_matrix, perpendicular, turn_matrix


@dataclass(frozen=True, eq=False)
class Stretch:
    """Poses 0 to T of a robot: the motions between them, and what was seen from them by which sensor.

    Attributes:
        name: of the log, for messages.
        motions, noise: (T, 3) and (T, 3, 3), each pose measured from the one before, and the covariance of that.
        steps, landmarks, sightings: (M,), (M,) and (M, 2 or 3), as in a `Log`.
        sensor: its noise model.
    """

    name: str
    motions: Array
    noise: Array
    steps: np.ndarray
    landmarks: np.ndarray
    sightings: Array
    sensor: SensorModel

    @classmethod
    def of(cls, log: Log, motion: MotionModel | None = None, sensor: SensorModel | None = None) -> Stretch:
        """A whole log; without controls its initial poses, taken as exact, are all there is.

        Args:
            log: the log.
            motion, sensor: the noise models; default: those of the log, else the book's.
        """
        if log.controls is None:
            motions = between(log.initial_poses[:-1], log.initial_poses[1:])
            noise = np.zeros((len(motions), 3, 3))
        else:
            motions, noise = log.motions(motion)
        sensor = sensor or log.sensor or SensorModel()
        return cls(log.name, motions, noise, log.steps, log.landmarks, log.sightings, sensor)

    @property
    def num_poses(self) -> int:
        """T + 1."""
        return len(self.motions) + 1

    @property
    def identified(self) -> bool:
        """Whether every sighting has an id."""
        return not np.any(self.landmarks == UNIDENTIFIED)

    @property
    def rows_at(self) -> list[np.ndarray]:
        """The rows of the sightings from each pose."""
        return np.split(
            np.argsort(self.steps, kind="stable"), np.cumsum(np.bincount(self.steps, minlength=self.num_poses))
        )

    def after(self, step: int) -> Stretch:
        """What comes from a pose on, which is then pose 0."""
        later = self.steps >= step
        return replace(
            self, motions=self.motions[step:], noise=self.noise[step:], steps=self.steps[later] - step,
            landmarks=self.landmarks[later], sightings=self.sightings[later],
        )  # fmt: skip


class Drift:
    """The poses (n, 3) of a stretch seen from the first one, and their covariances, as far as they are asked for.

    ``errors`` (T, 3) of the motions, where they are known about, are where the covariances are linearised.
    """

    def __init__(self, stretch: Stretch, errors: Array | None = None) -> None:
        self.poses, self.covariances = np.zeros((1, 3)), np.zeros((1, 3, 3))
        self._stretch, self._errors = stretch, errors
        self._motions = stretch.motions if errors is None else stretch.motions + errors

    def go_to(self, step: int) -> None:
        """Compute them up to a step, or farther."""
        done = len(self.poses) - 1
        if step <= done:
            return
        new = slice(done, max(step, 2 * done))
        more = drifted(self.poses[-1], self._motions[new], self._stretch.noise[new], self.covariances[-1])
        self.poses = np.concatenate([self.poses, more[0][1:]])
        self.covariances = np.concatenate([self.covariances, more[1][1:]])

    def between(self, steps: np.ndarray) -> Array:
        """The covariances (K, K, 3, 3) between the poses at steps (K,), not decreasing.

        The errors of an earlier pose s move a later pose t by [[1, 0, y_s - y_t], [0, 1, x_t - x_s], [0, 0, 1]].
        """
        x, own = self.poses[steps], self.covariances[steps]
        moved = lever_matrix(perpendicular(x[None, :, :2] - x[:, None, :2]))
        # rows are the earlier poses
        upper = own[:, None] @ np.swapaxes(moved, 2, 3)
        later = np.arange(len(x))[:, None] > np.arange(len(x))
        return np.where(later[:, :, None, None], np.transpose(upper, (1, 0, 3, 2)), upper)

    def shifts(self, steps: np.ndarray) -> Array:
        """How far, to first order, the errors move the poses at steps (K,): (K, 3), the sum of what `between` describes."""
        if self._errors is None:
            return np.zeros((len(steps), 3))
        x = self.poses
        a = np.zeros((len(x), 3))
        a[1:] = (turn_matrix(x[:-1, 2]) @ self._errors[: len(x) - 1, :, None])[..., 0]
        sums = np.cumsum(a + np.column_stack([x[:, 1] * a[:, 2], -x[:, 0] * a[:, 2], 0 * a[:, 2]]), axis=0)
        turn = sums[:, 2]
        return np.asarray((sums + np.column_stack([-x[:, 1] * turn, x[:, 0] * turn, 0 * turn]))[steps])

    def multipliers(self, steps: np.ndarray, forces: Array) -> Array:
        """D' f (T, 3), with D the derivatives of the poses at steps (K,) by the motions, and forces f (K, 3) on the poses."""
        x, f = self.poses, np.zeros((len(self.poses), 3))
        np.add.at(f, steps, forces)
        f[:, 2] += x[:, 0] * f[:, 1] - x[:, 1] * f[:, 0]
        later = np.cumsum(f[::-1], axis=0)[::-1]
        later[:, 2] += x[:, 1] * later[:, 0] - x[:, 0] * later[:, 1]
        found = np.zeros((len(self._stretch.motions), 3))
        found[: len(x) - 1] = (np.swapaxes(turn_matrix(x[:-1, 2]), 1, 2) @ later[1:, :, None])[..., 0]
        return found


def drifted(start: Array, motions: Array, noise: Array, covariance: Array | None = None) -> tuple[Array, Array]:
    """The poses (T+1, 3) after motions (T, 3), and their covariances (T+1, 3, 3), in world axes; see `moved`."""
    poses, covariances = [start], [np.zeros((3, 3)) if covariance is None else covariance]
    for m, Q in zip(motions, noise):
        x, P = moved(poses[-1], covariances[-1], m, Q)
        poses.append(x)
        covariances.append(P)
    return np.array(poses), np.array(covariances)


def moved(x: Array, P: Array, motion: Array, noise: Array) -> tuple[Array, Array]:
    """A pose (3,) and its covariance (3, 3) after a motion m (3,) with covariance Q (3, 3), in the axes of the pose.

    Sigma' = F Sigma F' + J Q J', F = d compose(x, m) / dx, J = d compose(x, m) / dm.
    """
    after = compose(x, motion)
    F = np.array([[1, 0, x[1] - after[1]], [0, 1, after[0] - x[0]], [0, 0, 1]])
    J = turn_matrix(x[2])
    return after, F @ P @ F.T + J @ noise @ J.T


def backwards(x: Array, P: Array) -> tuple[Array, Array]:
    """The motion (3,) from a pose x (3,) with covariance P back to the origin, in the axes of x, and its covariance."""
    back = between(x, np.zeros(3))
    F = lever_matrix(perpendicular(back[:2])) @ turn_matrix(back[2])
    return back, F @ P @ F.T
