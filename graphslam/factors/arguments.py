"""Checks of what factors are made from, each with a message that names the argument."""

from __future__ import annotations

from math import cos, sin
from typing import Any

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from ..checks import check_choice, check_type
from ..errors import OptionError, quoted
from ..models import MotionModel, SensorModel
from ..precision import SMALLEST, check_model, check_size
from ..se2 import Array

FRAMES = ("world", "body")

PoseLike = ArrayLike | gtsam.Pose2


def numbers(name: str, value: Any, lengths: tuple[int, ...], rows: int | None = None) -> Array:
    """A new array of finite numbers from an argument.

    Args:
        name: of the argument, for messages.
        value: numbers, or objects with the methods ``x()``, ``y()`` and perhaps ``theta()``, such as `gtsam.Pose2`.
        lengths: the allowed lengths of a vector, or of the rows of a matrix.
        rows: the number of rows of a matrix, whose only row may be given as a vector; None for a vector.

    Raises:
        OptionError: the value has another shape, or is not finite.
    """
    try:
        array = np.array(_coordinates(value), dtype=float)
    except Exception:  # objects that NumPy asks for numbers may raise anything
        array = np.empty(0)
    if rows == 1 and array.ndim == 1:
        array = array[None]
    leading = () if rows is None else (rows,)
    fits = array.ndim == len(leading) + 1 and array.shape[:-1] == leading and array.shape[-1] in lengths
    if not fits or not np.isfinite(array).all():
        count = f"{' or '.join(map(str, lengths))} finite numbers"
        raise OptionError(f"{name} must be {count if rows is None else f'{rows} rows of {count}'}, not {quoted(value)}")
    return array


def _coordinates(value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return [_coordinates(part) for part in value]
    if hasattr(value, "x") and hasattr(value, "y"):
        return [getattr(value, part)() for part in ("x", "y", "theta") if hasattr(value, part)]
    return value


def sighting(name: str, value: ArrayLike) -> Array:
    """A sighting (l, phi) or (l, phi, psi).

    Raises:
        OptionError: the value is no sighting, or its range is not above zero.
        GraphError: the range is outside of what double precision can hold.
    """
    z = numbers(name, value, (2, 3))
    if z[0] <= 0:
        raise OptionError(f"the range of {name} must be above zero, not {z[0]:g} m")
    check_size(f"the range of {name}", z[0], least=SMALLEST)
    return z


def sensor_of(sensor: Any) -> SensorModel:
    """The sensor model given, or the book's for None.

    Raises:
        OptionError: the argument is neither.
        GraphError: its numbers are outside of what double precision can hold.
    """
    check_type(SensorModel, sensor=sensor)
    sensor = sensor or SensorModel()
    check_model(sensor)
    return sensor


def motion_of(motion: Any) -> MotionModel:
    """The motion model given, or the book's for None.

    Raises:
        OptionError: the argument is neither.
        GraphError: its numbers are outside of what double precision can hold.
    """
    check_type(MotionModel, motion=motion)
    motion = motion or MotionModel()
    check_model(motion)
    return motion


def frozen_at(at: Any, needed: bool, rows: int | None = None) -> Array | None:
    """The pose (3,), or poses (rows, 3), at which state-dependent information is evaluated; None if it is constant.

    Raises:
        OptionError: the poses are needed and missing, or have another shape.
    """
    if not needed:
        return None
    if at is None:
        poses = "the pose; give it" if rows is None else "the poses; give them"
        raise OptionError(f"the information depends on {poses} as 'at', or take frame='body' where that is constant")
    return numbers("at", at, (3,), rows)


def in_world_frame(frame: str) -> bool:
    """Whether a residual stays in the axes of the world.

    Raises:
        OptionError: there is no such frame.
    """
    check_choice("frame", frame, FRAMES)
    return frame == "world"


def positive_definite(information: ArrayLike, size: int = 3, name: str = "information") -> Array:
    """A symmetric positive definite matrix (size, size).

    Raises:
        OptionError: the matrix is something else.
    """
    try:
        omega = np.asarray(information, dtype=float)
    except Exception:  # as above
        omega = np.empty(0)
    symmetric = (
        omega.shape == (size, size)
        and size > 0
        and np.allclose(omega, omega.T, rtol=0, atol=1e-9 * np.abs(omega).max())
    )
    if not symmetric or not np.linalg.eigvalsh(omega)[0] > 0:
        raise OptionError(f"{name} must be a symmetric positive definite {size or 'd'} x {size or 'd'} matrix")
    return (omega + omega.T) / 2


def in_robot_frame(z: Array, sensor: SensorModel) -> tuple[float, float]:
    """The position of a sighted landmark in the frame of the robot: o + l (cos phi, sin phi)."""
    ahead, left = sensor.offset
    return ahead + z[0] * cos(z[1]), left + z[0] * sin(z[1])
