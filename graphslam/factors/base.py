"""The base class of all factor types, which makes a residual safe for GTSAM; `ResidualFactor`, from a user's function.

GTSAM reads the Jacobians of a Python factor without a check (one left unset, or too small, ends the process), never
frees a factor whose callback refers back to it, and perturbs a pose on its right, in the pose's own axes. Here every
Jacobian gets its full shape, callbacks close over numbers and never over a factor, derivatives by world coordinates are
turned into the pose's axes, and every mistake becomes a `FactorError` that names the factor and its keys.
"""

from __future__ import annotations

import atexit
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from math import cos, floor, isfinite, pi, sin
from operator import index
from threading import Lock
from threading import enumerate as enumerate_threads
from typing import Any

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from ..edges.robust import Cauchy, GemanMcClure, Huber, Kernel, kernel_of
from ..errors import FactorError, OptionError, checks, quoted
from ..se2 import Array
from .arguments import positive_definite
from .description import FACTOR_TYPES, FactorDescription, describe, key_name

#: the value at a key: a `gtsam.Pose2`, given to residuals as (x, y, theta), or a `gtsam.Point2`, given as (x, y)
POSE, POINT, NUMBER = "pose", "point", "number"
KINDS = {POSE: (3, "gtsam.Pose2"), POINT: (2, "gtsam.Point2"), NUMBER: (1, "float")}

KernelLike = Kernel | str | None
Coordinates = Sequence[float] | Array
#: e, and for each key de/dx by the coordinates of its value
Linearized = tuple[ArrayLike, Sequence[ArrayLike]]


#: what a factor has from GTSAM: without `Factor.__init__` there is nothing behind it
_OF_GTSAM = frozenset(dir(gtsam.CustomFactor)) - frozenset(dir(object))

_python_ends = False
_never = Lock()
_never.acquire()


@atexit.register
def _stop_daemon_threads() -> None:
    """Block daemon threads at their next callback. Python would stop them there, inside GTSAM, which ends the process."""
    global _python_ends
    _python_ends = True
    if any(thread.daemon for thread in enumerate_threads()):
        time.sleep(0.1)


class Factor(gtsam.CustomFactor):
    """The base of all factor types: safe to evaluate, and able to be described, saved, pickled and copied.

    Args:
        keys: one for each argument of the residual.
        kinds: "pose", "point" or "number" for each key.
        residual: called with (x, y, theta), (x, y) or (number,) per key; returns e and a Jacobian (rows, 3, 2 or 1) per key.
        arguments: all other arguments of the factor type, by name. ``kernel`` must be among them, a robust kernel around the
            noise model or None (see `graphslam.edges.robust`); ``scale`` may be, a factor on the information.
        covariance, information: (rows, rows), one of the two.
        named_keys: the keys as the factor type takes them; default: ``keys``.
        in_own_axes: the Jacobians are by GTSAM's perturbations already, those of poses in their own axes.
        error: a faster function that returns an e with the same sum of squares, for evaluations without Jacobians.

    Raises:
        OptionError: a key is impossible, the scale is not positive, or there is no such kernel.
    """

    #: whether the constructor takes its keys as one list
    keys_in_list = False

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        FACTOR_TYPES[cls.__name__] = cls

    def __init__(
        self,
        keys: Sequence[int],
        kinds: Sequence[str],
        residual: Callable[..., Linearized],
        arguments: Mapping[str, Any],
        *,
        covariance: Array | None = None,
        information: Array | None = None,
        named_keys: Sequence[int] | None = None,
        in_own_axes: bool = False,
        error: Callable[..., ArrayLike] | None = None,
    ) -> None:
        keys = checked_keys(type(self).__name__, keys)
        given, kernel = covariance if information is None else information, kernel_of(arguments["kernel"])
        assert given is not None
        arguments = {**arguments, "kernel": kernel and kernel.of_dimension(len(given))}
        noise = noise_model(arguments, covariance=covariance, information=information)
        for value in arguments.values():
            if isinstance(value, np.ndarray):
                # a factor must not change when the caller changes the array later
                value.flags.writeable = False
        named = keys if named_keys is None else map(index, named_keys)
        description = FactorDescription(type(self).__name__, tuple(named), arguments)
        super().__init__(noise, keys, _guarded(description, keys, kinds, noise.dim(), residual, in_own_axes, error))
        #: the residual, for factors made of this one; it closes over numbers only
        self.residual, self.kinds, self.in_own_axes = residual, tuple(kinds), in_own_axes
        #: what the factor was made from; `describe` reads it also from a factor that only a graph holds
        self.description = description

    def __getattribute__(self, name: str) -> Any:
        value = super().__getattribute__(name)
        if name in _OF_GTSAM and "description" not in super().__getattribute__("__dict__"):
            made = f"this {type(self).__name__} was made without its constructor"
            raise FactorError(f"{made}, so GTSAM has no factor for it")
        return value

    def __repr__(self, *how: Any) -> str:
        return super().__repr__(*how) if "description" in self.__dict__ else f"<{type(self).__name__} without __init__>"

    def __reduce__(self) -> tuple[Any, ...]:
        return FactorDescription.build, (self.description,)

    def equals(self, f: Any, tol: Any = 1e-9) -> bool:
        """Whether a factor has the same description up to a tolerance; GTSAM's own method compares keys and noise only."""
        try:
            return self.description.equals(describe(f), tol)
        except OptionError:
            return False


