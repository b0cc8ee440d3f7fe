"""The orientations psi of sightings: whether the heading of a landmark stays, or stays better with another meaning of psi."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..log import Log
from ..se2 import Array, wrap
from .ids import Finding
from .readings import comparable

#: another meaning is reported where the headings change by more than the first number [rad, median], by it below the second
#: part of that, and less for more than the third part of the pairs
_WRONG, _BETTER, _SHARE = 0.1, 0.4, 0.65
#: headings that change by more, at chance pi / 2, say nothing
_NOTHING = 1.0


def orientations_of(log: Log) -> Iterator[Finding]:
    """Another meaning of psi that fits far better, or that psi says nothing; the odometry has to fit the sightings."""
    if not log.has_orientation or (pairs := comparable(log)) is None or pairs.long:
        return
    psi = log.sightings[:, 2]
    if np.ptp(psi) == 0:
        yield Finding(
            "orientation",
            f"all orientations are {psi[0] + 0.0:g} rad, so that the sensor probably does not measure them: leave out their "
            "column",
        )
        return
    theta, phi, psi = pairs.poses[..., 2], pairs.sightings[..., 1], psi[np.stack([pairs.first, pairs.second])]
    given = _change(theta + phi - psi)
    others = {
        "the orientations are the headings of landmarks in the axes of the robot, m_theta - theta": theta + psi,
        "the orientations have the opposite sign, m_theta - theta - phi": theta + phi + psi,
        "the orientations are the headings of landmarks in the axes of the world, m_theta": psi,
    }
    if np.max(np.abs(psi)) <= np.pi**2 / 90:
        others["the orientations are in radians and were read as degrees"] = theta + phi - psi * 180 / np.pi
    changes = {message: _change(headings) for message, headings in others.items()}
    best = min(changes, key=lambda message: float(np.median(changes[message])))
    before, after = float(np.median(given)), float(np.median(changes[best]))
    if before > _WRONG and after < _BETTER * before and np.mean(changes[best] < given) > _SHARE:
        how = (
            "state the unit" if "radians" in best else "make them psi = theta + phi - m_theta or leave out their column"
        )
        yield Finding(
            "orientation",
            f"{best}: read like this, the heading of a landmark changes by {after:.2g} instead of {before:.2g} rad over "
            f"short ways (median); {how}",
        )
    elif before > _NOTHING:
        yield Finding(
            "orientation",
            f"the orientations say nothing: over short ways the heading of a landmark changes by {before:.2g} rad (median); "
            "they may be in another unit, or not be psi = theta + phi - m_theta; correct them or leave out their column",
        )


def _change(headings: Array) -> Array:
    """The change (K,) of headings (2, K)."""
    return np.abs(wrap(headings[1] - headings[0]))
