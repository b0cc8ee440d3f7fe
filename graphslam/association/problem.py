"""What an association of sightings without ids is given: log, options, densities, classes, and ids that are known.

Some sightings may have ids: those with one id are of one landmark, and no landmark has two ids. Labels are first found as if
no sighting had an id, and `held` then changes them to agree with the ids.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import LogError
from ..errors.checks import check_options, option
from ..log import UNIDENTIFIED, Log
from ..log.measurements import PartialSightings
from ..log.rows import MOST_CLASSES
from ..maps.map_evidence import log_sum
from ..models import SensorModel
from ..se2 import Array

#: how the sightings of one scan are assigned to landmarks
METHODS = ("joint", "nearest")


@dataclass(frozen=True, kw_only=True)
class AssociationOptions:
    """How `fastslam.associate` decides which sightings are of the same landmark.

    Raises:
        OptionError: an option has an impossible value.
    """

    method: str = option(
        "joint", "Assign the sightings of a scan jointly (joint compatibility), or each to its nearest landmark.",
        choices=METHODS,
    )  # fmt: skip
    gate: float = option(
        0.999, "Share of correct sightings that lie within the gate of their landmark", positive=True, below=1
    )
    clutter: float = option(
        0.05, "Share of sightings that are of no landmark, before the log is known", positive=True, below=1
    )
    factor: float = option(
        100.0,
        "A decision between two landmarks is called ambiguous where the evidence for the better one is less than this",
        minimum=1,
    )
    confusion: float = option(
        0.05, "Probability that the class of a sighting is wrong, where the log has classes", positive=True, below=1
    )
    keep_ids: bool = option(True, "Keep the ids that some sightings of a log have, where others have none")
    window: int = option(
        30, "Steps between two solutions of the graph along the drive; more on long logs", minimum=1, maximum=2**31 - 1
    )
    rounds: int = option(10, "The most rounds of association and solving, in turn, at the end", minimum=0)
    slip: bool = option(True, "Raise the noise sideways of motions where the robot slips over long ways")
    tries: int = option(
        40, "The most alternatives that are tried in full where some are not much less likely", minimum=0
    )
    agreeing: int = option(
        2, "Of several starts, the others are left out once this many of them end alike; 0: none is", minimum=0
    )

    def __post_init__(self) -> None:
        check_options(self)


#: the least probability of a class
LEAST = 1e-300


@dataclass(frozen=True, eq=False)
class Classes:
    """The classes of the sightings of a log, such as the colours of cones; n = 1 where it has none.

    A sighting shows the class of its landmark, or, with the probability of confusion, any of the others. With n classes and
    the counts of the classes that a landmark's sightings have shown, p(c) is the probability that it is of class c, and the
    sighting's class k has the probability sum over c of p(c) P(k given c). Divided by 1/n, that of a new landmark, this is
    the factor on the evidence. A sighting whose class is not known has the factor 1.

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
            have = f"the sightings of {log.name} have {n} different classes, and at most {MOST_CLASSES} can be used"
            advice = "are they ids? Then give them as landmarks; else leave them out: log.replace(classes=None)"
            raise LogError(f"{have}: {advice}")
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
        one, first, second = (log_sum(each, axis=-1) for each in (a + b, a, b))
        return one - first - second + np.log(self.count)


#: the share of the sightings that lie within the estimated field of view
HELD = 0.98
#: a landmark should be seen only well within the limits of the field
INSIDE = 0.9
#: the least share of clutter
LEAST_CLUTTER = 0.01
#: assumed number of sightings of a landmark, before the log is known: its first sighting is rarer by this factor
SIGHTINGS = 20
#: limits of the estimated probability of detection
DETECTION = (0.3, 0.98)


@dataclass(frozen=True)
class Field:
    """The field of view of the sensor: ranges [m], and bearings of at most ``bearing`` [rad] to each side."""

    nearest: float
    farthest: float
    bearing: float

    @classmethod
    def of(cls, log: Log, sensor: SensorModel) -> Field:
        """The limits of the sensor, and where it has none those that hold nearly all sightings."""
        ranges, bearings = log.sightings[:, 0], np.abs(log.sightings[:, 1])
        low, high = np.quantile(ranges, [1 - HELD, HELD])
        return cls(
            max(float(low), sensor.min_range), min(float(high), sensor.max_range),
            min(float(np.quantile(bearings, HELD)) + sensor.bearing_std, sensor.field_of_view / 2),
        )  # fmt: skip

    @property
    def area(self) -> float:
        """The area of the field of view [m²]."""
        return max(self.bearing, 0.05) * max(self.farthest**2 - self.nearest**2, 1e-6)


