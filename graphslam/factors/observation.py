"""A landmark that is a node of its own, seen from a pose."""

from __future__ import annotations

from math import atan2, cos, hypot, sin

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from ..checks import check_positive
from ..errors import FactorError
from ..models import SensorModel
from .arguments import (
    PoseLike,
    frozen_at,
    in_robot_frame,
    in_world_frame,
    numbers,
    positive_definite,
    sensor_of,
    sighting,
)
from .base import POINT, POSE, Coordinates, Factor, KernelLike, Linearized, checked_keys, robust_noise, wrapped


class ObservationFactor(Factor):
    """A sighting of a landmark that is a node of its own: e = h(x, m) - z, information Q^-1.

    Args:
        pose_key: of a `gtsam.Pose2`.
        landmark_key: of a `gtsam.Pose2` (with psi) or a `gtsam.Point2` (without).
        z: (l, phi, psi) or (l, phi) [m, rad, rad].
        sensor: gives Q, at the measured range; default: the book's.
        scale: factor on the information.
        kernel: a robust kernel around the noise model; see `graphslam.edges.robust`.

    Raises:
        OptionError: an argument has an impossible value.

    A landmark exactly at the sensor has no bearing: `FactorError` when the factor is evaluated there. See also
    `observation_factor`.
    """

    def __init__(
        self,
        pose_key: int,
        landmark_key: int,
        z: ArrayLike,
        sensor: SensorModel | None = None,
        *,
        scale: float = 1.0,
        kernel: KernelLike = None,
    ) -> None:
        check_positive(scale=scale)
        z, sensor = sighting("z", z), sensor_of(sensor)
        oriented = len(z) == 3
        length, bearing, orientation = (*z.tolist(), 0.0)[:3]
        ahead, left = sensor.offset

        def residual(x: Coordinates, m: Coordinates) -> Linearized:
            ct, st = cos(x[2]), sin(x[2])
            # from the pose to the sensor; turning the robot moves the sensor by (-uy, ux)
            ux, uy = ct * ahead - st * left, st * ahead + ct * left
            dx, dy = m[0] - x[0] - ux, m[1] - x[1] - uy
            r, direction = hypot(dx, dy), atan2(dy, dx)
            if r == 0:
                raise FactorError("the landmark is exactly at the robot's sensor, where it has no bearing")
            c, s, p, q = dx / r, dy / r, -dy / (r * r), dx / (r * r)
            along, across = c * uy - s * ux, p * uy - q * ux
            e = [r - length, wrapped(direction - x[2] - bearing)]
            by_pose = [[-c, -s, along], [-p, -q, across - 1.0]]
            if not oriented:
                return e, (by_pose, [[c, s], [p, q]])
            e.append(wrapped(direction - m[2] - orientation))
            by_pose.append([-p, -q, across])
            return e, (by_pose, [[c, s, 0.0], [p, q, 0.0], [p, q, -1.0]])

        noise = gtsam.noiseModel.Gaussian.Covariance(sensor.Q(z) / scale)
        arguments = {"z": z, "sensor": sensor, "scale": scale}
        kinds = [POSE, POSE if oriented else POINT]
        super().__init__([pose_key, landmark_key], kinds, noise, residual, kernel, arguments=arguments)


def observation_factor(
    pose_key: int,
    landmark_key: int,
    z: ArrayLike,
    sensor: SensorModel | None = None,
    *,
    scale: float = 1.0,
    kernel: KernelLike = None,
) -> gtsam.NonlinearFactor:
    """The fastest factor of a sighting: GTSAM's own `gtsam.BearingRangeFactor2D` where that is exactly equal.

    It is equal without psi and with a sensor at the robot's pose. In all other cases the result is an
    `ObservationFactor`, whose arguments and exceptions these are. `describe` and `save_factors` know an
    `ObservationFactor` only; GTSAM itself can save and copy its own factor.
    """
    z, sensor = sighting("z", z), sensor_of(sensor)
    if len(z) == 3 or not sensor.centred:
        return ObservationFactor(pose_key, landmark_key, z, sensor, scale=scale, kernel=kernel)
    check_positive(scale=scale)
    key_1, key_2 = checked_keys("observation_factor", (pose_key, landmark_key))
    # GTSAM puts the bearing first
    deviations = np.sqrt(np.diag(sensor.Q(z)) / scale)[::-1].copy()
    noise = robust_noise(gtsam.noiseModel.Diagonal.Sigmas(deviations), kernel)
    return gtsam.BearingRangeFactor2D(key_1, key_2, gtsam.Rot2(z[1]), z[0], noise)


