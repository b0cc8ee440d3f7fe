"""Factors of landmarks: all sightings of one in one factor (one callback in place of K (K-1) / 2), or a node of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import atan2, cos, hypot, sin

import gtsam
import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import lapack

from ..edges.robust import kernel_of
from ..engine import engine
from ..errors import FactorError, OptionError, checks, quoted
from ..linear.precision import SMALLEST, check_size, model_of
from ..models import RESIDUALS, WEIGHTS, SensorModel
from ..se2 import Array, rotation, wrap
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
from .base import POINT, POSE, Coordinates, Factor, KernelLike, Linearized, listed_keys, noise_model, wrapped

#: the number of rows of e; the residual; e alone
Evaluation = tuple[int, Callable[..., Linearized], Callable[..., Array]]


class LandmarkFactor(Factor):
    """All edges that the sightings of one landmark make between the poses that saw it, as one factor.

    ``weight="pairs"`` and ``"tempered"`` have exactly the cost of a `VirtualMotionFactor` for every pair of sightings
    from different poses. Let b be the stacked residual of the K (K-1) / 2 pairs and A its Jacobian. With A'A = R'R, R
    the triangle of QR, the part of b in the range of A is d = R^-T A'b, and the error of the factor is
    (d, sqrt(b'b - d'd)): 3 K + 1 rows with the same cost, gradient and Gauss-Newton matrix. (R comes from a pivoted
    Cholesky factorisation of A'A, which has the size of the poses and not of the pairs.) Only the norm and the
    linearisation of this error have a meaning, not its single rows.

    ``weight="marginal"`` eliminates the landmark: e_a = m̂ - y_a for each sighting, where y_a = h^-1(x_a, z_a) and m̂ is
    the weighted mean of the y_a, which minimises the cost; see `edges.sightings`. Each sighting counts once.

    Args:
        keys: (K,) of `gtsam.Pose2`, the pose of each sighting; a key may be repeated.
        sightings: (K, 3) with psi or (K, 2) without.
        sensor: gives Q; default: the book's.
        frame: "body" or "world", as for `VirtualMotionFactor`.
        weight: "pairs", "tempered" (every pair times 2/K) or "marginal".
        at: (K, 3), or K `gtsam.Pose2`: the poses at which state-dependent information is evaluated, for
            ``frame="world"`` and for pairs without psi.
        trust: (K,) a factor above 0 on the information of each sighting. A pair has the product of its two factors.
        kernel: a robust kernel around the landmark as a whole, with its width in standard deviations, ``Huber(5.0)``: the
            rows of the error are no independent measurements, from which a default width could follow. (For a kernel on
            every pair or every sighting use `VirtualMotionFactor`, `InverseObservationFactor` or `ObservationFactor`.)
        noise_at: (K, 3) or (K, 2): the sightings at which Q and L are evaluated; default: the measured ones.

    Raises:
        OptionError: an argument has an impossible value, or ``at`` is missing where the information depends on the poses.
    """

    keys_in_list = True

    def __init__(
        self,
        keys: Sequence[int],
        sightings: ArrayLike,
        sensor: SensorModel | None = None,
        *,
        frame: str = "body",
        weight: str = "pairs",
        at: ArrayLike | Sequence[PoseLike] | None = None,
        trust: ArrayLike | None = None,
        kernel: KernelLike = None,
        noise_at: ArrayLike | None = None,
    ) -> None:
        world, robust = in_world_frame(frame), kernel_of(kernel)
        if robust is not None and robust.width is None:
            raise OptionError(f"the kernel of a LandmarkFactor needs a width, such as {type(robust).__name__}(5.0)")
        checks.check_choice("weight", weight, WEIGHTS)
        keys = listed_keys("LandmarkFactor", keys)
        sensor = model_of(SensorModel, sensor)
        place = {key: k for k, key in enumerate(dict.fromkeys(keys))}
        node = np.array([place[key] for key in keys], dtype=int)
        z = _sightings("sightings", sightings, (2, 3), len(node))
        at_sightings = z if noise_at is None else _sightings("noise_at", noise_at, z.shape[1:], len(node))
        trusted = np.ones(len(z)) if trust is None else checks.finite_numbers("trust", trust, (len(z),))
        if np.any(trusted <= 0):
            raise OptionError(f"trust must be above zero for every sighting, not {quoted(trust)}")
        frozen = frozen_at(at, needed=world or (weight != "marginal" and z.shape[1] == 2), rows=len(z), frame=frame)
        if weight == "marginal":
            rows, residual, error = _marginal(z, at_sightings, node, sensor, world, trusted, frozen)
        else:
            scale = 2 / float(np.sum(trusted)) if weight == "tempered" else 1.0
            rows, residual, error = _pairs(z, at_sightings, node, sensor, world, trusted, frozen, scale)
        options = {"frame": frame, "weight": weight, "at": frozen, "kernel": kernel}
        options["noise_at"] = None if noise_at is None else at_sightings
        arguments = {"sightings": z, "sensor": sensor, "trust": None if trust is None else trusted} | options
        super().__init__(
            list(place), [POSE] * len(place), residual, arguments,
            covariance=np.eye(rows), named_keys=keys, in_own_axes=True, error=error,
        )  # fmt: skip


def _sightings(name: str, value: ArrayLike, lengths: tuple[int, ...], rows: int) -> Array:
    """Sightings (K, d) from an argument.

    Raises:
        OptionError: they are none, or a range is not above zero.
        GraphError: a range is outside of what double precision can hold.
    """
    z = checks.finite_numbers(name, value, *((rows, length) for length in lengths))
    if len(z) == 0 or np.any(z[:, 0] <= 0):
        raise OptionError("LandmarkFactor needs at least one sighting, and ranges above zero")
    check_size("ranges", z[:, 0], least=SMALLEST)
    checks.check_sighted(name, (z[:, 1:].min(), z[:, 1:].max()))
    return z


def _pairs(
    z: Array, noisy: Array, node: np.ndarray, sensor: SensorModel, world: bool, trust: Array, frozen: Array | None,
    scale: float,
) -> Evaluation:  # fmt: skip
    """All pairs of sightings (K, d) from different poses, with the noise at other sightings (K, d)."""
    poses = int(node.max()) + 1
    a, b = np.triu_indices(len(z), k=1)
    a, b = a[node[a] != node[b]], b[node[a] != node[b]]
    at_a, at_b, ahead = np.zeros((len(a), 3)), np.zeros((len(a), 3)), np.zeros(len(z))
    if frozen is not None:
        at_a, at_b, ahead = frozen[a], frozen[b], -frozen[:, 2]
    else:
        # poses that see the landmark in the axes of the first pose, where its heading is phi - psi
        for at, seen in ((at_a, noisy[a]), (at_b, noisy[b])):
            at[:, 2] = z[a, 1] - z[a, 2] - seen[:, 1] + seen[:, 2]
    covariance = sensor.landmark_covariance(at_a, noisy[a]) + sensor.landmark_covariance(at_b, noisy[b])
    # without psi the third row and column stay zero
    information = np.zeros((len(a), 3, 3))
    weighed = np.linalg.inv(covariance) * (scale * trust[a] * trust[b])[:, None, None]
    information[:, : z.shape[1], : z.shape[1]] = weighed
    pairs = engine.LandmarkPairs(node, z, ahead, sensor.offset, not world, a, b, information)

    def error(*at: Coordinates) -> Array:
        # the norm of e is enough where no Jacobians are asked for
        return np.append(np.zeros(3 * poses), pairs.cost(np.array(at)) ** 0.5)

    def residual(*at: Coordinates) -> Linearized:
        e, R = compressed(*pairs.sums(np.array(at)))
        return e, [R[:, k : k + 3] for k in range(0, 3 * poses, 3)]

    return 3 * poses + 1, residual, error


def compressed(omega: Array, slope: Array, squares: float) -> tuple[Array, Array]:
    """Residuals e = (d, rest) (n+1,) and Jacobian R (n+1, n), with the same normal equations as b and A.

    R'R = omega = A'A, R'e = slope = A'b and e'e = squares = b'b. R comes from a Cholesky factorisation with diagonal
    pivoting, because omega is singular: nothing holds the poses as a whole. Directions with less than 1e-13 of the
    largest pivot are rounding errors.
    """
    n = len(omega)
    # a loop of our own took 0.7 ms for 50 poses where LAPACK takes 0.16 ms, and 13 us less for 3 poses
    upper, order, rank, _ = lapack.dpstrf(omega, tol=1e-13 * float(omega.max()))
    order -= 1  # LAPACK counts from one
    R, e = np.zeros((n + 1, n), order="F"), np.zeros(n + 1)
    R[:rank, order] = np.triu(upper)[:rank]
    if rank:  # all sightings may be from one pose
        e[:rank] = lapack.dtrtrs(upper[:rank, :rank], slope[order[:rank]], trans=1)[0].ravel()
    e[n] = max(float(squares - e @ e), 0.0) ** 0.5
    return e, R


def _marginal(
    z: Array, noisy: Array, node: np.ndarray, sensor: SensorModel, world: bool, trust: Array, frozen: Array | None
) -> Evaluation:
    """The landmark eliminated; arguments as for `_pairs`."""
    (K, d), poses = z.shape, int(node.max()) + 1
    information = np.linalg.inv(sensor.landmark_covariance(np.zeros((K, 3)) if frozen is None else frozen, noisy))
    information *= trust[:, None, None]
    # W = L L', in the axes of the robot, or the world's
    L_transposed = np.swapaxes(np.linalg.cholesky(information), 1, 2)
    none = np.zeros(0, dtype=np.int64)
    sightings = engine.LandmarkPairs(node, z, np.zeros(K), sensor.offset, not world, none, none, np.zeros((0, 3, 3)))

    def weighted(x: Array) -> tuple[Array, ...]:
        y, lever, turn = sightings.placed(x)
        y, (c, s) = y[:, :d], turn.T
        # from the world's axes to those of the robot
        axes = np.zeros((K, d, d))
        axes[:] = np.eye(d)
        axes[:, 0, 0] = axes[:, 1, 1] = c
        axes[:, 0, 1], axes[:, 1, 0] = s, -s
        whiten = L_transposed @ axes
        W = np.swapaxes(whiten, 1, 2) @ whiten
        S_inverse = np.linalg.inv(W.sum(axis=0))
        return _around_mean(y, W, S_inverse), lever, whiten, W, S_inverse

    def error(*at: Coordinates) -> Array:
        e, _, whiten, _, _ = weighted(np.array(at))
        return np.einsum("kij,kj->ki", whiten, e).ravel()

    def residual(*at: Coordinates) -> Linearized:
        x = np.array(at)
        e, lever, whiten, W, S_inverse = weighted(x)
        moved = np.zeros((K, d, 3))  # dy/dx
        moved[:] = np.eye(3)[:d]
        moved[:, :2, 2] = lever
        mean_moved = W @ moved  # S dm̂/dx
        own_moved = -whiten @ moved
        if not world:
            # W turns with its pose, dW = J W - W J, J the quarter turn; so do the axes of e
            We = np.einsum("kij,kj->ki", W, e)
            quarter = np.stack([-e[:, 1], e[:, 0]], axis=1)
            mean_moved[:, :, 2] += np.einsum("kij,kj->ki", W[:, :, :2], quarter)
            mean_moved[:, 0, 2] += We[:, 1]
            mean_moved[:, 1, 2] -= We[:, 0]
            own_moved[:, :, 2] -= np.einsum("kij,kj->ki", whiten[:, :, :2], quarter)
        mean_moved = S_inverse @ mean_moved
        A = whiten[:, None] @ mean_moved[None]  # (K rows, K sightings, d, 3)
        A[np.arange(K), np.arange(K)] += own_moved
        A[..., :2] = A[..., :2] @ rotation(x[node, 2])
        by_pose = np.zeros((poses, K, d, 3))
        np.add.at(by_pose, node, A.transpose(1, 0, 2, 3))
        return np.einsum("kij,kj->ki", whiten, e).ravel(), list(by_pose.reshape(poses, K * d, 3))

    return K * d, residual, error


def _around_mean(y: Array, W: Array, S_inverse: Array) -> Array:
    """e = m̂ - y (K, d); m̂ decides how each heading wraps; the search for it starts at their circular mean."""
    middle = y[0].copy()
    if y.shape[1] == 3:
        apart = y[:, 2] - y[0, 2]
        middle[2] += np.arctan2(W[:, 2, 2] @ np.sin(apart), W[:, 2, 2] @ np.cos(apart))
    for _ in range(100):
        # differences from the middle neither cancel nor wrap
        offset = y - middle
        offset[:, 2:] = wrap(offset[:, 2:])
        moved = S_inverse @ np.einsum("kij,kj->i", W, offset)
        e = moved - offset
        if np.all(np.abs(e[:, 2:]) <= np.pi):
            break
        middle = middle + moved
    return e


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
        sensor: gives Q; default: the book's.
        residual: "cartesian" or "polar".
        scale: factor on the information.
        kernel: a robust kernel around the noise model; see `graphslam.edges.robust`.
        noise_at: the sighting at which Q and L are evaluated; default: the measured one.

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
        noise_at: ArrayLike | None = None,
    ) -> None:
        z, sensor = sighting("z", z), model_of(SensorModel, sensor)
        at_sighting = noise_sighting(noise_at, z)
        checks.check_choice("residual", residual, RESIDUALS)
        if residual == "polar":
            evaluated, covariance = _polar(z, sensor), sensor.Q(at_sighting)
        else:
            evaluated, covariance = _seen(z, sensor), sighted_covariance(0.0, at_sighting.tolist(), sensor)
        arguments = {"z": z, "sensor": sensor, "residual": residual, "scale": scale, "kernel": kernel}
        arguments["noise_at"] = None if noise_at is None else at_sighting
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
        noise = noise_model(arguments, covariance=sensor.Q(noise_sighting(arguments["noise_at"], z))[::-1, ::-1])
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
        sensor: gives Q; default: the book's.
        frame: "body" or "world".
        at: the pose x, (3,) or a `gtsam.Pose2`, at which the world frame freezes the information.
        scale: factor on the information.
        kernel: a robust kernel around the noise model; see `graphslam.edges.robust`.
        noise_at: the sighting at which Q and L are evaluated; default: the measured one.

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
        noise_at: ArrayLike | None = None,
    ) -> None:
        z, sensor, world = sighting("z", z), model_of(SensorModel, sensor), in_world_frame(frame)
        frozen, kinds = frozen_at(at, needed=world), [POSE, POSE if len(z) == 3 else POINT]
        # in the robot's axes the covariance is that seen from a pose at the origin
        at_sighting = noise_sighting(noise_at, z)
        covariance = sighted_covariance(0.0 if frozen is None else float(frozen[2]), at_sighting.tolist(), sensor)
        residual = _seen(z, sensor, world)
        arguments = {"z": z, "sensor": sensor, "frame": frame, "at": frozen, "scale": scale, "kernel": kernel}
        arguments["noise_at"] = None if noise_at is None else at_sighting
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
        z, omega = checks.finite_numbers("measured", measured, (2,)), positive_definite(information, 2)
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
