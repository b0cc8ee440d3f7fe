"""Places where robots work: their landmarks, walls that occlude them, and the way of a robot through them.

warehouse   aisles between racks with tags, joined by cross aisles at both ends; aisles in random order
orchard     rows of trunks; along a few lanes between them in random order
field       scattered reflectors; rounds through the same region, in both directions
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import pi, sqrt

import numpy as np

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
