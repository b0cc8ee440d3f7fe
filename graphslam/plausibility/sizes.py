"""Numbers that are too large for their unit, or all zero."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..errors import decimals
from ..log import Log
from ..se2 import Array
from .finding import Finding

#: beyond these values numbers are probably in another unit: range [m], speed [m/s], turn rate [rad/s], time of a control [s]
FARTHEST, FASTEST, QUICKEST, SLOWEST = 1000.0, 100.0, 2 * np.pi, 5.0
#: a sensor that reports one range where it measures nothing: of how many sightings, how often, how far beyond other ranges
ENOUGH, REPEATED, BEYOND = 20, 3, 1.2


def sizes(log: Log) -> Iterator[Finding]:
    """Ranges, speeds, turn rates and times that no robot has."""
    if len(log.sightings) and (far := float(np.median(log.sightings[:, 0]))) > FARTHEST:
        yield Finding("range unit", f"half of the ranges are above {decimals(far, 0)} m; they may be in millimetres")
    yield from nothing_measured(log.sightings[:, 0])
    if log.controls is None or log.dt is None or len(log.controls) == 0:
        return
    speed, turn = np.quantile(np.abs(log.controls), 0.95, axis=0)
    if speed > FASTEST:
        yield Finding("speed unit", f"the speed reaches {decimals(speed, 0)} m/s; it may be in mm/s")
    within = float(np.median(np.abs(log.controls[:, 1]) * log.dt))
    if turn > QUICKEST or within > np.pi:
        yield Finding("turn rate unit", f"the turn rate reaches {turn:.1f} rad/s; it may be in degrees per second")
    if (lasting := float(np.median(log.dt))) > SLOWEST:
        yield Finding("time unit", f"controls last {lasting:g} s (median); the times may be in milliseconds")
    if not np.any(log.controls):
        yield Finding("no motion", "all controls are zero; the odometry may be another column or topic")


def nothing_measured(ranges: Array) -> Iterator[Finding]:
    """The largest range (of N), where it repeats exactly and no other range is near: 9999 or 65.535, for example."""
    values, counts = np.unique(ranges, return_counts=True)
    enough = len(ranges) >= ENOUGH and len(values) > 1 and counts[-1] >= REPEATED
    if enough and values[-1] > BEYOND * values[-2]:
        yield Finding(
            "range without measurement",
            f"{counts[-1]} sightings have the same range of {values[-1]:g} m, and all others are below {values[-2]:.3g} m; "
            "the sensor may report it where it measures nothing. Remove these rows",
        )
