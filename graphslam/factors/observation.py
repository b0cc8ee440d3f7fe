"""A landmark that is a node of its own, seen from a pose."""

from __future__ import annotations

from collections.abc import Callable
from math import atan2, cos, hypot, sin

import gtsam
from numpy.typing import ArrayLike

from ..checks import check_choice
from ..errors import FactorError
from ..models import RESIDUALS, SensorModel
from ..se2 import Array
from .arguments import (
    PoseLike,
    frozen_at,
    in_robot_frame,
    in_world_frame,
    numbers,
    positive_definite,
    sensor_of,
    sighted_covariance,
    sighting,
)
from .base import POINT, POSE, Coordinates, Factor, KernelLike, Linearized, noise_model, wrapped


class ObservationFactor(Factor):
    """A sighting of a landmark that is a node of its own.

    ``residual="cartesian"`` has the sighting as a position in the robot's axes, o + l (cos phi, sin phi) with o the sensor's
    offset: e = R(theta)' (m - p) - o - l (cos phi, sin phi), and with psi also theta_m - theta - (phi - psi). Its
    information is (L Q L')^-1, L = dh^-1/dz seen from a pose at the origin. This is an `InverseObservationFactor` with
    ``frame="body"``. ``residual="polar"`` is e = h(x, m) - z with information Q^-1.

    Args:
        pose_key: of a `gtsam.Pose2`.
        landmark_key: of a `gtsam.Pose2` (with psi) or a `gtsam.Point2` (without).
        z: (l, phi, psi) or (l, phi) [m, rad, rad].
        sensor: gives Q, at the measured range; default: the book's.
        residual: "cartesian" or "polar".
        scale: factor on the information.
        kernel: a robust kernel around the noise model; see `graphslam.edges.robust`.

    Raises:
        OptionError: an argument has an impossible value.

    With the polar residual a landmark exactly at the sensor has no bearing: `FactorError` when it is evaluated there.
    """

    def __init__(
        self,
        pose_key: int,
        landmark_key: int,
        z: ArrayLike,
        sensor: SensorModel | None = None,
        *,
        residual: str = "cartesian",
        scale: float = 1.0,
        kernel: KernelLike = None,
    ) -> None:
        z, sensor = sighting("z", z), sensor_of(sensor)
        check_choice("residual", residual, RESIDUALS)
        if residual == "polar":
            evaluated, covariance = _polar(z, sensor), sensor.Q(z)
        else:
            evaluated, covariance = _seen(z, sensor), sighted_covariance(0.0, z.tolist(), sensor)
        arguments = {"z": z, "sensor": sensor, "residual": residual, "scale": scale, "kernel": kernel}
        kinds = [POSE, POSE if len(z) == 3 else POINT]
        super().__init__([pose_key, landmark_key], kinds, evaluated, arguments, covariance=covariance)

    def fastest(self) -> gtsam.NonlinearFactor:
        """GTSAM's own `gtsam.BearingRangeFactor2D` where that is exactly equal, else this factor.

        It is equal with the polar residual, without psi, and with the sensor at the robot's pose. GTSAM can save and copy
        its own factor; `describe` and `save_factors` do not know it.
        """
        arguments = self.description.arguments
        z, sensor = arguments["z"], arguments["sensor"]
        if arguments["residual"] != "polar" or len(z) == 3 or not sensor.centred:
            return self
        # GTSAM puts the bearing first
        noise = noise_model(arguments, covariance=sensor.Q(z)[::-1, ::-1])
        pose_key, landmark_key = self.keys()
        return gtsam.BearingRangeFactor2D(pose_key, landmark_key, gtsam.Rot2(z[1]), z[0], noise)


class InverseObservationFactor(Factor):
    """A sighting as a measurement of the landmark's place: e = m - h^-1(x, z), information (R Q R')^-1.

    The residual is linear in m. With ``frame="body"`` the residual is turned into the robot's axes, R(theta)' e, where
    the information is constant, with psi or without; ``frame="world"`` keeps e in the world's axes and freezes the
    information at ``at``.
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
        z, sensor, world = sighting("z", z), sensor_of(sensor), in_world_frame(frame)
        frozen, kinds = frozen_at(at, needed=world), [POSE, POSE if len(z) == 3 else POINT]
        # in the robot's axes the covariance is that seen from a pose at the origin
        covariance = sighted_covariance(0.0 if frozen is None else float(frozen[2]), z.tolist(), sensor)
        residual = _seen(z, sensor, world)
        arguments = {"z": z, "sensor": sensor, "frame": frame, "at": frozen, "scale": scale, "kernel": kernel}
        super().__init__([pose_key, landmark_key], kinds, residual, arguments, covariance=covariance)


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
        arguments = {"measured": z, "information": omega, "kernel": kernel}
        residual = _in_the_plane(z[0], z[1])
        super().__init__([pose_key, landmark_key], [POSE, POINT], residual, arguments, information=omega)


def _polar(z: Array, sensor: SensorModel) -> Callable[..., Linearized]:
    """The residual h(x, m) - z."""
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

    return residual


def _seen(z: Array, sensor: SensorModel, world: bool = False) -> Callable[..., Linearized]:
    """The residual of a sighting in the plane: m - h^-1(x, z), or the same in the robot's axes."""
    return _in_the_plane(*in_robot_frame(z, sensor), z[1] - z[2] if len(z) == 3 else None, world)


def _in_the_plane(px: float, py: float, turn: float | None = None, world: bool = False) -> Callable[..., Linearized]:
    """The residual of a landmark measured at (px, py), and perhaps with the heading ``turn``, in the frame of a pose."""

    def residual(x: Coordinates, m: Coordinates) -> Linearized:
        c, s = cos(x[2]), sin(x[2])
        dx, dy = m[0] - x[0], m[1] - x[1]
        if world:
            vx, vy = c * px - s * py, s * px + c * py
            e, by_pose = [dx - vx, dy - vy], [[-1.0, 0.0, vy], [0.0, -1.0, -vx]]
            by_landmark = [[1.0, 0.0], [0.0, 1.0]]
        else:
            rx, ry = c * dx + s * dy, -s * dx + c * dy
            e, by_pose, by_landmark = [rx - px, ry - py], [[-c, -s, ry], [s, -c, -rx]], [[c, s], [-s, c]]
        if turn is not None:
            e.append(wrapped(m[2] - x[2] - turn))
            by_pose.append([0.0, 0.0, -1.0])
            by_landmark = [[*row, 0.0] for row in by_landmark] + [[0.0, 0.0, 1.0]]
        return e, (by_pose, by_landmark)

    return residual
