"""Units and signs of the numbers of a log: sizes, whether the odometry predicts the next sighting of a landmark, and psi.

Pairs of sightings of one landmark are compared with the odometry between them. From the first sighting the odometry
predicts the second. If another reading of the numbers (bearings with the other sign, turn rates in degrees, ...)
predicts far better, that is the likely cause. No graph is solved: a landmark has to stay where it is over a short
way already, which takes milliseconds and depends on no noise model.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import checks, decimals
from ..log import Log
from ..log.cells import nothing_measured
from ..log.rows import UNIDENTIFIED
from ..models import MotionModel, SensorModel
from ..se2 import Array, between, wrap
from .ids import Finding

#: way between the two sightings of a pair, [rad] turned plus [ranges] driven: at least, at most
_LEAST, _MOST = 0.4, 1.5
#: pairs with a larger turn [rad] show the sign of bearings
_TURNING = 0.1
#: pairs that are needed, and that are used at most
_FEWEST, _ENOUGH = 20, 4000
#: another reading is reported where the median error of the pairs [ranges] is above the first number, and with this reading
#: below the second part of that and smaller for more than the third part of the pairs
_WRONG, _BETTER, _SHARE = 0.08, 0.5, 0.65
#: the same part for fixed axes: at most 0.18 where the sightings have them (30 drives), and at least 0.28 where the turn rate
#: is very noisy, so that a robot that does not turn fits better (8 drives)
_BETTER_FIXED = 0.22
#: readings whose errors differ by less than this factor fit alike
_ALIKE = 1.3
#: a smaller unit is reported if it fits better than no motion: where the two differ by more than the first number [ranges],
#: its median error is below the second part of that
_DIFFERS, _MOVES = 0.1, 0.7
#: the same for revolutions per minute, which are rare: 0.05 to 0.31 where they are the unit, and 0.56 or more where the turn
#: rate has a noise of 2 rad/s, of which a tenth looks like motion (18 drives)
_TURNS_LIKE = 0.45
#: sightings that no reading fits better than this [ranges] contradict the odometry
_CONTRADICTION = 0.4
#: another meaning of psi is reported where the headings change by more than the first number [rad, median], by it below the
#: second part of that, and less for more than the third part of the pairs
_TURNS, _STAYS, _MOSTLY = 0.1, 0.4, 0.65
#: headings that change by more, at chance pi / 2, say nothing
_NOTHING = 1.0
#: the check that finds sightings in axes that do not turn with the robot, and its message
FIXED = "fixed axes"
_FIXED_AXES = (
    "bearings, or x and y, of the sightings are in the axes of the world, which do not turn with the robot: give them in "
    "those of the robot, subtract its heading"
)
#: a degree per second, and a revolution per minute [rad/s]
DEGREE, RPM = float(np.pi / 180), float(np.pi / 30)


@dataclass(frozen=True)
class Reading:
    """Another way to read a log.

    Attributes:
        check, message: as in a `Finding`.
        given, error: median error of the pairs as the log stands, and read like this, relative to the range.
        share: of the pairs for which this reading is better.
        slower: the factors of speed and turn rate, where one is below 1.
    """

    check: str
    given: float
    error: float
    share: float
    message: str
    slower: tuple[float, float] = (1.0, 1.0)


def readings_of(log: Log) -> Iterator[Finding]:
    """The other reading that fits far better, or that none fits."""
    if (pairs := comparable(log)) is None:
        return
    readings = pairs.readings()
    wrong = [each for each in readings if each.given > _WRONG]
    part = {FIXED: _BETTER_FIXED}
    better = [each for each in wrong if each.error < part.get(each.check, _BETTER) * each.given and each.share > _SHARE]
    if pairs.long:
        better = [each for each in better if min(each.slower) < 1]
    likely = [each for each in better if _moves_like(log, each.slower)]
    given = max(each.given for each in readings)
    if likely:
        least = min(reading.error for reading in likely)
        # of readings that fit about as well, the plain one: a quarter turn before one of 75 degrees, a clock later, and last
        # fixed axes, which are those of a turned sensor where the robot drives straight on
        best = min(
            (reading for reading in likely if reading.error <= _ALIKE * least),
            key=lambda each: (each.check == FIXED, "about" in each.message, each.check == "clock", each.error),
        )
        times = f"{best.given / best.error:.1f}" if best.error > 0 else "infinitely many"
        yield Finding(best.check, f"{best.message}: read like this, they fit the odometry {times} times better")
    elif pairs.long:
        return
    elif better:
        turns = min(better, key=lambda reading: reading.error).slower[1] < 1
        yield Finding(
            "odometry noise",
            "over short ways a robot that does not turn fits the sightings better than the recorded turn rates: they are "
            "very noisy, wheels slip, or rows of the odometry have wrong times"
            if turns
            else "over short ways a robot that only turns fits the sightings better than the recorded speeds: they are very "
            "noisy, wheels slip, rows of the odometry have wrong times, or the sightings have other axes",
        )
    elif given > _CONTRADICTION:
        what = (
            f"sightings contradict the odometry: over short ways a landmark moves by {given:.0%} of its range (median)"
        )
        cause = "ids, clocks, units or axes may be wrong"
        yield Finding("contradiction", f"{what}; {cause}")


def _moves_like(log: Log, slower: tuple[float, float]) -> bool:
    """Whether smaller units fit better than no motion, over ways that are short in these units."""
    if min(slower) == 1:
        return True
    pairs = pairs_of(log, slower=1 / slower[0], turning=slower[1])
    return pairs is not None and pairs.move_like(slower)


@dataclass(frozen=True)
class SightingPairs:
    """Pairs of sightings of one landmark, over short ways.

    Attributes:
        log: whose they are.
        first, second: (K,) rows of the sightings.
        long: whether ways are short in other units alone. As the log stands they are long, and drift is no mistake.
    """

    log: Log
    first: np.ndarray
    second: np.ndarray
    long: bool = False

    @cached_property
    def sightings(self) -> Array:
        """Range and bearing of the first and second sightings (2, K, 2)."""
        return self.log.sightings[np.stack([self.first, self.second]), :2]

    @cached_property
    def steps(self) -> np.ndarray:
        """The steps of the first and second sightings (2, K)."""
        return self.log.steps[np.stack([self.first, self.second])]

    @cached_property
    def path(self) -> Array:
        """Dead reckoning (S+1, 3) at the ends of all controls."""
        return self._path([1.0, 1.0])

    @property
    def poses(self) -> Array:
        """The poses of dead reckoning at the first and second sightings (2, K, 3)."""
        return self.path[self.log.control_starts[self.steps]]

    def readings(self) -> list[Reading]:
        """Every other reading of the log."""
        poses = self.poses
        sensor = self.log.sensor or SensorModel()
        as_given = moves(sensor, poses, self.sightings)
        turning = np.abs(poses[1, :, 2] - poses[0, :, 2]) > _TURNING
        readings = []
        for check, message, changed_poses, changed_sightings, *slower in self._others(poses):
            errors = moves(sensor, changed_poses, changed_sightings)
            # where the robot drives straight on, both signs fit
            used = turning if check == "bearing sign" and np.sum(turning) >= _FEWEST else slice(None)
            before, after = as_given[used], errors[used]
            share = float(np.mean(after < before))
            given, error = float(np.median(before)), float(np.median(after))
            readings.append(Reading(check, given, error, share, message, *slower))
        return readings

    def move_like(self, slower: Sequence[float]) -> bool:
        """Whether the odometry with these factors of speed and turn rate fits better than one that does not move.

        Where odometry is so noisy that a robot at rest fits better, any smaller unit of it does.
        """
        still = [factor if factor == 1 else 0.0 for factor in slower]
        errors, places = [], []
        for factors in (slower, still):
            first, second = self._path(factors)[self.log.control_starts[self.steps]]
            poses = np.stack([np.zeros_like(first), between(first, second)])
            sensor = self.log.sensor or SensorModel()
            errors.append(moves(sensor, poses, self.sightings))
            places.append(sensor.h_inverse(poses[1], self.sightings[1]))
        apart = np.linalg.norm(places[0] - places[1], axis=1) / np.maximum(*self.sightings[:, :, 0]) > _DIFFERS
        if np.sum(apart) < _FEWEST:
            return False
        least = _TURNS_LIKE if slower[1] == RPM else _MOVES
        return bool(np.median(errors[0][apart]) < least * np.median(errors[1][apart]))

    def _path(self, factors: ArrayLike, order: slice = slice(None)) -> Array:
        """The poses (S+1, 3) at the ends of all controls, of which the columns are reordered and multiplied."""
        controls, dt = self.log.controls, self.log.dt
        assert controls is not None and dt is not None
        return MotionModel().dead_reckoning(self.log.initial_poses[0], controls[:, order] * factors, dt)

    def _others(self, poses: Array) -> Iterator[tuple[Any, ...]]:
        """For each other reading the name of its check, its message, and the poses (2, K, 3) and sightings (2, K, 2).

        Of smaller units also the factors of speed and turn rate.
        """
        starts, z = self.log.control_starts[self.steps], self.sightings
        for sign in (1, -1):
            for degrees in range(-165, 181, 15):
                if (sign, degrees) != (1, 0):
                    yield *_direction(sign, degrees), poses, z * [1, sign] + [0.0, np.deg2rad(degrees)]
        # no sensor sees three degrees to each side only; slower turns would fit such bearings, too
        if np.max(np.abs(z[..., 1])) <= np.pi * np.pi / 180:
            stated = "the bearings are in radians and were read as degrees (angles='sightings=radians')"
            yield "bearing unit", stated, poses, z * [1.0, 180 / np.pi]
        else:
            for factor, slowly in (
                (DEGREE, "the turn rates are in degrees per second (angles='odometry=degrees')"),
                (RPM, f"the turn rates are in revolutions per minute: multiply their column by {RPM:.4f}"),
            ):
                yield "turn rate unit", slowly, self._path((1.0, factor))[starts], z, (1.0, factor)
        swapped = "the columns of speed and turn rate are swapped (columns='odometry.nu=NAME,odometry.omega=NAME')"
        yield "odometry swapped", swapped, self._path([1.0, 1.0], slice(None, None, -1))[starts], z
        for factor, message in (
            (1 / 1000, "the speeds are in mm/s"), (1 / 100, "the speeds are in cm/s"), (1 / 3.6, "the speeds are in km/h"),
            (1 / 0.3048, "the ranges are in feet"), (100.0, "the ranges are in cm"), (1000.0, "the ranges are in mm"),
        ):  # fmt: skip
            scaled = poses * [factor, factor, 1.0]
            yield "scale", f"{message}, against the other lengths", scaled, z, (min(factor, 1.0), 1.0)
        yield from self._clocks(starts)
        # the direction of fixed axes is not known in dead reckoning
        unturned = poses * [1.0, 1.0, 0.0]
        for sign in (1, -1):
            for degrees in range(-165, 181, 15):
                yield FIXED, _FIXED_AXES, unturned, z * [1, sign] + [0.0, np.deg2rad(degrees)]

    def _clocks(self, starts: np.ndarray) -> Iterator[tuple[str, str, Array, Array]]:
        """The sightings read as later or earlier."""
        times = self.log.control_times
        for late in (0.1, 0.2, 0.3, 0.5, 0.8, 1.2, 2.0, 3.0):
            for shift in (-late, late):
                moved = np.stack([np.interp(times[starts] + shift, times, column) for column in self.path.T], axis=-1)
                message = f"the clock of the sightings is about {late:g} s {'fast' if shift < 0 else 'slow'}"
                yield "clock", f"{message} (clocks='sightings={shift:g}')", moved, self.sightings


def moves(sensor: SensorModel, poses: Array, sightings: Array) -> Array:
    """The distance (K,) [ranges] between the landmarks of two sightings (2, K, 2) from poses (2, K, 3)."""
    first, second = sensor.h_inverse(poses, sightings)
    return np.linalg.norm(first - second, axis=1) / np.maximum(*sightings[:, :, 0])


def _direction(sign: int, degrees: int) -> tuple[str, str]:
    """The name of the check, and the finding about a sensor whose bearings b are read as sign * b + degrees."""
    yaw = f"sensor_yaw={np.deg2rad(degrees):.4f}"
    if (sign, degrees) == (-1, 0):
        return "bearing sign", "the bearings, or else the turn rates, have the wrong sign (bearings='clockwise')"
    if (sign, degrees) == (-1, 90):
        others = f"or bearings count clockwise from the left (bearings='clockwise', {yaw})"
        return "axes swapped", f"x and y of the sightings are swapped (axes='left-forward'), {others}"
    if sign < 0:
        message = f"bearings grow clockwise, from about {degrees} degrees left of ahead (bearings='clockwise', {yaw})"
        return "bearing sign", message.replace("about ", "") if degrees % 90 == 0 else message
    if degrees == 180:
        return "sensor direction", f"the sensor looks to the back ({yaw}), or the speeds have the wrong sign"
    side = "left" if degrees > 0 else "right"
    about = "" if degrees % 90 == 0 else "about "
    return "sensor direction", f"the sensor looks {about}{abs(degrees)} degrees to the {side} ({yaw})"


def comparable(log: Log) -> SightingPairs | None:
    """The pairs of a log as it stands, or else read with other units; None where nothing can be compared."""
    # at a thousandth of the speed, or with turn rates in rpm or degrees, there may be short ways
    for slower, turning in ((1.0, 1.0), (1000.0, 1.0), (1.0, RPM), (1.0, DEGREE), (1000.0, DEGREE)):
        if (pairs := pairs_of(log, slower=slower, turning=turning)) is not None:
            return replace(pairs, long=turning != 1 or slower != 1)
    return None


def pairs_of(log: Log, *, slower: float = 1.0, turning: float = 1.0) -> SightingPairs | None:
    """Pairs of sightings of one landmark over short ways; None where there are too few, or no controls.

    Args:
        log: the log.
        slower: ways are measured as if the speed was smaller by this factor.
        turning: ways are measured as if the turn rates were smaller by this factor, such as `DEGREE`.
    """
    if log.controls is None or log.dt is None or len(log.sightings) < 2:
        return None
    middle = float(np.median(log.sightings[:, 0]))
    driven = np.abs(log.controls) @ [1 / (slower * middle), turning] * log.dt
    # in a wrong unit a single control may seem to lead too far: the limits then grow with what is typical of one
    if (typical := float(np.median(driven[driven > 0]) if np.any(driven > 0) else 0.0)) == 0:
        return None
    way = np.concatenate([[0.0], np.cumsum(driven)])[log.control_starts]
    least = _LEAST if typical < _MOST else _LEAST * typical / _MOST
    order = np.lexsort((log.steps, log.landmarks))
    order = order[log.landmarks[order] != UNIDENTIFIED]
    # one number that grows along the way, landmark after landmark
    rank = np.unique(log.landmarks[order], return_inverse=True)[1]
    apart = way[-1] + 10 * _MOST + 1
    along = rank * apart + way[log.steps[order]]
    later = np.searchsorted(along, along + least)
    exists = later < len(order)
    first, second = np.flatnonzero(exists), later[exists]
    good = (along[second] - along[first] <= max(_MOST, 3 * least)) & (rank[first] == rank[second])
    first, second = order[first[good]], order[second[good]]
    if len(first) < _FEWEST:
        return None
    every = max(1, len(first) // _ENOUGH)
    return SightingPairs(log, first[::every], second[::every])


def orientations_of(log: Log) -> Iterator[Finding]:
    """Another meaning of psi that fits far better, or that psi says nothing; the odometry has to fit the sightings."""
    if not log.has_orientation or (pairs := comparable(log)) is None or pairs.long:
        return
    psi = log.sightings[:, 2]
    if np.ptp(psi) == 0:
        same = f"all orientations are {psi[0] + 0.0:g} rad, so that the sensor probably does not measure them"
        advice = "leave out their column"
        yield Finding("orientation", f"{same}: {advice}")
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
    if before > _TURNS and after < _STAYS * before and np.mean(changes[best] < given) > _MOSTLY:
        how = (
            "state the unit" if "radians" in best else "make them psi = theta + phi - m_theta or leave out their column"
        )
        heading = "read like this, the heading of a landmark"
        change = f"changes by {after:.2g} instead of {before:.2g} rad over short ways (median)"
        yield Finding("orientation", f"{best}: {heading} {change}; {how}")
    elif before > _NOTHING:
        yield Finding(
            "orientation",
            f"the orientations say nothing: over short ways the heading of a landmark changes by {before:.2g} rad (median); "
            "they may be in another unit, or not be psi = theta + phi - m_theta; correct them or leave out their column",
        )


def _change(headings: Array) -> Array:
    """The change (K,) of headings (2, K)."""
    return np.abs(wrap(headings[1] - headings[0]))


def sizes(log: Log) -> Iterator[Finding]:
    """Ranges, speeds, turn rates and times that no robot has, and a log of a single pose; no checks that are answered."""
    answered = {check for check, message in log.doubts if not message}
    yield from (each for each in _sizes(log) if each.check not in answered)


def _sizes(log: Log) -> Iterator[Finding]:
    yield from single_pose(log)
    if len(log.sightings) and (far := float(np.median(log.sightings[:, 0]))) > checks.FARTHEST:
        yield Finding("range unit", f"half of the ranges are above {decimals(far, 0)} m; they may be in millimetres")
    yield from (Finding(*doubt) for doubt in nothing_measured(log.sightings[:, 0]))
    if log.controls is None or log.dt is None or len(log.controls) == 0:
        return
    speed, turn = np.quantile(np.abs(log.controls), 0.95, axis=0)
    if speed > checks.FASTEST:
        yield Finding("speed unit", f"the speed reaches {decimals(speed, 0)} m/s; it may be in mm/s")
    within = float(np.median(np.abs(log.controls[:, 1]) * log.dt))
    if turn > checks.QUICKEST or within > np.pi:
        yield Finding("turn rate unit", f"the turn rate reaches {turn:.1f} rad/s; it may be in degrees per second")
    if (lasting := float(np.median(log.dt))) > checks.LONGEST:
        yield Finding("time unit", f"controls last {lasting:g} s (median); the times may be in milliseconds")
    if not np.any(log.controls):
        yield Finding("no motion", "all controls are zero; the odometry may be another column or topic")


def single_pose(log: Log) -> Iterator[Finding]:
    """Whether there is no motion at all."""
    if log.num_poses == 1:
        yield Finding(
            "single pose",
            "the log has a single pose: there is no motion, and without a map nothing to estimate, so that convergence, "
            "proofs and expected errors mean nothing; the rows may all have the same time",
        )
