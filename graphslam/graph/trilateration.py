"""Where a landmark can be that was seen by range or bearing alone, and the edges of such sightings.

From given poses the cost of a landmark's single numbers, two unknowns, is minimised by Levenberg-Marquardt from many places.
Each minimum is a place that they leave: two mirror images for ranges from a straight way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..edges import BearingEdges, PartialEdges, RangeEdges
from ..edges.robust import Kernel
from ..errors import GraphError, checks
from ..log import Log
from ..log.measurements import PartialSightings
from ..models import SensorModel
from ..se2 import Array, mounted

#: a place is clear where J at the second best one is higher by at least this
MIN_GAP = 30.0
#: other places of a landmark are tried where J there, on the same trajectory, is higher by at most this
TRIED = 200.0
#: directions, and distances as parts of the greatest one, from which places are searched
DIRECTIONS, DISTANCES = 24, (0.02, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0)
#: steps of the search, and how far away a landmark may be for bearings, in lengths of the way
STEPS, FAR = 60, 5.0
#: steps with more damping than this may be short anywhere
SETTLED = 1.0
#: ends that are nearer to each other than this part of the distance are one place
SAME = 1e-3
#: a place is known where its standard deviation is below this part of the distance
KNOWN = 0.5
#: the information of a landmark is singular where its smaller eigenvalue is below this part of the larger one
SINGULAR = 1e-8


@dataclass(frozen=True)
class Places:
    """The places (K, 2) that single numbers leave for a landmark, by rising cost (K,).

    Attributes:
        determined: whether the numbers determine the first of them at all.
        known: whether its standard deviation is small beside its distance.
    """

    places: Array
    costs: Array
    determined: bool = False
    known: bool = False

    @property
    def clear(self) -> bool:
        """Whether one place is far more likely than all others."""
        return self.known and (len(self.costs) == 1 or self.costs[1] - self.costs[0] > MIN_GAP)


def edges_of_single_numbers(
    partial: PartialSightings, nodes: np.ndarray, sensor: SensorModel, kernel: Kernel | None
) -> list[PartialEdges]:
    """The edges of ranges and of bearings alone, whose landmarks have the nodes (K,)."""
    ranged, found = partial.ranged, list[PartialEdges]()
    variance = (sensor.range_rate * partial.ranges[ranged]) ** 2 + sensor.range_std**2
    for kind, rows, measured, spread in (
        (RangeEdges, ranged, partial.ranges, variance),
        (BearingEdges, ~ranged, partial.bearings, np.full(np.sum(~ranged), sensor.bearing_std**2)),
    ):
        if rows.any():
            parts = partial.steps[rows], nodes[rows], measured[rows, None], 1 / spread[:, None, None]
            found.append(kind(*parts, np.array(sensor.offset), kernel=kernel))
    return found


#: the fewest single numbers from which a landmark is placed, and the factor by which they grow after each attempt
FEWEST, MORE = 3, 1.25


#: a single number of a landmark: the step of the pose, range and bearing, one of which is NaN
NumberRow = tuple[int, float, float]


@dataclass
class WaitingNumbers:
    """Single numbers, one after the other, of landmarks that have no place yet.

    Attributes:
        rows: the numbers of each landmark.
        tried: how many there were at the last attempt to find its place.
    """

    sensor: SensorModel
    rows: dict[int, tuple[NumberRow, ...]] = field(default_factory=dict)
    tried: dict[int, int] = field(default_factory=dict)

    def copy(self) -> WaitingNumbers:
        """The same numbers, to go back to."""
        return WaitingNumbers(self.sensor, self.rows.copy(), self.tried.copy())

    def take(self, id: int, since: int = 0) -> tuple[NumberRow, ...]:
        """The numbers of a landmark, which waits no longer; those from poses before ``since`` are dropped."""
        self.tried.pop(id, None)
        return tuple(each for each in self.rows.pop(id, ()) if each[0] >= since)

    def add(self, id: int, row: NumberRow, poses: Callable[[], Array], since: int = 0) -> Array | None:
        """Keep a number, and return the place (2,) of its landmark where all its numbers leave one.

        Args:
            id: the landmark.
            row: the number.
            poses: gives the poses (T, 3) so far.
            since: numbers from poses before this one are dropped.
        """
        kept = tuple(each for each in (*self.rows.get(id, ()), row) if each[0] >= since)
        self.rows[id] = kept
        tried = min(self.tried.get(id, 0), len(kept) - 1)
        if len(kept) < max(FEWEST, MORE * tried):
            return None
        self.tried[id] = len(kept)
        found = places_of_rows(id, kept, self.sensor, poses())
        return found.places[0] if found.clear else None


def places_of_rows(id: int, rows: Sequence[NumberRow], sensor: SensorModel, poses: Array) -> Places:
    """The places that single numbers of one landmark leave from poses (T, 3)."""
    return places_of(edges_of_rows(id, rows, sensor, len(poses)), poses)


def edges_of_rows(
    id: int, rows: Sequence[NumberRow], sensor: SensorModel, node: int, kernel: Kernel | None = None
) -> list[PartialEdges]:
    """The edges of single numbers (step, range, bearing) of one landmark."""
    steps, ranges, bearings = (np.array(column) for column in zip(*rows))
    ids = np.full(len(rows), id)
    numbers = PartialSightings(steps=steps.astype(np.int64), landmarks=ids, ranges=ranges, bearings=bearings)
    return edges_of_single_numbers(numbers, np.full(len(rows), node), sensor, kernel)


def placed_single_numbers(
    log: Log, sensor: SensorModel, kernel: Kernel | None, known: Mapping[int, Array]
) -> tuple[PartialSightings, dict[int, Array], tuple[str, ...]]:
    """The partial sightings that a graph can use, the places of landmarks that have no others, and notes.

    Args:
        known: landmarks of a map, which have a place.

    Raises:
        GraphError: landmarks have headings, about which ranges and bearings say nothing.
    """
    partial = log.partial_sightings
    if partial is None:
        return _NO_SIGHTINGS, {}, ()
    if log.has_orientation:
        raise GraphError(
            f"{log.name} has sightings with psi beside ranges or bearings alone, which say nothing about the heading of a "
            "landmark: use dimensions=2"
        )
    _, nodes = np.unique(partial.landmarks, return_inverse=True)
    edges = edges_of_single_numbers(partial, log.num_poses + nodes, sensor, kernel)
    places, open_ = dict[int, Array](), list[int]()
    for j in np.setdiff1d(partial.landmarks, [*log.landmark_ids, *known]).tolist():
        node = log.num_poses + int(nodes[np.argmax(partial.landmarks == j)])
        found = places_of([f.among(f.second == node) for f in edges], log.initial_poses)
        if found.determined:
            places[j] = found.places[0]
        else:
            open_.append(j)
    why = "left out: their ranges or bearings from this way leave any number of places"
    notes = (f"{checks.listed('landmark', open_)} {why}",) if open_ else ()
    return partial.among(~np.isin(partial.landmarks, open_)), places, notes


_NONE = np.zeros(0)
_NO_SIGHTINGS = PartialSightings(steps=_NONE, landmarks=_NONE, ranges=_NONE, bearings=_NONE)


def places_of(seen: Iterable[PartialEdges], state: Array) -> Places:
    """The places of one landmark, given its edges, from the poses of a state (n, 3)."""
    parts = [family for family in seen if family.count]
    if not parts:
        return Places(np.zeros((0, 2)), np.zeros(0))
    sensors = [mounted(state[part.first], tuple(part.offset)) for part in parts]
    where = np.concatenate([each[:, :2] for each in sensors])
    extent = float(np.hypot(*(where.max(axis=0) - where.min(axis=0))))
    ranges = [part.measured[:, 0].max() for part in parts if isinstance(part, RangeEdges)]
    reach = max([*ranges, FAR * extent if not ranges else 0.0, 1e-3])
    turns = np.arange(DIRECTIONS) * (2 * np.pi / DIRECTIONS)
    around = np.stack([np.cos(turns), np.sin(turns)], axis=1)
    starts = (where.mean(axis=0) + reach * np.multiply.outer(np.array(DISTANCES), around)).reshape(-1, 2)
    m, damping = starts, np.full(len(starts), 1e-3)
    cost, H, g = _normal(parts, sensors, m)
    moving = np.arange(len(m))
    for _ in range(STEPS):
        damped = H[moving] + damping[moving, None, None] * _diagonal(H[moving])
        step = np.linalg.solve(damped, -g[moving, :, None])[..., 0]
        tried, tried_H, tried_g = _normal(parts, sensors, m[moving] + step)
        better = tried < cost[moving]
        lower = moving[better]
        m[lower] += step[better]
        cost[lower], H[lower], g[lower] = tried[better], tried_H[better], tried_g[better]
        damping[moving] = np.clip(np.where(better, damping[moving] / 5, damping[moving] * 5), 1e-9, 1e9)
        # a short step may also be one that is damped much
        moving = moving[(np.abs(step).max(axis=1) >= SAME * reach / 10) | (damping[moving] > SETTLED)]
        if not len(moving):
            break
    far = np.hypot(*(m - where.mean(axis=0)).T)
    left = np.linalg.solve(H + 1e-12 * _diagonal(H), g[..., None])[..., 0]
    ended = np.flatnonzero(np.hypot(*left.T) <= SAME * np.maximum(far, reach))
    ended = ended[np.argsort(cost[ended], kind="stable")]
    kept: list[int] = []
    while len(ended):
        kept.append(int(ended[0]))
        ended = ended[np.hypot(*(m[ended] - m[kept[-1]]).T) > SAME * (reach + far[ended])]
    if not kept:
        return Places(np.zeros((0, 2)), np.zeros(0))
    best = kept[0]
    distance = max(np.hypot(*(where - m[best]).T).min(), 1e-3)
    least, most = np.linalg.eigvalsh(H[best]).tolist()
    determined = least > SINGULAR * most
    return Places(m[kept], cost[kept], determined, known=determined and least > (KNOWN * distance) ** -2)


def other_places(found: Iterable[tuple[int, Places, Array]]) -> Iterator[dict[int, Array]]:
    """Other places {landmark: (2,)} that are not much worse on the same trajectory: of one each, then of all at once.

    A straight way has a mirror image as a whole, in which single landmarks would contradict the others.

    Args:
        found: (landmark, the places that its numbers leave, where it is now) of each.
    """
    together: dict[int, Array] = {}
    for landmark, each, now in found:
        here = int(np.argmin(np.hypot(*(each.places - now[:2]).T))) if len(each.places) else 0
        for k, cost in enumerate(each.costs):
            if k != here and cost - each.costs[0] < TRIED:
                together.setdefault(landmark, each.places[k])
                yield {landmark: each.places[k]}
    if len(together) > 1:
        yield together


def _normal(parts: list[PartialEdges], sensors: list[Array], m: Array) -> tuple[Array, Array, Array]:
    """The cost (S,) of a landmark at places (S, 2), its Gauss-Newton matrix (S, 2, 2) and half its gradient (S, 2)."""
    cost, H, g = np.zeros(len(m)), np.zeros((len(m), 2, 2)), np.zeros((len(m), 2))
    for part, places in zip(parts, sensors):
        e, by_landmark, _ = part.residuals(places, m[:, None, :])
        squares = e**2 * part.weighed[:, 0, 0]
        w = np.broadcast_to(part.weighed[:, 0, 0], squares.shape)
        if part.kernel is not None:
            w = w * part.kernel.weight(squares)
            squares = part.kernel.loss(squares)
        cost += squares.sum(axis=1)
        # two products take a third of the time of one of three arrays
        weighed = w[..., None] * by_landmark
        H += np.swapaxes(weighed, 1, 2) @ by_landmark
        g += np.einsum("se,sei->si", e, weighed)
    return cost, H, g


def _diagonal(H: Array) -> Array:
    """The diagonal matrices (S, 2, 2) by which Levenberg-Marquardt damps, never zero."""
    size = np.trace(H, axis1=1, axis2=2)
    return (np.einsum("sii->si", H) + 1e-9 * size[:, None] + 1e-300)[:, :, None] * np.eye(2)
