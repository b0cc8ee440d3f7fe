"""Notes on the estimate of a particle filter: whether it contradicts its log, and what its particles have in common.

Weights are relative: where all particles are wrong, the least wrong ones win, and they agree. So the squared errors of
motions and sightings, each over its covariance, are compared with their number, along the history of the best particle and
on its map. A robot that was lifted, a wrong start or map, and ids that are misread again and again are far beyond it:
FastSLAM 1.0 and Monte Carlo localisation leave it in the sightings, FastSLAM 2.0, which corrects its poses by them, in the
motions.

The covariances of landmarks that a filter has made are not added, because they were made of the same sightings. With too few
particles the best history is not the best trajectory, and its squares are larger than those of chance: `BEYOND` has room for
that. Absolute positions and single numbers are not looked at.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from graphslam import Log, MotionModel, SensorModel
from graphslam.se2 import Array, between, difference, wrap

from .particles import FilterResult

#: how many steps in a row are summed up; the sum of all steps is looked at, too
STRETCH = 10
#: squared errors over their number from which on a stretch, or the whole log, is beyond chance
BEYOND, BEYOND_IN_ALL = 5.0, 3.0
#: the part of its length and turn by which a motion is uncertain at least, for what its covariance leaves out
CURVED = 0.02
#: what a note on a contradiction says
CONTRADICTION = "times what the noise models predict for the best particle"
#: what a note on particles with a common history says
ONE_HISTORY = "particles have one history"


def noted(result: FilterResult, log: Log | None, maps: bool) -> FilterResult:
    """A result with its notes.

    Args:
        log: that the filter went through, as far as the result goes; None for measurements that were handed in, which
            filters do not keep: only what the particles have in common is noted.
        maps: whether each particle has a map of its own.
    """
    if len(result.log_weights) == 1:
        shared = "one particle has no spread, so that its covariances of poses are 0, which says nothing; take more particles"
    else:
        shared = _shared_history(result) if maps else ""
    notes = [contradiction(result, log, maps), shared]
    return replace(result, notes=tuple(note for note in notes if note))


def _shared_history(result: FilterResult) -> str:
    """A sentence where all particles have one history from the beginning; empty otherwise, and with ``smoothing``."""
    last = int(np.argmax(np.append(result.ancestors, 0) != 1)) - 1
    if last < 1 or result.smoothed is not None:
        return ""
    return (
        f"all particles have one history up to step {last} of {len(result.poses) - 1}: they are one sample of the poses "
        "there and of the landmarks seen from them, so that covariances, also of the present pose, are too small; take more "
        "particles, or smoothing"
    )


def contradiction(result: FilterResult, log: Log | None, maps: bool) -> str:
    """A sentence on the stretch where the estimate contradicts the log most clearly; empty where none does."""
    named = result.options.uses_ids or not maps
    if log is None or log.num_poses < len(result.poses) or not (named or result.association is not None):
        return ""
    ids = log.landmarks if named else result.association
    assert ids is not None
    known = {} if maps else result.landmark_covariances
    # numbers far apart overflow, which is a contradiction, or leave nothing to invert
    with np.errstate(all="ignore"):
        try:
            squares, numbers = squares_of(log, result.motion, result.sensor, result.poses, result.landmarks, ids, known)
        except np.linalg.LinAlgError:
            return ""
    ratio, begin, end = _worst_stretch(squares, numbers)
    in_all = float(squares.sum() / max(numbers.sum(), 1.0))
    if not ratio > BEYOND:
        if not in_all > BEYOND_IN_ALL:
            return ""
        ratio, begin, end = in_all, 0, len(squares) - 1
    return (
        f"between steps {begin} and {end} the squared errors of motions and sightings are {ratio:,.0f} {CONTRADICTION}: "
        "poses, landmarks and covariances are wrong. The robot was moved, the start, the map or ids are wrong, there is more "
        "noise, or the particles are too few and have lost the robot; compare with graph SLAM (solve)"
    )


def squares_of(
    log: Log, motion: MotionModel, sensor: SensorModel, poses: Array, landmarks: Mapping[int, Array], ids: np.ndarray,
    known: Mapping[int, Array],
) -> tuple[Array, Array]:  # fmt: skip
    """The sums of squared errors over their covariances of each step (T + 1,), and how many numbers these are (T + 1,).

    Args:
        poses: (T + 1, 3), of the log's first steps; ``landmarks``: {id: place}.
        ids: (M,) of the sightings, which do not count without a place.
        known: {id: covariance} of landmarks of a map that is not made of these sightings.
    """
    squares, numbers = _of_motions(poses, *(each[: len(poses) - 1] for each in log.motions(motion)))
    rows = np.flatnonzero(np.isin(ids, list(landmarks)) & (log.steps < len(poses)))
    if not len(rows):
        return squares, numbers
    n = min(log.sightings.shape[1], *(len(place) for place in landmarks.values()))
    z, seen, steps = log.sightings[rows, :n], ids[rows].tolist(), log.steps[rows]
    places = np.array([landmarks[j][:n] for j in seen])
    error = z - sensor.h(poses[steps], places)
    error[:, 1:] = wrap(error[:, 1:])
    V = sensor.Q(z)
    if known:
        H = sensor.H(poses[steps], places)
        V = V + H @ np.array([known[j][:n, :n] for j in seen]) @ np.swapaxes(H, 1, 2)
    each = np.einsum("mi,mij,mj->m", error, np.linalg.inv(V), error)
    squares += np.bincount(steps, each, len(squares))
    numbers += n * np.bincount(steps, minlength=len(squares))
    return squares, numbers


def _of_motions(poses: Array, motions: Array, covariances: Array) -> tuple[Array, Array]:
    squares, numbers = np.zeros(len(poses)), np.zeros(len(poses))
    way, turn = np.hypot(motions[:, 0], motions[:, 1]), np.abs(motions[:, 2])
    least = (CURVED * np.column_stack([way, way, turn])) ** 2
    off = difference(between(poses[:-1], poses[1:]), motions)
    # where nothing moves, nothing can contradict
    moves = np.flatnonzero(np.diagonal(covariances, axis1=1, axis2=2).min(axis=1) > 0)
    inverse = np.linalg.inv(covariances[moves] + least[moves, :, None] * np.eye(3))
    squares[moves + 1] = np.einsum("ti,tij,tj->t", off[moves], inverse, off[moves])
    numbers[moves + 1] = 3
    return squares, numbers


def _worst_stretch(squares: Array, numbers: Array) -> tuple[float, int, int]:
    """The largest ratio of squares to numbers of a stretch of `STRETCH` steps, with its first and last step."""
    length = min(STRETCH, len(squares))
    sums, counts = (np.convolve(each, np.ones(length), "valid") for each in (squares, numbers))
    ratios = sums / np.maximum(counts, 1.0)
    first = int(np.argmax(ratios))
    return float(ratios[first]), first, first + length - 1
