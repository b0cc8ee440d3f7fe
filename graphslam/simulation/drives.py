"""`Drive`: a simulated recording of an uncalibrated robot, as a `Log` like one from tables, and its truth.

`graphslam.simulate` is the simulator of the book: one step per control, and noise as the lectures have it. Here odometry
and sensor have their own rates, the robot works in a warehouse, an orchard or a field, and its recording has what real ones
have: scale errors and biases, a late sensor that is not where it should be, misread ids, clutter, errors that are correlated
in time or common to a scan, inexact times, missed sightings and gaps of the sensor and of the odometry. The log has no noise
models.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import pi

import numpy as np

from ..errors import OptionError
from ..errors.checks import check_number, check_options, option
from ..identification.declared import PARAMETERS
from ..log import Log
from ..log.rows import UNIDENTIFIED
from ..log.streams import Stream, synchronize
from ..models import MotionModel, SensorModel
from ..se2 import Array
from .places import PLACES, Path, Place, follow
from .worlds import SENSORS

#: motions are exact but for their noise; the models need a variance above zero [m², rad²]
EPSILON = 1e-9
#: the standard deviation of the times between scans, as part of their interval
JITTER = 0.02
#: ids that do not exist are among so many above the true ones
SPARE_IDS = 1000
#: the part of misread ids that do not exist
NONEXISTENT = 0.03
#: the distance from the line between way points, drawn for each line [m]
WANDER = 0.15

#: how widely `Drive.random` draws each bias: prior standard deviations for whoever knows that much and no more. The scale of
#: ranges is always right: a log does not determine a common factor on all distances.
SPREADS = {
    "wheel_scale": 0.025, "turn_scale": 0.02, "turn_rate_bias": 0.005, "curvature_bias": 0.005, "range_bias": 0.03,
    "bearing_bias": 0.02, "sensor_ahead": 0.1, "sensor_left": 0.05, "sensor_delay": 0.04,
}  # fmt: skip

#: wheels with typical noise
WHEELS = MotionModel(nn=0.015, no=0.0015, on=0.008, oo=0.015, slip=0.005, epsilon=EPSILON)


@dataclass(frozen=True)
class DriveTruth:
    """The truth behind the log of a drive; M sightings.

    Attributes:
        motion, sensor: the noise. That of the sensor is the whole variance of single sightings, correlated parts included;
            its ``offset`` is where the sensor is believed to be.
        parameters: {name of `PARAMETERS`: value}, all of them.
        landmarks: (M,) the true ids; `UNIDENTIFIED` for clutter.
        misread: (M,) whether the log has another id of a landmark that was seen.
        clutter: (M,) whether no landmark was there.
        correlated: the part of the variance whose errors are correlated in time.
        correlation_time: over which they are [s]: the correlation falls as exp(-lapse / correlation_time).
    """

    motion: MotionModel
    sensor: SensorModel
    parameters: Mapping[str, float]
    landmarks: np.ndarray
    misread: np.ndarray
    clutter: np.ndarray
    correlated: float
    correlation_time: float

    @property
    def misread_share(self) -> float:
        """The part of all sightings that is misread or clutter."""
        return float(np.mean(self.misread | self.clutter)) if len(self.misread) else 0.0


@dataclass(frozen=True, kw_only=True)
class Drive:
    """Settings of a drive; `simulate` drives it. The default is a warehouse robot with a camera, 10 minutes, 40 tags.

    Attributes:
        motion: the true noise of the odometry.
        sensor: the true noise of single sightings, and the limits of the sensor; ``offset`` is where it is believed to be.
        parameters: true values of `PARAMETERS` by their names; the others have their ideal values, and the
            place of the sensor counts from ``offset``.

    The other settings say themselves what they are, in the metadata of `dataclasses.fields`.

    Raises:
        OptionError: a setting has an impossible value.
    """

    place: str = option("warehouse", f"Place: {', '.join(PLACES)}", choices=tuple(PLACES))
    seed: int = option(0, "Random seed", minimum=0)
    duration: float = option(600.0, "Duration of the drive", "s", positive=True)
    speed: float = option(1.4, "Highest speed", "m/s", positive=True)
    turn_rate: float = option(1.0, "Highest turn rate", "rad/s", positive=True)
    landmarks: int = option(40, "Number of landmarks", minimum=4)
    orientation: bool = option(False, "Sightings have the orientation psi")
    odometry_rate: float = option(50.0, "Rows of odometry per second", "Hz", positive=True)
    sensor_rate: float = option(10.0, "Scans per second", "Hz", positive=True)
    motion: MotionModel = WHEELS
    sensor: SensorModel = SENSORS["camera"]
    parameters: Mapping[str, float] = field(
        default_factory=lambda: {"wheel_scale": 1.02, "turn_rate_bias": 0.004, "sensor_delay": 0.03}
    )
    misread: float = option(
        0.05,
        "Part of the sightings that have the id of another landmark, or one that does not exist",
        minimum=0,
        below=1,
    )
    clutter: float = option(0.0, "Part of the sightings that show no landmark", minimum=0, below=1)
    missed: float = option(0.15, "Probability that a visible landmark is not seen", minimum=0, below=1)
    correlated: float = option(
        0.0, "Part of the variance of sightings whose errors are correlated, per landmark", minimum=0, below=1
    )
    correlation: float = option(50.0, "Number of scans over which they are correlated", positive=True)
    scan_bearing_std: float = option(
        0.0, "Standard deviation of an error that all bearings of a scan have in common", "rad", minimum=0
    )
    stamp_std: float = option(0.0, "Standard deviation of the recorded times of scans", "s", minimum=0)
    gaps: int = option(0, "Number of times at which the sensor sees nothing", minimum=0)
    gap: float = option(15.0, "Duration of each of these", "s", minimum=0)
    silences: int = option(0, "Number of times at which no odometry is recorded", minimum=0)
    silence: float = option(5.0, "Duration of each of these", "s", minimum=0)

    def __post_init__(self) -> None:
        check_options(self)
        if not np.isfinite(self.sensor.max_range):
            raise OptionError("sensor needs a max_range, because a drive has no other limit of sight")
        if unknown := self.parameters.keys() - PARAMETERS.keys():
            raise OptionError(f"parameters: there is no {sorted(unknown)[0]!r}; they are {', '.join(PARAMETERS)}")
        check_number(**self.parameters)
        whole = {name: float(self.parameters.get(name, p.ideal)) for name, p in PARAMETERS.items()}
        object.__setattr__(self, "parameters", whole)

    @classmethod
    def random(cls, seed: int) -> Drive:
        """The drive with a number, drawn from the whole range of places, sensors, rates, noise and faults."""
        rng = np.random.default_rng([seed, 26])
        place = str(rng.choice(list(PLACES), p=[0.5, 0.25, 0.25]))
        kinds = {"warehouse": ("camera", "camera", "laser"), "orchard": ("laser", "camera"),
                 "field": ("reflectors", "laser", "camera")}[place]  # fmt: skip
        kind = str(rng.choice(kinds))
        odometry_rate = _between(rng, 20.0, 100.0)
        # sightings are sparse now and then; where many landmarks are in view, scans are slow
        fastest = 20.0 if place == "warehouse" else 3.0 if kind == "reflectors" else 4.0
        sparse = rng.random() < 0.15
        rate = 1.0 if sparse else _between(rng, max(1.0, fastest / 5), fastest)
        count = int(rng.integers(*{"warehouse": (30, 61), "orchard": (30, 61), "field": (15, 36)}[place]))
        sensor, motion, precise = _noise_of_sensor(kind, rng), *_noise_of_wheels(odometry_rate, rng)
        has_ids_wrong = rng.random() < 0.75
        correlated = rng.random() < 0.5
        return cls(
            place=place, seed=seed, duration=float(rng.uniform(240.0 if sparse else 120.0, 360.0)),
            speed=float(rng.uniform(0.6, 1.6)), turn_rate=float(rng.uniform(0.6, 1.3)), landmarks=count,
            orientation=bool(kind == "camera" and rng.random() < 0.4), odometry_rate=odometry_rate, sensor_rate=rate,
            motion=motion, sensor=_reaching(sensor, place, rng), parameters=_biases(rng, precise, motion.sigma_omega > 0),
            misread=float(rng.uniform(0.0, 0.1)) if has_ids_wrong else 0.0,
            clutter=float(rng.uniform(0.0, 0.03)) if rng.random() < 0.4 else 0.0, missed=float(rng.uniform(0.02, 0.4)),
            correlated=float(rng.uniform(0.2, 0.8)) if correlated else 0.0, correlation=float(rng.uniform(30.0, 70.0)),
            gaps=int(rng.integers(1, 4)) if rng.random() < 0.4 else 0, gap=float(rng.uniform(4.0, 20.0)),
        )  # fmt: skip

    def simulate(self) -> tuple[Log, DriveTruth]:
        """The log without noise models, as it would have been recorded, and its truth.

        Raises:
            LogError: nothing is seen. OptionError: the duration is too short for two rows of odometry.
        """
        rng = np.random.default_rng([self.seed, 0])
        place = PLACES[self.place](self.landmarks, self.sensor.max_range, rng)
        path = follow(
            place.route, speed=self.speed, turn_rate=self.turn_rate, duration=self.duration, slip=self.motion.slip,
            wander=WANDER, rng=rng,
        )  # fmt: skip
        odometry = self._odometry(path, rng)
        at, seen, sightings, clutter = self._sightings(path, place, rng)
        true = np.where(clutter, UNIDENTIFIED, seen)
        landmarks, misread = self._read(seen, clutter, rng)
        scans, of_scan = np.unique(at, return_inverse=True)
        shaking = np.random.default_rng([self.seed, 2])
        sightings[:, 1] += self.scan_bearing_std * shaking.standard_normal(len(scans))[of_scan]
        # a recording has its scans in the order in which they came
        recorded = np.sort(scans + self.stamp_std * shaking.standard_normal(len(scans)))
        stamps = recorded[of_scan] + self.parameters["sensor_delay"]
        kept = (stamps >= odometry.times[0]) & (stamps <= odometry.times[-1]) & (sightings[:, 0] > 0)
        times = np.union1d(odometry.times, stamps[kept])
        columns = 3 if self.orientation else 2
        log = synchronize(
            odometry, Stream(stamps[kept], sightings[kept, :columns]), landmarks[kept],
            truth=Stream(times, path.at(times)), name=f"{self.place} {self.seed}",
            true_landmarks={j: place.landmarks[j, :columns] for j in range(len(place.landmarks))},
        )  # fmt: skip
        return log, DriveTruth(
            self.motion, self.sensor, self.parameters, true[kept], misread[kept], clutter[kept], self.correlated,
            self.correlation / self.sensor_rate,
        )  # fmt: skip

    def _odometry(self, path: Path, rng: np.random.Generator) -> Stream:
        """The record of the path by wheels and gyroscope."""
        times = np.arange(int(path.duration * self.odometry_rate) + 1) / self.odometry_rate
        kept, latest = np.ones(len(times), dtype=bool), max(path.duration - self.silence, 0.0)
        for begin in np.random.default_rng([self.seed, 1]).uniform(0, latest, self.silences):
            kept &= (times < begin) | (times > begin + self.silence)
        if np.sum(kept) < 2:
            raise OptionError(
                f"a drive of {self.duration:g} s must have two rows of odometry, but has {np.sum(kept)}: choose a longer "
                "duration, a higher odometry_rate or shorter silences"
            )
        controls, p = path.odometry(times), self.parameters
        variances = np.diagonal(self.motion.M(controls, 1 / self.odometry_rate), axis1=1, axis2=2)
        nu, omega = (controls + rng.standard_normal(controls.shape) * np.sqrt(variances)).T
        recorded = p["turn_scale"] * omega + p["turn_rate_bias"] + p["curvature_bias"] * nu
        return Stream(times[kept], np.column_stack([p["wheel_scale"] * nu, recorded])[kept])

    def _sightings(
        self, path: Path, place: Place, rng: np.random.Generator
    ) -> tuple[Array, np.ndarray, Array, np.ndarray]:
        """The times (M,) at which the sensor saw, the rows of the landmarks, the sightings (M, 3), and what is clutter."""
        interval, p = 1 / self.sensor_rate, self.parameters
        scans = np.arange(rng.uniform(0, interval), path.duration - interval, interval)
        scans += np.clip(rng.normal(0, JITTER, len(scans)), -0.3, 0.3) * interval
        scans = np.maximum(scans, 0.0)
        for begin in rng.uniform(0, path.duration, self.gaps):
            scans = scans[(scans < begin) | (scans > begin + self.gap)]
        ideal = replace(self.sensor, offset=(0.0, 0.0))
        offset = (self.sensor.offset[0] + p["sensor_ahead"], self.sensor.offset[1] + p["sensor_left"])
        eyes = replace(self.sensor, offset=offset).mount(path.at(scans))
        at, seen = np.divmod(np.arange(len(scans) * len(place.landmarks)), len(place.landmarks))
        inside = ideal.sees(eyes[at], place.landmarks[seen]) & (rng.random(len(at)) >= self.missed)
        at, seen = at[inside], seen[inside]
        inside = place.in_sight(eyes[at], seen)
        at, seen = at[inside], seen[inside]
        exact = ideal.h(eyes[at], place.landmarks[seen])
        deviations = np.sqrt(np.diagonal(ideal.Q(exact), axis1=1, axis2=2))
        lasting = self.correlation / self.sensor_rate
        z = exact + deviations * correlated_errors(scans[at], seen, self.correlated, lasting, rng)
        z[:, 0] = p["range_scale"] * z[:, 0] + p["range_bias"]
        z[:, 1] += p["bearing_bias"]
        # clutter anywhere in view, even in area
        false = np.sort(rng.integers(0, max(len(scans), 1), rng.binomial(len(at), self.clutter / (1 - self.clutter))))
        low, high = ideal.min_range, ideal.max_range
        places = np.column_stack([
            np.sqrt(rng.uniform(low**2, high**2, len(false))),
            rng.uniform(-0.5, 0.5, len(false)) * ideal.field_of_view,
            rng.uniform(-pi, pi, len(false)),
        ])  # fmt: skip
        at, seen = np.append(at, false), np.append(seen, rng.integers(0, len(place.landmarks), len(false)))
        order = np.argsort(scans[at], kind="stable")
        clutter = np.arange(len(at)) >= len(z)
        return scans[at[order]], seen[order], np.concatenate([z, places])[order], clutter[order]

    def _read(self, seen: np.ndarray, clutter: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """The ids (M,) that the detector reports, and whether they are misread."""
        misread = (rng.random(len(seen)) < self.misread) & ~clutter
        # another one: any step but a whole round
        read = np.where(misread, (seen + rng.integers(1, self.landmarks, len(seen))) % self.landmarks, seen)
        unknown = misread & (rng.random(len(seen)) < NONEXISTENT)
        return np.where(unknown, self.landmarks + rng.integers(0, SPARE_IDS, len(seen)), read), misread


def correlated_errors(times: Array, seen: np.ndarray, part: float, tau: float, rng: np.random.Generator) -> Array:
    """Standard normal errors (M, 3) of which a part s of the variance is an Ornstein-Uhlenbeck process for each landmark.

    c_k = a c_{k-1} + sqrt(1 - a²) w_k with a = exp(-lapse / tau); the error is sqrt(1 - s) v_k + sqrt(s) c_k.

    Args:
        times: (M,) not decreasing [s].
        seen: (M,) the landmarks.
        part: s.
        tau: the correlation time [s].
        rng: of v and w.
    """
    white = rng.standard_normal((len(times), 3))
    if part == 0:
        return white
    slow = rng.standard_normal((len(times), 3))
    for j in np.unique(seen):
        rows = np.flatnonzero(seen == j)
        decay = np.exp(-np.diff(times[rows]) / tau)
        for row, before, a in zip(rows[1:].tolist(), rows[:-1].tolist(), decay.tolist()):
            slow[row] = a * slow[before] + (1 - a * a) ** 0.5 * slow[row]
    return (1 - part) ** 0.5 * white + part**0.5 * slow


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    """A number between two bounds whose logarithm is uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _noise_of_sensor(kind: str, rng: np.random.Generator) -> SensorModel:
    """The noise of a sensor, over more than a decade; one in ten is almost perfect."""
    typical, part = SENSORS[kind], 0.1 if rng.random() < 0.1 else 1.0
    return replace(typical, **{n: getattr(typical, n) * (_between(rng, 0.3, 3.0) * part) for n in typical.NOISE})


