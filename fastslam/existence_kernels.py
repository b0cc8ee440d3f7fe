"""Which landmarks of the particles exist, compiled: evidence against those not seen, and landmarks that are one.

The pool of landmarks is that of `association_kernels`.
"""

from __future__ import annotations

from math import log, sqrt

import numpy as np
from numba import njit

from graphslam.se2 import Array

from . import class_kernels
from .association_kernels import EVIDENCE, LAST_STEP, Rule, existence
from .blocks import Nine, get_nine, put_nine
from .fast_math import INLINED, OPTIONS, atan2, wrap_angle
from .kalman import weigh_and_update


@njit(**OPTIONS)
def count_misses(
    lo: int, hi: int, poses: Array, pool: Array, candidates: np.ndarray, step: int, view: Array, miss: float, rule: Rule,
    log_likelihood: Array,
) -> None:  # fmt: skip
    """Lower the evidence for landmarks that were in view in this step without a sighting, except for permanent ones.

    Where hypotheses are drawn, that the landmark was not seen has the probability 1 - P_D e, which is the particle's.

    Args:
        view: smallest range, largest range [m] and largest bearing [rad] at which a landmark should be seen.
        miss: by how much.
    """
    for c in range(len(candidates)):
        rows = pool[candidates[c]]
        for i in range(lo, hi):
            missed = rows[EVIDENCE, i] > 0 and rows[LAST_STEP, i] != step
            missed &= rule.sampled or rows[EVIDENCE, i] < rule.kept
            if missed and _in_view(rows[0, i] - poses[0, i], rows[1, i] - poses[1, i], poses[2, i], view):
                if rule.sampled:
                    log_likelihood[i] += log(1.0 - rule.detection * existence(rows[EVIDENCE, i], rule.dropped))
                if rows[EVIDENCE, i] < rule.kept:
                    rows[EVIDENCE, i] = max(rows[EVIDENCE, i] - miss, 0.0)


@njit(**INLINED)
def _in_view(dx: float, dy: float, heading: float, view: Array) -> bool:
    r = sqrt(dx * dx + dy * dy)
    return view[0] <= r <= view[1] and abs(wrap_angle(atan2(dy, dx) - heading)) <= view[2]


@njit(**OPTIONS)
def extents(
    pool: Array, slices: np.ndarray, kept: float, gate: float, owners: np.ndarray, droppable: np.ndarray, boxes: Array
) -> None:  # fmt: skip
    """Write for each of some slices how many particles have it, whether any may still drop it, and where it lies.

    The box, (smallest x, largest x, smallest y, largest y), holds the means with the margin that `places` leaves to it.
    """
    for n in range(len(slices)):
        rows = pool[slices[n]]
        count, may_go, left, right, low, high = 0, False, np.inf, -np.inf, np.inf, -np.inf
        for i in range(rows.shape[1]):
            if rows[EVIDENCE, i] > 0:
                count += 1
                may_go |= rows[EVIDENCE, i] < kept
                wide = 2 * sqrt(gate * max(rows[3, i] + rows[6, i], 0.0))
                left, right = min(left, rows[0, i] - wide), max(right, rows[0, i] + wide)
                low, high = min(low, rows[1, i] - wide), max(high, rows[1, i] + wide)
        owners[n], droppable[n] = count, may_go
        boxes[n, 0], boxes[n, 1], boxes[n, 2], boxes[n, 3] = left, right, low, high


@njit(**OPTIONS)
def merge(
    lo: int, hi: int, pool: Array, slices: np.ndarray, third: float, gate: float, blur: tuple[float, float], kept: float
) -> None:
    """Merge landmarks of a particle that are one: the older takes what the younger knows, and the younger goes.

    They are one where the squared Mahalanobis distance of their means, under S_a + S_b + diag(blur), is at most the gate,
    and the last scan that saw one of them did not see both. With classes, twice `class_kernels.log_same` is subtracted from
    the distance.

    Args:
        slices: pool indices, the older first; ``third``: 1 where landmarks have a heading.
        blur: variances [m², rad²] by which the covariances are too small, because errors of sightings are correlated.
    """
    classes = pool.shape[1] - class_kernels.FIRST
    farthest = gate + 2 * log(classes) if classes > 0 else gate
    for i in range(lo, hi):
        for young in range(1, len(slices)):
            rows = pool[slices[young]]
            if rows[EVIDENCE, i] == 0:
                continue
            for old in range(young):
                other = pool[slices[old]]
                if other[EVIDENCE, i] == 0 or other[LAST_STEP, i] == rows[LAST_STEP, i]:
                    continue
                dx, dy = rows[0, i] - other[0, i], rows[1, i] - other[1, i]
                # within the gate the distance is at most that of the traces, and a common class is worth at most log n
                wide = rows[3, i] + rows[6, i] + other[3, i] + other[6, i] + 2 * blur[0]
                if dx * dx + dy * dy > farthest * wide:
                    continue
                squared, fused = _fused(get_nine(other, 0, i), get_nine(rows, 0, i), third, blur)
                if classes > 0:
                    squared -= 2 * class_kernels.log_same(rows, other, i)
                if squared <= gate:
                    put_nine(other, 0, i, fused)
                    class_kernels.join(rows, other, i)
                    other[EVIDENCE, i] = min(other[EVIDENCE, i] + rows[EVIDENCE, i], kept)
                    other[LAST_STEP, i] = max(other[LAST_STEP, i], rows[LAST_STEP, i])
                    rows[EVIDENCE, i] = 0.0
                    break


@njit(**INLINED)
def _fused(a: Nine, b: Nine, third: float, blur: tuple[float, float]) -> tuple[float, Nine]:
    """Return the squared Mahalanobis distance of two landmarks, blurred, and the product of their Gaussians.

    It is a Kalman update of a by b with H = I and V = S_a + S_b = L D L'.
    """
    e = b[0] - a[0], b[1] - a[1], third * wrap_angle(b[2] - a[2])
    squared, _ = _updated(a, b, e, third, blur)
    _, fused = _updated(a, b, e, third, (0.0, 0.0))
    return squared, fused


@njit(**INLINED)
def _updated(
    a: Nine, b: Nine, e: tuple[float, float, float], third: float, blur: tuple[float, float]
) -> tuple[float, Nine]:
    v00, v10, v20 = a[3] + b[3] + blur[0], a[4] + b[4], third * (a[5] + b[5])
    v11, v21, v22 = a[6] + b[6] + blur[0], third * (a[7] + b[7]), third * (a[8] + b[8] + blur[1]) + (1.0 - third)
    l10, l20 = v10 / v00, v20 / v00
    d1 = v11 - l10 * v10
    l21 = (v21 - l20 * v10) / d1
    d2 = v22 - l20 * v20 - l21 * l21 * d1
    wa = a[3], a[4], a[5]
    wb = a[4] - l10 * wa[0], a[6] - l10 * wa[1], a[7] - l10 * wa[2]
    wc = (
        third * (a[5] - l20 * wa[0] - l21 * wb[0]), third * (a[7] - l20 * wa[1] - l21 * wb[1]),
        third * (a[8] - l20 * wa[2] - l21 * wb[2]),
    )  # fmt: skip
    y1 = e[1] - l10 * e[0]
    y2 = e[2] - l20 * e[0] - l21 * y1
    squared = e[0] * e[0] / v00 + y1 * y1 / d1 + y2 * y2 / d2
    _, fused = weigh_and_update(a, wa, wb, wc, e, (l10, l20, l21), (v00, d1, d2), third, 1.0, 1.0)
    return squared, fused
