"""The median with its bootstrap interval: how far it would move if other logs had been drawn; and quartiles."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np

from graphslam.se2 import Array

#: the share of resamples that the interval holds
LEVEL = 0.95
RESAMPLES = 2000
#: numbers drawn at once, so that memory stays small whatever the study's size
_AT_ONCE = 1_000_000


@dataclass(frozen=True)
class Median:
    """A median and its interval.

    Attributes:
        median: of the values.
        low, high: the interval; None where there is only one unit to draw from.
        count: the number of values.
    """

    median: float
    low: float | None
    high: float | None
    count: int


def quartiles(values: Sequence[float]) -> Array:
    """The first quartile, the median and the third quartile, (3,)."""
    return np.percentile(np.asarray(values, dtype=float), (25, 50, 75))


def median_of(values: Sequence[float], units: Sequence[Hashable], *, seed: int = 0) -> Median | None:
    """The median of values and its percentile-bootstrap interval (Efron and Tibshirani, 1993, chapter 13).

    Units are drawn with replacement, each with all its values: values of one log share its noise, and are not
    independent. With fewer than about ten units the interval is too short.

    Args:
        values: the numbers.
        units: of each value; equal for values that belong together.
        seed: random seed of the resampling; the same values give the same interval.

    Returns:
        None where there are no values.
    """
    if len(values) == 0:
        return None
    numbers = np.asarray(values, dtype=float)
    members: dict[Hashable, list[float]] = {}
    for value, unit in zip(values, units, strict=True):
        members.setdefault(unit, []).append(value)
    median, count = float(np.median(numbers)), len(members)
    if count < 2:
        return Median(median, None, None, len(numbers))
    rng = np.random.default_rng(seed)
    if count == len(numbers):
        step = max(1, _AT_ONCE // count)
        sizes = [min(step, RESAMPLES - begin) for begin in range(0, RESAMPLES, step)]
        medians = np.concatenate([np.median(numbers[rng.integers(count, size=(k, count))], axis=1) for k in sizes])
    else:
        groups = [np.array(group, dtype=float) for group in members.values()]
        draws = (rng.integers(count, size=count) for _ in range(RESAMPLES))
        medians = np.array([np.median(np.concatenate([groups[k] for k in draw])) for draw in draws])
    low, high = np.percentile(medians, (50 * (1 - LEVEL), 50 * (1 + LEVEL)))
    return Median(median, float(low), float(high), len(numbers))
