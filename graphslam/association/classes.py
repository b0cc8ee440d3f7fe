"""Classes of sightings, such as the colour of a cone: the log likelihood ratio that a class gives to a landmark.

A sighting shows the class of its landmark, or, with the probability of confusion, any of the others. With n classes and
the counts of the classes that a landmark's sightings have shown, p(c) is the probability that it is of class c, and the
sighting's class k has the probability sum over c of p(c) P(k given c). Against 1/n, that of a new landmark, this is the
factor on the evidence. A sighting whose class is not known has the factor 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import LogError
from ..log import Log
from ..reading import MOST_CLASSES
from ..se2 import Array

#: a probability below this counts as this much
LEAST = 1e-300


@dataclass(frozen=True, eq=False)
class Classes:
    """The classes of the sightings of a log; n = 1 where it has none.

    Attributes:
        shown: (M,) the class of each sighting as a number from 0 to n - 1; n where it is not known.
        log_confusion: (n, n + 1) log P(shown given true), -log n in the last column.
    """

    shown: np.ndarray
    log_confusion: Array

    @classmethod
    def of(cls, log: Log, confusion: float) -> Classes:
        """The classes of a log, and a matrix with this probability of confusion.

        Raises:
            LogError: there are more than `MOST_CLASSES`.
        """
        known = log.classified
        names, which = np.unique(() if log.classes is None else log.classes[known], return_inverse=True)
        if (n := len(names)) > MOST_CLASSES:
            raise LogError(
                f"the sightings of {log.name} have {n} different classes, and at most {MOST_CLASSES} can be used: are they "
                "ids? Then give them as landmarks; else leave them out: log.replace(classes=None)"
            )
        if n < 2:
            return cls(np.zeros(len(log.steps), dtype=np.int64), np.zeros((1, 2)))
        shown = np.full(len(log.steps), n)
        shown[known] = which
        log_confusion = np.full((n, n + 1), np.log(confusion / (n - 1)))
        np.fill_diagonal(log_confusion, np.log(1 - confusion))
        log_confusion[:, n] = -np.log(n)
        return cls(shown, log_confusion)

    @property
    def count(self) -> int:
        """The number n of classes."""
        return len(self.log_confusion)

    def sums(self, group: np.ndarray, rows: np.ndarray, groups: int) -> Array:
        """The sum (groups, n) of log P(shown given true) over the sightings in rows (k,) of each group (k,)."""
        total = np.zeros((groups, self.count))
        np.add.at(total, group, self.of_sightings(rows))
        return total

    def of_sightings(self, rows: np.ndarray) -> Array:
        """log P(shown given true) (k, n) of the sightings in rows (k,)."""
        return self.log_confusion[:, self.shown[rows]].T

    def together(self, a: Array, b: Array) -> Array:
        """log of P(both | one landmark) / (P(a) P(b)) for sums (..., n), broadcast; 0 where there are no classes."""
        if self.count == 1:
            return np.zeros(np.broadcast_shapes(a.shape, b.shape)[:-1])
        one, first, second = (np.logaddexp.reduce(each, axis=-1) for each in (a + b, a, b))
        return one - first - second + np.log(self.count)
