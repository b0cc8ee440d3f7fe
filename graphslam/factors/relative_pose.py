"""One pose measured from another: relative poses, and the motions that a control drives."""

from __future__ import annotations

from math import cos, sin
from typing import Any

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from ..checks import check_choice, check_positive
from ..edges.robust import Kernel
from ..errors import OptionError
from ..models import MotionModel
from ..se2 import Array, rotation
from .layer import POSE, Coordinates, Factor, positive_definite, robust_noise, vector, wrapped


class RelativePoseFactor(Factor):
    """The pose at one key measured from another's: e = (R(theta_1)' (p_2 - p_1) - t, theta_2 - theta_1 - theta_z).

    The information belongs to the axes of pose 1. ``frame="world"`` leaves e in the world's axes, R(theta_1) e, and
    freezes the information at the heading of ``at``. (GTSAM's own ``BetweenFactorPose2`` is the same residual turned by
    theta_z, but its error is measured through the logarithm.)

    Args:
        key_1, key_2: of two `gtsam.Pose2`.
        measured: z = (x, y, theta) [m, m, rad], pose 2 seen from pose 1.
        information: Omega (3, 3).
        frame: "body" or "world".
        at: the pose x_1 (3,) at which the world frame freezes the information.
        kernel: a robust kernel around the noise model; see `graphslam.edges.robust`.

    Raises:
        OptionError: a value is not what it must be, or ``at`` is missing in the world frame.
    """

    def __init__(
        self,
        key_1: int,
        key_2: int,
        measured: ArrayLike,
        information: ArrayLike,
        frame: str = "body",
        *,
        at: ArrayLike | None = None,
        kernel: Kernel | str | None = None,
    ) -> None:
        told = {"measured": vector("measured", measured, (3,)), "information": positive_definite(information)}
        self._make([key_1, key_2], told["measured"], told["information"], frame, at, told, kernel)

    def _make(
        self,
        keys: list[int],
        measured: Array,
        omega: Array,
        frame: str,
        at: ArrayLike | None,
        arguments: dict[str, Any],
        kernel: Kernel | str | None,
    ) -> None:
        check_choice("frame", frame, ("world", "body"))
        (dx, dy, turned), world = measured.tolist(), frame == "world"
        frozen_at = None
        if world:
            if at is None:
                raise OptionError("with frame='world' the information depends on the pose x_1; give it as 'at'")
            turn = np.eye(3)
            frozen_at = vector("at", at, (3,))
            turn[:2, :2] = rotation(frozen_at[2])
            omega = turn @ omega @ turn.T

        def residual(a: Coordinates, b: Coordinates) -> tuple[list[float], tuple[list[list[float]], ...]]:
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

        def error(a: Coordinates, b: Coordinates) -> tuple[float, float, float]:
            c, s = cos(a[2]), sin(a[2])
            x, y, et = b[0] - a[0], b[1] - a[1], wrapped(b[2] - a[2] - turned)
            if world:
                return x - c * dx + s * dy, y - s * dx - c * dy, et
            return c * x + s * y - dx, -s * x + c * y - dy, et

        arguments = arguments | {"frame": frame, "at": frozen_at}
        noise = gtsam.noiseModel.Gaussian.Information(omega)
        Factor.__init__(self, keys, [POSE, POSE], noise, residual, arguments, kernel, in_own_axes=True, error=error)

    def to_between(self) -> gtsam.BetweenFactorPose2:
        """GTSAM's own factor of the same relative pose: C++ speed, and serialisation.

        Its residual is this one turned by theta_z, so its information is turned, too; GTSAM measures the error through
        the logarithm of SE(2), which agrees where e = 0 and differs in the second order.

        Raises:
            OptionError: in the world frame the information is frozen, and GTSAM's factor has it turn with the pose.
        """
        measured, omega, frame, kernel = self._between
        if frame == "world":
            raise OptionError("to_between needs frame='body': GTSAM's factor turns its information with the pose")
        turn = np.eye(3)
        turn[:2, :2] = rotation(-measured[2])
        noise = robust_noise(gtsam.noiseModel.Gaussian.Information(turn @ omega @ turn.T), kernel)
        key_1, key_2 = self.keys()
        return gtsam.BetweenFactorPose2(key_1, key_2, gtsam.Pose2(*measured), noise)

    @property
    def _between(self) -> tuple[Array, Array, str, Kernel | None]:
        told = self.description.arguments
        return told["measured"], told["information"], told["frame"], told.get("kernel")


class MotionFactor(RelativePoseFactor):
    """A control that takes the pose at one key to the pose at another: e = x_2 - f(x_1, u), Omega^-1 = A M A' + eps I.

    With ``frame="body"`` the residual is turned into the axes of x_1, where the information does not depend on the
    state; with ``frame="world"`` the information is frozen at the heading of ``at``.

    Args:
        key_1, key_2: of two `gtsam.Pose2`.
        control: (nu, omega) [m/s, rad/s], held for ``dt`` seconds.
        dt: [s].
        motion: gives f, A, M and epsilon; default: the book's.
        frame: "body" or "world".
        at: the pose x_1 (3,) at which state-dependent information is evaluated.
        weight: lambda, the factor on the information.
        kernel: a robust kernel around the noise model; see `graphslam.edges.robust`.

    Raises:
        OptionError: a value is not what it must be, or ``at`` is missing in the world frame.

    Source: the lectures, slides 9.3.
    """

    def __init__(
        self,
        key_1: int,
        key_2: int,
        control: ArrayLike,
        dt: float,
        motion: MotionModel | None = None,
        frame: str = "body",
        *,
        at: ArrayLike | None = None,
        weight: float = 1.0,
        kernel: Kernel | str | None = None,
    ) -> None:
        check_positive(weight=weight, dt=dt)
        motion, u = motion or MotionModel(), vector("control", control, (2,))
        arguments = {"control": u, "dt": dt, "motion": motion, "weight": weight}
        self._make([key_1, key_2], *_driven(motion, u, dt, weight), frame, at, arguments, kernel)

    @property
    def _between(self) -> tuple[Array, Array, str, Kernel | None]:
        told = self.description.arguments
        driven = _driven(told["motion"], told["control"], told["dt"], told["weight"])
        return *driven, told["frame"], told.get("kernel")


def _driven(motion: MotionModel, control: Array, dt: float, weight: float) -> tuple[Array, Array]:
    """The relative pose that a control leads to, and its information: f and its covariance turn with their start."""
    origin = np.zeros(3)
    information = weight * np.linalg.inv(motion.covariance(origin, control, dt))
    return motion.f(origin, control, dt), (information + information.T) / 2
