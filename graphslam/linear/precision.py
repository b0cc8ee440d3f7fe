"""Limits of double precision: of lengths and noise, and the inverses of covariances.

Graphs multiply up to six lengths and standard deviations with one another, and a determinant multiplies three of these
products. Between 1e-20 and 1e20 none of that leaves the range of floating point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any, TypeVar
from weakref import WeakSet

import numpy as np

from ..engine import engine
from ..errors import GraphError, checks
from ..models import MotionModel, SensorModel
from ..se2 import Array

if TYPE_CHECKING:
    from ..log import Log

Model = TypeVar("Model", MotionModel, SensorModel)

SMALLEST, LARGEST = 1e-20, 1e20
#: a matrix is singular to double precision where elimination leaves less than this part of a diagonal entry
PART = 1e-13


def check_magnitudes(log: Log, motion: MotionModel | None, sensor: SensorModel) -> None:
    """Raise `GraphError` where numbers of a log and its noise models are too large, too small or too far apart.

    The variances of a sighting along the line of sight and across it must not differ by more than 1 / `PART`, nor may
    those of bearing and orientation: their sum in other axes would lose the smaller one.
    """
    for model in (motion, sensor):
        if model is not None:
            check_model(model)
    check_size(f"the initial poses of {log.name}", log.initial_poses)
    ranges = log.sightings[:, 0]
    check_size(f"the ranges of {log.name}", ranges, least=SMALLEST)
    if log.partial_sightings is not None:
        check_size(f"the ranges alone of {log.name}", log.partial_sightings.ranges, least=SMALLEST)
    bearing, orientation = sensor.bearing_std, sensor.orientation_std
    along, across = np.hypot(ranges * sensor.range_rate, sensor.range_std), ranges * bearing
    if (k := checks.first(np.maximum(along / across, across / along) > PART**-0.5)) is not None:
        raise GraphError(
            f"{log.name}: the noise of sighting {k} is {along[k]:.2g} m along the line of sight and {across[k]:.2g} m "
            f"across it, and double precision holds a ratio of {PART**-0.5:.0e} at most; change range_rate, "
            "range_std or bearing_std"
        )
    if log.has_orientation and orientation < PART**0.5 * bearing:
        raise GraphError(
            f"orientation_std, {orientation:.2g} rad, is too small beside bearing_std, {bearing:.2g} rad, for double "
            f"precision; their ratio may be {PART**0.5:.0e} at least"
        )


#: the models that `check_model` has accepted: every factor comes with one, and a check takes longer than making the factor
_accepted: WeakSet[MotionModel | SensorModel] = WeakSet()


def check_model(model: MotionModel | SensorModel) -> None:
    """Raise `GraphError` where numbers of a noise model are too large or too small."""
    if model in _accepted:
        return
    # limits of sight may be infinite; the offset is a number of the equations
    limits = [name for name in getattr(model, "GEOMETRY", ()) if name != "offset"]
    for name in (f.name for f in fields(model)):
        if name in limits:
            continue
        # a small noise of the motion, or epsilon, is judged by the inverse of its covariance
        least = SMALLEST if isinstance(model, SensorModel) and name != "offset" else 0.0
        for number in np.atleast_1d(getattr(model, name)).tolist():
            check_size(f"{name} of the noise model", number, least=least if number else 0.0)
    _accepted.add(model)


#: the book's models, made once, because making one takes as long as a factor
_BOOK: dict[type, Any] = {kind: kind() for kind in (MotionModel, SensorModel)}


def model_of(kind: type[Model], model: Model | None) -> Model:
    """The noise model given, or the book's for None.

    Raises:
        OptionError: the argument is neither.
        GraphError: its numbers are too large or too small.
    """
    if model is None:
        return _BOOK[kind]
    checks.check_type(kind, **{kind.__name__.removesuffix("Model").lower(): model})
    check_model(model)
    return model


def check_size(what: str, numbers: object, *, least: float = 0.0, most: float = LARGEST) -> None:
    """Raise `GraphError` unless the magnitudes of all numbers lie between two limits."""
    if isinstance(numbers, float) and least <= abs(numbers) <= most:
        return
    size = np.abs(np.asarray(numbers, dtype=float)).ravel()
    if (k := checks.first((size > most) | (size < least))) is not None:
        raise GraphError(
            f"{what}: {size[k]:g} is too {'large' if size[k] > most else 'small'} for double precision; the limit is "
            f"{most if size[k] > most else least:g}"
        )


def inverses(covariances: Array, noun: str, remedy: str, least: float = PART) -> Array:
    """The inverses (E, d, d) of covariances, symmetric and positive definite.

    Rows and columns are scaled to a diagonal of ones first, so that metres and radians of different size lose no digits.

    Args:
        covariances: (E, d, d).
        noun: what has these covariances, for the message, such as "motion".
        remedy: what to do, for the message.
        least: elimination must leave more than this part of each diagonal entry.

    Raises:
        GraphError: one of them is not finite, or singular to double precision.
    """
    inverse, wrong = engine.inverses(np.ascontiguousarray(covariances, dtype=float), least)
    if wrong >= 0:
        raise GraphError(f"the uncertainty of {noun} {wrong} is singular to double precision; {remedy}")
    return inverse


def small_inverse(matrix: Sequence[Sequence[float]] | Array, least: float = PART) -> Array | None:
    """The inverse (d, d) of one symmetric matrix (d, d), d at most 3, or None where it is not positive definite.

    Elimination must leave more than the part ``least`` of each diagonal entry.
    """
    inverse, wrong = engine.inverses(np.array([matrix], dtype=float), least)
    return None if wrong >= 0 else inverse[0]
