"""`simulate`: a robot among landmarks, with the faults of the book's simulator, as a `Log` with its ground truth.

The robot drives a circle or through way points, and its camera sees landmarks within limits of range and bearing. Every
fault is a named option. A clean world has noise but no faults, and the noise is drawn from the estimators' own models, as
statistical tests (NEES, chi-square) require.

Source of the faults: Ueda, *LNPR*, chapter 3 (uncertainty in a mobile robot's motion and observation).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from math import inf, pi
from typing import Any

import numpy as np

from ..errors import OptionError
from ..errors.checks import check_count, check_known, check_not_negative, check_options, check_type, option
from ..log import Log
from ..models import MotionModel, SensorModel
from ..se2 import Array, wrap
from .worlds import World

#: so many pairs of steps and landmarks are all looked at: loading SciPy's tree takes 0.15 s
FEW = 10_000


@dataclass(frozen=True, kw_only=True)
class MotionFaults:
    """Faults of the wheels.

    Raises:
        OptionError: a value is negative.
    """

    kicks_per_metre: float = option(5.0, "Pebbles per metre; each turns the robot", "1/m")
    kick_std: float = option(pi / 60, "Standard deviation of the turn by a pebble", "rad")
    velocity_bias_std: float = option(0.1, "Speed and turn rate are each scaled by one factor N(1, this²) per run")
    stuck_interval: float = option(inf, "Mean time until the wheels get stuck", "s")
    stuck_duration: float = option(3.0, "Mean time for which they are stuck", "s")
    kidnap_interval: float = option(inf, "Mean time until the robot is put at a random pose", "s")

    def __post_init__(self) -> None:
        check_not_negative(**vars(self))


@dataclass(frozen=True, kw_only=True)
class SensorFaults:
    """Faults and noise of the camera.

    Raises:
        OptionError: a value is negative, or a probability above 1.
    """

    range_noise_rate: float = option(0.1, "Standard deviation of the range noise per metre of range", "m/m")
    bearing_noise: float = option(pi / 90, "Standard deviation of the bearing noise", "rad")
    orientation_noise: float = option(pi / 90, "Standard deviation of the noise of psi", "rad")
    range_bias_rate_std: float = option(0.1, "Standard deviation of the run's range bias per metre of range", "m/m")
    bearing_bias_std: float = option(pi / 90, "Standard deviation of the run's bearing bias", "rad")
    orientation_bias_std: float = option(pi / 90, "Standard deviation of the run's bias of psi", "rad")
    phantom: float = option(
        0.0, "Probability that the sensor reports a random position instead of a visible landmark", maximum=1
    )
    oversight: float = option(0.1, "Probability that a visible landmark is not seen", maximum=1)
    occlusion: float = option(0.0, "Probability that a range is too long, uniform up to the greatest range", maximum=1)

    def __post_init__(self) -> None:
        check_not_negative(**vars(self))
        check_options(self)


#: the biases that are factors; the others are angles
_FACTORS = ("speed", "turn rate", "range")
#: the parameters of `identification.declared` that stand for biases. None stands for that of psi, and the range shares its
#: scale with the speed, so that only one of the two can be estimated well.
_PARAMETERS = {"speed": "wheel_scale", "turn rate": "turn_scale", "range": "range_scale", "bearing": "bearing_bias"}


def simulate(
    world: World | None = None,
    *,
    motion_faults: MotionFaults | None = None,
    sensor_faults: SensorFaults | None = None,
    motion: MotionModel | None = None,
    sensor: SensorModel | None = None,
    seed: int | np.random.Generator = 0,
    name: str = "simulated",
    **options: Any,
) -> Log:
    """Drive a robot through a world and return its log with the ground truth.

    Args:
        world: the course, the landmarks and the camera; default: the book's.
        motion_faults, sensor_faults: faults of wheels and camera; default: the book's noise and biases.
        motion, sensor: the noise models of a clean world, x_t ~ N(f(x, u), A M A' + S + epsilon I), S the slip, and
            z ~ N(h, Q) with Q at the true range (the estimators know only the measured one); default: the estimators'
            defaults.
        seed: random seed, or a generator.
        name: the name of the log.
        options: fields of `World` that differ from ``world``, such as ``steps=60`` or ``clean=True``.

    Raises:
        OptionError: an option has an impossible value.
    """
    check_type(World, world=world)
    check_type(MotionFaults, motion_faults=motion_faults)
    check_type(SensorFaults, sensor_faults=sensor_faults)
    check_type(MotionModel, motion=motion)
    check_type(SensorModel, sensor=sensor)
    check_known("simulate", options, [each.name for each in fields(World)])
    if not isinstance(seed, np.random.Generator):
        check_count(seed=seed)
    world = replace(world or World(), **options)
    if world.clean and (motion_faults is not None or sensor_faults is not None):
        raise OptionError("clean means no faults: leave out motion_faults and sensor_faults, or clean")
    rng = np.random.default_rng(seed)
    motion, sensor = motion or MotionModel(), sensor or SensorModel()
    landmarks, arena = _landmarks(world, rng)
    if world.clean:
        poses, controls = _drive_clean(world, motion, rng)
        biases: dict[str, float] = {}
    else:
        poses, controls, biases = _drive(world, motion_faults or MotionFaults(), arena, rng)
    # the stricter limits of sight count, those of the world or those of the sensor; at no distance there is no direction
    least, most, view = sensor.limits
    camera = sensor.with_limits(
        max(world.min_range, least, 1e-9), min(world.max_range, most), min(world.field_of_view, view)
    )
    at, seen = _visible(camera, poses, landmarks)
    exact = sensor.h(poses[at], landmarks[seen])
    if world.clean:
        deviations = np.sqrt(np.diagonal(sensor.Q(exact), axis1=-2, axis2=-1))
        sightings = exact + rng.standard_normal(exact.shape) * deviations
        keep = sightings[:, 0] > 0
    else:
        faults = sensor_faults or SensorFaults()
        sightings, keep, of_sensor = _measured(exact, poses[at], faults, sensor, world, arena, rng)
        biases |= of_sensor
    columns = 3 if world.orientation else 2
    return Log(
        simulated=True,
        dt=np.full(world.steps, float(world.dt)),
        controls=controls,
        steps=at[keep],
        landmarks=seen[keep],
        sightings=sightings[keep, :columns],
        initial_poses=motion.dead_reckoning(world.start, controls, world.dt),
        true_poses=poses,
        true_landmarks={j: place[:columns] for j, place in enumerate(landmarks)},
        name=name,
        notes=_note(biases),
    )


def _note(biases: dict[str, float]) -> tuple[str, ...]:
    """The notes of a log on biases {name: factor, or angle [rad]}; those without effect are left out."""
    factors = [f"{what} x {value:.3f}" for what, value in biases.items() if what in _FACTORS and value != 1]
    angles = [f"{what} {value:+.3f} rad" for what, value in biases.items() if what not in _FACTORS and value]
    if not factors and not angles:
        return ()
    advice = ",".join(_estimated(biases))
    return (
        f"the simulated robot has constant biases ({', '.join(factors + angles)}), which the noise models do not have, so "
        "errors and NEES are larger than without them"
        + (f"; to estimate the biases: --estimate {advice} --estimators graph-marginal" if advice else ""),
    )


def _estimated(biases: dict[str, float]) -> list[str]:
    """The parameters that stand for the biases; a range scale is left out where the wheels have one, see `_PARAMETERS`."""
    names = [name for what, name in _PARAMETERS.items() if what in biases and biases[what] != (what in _FACTORS)]
    return [name for name in names if name != "range_scale" or "wheel_scale" not in names]


def _landmarks(world: World, rng: np.random.Generator) -> tuple[Array, float]:
    """The landmarks as poses (L, 3), and half the side of the world."""
    reach = max(1.0, *np.abs(world.start[:2]), *np.abs(np.ravel(world.way_points or ())))
    if isinstance(world.landmarks, int):
        arena, count = float(world.arena or max(reach, 5.0) * 1.2), world.landmarks
        return np.column_stack([rng.uniform(-arena, arena, (count, 2)), rng.uniform(-pi, pi, count)]), arena
    places = np.asarray(world.landmarks)
    if places.shape[1] == 2:
        places = np.column_stack([places, np.zeros(len(places))])
    return places, float(world.arena or max(reach, np.abs(places[:, :2]).max()))


class _Driver:
    """Chooses the controls: a constant circle, or towards the next way point."""

    def __init__(self, world: World) -> None:
        self.world, self.next = world, 0
        self.route = None if world.way_points is None else np.asarray(world.way_points)

    def control(self, pose: Array) -> tuple[float, float]:
        world = self.world
        if self.route is None:
            return world.speed, world.turn_rate
        stride = world.speed * world.dt
        for _ in range(len(self.route)):
            dx, dy = self.route[self.next] - pose[:2]
            if dx * dx + dy * dy > stride * stride:
                break
            self.next = (self.next + 1) % len(self.route)
        direction = float(wrap(np.arctan2(dy, dx) - pose[2]))
        limit = abs(world.turn_rate)
        # an arc to the goal starts at half the angle by which it turns; sharp turns are driven slowly
        omega = float(np.clip(2 * direction / world.dt, -limit, limit))
        return (world.speed if abs(direction) < pi / 2 else world.speed / 4), omega


def _drive_clean(world: World, motion: MotionModel, rng: np.random.Generator) -> tuple[Array, Array]:
    """True poses x_t ~ N(f(x_{t-1}, u_t), A M A' + S + epsilon I) and the controls."""
    driver, steps = _Driver(world), world.steps
    poses, controls = np.empty((steps + 1, 3)), np.empty((steps, 2))
    poses[0] = world.start
    noise = rng.standard_normal((steps, 3))
    for t in range(steps):
        controls[t] = driver.control(poses[t])
        factor = np.linalg.cholesky(motion.covariance(poses[t], controls[t], world.dt))
        poses[t + 1] = motion.f(poses[t], controls[t], world.dt) + factor @ noise[t]
    poses[:, 2] = wrap(poses[:, 2])
    return poses, controls


def _drive(
    world: World, faults: MotionFaults, arena: float, rng: np.random.Generator
) -> tuple[Array, Array, dict[str, float]]:
    """True poses, controls and biases of a robot with faults; pebbles and stuck wheels act within a step."""
    driver, steps, exact = _Driver(world), world.steps, MotionModel()
    poses, controls = np.empty((steps + 1, 3)), np.empty((steps, 2))
    poses[0] = world.start
    bias = rng.normal(1.0, faults.velocity_bias_std, 2) if faults.velocity_bias_std > 0 else np.ones(2)

    def wait(mean: float) -> float:
        """The time, or the distance, to the next event, of which this is the mean; infinite for a mean of 0."""
        return rng.exponential(mean) if 0 < mean < inf else inf

    per_kick = 1 / faults.kicks_per_metre if faults.kicks_per_metre > 0 else inf
    to_kick, to_kidnap = wait(per_kick), wait(faults.kidnap_interval)
    # wheels that are stuck for no time are never stuck
    to_stuck, stuck = wait(faults.stuck_interval if faults.stuck_duration > 0 else inf), False
    for t in range(steps):
        controls[t] = driver.control(poses[t])
        pose, left = poses[t], world.dt
        while left > 1e-12:
            real = np.zeros(2) if stuck else controls[t] * bias
            # the next event: the step ends, a pebble, the wheels get stuck or free, the robot is put elsewhere
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
    return poses, controls, dict(zip(("speed", "turn rate"), bias.tolist()))


def _visible(camera: SensorModel, poses: Array, landmarks: Array) -> tuple[np.ndarray, np.ndarray]:
    """Every (step, landmark) within the camera's limits, by step and then by landmark; poses (T+1, 3) of the robot."""
    if len(poses) * len(landmarks) <= FEW:
        at, seen = np.divmod(np.arange(len(poses) * len(landmarks)), max(len(landmarks), 1))
    else:
        from scipy.spatial import cKDTree

        tree = cKDTree(landmarks[:, :2])
        near = tree.query_ball_point(camera.mount(poses)[:, :2], camera.max_range, return_sorted=True)
        at = np.repeat(np.arange(len(poses)), [len(each) for each in near])
        seen = np.fromiter((j for each in near for j in each), dtype=np.int64, count=len(at))
    within = camera.sees(poses[at], landmarks[seen])
    return at[within], seen[within]


def _measured(
    exact: Array, poses: Array, faults: SensorFaults, sensor: SensorModel, world: World, arena: float,
    rng: np.random.Generator,
) -> tuple[Array, np.ndarray, dict[str, float]]:  # fmt: skip
    """The sightings as the faulty camera measures them, which of them it reports, and its biases."""
    exact, count = exact.copy(), len(exact)
    phantom = rng.random(count) < faults.phantom
    places = np.column_stack([rng.uniform(-arena, arena, (count, 2)), rng.uniform(-pi, pi, count)])
    exact[phantom] = sensor.h(poses[phantom], places[phantom])
    occluded = rng.random(count) < faults.occlusion
    room = np.maximum(world.max_range - exact[:, 0], 0.0)
    exact[:, 0] += np.where(occluded, rng.random(count) * room, 0.0)
    bias = rng.standard_normal(3) * [faults.range_bias_rate_std, faults.bearing_bias_std, faults.orientation_bias_std]
    noise = rng.standard_normal((count, 3)) * [faults.range_noise_rate, faults.bearing_noise, faults.orientation_noise]
    sightings = exact + noise + bias
    sightings[:, 0] = exact[:, 0] * (1 + noise[:, 0] + bias[0])
    overlooked = rng.random(count) < faults.oversight
    biases = {"range": 1 + float(bias[0]), "bearing": float(bias[1])}
    if world.orientation:
        biases["psi"] = float(bias[2])
    return sightings, ~overlooked & (sightings[:, 0] > 0), biases
