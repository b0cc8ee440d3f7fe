"""GTSAM factor types for any graph of your own: virtual motion, motion, relative pose, observation, point, anchor.

Every factor is a `gtsam.CustomFactor` whose residual and analytic Jacobians are those of the edges of this framework,
derived here a second time, on scalars, so that the two implementations check each other. GTSAM perturbs a pose on its
right, in the pose's own axes, so a Jacobian by world coordinates is multiplied by blkdiag(R(theta), 1).

GTSAM's ``error`` is one half of e' Omega e.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import atan2, cos, floor, hypot, pi, sin
from typing import Any

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from .errors import OptionError, check_choice, check_positive
from .models import MotionModel, SensorModel
from .se2 import Array, rotation

Pose = tuple[float, float, float]
#: e, and per key the rows of de/dx in world coordinates
Residual = Callable[..., tuple[list[float], tuple[list[list[float]], ...]]]


class VirtualMotionFactor(gtsam.CustomFactor):
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
        at: the two poses ((3,), (3,)) at which state-dependent information is evaluated.
        weight: factor on the information.

    Raises:
        OptionError: a value is not what it must be, or ``at`` is missing where the information depends on the poses.

    Source: the lectures, slides 9.1 to 9.2.
    """

    def __init__(
        self,
        key_1: int,
        key_2: int,
        z_1: ArrayLike,
        z_2: ArrayLike,
        sensor: SensorModel | None = None,
        frame: str = "body",
        *,
        at: tuple[ArrayLike, ArrayLike] | None = None,
        weight: float = 1.0,
    ) -> None:
        check_choice("frame", frame, ("world", "body"))
        check_positive(weight=weight)
        sensor = _centred(sensor)
        first, second = _sighting("z_1", z_1), _sighting("z_2", z_2)
        if len(first) != len(second):
            raise OptionError("z_1 and z_2 must both have psi, or both lack it")
        oriented = len(first) == 3
        (l1, phi1, psi1), (l2, phi2, psi2) = ((*z, 0.0)[:3] for z in (first.tolist(), second.tolist()))
        if frame == "body" and oriented:
            axes_1, axes_2 = np.array([0.0, 0.0, -phi1]), np.array([0.0, 0.0, psi2 - psi1 - phi2])
            covariance = sensor.landmark_covariance(axes_1, first) + sensor.landmark_covariance(axes_2, second)
        elif at is None:
            raise OptionError(
                f"with frame={frame!r} and {len(first)}-D sightings the information depends on the poses; "
                "give them as 'at'"
            )
        else:
            x1, x2 = _vector("at[0]", at[0], (3,)), _vector("at[1]", at[1], (3,))
            covariance = sensor.landmark_covariance(x1, first) + sensor.landmark_covariance(x2, second)
        body, frozen = frame == "body", 0.0 if oriented or frame == "world" else float(x1[2])

        def residual(a: Pose, b: Pose) -> tuple[list[float], tuple[list[list[float]], ...]]:
            ca, sa, cb, sb = cos(a[2] + phi1), sin(a[2] + phi1), cos(b[2] + phi2), sin(b[2] + phi2)
            ex, ey = b[0] + l2 * cb - a[0] - l1 * ca, b[1] + l2 * sb - a[1] - l1 * sa
            # what turning each pose does to e
            ax, ay, bx, by = l1 * sa, -l1 * ca, -l2 * sb, l2 * cb
            e, by_a, by_b = [ex, ey], [[-1.0, 0.0, ax], [0.0, -1.0, ay]], [[1.0, 0.0, bx], [0.0, 1.0, by]]
            if body:
                # the axes turn with pose a: towards the landmark, or as pose a has turned since the freezing
                turn = a[2] + phi1 if oriented else a[2] - frozen
                c, s = cos(turn), sin(turn)
                e = [c * ex + s * ey, -s * ex + c * ey]
                by_a = [[-c, -s, c * ax + s * ay + e[1]], [s, -c, -s * ax + c * ay - e[0]]]
                by_b = [[c, s, c * bx + s * by], [-s, c, -s * bx + c * by]]
            if oriented:
                e.append(_wrapped(b[2] + phi2 - psi2 - a[2] - phi1 + psi1))
                by_a.append([0.0, 0.0, -1.0])
                by_b.append([0.0, 0.0, 1.0])
            return e, (by_a, by_b)

        noise = gtsam.noiseModel.Gaussian.Covariance(covariance / weight)
        super().__init__(noise, [key_1, key_2], _callback((key_1, key_2), residual))


