"""One pose measured from another: relative poses, and the motions that controls lead to."""

from __future__ import annotations

from math import cos, sin
from typing import Any

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from ..checks import check_positive
from ..errors import GraphError, OptionError
from ..models import MotionModel, sinc_slope_near_zero
from ..precision import check_size, small_inverse
from ..se2 import Array, rotation
from .arguments import QUICKEST, PoseLike, frozen_at, in_world_frame, motion_of, numbers, pose, positive_definite
from .base import POSE, Coordinates, Factor, KernelLike, Linearized, noise_model, wrapped


class RelativePoseFactor(Factor):
    """The pose at one key measured from another's: e = (R(theta_1)' (p_2 - p_1) - t, theta_2 - theta_1 - theta_z).

    The information belongs to the axes of pose 1. ``frame="world"`` leaves e in the world's axes, R(theta_1) e, and
    freezes the information at the heading of ``at``. (GTSAM's own ``BetweenFactorPose2`` has the same residual turned by
    theta_z, but measures its error through the logarithm.)

    Args:
        key_1, key_2: of two `gtsam.Pose2`.
        measured: z = (x, y, theta) [m, m, rad], or a `gtsam.Pose2`: pose 2 in the frame of pose 1.
        information: Omega (3, 3).
        frame: "body" or "world".
        at: the pose x_1, (3,) or a `gtsam.Pose2`, at which the world frame freezes the information.
        kernel: a robust kernel around the noise model; see `graphslam.edges.robust`.

    Raises:
        OptionError: an argument has an impossible value, or ``at`` is missing in the world frame.
    """

    def __init__(
        self,
        key_1: int,
        key_2: int,
        measured: PoseLike,
        information: ArrayLike,
        *,
        frame: str = "body",
        at: PoseLike | None = None,
        kernel: KernelLike = None,
    ) -> None:
        z, omega = pose("measured", measured), positive_definite(information)
        arguments = {"measured": z, "information": omega, "frame": frame, "at": at, "kernel": kernel}
        self._make([key_1, key_2], z, omega, arguments)

    def _make(self, keys: list[int], z: Array, omega: Array, arguments: dict[str, Any]) -> None:
        """Make the factor of a relative pose (3,) and its information (3, 3), unscaled."""
        self._between = z, omega
        (dx, dy, turned), world = z.tolist(), in_world_frame(arguments["frame"])
        frozen = frozen_at(arguments["at"], needed=world)
        omega = omega if frozen is None else _turned_information(omega, frozen[2])

        def residual(a: Coordinates, b: Coordinates) -> Linearized:
            # derivatives by GTSAM's perturbations, each pose's in its own axes
            c, s = cos(a[2]), sin(a[2])
            x, y, turn = b[0] - a[0], b[1] - a[1], b[2] - a[2]
            et = wrapped(turn - turned)
            if world:
                rx, ry, cb, sb = c * dx - s * dy, s * dx + c * dy, cos(b[2]), sin(b[2])
                e, by_a = [x - rx, y - ry, et], [[-c, s, ry], [-s, -c, -rx], [0.0, 0.0, -1.0]]
            else:
                sx, sy, cb, sb = c * x + s * y, -s * x + c * y, cos(turn), sin(turn)
                e, by_a = [sx - dx, sy - dy, et], [[-1.0, 0.0, sy], [0.0, -1.0, -sx], [0.0, 0.0, -1.0]]
            return e, (by_a, [[cb, -sb, 0.0], [sb, cb, 0.0], [0.0, 0.0, 1.0]])

        arguments |= {"at": frozen}
        Factor.__init__(self, keys, [POSE, POSE], residual, arguments, information=omega, in_own_axes=True)

    def to_between(self) -> gtsam.BetweenFactorPose2:
        """GTSAM's own factor of the same relative pose, which has the speed of C++ and can be serialised.

        Its residual is this one turned by theta_z, so its information is turned, too; GTSAM measures the error through
        the logarithm of SE(2), which agrees where e = 0 and differs in the second order.

        Raises:
            OptionError: in the world frame the information is frozen, and that of GTSAM's factor turns with the pose.
        """
        arguments = self.description.arguments
        if arguments["frame"] == "world":
            raise OptionError("to_between needs frame='body': GTSAM's factor turns its information with the pose")
        z, omega = self._between
        noise = noise_model(arguments, information=_turned_information(omega, -z[2]))
        key_1, key_2 = self.keys()
        return gtsam.BetweenFactorPose2(key_1, key_2, gtsam.Pose2(*z), noise)


