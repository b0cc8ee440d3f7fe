"""The noise models taken apart into variances: covariance = sum over the model's numbers of theta_p C_p.

The covariance of a motion (`MotionModel.accumulate`) is linear in nn², no², on², oo², sigma_v², sigma_omega² and epsilon,
that of a sighting (`SensorModel.Q`) in range_rate², range_std², bearing_std² and orientation_std².
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..log import Log
from ..models import MotionModel, SensorModel
from ..se2 import Array

#: the standard deviations of the motion model
OF_MOTION = ("nn", "no", "on", "oo", "sigma_v", "sigma_omega")

#: the least epsilon [m², rad²] that a calibrated model has, because A M A' has only rank 2
LEAST_EPSILON = 1e-9


def motion_parts(log: Log) -> dict[str, Array]:
    """C_p (T, 3, 3) of each number of the motion model, for all motions of a log, in the frame each starts from."""
    assert log.controls is not None and log.dt is not None
    nothing = MotionModel(**dict.fromkeys(OF_MOTION, 0.0), epsilon=LEAST_EPSILON)
    identity = np.eye(3)
    parts = {}
    for name in OF_MOTION:
        alone = MotionModel(**{**dict.fromkeys(OF_MOTION, 0.0), name: 1.0}, epsilon=nothing.epsilon)
        covariances = alone.accumulate(log.controls, log.dt, log.control_starts)[1]
        parts[name] = covariances - nothing.epsilon * identity
    parts["epsilon"] = np.broadcast_to(identity, parts["nn"].shape).copy()
    return parts


def motion_model(variances: Mapping[str, float]) -> MotionModel:
    """The model with these variances; epsilon is `LEAST_EPSILON` at least."""
    return MotionModel(
        **{name: variances[name] ** 0.5 for name in OF_MOTION}, epsilon=max(variances["epsilon"], LEAST_EPSILON)
    )


def motion_variances(motion: MotionModel) -> dict[str, float]:
    """The variances of a model."""
    return {name: getattr(motion, name) ** 2 for name in OF_MOTION} | {"epsilon": motion.epsilon}


def ordinary(log: Log) -> np.ndarray:
    """The motions (T,) bool whose noise is the model's alone: those across no gap in the odometry."""
    if log.control_variances is None:
        return np.ones(log.num_poses - 1, dtype=bool)
    return np.maximum.reduceat(log.control_variances.max(axis=1), log.control_starts[:-1]) == 0


def sensor_parts(sightings: Array) -> dict[str, Array]:
    """C_p (M, n, n) of each number of the sensor model, for sightings (M, 2 or 3)."""
    count, n = sightings.shape
    parts = {}
    for name, row, scale in (
        ("range_rate", 0, sightings[:, 0] ** 2),
        ("range_std", 0, np.ones(count)),
        ("bearing_std", 1, np.ones(count)),
        ("orientation_std", 2, np.ones(count)),
    ):
        if row < n:
            parts[name] = np.zeros((count, n, n))
            parts[name][:, row, row] = scale
    return parts


def sensor_model(variances: Mapping[str, float], like: SensorModel) -> SensorModel:
    """The model with these variances, and the place on the robot (and psi's noise, where there is none) of another."""
    found = {name: variance**0.5 for name, variance in variances.items()}
    return SensorModel(**{"orientation_std": like.orientation_std, **found}, offset=like.offset)


def sensor_variances(sensor: SensorModel, coordinates: int) -> dict[str, float]:
    """The variances of a model of a sensor with 2 or 3 coordinates."""
    names = ("range_rate", "range_std", "bearing_std", "orientation_std")
    return {name: getattr(sensor, name) ** 2 for name in names[: coordinates + 1]}