class RelativePoseFactor(gtsam.CustomFactor):
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
    ) -> None:
        check_choice("frame", frame, ("world", "body"))
        dx, dy, turned = _vector("measured", measured, (3,)).tolist()
        omega, world = _positive_definite(information), frame == "world"
        if world:
            if at is None:
                raise OptionError("with frame='world' the information depends on the pose x_1; give it as 'at'")
            turn = np.eye(3)
            turn[:2, :2] = rotation(_vector("at", at, (3,))[2])
            omega = turn @ omega @ turn.T

        def residual(a: Pose, b: Pose) -> tuple[list[float], tuple[list[list[float]], ...]]:
            c, s = cos(a[2]), sin(a[2])
            x, y, et = b[0] - a[0], b[1] - a[1], _wrapped(b[2] - a[2] - turned)
            if world:
                rx, ry = c * dx - s * dy, s * dx + c * dy
                by_a, by_b = [[-1.0, 0.0, ry], [0.0, -1.0, -rx]], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
                e = [x - rx, y - ry, et]
            else:
                sx, sy = c * x + s * y, -s * x + c * y
                by_a, by_b = [[-c, -s, sy], [s, -c, -sx]], [[c, s, 0.0], [-s, c, 0.0]]
                e = [sx - dx, sy - dy, et]
            return e, ([*by_a, [0.0, 0.0, -1.0]], [*by_b, [0.0, 0.0, 1.0]])

        super().__init__(
            gtsam.noiseModel.Gaussian.Information(omega), [key_1, key_2], _callback((key_1, key_2), residual)
        )


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
    ) -> None:
        check_positive(weight=weight, dt=dt)
        motion, u, origin = motion or MotionModel(), _vector("control", control, (2,)), np.zeros(3)
        # f and its covariance turn with the pose they start from
        information = weight * np.linalg.inv(motion.covariance(origin, u, dt))
        super().__init__(key_1, key_2, motion.f(origin, u, dt), information, frame, at=at)


class ObservationFactor(gtsam.CustomFactor):
    """A sighting with psi of a landmark that is a `gtsam.Pose2` of its own: e = h(x, m) - z, information Q^-1.

    Without psi the landmark is a `gtsam.Point2` and GTSAM has the factor itself: then the call
    ``ObservationFactor(pose_key, landmark_key, z)`` returns a native `gtsam.BearingRangeFactor2D`.

    Args:
        pose_key: of a `gtsam.Pose2`.
        landmark_key: of a `gtsam.Pose2` (with psi) or a `gtsam.Point2` (without).
        z: (l, phi, psi) or (l, phi) [m, rad, rad].
        sensor: gives Q, at the measured range; default: the book's.

    Raises:
        OptionError: a value is not what it must be.
    """

    def __new__(cls, pose_key: int, landmark_key: int, z: ArrayLike, sensor: SensorModel | None = None) -> Any:
        """The native factor where GTSAM has one."""
        seen = _sighting("z", z)
        if len(seen) == 3:
            return super().__new__(cls)
        stds = np.sqrt(np.diag(_centred(sensor).Q(seen)))
        # GTSAM puts the bearing first
        noise = gtsam.noiseModel.Diagonal.Sigmas(stds[::-1].copy())
        return gtsam.BearingRangeFactor2D(pose_key, landmark_key, gtsam.Rot2(seen[1]), seen[0], noise)

    def __init__(self, pose_key: int, landmark_key: int, z: ArrayLike, sensor: SensorModel | None = None) -> None:
        seen = _sighting("z", z)
        length, bearing, orientation = seen.tolist()

        def residual(x: Pose, m: Pose) -> tuple[list[float], tuple[list[list[float]], ...]]:
            dx, dy = m[0] - x[0], m[1] - x[1]
            r, direction = hypot(dx, dy), atan2(dy, dx)
            c, s, p, q = dx / r, dy / r, -dy / (r * r), dx / (r * r)
            e = [r - length, _wrapped(direction - x[2] - bearing), _wrapped(direction - m[2] - orientation)]
            by_pose = [[-c, -s, 0.0], [-p, -q, -1.0], [-p, -q, 0.0]]
            return e, (by_pose, [[c, s, 0.0], [p, q, 0.0], [p, q, -1.0]])

        noise = gtsam.noiseModel.Gaussian.Covariance(_centred(sensor).Q(seen))
        super().__init__(noise, [pose_key, landmark_key], _callback((pose_key, landmark_key), residual))


