"""Planar poses as plain arrays: x = (x, y, theta) in [m, m, rad], any leading shape, angles in [-pi, pi).

SE(2) is the group of rigid motions of the plane; ``compose(a, b)`` is "first a, then b seen from a", the same
convention as ``gtsam.Pose2.compose``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: float64 arrays; the name says what they are, the docstrings their shapes
Array = NDArray[Any]


def stacked(*components: Any) -> Array:
    """Arrays or numbers (...) of floats as the components of vectors, (..., n); the first one has the shape of all.

    As `np.stack`, in a third of the time for the some hundred poses of a usual drive.
    """
    vectors = np.empty((*np.shape(components[0]), len(components)))
    for k, component in enumerate(components):
        vectors[..., k] = component
    return vectors


def wrap(angle: ArrayLike) -> Array:
    """The same angle in [-pi, pi) [rad], element by element; angles in that range are returned unchanged."""
    angle = np.asarray(angle, dtype=float)
    within = (angle >= -np.pi) & (angle < np.pi)
    if within.all():
        return angle.copy()
    wrapped = np.mod(angle + np.pi, 2 * np.pi) - np.pi
    # np.mod may round a tiny negative number up to the full 2 pi
    wrapped = np.where(wrapped >= np.pi, -np.pi, wrapped)
    return np.where(within, angle, wrapped)


def sinc(a: ArrayLike) -> Array:
    """sin(a) / a, equal to 1 at a = 0."""
    return np.sinc(np.asarray(a, dtype=float) / np.pi)


def sinc_derivative(a: ArrayLike) -> Array:
    """d/da (sin(a) / a) = (cos(a) - sin(a)/a) / a, by its Taylor series where that difference would cancel."""
    a = np.asarray(a, dtype=float)
    near = np.abs(a) < 0.3
    if near.all():
        return np.asarray(sinc_slope_near_zero(a))
    away = np.where(near, 1.0, a)
    return np.where(near, sinc_slope_near_zero(a), (np.cos(away) - np.sin(away) / away) / away)


def sinc_slope_near_zero(a: Any) -> Any:
    """The sum over k of (-1)^k 2k / (2k+1)! a^(2k-1), an array or a number: six terms are exact to rounding for |a| < 0.3."""
    q = a * a
    return a * (-1 / 3 + q * (1 / 30 + q * (-1 / 840 + q * (1 / 45360 + q * (-1 / 3991680 + q / 518918400)))))


def rotation(theta: ArrayLike) -> Array:
    """The rotation matrix [[c, -s], [s, c]] of each angle; shape (...) -> (..., 2, 2)."""
    c, s = np.cos(theta), np.sin(theta)
    return stacked(c, -s, s, c).reshape(*np.shape(c), 2, 2)


def turn_matrix(theta: ArrayLike) -> Array:
    """blkdiag(R(theta), 1), which turns a vector (x, y, heading) by an angle; shape (...) -> (..., 3, 3)."""
    matrix = np.zeros((*np.shape(theta), 3, 3))
    matrix[..., :2, :2], matrix[..., 2, 2] = rotation(theta), 1.0
    return matrix


def turned_by(matrix: ArrayLike, theta: ArrayLike) -> Array:
    """Covariances or information (..., 3, 3) in the axes of poses with headings (...), in the axes of the poses' parent."""
    turn = turn_matrix(theta)
    return turn @ matrix @ np.swapaxes(turn, -1, -2)


def lever_matrix(lever: ArrayLike) -> Array:
    """[I, t; 0, 1], by which a pose moves what it sees: by t (..., 2) for each radian that it turns; (..., 3, 3)."""
    matrix = np.zeros((*np.shape(lever)[:-1], 3, 3))
    matrix[..., [0, 1, 2], [0, 1, 2]], matrix[..., :2, 2] = 1.0, lever
    return matrix


def perpendicular(vector: ArrayLike) -> Array:
    """The vector (-y, x): a quarter turn to the left, the derivative of R(theta) v by theta; shapes (..., 2)."""
    vector = np.asarray(vector, dtype=float)
    return stacked(-vector[..., 1], vector[..., 0])


def transform(pose: ArrayLike, point: ArrayLike) -> Array:
    """A point given in the frame of a pose, in the frame the pose is given in: p + R(theta) q; (..., 3), (..., 2)."""
    pose, point = np.asarray(pose, dtype=float), np.asarray(point, dtype=float)
    c, s = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    x, y = point[..., 0], point[..., 1]
    return stacked(pose[..., 0] + c * x - s * y, pose[..., 1] + s * x + c * y)