def _guarded(
    description: FactorDescription,
    keys: Sequence[int],
    kinds: Sequence[str],
    rows: int,
    residual: Callable[..., Linearized],
    in_own_axes: bool,
    error: Callable[..., ArrayLike] | None,
) -> Callable[..., Array]:
    """The callback of a `gtsam.CustomFactor` around a residual; the arguments are those of `Factor`."""
    ends = list(zip(keys, kinds))
    expected, shapes = (rows,), [(rows, KINDS[kind][0]) for kind in kinds]

    def callback(_this: gtsam.CustomFactor, values: gtsam.Values, jacobians: Any) -> Array:
        if _python_ends:
            _never.acquire()
        try:
            try:
                at = values_at(values, ends)
            except (RuntimeError, TypeError) as problem:
                raise FactorError(_unreadable(values, keys, kinds)) from problem
            if jacobians is None and error is not None:
                e = np.array(error(*at), dtype=float)
            else:
                raw, by_value = residual(*at)
                e = _real(raw)
            if e.shape != expected:
                raise FactorError(f"its residual must have shape ({rows},), not {e.shape}")
            if not isfinite(e.dot(e)):
                raise FactorError(f"its residual is not finite at {_text(at)}: {e}")
            if jacobians is not None:
                if not hasattr(by_value, "__len__") or len(by_value) != len(keys):
                    raise FactorError(f"it needs {len(keys)} Jacobians, one per key, not {quoted(by_value)}")
                for k, (value, kind, shape) in enumerate(zip(at, kinds, shapes)):
                    jacobian = _matrix(k, by_value[k], value[2] if kind == POSE and not in_own_axes else None)
                    if jacobian.shape != shape:
                        raise FactorError(f"Jacobian {k} must have shape {shape}, not {jacobian.shape}")
                    # for few numbers this is faster than NumPy's sum
                    if not isfinite(sum(jacobian.ravel("K").tolist())):
                        raise FactorError(f"its Jacobian {k} is not finite at {_text(at)}")
                    jacobians[k] = jacobian
        except FactorError as problem:
            raise FactorError(str(problem), description) from problem.__cause__
        except KeyboardInterrupt:
            raise
        except BaseException as problem:
            # SystemExit, too: a residual must not end the program from inside GTSAM
            raise FactorError(f"its residual raised {type(problem).__name__}: {problem}", description) from problem
        return e

    return callback


def values_at(values: gtsam.Values, ends: Iterable[tuple[int, str]]) -> list[Coordinates]:
    """The values at keys, each with its kind: (x, y, theta), (x, y), or (number,).

    Raises:
        RuntimeError, TypeError: there is no such value at a key.
    """
    at: list[Coordinates] = []
    for key, kind in ends:
        if kind == POSE:
            pose = values.atPose2(key)
            at.append((pose.x(), pose.y(), pose.theta()))
        else:
            at.append(values.atPoint2(key) if kind == POINT else (values.atDouble(key),))
    return at


