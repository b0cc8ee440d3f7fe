"""The median with its bootstrap interval: how far it would move if the logs had been drawn anew."""

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
        low, high: the interval; None where there is but one unit to draw from.
        count: how many values there are.
    """

    median: float
    low: float | None
    high: float | None
    count: int


def median_of(values: Sequence[float], units: Sequence[Hashable], seed: int = 0) -> Median | None:
    """The median of values and its percentile-bootstrap interval (Efron and Tibshirani, 1993, chapter 13).

    What is drawn anew, with replacement, are the units, each with all its values: values of one log share its noise, so
    they must not pass for independent ones. With fewer than about ten units the interval is too short.

    Args:
        values: the numbers.
        units: of each value; equal for values that belong together.
        seed: of the resampling: the same values give the same interval.

    Returns:
        None where there are no values.
    """
    if len(values) == 0:
        return None
    numbers = np.asarray(values, dtype=float)
    members: dict[Hashable, list[int]] = {}
    for index, unit in enumerate(units):
        members.setdefault(unit, []).append(index)
    median = float(np.median(numbers))
    if len(members) < 2:
        return Median(median, None, None, len(numbers))
    resampled = _resampled_medians(numbers, list(members.values()), np.random.default_rng(seed))
    low, high = np.percentile(resampled, (50 * (1 - LEVEL), 50 * (1 + LEVEL)))
    return Median(median, float(low), float(high), len(numbers))


def _resampled_medians(numbers: Array, members: list[list[int]], rng: np.random.Generator) -> Array:
    count = len(members)
    if all(len(indices) == 1 for indices in members):
        step = max(1, _AT_ONCE // count)
        sizes = [min(step, RESAMPLES - begin) for begin in range(0, RESAMPLES, step)]
        return np.concatenate([np.median(numbers[rng.integers(count, size=(k, count))], axis=1) for k in sizes])
    units = [numbers[indices] for indices in members]
    drawn = (rng.integers(count, size=count) for _ in range(RESAMPLES))
    return np.array([np.median(np.concatenate([units[k] for k in chosen])) for chosen in drawn])
