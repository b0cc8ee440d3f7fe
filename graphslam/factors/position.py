"""The place of a point of the robot in the world: GPS, motion capture, a total station."""

from __future__ import annotations

from math import cos, sin

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from .arguments import numbers, positive_definite
from .base import POSE, Coordinates, Factor, KernelLike, Linearized, noise_model, wrapped


class PositionFactor(Factor):
    """A point of the robot measured in the world: e = p + R(theta) a - (x, y), with a heading also theta - theta_z.

    Args:
        key: of a `gtsam.Pose2`.
        measured: (x, y) [m], or (x, y, theta) with the heading of the robot [rad].
        information: (2, 2) or (3, 3), in world axes.
        lever: a, the point of the robot that is measured, (ahead, left) [m] of its pose.
        kernel: a robust kernel around the noise model; see `graphslam.edges.robust`.

    Raises:
        OptionError: an argument has an impossible value.
    """

    def __init__(
        self,
        key: int,
        measured: ArrayLike,
        information: ArrayLike,
        *,
        lever: ArrayLike = (0.0, 0.0),
        kernel: KernelLike = None,
    ) -> None:
        z, arm = numbers("measured", measured, (2, 3)), numbers("lever", lever, (2,))
        omega = positive_definite(information, len(z))
        (x, y), (ahead, left), heading = z[:2].tolist(), arm.tolist(), z[2:].tolist()

        def residual(pose: Coordinates) -> Linearized:
            # derivatives by GTSAM's perturbations, in the pose's own axes: R(theta) [I, (-a_y, a_x)]
            c, s = cos(pose[2]), sin(pose[2])
            right, forward = c * ahead - s * left, s * ahead + c * left
            e, J = [pose[0] + right - x, pose[1] + forward - y], [[c, -s, -forward], [s, c, right]]
            if heading:
                return [*e, wrapped(pose[2] - heading[0])], ([*J, [0.0, 0.0, 1.0]],)
            return e, (J,)

        arguments = {"measured": z, "information": omega, "lever": arm, "kernel": kernel}
        super().__init__([key], [POSE], residual, arguments, information=omega, in_own_axes=True)

    def fastest(self) -> gtsam.NonlinearFactor:
        """GTSAM's own `PoseTranslationPrior2D` where the cost is exactly the same, without lever and heading; else itself."""
        a = self.description.arguments
        if np.any(a["lever"]) or len(a["measured"]) == 3:
            return self
        noise = noise_model(a, information=a["information"])
        return gtsam.PoseTranslationPrior2D(self.keys()[0], gtsam.Point2(*a["measured"]), noise)
