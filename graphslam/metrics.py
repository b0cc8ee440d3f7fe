"""Errors of an estimate against the ground truth: functions of planar trajectories and maps.

Ground truth and estimate may be given in different world frames, so positions are compared after the rigid motion that
aligns the estimate best with the ground truth. The definitions are those of Sturm et al., *A benchmark for the evaluation
of RGB-D SLAM systems* (IROS 2012), in the plane. The values equal those of the tool ``evo`` (APE of the translation part
after alignment without scale, RPE between neighbours), with one difference: evo aligns in space, where turning the plane
over is a rotation, so it may compare with the mirror image of an estimate. Here nothing is mirrored.

A step whose true position is NaN (see `graphslam.Log`) does not count; a step whose true heading is NaN does not count
in the RPE.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .errors import OptionError
from .se2 import Array, between, compose, difference, inverse, transform, turn_matrix, wrap

#: a map: the position (2,) or (3,) of each landmark [m], by id; a heading does not count
Landmarks = Mapping[int, ArrayLike]
#: see `exchanged`
EXCHANGED = 3.0


def metric(title: str, unit: str, help: str, *, shown: str = "always") -> Any:
    """A field of `Errors`: the declaration of a metric, from which tables, studies, axes, JSON and options take it.

    Args:
        title: in tables and on axes.
        unit: "m" or "rad".
        help: what it is, for the JSON schema.
        shown: in which tables: "always", "runs" (not in the tables of studies), or "never" (only in files).
    """
    return field(default=None, metadata={"title": title, "unit": unit, "help": help, "shown": shown})


@dataclass(frozen=True, kw_only=True)
class Errors:
    """The metrics of an estimate, each a number that is smaller for a better estimate; None where it cannot be known.

    A further metric is a field here, and its value in `evaluate`.
    """

    ate_m: float | None = metric("ATE", "m", "absolute trajectory error, see `graphslam.metrics.ate`")
    rpe_m: float | None = metric("RPE", "m", "relative pose error per step, see `graphslam.metrics.rpe`")
    rpe_rad: float | None = metric("RPE", "rad", "relative pose error per step", shown="runs")
    heading_rad: float | None = metric("heading", "rad", "error of the headings after alignment", shown="never")
    landmark_rmse_m: float | None = metric("map", "m", "error of the map in the aligned frame")


#: {name: title, unit, help and shown} of every metric
METRICS = {f.name: f.metadata for f in fields(Errors)}


def headings(studies: bool = False, separator: str = "\n") -> dict[str, str]:
    """{name: title and unit} of the metrics that the tables of runs, or of studies, show."""
    which = ("always",) if studies else ("always", "runs")
    return {n: f"{m['title']}{separator}[{m['unit']}]" for n, m in METRICS.items() if m["shown"] in which}


@dataclass(frozen=True, kw_only=True)
class Metrics(Errors):
    """The errors of one estimate and what they were computed with; None where they cannot be computed.

    Attributes:
        landmark_errors_m: {id: error of each landmark [m]}, see `landmark_errors`.
        aligned_by: "poses", or "landmarks" where only their truth is known; see `alignment_of`.
        poses_counted: the number of poses that were compared: estimated, and with known true position.
    """

    landmark_errors_m: Mapping[int, float] | None = None
    aligned_by: str | None = None
    poses_counted: int | None = None


def align(truth: ArrayLike, estimate: ArrayLike, *, mask: ArrayLike | None = None) -> Array:
    """The pose A of SE(2) that aligns the estimate with the ground truth: argmin over A of sum_t |A p_t - q_t|².

    p_t and q_t are the positions of estimate and truth. With both centred (p', q') the minimum has the closed form
    theta = atan2(sum p' x q', sum p' . q'), translation = mean q - R(theta) mean p: Umeyama's solution without scale,
    and without mirroring by construction. Where all positions coincide the heading is 0.

    Args:
        truth, estimate: (T+1, 3) poses or (T+1, 2) positions.
        mask: (T+1,) bool, which steps count; default: all.

    Returns:
        A as a pose (3,): ``se2.compose(A, estimate)`` is the aligned trajectory.

    Raises:
        OptionError: the shapes differ, or no step counts.
    """
    truth, estimate, mask = _checked(truth, estimate, mask)
    q, p = truth[mask, :2], estimate[mask, :2]
    q_mean, p_mean = q.mean(axis=0), p.mean(axis=0)
    # the mean of equal numbers is rounded, and differences from it would be a direction
    q, p = (np.where(np.ptp(each, axis=0) > 0, each - mean, 0.0) for each, mean in ((q, q_mean), (p, p_mean)))
    theta = np.arctan2(np.sum(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]), np.sum(p * q))
    return np.array([*(q_mean - transform(np.array([0.0, 0.0, theta]), p_mean)), theta])


def position_errors(truth: ArrayLike, estimate: ArrayLike, *, mask: ArrayLike | None = None) -> Array:
    """The distance |A p_t - q_t| [m] of every step after alignment (see `align`); (T+1,), NaN where the mask is False.

    Raises:
        OptionError: the shapes differ, or no step counts.
    """
    truth, estimate, mask = _checked(truth, estimate, mask)
    off = transform(align(truth, estimate, mask=mask), estimate[:, :2]) - truth[:, :2]
    return np.where(mask, np.hypot(off[:, 0], off[:, 1]), np.nan)


def ate(truth: ArrayLike, estimate: ArrayLike, *, mask: ArrayLike | None = None) -> float:
    """Absolute trajectory error [m]: sqrt(mean over t of |A p_t - q_t|²), A the best rigid alignment (see `align`).

    Equal to evo's ``APE(PoseRelation.translation_part)`` RMSE after ``align(correct_scale=False)``.

    Raises:
        OptionError: the shapes differ, or no step counts.
    """
    errors = position_errors(truth, estimate, mask=mask)
    return float(np.sqrt(np.nanmean(errors**2)))


def rpe(truth: ArrayLike, estimate: ArrayLike, *, mask: ArrayLike | None = None) -> tuple[float, float] | None:
    """Relative pose error per step: RMSE of the translation [m] and of the rotation [rad] of E_t.

    E_t = (x_t^-1 x_{t+1})_true^-1 (x_t^-1 x_{t+1})_estimate, over all neighbours t, t+1 that both count: the error of one
    step, which does not depend on the frames of the trajectories. Equal to evo's ``RPE(delta=1, Unit.frames)`` with
    ``translation_part`` and ``rotation_angle_rad``.

    Args:
        truth, estimate: (T+1, 3) poses.
        mask: (T+1,) bool, which steps count; default: all.

    Returns:
        (metres, radians), or None where no two neighbouring steps count.

    Raises:
        OptionError: the shapes differ, or no step counts.
    """
    truth, estimate, mask = _checked(truth, estimate, mask, columns=3)
    mask = mask & np.isfinite(truth[:, 2])
    pairs = mask[:-1] & mask[1:]
    if not pairs.any():
        return None
    error = between(between(truth[:-1], truth[1:]), between(estimate[:-1], estimate[1:]))[pairs]
    return float(np.sqrt(np.mean(error[:, 0] ** 2 + error[:, 1] ** 2))), float(np.sqrt(np.mean(error[:, 2] ** 2)))


def heading_rmse(truth: ArrayLike, estimate: ArrayLike, *, mask: ArrayLike | None = None) -> float | None:
    """Root mean square [rad] of the headings' errors after the alignment of the positions (see `align`).

    None where no true heading is known.

    Raises:
        OptionError: the shapes differ, or no step counts.
    """
    truth, estimate, mask = _checked(truth, estimate, mask, columns=3)
    known = mask & np.isfinite(truth[:, 2])
    if not known.any():
        return None
    errors = wrap(estimate[known, 2] + align(truth, estimate, mask=mask)[2] - truth[known, 2])
    return float(np.sqrt(np.mean(errors**2)))


def alignment_of(
    true_poses: Array | None,
    true_landmarks: Mapping[int, Array] | None,
    poses: Array,
    landmarks: Landmarks,
    *,
    mask: ArrayLike | None = None,
    named: bool = True,
) -> tuple[Array, str] | None:
    """The rigid motion (3,) after which an estimate is measured and drawn, and whether "poses" or "landmarks" gave it.

    The poses give it where at least two true positions are known. Otherwise the landmarks do, if at least two of them
    have a true position and the ids of the true map (``named``). A single point could always be aligned without error.

    Args:
        true_poses, true_landmarks: the ground truth, as in `graphslam.Log`.
        poses: (T+1, 3), of the point to which the true poses belong.
        landmarks: the estimated map.
        mask: (T+1,) bool, which poses count; default: all.
        named: whether the ids of the landmarks are those of the ground truth.

    Returns:
        None where neither is known.
    """
    if true_poses is not None:
        counted = np.isfinite(true_poses[:, 0]) & (True if mask is None else np.asarray(mask, dtype=bool))
        if np.count_nonzero(counted) >= 2:
            return align(true_poses, poses, mask=counted), "poses"
    shared = sorted((true_landmarks or {}).keys() & landmarks.keys()) if named else []
    if true_landmarks is None or len(shared) < 2:
        return None
    return align(_positions(true_landmarks, shared), _positions(landmarks, shared)), "landmarks"


def landmark_errors(truth: Landmarks, estimate: Landmarks, alignment: ArrayLike) -> dict[int, float]:
    """The error |A m_j - M_j| [m] of each landmark that both maps have, {id: error}; see `landmark_rmse`."""
    shared = sorted(truth.keys() & estimate.keys())
    if not shared:
        return {}
    errors = transform(alignment, _positions(estimate, shared)) - _positions(truth, shared)
    return dict(zip(shared, np.hypot(errors[:, 0], errors[:, 1]).tolist()))


def exchanged(truth: Landmarks, estimate: Landmarks, alignment: ArrayLike) -> list[tuple[int, int]]:
    """Pairs of landmarks that lie where the truth puts the other one: the ids of the two may have been exchanged.

    Each of the two is at least `EXCHANGED` times as far from its own true position as from that of the other.
    """
    errors = landmark_errors(truth, estimate, alignment)
    # an exchange makes large errors, and the number of pairs is quadratic
    worst = sorted(sorted(errors, key=errors.__getitem__, reverse=True)[:100])
    if len(worst) < 2:
        return []
    off = transform(alignment, _positions(estimate, worst))[:, None] - _positions(truth, worst)
    distance = np.hypot(off[..., 0], off[..., 1])
    better = np.diag(distance)[:, None] > EXCHANGED * distance
    return [(worst[a], worst[b]) for a, b in np.argwhere(np.triu(better & better.T, 1)).tolist()]


def landmark_rmse(truth: Landmarks, estimate: Landmarks, alignment: ArrayLike) -> float | None:
    """The error of a map [m]: sqrt(mean over j of |A m_j - M_j|²) over the landmarks that both maps have.

    A is the alignment of the **trajectory** (`align` on the poses) wherever that is known: a map that is correct in
    itself but turned against the trajectory counts as wrong. Headings of landmarks are ignored. None where the maps
    have no landmark in common.
    """
    errors = list(landmark_errors(truth, estimate, alignment).values())
    return float(np.sqrt(np.mean(np.square(errors)))) if errors else None


def named_by_place(truth: Landmarks, estimate: Landmarks, alignment: ArrayLike) -> dict[int, ArrayLike]:
    """An estimated map with arbitrary ids, renamed by those of the ground truth that it matches best by position.

    The matching minimises the sum of |A m_k - M_j|, where A is the alignment of the trajectory, as in `landmark_rmse`.
    Where one map has more landmarks than the other, those without a partner are left out. The sum is of distances, not
    of their squares, with which one wrong landmark far away would change the other pairs.

    Source: Kuhn, *The Hungarian method*, 1955, as implemented in SciPy.
    """
    pairs = _matched(truth, estimate, lambda off: np.hypot(off[..., 0], off[..., 1]), alignment)
    return {j: estimate[k] for j, k, _ in pairs}


def matched_places(truth: Landmarks, estimate: Landmarks, cutoff: float) -> list[tuple[int, int]]:
    """The pairs (true id, id) of landmarks nearer than the cutoff [m] that `gospa` counts; maps in one frame, any ids."""
    pairs = _matched(truth, estimate, lambda off: np.minimum(np.sum(off**2, axis=2), cutoff**2))
    return sorted((j, k) for j, k, square in pairs if square < cutoff**2)


def _matched(
    truth: Landmarks, estimate: Landmarks, cost: Callable[[Array], Array], alignment: ArrayLike = (0.0, 0.0, 0.0)
) -> list[tuple[int, int, float]]:
    """The pairs (true id, id, cost) of two maps with the least sum of costs, which are of the offsets (L, J, 2)."""
    from scipy.optimize import linear_sum_assignment

    if not truth or not estimate:
        return []
    ids, numbers = sorted(truth), sorted(estimate)
    costs = cost(transform(alignment, _positions(estimate, numbers))[:, None] - _positions(truth, ids))
    return [(ids[c], numbers[r], float(costs[r, c])) for r, c in zip(*linear_sum_assignment(costs))]


def gospa(truth: Landmarks, estimate: Landmarks, cutoff: float) -> float:
    """The GOSPA distance [m] of two maps in one frame, with the exponents p = 2 and alpha = 2.

        sqrt( min over pairs of  sum of |m_k - M_j|² + c²/2 (landmarks of both maps without a partner) )

    A landmark that is missed or false costs as much as an error of c / sqrt(2), c the cutoff [m]. Ids do not count.

    Source: Rahmathullah, Garcia-Fernandez and Svensson, *Generalized optimal sub-pattern assignment metric* (FUSION 2017).
    """
    pairs = matched_places(truth, estimate, cutoff)
    off = _positions(truth, [j for j, _ in pairs]) - _positions(estimate, [k for _, k in pairs])
    near = float(np.sum(off**2))
    return float(np.sqrt(near + cutoff**2 / 2 * (len(truth) + len(estimate) - 2 * len(pairs))))


def pose_nees(errors: Array, covariances: Array) -> Array:
    """The normalised estimation error squared e' P^-1 e / 3 for errors (T, 3) with covariances (T, 3, 3); (T,).

    The headings of the errors must be wrapped. The average over many logs is 1 if the covariances are consistent. NaN
    where an error is unknown or a covariance is zero.

    Source: Bar-Shalom, Li and Kirubarajan, *Estimation with applications to tracking and navigation*, section 5.4.
    """
    nees = np.full(len(errors), np.nan)
    known = np.isfinite(errors).all(axis=1) & (np.einsum("tii->ti", covariances) > 0).all(axis=1)
    e = errors[known]
    nees[known] = np.einsum("ti,ti->t", e, np.linalg.solve(covariances[known], e[:, :, None])[:, :, 0]) / 3
    return nees


def mean_nees(truth: Array, poses: Array, covariances: Array, *, relative: bool = True) -> float | None:
    """The mean of e' P^-1 e / 3 over the poses whose truth and covariance are known; 1 means consistent, more overconfident.

    Args:
        truth, poses, covariances: (T, 3), (T, 3) and (T, 3, 3) in the axes of ``poses``; NaN where unknown.
        relative: e is the error relative to the first pose, which does not count; else that in the axes of the truth.

    Returns:
        None where nothing is known, or a covariance has no inverse.
    """
    if relative:
        frame = compose(truth[0], inverse(poses[0]))
        turn = turn_matrix(frame[2])
        poses, covariances = compose(frame, poses), turn @ covariances @ turn.T
    errors = difference(poses, truth)
    errors[: int(relative)] = np.nan
    try:
        each = pose_nees(errors, covariances)
    except np.linalg.LinAlgError:
        return None
    return float(np.nanmean(each)) if np.isfinite(each).any() else None


def evaluate(
    true_poses: Array | None,
    true_landmarks: Mapping[int, Array] | None,
    poses: Array,
    landmarks: Landmarks,
    *,
    mask: ArrayLike | None = None,
    named: bool = True,
) -> Metrics:
    """All errors of one estimate; those that need an unknown truth are None.

    `alignment_of` says how the estimate is aligned. Where the landmarks are not ``named``, because their ids are arbitrary
    numbers of the estimator, they are first matched by `named_by_place`. The arguments are those of `alignment_of`.
    """
    aligned = alignment_of(true_poses, true_landmarks, poses, landmarks, mask=mask, named=named)
    if aligned is None:
        return Metrics()
    alignment, aligned_by = aligned
    if true_landmarks is not None and not named:
        landmarks = named_by_place(true_landmarks, landmarks, alignment)
    of_map = Metrics(aligned_by=aligned_by)
    if true_landmarks is not None:
        each = landmark_errors(true_landmarks, landmarks, alignment)
        rmse = landmark_rmse(true_landmarks, landmarks, alignment)
        of_map = replace(of_map, landmark_rmse_m=rmse, landmark_errors_m=each)
    if true_poses is None or aligned_by != "poses":
        return of_map
    counted = np.isfinite(true_poses[:, 0]) & (True if mask is None else np.asarray(mask, dtype=bool))
    rpe_m, rpe_rad = rpe(true_poses, poses, mask=counted) or (None, None)
    heading_rad = heading_rmse(true_poses, poses, mask=counted)
    return replace(
        of_map,
        ate_m=ate(true_poses, poses, mask=counted),
        rpe_m=rpe_m,
        rpe_rad=rpe_rad,
        heading_rad=heading_rad,
        poses_counted=int(np.count_nonzero(counted)),
    )


def _positions(places: Landmarks, ids: list[int]) -> Array:
    return np.array([np.asarray(places[j], dtype=float)[:2] for j in ids])


def _checked(
    truth: ArrayLike, estimate: ArrayLike, mask: ArrayLike | None, columns: int = 2
) -> tuple[Array, Array, np.ndarray]:
    truth, estimate = np.asarray(truth, dtype=float), np.asarray(estimate, dtype=float)
    if truth.shape != estimate.shape or truth.ndim != 2 or not columns <= truth.shape[1] <= 3:
        shapes = f"{truth.shape}, {estimate.shape}"
        raise OptionError(f"truth and estimate must be arrays of one shape (T+1, 3), not {shapes}")
    counted = np.ones(len(truth), dtype=bool) if mask is None else np.asarray(mask, dtype=bool)
    if counted.shape != truth.shape[:1]:
        raise OptionError(f"mask must have one entry per step, shape ({len(truth)},), not {counted.shape}")
    counted = counted & np.isfinite(truth[:, :2]).all(axis=1)
    if not counted.any():
        raise OptionError("no step counts, so there is nothing to compare")
    return truth, estimate, counted
