"""`World`: the course of a simulated robot, its landmarks and camera; named worlds and sensors; a sample log; single numbers.

`simulate_single_numbers` makes logs of sensors that measure one number: ranges of radio beacons, or bearings of a camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from math import pi
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import OptionError, quoted
from ..errors.checks import array_of, check_choice, check_count, check_heading, check_options, option
from ..log import Log
from ..log.measurements import PartialSightings
from ..models import MotionModel, SensorModel
from ..se2 import Array, between

#: rows of x, y (and heading) [m, m, rad]
Places = tuple[tuple[float, ...], ...]

#: the six landmarks of the book's logs, ids 0 to 5 [m]
BOOK_LANDMARKS: Places = ((-4.0, 2.0), (2.0, -3.0), (3.0, 3.0), (0.0, 4.0), (1.0, 1.0), (-3.0, -1.0))


#: the most steps and landmarks of a world
_MOST = 10_000_000


@dataclass(frozen=True, kw_only=True)
class World:
    """The settings of `simulate`; arrays and lists are accepted for tuples.

    Raises:
        OptionError: an option has an impossible value.
    """

    steps: int = option(62, "Number of motions T; the log has T + 1 poses", minimum=1, maximum=_MOST)
    dt: float = option(3.0, "Duration of each motion", "s", positive=True)
    speed: float = option(0.2, "Speed on the circle; with way points, the highest speed", "m/s", positive=True)
    turn_rate: float = option(pi / 36, "Turn rate on the circle; with way points, the highest turn rate", "rad/s")
    way_points: tuple[tuple[float, ...], ...] | None = option(
        None, "Positions to visit in turn, repeatedly; default: drive a circle", "m"
    )
    start: tuple[float, ...] = option((0.0, -3.0, 0.0), "First pose, true and dead-reckoned", "m, m, rad")
    landmarks: tuple[tuple[float, ...], ...] | int = option(
        BOOK_LANDMARKS, "Landmarks 'x,y x,y ...' ('x,y,heading' also allowed), or how many to place at random", "m"
    )
    arena: float | None = option(
        None, "Half the side of the square world; default: as large as needed", "m", positive=True
    )
    min_range: float = option(0.5, "Least range of the camera", "m")
    max_range: float = option(6.0, "Greatest range of the camera", "m", positive=True)
    field_of_view: float = option(2 * pi / 3, "Whole opening angle of the camera", "rad", positive=True)
    orientation: bool = option(True, "Sightings have the orientation psi; landmarks without a heading face along x")
    clean: bool = option(False, "No faults; the noise follows the estimators' models exactly")

    def __post_init__(self) -> None:
        start, route, landmarks = array_of("start", self.start), self.way_points, self.landmarks
        if start.shape != (3,):
            raise OptionError(f"start must be (x, y, theta), not an array of shape {start.shape}")
        check_heading("start", start[2])
        object.__setattr__(self, "start", tuple(start.tolist()))
        if route is not None:
            object.__setattr__(self, "way_points", _places("way_points must have shape (W, 2)", route, (2,)))
        if not isinstance(landmarks, (Sequence, np.ndarray)) or isinstance(landmarks, str):
            check_count(landmarks=landmarks)
            if landmarks > _MOST:
                raise OptionError(f"landmarks must be at most {_MOST:,}, not {quoted(landmarks)}")
            object.__setattr__(self, "landmarks", int(landmarks))
            if self.landmarks < 1:  # type: ignore[operator]
                raise OptionError(f"landmarks must be at least 1, not {landmarks}")
        else:
            rule = "landmarks must be a number or an array of shape (L, 2) or (L, 3)"
            object.__setattr__(self, "landmarks", _places(rule, landmarks, (2, 3)))
        check_options(self)
        if not 0 <= self.min_range < self.max_range:
            raise OptionError(f"min_range must lie between 0 and {self.max_range:g} m, not {quoted(self.min_range)}")


def _places(rule: str, value: Any, columns: tuple[int, ...]) -> Places:
    places = array_of(rule.split()[0], value)
    if places.ndim != 2 or places.shape[1] not in columns or len(places) == 0:
        raise OptionError(f"{rule}, not {places.shape}")
    if not np.isfinite(places).all():
        raise OptionError(f"{rule.split()[0]} must be finite numbers")
    return tuple(map(tuple, places.tolist()))


#: the named worlds
WORLDS: dict[str, World] = {
    # six landmarks around a circle, as in the logs of the book
    "book": World(),
    # two rounds through thirteen landmarks; the robot sees about two of them at a time
    "garden": World(
        steps=160, dt=1.0, speed=0.4, turn_rate=0.5, start=(0.0, -2.5, 0.0), max_range=5.0, field_of_view=pi,
        way_points=((4, -3.5), (6, 0), (4, 3.5), (0, 2), (-4, 3.5), (-6, 0), (-4, -3.5), (0, -2)),
        landmarks=(
            (-7.5, -3.5), (-7.5, 3), (-4, 0), (-2, 5), (2, 4.6), (0, 0), (4, 0), (7.5, 3.2), (7.6, -3), (2.2, -4.8),
            (-2, -4.8), (-4.9, 5.6), (5.2, 6),
        ),
    ),
}  # fmt: skip


#: the sensors by name, with typical noise
SENSORS = {
    "camera": SensorModel(range_rate=0.02, range_std=0.01, bearing_std=0.006, orientation_std=0.04, min_range=0.4,
                          max_range=8.0, field_of_view=1.92),
    "laser": SensorModel(range_rate=0.0, range_std=0.03, bearing_std=0.006, orientation_std=0.05, min_range=0.2,
                         max_range=11.0, field_of_view=3 * pi / 2),
    "reflectors": SensorModel(range_rate=0.0, range_std=0.02, bearing_std=0.003, orientation_std=0.05, min_range=0.5,
                              max_range=30.0),
}  # fmt: skip


def sample_log_path() -> Path:
    """The log shipped with the package, made by ``slam-compare simulate sample.npz --world garden --seed 1``."""
    return Path(str(files("graphslam") / "data" / "sample.npz"))


#: the sides of the field of `simulate_single_numbers` [m]
SIZE = 40.0
#: what the sensor measures
NUMBERS = ("range", "bearing")
#: the noise of a mower with radio beacons or a camera
MOTION = MotionModel(nn=0.03, no=0.001, on=0.01, oo=0.03, epsilon=1e-8)
SENSOR = SensorModel.constant(0.1, 0.02)


def simulate_single_numbers(
    number: str,
    *,
    seed: int | np.random.Generator = 0,
    poses: int = 300,
    landmarks: int = 8,
    every: int = 2,
    lanes: int = 6,
) -> Log:
    """A robot that mows a square field in lanes, and measures the range or the bearing of one landmark after the other.

    The controls are the true motions with the noise of the motion model, and the initial poses are those of dead reckoning.

    Args:
        number: "range" or "bearing".
        seed: of landmarks and noise.
        poses: number of poses, one a second.
        landmarks: number of landmarks, anywhere in the field or up to a quarter of its size outside.
        every: a sighting at every so many poses.
        lanes: 1 is a straight way, from which ranges have mirror images.
    """
    check_choice("number", number, NUMBERS)
    check_count(poses=poses, landmarks=landmarks, every=every, lanes=lanes)
    if 0 in (poses, landmarks, every, lanes):
        raise OptionError("poses, landmarks, every and lanes must be at least 1")
    rng, motion, sensor = np.random.default_rng(seed), MOTION, SENSOR
    truth = _lanes(poses, lanes)
    moved = between(truth[:-1], truth[1:])
    # speed and turn rate of the arc to the next pose
    half = moved[:, 2] / 2
    controls = np.column_stack([np.hypot(moved[:, 0], moved[:, 1]) / np.sinc(half / np.pi), moved[:, 2]])
    dt = np.ones(poses - 1)
    spread = np.sqrt(np.diagonal(motion.M(controls, dt), axis1=1, axis2=2))
    controls = controls + spread * rng.standard_normal(controls.shape)
    places = rng.uniform(-SIZE / 4, SIZE * 1.25, (landmarks, 2))
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


def _lanes(poses: int, count: int) -> Array:
    """Poses (T+1, 3) along lanes over a square field, joined by half circles, at equal distances of arc."""
    width, radius = SIZE / count, SIZE / count / 2
    both = SIZE + np.pi * radius
    way = np.linspace(0.0, count * both - np.pi * radius, poses)
    number = np.minimum((way / both).astype(int), count - 1)
    along, up = way - number * both, number % 2 == 0
    angle, straight = np.maximum(along - SIZE, 0.0) / radius, np.minimum(along, SIZE)
    x = radius + number * width + radius * (1 - np.cos(angle))
    y = np.where(up, straight, SIZE - straight) + np.where(up, 1, -1) * radius * np.sin(angle)
    theta = np.where(up, np.pi / 2 - angle, -np.pi / 2 + angle)
    return np.column_stack([x, y, theta])
