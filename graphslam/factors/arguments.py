"""Checks of what factors are made from, each with a message that names the argument."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, inf, sin
from typing import Any

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from ..errors import OptionError, checks, quoted
from ..linear.precision import SMALLEST, check_size, small_inverse
from ..models import FRAMES, SensorModel
from ..se2 import Array

PoseLike = ArrayLike | gtsam.Pose2


def sighting(name: str, value: ArrayLike) -> Array:
    """A sighting (l, phi) or (l, phi, psi).

    Raises:
        OptionError: the value is no sighting, or its range is not above zero.
        GraphError: the range is outside of what double precision can hold.
    """
    z = checks.finite_numbers(name, value, (2,), (3,))
    length, *angles = z.tolist()
    if length <= 0:
        raise OptionError(f"the range of {name} must be above zero, not {length:g} m")
    check_size(f"the range of {name}", length, least=SMALLEST)
    checks.check_sighted(name, angles)
    return z


def noise_sighting(value: ArrayLike | None, z: Array) -> Array:
    """The sighting at which the noise is evaluated: ``noise_at``, or the measured one.

    Raises:
        OptionError: it is no sighting, or has psi where the measured one has none.
    """
    if value is None:
        return z
    other = sighting("noise_at", value)
    if len(other) != len(z):
        raise OptionError(f"noise_at must be a sighting of {len(z)} numbers, as the measured one is")
    return other


def sighted_covariance(theta: float, z: Sequence[float], sensor: SensorModel) -> Array:
    """R Q R' (n, n) of one sighting, from a pose of heading theta: `SensorModel.landmark_covariance`, written out.

    With a = (l range_rate)² + range_std², b = bearing_std², d = orientation_std² and c, s of theta + phi it is
    [[c² a + l² s² b, c s (a - l² b), -l s b], [., s² a + l² c² b, l c b], [., ., b + d]]. For one sighting the arrays of the
    sensor model take twenty times as long.
    """
    length, direction = z[0], theta + z[1]
    c, s, b = cos(direction), sin(direction), sensor.bearing_std * sensor.bearing_std
    rate = length * sensor.range_rate
    a, across = rate * rate + sensor.range_std * sensor.range_std, length * length * b
    xx, xy, yy = c * c * a + s * s * across, c * s * (a - across), s * s * a + c * c * across
    if len(z) == 2:
        return np.array([[xx, xy], [xy, yy]])
    x, y, turn = -length * s * b, length * c * b, b + sensor.orientation_std * sensor.orientation_std
    return np.array([[xx, xy, x], [xy, yy, y], [x, y, turn]])


def frozen_at(at: Any, needed: bool, rows: int | None = None, *, frame: str = "world") -> Array | None:
    """The pose (3,), or poses (rows, 3), at which state-dependent information is evaluated; None if it is constant.

    In the body frame it depends on the poses only where the sightings have no psi.

    Raises:
        OptionError: the poses are needed and missing, or have another shape.
    """
    if not needed:
        return None
    if at is None:
        poses, given = ("the pose", "at=pose") if rows is None else ("the poses", "at=poses")
        if frame == "body":
            others = f"pass {given}, or use landmark nodes or weight='marginal', whose information is constant"
            raise OptionError(f"without psi the information depends on {poses}, in frame='body', too: {others}")
        message = f"the information depends on {poses}: pass {given}, or take frame='body' where that is constant"
        raise OptionError(message)
    frozen = checks.finite_numbers("at", at, (3,) if rows is None else (rows, 3))
    checks.check_heading("at", frozen[..., 2])
    return frozen


def in_world_frame(frame: str) -> bool:
    """Whether a residual stays in the axes of the world.

    Raises:
        OptionError: there is no such frame.
    """
    checks.check_choice("frame", frame, FRAMES)
    return frame == "world"


def positive_definite(information: ArrayLike | gtsam.noiseModel.Gaussian, size: int | None = 3) -> Array:
    """A symmetric positive definite matrix (size, size), or of any size; a noise model of GTSAM gives its information.

    Raises:
        OptionError: the matrix is something else.
    """
    given, shape = information, f"{size or 'd'} x {size or 'd'}"
    if isinstance(information, gtsam.noiseModel.Gaussian):
        information = information.information()
    try:
        omega = np.asarray(information, dtype=float)
        rows = omega.tolist()
        size = len(rows) if size is None else size
        # most are exactly symmetric, which is soon known
        possible = size > 0 and omega.shape == (size, size) and (rows == [*map(list, zip(*rows))] or _symmetric(rows))
        if possible and size <= 3:
            possible = small_inverse(rows, 0.0) is not None
        elif possible:
            np.linalg.cholesky(omega)
    except Exception:  # objects that NumPy asks for numbers may raise anything
        possible = False
    if not possible:
        wanted = f"a symmetric positive definite {shape} matrix, or a Gaussian noise model of GTSAM of this size"
        raise OptionError(f"information must be {wanted}, not {quoted(given)}")
    return (omega + omega.T) / 2


def _symmetric(rows: list[list[float]]) -> bool:
    """Whether a matrix is symmetric, to rounding errors, and finite."""
    largest = max((abs(entry) for row in rows for entry in row), default=0.0)
    return all(abs(rows[i][j] - rows[j][i]) <= 1e-9 * largest < inf for i in range(len(rows)) for j in range(i + 1))


def in_robot_frame(z: Array, sensor: SensorModel) -> tuple[float, float]:
    """The position of a sighted landmark in the frame of the robot: o + l (cos phi, sin phi)."""
    ahead, left = sensor.offset
    return ahead + z[0] * cos(z[1]), left + z[0] * sin(z[1])
