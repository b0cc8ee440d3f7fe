"""Places where robots work: their landmarks, walls that occlude them, and the way of a robot through them.

warehouse   aisles between racks with tags, joined by cross aisles at both ends; aisles in random order
orchard     rows of trunks; along a few lanes between them in random order
field       scattered reflectors; rounds through the same region, in both directions

`follow`: the true motion of a robot along way points, with limits of speed, turn rate and acceleration, and with stops.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from math import atan2, cos, hypot, pi, sin, sqrt

import numpy as np

from ..models import MotionModel
from ..se2 import Array, wrap

#: a tag is read under an angle of at most this to its normal [rad]
STEEPEST = 1.4
#: the part of the ends of lines at which the robot stops, and for how long at most [s]
STOPS, LONGEST_STOP = 0.25, 6.0
#: the number of lanes of an orchard in which the robot works
LANES = 4

WayPoint = tuple[float, float, float]


@dataclass(frozen=True)
class Place:
    """A place of work.

    Attributes:
        landmarks: (L, 3) positions and headings.
        facing: whether landmarks are seen from the front only, where their heading points.
        walls: (W, 4) the ends x_1, y_1, x_2, y_2 of the walls that occlude landmarks [m].
        route: way points (x, y, pause) without end [m, m, s].
    """

    landmarks: Array
    facing: bool
    walls: Array
    route: Iterator[WayPoint]

    def in_sight(self, eyes: Array, landmarks: np.ndarray) -> np.ndarray:
        """Whether landmarks (N,), given by their rows, are not occluded, from positions (N, 2 or more); (N,) bool."""
        targets = self.landmarks[landmarks]
        to = targets[:, :2] - eyes[:, :2]
        seen = np.ones(len(eyes), dtype=bool)
        if self.facing:
            seen &= np.abs(wrap(np.arctan2(-to[:, 1], -to[:, 0]) - targets[:, 2])) <= STEEPEST
        for x_1, y_1, x_2, y_2 in self.walls:
            along = np.array([x_2 - x_1, y_2 - y_1])
            from_wall = eyes[:, :2] - [x_1, y_1]
            # eye + s to = wall + t along
            cross = to[:, 0] * along[1] - to[:, 1] * along[0]
            with np.errstate(divide="ignore", invalid="ignore"):
                s = (along[0] * from_wall[:, 1] - along[1] * from_wall[:, 0]) / cross
                t = (to[:, 0] * from_wall[:, 1] - to[:, 1] * from_wall[:, 0]) / cross
            seen &= ~((s > 0) & (s < 1) & (t >= 0) & (t <= 1))
        return seen


def _pause(rng: np.random.Generator) -> float:
    return float(rng.uniform(1.0, LONGEST_STOP)) if rng.random() < STOPS else 0.0


def warehouse(count: int, _reach: float, rng: np.random.Generator) -> Place:
    """Four to seven aisles of 20 to 40 m; a tag at each end of each rack, the others along the aisles."""
    aisles, spacing, length = int(rng.integers(4, 8)), rng.uniform(4.5, 6.0), rng.uniform(20.0, 40.0)
    racks = (np.arange(aisles + 1) - 0.5) * spacing
    ends = [(x, y, heading) for x in racks for y, heading in ((-0.2, -pi / 2), (length + 0.2, pi / 2))]
    if len(ends) > count // 2:
        ends = [ends[k] for k in np.sort(rng.choice(len(ends), count // 2, replace=False))]
    faces = [(i * spacing + side * (spacing / 2 - 0.6), side) for i in range(aisles) for side in (-1, 1)]
    along = count - len(ends)
    # as even as tags on racks are: one in each of as many equal parts of all faces laid end to end
    at = (np.arange(along) + rng.uniform(0.1, 0.9, along)) / along * len(faces)
    face = at.astype(int)
    tags = [(faces[f][0], (a - f) * length, pi if faces[f][1] > 0 else 0.0) for f, a in zip(face, at)]
    walls = np.column_stack([racks, np.zeros(aisles + 1), racks, np.full(aisles + 1, length)])

    def route() -> Iterator[WayPoint]:
        aisle, low = 0, True
        yield 0.0, -2.0, 0.0
        while True:
            # a stop between the racks
            if rng.random() < STOPS:
                middle = rng.uniform(0.2, 0.8) * length
                yield aisle * spacing, middle, float(rng.uniform(1.0, LONGEST_STOP))
            low = not low
            y = -2.0 if low else length + 2.0
            yield aisle * spacing, y, _pause(rng)
            others = [i for i in range(aisles) if i != aisle]
            near = [i for i in others if abs(i - aisle) <= 2]
            aisle = int(rng.choice(near if rng.random() < 0.8 else others))
            yield aisle * spacing, y, 0.0

    return Place(np.array(ends + tags), True, walls, route())


def orchard(count: int, _reach: float, rng: np.random.Generator) -> Place:
    """Three to eight rows of trunks, 3 to 5 m apart, that are not quite in line."""
    rows, spacing = int(np.clip(round(sqrt(count / 2.0)), 3, 8)), rng.uniform(3.5, 5.0)
    trunk, gap = np.arange(count), rng.uniform(3.0, 5.0)
    places = np.column_stack([trunk % rows * spacing, trunk // rows * gap]) + rng.normal(0, 0.15, (count, 2))
    length = (count - 1) // rows * gap

    def route() -> Iterator[WayPoint]:
        lane, low = 0, True
        yield -spacing / 2, -3.0, 0.0
        while True:
            low = not low
            y = -3.0 if low else length + 3.0
            yield (lane - 0.5) * spacing, y, _pause(rng)
            lane = int(rng.choice([other for other in range(LANES) if other != lane]))
            yield (lane - 0.5) * spacing, y, 0.0

    landmarks = np.column_stack([places, rng.uniform(-pi, pi, count)])
    return Place(landmarks, False, np.zeros((0, 4)), route())


def field(count: int, reach: float, rng: np.random.Generator) -> Place:
    """A square about as large as the sensor sees; rounds through five to eight way points, with changes of direction."""
    half = rng.uniform(0.8, 1.5) * reach
    landmarks = np.column_stack([rng.uniform(-half, half, (count, 2)), rng.uniform(-pi, pi, count)])
    corners = int(rng.integers(5, 9))
    angles = (np.arange(corners) + rng.uniform(-0.25, 0.25, corners)) / corners * 2 * pi
    radii = rng.uniform(0.35, 0.8, corners) * half

    def route() -> Iterator[WayPoint]:
        at, step = 0, 1
        while True:
            yield float(radii[at] * np.cos(angles[at])), float(radii[at] * np.sin(angles[at])), _pause(rng)
            step = -step if rng.random() < 0.08 else step
            at = (at + step) % corners

    return Place(landmarks, False, np.zeros((0, 4)), route())


#: the places by name, each made for a number of landmarks and the range of a sensor [m]
PLACES: dict[str, Callable[[int, float, np.random.Generator], Place]] = {
    "warehouse": warehouse, "orchard": orchard, "field": field,
}  # fmt: skip


#: the interval at which the robot is steered [s], and its greatest accelerations [m/s², rad/s²]
INTERVAL, ACCELERATION, TURN_ACCELERATION = 0.05, 0.8, 2.5
#: turn rate per heading error [1/s]; the heading error above which the robot turns in place [rad]
GAIN, SHARP = 2.0, 0.8


@dataclass(frozen=True)
class Path:
    """A true trajectory: knots every `INTERVAL` seconds from time 0, and between them arcs on which the robot slips evenly.

    Attributes:
        poses: (K+1, 3), headings not wrapped.
        controls: (K, 2) true speeds and turn rates.
        slips: (K,) how far the robot slips to its left [m].
    """

    poses: Array
    controls: Array
    slips: Array

    @property
    def duration(self) -> float:
        """The time of the last knot [s]."""
        return len(self.controls) * INTERVAL

    def at(self, times: Array) -> Array:
        """The poses (N, 3) at times (N,) [s]."""
        k = np.clip((times / INTERVAL).astype(np.int64), 0, len(self.controls) - 1)
        lapse = times - k * INTERVAL
        poses = MotionModel().f(self.poses[k], self.controls[k], lapse)
        across = self.poses[k, 2] + self.controls[k, 1] * INTERVAL / 2
        part = self.slips[k] * lapse / INTERVAL
        poses[:, 0] -= part * np.sin(across)
        poses[:, 1] += part * np.cos(across)
        return poses

    def odometry(self, times: Array) -> Array:
        """The controls (N, 2), each constant until the next time, that lead from pose to pose at ``times`` (N,).

        The arc with the turn and with the part of the displacement along its chord; slip is not seen. The last control is
        that before it.
        """
        poses = self.at(times)
        lasting, (dx, dy, turn) = np.diff(times), np.diff(poses, axis=0).T
        along = poses[:-1, 2] + turn / 2
        # np.sinc is sin(pi x) / (pi x)
        nu = (dx * np.cos(along) + dy * np.sin(along)) / (lasting * np.sinc(turn / (2 * pi)))
        controls = np.column_stack([nu, turn / lasting])
        return np.concatenate([controls, controls[-1:]])


def follow(
    route: Iterable[tuple[float, float, float]], *, speed: float, turn_rate: float, duration: float, slip: float,
    wander: float, rng: np.random.Generator,
) -> Path:  # fmt: skip
    """Drive from the first way point on along the straight lines between way points.

    Args:
        route: way points (x, y, pause): where, and for how long the robot stops there [m, m, s]; as many as the time needs.
        speed, turn_rate: the highest ones [m/s, rad/s].
        duration: of the drive [s].
        slip: noise sideways per distance driven [m/√m].
        wander: standard deviation of the robot's distance from the lines, drawn for each line [m].
        rng: of slip and wander.
    """
    steps = int(np.ceil(duration / INTERVAL))
    normals = (slip * rng.standard_normal(steps)).tolist()
    ahead, dt = 0.5 + 0.6 * speed, INTERVAL
    points = iter(route)
    ax, ay, _ = next(points)
    bx, by, pause = _other_than(ax, ay, points)
    x, y, theta, nu, omega, rest = ax, ay, atan2(by - ay, bx - ax), 0.0, 0.0, 0.0
    side = 0.0
    poses, controls, slips = [(x, y, theta)], [], []
    for k in range(steps):
        length = hypot(bx - ax, by - ay)
        ux, uy = (bx - ax) / length, (by - ay) / length
        left = length - (x - ax) * ux - (y - ay) * uy
        if left < 0.15 + 0.2 * nu and rest <= 0:
            rest = pause
            ax, ay = bx, by
            bx, by, pause = _other_than(ax, ay, points)
            side = wander * float(rng.standard_normal())
        if rest > 0:
            rest -= dt
            want, turn = 0.0, 0.0
        else:
            # towards a point ahead on the line, beside which the robot drives
            on = min(length - left + ahead, length + 0.3)
            px, py = ax + ux * on - uy * side, ay + uy * on + ux * side
            off = (atan2(py - y, px - x) - theta + pi) % (2 * pi) - pi
            turn = min(max(GAIN * off, -turn_rate), turn_rate)
            # slower towards the end of a line, and while the robot has to turn
            want = min(speed * max(0.0, 1 - abs(off) / SHARP), sqrt(2 * ACCELERATION * max(left, 0.0)) + 0.1)
        most = ACCELERATION * dt
        nu += min(max(want - nu, -most), most)
        most = TURN_ACCELERATION * dt
        omega += min(max(turn - omega, -most), most)
        half = omega * dt / 2
        chord = nu * dt * (sin(half) / half if abs(half) > 1e-9 else 1.0)
        across = normals[k] * sqrt(abs(nu) * dt)
        c, s = cos(theta + half), sin(theta + half)
        x, y, theta = x + chord * c - across * s, y + chord * s + across * c, theta + 2 * half
        poses.append((x, y, theta))
        controls.append((nu, omega))
        slips.append(across)
    return Path(np.array(poses), np.array(controls), np.array(slips))


def _other_than(x: float, y: float, points: Iterator[tuple[float, float, float]]) -> tuple[float, float, float]:
    """The next way point that is not at (x, y)."""
    return next(point for point in points if hypot(point[0] - x, point[1] - y) > 1e-6)
