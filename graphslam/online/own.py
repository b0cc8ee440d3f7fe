"""The online solver of the project: a minimum of J over all edges so far after every call.

J may have several minima: other ends are tried with the whole graph, and the lower J counts; see `online.other_ends`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from functools import partial
from itertools import repeat
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..edges import ANCHOR_INFORMATION, RangeEdges, freest_turn
from ..edges.robust import Kernel, code_and_width
from ..engine import engine
from ..errors import GraphError
from ..errors.checks import check_count, check_positive
from ..graph.trilateration import NumberRow, WaitingNumbers, edges_of_rows
from ..linear.precision import inverses
from ..maps.landmark_map import HELD_STD, LandmarkMap, as_map
from ..models import SensorModel
from ..se2 import Array, compose, difference, inverse
from .backend import RELEASED_START, Backend, ExpectedCost, Measured, Relation, information_of
from .other_ends import LatestSightings, OtherEnds

#: other places of landmarks are tried so many times in a row at most, as long as J falls
SWEEPS = 3
#: kinds of edges
Kind = engine.OnlineEdge
#: the most passes of one update, after which the batch solver takes over
PASSES = 12
#: the part of J below which updates leave it
TOLERANCE = 3e-8
#: the fewest steps from one pose that stays a node, with a lag, to the next
STRETCH = 20
#: no sightings
NO_ROWS = np.zeros((0, 3))


@dataclass
class _Added:
    """What one call adds.

    Attributes:
        edges: for the engine.
        landmarks: those that are new.
        leading: the relation that makes the new pose.
        rows: single numbers of landmarks that are known.
        placed: the single numbers of each landmark that they place now.
        counted: how many measurements of each kind.
    """

    edges: Any = field(default_factory=engine.NewEdges)
    landmarks: list[int] = field(default_factory=list)
    leading: Relation | None = None
    rows: list[tuple[int, NumberRow]] = field(default_factory=list)
    placed: dict[int, tuple[NumberRow, ...]] = field(default_factory=dict)
    counted: Counter[Measured] = field(default_factory=Counter[Measured])


class OwnBackend(Backend):
    """The nodes and edges of an `OnlineSolver` in the engine; see `engine/include/vmslam/online`.

    The estimate follows the nearest minimum from one update to the next, and `converged` says whether it was reached.
    Only those nodes that a change concerns are eliminated again.

    Args:
        start, sensor, kernel: checked by `OnlineSolver`.
        tolerance: an update ends where the next pass would lower J by less than this part of it; default: `TOLERANCE`, and
            a thirtieth of it with a lag, because later steps cannot correct what a prior was made of. Together with what
            passes leave out, J was at most 1e-6 above that of the batch solver at the steps that were compared,
            but for one that has a lower minimum next to it (`docs/benchmarks.md`).
        lag: poses that are older than so many steps are final. They are marginalised: their edges, at their last
            linearisation and with their last robust weights, become a dense prior on what they are tied to. Landmarks stay
            nodes, and so does one pose in each stretch of ``lag`` steps, at least `STRETCH`, in which landmarks were new:
            the prior of a stretch is relative to it. None keeps all poses.
        map: landmarks that are known beforehand, in a form that `Graph.from_log` takes; exact ones have a standard deviation
            of `HELD_STD`. Sightings have psi where all its landmarks have headings, else not. Give ``start`` in its frame.
        start_covariance: (3, 3) of the first pose; default: it is anchored.

    Raises:
        OptionError: an option has an impossible value.
    """

    def __init__(
        self,
        start: Array,
        sensor: SensorModel,
        kernel: Kernel | None,
        *,
        tolerance: float | None = None,
        lag: int | None = None,
        map: Any = None,
        start_covariance: ArrayLike | None = None,
    ) -> None:
        if tolerance is None:
            tolerance = TOLERANCE if lag is None else TOLERANCE / 30
        check_positive(tolerance=tolerance)
        if lag is not None:
            check_count(lag=lag)
            check_positive(lag=lag)
        self._sensor, self._kernel, self.lag = sensor, kernel, lag
        self._expected = ExpectedCost(kernel, lag)
        self.system = engine.OnlineSystem(tolerance, PASSES)
        #: the nodes of the poses that are not final, and the values of those that are
        self._poses: list[int] = [self.system.add_node()]
        self._final = np.zeros((64, 3))
        self.num_final = 0
        self._landmarks: dict[int, int] = {}
        #: the final poses that stay nodes, and the number of landmarks when one was kept last
        self._kept: list[int] = []
        self._mapped = 0
        self.columns: int | None = None
        self._others = OtherEnds(sensor, WaitingNumbers(sensor))
        # without a kernel, single sightings do not keep a landmark where all others contradict them
        self._latest = None if kernel is None else LatestSightings(kernel)
        if kernel is not None:
            for rows in (1, 2, 3):
                own, gain = kernel.of_dimension(rows), kernel.information_per_weight(rows)
                self.system.use_kernel(*code_and_width(own), gain, rows)
        held = ANCHOR_INFORMATION if start_covariance is None else information_of(start_covariance)
        self._start, self._in_map, self._of_map = (start, held), False, 0
        self.system.add_prior([0], start, np.ascontiguousarray(held), False, np.empty(0))
        self.system.solve(self._poses, self._poses)
        if map is not None:
            known = as_map(map)
            self.begin_with(known, 3 if known.oriented else 2)

    def begin_with(self, known: LandmarkMap, columns: int) -> None:
        """Add the landmarks of a map as nodes with their priors, for sightings of ``columns`` values."""
        ids, places, information = _priors_of(known, columns)
        self.columns, self._in_map = columns, True
        if self._latest is not None:
            self._latest.held = {j for j in ids if j not in known.covariances}
        self._landmarks = {j: self.system.add_node() for j in ids}
        nodes, self._of_map = list(self._landmarks.values()), len(ids)
        # one prior of all of them would tie together those that are not
        together = [k for k, j in enumerate(ids) if known.joint is not None and j in known.covariances]
        for group in ([together] if together else []) + [[k] for k in range(len(ids)) if k not in together]:
            of_group = np.add.outer(3 * np.array(group), np.arange(3)).ravel()
            omega = np.ascontiguousarray(information[np.ix_(of_group, of_group)])
            pivot = freest_turn(places[group], omega)
            turns = np.empty(0) if pivot is None else pivot
            self.system.add_prior([nodes[k] for k in group], places[group], omega, columns == 2, turns)
        self.system.solve(nodes, self._poses)

    def relate(self, *relations: Relation) -> None:
        self.update(relations)

    def observe(self, pose: int, ids: Sequence[int], sightings: Array) -> None:
        alone: np.ndarray = np.asarray(np.isnan(sightings).any(axis=1))
        # a range beyond floating point has no inverse covariance, and is refused for that
        measured, covariances = self._sensor.places(sightings[~alone])
        information = inverses(covariances, "sighting", "check the noise of the sensor")
        whole = [id for id, single in zip(ids, alone) if not single]
        numbers = [(id, z) for id, z, single in zip(ids, sightings, alone) if single]
        self.update((), pose, whole, measured, information, numbers)

    def update(
        self,
        relations: Sequence[Relation],
        pose: int = 0,
        landmarks: Sequence[int] = (),
        measured: Array = NO_ROWS,
        information: Array = NO_ROWS,
        numbers: Sequence[tuple[int, Array]] = (),
        *,
        places: dict[int, Array] | None = None,
        doubted: Sequence[bool] | None = None,
    ) -> None:
        """Add relations, and what is seen from a pose; then solve.

        Args:
            relations: to a new pose, or between known ones.
            pose: from which something is seen.
            landmarks, measured, information: landmarks in the axes of the pose (K, 2 or 3), with their information.
            numbers: further landmarks with (range, bearing), one of which is NaN.
            places: of landmarks that have been waiting, (2,) each.
            doubted: for each relation whether the robust kernel acts on it where it is between known poses; default: it does.

        Raises:
            GraphError: a pose or landmark is not determined. Nothing is added then.
        """
        system, known = self.system, self.system.num_nodes
        before = len(self._poses), self.columns, self._others.waiting, self._expected.windows
        first_sighting = system.num_edges + len(relations)
        if self._expected.window_ends(self.num_poses, relations):
            self._expected.add_window(float(system.cost()))
        new = _Added()
        self._add_relations(new, relations, doubted)
        self._add_sightings(new, pose, landmarks, measured, information)
        self._add_single_numbers(new, pose, numbers, places or {})
        # the state before these numbers bend the graph, from which other places are tried
        doubtful, state = [], None
        if new.rows and self.lag is None:
            doubtful = self._others.doubts(new.rows, partial(self._poses_with, new.leading), self._place)
        if doubtful:
            where = {id: self._place(id) for id in self._landmarks if id not in new.landmarks}
            state = self._poses_with(new.leading), where
        if len(new.edges) and not system.add(known, new.edges, self._poses[-1:]):
            for landmark in new.landmarks:
                del self._landmarks[landmark]
            del self._poses[before[0] :]
            self.columns, self._others.waiting, self._expected.windows = before[1:]
            # in a copy, which counts only where the call is possible then
            if self._others.numbers and (other := deepcopy(self))._let_wait_again():
                other.update(relations, pose, landmarks, measured, information, numbers, places=places, doubted=doubted)
                self.__dict__.update(other.__dict__)
                return
            text = "the call leaves a pose or landmark undetermined, so that nothing was added"
            if not system.converged:
                text += "; the solver had not converged before: is a measurement wrong? It counts little with kernel='cauchy'"
            raise GraphError(text)
        self._expected.count(pose if len(landmarks) or numbers else self.num_poses - 1, new.counted)
        for landmark, numbers_of_it in new.placed.items():
            self._others.placed(landmark, numbers_of_it)
        self._others.seen(landmarks, new.rows)
        # landmarks that are seen as a whole now are no landmarks of single numbers alone
        if state is not None and (doubtful := [id for id in doubtful if id in self._others.numbers]):
            self._try_other_places(*state, doubtful)
        while not self.system.converged and self._let_wait_again():
            pass
        if self._latest is not None and len(landmarks):
            self._latest.add(landmarks, zip(repeat(pose), measured, information))
            self._try_where_seen(self._latest, landmarks, self.system.squares(first_sighting, len(landmarks)))
        while self.lag is not None and len(self._poses) > self.lag + 1:
            self._marginalize()

    def _add_relations(self, new: _Added, relations: Sequence[Relation], doubted: Sequence[bool] | None) -> None:
        """The edges of relations, and the node of the pose that they make."""
        for relation, in_doubt in zip(relations, repeat(True) if doubted is None else doubted):
            first, second, z, omega = relation
            if created := max(first, second) == self.num_poses:
                self._poses.append(self.system.add_node())
                new.leading = relation
            in_doubt = bool(in_doubt) and not created
            kind = Kind.motion if created and first < second else Kind.relation
            ends = np.array([[self._node(first), self._node(second)]], np.int32)
            new.edges.add(kind, ends, z[None], omega[None], doubted=in_doubt)
            new.counted[3, in_doubt] += 1

    def _add_sightings(
        self, new: _Added, pose: int, landmarks: Sequence[int], measured: Array, information: Array
    ) -> None:
        """The edges of landmarks that are seen as a whole, and nodes of those that are new."""
        if not len(landmarks):
            return
        self.columns = measured.shape[1]
        for landmark in landmarks:
            if landmark not in self._landmarks:
                self._landmarks[landmark] = self.system.add_node()
                new.landmarks.append(landmark)
        node = self._node(pose)
        ends = np.array([(node, self._landmarks[landmark]) for landmark in landmarks], np.int32)
        new.edges.add(Kind.sighting, ends, measured, information)
        new.counted[self.columns, True] += len(landmarks)

    def _add_single_numbers(
        self, new: _Added, pose: int, numbers: Sequence[tuple[int, Array]], places: dict[int, Array]
    ) -> None:
        """The edges of ranges and bearings alone, and nodes of the landmarks that they place now; others wait."""
        waiting, columns = self._others.waiting, self.columns
        if not (numbers or places or waiting.rows):
            return
        self._others.waiting = still = waiting.copy()
        for landmark in new.landmarks:
            self._add_numbers(new, landmark, still.take(landmark, self.num_final))
        found = dict(places)
        for landmark, z in numbers:
            self.columns = columns or 2
            row = (pose, float(z[0]), float(z[1]))
            if landmark in self._landmarks:
                new.rows.append((landmark, row))
                self._add_numbers(new, landmark, (row,))
                continue
            place = still.add(landmark, row, partial(self._poses_with, new.leading), self.num_final)
            if place is not None:
                found[landmark] = place
        for landmark, place in found.items():
            self._landmarks[landmark] = self.system.add_point(*place)
            new.landmarks.append(landmark)
            new.placed[landmark] = still.take(landmark, self.num_final)
            self._add_numbers(new, landmark, new.placed[landmark])

    def place(self, landmark: int, place: Array) -> None:
        self.update((), places={landmark: place})

    def locate(self, pose: int, measured: Array, information: Array, lever: Array, *, doubted: bool = True) -> None:
        node, system, added = self._node(pose), self.system, engine.NewEdges()
        ends = np.array([[node, node]], np.int32)
        added.add(Kind.position, ends, measured[None], information[None], lever[None], doubted)
        if not system.add(system.num_nodes, added, self._poses[-1:]):
            raise GraphError("with this position the graph is not determined, so that nothing was added")
        self._expected.count(pose, {(len(measured), doubted): 1})
        self._others.positions.append((pose, measured, information, lever))
        if self.lag is None:
            nodes = [*self._poses, *self._landmarks.values()]
            moved = self._others.turned(system.values(nodes), len(self._poses))
            if moved is not None:
                self._try(nodes, moved)

    def look_again(self) -> None:
        self._try_other_places(self.poses, {id: self._place(id) for id in self._landmarks}, list(self._others.numbers))

    def _try_other_places(self, poses: Array, places: dict[int, Array], tried: list[int]) -> None:
        """Try other places of landmarks, from poses (T, 3) and places of all landmarks, and take the lowest J."""
        nodes = [*self._poses, *(self._landmarks[id] for id in places)]
        row_of = {id: row for row, id in enumerate(places, start=len(poses))}
        for _ in range(SWEEPS):
            state, before = np.concatenate([poses, *(place[None] for place in places.values())]), self.system
            for others in self._others.elsewhere(poses, places, tried):
                values = state.copy()
                for id, place in others.items():
                    values[row_of[id], :2] = place
                self._try(nodes, values)
            if self.system is before:
                break
            poses, places = self.poses, {id: self._place(id) for id in places}

    def _let_wait_again(self) -> bool:
        """Take landmarks out of the graph whose single numbers do not say any more where they are; whether there were any.

        J then has its minimum at infinity, no step converges, and later ones would be refused.
        """
        # what a lag has made a prior of stays
        unknown = self._others.unknown(self.poses, self._place)
        gone = [id for id in unknown if self.system.remove(self._landmarks[id], self._poses[-1:])]
        for id in gone:
            del self._landmarks[id]
            self._expected.measured[1, True] -= self._others.wait_again(id)
        return bool(gone)

    def _try_where_seen(self, latest: LatestSightings, landmarks: Sequence[int], squares: Sequence[float]) -> None:
        """Try landmarks that what is seen now contradicts where their latest sightings put them, and take the lowest J."""
        for id in latest.contradicted(landmarks, squares):
            # sightings from final poses are part of priors
            first, node = self.num_final, self._landmarks[id]
            seen_from = self.system.places([*map(self._node, latest.steps(id, first)), node])
            place = latest.elsewhere(id, first, seen_from)
            if place is not None and not self._try([node], place[None]):
                latest.tried[id] = latest.counts[id]

    def _place(self, landmark: int) -> Array:
        return np.asarray(self.system.values([self._landmarks[landmark]])[0])

    def _poses_with(self, leading: Relation | None) -> Array:
        """All poses (T, 3), the new one where the relation leads that it came with."""
        poses = self.poses
        if leading is not None:
            first, second, z, _ = leading
            poses[-1] = compose(poses[first], z) if first < second else compose(poses[second], inverse(z[None])[0])
        return poses

    def _try(self, nodes: Sequence[int], values: Array) -> bool:
        """Solve from a state with other values of some nodes, and stay there if J is lower, which is returned."""
        other = deepcopy(self.system)
        solved = other.solve_from(list(nodes), np.ascontiguousarray(values), self._poses[-1:]) and other.converged
        least = 1e-9 * (1.0 + self.system.cost())
        if lower := solved and other.cost_with_priors() < self.system.cost_with_priors() - least:
            self.system = other
        return bool(lower)

    def release(self, motion: Array, position: Callable[[], None], information: Array | None = None) -> None:
        """Hold the first pose until `position` is added; its prior is then that of a free start, and ``information``."""
        before, start = deepcopy(self.system), self._start
        # the first pose stays a node also where it is final
        nodes = [*self._kept, *self._poses, *self._landmarks.values()]
        moved = compose(motion, self.system.values(nodes))
        self._hold_first(moved[0], ANCHOR_INFORMATION, nodes, moved)
        try:
            position()
        except GraphError:
            self.system, self._start = before, start
            raise
        self._final[: self.num_final] = compose(motion, self._final[: self.num_final])
        free = np.diag(1 / np.array(RELEASED_START))
        first = self.system.values(nodes[:1])[0]
        self._hold_first(first, free if information is None else free + information, [], np.zeros((0, 3)))

    def _hold_first(self, place: Array, information: Array, nodes: Sequence[int], values: Array) -> None:
        """Give the first pose another prior, put nodes at values, and solve."""
        self._start = (place, information)
        self.system.loosen(place, np.ascontiguousarray(information))
        self.system.solve_from(list(nodes), np.ascontiguousarray(values), self._poses[-1:])

    def _add_numbers(self, new: _Added, landmark: int, rows: tuple[NumberRow, ...]) -> None:
        """Add the edges of single numbers of a landmark that is a node."""
        for each in edges_of_rows(landmark, rows, self._sensor, self.num_poses) if rows else ():
            ends = np.array([(self._node(step), self._landmarks[landmark]) for step in each.first.tolist()], np.int32)
            kind = Kind.range if isinstance(each, RangeEdges) else Kind.bearing
            new.edges.add(kind, ends, each.measured, each.information, np.tile(each.offset, (each.count, 1)))
        new.counted[1, True] += len(rows)

    def _marginalize(self) -> None:
        """Make the oldest pose final."""
        if self.num_final == len(self._final):
            self._final = np.concatenate([self._final, np.zeros_like(self._final)])
        oldest = self._poses.pop(0)
        # where the map grows, one at intervals stays a node: what others leave is then relative to a pose nearby
        due = self.num_final % max(self.lag or 0, STRETCH) == 0
        kept = due and (self.num_final == 0 or len(self._landmarks) > self._mapped)
        self._expected.becomes_final(self.num_final, kept)
        if kept:
            self._mapped = len(self._landmarks)
            self._kept.append(oldest)
            self._final[self.num_final] = self.system.values([oldest])[0]
        else:
            self._final[self.num_final] = self.system.marginalize(oldest, self._poses[-1:])
        self.num_final += 1
        if self.system.crowded():
            number = self.system.renumber()
            self._kept = [number[node] for node in self._kept]
            self._poses = [number[node] for node in self._poses]
            self._landmarks = {key: number[node] for key, node in self._landmarks.items()}

    def _node(self, pose: int) -> int:
        return self._poses[pose - self.num_final]

    def relinearize(self) -> None:
        self.system.relinearize(self._poses[-1:])

    @property
    def num_poses(self) -> int:
        return self.num_final + len(self._poses)

    @property
    def landmark_ids(self) -> Sequence[int]:
        return list(self._landmarks)

    @property
    def waiting(self) -> dict[int, tuple[NumberRow, ...]]:
        return self._others.waiting.rows

    @property
    def passes(self) -> int:
        """The number of passes of the last update: solutions of the tree after edges were evaluated again."""
        return int(self.system.passes)

    @property
    def converged(self) -> bool:
        return bool(self.system.converged)

    @property
    def cost(self) -> float:
        # of the priors that a lag leaves, a constant is unknown
        if not self._in_map or self.lag is not None:
            return float(self.system.cost())
        start, information = self._start
        off = difference(self.system.values(self._poses[:1])[0], start)
        return float(self.system.cost_with_priors() - off @ information @ off)

    @property
    def misfit(self) -> str:  # type: ignore[override]
        windows = self.lag is not None and self.num_final
        return self._expected.misfit(None if windows else self.cost, self._num_unknowns)

    @property
    def _num_unknowns(self) -> int:
        """The numbers that are estimated, without the landmarks of the map, which have as many numbers as priors."""
        return 3 * (self.num_poses - 1 + self._in_map) + (self.columns or 0) * (len(self._landmarks) - self._of_map)

    @property
    def pose(self) -> Array:
        return np.asarray(self.system.values(self._poses[-1:])[0])

    @property
    def poses(self) -> Array:
        self.system.complete()
        return np.concatenate([self._final[: self.num_final], self.system.places(self._poses)])

    @property
    def landmarks(self) -> dict[int, Array]:
        x = self.system.values(list(self._landmarks.values()))
        return {key: row[: self.columns] for key, row in zip(self._landmarks, x, strict=True)}

    def covariance(self, poses: Sequence[int], landmarks: Sequence[int]) -> Array:
        nodes = [*map(self._node, poses), *(self._landmarks[key] for key in landmarks)]
        block = self.system.covariance(nodes, self._poses[-1:])
        if block is None:
            raise GraphError("there is no covariance: the edges do not determine all nodes to double precision")
        ends = 3 * np.arange(len(poses), len(nodes))[:, None] + np.arange(self.columns or 2)
        kept = np.concatenate([np.arange(3 * len(poses)), ends.ravel()])
        return np.asarray(block[np.ix_(kept, kept)])


def _priors_of(known: LandmarkMap, columns: int) -> tuple[list[int], Array, Array]:
    """The ids, places (K, 3) and information (3K, 3K) of the landmarks of a map, with ``columns`` coordinates each."""
    ids, count = list(known), len(known)
    places = np.zeros((count, 3))
    places[:, :columns] = [place[:columns] for place in known.values()]
    information = known.information(ids, columns)
    exact = np.repeat([j not in known.covariances for j in ids], 3) & np.tile(np.arange(3) < columns, count)
    information[exact, exact] = HELD_STD**-2
    return ids, places, information
