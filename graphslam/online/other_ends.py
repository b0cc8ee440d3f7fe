"""Other ends of an online solution: places that single numbers leave for a landmark, and the way turned as a whole.

The cost of ranges or bearings alone has several minima, and so has that of absolute positions while the direction of the way
is hardly known. So whenever there are a quarter more of them, other places of a landmark, and the way where its positions put
it in closed form, are tried with the whole graph, and the lower J counts, as in `solvers.initialize`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..edges import PositionEdges
from ..graph.defaults import into_world
from ..graph.trilateration import MIN_GAP, MORE, NumberRow, WaitingNumbers, edges_of_rows, other_places, places_of_rows
from ..models import SensorModel
from ..se2 import Array, wrap

#: so many times at most in a row
SWEEPS = 3
#: the way is tried where its positions put it when that turns it by more than this [rad]
TURNED = 0.1
#: the fewest positions that say something about the direction
POSITIONS = 3


@dataclass
class OtherEnds:
    """What a solver needs to find them again.

    Attributes:
        waiting: the single numbers of landmarks that have no place yet.
        numbers: those of landmarks that have a place by them alone.
        positions: (pose, measured, information, lever) of each.
        tried, turned_at: how many there were when other places were tried last, and how many positions.
    """

    sensor: SensorModel
    waiting: WaitingNumbers
    numbers: dict[int, list[NumberRow]] = field(default_factory=dict)
    positions: list[tuple[int, Array, Array, Array]] = field(default_factory=list)
    tried: dict[int, int] = field(default_factory=dict)
    turned_at: int = 0

    def placed(self, landmark: int, rows: Iterable[NumberRow]) -> None:
        """A landmark has got its place by these numbers."""
        self.numbers[landmark] = list(rows)
        self.tried[landmark] = len(self.numbers[landmark])

    def seen(self, whole: Iterable[int], rows: Iterable[tuple[int, NumberRow]]) -> None:
        """Landmarks with a place have been seen again: as a whole, which leaves no other place, or by single numbers."""
        for landmark in whole:
            self.numbers.pop(landmark, None)
        for landmark, row in rows:
            if landmark in self.numbers:
                self.numbers[landmark].append(row)

    def located(self, pose: int, measured: Array, information: Array, lever: Array) -> None:
        """A position of a pose has been added."""
        self.positions.append((pose, measured, information, lever))

    def doubts(
        self,
        rows: Sequence[tuple[int, NumberRow]],
        poses: Callable[[], Array],
        place: Callable[[int], Array],
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
