"""A log against its ground truth: scale, signs and axes of the true poses."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..errors import decimals
from ..log import Log
from ..se2 import Array, between, wrap
from .finding import Finding

#: motions that are needed
_FEWEST = 20
#: the path is divided into this many straight lines; turns between them are compared if the odometry turns by more [rad]
_LINES, _TURN = 60, 0.15
#: mirrored turns fit if they are off by less [rad, median], and this part of what turns as they are given are off
_FITS, _PART = 0.3, 0.4
#: mean cosine of the angle between two directions that are the same
_ALONG = 0.7


def against_truth(log: Log) -> Iterator[Finding]:
    """Odometry against the true poses: the length of the way, the sign of its turns, and where the robot looks."""
    if log.true_poses is None or log.controls is None:
        return
    placed = log.covered
    steps = np.flatnonzero(placed[:-1] & placed[1:])
    if len(steps) < _FEWEST:
        return
    path, truth = log.at_truth(log.dead_reckoning()), log.true_poses
    ours, theirs = (float(np.sum(np.hypot(*(poses[steps + 1, :2] - poses[steps, :2]).T))) for poses in (path, truth))
    if max(ours, theirs) > 1 and not 0.5 * theirs < ours < 2 * theirs:
        yield Finding(
            "truth scale",
            f"the odometry drives {decimals(ours, 1)} m where the truth moves {decimals(theirs, 1)} m; one may be in another "
            "unit",
        )
    mirrored = _is_mirrored(path, truth, np.flatnonzero(placed))
    headed = steps[np.isfinite(truth[steps, 2]) & np.isfinite(truth[steps + 1, 2])]
    if len(headed) < _FEWEST:
        if mirrored:
            yield Finding(
                "truth mirrored",
                "the true path turns the other way than the odometry: x and y of the truth may be swapped, or one of them "
                "or of the turn rates have the wrong sign",
            )
        return
    turns, real = path[headed + 1, 2] - path[headed, 2], wrap(truth[headed + 1, 2] - truth[headed, 2])
    small = np.abs(turns) < np.pi / 2
    product, size = float(np.sum((turns * real)[small])), float(np.sum((turns**2)[small]))
    if np.sum(np.abs(turns[small])) > 1 and product < -0.5 * size:
        also = "; or x and y of the truth are swapped, with the headings" if mirrored else ""
        message = f"the odometry turns the other way than the truth; one of them has the wrong sign{also}"
        yield Finding("truth sign", message)
        return
    if theirs > 1:
        yield from _headings(between(truth[headed], truth[headed + 1]), truth[headed], path, headed, mirrored=mirrored)


def _headings(motions: Array, truth: Array, path: Array, steps: np.ndarray, *, mirrored: bool) -> Iterator[Finding]:
    """Whether the robot looks where it drives; if not, whether it does with x and y read another way.

    Args:
        motions: (K, 3) true ones, seen from the poses where they begin.
        truth: (K, 3) where they begin.
        path: dead reckoning (T+1, 3).
        steps: (K,) of the motions.
        mirrored: whether the true path turns the other way than the odometry.
    """
    far = np.hypot(*motions[:, :2].T) > np.median(np.hypot(*motions[:, :2].T))
    if not far.any():
        return
    driven = between(path[steps], path[steps + 1])[far]
    ahead, heading = np.arctan2(driven[:, 1], driven[:, 0]), truth[far, 2]
    seen = np.arctan2(motions[far, 1], motions[far, 0])
    aside = np.mean(np.exp(1j * (seen - ahead)))
    # cos of the angle between where the robot looks and where it drives
    others = {
        "x and y of the truth are swapped": np.pi / 2 - (seen + heading),
        "x of the truth has the wrong sign": np.pi - (seen + heading),
        "y of the truth has the wrong sign": -(seen + heading),
    }
    fits = {name: float(np.mean(np.cos(direction - heading - ahead))) for name, direction in others.items()}
    best = max(fits, key=lambda name: fits[name])
    if mirrored and fits[best] > _ALONG > aside.real:
        yield Finding("truth mirrored", f"{best}: read like this, the robot looks where it drives")
    elif abs(aside) > _ALONG and abs(direction := np.angle(aside)) > np.deg2rad(45):
        yield Finding(
            "truth heading",
            f"the true headings point {np.rad2deg(abs(direction)):.0f} degrees away from the direction of driving; they "
            "may be in another unit, or count from another axis",
        )
    elif abs(aside) < 1 - _ALONG:
        yield Finding(
            "truth heading",
            "the true headings have nothing to do with the direction of driving; they may be in another unit or column",
        )


def _is_mirrored(path: Array, truth: Array, known: np.ndarray) -> bool:
    """Whether the true path has the turns of the odometry with the other sign."""
    lengths = np.hypot(*np.diff(path[known, :2], axis=0).T)
    way = np.concatenate([[0.0], np.cumsum(lengths)])
    if way[-1] == 0:
        return False
    ends = known[np.unique(np.searchsorted(way, np.linspace(0, way[-1], _LINES + 1)).clip(max=len(known) - 1))]
    lines = [np.diff(poses[ends, 0] + 1j * poses[ends, 1]) for poses in (path, truth)]
    ours, theirs = (np.angle(line[1:] * np.conj(line[:-1])) for line in lines)
    turning = (np.abs(ours) > _TURN) & (np.abs(ours) < np.pi / 2)
    if np.sum(turning) < _FEWEST // 2:
        return False
    given, other = (float(np.median(np.abs(wrap(theirs + sign * ours)[turning]))) for sign in (-1, 1))
    return other < _FITS and other < _PART * given
