"""A robot among landmarks, with the faults of the book's simulator, written down as a `Log` with its truth.

The robot drives a circle or through way points, its camera sees landmarks within range and bearing limits, and
everything that can go wrong is a named option. With ``clean=True`` nothing goes wrong but noise, and that noise is
drawn exactly from the estimators' own models, so that statistical tests (NEES, chi-square) mean what they say.

Source of the faults: Ueda, *LNPR*, chapter 3 (uncertainty in a mobile robot's motion and observation).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, pi

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from ..errors import OptionError
from ..log import Log
from ..models import MotionModel, SensorModel
from ..se2 import Array, wrap

#: the six landmarks of the book's logs, ids 0 to 5 [m]
BOOK_LANDMARKS = ((-4.0, 2.0), (2.0, -3.0), (3.0, 3.0), (0.0, 4.0), (1.0, 1.0), (-3.0, -1.0))


@dataclass(frozen=True)
class MotionFaults:
    """What goes wrong with the wheels.

    Args:
        kicks_per_metre: pebbles; each turns the robot by a Gaussian angle of ``kick_std`` [rad].
        velocity_bias_std: nu and omega are each scaled by a factor of N(1, this²), one draw for the whole run.
        stuck_interval, stuck_duration: mean time between getting stuck and mean time stuck [s]; exponential.
        kidnap_interval: mean time between kidnappings [s]; the robot is set down anywhere among the landmarks.
    """

    kicks_per_metre: float = 5.0
    kick_std: float = pi / 60
    velocity_bias_std: float = 0.1
    stuck_interval: float = inf
    stuck_duration: float = 3.0
    kidnap_interval: float = inf

    def __post_init__(self) -> None:
        _not_negative(vars(self))


@dataclass(frozen=True)
class SensorFaults:
    """What goes wrong with the camera.

    Args:
        range_noise_rate, bearing_noise, orientation_noise: standard deviations of the noise (range: times the range).
        range_bias_rate_std, bearing_bias_std, orientation_bias_std: one draw for the whole run.
        phantom: probability that a sighting is of a place drawn at random instead of the landmark.
        oversight: probability that a visible landmark is not seen.
        occlusion: probability that a range comes out too long, uniform between the truth and the camera's limit.
    """

    range_noise_rate: float = 0.1
    bearing_noise: float = pi / 90
    orientation_noise: float = pi / 90
    range_bias_rate_std: float = 0.1
    bearing_bias_std: float = pi / 90
    orientation_bias_std: float = pi / 90
    phantom: float = 0.0
    oversight: float = 0.1
    occlusion: float = 0.0

    def __post_init__(self) -> None:
        _not_negative(vars(self))
        for option in ("phantom", "oversight", "occlusion"):
            if getattr(self, option) > 1:
                raise OptionError(f"{option} must be a probability between 0 and 1, not {getattr(self, option)!r}")


def simulate(
    *,
    steps: int = 62,
    dt: float = 3.0,
    speed: float = 0.2,
    turn_rate: float = pi / 36,
    way_points: ArrayLike | None = None,
    start: ArrayLike = (0.0, -3.0, 0.0),
    landmarks: ArrayLike | int = BOOK_LANDMARKS,
    arena: float | None = None,
    min_range: float = 0.5,
    max_range: float = 6.0,
    field_of_view: float = 2 * pi / 3,
    orientation: bool = True,
    motion_faults: MotionFaults | None = None,
    sensor_faults: SensorFaults | None = None,
    clean: bool = False,
    motion: MotionModel | None = None,
    sensor: SensorModel | None = None,
    seed: int | np.random.Generator = 0,
    name: str = "simulated",
) -> Log:
    """Drive a robot for ``steps`` motions of ``dt`` seconds and return what it did and saw, with the truth.

    Args:
        steps: number of motions T; the log has T + 1 poses.
        dt: duration of each motion [s].
        speed, turn_rate: nu [m/s] and omega [rad/s] of the circle; with way points the fastest the robot drives and
            turns.
        way_points: (W, 2) [m], visited in turn and again from the first; None for the circle.
        start: the true first pose, also the first dead-reckoned one.
        landmarks: positions (L, 2) or poses (L, 3), or a number of landmarks drawn uniformly over the arena.
        arena: half the side of the square world [m]; default: large enough for landmarks, way points and start.
        min_range, max_range: limits of the camera [m]; ``field_of_view``: its whole opening angle [rad].
        orientation: whether the sightings have psi (landmarks without a heading of their own face along x).
        motion_faults, sensor_faults: what goes wrong; default: the book's noise and biases.
        clean: no faults but noise drawn from the models, x_t ~ N(f(x, u), A M A' + epsilon I) and z ~ N(h, Q) with Q
            at the true range (the estimators can know only the measured one).
        motion, sensor: the models of the clean mode; default: the estimators' defaults.
        seed: of the random numbers, or a generator.

    Raises:
        OptionError: an option has an impossible value.
    """
    rng = np.random.default_rng(seed)
    _check(steps, dt, speed, min_range, max_range, field_of_view)
    if clean and (motion_faults is not None or sensor_faults is not None):
        raise OptionError("clean means no faults: leave out motion_faults and sensor_faults, or clean")
    motion, sensor = motion or MotionModel(), sensor or SensorModel()
    start = np.asarray(start, dtype=float)
    route = None if way_points is None else np.asarray(way_points, dtype=float)
    if start.shape != (3,):
        raise OptionError(f"start must be (x, y, theta), not an array of shape {start.shape}")
    if route is not None and (route.ndim != 2 or route.shape[1] != 2 or len(route) < 1):
        raise OptionError(f"way_points must have shape (W, 2), not {route.shape}")
    world, arena = _world(landmarks, arena, route, start, rng)

    if clean:
        poses, controls = _drive_clean(steps, dt, speed, turn_rate, route, start, motion, rng)
    else:
        faults = motion_faults or MotionFaults()
        poses, controls = _drive(steps, dt, speed, turn_rate, route, start, faults, arena, rng)
    at, seen = _visible(poses, world, min_range, max_range, field_of_view)
    exact = sensor.h(poses[at], world[seen])
    if clean:
        sightings = exact + rng.standard_normal(exact.shape) * np.sqrt(np.diagonal(sensor.Q(exact), axis1=-2, axis2=-1))
        keep = sightings[:, 0] > 0
    else:
        sightings, keep = _look(exact, poses[at], sensor_faults or SensorFaults(), max_range, arena, sensor, rng)
    columns = 3 if orientation else 2
    return Log(
        dt=np.full(steps, float(dt)),
        controls=controls,
        steps=at[keep],
        landmarks=seen[keep],
        sightings=sightings[keep, :columns],
        initial_poses=motion.dead_reckoning(start, controls, dt),
        true_poses=poses,
        true_landmarks={j: world[j, :columns] for j in range(len(world))},
        name=name,
    )


def _not_negative(options: dict[str, float]) -> None:
    for option, value in options.items():
        if not value >= 0:
            raise OptionError(f"{option} must not be negative, but is {value!r}")


def _check(steps: int, dt: float, speed: float, min_range: float, max_range: float, field_of_view: float) -> None:
    if steps < 1:
        raise OptionError(f"steps must be at least 1, not {steps}")
    for option, value in {"dt": dt, "speed": speed, "max_range": max_range, "field_of_view": field_of_view}.items():
        if not 0 < value < inf:
            raise OptionError(f"{option} must be a positive number, not {value!r}")
    if not 0 <= min_range < max_range:
        raise OptionError(f"min_range must lie between 0 and max_range = {max_range:g}, not {min_range!r}")


def _world(
    landmarks: ArrayLike | int, arena: float | None, route: Array | None, start: Array, rng: np.random.Generator
) -> tuple[Array, float]:
    """The landmarks as poses (L, 3), and half the side of the world."""
    reach = [np.abs(start[:2]).max(), 1.0] + ([np.abs(route).max()] if route is not None else [])
    if np.ndim(landmarks) == 0:
        count = int(landmarks)  # type: ignore[arg-type]
        if count < 1:
            raise OptionError(f"landmarks must be at least 1, not {count}")
        arena = float(arena or max(*reach, 5.0) * 1.2)
        return np.column_stack([rng.uniform(-arena, arena, (count, 2)), rng.uniform(-pi, pi, count)]), arena
    world = np.asarray(landmarks, dtype=float)
    if world.ndim != 2 or world.shape[1] not in (2, 3) or len(world) == 0:
        raise OptionError(f"landmarks must be a number or an array of shape (L, 2) or (L, 3), not {world.shape}")
    if world.shape[1] == 2:
        world = np.column_stack([world, np.zeros(len(world))])
    return world, float(arena or max(*reach, np.abs(world[:, :2]).max()))


class _Driver:
    """Chooses the commands: a constant circle, or towards the next way point."""

    def __init__(self, dt: float, speed: float, turn_rate: float, route: Array | None) -> None:
        self.dt, self.speed, self.turn_rate, self.route = dt, speed, turn_rate, route
        self.next = 0

    def command(self, pose: Array) -> tuple[float, float]:
        if self.route is None:
            return self.speed, self.turn_rate
        stride = self.speed * self.dt
        for _ in range(len(self.route)):
            dx, dy = self.route[self.next] - pose[:2]
            if dx * dx + dy * dy > stride * stride:
                break
            self.next = (self.next + 1) % len(self.route)
        off = float(wrap(np.arctan2(dy, dx) - pose[2]))
        limit = abs(self.turn_rate)
        # an arc that ends at the goal leaves at half the turn it makes; sharp turns are driven slowly
        omega = float(np.clip(2 * off / self.dt, -limit, limit))
        return (self.speed if abs(off) < pi / 2 else self.speed / 4), omega


def _drive_clean(
    steps: int, dt: float, speed: float, turn_rate: float, route: Array | None, start: Array, motion: MotionModel,
    rng: np.random.Generator,
) -> tuple[Array, Array]:  # fmt: skip
    """True poses x_t ~ N(f(x_{t-1}, u_t), A M A' + epsilon I) and the commands."""
    driver = _Driver(dt, speed, turn_rate, route)
    poses, controls = np.empty((steps + 1, 3)), np.empty((steps, 2))
    poses[0] = start
    noise = rng.standard_normal((steps, 3))
    for t in range(steps):
        controls[t] = driver.command(poses[t])
        factor = np.linalg.cholesky(motion.covariance(poses[t], controls[t], dt))
        poses[t + 1] = motion.f(poses[t], controls[t], dt) + factor @ noise[t]
    poses[:, 2] = wrap(poses[:, 2])
    return poses, controls


def _drive(
    steps: int, dt: float, speed: float, turn_rate: float, route: Array | None, start: Array, faults: MotionFaults,
    arena: float, rng: np.random.Generator,
) -> tuple[Array, Array]:  # fmt: skip
    """True poses and commands of a robot with the book's faults; pebbles and stuck wheels act within a step."""
    driver, exact = _Driver(dt, speed, turn_rate, route), MotionModel()
    poses, controls = np.empty((steps + 1, 3)), np.empty((steps, 2))
    poses[0] = start
    bias = rng.normal(1.0, faults.velocity_bias_std, 2) if faults.velocity_bias_std > 0 else np.ones(2)

    def wait(mean: float) -> float:
        return rng.exponential(mean) if 0 < mean < inf else inf

    per_kick = 1 / faults.kicks_per_metre if faults.kicks_per_metre > 0 else inf
    to_kick, to_kidnap = wait(per_kick), wait(faults.kidnap_interval)
    to_stuck, stuck = wait(faults.stuck_interval), False
    for t in range(steps):
        controls[t] = driver.command(poses[t])
        pose, left = poses[t], dt
        while left > 1e-12:
            real = np.zeros(2) if stuck else controls[t] * bias
            # the next thing to happen: the step ends, a pebble, the wheels stick or come free, somebody lifts the robot
            pebble = to_kick / abs(real[0]) if real[0] != 0 else inf
            lapse = min(left, pebble, to_stuck, to_kidnap)
            pose = exact.f(pose, real, lapse)
            left, to_stuck, to_kidnap = left - lapse, to_stuck - lapse, to_kidnap - lapse
            to_kick -= lapse * abs(real[0])
            if lapse == pebble:
                pose = pose + np.array([0.0, 0.0, rng.normal(0.0, faults.kick_std)])
                to_kick = wait(per_kick)
            if to_stuck <= 0:
                stuck = not stuck
                to_stuck = wait(faults.stuck_duration if stuck else faults.stuck_interval)
            if to_kidnap <= 0:
                pose = np.array([*rng.uniform(-arena, arena, 2), rng.uniform(-pi, pi)])
                to_kidnap = wait(faults.kidnap_interval)
        poses[t + 1] = pose
    poses[:, 2] = wrap(poses[:, 2])
    return poses, controls


def _visible(
    poses: Array, world: Array, min_range: float, max_range: float, field_of_view: float
) -> tuple[np.ndarray, np.ndarray]:
    """Every (step, landmark) within the camera's limits, by step and then by landmark."""
    near = cKDTree(world[:, :2]).query_ball_point(poses[:, :2], max_range, return_sorted=True)
    at = np.repeat(np.arange(len(poses)), [len(found) for found in near])
    seen = np.fromiter((j for found in near for j in found), dtype=np.int64, count=len(at))
    d = world[seen, :2] - poses[at, :2]
    bearing = wrap(np.arctan2(d[:, 1], d[:, 0]) - poses[at, 2])
    within = (np.hypot(d[:, 0], d[:, 1]) >= max(min_range, 1e-9)) & (np.abs(bearing) <= field_of_view / 2)
    return at[within], seen[within]


def _look(
    exact: Array, poses: Array, faults: SensorFaults, max_range: float, arena: float, sensor: SensorModel,
    rng: np.random.Generator,
) -> tuple[Array, np.ndarray]:  # fmt: skip
    """The sightings as the faulty camera reports them, and which of them it reports at all."""
    exact, count = exact.copy(), len(exact)
    phantom = rng.random(count) < faults.phantom
    places = np.column_stack([rng.uniform(-arena, arena, (count, 2)), rng.uniform(-pi, pi, count)])
    exact[phantom] = sensor.h(poses[phantom], places[phantom])
    occluded = rng.random(count) < faults.occlusion
    room = np.maximum(max_range - exact[:, 0], 0.0)
    exact[:, 0] += np.where(occluded, rng.random(count) * room, 0.0)
    bias = rng.standard_normal(3) * [faults.range_bias_rate_std, faults.bearing_bias_std, faults.orientation_bias_std]
    noise = rng.standard_normal((count, 3)) * [faults.range_noise_rate, faults.bearing_noise, faults.orientation_noise]
    sightings = exact + noise + bias
    sightings[:, 0] = exact[:, 0] * (1 + noise[:, 0] + bias[0])
    overlooked = rng.random(count) < faults.oversight
    return sightings, ~overlooked & (sightings[:, 0] > 0)
