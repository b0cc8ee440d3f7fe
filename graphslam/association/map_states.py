"""What a log says about each landmark of a map: it is where the map has it, has moved, or is gone; and which are new.

**Moved.** `solvers.map_errors` has the least squares estimate of the shift d_j of a landmark and its information S_jj, in the
linear model and without solving again. A landmark that has moved becomes another one in this log, and the graph is solved
again, until all others agree: it does not pull the trajectory. Its shift is then the difference of both nodes. The odds of
moved are

    prior odds * N(d_j; 0, S_jj^-1 + diag(`MOVE`, `MOVE`, turn)²) / N(d_j; 0, S_jj^-1),

the mean of those with turn = `TURN` and 0: a landmark that has moved may have turned or not.

**Gone.** In scan v a landmark is well within the field of view with probability p_v, by the covariances of the pose and of
the landmark, and one that is there is then seen with probability d. Landmarks are occluded to different degrees: d has a beta
distribution, estimated from the landmarks that were seen, of each the product over the scans of d or 1 - p_v d. One that was
never seen is gone with the likelihood 1, and there with E[(1 - d)^n], n the number of scans in which it is in view. These
count in the estimate, too: where walls hide many, or tags show from one side only, d near 0 is more probable. The
error of its place relative to the trajectory is the same in all scans. Let it be z standard deviations in range and bearing:
each z gives a number n, and the expectation is also taken over z (Gauss-Hermite quadrature).

Source: Skellam, *A probability distribution derived from the binomial distribution*, JRSS B 1948.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any

import numpy as np

from ..edges import PriorEdges
from ..errors import GraphError, OptionError, checks, quoted
from ..graph import Graph
from ..log import UNIDENTIFIED, Log
from ..maps.landmark_map import LandmarkMap, as_map
from ..maps.map_evidence import log_sum
from ..maps.registration import Points, register
from ..metrics import align
from ..se2 import Array, rotation, transform, wrap
from ..solvers.map_errors import scores_in_map
from ..solvers.solution import Solution
from ..solvers.solve import solve
from .assignment import log_density
from .problem import INSIDE, Field

#: standard deviations of the shift [m] and the turn [rad] of a landmark that has moved
MOVE, TURN = 1.0, 1.0
#: exact landmarks of a map are taken as known to this standard deviation [m, rad]
EXACT_STD = 1e-3
#: the most graphs that are solved
MAX_SOLVES = 20
#: the information of a log on a shift is a difference, of which less than this part of the map's is rounding
ROUNDING = 1e-12
#: the states
AGREES, MOVED, VANISHED, NOT_IN_VIEW, NEW = "agrees", "moved", "vanished", "not in view", "new"
#: means and sizes a + b of the beta distributions of detection that are compared
_MEANS, _SIZES = np.linspace(0.02, 0.98, 49), np.geomspace(0.5, 100.0, 16)
#: errors in standard deviations, and their shares, that of range and bearing together
_ERRORS, _WEIGHTS = np.polynomial.hermite_e.hermegauss(9)
_SHARES = np.outer(_WEIGHTS, _WEIGHTS).ravel() / _WEIGHTS.sum() ** 2
#: errors of all places of a map [m] that are tried
_COMMON = np.geomspace(0.01, 3.0, 30)
#: the ends of the intervals of d over which they are integrated
_DETECTION = np.linspace(0.0, 1.0, 41)


@dataclass(frozen=True, eq=False)
class LandmarkState:
    """What a log says about one landmark; None where there is nothing to say.

    Attributes:
        id: of the landmark.
        state: "agrees", "moved", "vanished", "not in view" or "new".
        probability: of this state; of "not in view" that it is still there.
        moved, vanished: the probabilities that it has moved, and that it is gone.
        shift: (2,) [m] from its place in the map to that in this log.
        chi_square: of the shift, with as many degrees of freedom as the landmark has coordinates.
        views, seen: the number of scans in which it should have been seen, and of sightings.
    """

    id: int
    state: str
    probability: float
    moved: float | None = None
    vanished: float | None = None
    shift: Array | None = None
    chi_square: float | None = None
    views: int | None = None
    seen: int = 0


@dataclass(frozen=True, eq=False)
class MapStates:
    """The states of all landmarks of a map, and the new ones.

    Attributes:
        landmarks: by increasing id.
        map: the map without the landmarks that have moved, which the log then places anew: a map for `Graph.from_log`.
        solution: of the log in the map; landmarks that have moved have ids of their own.
    """

    landmarks: tuple[LandmarkState, ...]
    map: LandmarkMap
    solution: Solution

    def of(self, state: str) -> list[int]:
        """The ids of the landmarks in a state.

        Raises:
            OptionError: there is no such state.
        """
        if state not in (AGREES, MOVED, VANISHED, NOT_IN_VIEW, NEW):
            raise OptionError(f"there is no state {quoted(state)} of landmarks")
        return [each.id for each in self.landmarks if each.state == state]

    @property
    def sentence(self) -> str:
        """One sentence: how many landmarks agree, and which have moved, are gone or new."""
        agree = len(self.of(AGREES))
        parts = [f"{agree} landmarks agree with the map" if agree != 1 else "1 landmark agrees with the map"]
        parts += [
            f"{checks.listed('landmark', ids, most=8)} {verbs[len(ids) > 1]}"
            for name, verbs in {
                MOVED: ("has moved", "have moved"),
                VANISHED: ("has vanished", "have vanished"),
                NOT_IN_VIEW: ("was not in view of the sensor", "were not in view of the sensor"),
                NEW: ("is new", "are new"),
            }.items()
            if (ids := self.of(name))
        ]
        return "; ".join(parts)


@dataclass(frozen=True, eq=False)
class _Views:
    """The scans of a landmark: the probability (n,) that it is well within the field of view, and whether (n,) it was seen.

    ``counts`` are the numbers of scans in which it is, one for each pair of errors in range and bearing, as `_SHARES`.
    """

    inside: Array
    counts: np.ndarray
    seen: np.ndarray

    @property
    def count(self) -> int:
        """The number of scans in which it is probably in view."""
        return int(np.sum(self.inside > 0.5))


def map_states(
    log: Log,
    landmarks: LandmarkMap | Mapping[int, Array] | str | PathLike[str] | Solution,
    *,
    prior: float = 0.05,
    **options: Any,
) -> MapStates:
    """The state of each landmark of a map after a log, with probabilities; see the module for the equations.

    Ids are taken to be right: a new id that was read once may be a misread one.

    Args:
        log: with ids of the map's landmarks, and controls. Sightings of a range or a bearing alone count, too.
        landmarks: the map, in any form that `Graph.from_log` takes.
        prior: the probability that a landmark has moved, and that it is gone, before the log.
        options: of `Graph.from_log`, such as the noise models.

    Raises:
        GraphError: the log does not fit the map. OptionError: an option has an impossible value.
    """
    if not 0 < prior < 0.5:
        raise OptionError(f"prior must be a probability above 0 and below 0.5, not {quoted(prior)}")
    known = as_map(landmarks)
    _, measured = _measured(log)
    ids, counts = (each.tolist() for each in np.unique(measured[measured != UNIDENTIFIED], return_counts=True))
    seen = set(ids) & set(known)
    if known and not seen:
        sees, has = (
            checks.listed("landmark", sorted(each), most=4) if each else "none with an id" for each in (ids, known)
        )
        cause = "is it the map of another place, or are the ids numbered otherwise?"
        raise GraphError(f"{log.name} sees no landmark of the map: it sees {sees}, and the map has {has}; {cause}")
    # exact landmarks need nodes with errors
    used = known.among(seen).widened(0.0, EXACT_STD)
    if any(len(place) == 2 for place in used.values()):
        # the node of such a landmark, without sightings, would have no heading
        log = log.without_orientation()
    away: set[int] = set()
    tried: list[set[int]] = []
    compared, found = False, dict[int, tuple[Array, float, float]]()
    for _ in range(MAX_SOLVES):
        fresh = {j: max(0, *ids, *known) + 1 + k for k, j in enumerate(sorted(away))}
        built = Graph.from_log(_renamed(log, fresh), map=used, **options)
        latest = solve(built)
        graph = latest.graph or built
        assert graph.map is not None
        if left_out := set(used) - set(graph.map):
            # the first fix, or the solution, showed already that they have moved; they have no ids of their own there
            away = away | left_out
            if away in tried:
                break
            continue
        if not compared and graph.map is not built.map:
            # most places contradict the log: those that agree among each other are right, and the others may have moved
            compared, others = True, _others(log, known, sorted(seen), **options)
            if others | away != away:
                away = away | others
                continue
        # ranges or bearings alone may contradict the map, and not give another place
        unplaced = away & set(found) - set(log.landmark_ids.tolist())
        solution, found = latest, {j: found[j] for j in unplaced} | _shifts(latest, fresh, prior)
        tried.append(away)
        away = _next(solution, found, away, first=len(tried) == 1)
        if seen and seen <= away:
            cause = "it is probably the map of another place, or the ids are numbered otherwise"
            raise GraphError(f"all {len(seen)} landmarks that the log shares with the map have moved: {cause}")
        if away in tried:
            break
    moved = {j for j, (_, _, p) in found.items() if p > 0.5}
    places = {**known, **{j: solution.landmarks[j] for j in seen if j not in moved and j in solution.landmarks}}
    views = _views(solution, known, places, log)
    gone = _gone(
        [views[j] for j in sorted(seen) if j not in moved], [views[j].counts for j in known if j not in found], prior
    )
    count = dict(zip(ids, counts))
    states = [LandmarkState(j, NEW, 1.0, seen=count[j]) for j in ids if j not in known]
    for j in known:
        if j in found:
            shift, square, p = found[j]
            name = MOVED if p > 0.5 else AGREES
            state = LandmarkState(j, name, max(p, 1 - p), p, 0.0, shift[:2], square, views[j].count, seen=count[j])
            states.append(state)
        else:
            p = gone(views[j].counts)
            name = VANISHED if p > 0.5 else NOT_IN_VIEW
            states.append(LandmarkState(j, name, max(p, 1 - p), vanished=p, views=views[j].count))
    return MapStates(tuple(sorted(states, key=lambda each: each.id)), known.among(set(known) - moved), solution)


def session_states(log: Log, **options: Any) -> list[MapStates]:
    """The states of the landmarks of a joined log: those of each drive but the first in the map of the drives before it.

    Args:
        log: of `graphslam.join_logs`.
        options: of `Graph.from_log`.

    Raises:
        OptionError: the log is that of one drive. GraphError: a drive does not fit the map of those before.
    """
    if len(log.sessions) < 2:
        raise OptionError(f"{log.name} is one drive; session_states takes the log of graphslam.join_logs")
    found = []
    for drive in log.drives[1:]:
        before = log.at_steps(np.arange(drive.start)).replace(sessions=())
        known = solve(Graph.from_log(before, **(options | {"edges": "landmark+motion"}))).map
        own = log.at_steps(np.arange(drive.start, drive.stop)).replace(sessions=())
        found.append(map_states(own, known, **options))
    return found


def _others(log: Log, known: LandmarkMap, seen: list[int], **options: Any) -> set[int]:
    """The landmarks that are elsewhere in the map of the log alone, moved to where most of its landmarks fit.

    There are none where errors of one size s of all places are more probable: with the displacements d_j and their
    covariances V_j, where sum log (N(d_j; 0, V_j) + N(d_j; 0, V_j + `MOVE`² I)) / 2, at that place, is below the largest
    sum log N(d_j; 0, V_j + s² I), where all landmarks fit best.
    """
    own = solve(Graph.from_log(log, **(options | {"edges": "landmark+motion"}))).map
    seen = [j for j in seen if j in own]
    places, covariances = known.arrays(seen)
    of_log, errors = own.arrays(seen)
    area = float(np.prod(np.ptp(places[:, :2], axis=0) + MOVE))
    matches = register(Points(of_log, errors, places, covariances, np.array(seen), area))
    if not matches:
        return set()

    def densities(pose: Array, size: float) -> Array:
        turn = rotation(pose[2])
        V = turn @ errors[:, :2, :2] @ turn.T + covariances[:, :2, :2] + size**2 * np.eye(2)
        return log_density(transform(pose, of_log[:, :2]) - places[:, :2], V)[0]

    best, together = matches[0], align(places[:, :2], of_log[:, :2])
    moved = np.sum(np.logaddexp(densities(best.pose, 0.0), densities(best.pose, MOVE)) - np.log(2))
    if moved < max(np.sum(densities(together, size)) for size in _COMMON):
        return set()
    return {j for j, agrees in zip(seen, best.agree) if not agrees}


def _measured(log: Log) -> tuple[np.ndarray, np.ndarray]:
    """The steps and the ids (M,) of all sightings, also of those of a range or a bearing alone."""
    single = log.partial_sightings
    others = ((), ()) if single is None else (single.steps, single.landmarks)
    return np.append(log.steps, others[0]).astype(np.int64), np.append(log.landmarks, others[1]).astype(np.int64)


def _renamed(log: Log, names: dict[int, int]) -> Log:
    """The log in which some landmarks have other ids."""

    def of(landmarks: np.ndarray) -> np.ndarray:
        return np.array([names.get(j, j) for j in landmarks.tolist()], dtype=np.int64)

    single = log.partial_sightings
    other = None if single is None else replace(single, landmarks=of(single.landmarks))
    return log.replace(landmarks=of(log.landmarks), partial_sightings=other)


def _shifts(solution: Solution, fresh: dict[int, int], prior: float) -> dict[int, tuple[Array, float, float]]:
    """{id: (shift (d,), its chi-square, probability of moved)} of the landmarks of the map that were seen.

    The map is that of the graph, whose places may count as less certain than at first. Landmarks have no shift all of whose
    sightings the graph leaves out, because they contradict their ids.
    """
    graph = solution.graph
    assert graph is not None and graph.log is not None and graph.map is not None
    used, seen = graph.map, set(graph.log.landmarks[graph.sighting_rows].tolist())
    if graph.log.partial_sightings is not None:
        seen |= set(graph.log.partial_sightings.landmarks.tolist()) & set(solution.landmarks)
    d, ids = graph.landmark_dimension, [j for j in used if fresh.get(j, j) in seen]
    fresh = {j: fresh[j] for j in ids if j in fresh}
    if not ids:
        return {}
    P = solution.covariance(landmarks=[*ids, *(fresh[j] for j in fresh)], joint=True)
    size = d * len(ids)
    # a joint prior turns with the map
    pivot = next((family.pivot for family in graph.families if isinstance(family, PriorEdges)), None)
    places = np.array([solution.landmarks[j][:d] for j in ids])
    score, S, L, turn = scores_in_map(used, ids, places, P[:size, :size], pivot)
    found = {}
    for k, j in enumerate(ids):
        n = min(d, len(used[j]))
        rows = slice(k * d, k * d + n)
        if j in fresh:
            at = size + d * list(fresh).index(j)
            other = slice(at, at + n)
            shift = solution.landmarks[fresh[j]][:n] - solution.landmarks[j][:n]
            V = P[rows, rows] + P[other, other] - P[rows, other] - P[other, rows]
        else:
            of_log, of_map = (S[rows, rows] + S[rows, rows].T) / 2, L[rows, rows]
            if np.linalg.eigvalsh(of_log)[0] <= ROUNDING * np.trace(of_map):
                # the log says nothing of the place, as where a kernel leaves its sightings out
                found[j] = np.zeros(n), 0.0, prior
                continue
            V = np.linalg.inv(of_log)
            shift = V @ score[rows]
            shift[:2] = shift[:2] @ turn[:2, :2]
        shift[2:] = wrap(shift[2:])
        density, square = log_density(shift, V)
        # one that has moved may have turned or not
        turned = [log_density(shift, V + np.diag([MOVE, MOVE, std][: len(shift)]) ** 2)[0] for std in (0.0, TURN)]
        gain = log_sum(turned) - np.log(2) - density
        odds = np.log(prior / (1 - prior)) + gain
        found[j] = shift, float(square), float(1 / (1 + np.exp(-np.clip(odds, -700, 700))))
    return found


def _next(solution: Solution, found: dict[int, tuple[Array, float, float]], away: set[int], *, first: bool) -> set[int]:
    """The landmarks that are to be others than those of the map in the next round."""
    if back := {j for j in away & set(found) if found[j][2] <= 0.5}:
        return away - back
    rest = {j: square for j, (_, square, p) in found.items() if j not in away and p > 0.5}
    if first:
        # a robust kernel hides the shift of landmarks whose sightings it leaves out
        away = away | _weighed_down(solution, set(found) - away)
    if not rest:
        return away
    # the largest first: it may have pulled the others
    return away | {j for j, square in rest.items() if square > max(rest.values()) / 2}


def _weighed_down(solution: Solution, known: set[int]) -> set[int]:
    """The landmarks of the map most of whose sightings a robust kernel gives less than half of their weight."""
    graph = solution.graph
    assert graph is not None and graph.log is not None
    weights = graph.sighting_weights(solution.state)
    ids = graph.log.landmarks[graph.sighting_rows]
    return {j for j in known & set(ids.tolist()) if np.median(weights[ids == j]) < 0.5}


def _views(solution: Solution, known: LandmarkMap, places: Mapping[int, Array], log: Log) -> dict[int, _Views]:
    """{id: the scans in which it is well within the field of view, and in which it was seen}."""
    from scipy.special import ndtr  # late: 0.1 s that most runs do not need

    graph = solution.graph
    assert graph is not None and graph.sensor is not None
    field = Field.of(log, graph.sensor)
    scans, (steps, measured) = np.unique(log.steps), _measured(log)
    poses, P = solution.poses[scans], solution.covariance()[scans]
    eyes = graph.sensor.mount(poses)
    covariances = {**known.covariances, **solution.landmark_covariances}
    found = {}
    for j, place in places.items():
        way = place[:2] - eyes[:, :2]
        ranges = np.maximum(np.hypot(*way.T), 1e-6)
        along = way / ranges[:, None]
        across = np.column_stack([-along[:, 1], along[:, 0]])
        V = P[:, :2, :2] + (covariances[j][:2, :2] if j in covariances else 0.0)
        bearings = wrap(np.arctan2(way[:, 1], way[:, 0]) - poses[:, 2])
        of_range = np.sqrt(np.einsum("ki,kij,kj->k", along, V, along)) + 1e-9
        # the heading turns the bearing, and the position moves it
        mixed = np.einsum("ki,ki->k", across, P[:, :2, 2]) / ranges
        of_bearing = np.einsum("ki,kij,kj->k", across, V, across) / ranges**2 + 2 * mixed + P[:, 2, 2]
        of_bearing = np.sqrt(np.maximum(of_bearing, 0.0)) + 1e-9
        near, far, wide = field.nearest / INSIDE, INSIDE * field.farthest, INSIDE * field.bearing
        inside = ndtr((far - ranges) / of_range) - ndtr((near - ranges) / of_range)
        inside *= ndtr((wide - bearings) / of_bearing) - ndtr((-wide - bearings) / of_bearing)
        near_enough = np.abs(ranges + _ERRORS[:, None] * of_range - (near + far) / 2) < (far - near) / 2
        ahead_enough = np.abs(bearings + _ERRORS[:, None] * of_bearing) < wide
        seen = np.isin(scans, steps[measured == j])
        counts = np.sum(near_enough[:, None] & ahead_enough, axis=2)
        found[j] = _Views(np.clip(inside, 0.0, 1.0), counts.ravel(), seen)
    return found


def _gone(there: list[_Views], unseen: list[np.ndarray], prior: float) -> Callable[[np.ndarray], float]:
    """The probability that a landmark is gone that was not seen in any of so many scans, for all errors of `_Views`.

    The beta distributions of `_MEANS` and `_SIZES` are averaged with their likelihoods by the landmarks that are ``there``,
    and by those that were not seen, with their numbers of scans, which are gone or there: where many were not seen, more of
    them are hidden than gone.
    """
    from scipy.special import betainc

    a, b = (_MEANS[:, None] * _SIZES).ravel(), ((1 - _MEANS[:, None]) * _SIZES).ravel()
    shares = np.diff(betainc(a[:, None], b[:, None], _DETECTION), axis=1)
    d = (_DETECTION[1:] + _DETECTION[:-1]) / 2
    weight = np.zeros(len(a))
    for views in there:
        counted = views.inside > 0.5
        log_likelihood = np.sum(views.seen[counted]) * np.log(d)
        log_likelihood += np.log1p(-views.inside[counted & ~views.seen, None] * d).sum(axis=0)
        most = np.max(log_likelihood)
        weight += np.log(shares @ np.exp(log_likelihood - most) + 1e-300) + most
    for counts in unseen:
        weight += np.log(prior + (1 - prior) * (shares @ (_SHARES @ (1 - d) ** counts[:, None])))
    weight = np.exp(weight - np.max(weight))
    mixed = (weight / weight.sum()) @ shares

    def probability(counts: np.ndarray) -> float:
        missed = float(mixed @ (_SHARES @ (1 - d) ** counts[:, None]))
        return prior / (prior + (1 - prior) * missed)

    return probability
