"""The densities of landmarks and false sightings, and the probability of detection, with which evidence is compared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..log import Log
from ..models import SensorModel

#: the share of sightings that the estimated field of view holds
HELD = 0.98
#: a landmark should be seen only well within the limits of the field
INSIDE = 0.9
#: the least share of clutter
LEAST_CLUTTER = 0.01
#: a landmark is seen so many times, at least, before the log is known: so much rarer is its first sighting
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
