"""The noise models as sums of variances: covariance = sum over the model's fields p of theta_p C_p.

The covariance of a motion (`MotionModel.accumulate`) is linear in the squares of the model's standard deviations and in
epsilon, and that of a sighting (`SensorModel.Q`) in the squares of the sensor's standard deviations.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np

from ..log import Log
from ..models import MotionModel, SensorModel
from ..se2 import Array

Model = TypeVar("Model", MotionModel, SensorModel)

#: the standard deviations of the models
OF_MOTION = tuple(f.name for f in fields(MotionModel) if f.name != "epsilon")
OF_SENSOR = tuple(f.name for f in fields(SensorModel) if f.name not in SensorModel.GEOMETRY)

#: the least epsilon [m², rad²] that a calibrated model has, because A M A' has only rank 2
LEAST_EPSILON = 1e-9
#: the least variances of calibrated models: noise that is smaller counts as this, (0.01 mm)² or (0.01 mrad)²
LEAST = {"epsilon": LEAST_EPSILON, "range_std": 1e-10, "bearing_std": 1e-10, "orientation_std": 1e-10}

#: the model without noise, and one whose variances, 1e-18, vanish beside 1
_STILL = MotionModel(**dict.fromkeys(OF_MOTION, 0.0), epsilon=LEAST_EPSILON)
_TINY: dict[str, Any] = dict.fromkeys(OF_SENSOR, 1e-9)
_EXACT = SensorModel(**_TINY)


def motion_parts(log: Log, names: Iterable[str] = (*OF_MOTION, "epsilon")) -> dict[str, Array]:
    """C_p (T, 3, 3) of fields of the motion model, for all motions of a log, in the frame each starts from."""
    assert log.controls is not None and log.dt is not None
    identity, parts = np.eye(3), {}
    for name in names:
        if name == "epsilon":
            parts[name] = np.broadcast_to(identity, (log.num_poses - 1, 3, 3)).copy()
            continue
        alone = replace(_STILL, **{name: 1.0})
        covariances = alone.accumulate(log.controls, log.dt, log.control_starts, recorded_dt=log.recorded_dt)[1]
        parts[name] = covariances - LEAST_EPSILON * identity
    return parts


def stacked(parts: Iterable[Mapping[str, Array]]) -> dict[str, Array]:
    """The parts of several logs, one after the other; all of the same names."""
    several = list(parts)
    return {name: np.concatenate([each[name] for each in several]) for name in several[0]}


def with_variances(model: Model, variances: Mapping[str, float]) -> Model:
    """The model with these variances, epsilon at least `LEAST_EPSILON`; fields that are not named stay."""
    numbers: dict[str, Any] = {n: max(v, LEAST_EPSILON) if n == "epsilon" else v**0.5 for n, v in variances.items()}
    return replace(model, **numbers)


def ordinary(log: Log) -> np.ndarray:
    """The motions (T,) bool whose noise is the model's alone: those across no gap in the odometry."""
    if log.control_variances is None:
        return np.ones(log.num_poses - 1, dtype=bool)
    return np.maximum.reduceat(log.control_variances.max(axis=1), log.control_starts[:-1]) == 0


def sensor_parts(sightings: Array) -> dict[str, Array]:
    """C_p (M, n, n) of each field of the sensor model that affects sightings (M, n), n = 2 or 3."""
    least = _EXACT.Q(sightings)
    parts = {name: SensorModel(**(_TINY | {name: 1.0})).Q(sightings) - least for name in OF_SENSOR}
    return {name: C for name, C in parts.items() if C.any()}
