"""The thin layer between GTSAM's callback and our residuals: what makes a factor safe.

GTSAM reads the Jacobians of a Python factor without looking (one left unset, or too small, ends the process), keeps a
factor whose callback refers back to it for ever, and perturbs a pose on its right, in the pose's own axes. Here every
Jacobian is filled with its full shape, callbacks close over numbers and never over a factor, derivatives by world
coordinates are turned into the pose's axes, and every mistake becomes a `FactorError` with the factor and its keys.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import cos, floor, isfinite, pi, sin
from operator import index
from typing import Any

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from ..edges.robust import Cauchy, GemanMcClure, Huber, Kernel, kernel_of
from ..errors import FactorError, OptionError
from ..models import SensorModel
from ..se2 import Array
from .description import FactorDescription, key_name

#: what may stand at a key: a `gtsam.Pose2`, given to residuals as (x, y, theta), or a `gtsam.Point2`, as (x, y)
POSE, POINT = "pose", "point"
KINDS = {POSE: (3, "gtsam.Pose2"), POINT: (2, "gtsam.Point2")}

Coordinates = Sequence[float] | Array
#: e, and per key the rows of de/dx by the coordinates of its value
Residual = Callable[..., tuple[ArrayLike, Sequence[ArrayLike]]]


class Factor(gtsam.CustomFactor):
    """What all factor types have in common: they are safe, and can be described, saved, pickled and copied."""

    def __init__(
        self,
        keys: Sequence[int],
        kinds: Sequence[str],
        noise: gtsam.noiseModel.Base,
        residual: Residual,
        arguments: Mapping[str, Any],
        kernel: Kernel | str | None = None,
        in_own_axes: bool = False,
        error: Callable[..., ArrayLike] | None = None,
    ) -> None:
        """See `guarded`; ``arguments`` are those that the factor type can be made anew from."""
        keys = checked_keys(type(self).__name__, keys)
        arguments = dict(arguments) | ({"kernel": kernel_of(kernel)} if kernel is not None else {})
        for value in arguments.values():
            if isinstance(value, np.ndarray):
                # a factor does not change because somebody goes on working with an array
                value.flags.writeable = False
        description = FactorDescription(type(self).__name__, tuple(keys), arguments)
        callback = guarded(description, kinds, noise.dim(), residual, in_own_axes, error)
        super().__init__(robust_noise(noise, kernel), keys, callback)

    @property
    def description(self) -> FactorDescription:
        """What the factor was made from; see `describe`."""
        from .description import describe

        return describe(self)

    def __reduce__(self) -> tuple[Any, ...]:
        return FactorDescription.build, (self.description,)

    def __deepcopy__(self, memo: dict[int, Any]) -> Any:
        return self.description.build()


def guarded(
    description: FactorDescription,
    kinds: Sequence[str],
    rows: int,
    residual: Residual,
    in_own_axes: bool = False,
    error: Callable[..., ArrayLike] | None = None,
) -> Callable[..., Array]:
    """The callback for a `gtsam.CustomFactor` around a residual.

    Args:
        description: who the factor is, for messages.
        kinds: "pose" or "point" for each key.
        rows: the length of e.
        residual: called with one (x, y, theta) or (x, y) per key; returns e and one Jacobian (rows, 3 or 2) per key.
        in_own_axes: the Jacobians are already by GTSAM's perturbations, poses' in their own axes.
        error: a faster way to an e of the same norm, where no Jacobians are asked for.
    """
    keys, sizes = description.keys, [KINDS[kind][0] for kind in kinds]
    ends = [(key, kind == POSE) for key, kind in zip(keys, kinds)]
    expected, shapes = (rows,), [(rows, size) for size in sizes]

    def callback(_this: gtsam.CustomFactor, values: gtsam.Values, jacobians: Any) -> Array:
        at: list[Coordinates] = []
        try:
            for key, is_pose in ends:
                if is_pose:
                    pose = values.atPose2(key)
                    at.append((pose.x(), pose.y(), pose.theta()))
                else:
                    at.append(values.atPoint2(key))
        except (RuntimeError, TypeError) as problem:
            raise FactorError(_unreadable(values, keys, kinds), description) from problem
        try:
            if jacobians is None and error is not None:
                e = np.array(error(*at), dtype=float)
            else:
                raw, by_value = residual(*at)
                e = np.array(raw, dtype=float)
        except FactorError as problem:
            raise FactorError(str(problem), description) from None
        except Exception as problem:
            told = f"its residual raised {type(problem).__name__}: {problem}"
            raise FactorError(told, description) from problem
        if e.shape != expected:
            raise FactorError(f"its residual must have shape ({rows},), not {e.shape}", description)
        if not isfinite(e.dot(e)):
            raise FactorError(f"its residual is not finite at {_shown(at)}: {e}", description)
        if jacobians is not None:
            if not hasattr(by_value, "__len__") or len(by_value) != len(keys):
                told = f"it needs {len(keys)} Jacobians, one per key, not {by_value!r}"
                raise FactorError(told, description)
            for k, (value, (_, is_pose), shape) in enumerate(zip(at, ends, shapes)):
                try:
                    raw = by_value[k]
                except Exception as problem:
                    told = f"its residual raised {type(problem).__name__} for Jacobian {k}: {problem}"
                    raise FactorError(told, description) from problem
                try:
                    if np.iscomplexobj(raw):
                        raise TypeError("it is complex")
                    own = turned(raw, value[2]) if is_pose and not in_own_axes else raw
                    jacobian = np.asarray(own, dtype=float, order="F")
                except (TypeError, ValueError, IndexError) as problem:
                    raise FactorError(f"Jacobian {k} is no matrix of numbers: {problem}", description) from problem
                if jacobian.shape != shape:
                    told = f"Jacobian {k} must have shape {shape}, not {jacobian.shape}"
                    raise FactorError(told, description)
                if not isfinite(jacobian.sum()):
                    raise FactorError(f"its Jacobian {k} is not finite at {_shown(at)}", description)
                jacobians[k] = jacobian
        return e

    return callback


def turned(by_world: Any, theta: float) -> Any:
    """A Jacobian (d, 3) by (x, y, theta) in world axes, by a perturbation in the pose's own: times blkdiag(R(theta), 1)."""
    c, s = cos(theta), sin(theta)
    if isinstance(by_world, list):
        # three numbers each: faster than NumPy
        return [[a * c + b * s, b * c - a * s, turn] for a, b, turn in by_world]
    own = np.array(by_world, dtype=float, order="F")
    if own.ndim == 2 and own.shape[1] == 3:
        own[:, :2] = own[:, :2] @ np.array([[c, -s], [s, c]])
    return own


