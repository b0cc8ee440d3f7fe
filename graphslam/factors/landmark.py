"""All sightings of one landmark in one factor: one callback where there were K (K-1) / 2."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from ..checks import check_choice
from ..edges.robust import Kernel
from ..errors import OptionError
from ..models import SensorModel
from ..se2 import Array, rotation, wrap
from .landmark_kernels import compressed, pair_cost, pair_sums, placed
from .layer import POSE, Coordinates, Factor, check_keys_listed, sensor_of

WEIGHTS = ("pairs", "tempered", "marginal")


class LandmarkFactor(Factor):
    """All edges that the sightings of one landmark make between the poses that saw it, as one factor.

    ``weight="pairs"`` and ``"tempered"`` have exactly the cost of a `VirtualMotionFactor` for every pair of sightings
    from different poses. The stacked residual b, of K (K-1) / 2 pairs, is compressed: with A'A = R'R, R the triangle of
    QR, its part in the range of A is d = R^-T A'b, and the factor's error is (d, sqrt(b'b - d'd)): 3 K + 1 rows with the
    same cost, gradient and Gauss-Newton matrix. (R comes from a pivoted Cholesky factorisation of A'A, which has the
    size of the poses and not of the pairs.) Only its norm and its linearisation mean something, not its single rows.

    ``weight="marginal"`` is the landmark eliminated: e_a = m̂ - y_a for each sighting, m̂ the weighted mean of the
    y_a = h^-1(x_a, z_a) that makes the cost least; see `edges.marginal`. Each sighting counts once.

    Args:
        keys: (K,) of `gtsam.Pose2`, the pose of each sighting; one may come twice.
        sightings: (K, 3) with psi or (K, 2) without.
        sensor: gives Q; default: the book's.
        frame: "body" or "world", as for `VirtualMotionFactor`.
        weight: "pairs", "tempered" (every pair times 2/K) or "marginal".
        at: (K, 3) the poses at which state-dependent information is evaluated: ``frame="world"``, or no psi with pairs.
        trust: (K,) a factor above 0 on the information of each sighting; of a pair's, the product.
        of: (K,) which of the keys each sighting belongs to, where there are fewer keys than sightings.
        kernel: a robust kernel around the landmark as a whole. (For one on every pair or sighting take
            `VirtualMotionFactor`, `InverseObservationFactor` or `ObservationFactor`.)

    Raises:
        OptionError: a value is not what it must be, or ``at`` is missing where the information depends on the poses.
    """

    def __init__(
        self,
        keys: Sequence[int],
        sightings: ArrayLike,
        sensor: SensorModel | None = None,
        frame: str = "body",
        weight: str = "pairs",
        *,
        at: ArrayLike | None = None,
        trust: ArrayLike | None = None,
        of: ArrayLike | None = None,
        kernel: Kernel | str | None = None,
    ) -> None:
        check_choice("frame", frame, ("world", "body"))
        check_choice("weight", weight, WEIGHTS)
        check_keys_listed("LandmarkFactor", keys)
        sensor = sensor_of(sensor)
        node = np.arange(len(keys)) if of is None else np.array(of)
        if node.ndim != 1 or node.dtype.kind not in "iu" or not np.array_equal(np.unique(node), np.arange(len(keys))):
            raise OptionError(
                f"of must name each of the {len(keys)} keys, from 0 to {len(keys) - 1}, for every sighting"
            )
        if of is None:
            place = {key: k for k, key in enumerate(dict.fromkeys(keys))}
            keys, node = list(place), np.array([place[key] for key in keys], dtype=int)
        z = _matrix("sightings", sightings, (len(node), (2, 3)))
        if len(z) == 0 or np.any(z[:, 0] <= 0):
            raise OptionError("LandmarkFactor needs at least one sighting, and ranges above zero")
        faith = np.ones(len(z)) if trust is None else np.array(trust, dtype=float)
        if faith.shape != (len(z),) or not np.all((faith > 0) & np.isfinite(faith)):
            raise OptionError(f"trust must be {len(z)} positive numbers, one per sighting")
        frozen = frame == "world" or (weight != "marginal" and z.shape[1] == 2)
        if frozen and at is None:
            raise OptionError("the information depends on the poses here; give them as 'at', one per sighting")
        reference = _matrix("at", at, (len(z), (3,))) if frozen else None
        arguments = {
            "sightings": z, "sensor": sensor, "frame": frame, "weight": weight, "at": reference,
            "trust": None if trust is None else faith,
            "of": None if len(keys) == len(z) else node,
        }  # fmt: skip
        make = _marginal if weight == "marginal" else _pairs
        rows, residual, error = make(z, node, sensor, frame, faith, reference, weight == "tempered")
        super().__init__(
            keys, [POSE] * len(keys), gtsam.noiseModel.Unit.Create(rows), residual, arguments, kernel,
            in_own_axes=True, error=error,
        )  # fmt: skip


def _pairs(
    z: Array, node: np.ndarray, sensor: SensorModel, frame: str, trust: Array, reference: Array | None, tempered: bool
) -> tuple[int, Callable[..., Any], Callable[..., Any]]:
    """The number of rows, the residual and the error alone, of all pairs of sightings from different poses."""
    poses = int(node.max()) + 1
    a, b = np.triu_indices(len(z), k=1)
    a, b = a[node[a] != node[b]], b[node[a] != node[b]]
    if reference is not None:
        covariance = sensor.landmark_covariance(reference, z)
        covariance = covariance[a] + covariance[b]
    else:
        # axes along the first sighting: it looks along x, the second along psi_2 - psi_1
        along_x, other = np.zeros((2, len(a), 3))
        along_x[:, 2] = -z[a, 1]
        other[:, 2] = z[b, 2] - z[a, 2] - z[b, 1]
        covariance = sensor.landmark_covariance(along_x, z[a]) + sensor.landmark_covariance(other, z[b])
    factor = trust[a] * trust[b] * (2 / trust.sum() if tempered else 1.0)
    # without psi the third row and column stay zero
    information = np.zeros((len(a), 3, 3))
    information[:, : z.shape[1], : z.shape[1]] = np.linalg.inv(covariance) * factor[:, None, None]
    # the angle of a pair's axes is theta_a plus this
    ahead = z[:, 1] if reference is None else -reference[:, 2]

    turning = frame == "body"

    def error(*at: Coordinates) -> Array:
        x = np.array(at)
        y, _, c, s = placed(x, node, z, sensor.offset, ahead, turning)
        only_norm = np.zeros(3 * poses + 1)
        only_norm[-1] = np.sqrt(pair_cost(a, b, y, c, s, information))
        return only_norm

    def residual(*at: Coordinates) -> tuple[Array, list[Array]]:
        x = np.array(at)
        e, R = compressed(
            *pair_sums(a, b, node, x, *placed(x, node, z, sensor.offset, ahead, turning), information, turning)
        )
        return e, [R[:, k : k + 3] for k in range(0, 3 * poses, 3)]

    return 3 * poses + 1, residual, error


def _marginal(
    z: Array, node: np.ndarray, sensor: SensorModel, frame: str, trust: Array, reference: Array | None, _: bool
) -> tuple[int, Callable[..., Any], Callable[..., Any]]:
    """The number of rows, the residual and the error alone, of the landmark eliminated."""
    (K, d), poses = z.shape, int(node.max()) + 1
    looking = np.zeros((K, 3))
    looking[:, 2] = -z[:, 1]
    information = np.linalg.inv(sensor.landmark_covariance(looking if reference is None else reference, z))
    information *= trust[:, None, None]
    # W = L L', in the axes of the sighting, or the world's
    L_transposed = np.swapaxes(np.linalg.cholesky(information), 1, 2)

    def placed(x: Array) -> tuple[Array, ...]:
        y, lever = _seen_from(x[node], z, sensor)
        axes = np.zeros((K, d, d))
        axes[:] = np.eye(d)
        if frame == "body":
            axes[:, :2, :2] = rotation(x[node, 2] + z[:, 1])
        whiten = L_transposed @ np.swapaxes(axes, 1, 2)
        W = np.swapaxes(whiten, 1, 2) @ whiten
        S_inverse = np.linalg.inv(W.sum(axis=0))
        e = _around_mean(y, W, S_inverse)
        return e, lever, whiten, W, S_inverse

    def error(*at: Coordinates) -> Array:
        e, _, whiten, _, _ = placed(np.array(at))
        return np.einsum("kij,kj->ki", whiten, e).ravel()

    def residual(*at: Coordinates) -> tuple[Array, list[Array]]:
        x = np.array(at)
        e, lever, whiten, W, S_inverse = placed(x)
        moved = np.zeros((K, d, 3))  # dy/dx
        moved[:] = np.eye(3)[:d]
        moved[:, :2, 2] = lever
        mean_moved = W @ moved  # S dm̂/dx
        own_moved = -whiten @ moved
        if frame == "body":
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
    """e = m̂ - y (K, d); each heading's turn is decided by m̂ itself, sought from their circular mean."""
    middle = y[0].copy()
    if y.shape[1] == 3:
        apart = y[:, 2] - y[0, 2]
        middle[2] += np.arctan2(W[:, 2, 2] @ np.sin(apart), W[:, 2, 2] @ np.cos(apart))
    for _ in range(100):
        # as differences from the middle: no cancellation, no seam
        offset = y - middle
        offset[:, 2:] = wrap(offset[:, 2:])
        moved = S_inverse @ np.einsum("kij,kj->i", W, offset)
        e = moved - offset
        if np.all(np.abs(e[:, 2:]) <= np.pi):
            break
        middle = middle + moved
    return e


def _seen_from(x: Array, z: Array, sensor: SensorModel) -> tuple[Array, Array]:
    """y = h^-1(x, z) (K, d), its heading not wrapped, and what turning the pose does to its position (K, 2)."""
    direction = x[:, 2] + z[:, 1]
    towards = z[:, :1] * np.column_stack([np.cos(direction), np.sin(direction)])
    towards += sensor.mount(x)[:, :2] - x[:, :2]
    y = np.empty_like(z)
    y[:, :2] = x[:, :2] + towards
    if z.shape[1] == 3:
        y[:, 2] = direction - z[:, 2]
    return y, np.column_stack([-towards[:, 1], towards[:, 0]])


def _matrix(name: str, value: Any, shape: tuple[int, tuple[int, ...]]) -> Array:
    try:
        matrix = np.array(value, dtype=float)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if (
        matrix.ndim != 2
        or len(matrix) != shape[0]
        or matrix.shape[1] not in shape[1]
        or not np.all(np.isfinite(matrix))
    ):
        columns = " or ".join(map(str, shape[1]))
        raise OptionError(f"{name} must be {shape[0]} rows of {columns} finite numbers, one per key, not {value!r}")
    return matrix
