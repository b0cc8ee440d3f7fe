"""Factors of one pose measured from another: relative poses, motions by controls, many of them in one factor, and two
sightings of one landmark.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin
from typing import Any

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from ..edges.robust import code_and_width, kernel_of
from ..engine import engine
from ..errors import GraphError, OptionError, checks, quoted
from ..linear.precision import check_size, model_of, small_inverse
from ..models import MotionModel, SensorModel
from ..se2 import Array, turned_by
from .arguments import (
    PoseLike,
    frozen_at,
    in_robot_frame,
    in_world_frame,
    noise_sighting,
    positive_definite,
    sighted_covariance,
    sighting,
)
from .base import POSE, Coordinates, Factor, KernelLike, Linearized, kinds_of, listed_keys, noise_model, wrapped


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
        z, omega = checks.checked_pose("measured", measured), positive_definite(information)
        arguments = {"measured": z, "information": omega, "frame": frame, "at": at, "kernel": kernel}
        self._make([key_1, key_2], z, omega, arguments)

    def _make(self, keys: list[int], z: Array, omega: Array, arguments: dict[str, Any]) -> None:
        """Make the factor of a relative pose (3,) and its information (3, 3), unscaled."""
        self._between = z, omega
        (dx, dy, turned), world = z.tolist(), in_world_frame(arguments["frame"])
        frozen = frozen_at(arguments["at"], needed=world)
        omega = omega if frozen is None else turned_by(omega, frozen[2])

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
        _check_body(arguments["frame"])
        z, omega = self._between
        noise = noise_model(arguments, information=turned_by(omega, -z[2]))
        key_1, key_2 = self.keys()
        return gtsam.BetweenFactorPose2(key_1, key_2, gtsam.Pose2(*z), noise)


def _check_body(frame: str) -> None:
    """Raise `OptionError` in the world frame, whose information is frozen; that of GTSAM's factor turns with the pose."""
    if frame == "world":
        raise OptionError("to_between needs frame='body': GTSAM's factor turns its information with the pose")


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
        checks.check_positive(dt=dt)
        motion, u = model_of(MotionModel, motion), checks.finite_numbers("control", control, (2,))
        nu, omega = u.tolist()
        sizes = {"dt": float(dt), "the distance of control": nu * dt, "the turn of control": omega * dt}
        for name, number in sizes.items():
            check_size(name, number)
        relative = (
            "use RelativePoseFactor with the relative pose and information of MotionModel.f and MotionModel.covariance"
        )
        checks.check_turn_rate(omega, relative, checks.QUICKEST)
        options = {"frame": frame, "at": at, "scale": scale, "kernel": kernel}
        arguments = {"control": u, "dt": dt, "motion": motion} | options
        # f and its covariance turn with the pose that they start from
        moved, covariance = motion.moved(u, float(dt))
        information = small_inverse(covariance)
        if information is None:
            raise GraphError("the uncertainty of the motion is singular to double precision; raise epsilon")
        self._make([key_1, key_2], moved, information, arguments)


