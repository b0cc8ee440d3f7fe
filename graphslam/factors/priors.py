"""Gaussian priors: of a pose that is held at a value, and of several nodes together, such as the landmarks of a map.

`PositionFactor` measures the place of a point of the robot in the world: by GPS, motion capture, or a total station.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import cos, sin

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from ..errors import OptionError, checks, quoted
from ..se2 import Array
from .arguments import PoseLike, positive_definite
from .base import KINDS, POSE, Coordinates, Factor, KernelLike, Linearized, kinds_of, listed_keys, noise_model, wrapped


class PriorFactor(Factor):
    """The values at keys, with a joint prior: e = x - x̂ of all of them in world axes, headings wrapped.

    With a ``pivot`` c, that of a map, a turn of all keys together counts as its angle theta. In complex numbers x + i y,

        e = exp(-i theta) (x - c) - (x̂ - c) + i theta (x̂ - c),   theta = arg sum of conj(x̂ - mean) x.

    Args:
        keys: of the nodes, each a `gtsam.Pose2` or a `gtsam.Point2`.
        values: x̂ (K, 3); the heading of a point is not used.
        information: (N, N), for the coordinates of all keys in their order.
        coordinates: (K,) 3 or 2, how many coordinates of each key the prior is about; default: all that it has.
        points: the number of points; they are the last keys.
        pivot: the centre (2,) of `graphslam.edges.freest_turn`; default: the prior is quadratic in the values.
        kernel: a robust kernel around the noise model; see `graphslam.edges.robust`.

    Raises:
        OptionError: an argument has an impossible value.
    """

    keys_in_list = True

    def __init__(
        self,
        keys: Sequence[int],
        values: ArrayLike,
        information: ArrayLike,
        *,
        coordinates: Sequence[int] | np.ndarray | None = None,
        points: int = 0,
        pivot: ArrayLike | None = None,
        kernel: KernelLike = None,
    ) -> None:
        keys = listed_keys("PriorFactor", keys)
        kinds, held = kinds_of(keys, points), checks.finite_numbers("values", values, (len(keys), 3))
        most = [KINDS[kind][0] for kind in kinds]
        given = (
            most if coordinates is None else checks.finite_numbers("coordinates", coordinates, (len(keys),)).tolist()
        )
        if any(n not in (2, 3) or n > m for n, m in zip(given, most)):
            raise OptionError(f"coordinates must be 2 or 3 for each key, and 2 for points, not {quoted(coordinates)}")
        used = [int(n) for n in given]
        checks.check_heading("values", held[np.array(used) == 3, 2])
        omega = positive_definite(information, sum(used))
        # which of the three coordinates of each key the prior is about, and which it has
        about, has = (np.flatnonzero(np.arange(3) < np.array(n)[:, None]) for n in (used, most))
        ends = np.cumsum(most)[:-1]
        jacobians = np.split(np.eye(3 * len(keys))[np.ix_(about, has)], ends, axis=1)
        rows = held.tolist()
        centre = None if pivot is None else checks.finite_numbers("pivot", pivot, (2,))
        if centre is not None and not np.ptp(held[:, :2], axis=0).any():
            raise OptionError(
                "a pivot needs values at two places or more, which have an angle together: leave it out here"
            )
        turning = None if centre is None else _turning(held, complex(*centre), about, has, ends)

        def residual(*nodes: Coordinates) -> Linearized:
            if turning is not None:
                return turning(nodes)
            e: list[float] = []
            for at, (x, y, theta), n in zip(nodes, rows, used):
                e += [at[0] - x, at[1] - y] + ([wrapped(at[2] - theta)] if n == 3 else [])
            return e, jacobians

        arguments = {
            "values": held, "information": omega, "coordinates": np.array(used), "points": points,
            "pivot": centre, "kernel": kernel,
        }  # fmt: skip
        super().__init__(keys, kinds, residual, arguments, information=omega)


def _turning(
    held: Array, centre: complex, about: np.ndarray, has: np.ndarray, ends: np.ndarray
) -> Callable[[Sequence[Coordinates]], Linearized]:
    """The residual of a prior that turns with its keys, in complex numbers."""
    places = held[:, 0] + 1j * held[:, 1]
    arms, spread = places - centre, np.conj(places - places.mean())

    def residual(nodes: Sequence[Coordinates]) -> Linearized:
        at = np.array([(*node, 0.0)[:3] for node in nodes])
        x = at[:, 0] + 1j * at[:, 1]
        fit = spread @ x
        theta = float(np.angle(fit))
        back = np.exp(-1j * theta)
        way = back * (x - centre) - (1 - 1j * theta) * arms
        e = np.column_stack([way.real, way.imag, [wrapped(heading) for heading in at[:, 2] - held[:, 2]]])
        by_theta = 1j * (arms - back * (x - centre))
        theta_by = spread / fit
        jacobian = np.kron(np.eye(len(x)), [[back.real, -back.imag, 0], [back.imag, back.real, 0], [0, 0, 1]])
        jacobian += np.outer(
            np.column_stack([by_theta.real, by_theta.imag, np.zeros(len(x))]),
            np.column_stack([theta_by.imag, theta_by.real, np.zeros(len(x))]),
        )
        return e.ravel()[about], np.split(jacobian[np.ix_(about, has)], ends, axis=1)

    return residual


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
        held = checks.checked_pose("pose", pose)
        omega = 1e6 * np.eye(3) if information is None else positive_definite(information)
        x, y, theta = held.tolist()

        def residual(a: Coordinates) -> Linearized:
            e = [a[0] - x, a[1] - y, wrapped(a[2] - theta)]
            return e, ([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],)

        arguments = {"pose": held, "information": omega, "kernel": kernel}
        super().__init__([key], [POSE], residual, arguments, information=omega)


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
        z, arm = checks.finite_numbers("measured", measured, (2,), (3,)), checks.finite_numbers("lever", lever, (2,))
        omega = positive_definite(information, len(z))
        (x, y), (ahead, left), heading = z[:2].tolist(), arm.tolist(), z[2:].tolist()
        checks.check_heading("measured", z[2:])

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
