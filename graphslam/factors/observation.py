"""A landmark that is a node of its own, seen from a pose."""

from __future__ import annotations

from math import atan2, cos, hypot, sin
from typing import Any

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from ..checks import check_choice, check_positive
from ..edges.robust import Kernel
from ..errors import FactorError, OptionError
from ..models import SensorModel
from .layer import (
    POINT,
    POSE,
    Coordinates,
    Factor,
    checked_keys,
    positive_definite,
    robust_noise,
    seen_from_robot,
    sensor_of,
    sighting,
    vector,
    wrapped,
)


class ObservationFactor(Factor):
    """A sighting of a landmark that is a node of its own: e = h(x, m) - z, information Q^-1.

    With psi the landmark is a `gtsam.Pose2`, without it a `gtsam.Point2`. In the second case GTSAM has the factor itself,
    if the sensor sits at the robot's pose: then the call returns a native `gtsam.BearingRangeFactor2D`.

    Args:
        pose_key: of a `gtsam.Pose2`.
        landmark_key: of a `gtsam.Pose2` (with psi) or a `gtsam.Point2` (without).
        z: (l, phi, psi) or (l, phi) [m, rad, rad].
        sensor: gives Q, at the measured range; default: the book's.
        weight: factor on the information.
        kernel: a robust kernel around the noise model; see `graphslam.edges.robust`.

    Raises:
        OptionError: a value is not what it must be.

    A landmark exactly at the sensor has no bearing: `FactorError` when it is evaluated there.
    """

    def __new__(
        cls,
        pose_key: int,
        landmark_key: int,
        z: ArrayLike,
        sensor: SensorModel | None = None,
        *,
        weight: float = 1.0,
        kernel: Kernel | str | None = None,
    ) -> Any:
        """The native factor where GTSAM has one."""
        seen, sensor = sighting("z", z), sensor_of(sensor)
        if len(seen) == 3 or not sensor.centred:
            return super().__new__(cls)
        check_positive(weight=weight)
        key_1, key_2 = checked_keys(cls.__name__, (pose_key, landmark_key))
        stds = np.sqrt(np.diag(sensor.Q(seen)) / weight)
        # GTSAM puts the bearing first
        noise = robust_noise(gtsam.noiseModel.Diagonal.Sigmas(stds[::-1].copy()), kernel)
        return gtsam.BearingRangeFactor2D(key_1, key_2, gtsam.Rot2(seen[1]), seen[0], noise)

    def __init__(
        self,
        pose_key: int,
        landmark_key: int,
        z: ArrayLike,
        sensor: SensorModel | None = None,
        *,
        weight: float = 1.0,
        kernel: Kernel | str | None = None,
    ) -> None:
        check_positive(weight=weight)
        seen, sensor = sighting("z", z), sensor_of(sensor)
        oriented = len(seen) == 3
        length, bearing, orientation = (*seen.tolist(), 0.0)[:3]
        ahead, left = sensor.offset

        def residual(x: Coordinates, m: Coordinates) -> tuple[list[float], tuple[list[list[float]], ...]]:
            ct, st = cos(x[2]), sin(x[2])
            # the arm from the pose to the sensor; turning the robot moves the sensor by (-uy, ux)
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

        noise = gtsam.noiseModel.Gaussian.Covariance(sensor.Q(seen) / weight)
        arguments = {"z": seen, "sensor": sensor, "weight": weight}
        kinds = [POSE, POSE if oriented else POINT]
        super().__init__([pose_key, landmark_key], kinds, noise, residual, arguments, kernel)