class RelativeEdgesFactor(Factor):
    """Nodes measured in the frames of poses: the sum of a `RelativePoseFactor` or `RelativePointFactor` for each edge.

    A graph of many such edges is evaluated faster with some of them in one factor, above all because GTSAM's optimisers
    copy all values of the graph for every call of a Python factor. Put edges together that share nodes: the factor connects
    all its keys. e is whitened already, L' (R(theta_i)' (p_j - p_i) - t, theta_j - theta_i - theta_z) with
    Omega = L L', and a kernel acts on each edge: the cost, its gradient and the Gauss-Newton matrix are those of the single
    factors.

    Args:
        keys: the nodes, each a `gtsam.Pose2` or a `gtsam.Point2`.
        first, second: (E,) the places of each edge's ends among the keys; the first is a pose.
        measured: (E, 3) z = (x, y, theta); theta is not used where the second end is a point.
        information: (E, 3, 3) in the axes of the first end; for a point only the leading 2 x 2 part counts.
        points: the number of points; they are the last keys.
        frame: "body" or "world", as in `RelativePoseFactor`.
        at: (E,) the heading of each first end at which the world frame freezes the information.
        edge_kernel: a robust kernel on each edge of which ``robust`` is true; see `graphslam.edges.robust`.
        robust: (E,) bool; default: all edges.
        kernel: a robust kernel around all edges as a whole.

    Raises:
        OptionError: an argument has an impossible value.
    """

    keys_in_list = True

    def __init__(
        self,
        keys: Sequence[int],
        first: ArrayLike,
        second: ArrayLike,
        measured: ArrayLike,
        information: ArrayLike,
        *,
        points: int = 0,
        frame: str = "body",
        at: ArrayLike | None = None,
        edge_kernel: KernelLike = None,
        robust: ArrayLike | None = None,
        kernel: KernelLike = None,
    ) -> None:
        keys = listed_keys("RelativeEdgesFactor", keys)
        kinds, world = kinds_of(keys, points), in_world_frame(frame)
        poses = len(keys) - points
        i, j = checks.array_of("first", first), checks.array_of("second", second)
        listed = i.ndim == 1 and i.shape == j.shape and len(i) > 0
        if not listed or not np.all(
            (i >= 0) & (i < poses) & (j >= 0) & (j < len(keys)) & (i != j) & (i % 1 + j % 1 == 0)
        ):
            raise OptionError("first and second must be places of keys, one of a pose and one of another node per edge")
        i, j = i.astype(np.int64), j.astype(np.int64)
        z = checks.finite_numbers("measured", measured, (len(i), 3))
        checks.check_heading("measured", z[j < poses, 2])
        omega = checks.finite_numbers("information", information, (len(i), 3, 3))
        rows = np.where(j < poses, 3, 2)
        root = np.zeros_like(omega)
        for edge, d in enumerate(rows.tolist()):
            root[edge, :d, :d] = np.linalg.cholesky(positive_definite(omega[edge, :d, :d], d)).T
        frozen = checks.finite_numbers("at", at, (len(i),)) if world else np.zeros(len(i))
        checks.check_heading("at", frozen)
        edge_kernel = kernel_of(edge_kernel)
        # a kernel without a width takes that of the dimension
        of_rows = {d: code_and_width(edge_kernel and edge_kernel.of_dimension(d)) for d in (2, 3)}
        code, widths = of_rows[3][0], np.array([of_rows[d][1] for d in rows.tolist()])
        flags = np.ones(len(i), dtype=bool) if robust is None else checks.array_of("robust", robust)
        if flags.shape != i.shape or not np.isin(flags, (0, 1)).all():
            raise OptionError(f"robust must be {len(i)} times True or False, once for each edge, not {quoted(robust)}")
        robust = flags.astype(bool)
        codes = np.where(robust, code, 0)
        edges = engine.WhitenedEdges(i, j, rows, z, root, frozen, codes, widths, poses, world)

        def stacked(nodes: tuple[Coordinates, ...]) -> Array:
            at = np.zeros((len(nodes), 3))
            at[:poses] = nodes[:poses]
            if points:
                at[poses:, :2] = nodes[poses:]
            return at

        def error(*nodes: Coordinates) -> Array:
            return edges.residuals(stacked(nodes))

        def residual(*nodes: Coordinates) -> Linearized:
            e, jacobians = edges.linearized(stacked(nodes))
            return e, [jacobian[: 3 if k < poses else 2].T for k, jacobian in enumerate(jacobians)]

        options = {"points": points, "frame": frame, "at": frozen if world else None, "kernel": kernel}
        arguments = {"first": i, "second": j, "measured": z, "information": omega} | options
        super().__init__(
            keys, kinds, residual,
            arguments | {"edge_kernel": edge_kernel, "robust": robust},
            covariance=np.eye(int(rows.sum())), in_own_axes=True, error=error,
        )  # fmt: skip


