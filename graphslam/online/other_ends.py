"""Other ends of an online solution: J has several minima, and steps follow the nearest one.

The cost of ranges or bearings alone has several minima, and so has that of absolute positions while the direction of the way
is hardly known. So whenever there are a quarter more of them, other places of a landmark, and the way where its positions put
it in closed form, are tried with the whole graph, and the lower J counts, as in `solvers.initialize` (`OtherEnds`).

With a robust kernel, whole sightings have several minima, too: a landmark stays at its first sighting, even a wrong one, as
all that contradict it lose their weight. So it is tried where its latest sightings put it (`LatestSightings`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..edges import PositionEdges
from ..edges.robust import Kernel
from ..graph.defaults import into_world
from ..graph.trilateration import (
    KNOWN,
    MIN_GAP,
    MORE,
    NumberRow,
    WaitingNumbers,
    edges_of_rows,
    other_places,
    places_of_rows,
)
from ..models import SensorModel
from ..se2 import Array, between, compose, difference, wrap

#: the way is tried where its positions put it when that turns it by more than this [rad]
TURNED = 0.1
#: the fewest positions that say something about the direction
POSITIONS = 3
#: so many of the latest whole sightings of a landmark say where else it may be
LATEST = 16


@dataclass
class OtherEnds:
    """Other ends of an online solution: what the solver needs to find them.

    Attributes:
        waiting: the single numbers of landmarks that have no place yet.
        numbers: those of landmarks that have a place by them alone.
        positions: (pose, measured, information, lever) of each.
        tried: how many numbers each of these landmarks had when its other places were tried last.
        turned_at: how many positions there were when they last moved the way in closed form.
    """

    sensor: SensorModel
    waiting: WaitingNumbers
    numbers: dict[int, list[NumberRow]] = field(default_factory=dict)
    positions: list[tuple[int, Array, Array, Array]] = field(default_factory=list)
    tried: dict[int, int] = field(default_factory=dict)
    turned_at: int = 0

    def placed(self, landmark: int, rows: Iterable[NumberRow]) -> None:
        """Note the numbers by which a landmark has got its place."""
        self.numbers[landmark] = list(rows)
        self.tried[landmark] = len(self.numbers[landmark])

    def seen(self, whole: Iterable[int], rows: Iterable[tuple[int, NumberRow]]) -> None:
        """Note landmarks that were seen again: as a whole, and so in one place, or by single numbers."""
        for landmark in whole:
            self.numbers.pop(landmark, None)
        for landmark, row in rows:
            if landmark in self.numbers:
                self.numbers[landmark].append(row)

    def doubts(
        self, rows: Sequence[tuple[int, NumberRow]], poses: Callable[[], Array], place: Callable[[int], Array]
    ) -> list[int]:
        """The landmarks whose other places are to be tried: all where a number surprises, or those with many more numbers."""
        rows = [(id, row) for id, row in rows if id in self.numbers]
        state = poses() if rows else np.zeros((0, 3))
        for id, row in rows:
            nodes = np.concatenate([state, place(id)[None]])
            for each in edges_of_rows(id, [row], self.sensor, len(state)):
                if each.linearize(nodes, nodes).mahalanobis[0] > MIN_GAP:
                    return list(self.numbers)
        return [id for id, _ in rows if len(self.numbers[id]) + 1 >= MORE * self.tried[id]]

    def elsewhere(self, poses: Array, places: Mapping[int, Array], tried: Sequence[int]) -> Iterator[dict[int, Array]]:
        """Other places {id: (2,)} of landmarks from poses (T, 3); see `graph.trilateration.other_places`."""
        for id in tried:
            self.tried[id] = len(self.numbers[id])
        return other_places((id, places_of_rows(id, self.numbers[id], self.sensor, poses), places[id]) for id in tried)

    def unknown(self, poses: Array, place: Callable[[int], Array]) -> list[int]:
        """The landmarks that are not where their numbers from poses (T, 3) put them, or which these do not put anywhere."""
        found = list[int]()
        for id, rows in self.numbers.items():
            by_numbers, now = places_of_rows(id, rows, self.sensor, poses), place(id)[:2]
            distance = np.hypot(*(now - poses[rows[-1][0], :2]))
            if not by_numbers.known or np.hypot(*(by_numbers.places[0] - now)) > KNOWN * distance:
                found.append(id)
        return found

    def wait_again(self, landmark: int) -> int:
        """Let a landmark wait for a place until it has a quarter more numbers; returns how many it has."""
        self.waiting.rows[landmark] = rows = tuple(self.numbers.pop(landmark))
        self.waiting.tried[landmark] = len(rows)
        return len(rows)

    def turned(self, state: Array, poses: int) -> Array | None:
        """A state (n, 3), poses first, where the positions put it in closed form, where that is due and far from it."""
        count = len(self.positions)
        if count < max(POSITIONS, MORE * self.turned_at):
            return None
        self.turned_at = count
        families = []
        for d in (2, 3):
            if rows := [row for row in self.positions if len(row[1]) == d]:
                nodes, measured, information, levers = map(np.array, zip(*rows))
                families.append(PositionEdges(nodes, measured, information, levers))
        moved = into_world(state, families, poses)
        return moved if abs(wrap(moved[0, 2] - state[0, 2])) > TURNED else None


#: a whole sighting: the pose, what is measured (d = 2 or 3) in its axes, and the information (d, d)
Row = tuple[int, Array, Array]


@dataclass
class LatestSightings:
    """The latest whole sightings of each landmark, which say where else it may be.

    Attributes:
        kernel: that of the sightings.
        held: the landmarks that cannot move: a map has them exactly.
        rows: {landmark: its latest sightings}.
        counts, tried: how many there were of each so far, and when it was tried elsewhere in vain.
    """

    kernel: Kernel
    held: set[int] = field(default_factory=set)
    rows: dict[int, deque[Row]] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    tried: dict[int, int] = field(default_factory=dict)

    def add(self, landmarks: Sequence[int], sightings: Iterable[Row]) -> None:
        """Note the sightings of landmarks."""
        for id, row in zip(landmarks, sightings):
            self.rows.setdefault(id, deque(maxlen=LATEST)).append(row)
            self.counts[id] = self.counts.get(id, 0) + 1

    def contradicted(self, landmarks: Sequence[int], squares: Sequence[float]) -> list[int]:
        """The landmarks that may be elsewhere, because they surprise: ``squares`` are r² of the sightings."""
        far = dict.fromkeys(id for id, square in zip(landmarks, squares) if square > MIN_GAP)
        return [id for id in far if id not in self.held and self.counts[id] >= max(2, MORE * self.tried.get(id, 0))]

    def steps(self, landmark: int, first: int) -> list[int]:
        """The poses of the latest sightings of a landmark, from number ``first`` on."""
        return [row[0] for row in self.rows[landmark] if row[0] >= first]

    def elsewhere(self, landmark: int, first: int, nodes: Array) -> Array | None:
        """Where its latest sightings from the poses of `steps` put a landmark best; None where it suits them now.

        ``nodes`` are these poses, and where it is now. J decides later: other poses may have seen it, too.
        """
        rows = [row[1:] for row in self.rows[landmark] if row[0] >= first]
        measured, information = (np.array(each) for each in zip(*rows))
        poses, now, (count, d) = nodes[:-1], nodes[-1], measured.shape
        seen = np.zeros((count, 3))
        seen[:, :d] = measured
        places = np.concatenate([compose(poses, seen), now[None]])
        places[:, d:] = now[d:]
        e = difference(between(poses, places[:, None])[..., :d], measured)
        squares = ((e[..., None, :] @ information)[..., 0, :] * e).sum(axis=-1)
        costs = self.kernel.of_dimension(d).loss(squares).sum(axis=1)
        best = int(np.argmin(costs))
        return places[best] if costs[best] < costs[-1] else None
