"""All sightings of one landmark in one factor: one callback in place of K (K-1) / 2."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import lapack

from ..checks import check_choice
from ..engine import engine
from ..errors import OptionError, quoted
from ..models import SensorModel
from ..precision import SMALLEST, check_size
from ..se2 import Array, rotation, wrap
from .arguments import PoseLike, check_sighted, frozen_at, in_world_frame, numbers, sensor_of
from .base import POSE, Coordinates, Factor, KernelLike, Linearized, listed_keys

WEIGHTS = ("pairs", "tempered", "marginal")
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
    the weighted mean of the y_a, which minimises the cost; see `edges.marginal`. Each sighting counts once.

    Args:
        keys: (K,) of `gtsam.Pose2`, the pose of each sighting; a key may be repeated.
        sightings: (K, 3) with psi or (K, 2) without.
        sensor: gives Q; default: the book's.
        frame: "body" or "world", as for `VirtualMotionFactor`.
        weight: "pairs", "tempered" (every pair times 2/K) or "marginal".
        at: (K, 3), or K `gtsam.Pose2`: the poses at which state-dependent information is evaluated, for
            ``frame="world"`` and for pairs without psi.
        trust: (K,) a factor above 0 on the information of each sighting. A pair has the product of its two factors.
        kernel: a robust kernel around the landmark as a whole. (For a kernel on every pair or every sighting use
            `VirtualMotionFactor`, `InverseObservationFactor` or `ObservationFactor`.)

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
    ) -> None:
        world = in_world_frame(frame)
        check_choice("weight", weight, WEIGHTS)
        keys = listed_keys("LandmarkFactor", keys)
        sensor = sensor_of(sensor)
        place = {key: k for k, key in enumerate(dict.fromkeys(keys))}
        node = np.array([place[key] for key in keys], dtype=int)
        z = numbers("sightings", sightings, (2, 3), rows=len(node))
        if len(z) == 0 or np.any(z[:, 0] <= 0):
            raise OptionError("LandmarkFactor needs at least one sighting, and ranges above zero")
        check_size("ranges", z[:, 0], least=SMALLEST)
        check_sighted("sightings", (z[:, 1:].min(), z[:, 1:].max()))
        trusted = np.ones(len(z)) if trust is None else numbers("trust", trust, (len(z),))
        if np.any(trusted <= 0):
            raise OptionError(f"trust must be above zero for every sighting, not {quoted(trust)}")
        frozen = frozen_at(at, needed=world or (weight != "marginal" and z.shape[1] == 2), rows=len(z), frame=frame)
        if weight == "marginal":
            rows, residual, error = _marginal(z, node, sensor, world, trusted, frozen)
        else:
            scale = 2 / trusted.sum() if weight == "tempered" else 1.0
            rows, residual, error = _pairs(z, node, sensor, world, trusted, frozen, scale)
        options = {"frame": frame, "weight": weight, "at": frozen, "kernel": kernel}
        arguments = {"sightings": z, "sensor": sensor, "trust": None if trust is None else trusted} | options
        super().__init__(
            list(place), [POSE] * len(place), residual, arguments,
            covariance=np.eye(rows), named_keys=keys, in_own_axes=True, error=error,
        )  # fmt: skip


def _pairs(
    z: Array, node: np.ndarray, sensor: SensorModel, world: bool, trust: Array, frozen: Array | None, scale: float
) -> Evaluation:
    """All pairs of sightings from different poses."""
    poses = int(node.max()) + 1
    a, b = np.triu_indices(len(z), k=1)
    a, b = a[node[a] != node[b]], b[node[a] != node[b]]
    at_a, at_b, ahead = np.zeros((len(a), 3)), np.zeros((len(a), 3)), np.zeros(len(z))
    if frozen is not None:
        at_a, at_b, ahead = frozen[a], frozen[b], -frozen[:, 2]
    else:
        # poses that see the landmark in the axes of the first pose
        at_b[:, 2] = z[a, 1] - z[a, 2] - z[b, 1] + z[b, 2]
    covariance = sensor.landmark_covariance(at_a, z[a]) + sensor.landmark_covariance(at_b, z[b])
    # without psi the third row and column stay zero
    information = np.zeros((len(a), 3, 3))
    information[:, : z.shape[1], : z.shape[1]] = (
        np.linalg.inv(covariance) * (scale * trust[a] * trust[b])[:, None, None]
    )

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
    e[:rank] = lapack.dtrtrs(upper[:rank, :rank], slope[order[:rank]], trans=1)[0].ravel()
    e[n] = max(float(squares - e @ e), 0.0) ** 0.5
    return e, R


def _marginal(
    z: Array, node: np.ndarray, sensor: SensorModel, world: bool, trust: Array, frozen: Array | None
) -> Evaluation:
    """The landmark eliminated."""
    (K, d), poses = z.shape, int(node.max()) + 1
    information = np.linalg.inv(sensor.landmark_covariance(np.zeros((K, 3)) if frozen is None else frozen, z))
    information *= trust[:, None, None]
    # W = L L', in the axes of the robot, or the world's
    L_transposed = np.swapaxes(np.linalg.cholesky(information), 1, 2)
    none = np.zeros(0, dtype=np.int64)
    sightings = engine.LandmarkPairs(node, z, np.zeros(K), sensor.offset, not world, none, none, np.zeros((0, 3, 3)))

    def weighted(x: Array) -> tuple[Array, ...]:
        y, lever, c, s = sightings.placed(x)
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
