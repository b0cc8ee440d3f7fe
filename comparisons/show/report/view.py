"""What the page shows of a comparison: every estimate in one frame, with errors and covariances, thinned to fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from graphslam import Log, SensorModel
from graphslam.metrics import position_errors
from graphslam.se2 import Array, compose, rotation, transform

from ..comparison import Comparison
from ..estimator import EstimatorResult, RunOptions
from ..plots import frame_of, reference_of
from .uncertainty import pose_covariances

#: of longer logs every so manieth step is shown: a screen has no more points, and the file must stay small
MOST_STEPS = 1500


@dataclass(frozen=True, eq=False)
class Estimate:
    """One estimate, drawn: S shown steps, laid onto the truth where it is known.

    Attributes:
        name: of the estimator.
        poses: (S, 3); NaN where the pose is not estimated.
        errors: (S,) [m], see `View.judged_by`; NaN where unknown.
        covariances: (S, 3, 3) in the drawn axes, NaN where unknown; None where known nowhere.
        landmarks, landmark_covariances: {id: (2,)} and {id: (2, 2)} in the drawn axes.
    """

    name: str
    poses: Array
    errors: Array
    covariances: Array | None
    landmarks: Mapping[int, Array]
    landmark_covariances: Mapping[int, Array]


@dataclass(frozen=True, eq=False)
class View:
    """All estimates of a comparison, drawn.

    Attributes:
        log: what was estimated from.
        steps: (S,) the steps shown.
        times: (S,) [s]; None where the log tells none.
        truth: (S, 3), NaN where unknown; None without truth.
        estimates: in the order of the results.
        judged_by: whose path the errors are distances from, after alignment: "truth", or the name of an estimator
            where the truth is not known; None where there is nobody to compare with.
        points: {step: (K, 2)} what was seen, in the robot's frame [m].
        seen: {step: (K,)} the ids of the landmarks.
    """

    log: Log
    steps: np.ndarray
    times: Array | None
    truth: Array | None
    estimates: tuple[Estimate, ...]
    judged_by: str | None
    points: Mapping[int, Array]
    seen: Mapping[int, np.ndarray]

    @property
    def abscissa(self) -> tuple[Array, str]:
        """What curves over the drive are drawn over, (S,), and its name with the unit."""
        return (self.steps.astype(float), "step") if self.times is None else (self.times, "time [s]")


def view_of(comparison: Comparison, options: RunOptions) -> View:
    """The view of a comparison whose estimators were told ``options``, noise models included."""
    log = comparison.log
    stride = max(1, -(-log.num_poses // MOST_STEPS))
    steps = np.unique(np.append(np.arange(0, log.num_poses, stride), log.num_poses - 1))
    judge, judged_by = _judge(comparison)
    estimates = tuple(_estimate(comparison, result, options, steps, judge) for result in comparison.results)
    points, seen = _sightings(log, options.sensor or log.sensor or SensorModel(), steps)
    return View(
        log=log,
        steps=steps,
        times=None if log.times is None else log.times[steps],
        truth=None if log.true_poses is None else log.true_poses[steps],
        estimates=estimates,
        judged_by=judged_by,
        points=points,
        seen=seen,
    )


def _judge(comparison: Comparison) -> tuple[Array | None, str | None]:
    """The path that errors are measured from, (T+1, 3), and its name."""
    if comparison.log.true_poses is not None:
        return comparison.log.true_poses, "truth"
    reference = reference_of(comparison)
    if reference is None or len(comparison.results) < 2:
        return None, None
    return np.where(reference.estimated[:, None], reference.poses, np.nan), reference.name


def _estimate(
    comparison: Comparison, result: EstimatorResult, options: RunOptions, steps: np.ndarray, judge: Array | None
) -> Estimate:
    frame = frame_of(comparison, result)
    errors = np.full(len(result.poses), np.nan)
    if judge is not None:
        counted = result.estimated & np.isfinite(judge[:, 0])
        if np.count_nonzero(counted) >= 2:
            errors = position_errors(judge, result.poses, counted)
    turn = rotation(frame[2])
    covariances = pose_covariances(result, comparison.log, options)
    if covariances is not None:
        whole = np.eye(3)
        whole[:2, :2] = turn
        covariances = whole @ covariances[steps] @ whole.T
    return Estimate(
        name=result.name,
        poses=np.where(result.estimated[steps, None], compose(frame, result.poses[steps]), np.nan),
        errors=errors[steps],
        covariances=covariances,
        landmarks={j: transform(frame, m[:2]) for j, m in result.landmarks.items()},
        landmark_covariances={j: turn @ S[:2, :2] @ turn.T for j, S in result.landmark_covariances.items()},
    )


def _sightings(
    log: Log, sensor: SensorModel, steps: np.ndarray
) -> tuple[Mapping[int, Array], Mapping[int, np.ndarray]]:
    """What was seen from each shown step: places in the robot's frame, and ids."""
    places = sensor.h_inverse(np.zeros((len(log.steps), 3)), log.sightings)[:, :2]
    begin, end = np.searchsorted(log.steps, steps), np.searchsorted(log.steps, steps, side="right")
    rows = {int(t): slice(a, b) for t, a, b in zip(steps, begin, end) if b > a}
    return {t: places[k] for t, k in rows.items()}, {t: log.landmarks[k] for t, k in rows.items()}