class VirtualMotionFactor(Factor):
    """Two sightings of one landmark, from the poses at two keys: e = h^-1(x_2, z_2) - h^-1(x_1, z_1).

    Omega^-1 = R_1 Q_1 R_1' + R_2 Q_2 R_2'. With ``frame="body"`` and psi the residual is turned into the first
    sighting's axes, R(theta_1 + phi_1)' e, where Omega^-1 = L(l_1, 0) Q_1 L' + L(l_2, psi_2 - psi_1) Q_2 L' depends on
    the sightings alone. In all other cases the information depends on the poses and is frozen at the poses ``at``:
    ``frame="world"`` keeps e in the world's axes; ``frame="body"`` without psi turns e, and the frozen information,
    with the first pose.

    Args:
        key_1, key_2: of two `gtsam.Pose2`.
        z_1, z_2: sightings (l, phi, psi) or (l, phi) [m, rad, rad].
        sensor: gives Q; default: the book's.
        frame: "body" or "world".
        at: the two poses, each (3,) or a `gtsam.Pose2`, at which state-dependent information is evaluated.
        scale: factor on the information.
        kernel: a robust kernel around the noise model; see `graphslam.edges.robust`.
        noise_at: the two sightings at which Q and L are evaluated; default: the measured ones.

    Raises:
        OptionError: an argument has an impossible value, or ``at`` is missing where the information depends on the poses.

    Source: the lectures, slides 9.1 to 9.2.
    """

    def __init__(
        self,
        key_1: int,
        key_2: int,
        z_1: ArrayLike,
        z_2: ArrayLike,
        sensor: SensorModel | None = None,
        *,
        frame: str = "body",
        at: tuple[PoseLike, PoseLike] | None = None,
        scale: float = 1.0,
        kernel: KernelLike = None,
        noise_at: tuple[ArrayLike, ArrayLike] | None = None,
    ) -> None:
        sensor, body = model_of(SensorModel, sensor), not in_world_frame(frame)
        z_1, z_2 = sighting("z_1", z_1), sighting("z_2", z_2)
        if len(z_1) != len(z_2):
            raise OptionError("z_1 and z_2 must both have psi, or both lack it")
        oriented = len(z_1) == 3
        _, phi1, psi1 = (*z_1.tolist(), 0.0)[:3]
        frozen = frozen_at(at, needed=not (body and oriented), rows=2, frame=frame)
        at_1, at_2 = z_1.tolist(), z_2.tolist()
        if noise_at is not None:
            if not hasattr(noise_at, "__len__") or len(noise_at) != 2:
                raise OptionError("noise_at must be two sightings, as z_1 and z_2 are")
            at_1, at_2 = (noise_sighting(seen, z).tolist() for seen, z in zip(noise_at, (z_1, z_2)))
        # poses that see the landmark in the axes of the first sighting, if the information does not depend on the poses
        headings = [at_1[-1] - at_1[1] - psi1, at_2[-1] - at_2[1] - psi1] if frozen is None else frozen[:, 2].tolist()
        covariance = sighted_covariance(headings[0], at_1, sensor) + sighted_covariance(headings[1], at_2, sensor)
        # in the body frame e is in axes that stand at this angle to the heading of the first pose
        ahead = phi1 if oriented else -headings[0]
        first, second, both = np.zeros(1, np.int64), np.ones(1, np.int64), np.array([z_1, z_2])
        unit = np.eye(3)[None]  # the factor weighs e by itself
        pair = engine.LandmarkPairs(
            np.arange(2), both, np.array([ahead, 0.0]), sensor.offset, body, first, second, unit
        )

        def residual(a: Coordinates, b: Coordinates) -> Linearized:
            # derivatives by GTSAM's perturbations, each pose's in its own axes
            e_and_columns = pair.linearized(a, b)
            return e_and_columns[0], (e_and_columns[1:4].T, e_and_columns[4:].T)

        options = {"frame": frame, "at": frozen, "scale": scale, "kernel": kernel}
        options["noise_at"] = None if noise_at is None else np.array([at_1, at_2])
        arguments = {"z_1": z_1, "z_2": z_2, "sensor": sensor} | options
        super().__init__([key_1, key_2], [POSE, POSE], residual, arguments, covariance=covariance, in_own_axes=True)

    def to_between(self) -> gtsam.BetweenFactorPose2:
        """GTSAM's own factor of the same two sightings, with the speed of C++: the relative pose z_12 = T_1 T_2^-1.

        T = (l cos phi, l sin phi, phi - psi), plus the offset of the sensor, is the landmark as a pose seen from the
        robot. The noise that the landmark has in its own axes, C = L(l_1, psi_1) Q_1 L' + L(l_2, psi_2) Q_2 L', becomes
        Ad(T_2) C Ad(T_2)' by the adjoint. Value and information agree with this factor where e = 0; GTSAM measures the
        error through the logarithm of SE(2), so away from there they differ (docs/factors.md has figures).

        Raises:
            OptionError: without psi two sightings measure no relative pose; in the world frame the information is frozen.
        """
        arguments = self.description.arguments
        z_1, z_2, sensor = arguments["z_1"], arguments["z_2"], arguments["sensor"]
        if len(z_1) != 3:
            raise OptionError("without psi two sightings of a landmark measure no relative pose")
        _check_body(arguments["frame"])
        landmark_1, landmark_2 = (gtsam.Pose2(*in_robot_frame(z, sensor), z[1] - z[2]) for z in (z_1, z_2))
        # a pose whose theta + phi is psi sees the landmark in the landmark's own axes
        noisy = (z_1, z_2) if arguments["noise_at"] is None else arguments["noise_at"]
        covariance = sum(sighted_covariance(z[2] - z[1], z, sensor) for z in noisy)
        adjoint = landmark_2.AdjointMap()
        covariance = adjoint @ covariance @ adjoint.T
        noise = noise_model(arguments, covariance=(covariance + covariance.T) / 2)
        key_1, key_2 = self.keys()
        return gtsam.BetweenFactorPose2(key_1, key_2, landmark_1.compose(landmark_2.inverse()), noise)
