"""Noise from a log whose true poses and landmarks are known: the residuals are the noise itself."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import LogError
from ..log import Log
from ..models import MotionModel, SensorModel, sinc
from ..se2 import Array, between, wrap
from .parts import LEAST, motion_parts, ordinary, sensor_parts
from .variances import VarianceFit, fit_variances

#: scale and bias have converged when they change by less than this
SETTLED = 1e-6


def knows_enough(log: Log) -> bool:
    """Whether true poses with headings and the positions of landmarks that were seen are known."""
    truth = log.robot_truth
    if truth is None or not log.true_landmarks:
        return False
    return bool(np.isfinite(truth[:, 2]).any() and np.isin(log.landmarks, list(log.true_landmarks)).any())


def motion_noise(log: Log, degrees: float | None = None) -> VarianceFit:
    """The variances of the motion, from the differences of true and commanded motions in the frame of their start.

    Motions across gaps in the odometry, and those whose true start or end is unknown, do not count.

    Raises:
        LogError: there are too few motions.
    """
    truth = log.robot_truth
    assert truth is not None
    moved = between(truth[:-1], truth[1:])
    e = moved - log.motions()[0]
    e[:, 2] = wrap(e[:, 2])
    counted = np.isfinite(e).all(axis=1) & ordinary(log)
    parts = {name: C[counted] for name, C in motion_parts(log).items()}
    ways = [e] if log.composite else [e, straightened(log, moved, e)]
    # the noise may enter by the controls or at the poses: the better explanation of the motions counts
    options: dict[str, Any] = {"degrees": degrees, "least": LEAST}
    fits = [fit_variances(way[counted], parts, **options, bounds=False) for way in ways]
    best = max(range(len(ways)), key=lambda k: fits[k].log_likelihood)
    return fit_variances(ways[best][counted], parts, **options, start=fits[best])


def straightened(log: Log, moved: Array, e: Array) -> Array:
    """The residuals (T, 3) of motions of one control each, computed from the controls that were really carried out.

    The noise du of a control changes the arc of the motion. To first order the residual is A du. To second order the
    product of the two parts of du also moves the robot sideways, a direction in which A is zero and the covariance only
    epsilon, which may be tiny; that would look like heavy tails. Therefore du is computed exactly, from the arc that
    turns as far as the robot did and ends nearest to it. The residual is A du plus the remaining distance to the arc.

    Args:
        log: without composite motions.
        moved: (T, 3) the true motions in the frames they start from.
        e: (T, 3) their plain residuals.
    """
    assert log.controls is not None and log.dt is not None
    dt, origin = log.dt, np.zeros(3)
    turn = log.controls[:, 1] * dt + e[:, 2]
    along = np.column_stack([np.cos(turn / 2), np.sin(turn / 2)])
    length = np.einsum("ti,ti->t", moved[:, :2], along)
    done = np.column_stack([length / (dt * sinc(turn / 2)), turn / dt])
    straight = np.einsum("tij,tj->ti", MotionModel().A(origin, log.controls, dt), done - log.controls)
    straight[:, :2] += moved[:, :2] - length[:, None] * along
    # turns of more than half a circle are ambiguous
    return np.where((np.abs(turn) < np.pi)[:, None], straight, e)


def sensor_noise(
    log: Log, sensor: SensorModel, degrees: float | None = None
) -> tuple[VarianceFit, dict[str, float], dict[str, float]]:
    """The variances of the sensor, the line by which it measures ranges ("range_scale", "range_bias"), and its errors.

    Line and variances are estimated in turn: the line by least squares with the variances and weights of the last fit,
    the variances from the ranges that the line corrects. The noise is assumed to grow with the true range; if it grew
    with the measured one, the likelihood would not be a density of the measurement.

    Raises:
        LogError: there are too few sightings of true landmarks from true poses.
    """
    truth = log.robot_truth
    assert truth is not None and log.true_landmarks is not None
    counted = np.isfinite(truth[log.steps]).all(axis=1) & np.isin(log.landmarks, list(log.true_landmarks))
    if not counted.any():
        raise LogError(f"{log.name}: no sighting has a known true pose and a known true landmark")
    n = log.sightings.shape[1]
    places = [log.true_landmarks[j] for j in log.landmarks[counted].tolist()]
    if n == 3 and any(len(place) == 2 for place in places):
        raise LogError(
            f"{log.name}: the truth of psi is unknown, because true landmarks have no heading; leave psi out"
        )
    z = log.sightings[counted]
    seen = sensor.h(truth[log.steps[counted]], np.array([place[:n] for place in places]))
    lines, parts = np.column_stack([seen[:, 0], np.ones(len(z))]), sensor_parts(seen)
    line, fit = np.array([1.0, 0.0]), None
    options: dict[str, Any] = {"degrees": degrees, "least": LEAST}
    e = z - seen
    e[:, 1:] = wrap(e[:, 1:])
    for _ in range(100):
        e[:, 0] = (z[:, 0] - line[1]) / line[0] - seen[:, 0]
        fit = fit_variances(e, parts, **options, start=fit, bounds=False)
        variance = np.sum([fit.variances[name] * C[:, 0, 0] for name, C in parts.items()], axis=0)
        weighted = lines * np.sqrt(fit.weights / variance)[:, None]
        # the nearest line to (1, 0), where all ranges are the same and do not determine one
        change = np.linalg.lstsq(weighted, np.sqrt(fit.weights / variance) * (z[:, 0] - lines @ line), rcond=1e-9)[0]
        line = line + change
        if np.abs(change).max() < SETTLED:
            break
    fit = fit_variances(e, parts, **options, start=fit)
    # the expected information of Student's t, as a fraction of the Gaussian one
    share = 1.0 if np.isinf(fit.degrees) else (fit.degrees + n) / (fit.degrees + n + 2)
    weighted = lines * np.sqrt(share / variance)[:, None]
    errors = np.full(2, np.nan)
    if np.linalg.matrix_rank(weighted, rtol=1e-9) == 2:
        errors = np.sqrt(np.diag(np.linalg.inv(weighted.T @ weighted))) * line[0]
    names = ("range_scale", "range_bias")
    return fit, dict(zip(names, line.tolist())), dict(zip(names, errors.tolist()))