def _matrix(k: int, raw: Any, heading: float | None) -> Array:
    """A Jacobian in GTSAM's form; by world coordinates where the pose's heading is given, else in its own axes."""
    try:
        return _real(raw if heading is None else turned(raw, heading))
    except (TypeError, ValueError, IndexError) as problem:
        raise FactorError(f"Jacobian {k} is no matrix of numbers: {problem}") from problem


def _real(raw: Any) -> Array:
    """Real numbers as an array by columns; NumPy would take the real parts of complex ones with a warning only."""
    given = np.asarray(raw)
    if given.dtype.kind == "c":
        raise TypeError("it is complex")
    return np.asarray(given, dtype=float, order="F")


def turned(by_world: Any, theta: float) -> Any:
    """A Jacobian (d, 3) by (x, y, theta) in world axes, by a perturbation in the pose's own: times blkdiag(R(theta), 1)."""
    c, s = cos(theta), sin(theta)
    if isinstance(by_world, list):
        # for rows of three numbers this is faster than NumPy
        return [[a * c + b * s, b * c - a * s, turn] for a, b, turn in by_world]
    own = _real(by_world).copy(order="F")
    if own.ndim == 2 and own.shape[1] == 3:
        own[:, :2] = own[:, :2] @ np.array([[c, -s], [s, c]])
    return own


def noise_model(
    arguments: Mapping[str, Any], *, covariance: Array | None = None, information: Array | None = None
) -> gtsam.noiseModel.Base:
    """The noise model of a covariance or an information matrix, with the scale and the kernel among the arguments.

    Raises:
        OptionError: the scale is not positive, or there is no such kernel.
    """
    scale, kernel = arguments.get("scale", 1.0), kernel_of(arguments["kernel"])
    checks.check_positive(scale=scale)
    if covariance is None:
        noise = gtsam.noiseModel.Gaussian.Information(information * scale)
    else:
        noise = gtsam.noiseModel.Gaussian.Covariance(covariance / scale)
    if kernel is None:
        return noise
    estimators = gtsam.noiseModel.mEstimator
    of_kernel = {Huber: estimators.Huber, Cauchy: estimators.Cauchy, GemanMcClure: estimators.GemanMcClure}
    return gtsam.noiseModel.Robust.Create(of_kernel[type(kernel)](kernel.of_dimension(noise.dim()).width), noise)


def checked_keys(name: str, keys: Sequence[Any]) -> list[int]:
    """The keys as integers.

    Raises:
        OptionError: a key is no integer, negative, or given twice.
    """
    checked = [_checked_key(name, key) for key in keys]
    if len(set(checked)) < len(checked):
        raise OptionError(f"{name}: its keys must differ, but are {', '.join(map(key_name, checked))}")
    return checked


def listed_keys(name: str, keys: Any) -> list[int]:
    """The keys of a factor type that takes a list of them, as integers; one may be given twice.

    Raises:
        OptionError: the argument is no list, or a key is no integer or negative.
    """
    if not isinstance(keys, (Sequence, np.ndarray)) or isinstance(keys, (str, bytes)) or getattr(keys, "ndim", 1) != 1:
        raise OptionError(f"{name} takes a list of keys, not {quoted(keys)}")
    return [_checked_key(name, key) for key in keys]


def kinds_of(keys: Sequence[int], points: int) -> list[str]:
    """The kinds of keys of which the last ones are of ``points`` points, the others of poses.

    Raises:
        OptionError: there cannot be so many points.
    """
    checks.check_count(points=points)
    if points > len(keys):
        raise OptionError(f"points must be at most {len(keys)}, the number of keys, not {quoted(points)}")
    return [POSE] * (len(keys) - points) + [POINT] * points


def _checked_key(name: str, key: Any) -> int:
    try:
        number = -1 if isinstance(key, bool) else index(key)
    except TypeError:
        number = -1
    if not 0 <= number < 2**64:
        raise OptionError(f"{name}: a key must be an integer from 0 to 2^64 - 1 (gtsam.symbol), not {quoted(key)}")
    return number