def mounted(pose: ArrayLike, offset: tuple[float, float]) -> Array:
    """The pose of what is mounted at o = (ahead, left) [m] of a pose, (p + R(theta) o, theta); (..., 3)."""
    pose = np.asarray(pose, dtype=float)
    return pose if offset == (0.0, 0.0) else np.concatenate([transform(pose, offset), pose[..., 2:]], axis=-1)


def compose(a: ArrayLike, b: ArrayLike) -> Array:
    """The product a b: the pose b given in the frame of a, in the frame of a's parent; shapes (..., 3)."""
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    position = transform(a, b[..., :2])
    return stacked(position[..., 0], position[..., 1], wrap(a[..., 2] + b[..., 2]))


def inverse(a: ArrayLike) -> Array:
    """The pose a^-1 with compose(a, a^-1) = 0; shape (..., 3)."""
    a = np.asarray(a, dtype=float)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    x, y = a[..., 0], a[..., 1]
    return stacked(-c * x - s * y, s * x - c * y, wrap(-a[..., 2]))


def between(a: ArrayLike, b: ArrayLike) -> Array:
    """The relative pose a^-1 b: where b is, seen from a; shapes (..., 3)."""
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    d = b - a
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    return stacked(c * d[..., 0] + s * d[..., 1], -s * d[..., 0] + c * d[..., 1], wrap(d[..., 2]))


def in_frame(frame: ArrayLike, poses: Array) -> Array:
    """Poses (n, 3) given in a frame (3,), in the frame's parent, as `compose`; headings keep their full turns."""
    moved, frame = compose(frame, poses), np.asarray(frame)
    moved[:, 2] = poses[:, 2] + frame[2]
    return moved


def begun_at(first: Array, poses: Array) -> Array:
    """Poses (n, 3) moved as a whole so that the first one is ``first`` (3,); headings keep their full turns."""
    moved = compose(first, between(poses[0], poses))
    moved[:, 2] = first[2] + poses[:, 2] - poses[0, 2]
    return moved


def chained(start: ArrayLike, motions: Array) -> Array:
    """The poses (T+1, 3) that motions (T, 3) lead to, one after the other, each in the axes of the pose before it.

    Headings are not wrapped.
    """
    poses = np.empty((len(motions) + 1, 3))
    poses[0] = start
    poses[1:, 2] = poses[0, 2] + np.cumsum(motions[:, 2])
    moved = np.einsum("tij,tj->ti", rotation(poses[:-1, 2]), motions[:, :2])
    poses[1:, :2] = poses[0, :2] + np.cumsum(moved, axis=0)
    return poses


def joined_motions(motions: Array, steps: np.ndarray) -> tuple[Array, Array]:
    """The motions (n, 3) between steps, from the first to the last, and L (T, 3, 3) of each motion (T, 3) that they join."""
    first, count = steps[:-1], np.diff(steps)

    def before(values: Array) -> Array:
        """The sum of the earlier values of the same joined motion."""
        total = np.cumsum(values, axis=0) - values
        return total - np.repeat(total[first], count, axis=0)

    levers = turn_matrix(before(motions[:, 2]))
    ways = np.einsum("eij,ej->ei", levers[:, :2, :2], motions[:, :2])
    total = np.column_stack([np.add.reduceat(ways, first), np.add.reduceat(motions[:, 2], first)])
    levers[:, :2, 2] = perpendicular(np.repeat(total[:, :2], count, axis=0) - before(ways) - ways)
    return total, levers


def difference(a: ArrayLike, b: ArrayLike) -> Array:
    """a - b of poses (..., 3), the headings wrapped, or of points (..., 2)."""
    apart = np.asarray(a, dtype=float) - b
    if apart.shape[-1] == 3:
        apart[..., 2] = wrap(apart[..., 2])
    return apart


def interpolate(a: ArrayLike, b: ArrayLike, share: ArrayLike) -> Array:
    """The pose a exp(share log(a^-1 b)): on the arc that leads from a to b with one twist; (..., 3), (..., 3), (...).

    The shorter way round is taken. a at share 0, b at share 1; the heading is not wrapped but follows a's.

    Source: Lynch and Park, *Modern Robotics*, section 3.3 (screw motions), in the plane.
    """
    a, share = np.asarray(a, dtype=float), np.asarray(share, dtype=float)
    d = between(a, b)
    whole = d[..., 2]
    part = share * whole
    # a chord looks along half the turn, and is sin(turn/2) / (turn/2) as long as its arc
    longer = share * np.sinc(part / (2 * np.pi)) / np.sinc(whole / (2 * np.pi))
    back = (part - whole) / 2
    c, s = np.cos(back), np.sin(back)
    x, y = longer * (c * d[..., 0] - s * d[..., 1]), longer * (s * d[..., 0] + c * d[..., 1])
    position = transform(a, stacked(x, y))
    return stacked(position[..., 0], position[..., 1], a[..., 2] + part)