def _noise_of_wheels(rate: float, rng: np.random.Generator) -> tuple[MotionModel, bool]:
    """The noise of wheels alone, or of wheels and a gyroscope; and whether they are almost perfect, as one in ten is."""
    best = bool(rng.random() < 0.1)
    along = _between(rng, 1e-4, 3e-4) if best else _between(rng, 0.002, 0.06)
    slip = along * _between(rng, 0.1, 0.6)
    if rng.random() < 0.6:
        # a gyroscope: the error of its angle is a random walk, in rad per square root of the second
        walk = _between(rng, 5e-5, 1e-4) if best else _between(rng, 2e-4, 5e-3)
        return MotionModel(
            nn=along, no=along / 10, on=0.0, oo=0.0, slip=slip, epsilon=EPSILON, sigma_omega=walk * rate**0.5
        ), best
    on, oo = (_between(rng, *((1e-4, 3e-4) if best else (0.001, 0.03))) for _ in range(2))
    return MotionModel(nn=along, no=along / 10, on=on, oo=oo, slip=slip, epsilon=EPSILON), best


def _reaching(sensor: SensorModel, place: str, rng: np.random.Generator) -> SensorModel:
    """The sensor with a range and a view of its own; in the open it sees farther."""
    least, most, view = sensor.limits
    reach = most * rng.uniform(0.8, 1.2) * (2.0 if place == "field" and most < 20 else 1.0)
    view = min(2 * pi, view * float(rng.uniform(0.9, 1.1)))
    return sensor.with_limits(least, float(reach), 2 * pi if most >= 20 else view)


def _biases(rng: np.random.Generator, precise: bool, gyroscope: bool) -> dict[str, float]:
    """Values of the parameters: of wheels and turns on every robot, of the sensor on some."""
    p, fine = {}, 0.03 if precise else 1.0
    p["wheel_scale"] = 1 + fine * rng.uniform(-0.04, 0.04)
    p["turn_scale"] = 1 + fine * rng.uniform(-0.01, 0.01) * (1 if gyroscope else 3)
    p["turn_rate_bias" if gyroscope else "curvature_bias"] = fine * rng.uniform(-0.008, 0.008)
    p["sensor_delay"] = rng.uniform(0.0, 0.06) if rng.random() < 0.7 else 0.0
    wrong = rng.random(3) < [0.4, 0.5, 0.5]
    p["range_bias"] = wrong[0] * rng.uniform(-0.05, 0.05)
    p["bearing_bias"] = wrong[1] * rng.uniform(-0.03, 0.03)
    p["sensor_ahead"], p["sensor_left"] = wrong[2] * rng.uniform(-0.15, 0.15), wrong[2] * rng.uniform(-0.06, 0.06)
    return {name: float(value) for name, value in p.items()}