class MotionFactor(RelativePoseFactor):
    """A control that takes the pose at one key to the pose at another: e = x_2 - f(x_1, u), Omega^-1 = A M A' + eps I.

    With ``frame="body"`` the residual is turned into the axes of x_1, where the information does not depend on the
    state; with ``frame="world"`` the information is frozen at the heading of ``at``.

    Args:
        key_1, key_2: of two `gtsam.Pose2`.
        control: (nu, omega) [m/s, rad/s], held for ``dt`` seconds.
        dt: [s].
        motion: gives f, A, M, S and epsilon; default: the book's.
        frame: "body" or "world".
        at: the pose x_1, (3,) or a `gtsam.Pose2`, at which the world frame freezes the information.
        scale: lambda, the factor on the information.
        kernel: a robust kernel around the noise model; see `graphslam.edges.robust`.

    Raises:
        OptionError: an argument has an impossible value, or ``at`` is missing in the world frame.

    Source: the lectures, slides 9.3.
    """

    def __init__(
        self,
        key_1: int,
        key_2: int,
        control: ArrayLike,
        dt: float,
        motion: MotionModel | None = None,
        *,
        frame: str = "body",
        at: PoseLike | None = None,
        scale: float = 1.0,
        kernel: KernelLike = None,
    ) -> None:
        check_positive(dt=dt)
        motion, u = motion_of(motion), numbers("control", control, (2,))
        nu, omega = u.tolist()
        for name, number in (
            ("dt", float(dt)),
            ("the distance of control", nu * dt),
            ("the turn of control", omega * dt),
        ):
            check_size(name, number)
        if abs(omega) > QUICKEST:
            raise OptionError(
                f"the turn rate of control is {omega:g} rad/s, more than a whole turn per second: is it in degrees per "
                "second? Give radians, np.deg2rad(...); if the robot turns so fast, use RelativePoseFactor with the "
                "relative pose and information of MotionModel.f and MotionModel.covariance"
            )
        options = {"frame": frame, "at": at, "scale": scale, "kernel": kernel}
        arguments = {"control": u, "dt": dt, "motion": motion} | options
        # f and its covariance turn with the pose that they start from
        moved, covariance = _from_origin(motion, nu, omega, float(dt))
        information = small_inverse(covariance)
        if information is None:
            raise GraphError("the uncertainty of the motion is singular to double precision; raise epsilon")
        self._make([key_1, key_2], moved, information, arguments)


def _from_origin(motion: MotionModel, nu: float, omega: float, dt: float) -> tuple[Array, list[list[float]]]:
    """f(0, u) (3,) and its covariance A M A' + S + epsilon I (3, 3): `MotionModel`, written out for one control.

    For one control the arrays of the model take ten times as long.
    """
    a = omega * dt / 2
    c, s, chord = cos(a), sin(a), sin(a) / a if a else 1.0
    slope = sinc_slope_near_zero(a) if abs(a) < 0.3 else (c - chord) / a
    half = nu * dt * dt / 2
    # the columns (ax, ay, 0) and (bx, by, dt) of A; the normal of the chord is (-s, c, 0)
    ax, ay = dt * chord * c, dt * chord * s
    bx, by = half * (slope * c - chord * s), half * (slope * s + chord * c)
    far, turned, epsilon = abs(nu) / dt, abs(omega) / dt, motion.epsilon
    v = motion.nn * motion.nn * far + motion.no * motion.no * turned + motion.sigma_v * motion.sigma_v
    w = motion.on * motion.on * far + motion.oo * motion.oo * turned + motion.sigma_omega * motion.sigma_omega
    aside = motion.slip * motion.slip * abs(nu) * dt
    xy, xt, yt = v * ax * ay + w * bx * by - aside * c * s, w * bx * dt, w * by * dt
    covariance = [
        [v * ax * ax + w * bx * bx + aside * s * s + epsilon, xy, xt],
        [xy, v * ay * ay + w * by * by + aside * c * c + epsilon, yt],
        [xt, yt, w * dt * dt + epsilon],
    ]
    driven = nu * dt * chord
    return np.array([driven * c, driven * s, 2 * a]), covariance


def _turned_information(information: Array, theta: float) -> Array:
    """The information (3, 3) of a pose in axes turned by -theta."""
    turn = np.eye(3)
    turn[:2, :2] = rotation(theta)
    return turn @ information @ turn.T