class RelativePointFactor(gtsam.CustomFactor):
    """A `gtsam.Point2` landmark measured in the frame of a pose: e = R(theta)' (m - p) - z.

    Args:
        pose_key, landmark_key: of a `gtsam.Pose2` and a `gtsam.Point2`.
        measured: z = (x, y) [m].
        information: Omega (2, 2).

    Raises:
        OptionError: a value is not what it must be.
    """

    def __init__(self, pose_key: int, landmark_key: int, measured: ArrayLike, information: ArrayLike) -> None:
        zx, zy = _vector("measured", measured, (2,)).tolist()
        noise = gtsam.noiseModel.Gaussian.Information(_positive_definite(information, 2))

        def callback(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: Any) -> Array:
            x, y, theta = _coordinates(values.atPose2(pose_key))
            m = values.atPoint2(landmark_key)
            c, s = cos(theta), sin(theta)
            dx, dy = m[0] - x, m[1] - y
            sx, sy = c * dx + s * dy, -s * dx + c * dy
            if jacobians is not None:
                jacobians[0] = np.array([[-1.0, 0.0, sy], [0.0, -1.0, -sx]], order="F")
                jacobians[1] = np.array([[c, s], [-s, c]], order="F")
            return np.array([sx - zx, sy - zy])

        super().__init__(noise, [pose_key, landmark_key], callback)


class AnchorFactor(gtsam.CustomFactor):
    """The pose at a key held at a value: e = x - x̂ in world axes, the heading wrapped.

    Args:
        key: of a `gtsam.Pose2`.
        pose: x̂ (3,).
        information: Omega_0 (3, 3); default: the lectures' 1e6 I.

    Raises:
        OptionError: a value is not what it must be.
    """

    def __init__(self, key: int, pose: ArrayLike, information: ArrayLike | None = None) -> None:
        held = _vector("pose", pose, (3,)).tolist()
        omega = _positive_definite(1e6 * np.eye(3) if information is None else information)

        def residual(a: Pose) -> tuple[list[float], tuple[list[list[float]], ...]]:
            e = [a[0] - held[0], a[1] - held[1], _wrapped(a[2] - held[2])]
            return e, ([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],)

        super().__init__(gtsam.noiseModel.Gaussian.Information(omega), [key], _callback((key,), residual))


def _callback(keys: Sequence[int], residual: Residual) -> Callable[..., Array]:
    # Closes over the keys and the numbers, never over the factor: a factor that its own callback refers to would never
    # be collected. Every Jacobian is always filled with its full shape: GTSAM reads them without looking.
    def callback(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: Any) -> Array:
        poses = [_coordinates(values.atPose2(key)) for key in keys]
        e, by_pose = residual(*poses)
        if jacobians is not None:
            for k, (rows, pose) in enumerate(zip(by_pose, poses)):
                c, s = cos(pose[2]), sin(pose[2])
                on_the_right = [[r[0] * c + r[1] * s, -r[0] * s + r[1] * c, r[2]] for r in rows]
                jacobians[k] = np.array(on_the_right, order="F")
        return np.array(e)

    return callback


def _centred(sensor: SensorModel | None) -> SensorModel:
    sensor = sensor or SensorModel()
    if not sensor.centred:
        raise OptionError(
            "these factors have the sensor at the robot's pose; a sensor with an offset is not theirs yet"
        )
    return sensor


def _coordinates(pose: gtsam.Pose2) -> Pose:
    return pose.x(), pose.y(), pose.theta()


def _wrapped(angle: float) -> float:
    return angle - 2 * pi * floor((angle + pi) / (2 * pi))


def _positive_definite(information: ArrayLike, size: int = 3) -> Array:
    omega = np.asarray(information, dtype=float)
    symmetric = omega.shape == (size, size) and np.allclose(omega, omega.T, rtol=0, atol=1e-9 * np.abs(omega).max())
    if not symmetric or not np.linalg.eigvalsh(omega)[0] > 0:
        raise OptionError(f"information must be a symmetric positive definite {size} x {size} matrix")
    return (omega + omega.T) / 2


def _sighting(name: str, value: ArrayLike) -> Array:
    z = _vector(name, value, (2, 3))
    if z[0] <= 0:
        raise OptionError(f"the range of {name} must be above zero, not {z[0]:g} m")
    return z


def _vector(name: str, value: ArrayLike, lengths: tuple[int, ...]) -> Array:
    vector = np.asarray(value, dtype=float)
    if vector.ndim != 1 or len(vector) not in lengths or not np.all(np.isfinite(vector)):
        raise OptionError(f"{name} must be {' or '.join(map(str, lengths))} finite numbers, not {value!r}")
    return vector