class InverseObservationFactor(Factor):
    """A sighting as what it says of the landmark: e = m - h^-1(x, z), information (R Q R')^-1.

    The same sighting as `ObservationFactor`, measured where the landmark is and not in the sensor; linear in m. With
    ``frame="body"`` the residual is turned into the axes of the sighting, R(theta + phi)' e, where the information is
    constant, with psi or without; ``frame="world"`` keeps e in the world's axes and freezes the information at ``at``.
    Landmarks eliminated, these are the marginal edges (`LandmarkFactor` with ``weight="marginal"``).

    Args:
        pose_key: of a `gtsam.Pose2`.
        landmark_key: of a `gtsam.Pose2` (with psi) or a `gtsam.Point2` (without).
        z: (l, phi, psi) or (l, phi) [m, rad, rad].
        sensor: gives Q, at the measured range; default: the book's.
        frame: "body" or "world".
        at: the pose x (3,) at which the world frame freezes the information.
        weight: factor on the information.
        kernel: a robust kernel around the noise model; see `graphslam.edges.robust`.

    Raises:
        OptionError: a value is not what it must be, or ``at`` is missing in the world frame.
    """

    def __init__(
        self,
        pose_key: int,
        landmark_key: int,
        z: ArrayLike,
        sensor: SensorModel | None = None,
        frame: str = "body",
        *,
        at: ArrayLike | None = None,
        weight: float = 1.0,
        kernel: Kernel | str | None = None,
    ) -> None:
        check_choice("frame", frame, ("world", "body"))
        check_positive(weight=weight)
        seen, sensor, body = sighting("z", z), sensor or SensorModel(), frame == "body"
        oriented = len(seen) == 3
        (_, bearing, orientation), (px, py) = (*seen.tolist(), 0.0)[:3], seen_from_robot(seen, sensor)
        if body:
            # a pose that looks along x at the landmark: theta + phi = 0
            frozen_at, looking = None, np.array([0.0, 0.0, -bearing])
        elif at is None:
            raise OptionError("with frame='world' the information depends on the pose; give it as 'at'")
        else:
            frozen_at = looking = vector("at", at, (3,))

        def residual(x: Coordinates, m: Coordinates) -> tuple[list[float], tuple[list[list[float]], ...]]:
            ct, st = cos(x[2]), sin(x[2])
            # from the pose to where the sighting puts the landmark, and what turning the pose does to e
            vx, vy = ct * px - st * py, st * px + ct * py
            ex, ey = m[0] - x[0] - vx, m[1] - x[1] - vy
            if body:
                c, s = cos(x[2] + bearing), sin(x[2] + bearing)
                e = [c * ex + s * ey, -s * ex + c * ey]
                by_pose = [[-c, -s, c * vy - s * vx + e[1]], [s, -c, -s * vy - c * vx - e[0]]]
                by_landmark = [[c, s], [-s, c]]
            else:
                e = [ex, ey]
                by_pose = [[-1.0, 0.0, vy], [0.0, -1.0, -vx]]
                by_landmark = [[1.0, 0.0], [0.0, 1.0]]
            if oriented:
                e.append(wrapped(m[2] - x[2] - bearing + orientation))
                by_pose.append([0.0, 0.0, -1.0])
                by_landmark = [[*row, 0.0] for row in by_landmark] + [[0.0, 0.0, 1.0]]
            return e, (by_pose, by_landmark)

        noise = gtsam.noiseModel.Gaussian.Covariance(sensor.landmark_covariance(looking, seen) / weight)
        arguments = {"z": seen, "sensor": sensor, "frame": frame, "at": frozen_at, "weight": weight}
        kinds = [POSE, POSE if oriented else POINT]
        super().__init__([pose_key, landmark_key], kinds, noise, residual, arguments, kernel)


class RelativePointFactor(Factor):
    """A `gtsam.Point2` landmark measured in the frame of a pose: e = R(theta)' (m - p) - z.

    Args:
        pose_key, landmark_key: of a `gtsam.Pose2` and a `gtsam.Point2`.
        measured: z = (x, y) [m].
        information: Omega (2, 2).
        kernel: a robust kernel around the noise model; see `graphslam.edges.robust`.

    Raises:
        OptionError: a value is not what it must be.
    """

    def __init__(
        self,
        pose_key: int,
        landmark_key: int,
        measured: ArrayLike,
        information: ArrayLike,
        *,
        kernel: Kernel | str | None = None,
    ) -> None:
        at, omega = vector("measured", measured, (2,)), positive_definite(information, 2)
        zx, zy = at.tolist()

        def residual(x: Coordinates, m: Coordinates) -> tuple[list[float], tuple[list[list[float]], ...]]:
            c, s = cos(x[2]), sin(x[2])
            dx, dy = m[0] - x[0], m[1] - x[1]
            sx, sy = c * dx + s * dy, -s * dx + c * dy
            return [sx - zx, sy - zy], ([[-c, -s, sy], [s, -c, -sx]], [[c, s], [-s, c]])

        noise = gtsam.noiseModel.Gaussian.Information(omega)
        arguments = {"measured": at, "information": omega}
        super().__init__([pose_key, landmark_key], [POSE, POINT], noise, residual, arguments, kernel)
