"""A pose that is held at a value."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .arguments import PoseLike, positive_definite
from .arguments import pose as checked
from .base import POSE, Coordinates, Factor, KernelLike, Linearized, wrapped


class AnchorFactor(Factor):
    """The pose at a key, held at a value: e = x - x̂ in world axes, the heading wrapped.

    (`gtsam.PriorFactorPose2` measures its error in the axes of x̂ and through the logarithm.)

    Args:
        key: of a `gtsam.Pose2`.
        pose: x̂ (3,), or a `gtsam.Pose2`.
        information: Omega_0 (3, 3); default: the lectures' 1e6 I.
        kernel: a robust kernel around the noise model; see `graphslam.edges.robust`.

    Raises:
        OptionError: an argument has an impossible value.
    """

    def __init__(
        self, key: int, pose: PoseLike, information: ArrayLike | None = None, *, kernel: KernelLike = None
    ) -> None:
        held = checked("pose", pose)
        omega = 1e6 * np.eye(3) if information is None else positive_definite(information)
        x, y, theta = held.tolist()

        def residual(a: Coordinates) -> Linearized:
            e = [a[0] - x, a[1] - y, wrapped(a[2] - theta)]
            return e, ([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],)

        arguments = {"pose": held, "information": omega, "kernel": kernel}
        super().__init__([key], [POSE], residual, arguments, information=omega)