@dataclass(frozen=True)
class Densities:
    """Logarithms of densities per m² (and rad, where sightings have psi), and of the probabilities of detection and miss."""

    new: float
    clutter: float
    seen: float
    missed: float

    @classmethod
    def of(cls, log: Log, field: Field, clutter: float, detection: float = 0.9) -> Densities:
        """Densities from the number of sightings in a scan, of which a share is clutter."""
        scans = max(len(np.unique(log.steps)), 1)
        volume = field.area * (2 * np.pi if log.has_orientation else 1.0)
        density = len(log.steps) / scans / volume
        return cls(np.log(density), np.log(clutter * density), np.log(detection), np.log(1 - detection))

    def counted(self, seen: int, views: int, clutter: float) -> Densities:
        """With the probability of detection from how many of the views led to a sighting, and with this share of clutter.

        ``new`` stays the density of all sightings of a scan, of which clutter is a part.
        """
        share = float(np.clip(seen / max(views, 1), *DETECTION))
        return Densities(self.new, self.new + np.log(max(clutter, LEAST_CLUTTER)), np.log(share), np.log1p(-share))

    @classmethod
    def mean(cls, densities: list[Densities]) -> Densities:
        """The means of several, by which associations with each of them are compared."""
        new, clutter = (float(np.mean([getattr(each, name) for each in densities])) for name in ("new", "clutter"))
        detection = float(np.mean([np.exp(each.seen) for each in densities]))
        return cls(new, clutter, float(np.log(detection)), float(np.log1p(-detection)))

    @property
    def weight(self) -> float:
        """w of a candidate in a scan: log of the probability of detection over the density of what is new or clutter."""
        return self.seen - float(np.logaddexp(self.new - np.log(SIGHTINGS), self.clutter))


def numbered(landmarks: np.ndarray) -> np.ndarray:
    """The ids (M,) numbered from 0, -1 where there is none."""
    ids, which = np.unique(landmarks, return_inverse=True)
    return which - np.count_nonzero(ids == UNIDENTIFIED)


def id_of_each(labels: np.ndarray, known: np.ndarray, count: int) -> np.ndarray:
    """The id (count,) that most sightings with each label have, of labels (m,) and ids ``known`` (m,); -1 for none."""
    fixed = (known >= 0) & (labels >= 0)
    pairs, votes = np.unique(np.column_stack([labels[fixed], known[fixed]]), axis=0, return_counts=True)
    order = np.argsort(votes, kind="stable")
    ids = np.full(count, -1)
    ids[pairs[order, 0]] = pairs[order, 1]
    return ids


def held(labels: np.ndarray, known: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """The labels (M,) changed to agree with the ids ``known`` (M,), -1 for none.

    A landmark of which some sightings have ids gets the id that most of them have. Other sightings of
    the scan, by their ``steps`` (M,), are then not of it.
    """
    fixed = known >= 0
    if not fixed.any():
        return labels
    base = int(labels.max(initial=-1)) + 1
    of_label = id_of_each(labels, known, base + 1)
    # the last entry is for label -1
    renamed = np.where(of_label < 0, np.append(np.arange(base), -1), base + of_label)[labels]
    renamed[fixed] = base + known[fixed]
    place = steps * (int(renamed.max()) + 2) + renamed
    renamed[~fixed & np.isin(place, place[fixed])] = -1
    return renamed


def agree(labels: np.ndarray, known: np.ndarray) -> bool:
    """Whether all sightings with one id ``known`` (M,) that have labels (M,) have the same one, and no label has two ids."""
    fixed = (known >= 0) & (labels >= 0)
    pairs = np.unique(np.column_stack([labels[fixed], known[fixed]]), axis=0)
    return len(pairs) == len(np.unique(pairs[:, 0])) == len(np.unique(pairs[:, 1]))


def names(labels: np.ndarray, landmarks: np.ndarray, single: PartialSightings | None) -> np.ndarray:
    """The id (L,) of each label 0 to L - 1 (M,): that of its sightings in ``landmarks`` (M,), else one above all of these.

    It is also above the ids of landmarks with ranges or bearings alone, which are others.
    """
    fixed = (landmarks != UNIDENTIFIED) & (labels >= 0)
    found = np.full(int(labels.max(initial=-1)) + 1, UNIDENTIFIED)
    found[labels[fixed]] = landmarks[fixed]
    new = found == UNIDENTIFIED
    taken = np.append(landmarks[fixed], np.zeros(0, dtype=np.int64) if single is None else single.landmarks)
    found[new] = int(taken.max(initial=-1)) + 1 + np.arange(np.count_nonzero(new))
    return found


def may_be_one(first: int, second: int) -> bool:
    """Whether landmarks with these ids, -1 for none, can be one."""
    return first < 0 or second < 0 or first == second