class InverseObservationFactor(Factor):
    """A sighting as a measurement of the landmark's place: e = m - h^-1(x, z), information (R Q R')^-1.

    The same sighting as that of an `ObservationFactor`, with a residual in the plane and not in the sensor's
    coordinates. It is linear in m. With
    ``frame="body"`` the residual is turned into the axes of the sighting, R(theta + phi)' e, where the information is
    constant, with psi or without; ``frame="world"`` keeps e in the world's axes and freezes the information at ``at``.
    When the landmarks are eliminated, these factors become the marginal edges (`LandmarkFactor` with
    ``weight="marginal"``).

    Args:
        pose_key: of a `gtsam.Pose2`.
        landmark_key: of a `gtsam.Pose2` (with psi) or a `gtsam.Point2` (without).
        z: (l, phi, psi) or (l, phi) [m, rad, rad].
        sensor: gives Q, at the measured range; default: the book's.
        frame: "body" or "world".
        at: the pose x, (3,) or a `gtsam.Pose2`, at which the world frame freezes the information.
        scale: factor on the information.
        kernel: a robust kernel around the noise model; see `graphslam.edges.robust`.

    Raises:
        OptionError: an argument has an impossible value, or ``at`` is missing in the world frame.
    """

    def __init__(
        self,
        pose_key: int,
        landmark_key: int,
        z: ArrayLike,
        sensor: SensorModel | None = None,
        *,
        frame: str = "body",
        at: PoseLike | None = None,
        scale: float = 1.0,
        kernel: KernelLike = None,
    ) -> None:
        check_positive(scale=scale)
        z, sensor, world = sighting("z", z), sensor_of(sensor), in_world_frame(frame)
        oriented = len(z) == 3
        (_, bearing, orientation), (px, py) = (*z.tolist(), 0.0)[:3], in_robot_frame(z, sensor)
        frozen = frozen_at(at, needed=world)
        # in the body frame: a pose that looks along x at the landmark, theta + phi = 0
        looking = np.array([0.0, 0.0, -bearing]) if frozen is None else frozen

        def residual(x: Coordinates, m: Coordinates) -> Linearized:
            ct, st = cos(x[2]), sin(x[2])
            # from the pose to the landmark according to the sighting
            vx, vy = ct * px - st * py, st * px + ct * py
            ex, ey = m[0] - x[0] - vx, m[1] - x[1] - vy
            if world:
                e = [ex, ey]
                by_pose = [[-1.0, 0.0, vy], [0.0, -1.0, -vx]]
                by_landmark = [[1.0, 0.0], [0.0, 1.0]]
            else:
                c, s = cos(x[2] + bearing), sin(x[2] + bearing)
                e = [c * ex + s * ey, -s * ex + c * ey]
                by_pose = [[-c, -s, c * vy - s * vx + e[1]], [s, -c, -s * vy - c * vx - e[0]]]
                by_landmark = [[c, s], [-s, c]]
            if oriented:
                e.append(wrapped(m[2] - x[2] - bearing + orientation))
                by_pose.append([0.0, 0.0, -1.0])
                by_landmark = [[*row, 0.0] for row in by_landmark] + [[0.0, 0.0, 1.0]]
            return e, (by_pose, by_landmark)

        noise = gtsam.noiseModel.Gaussian.Covariance(sensor.landmark_covariance(looking, z) / scale)
        arguments = {"z": z, "sensor": sensor, "frame": frame, "at": frozen, "scale": scale}
        kinds = [POSE, POSE if oriented else POINT]
        super().__init__([pose_key, landmark_key], kinds, noise, residual, kernel, arguments=arguments)


class RelativePointFactor(Factor):
    """A `gtsam.Point2` landmark measured in the frame of a pose: e = R(theta)' (m - p) - z.

    Args:
        pose_key, landmark_key: of a `gtsam.Pose2` and a `gtsam.Point2`.
        measured: z = (x, y) [m], or a `gtsam.Point2`.
        information: Omega (2, 2).
        kernel: a robust kernel around the noise model; see `graphslam.edges.robust`.

    Raises:
        OptionError: an argument has an impossible value.
    """

    def __init__(
        self,
        pose_key: int,
        landmark_key: int,
        measured: ArrayLike,
        information: ArrayLike,
        *,
        kernel: KernelLike = None,
    ) -> None:
        z, omega = numbers("measured", measured, (2,)), positive_definite(information, 2)
        zx, zy = z.tolist()

        def residual(x: Coordinates, m: Coordinates) -> Linearized:
            c, s = cos(x[2]), sin(x[2])
            dx, dy = m[0] - x[0], m[1] - x[1]
            sx, sy = c * dx + s * dy, -s * dx + c * dy
            return [sx - zx, sy - zy], ([[-c, -s, sy], [s, -c, -sx]], [[c, s], [-s, c]])

        noise = gtsam.noiseModel.Gaussian.Information(omega)
        arguments = {"measured": z, "information": omega}
        super().__init__([pose_key, landmark_key], [POSE, POINT], noise, residual, kernel, arguments=arguments)