def robust_noise(noise: gtsam.noiseModel.Base, kernel: Kernel | str | None) -> gtsam.noiseModel.Base:
    """A noise model with a robust kernel around it, or as it is."""
    kernel = kernel_of(kernel)
    if kernel is None:
        return noise
    estimators = {
        Huber: gtsam.noiseModel.mEstimator.Huber,
        Cauchy: gtsam.noiseModel.mEstimator.Cauchy,
        GemanMcClure: gtsam.noiseModel.mEstimator.GemanMcClure,
    }
    return gtsam.noiseModel.Robust.Create(estimators[type(kernel)](kernel.width), noise)


def checked_keys(name: str, keys: Sequence[Any]) -> list[int]:
    """The keys as integers.

    Raises:
        OptionError: a key is no integer, negative, or given twice.
    """
    checked = []
    for key in keys:
        try:
            number = index(key)
        except TypeError:
            raise OptionError(f"{name}: a key must be an integer such as gtsam.symbol('x', 1), not {key!r}") from None
        if isinstance(key, bool) or not 0 <= number < 2**64:
            raise OptionError(f"{name}: a key must be an integer from 0 to 2^64 - 1, not {key!r}")
        checked.append(number)
    if len(set(checked)) < len(checked):
        raise OptionError(f"{name}: its keys must differ, but are {', '.join(map(key_name, checked))}")
    return checked


def check_keys_listed(name: str, keys: Any) -> None:
    """Raise `OptionError` unless ``keys`` is a sequence."""
    if not hasattr(keys, "__len__") or isinstance(keys, str):
        raise OptionError(f"{name} takes a list of keys, not {keys!r}")


def sensor_of(sensor: Any) -> SensorModel:
    """A sensor model, the book's for None.

    Raises:
        OptionError: it is none.
    """
    if sensor is None:
        return SensorModel()
    if not isinstance(sensor, SensorModel):
        raise OptionError(f"sensor must be a SensorModel, not {sensor!r}")
    return sensor


def positive_definite(information: ArrayLike, size: int = 3, name: str = "information") -> Array:
    """A symmetric positive definite matrix (size, size).

    Raises:
        OptionError: it is not.
    """
    try:
        omega = np.asarray(information, dtype=float)
    except (TypeError, ValueError):
        omega = np.empty(0)
    symmetric = omega.shape == (size, size) and np.allclose(omega, omega.T, rtol=0, atol=1e-9 * np.abs(omega).max())
    if not symmetric or not np.linalg.eigvalsh(omega)[0] > 0:
        raise OptionError(f"{name} must be a symmetric positive definite {size} x {size} matrix")
    return (omega + omega.T) / 2


def sighting(name: str, value: ArrayLike) -> Array:
    """A sighting (l, phi) or (l, phi, psi).

    Raises:
        OptionError: it is none.
    """
    z = vector(name, value, (2, 3))
    if z[0] <= 0:
        raise OptionError(f"the range of {name} must be above zero, not {z[0]:g} m")
    return z


def seen_from_robot(z: Array, sensor: SensorModel) -> tuple[float, float]:
    """Where a sighting puts the landmark in the frame of the robot: o + l (cos phi, sin phi)."""
    ahead, left = sensor.offset
    return ahead + z[0] * cos(z[1]), left + z[0] * sin(z[1])


def vector(name: str, value: ArrayLike, lengths: tuple[int, ...]) -> Array:
    """A vector of one of some lengths.

    Raises:
        OptionError: it is not, or not finite.
    """
    try:
        numbers = np.array(value, dtype=float)
    except (TypeError, ValueError):
        numbers = np.empty((0, 0))
    if numbers.ndim != 1 or len(numbers) not in lengths or not np.all(np.isfinite(numbers)):
        raise OptionError(f"{name} must be {' or '.join(map(str, lengths))} finite numbers, not {value!r}")
    return numbers


def wrapped(angle: float) -> float:
    """The same angle in [-pi, pi), for scalars."""
    return angle - 2 * pi * floor((angle + pi) / (2 * pi))


def _unreadable(values: gtsam.Values, keys: Sequence[int], kinds: Sequence[str]) -> str:
    """What is wrong with the values at the keys."""
    for key, kind in zip(keys, kinds):
        name, wanted = key_name(key), KINDS[kind][1]
        if not values.exists(key):
            return f"the values have nothing at its key {name}; insert a {wanted} there"
        try:
            values.atPose2(key) if kind == POSE else values.atPoint2(key)
        except (RuntimeError, TypeError):
            return f"the value at its key {name} is no {wanted}"
    return "its values cannot be read"


def _shown(at: Sequence[Coordinates]) -> str:
    return " and ".join("(" + ", ".join(f"{part:g}" for part in value) + ")" for value in at)