def wrapped(angle: float) -> float:
    """The same angle in [-pi, pi), for scalars."""
    return angle - 2 * pi * floor((angle + pi) / (2 * pi))


def _unreadable(values: gtsam.Values, keys: Sequence[int], kinds: Sequence[str]) -> str:
    """A sentence on wrong values at the keys."""
    for key, kind in zip(keys, kinds):
        name, wanted = key_name(key), KINDS[kind][1]
        if not values.exists(key):
            return f"the values have nothing at its key {name}; insert a {wanted} there"
        try:
            values_at(values, [(key, kind)])
        except (RuntimeError, TypeError):
            return f"the value at its key {name} is no {wanted}"
    return "its values cannot be read"


def _text(at: Sequence[Coordinates]) -> str:
    return " and ".join("(" + ", ".join(f"{part:g}" for part in value) + ")" for value in at)


#: the step of numeric derivatives [m, rad]
STEP = 1e-6


class ResidualFactor(Factor):
    """Any residual of poses, points and numbers, with cost e' Omega e, evaluated as safely as the other factor types.

    Args:
        keys: one for each argument of the residual.
        residual: called with one array per key, (x, y, theta) of a `gtsam.Pose2`, (x, y) of a `gtsam.Point2`, or (value,)
            of a float, such as a scale. Returns e (d,), or (e, [de/d(x, y, theta) (d, 3), de/d(x, y) (d, 2) or de/dvalue
            (d, 1) for each key]); derivatives are by plain world coordinates, and turned into GTSAM's here. Without them
            central differences are taken, for which e must not jump (wrap angles so that the jump is far from the values
            you expect).
        information: Omega (d, d).
        kinds: "pose", "point" or "number" for each key; default: poses.
        kernel: a robust kernel around the noise model; see `graphslam.edges.robust`.

    Raises:
        OptionError: an argument has an impossible value.

    A residual that raises, or returns something of another shape or not finite, becomes a `FactorError` that names the
    factor and its keys. The residual may close over plain numbers but not over the factor, which GTSAM would never free.
    """

    keys_in_list = True

    def __init__(
        self,
        keys: Sequence[int],
        residual: Callable[..., Any],
        information: ArrayLike,
        *,
        kinds: Sequence[str] | None = None,
        kernel: KernelLike = None,
    ) -> None:
        keys = listed_keys("ResidualFactor", keys)
        if not (kinds is None or isinstance(kinds, (list, tuple))):
            raise OptionError(f"kinds must be a list of {', '.join(KINDS)}, not {quoted(kinds)}")
        kinds = [POSE] * len(keys) if kinds is None else list(kinds)
        for kind in kinds:
            checks.check_choice("kinds", kind, tuple(KINDS))
        if len(kinds) != len(keys) or not keys:
            raise OptionError(f"ResidualFactor needs one kind per key, not {len(kinds)} for {len(keys)} keys")
        if not callable(residual):
            raise OptionError(f"residual must be a function, not {quoted(residual)}")
        omega = positive_definite(information, None)

        def evaluated(*at: Coordinates) -> Linearized:
            values = [np.array(value, dtype=float) for value in at]
            answer = residual(*values)
            return answer if isinstance(answer, tuple) else (answer, _Differences(residual, values))

        arguments = {"residual": residual, "information": omega, "kinds": tuple(kinds), "kernel": kernel}
        super().__init__(keys, kinds, evaluated, arguments, information=omega)


class _Differences(Sequence[Array]):
    """The Jacobians of a residual by central differences, computed when they are read."""

    def __init__(self, residual: Callable[..., ArrayLike], values: list[Array]) -> None:
        self._residual, self._values = residual, values

    def __len__(self) -> int:
        return len(self._values)

    def __getitem__(self, k: Any) -> Any:
        columns = []
        for step in STEP * np.eye(len(self._values[k])):
            ahead, behind = (
                np.asarray(self._residual(*self._values[:k], self._values[k] + way * step, *self._values[k + 1 :]))
                for way in (1, -1)
            )
            columns.append((ahead - behind) / (2 * STEP))
        return np.stack(columns, axis=1)
