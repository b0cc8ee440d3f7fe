"""Logs of sensors that measure one number: ranges of radio beacons, or bearings of a camera."""

from __future__ import annotations

import numpy as np

from ..checks import check_choice, check_count
from ..log import Log
from ..measurements import PartialSightings
from ..models import MotionModel, SensorModel
from ..se2 import Array, between

#: what the sensor measures
NUMBERS = ("range", "bearing")
#: the noise of a mower with radio beacons or a camera
MOTION = MotionModel(nn=0.03, no=0.001, on=0.01, oo=0.03, epsilon=1e-8)
SENSOR = SensorModel(range_rate=0.0, range_std=0.1, bearing_std=0.02)


def simulate_single_numbers(
    number: str,
    *,
    seed: int | np.random.Generator = 0,
    poses: int = 300,
    landmarks: int = 8,
    size: float = 40.0,
    every: int = 2,
    lanes: int = 6,
    motion: MotionModel = MOTION,
    sensor: SensorModel = SENSOR,
) -> Log:
    """A robot that mows a square field in lanes, and measures the range or the bearing of one landmark after the other.

    The controls are the true motions with the noise of the motion model, and the initial poses are those of dead reckoning.

    Args:
        number: "range" or "bearing".
        seed: of landmarks and noise.
        poses: number of poses, one a second.
        landmarks: number of landmarks, anywhere in the field or up to a quarter of its size outside.
        size: of the field [m].
        every: a sighting at every so many poses.
        lanes: 1 is a straight way, from which ranges have mirror images.
        motion, sensor: the noise.
    """
    check_choice("number", number, NUMBERS)
    check_count(poses=poses, landmarks=landmarks, every=every, lanes=lanes)
    rng = np.random.default_rng(seed)
    truth = _lanes(poses, size, lanes)
    moved = between(truth[:-1], truth[1:])
    # speed and turn rate of the arc to the next pose
    half = moved[:, 2] / 2
    controls = np.column_stack([np.hypot(moved[:, 0], moved[:, 1]) / np.sinc(half / np.pi), moved[:, 2]])
    dt = np.ones(poses - 1)
    spread = np.sqrt(np.diagonal(motion.M(controls, dt), axis1=1, axis2=2))
    controls = controls + spread * rng.standard_normal(controls.shape)
    places = rng.uniform(-size / 4, size * 1.25, (landmarks, 2))
    steps = np.arange(0, poses, every)
    seen = rng.integers(0, landmarks, len(steps))
    z = sensor.h(truth[steps], places[seen])
    z = z + rng.standard_normal(z.shape) * np.sqrt(np.diagonal(sensor.Q(z), axis1=1, axis2=2))
    nothing = np.full(len(steps), np.nan)
    ranged = number == "range"
    return Log(
        dt=dt, controls=controls, steps=np.zeros(0), landmarks=np.zeros(0), sightings=np.zeros((0, 2)),
        initial_poses=motion.dead_reckoning(truth[0], controls, dt), true_poses=truth,
        true_landmarks=dict(enumerate(places)), motion=motion, sensor=sensor, simulated=True, name=f"{number} only",
        partial_sightings=PartialSightings(
            steps=steps, landmarks=seen, ranges=np.maximum(z[:, 0], 1e-3) if ranged else nothing,
            bearings=nothing if ranged else z[:, 1],
        ),
    )  # fmt: skip


def _lanes(poses: int, size: float, count: int) -> Array:
    """Poses (T+1, 3) along lanes over a square field, joined by half circles, at equal distances of arc."""
    width = size / count
    radius = width / 2
    lane, turn = size, np.pi * radius
    total = count * lane + (count - 1) * turn
    way = np.linspace(0.0, total, poses)
    number = np.minimum((way / (lane + turn)).astype(int), count - 1)
    along = way - number * (lane + turn)
    up = number % 2 == 0
    angle = np.maximum(along - lane, 0.0) / radius
    straight = np.minimum(along, lane)
    x = radius + number * width + radius * (1 - np.cos(angle))
    y = np.where(up, straight, size - straight) + np.where(up, 1, -1) * radius * np.sin(angle)
    theta = np.where(up, np.pi / 2 - angle, -np.pi / 2 + angle)
    return np.column_stack([x, y, theta])
