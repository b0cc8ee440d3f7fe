"""The offsets between the clocks of robots that see each other, from their sightings of each other.

Robot n's clock shows the time t_n = t - d_n; the first robot's is right, d = 0. When a sees b at its time t_a, the time
of b is t_a + d_a - d_b.

**Search.** The robots are solved together by their landmarks alone, which needs no common clock. Then each sighting of b
by a says where b was, and the path of b when it was there. For each pair and each offset on a grid the mean of log(1 + r²
/ s²) of the distances r is taken, and one robot after another gets the offset that is the best with those that have one.

**Estimate.** With the relations of those instants in the graph, an offset moves the end of a relation along the path:
with v the velocity (x, y, heading) of the robot that is seen, and B the Jacobian of the relation by its pose, de/dd_a = B
v = -de/dd_b. From the solution of the poses, with W the weighed information of the relations, A their Jacobian by the
pose that sees, and Omega the information of the graph,

    S = J' W J - M' Omega^-1 M,   M = (A, B)' W J,   d <- d - S^-1 J' W e,

which is the Gauss-Newton step of poses and offsets together; S^-1 is the covariance of the offsets.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..edges import RelationEdges
from ..errors import GraphError, LogError
from ..graph import Graph
from ..log import Log
from ..log.continuous_time import control_path
from ..models import SensorModel
from ..se2 import Array
from ..solvers.solve import solve
from ..solvers.uncertainty import Uncertainty
from .drives import Sessions, join_logs, join_robots, meetings, not_of_robots, with_common_noise

#: offsets from -`REACH` to `REACH` are searched in steps of `GRID` [s], with at most `MOST_SEARCHED` sightings of each pair
REACH, GRID, MOST_SEARCHED = 120.0, 0.05, 200
#: larger offsets than `LIKELY` [s] count where their cost is below this part of the lowest one up to there: on courses that
#: repeat themselves, wrong ones fit a part of the sightings. Sightings agree where it is below this part of the median one.
LIKELY, CLEARLY = 20.0, 0.5
#: the most passes over all robots, each with the offsets of the others
SWEEPS = 5
#: the fewest sightings of each other from which an offset is estimated
FEWEST = 5
#: the most estimates, and the part of the standard deviation below which a step is the last
MAX_ESTIMATES, FINE = 5, 0.1
#: the offsets count where one is larger than so many standard errors. Correlated errors make these too small: by half on
#: MR.CLAM 6, whose clocks agree.
SURE = 6.0


@dataclass(frozen=True)
class ClockOffsets:
    """The offsets of robots' clocks against that of the first: what to add to the times of each [s].

    Attributes:
        seconds, deviations: by the number of the robot; those of the first are 0.
        sightings: of robots by each other, from which they were estimated.
    """

    seconds: dict[int, float]
    deviations: dict[int, float]
    sightings: int

    @property
    def differ(self) -> bool:
        """Whether the clocks surely differ."""
        return any(abs(s) > SURE * self.deviations[n] for n, s in self.seconds.items())

    def applied(self, robots: Mapping[int, Log]) -> dict[int, Log]:
        """The logs by the clock of the first robot."""
        return {n: log.replace(start_time=log.start_time + self.seconds[n]) for n, log in robots.items()}

    def joined(self, robots: Mapping[int, Log]) -> Sessions:
        """The logs as one (`join_robots`), by the clock of the first robot where clocks differ; `Session` has the offsets."""
        found = join_robots(self.applied(robots) if self.differ else robots)
        sessions = []
        for each, (n, log) in zip(found.log.sessions, robots.items()):
            offset, deviation = self.seconds[n], self.deviations[n]
            own = replace(each, start_time=log.start_time, clock_offset=offset, clock_deviation=deviation)
            sessions.append(own)
        log = found.log.replace(sessions=tuple(sessions), notes=(*found.log.notes, self.sentence))
        return replace(found, log=log)

    @property
    def sentence(self) -> str:
        """The offsets in words."""
        first, *others = self.seconds
        offset = "{:+.3f} s for robot {} (standard error {:.3f} s)"
        each = ", ".join(offset.format(self.seconds[n], n, self.deviations[n]) for n in others)
        if not self.differ:
            return f"the clocks of the robots do not surely differ: the offsets are {each}, and not used"
        return f"to the times of the robots is added, so that they are those of robot {first}: {each}"


def clock_offsets(robots: Mapping[int, Log]) -> ClockOffsets:
    """The offsets of the clocks of robots that see landmarks and each other.

    Args:
        robots: as for `join_robots`; clocks may differ by up to `REACH` seconds.

    Raises:
        LogError: a robot and the others saw each other less than `FEWEST` times, or their sightings agree at no offset.
        GraphError: the robots share no landmarks, or the sightings do not determine the offsets, as when no robot moves.
    """
    logs = dict(zip(robots, with_common_noise(list(robots.values()))))
    names = list(logs)[1:]
    if not names:
        return ClockOffsets(dict.fromkeys(logs, 0.0), dict.fromkeys(logs, 0.0), 0)
    landmarks = join_logs([log.with_sightings(not_of_robots(log)) for log in logs.values()])
    poses = landmarks.split(solve(Graph.from_log(landmarks.log, edges="landmark+motion")).poses)
    logs = {n: log.replace(initial_poses=own) for (n, log), own in zip(logs.items(), poses)}
    found = _searched(logs)
    for _ in range(MAX_ESTIMATES):
        step, covariance, count = _step(ClockOffsets(found, found, 0).applied(logs))
        deviations = np.sqrt(np.diagonal(covariance))
        found |= {n: found[n] + float(each) for n, each in zip(names, step)}
        if np.all(np.abs(step) < FINE * deviations):
            break
    return ClockOffsets(found, {next(iter(logs)): 0.0, **dict(zip(names, deviations.tolist()))}, count)


def _searched(logs: Mapping[int, Log]) -> dict[int, float]:
    """The offsets on the grid; the initial poses of the logs are those of the solution by landmarks."""
    grid = np.arange(-round(REACH / GRID), round(REACH / GRID) + 1) * GRID
    costs: dict[tuple[int, int], Array] = {}
    counts: dict[tuple[int, int], int] = {}
    for b, log in logs.items():
        path = control_path(log)
        along = path.through(log.initial_poses)
        for a, other in logs.items():
            if a == b or not len(rows := meetings(other, b)):
                continue
            assert other.times is not None
            rows = rows[:: -(-len(rows) // MOST_SEARCHED)]
            x, z = other.initial_poses[other.steps[rows]], other.sightings[rows]
            places, covariances = (other.sensor or SensorModel()).places(z, x)
            at = other.times[other.steps[rows]][:, None] + grid
            inside = (at >= path.times[0]) & (at <= path.times[-1])
            passed = [np.interp(at, path.times, along[:, k]) for k in (0, 1)]
            # sightings of a robot that stands all the time cost the same at every offset
            spread = np.trace(covariances[:, :2, :2], axis1=1, axis2=2)
            telling = sum(np.ptp(each, axis=1) ** 2 for each in passed) > spread
            pair = (min(a, b), max(a, b))
            if not telling.any():
                counts[pair] = counts.get(pair, 0) + (len(rows) if inside.any() else 0)
                continue
            rows, inside, spread, places = rows[telling], inside[telling], spread[telling], places[telling]
            squares = sum((passed[k][telling] - places[:, k, None]) ** 2 for k in (0, 1))
            scale = spread[:, None] + np.median(np.min(np.where(inside, squares, np.inf), axis=1))
            each = np.where(inside, np.log1p(squares / scale), 0.0)
            seen = inside.sum(axis=0)
            # offsets that leave most sightings without a pose say nothing
            if not np.any(seen > 0.5 * len(rows)):
                continue
            cost = np.where(seen > 0.5 * len(rows), each.sum(axis=0) / np.maximum(seen, 1), each.max()) * len(rows)
            # by d_b - d_a: the time of b is t_a + d_a - d_b
            costs[pair] = costs.get(pair, 0.0) + (cost[::-1] if a < b else cost)
            counts[pair] = counts.get(pair, 0) + len(rows)
    first = next(iter(logs))
    found = {first: 0.0}
    while len(found) < len(logs):
        met = {n: sum(counts.get((min(n, m), max(n, m)), 0) for m in found) for n in logs if n not in found}
        n = max(met, key=lambda each: met[each])
        if met[n] < FEWEST:
            seen = (
                f"robot {n} and the others saw each other {met[n]} times with clocks that differ by at most {REACH:g} s"
            )
            raise LogError(f"{seen}, and the offset of its clock takes {FEWEST}{_apart(n, logs)}")
        found[n], _ = _lowest(_cost_of(n, found, grid, costs), grid)
    agree = dict[int, bool]()
    for _ in range(SWEEPS):
        before = dict(found)
        for n in list(logs)[1:]:
            others = {m: d for m, d in found.items() if m != n}
            found[n], agree[n] = _lowest(_cost_of(n, others, grid, costs), grid)
        if found == before:
            break
    if apart := [n for n in agree if not agree[n]]:
        which = f"no offset up to {REACH:g} s of the clock of robot {apart[0]}"
        cause = "do their clocks differ by more, or do sightings name wrong robots?"
        raise LogError(f"{which} makes the robots' sightings of each other agree: {cause}")
    return {n: found[n] for n in logs}


def _apart(n: int, logs: Mapping[int, Log]) -> str:
    """The times of a robot and of the others, where no offset up to `REACH` makes them overlap; else ""."""
    spans = {m: (log.times[0], log.times[-1]) for m, log in logs.items() if log.times is not None}
    first, last = spans.pop(n)
    begin, end = min(first for first, _ in spans.values()), max(last for _, last in spans.values())
    if first <= end + REACH and last >= begin - REACH:
        return ""
    shows = f"{first:.1f} to {last:.1f} s and theirs {begin:.1f} to {end:.1f} s, which do not overlap"
    return f": its clock shows {shows}; give the times of all robots by one clock"


def _cost_of(n: int, found: Mapping[int, float], grid: Array, costs: Mapping[tuple[int, int], Array]) -> Array:
    """The cost of each offset (D,) of robot n on the grid, with those of others."""
    total = np.zeros(len(grid))
    for m, d in found.items():
        if (cost := costs.get((min(n, m), max(n, m)))) is not None:
            # costs are by the offset of the later robot minus that of the earlier one
            off = grid - d if n > m else d - grid
            total += np.interp(off, grid, cost, left=cost.max(), right=cost.max())
    return total


def _lowest(cost: Array, grid: Array) -> tuple[float, bool]:
    """The offset with the lowest cost, one beyond `LIKELY` only where that is clearly lower; and whether sightings agree."""
    if not cost.any():
        # all robots that were seen stand, which is an error of `_step`
        return 0.0, True
    best, near = int(np.argmin(cost)), np.flatnonzero(np.abs(grid) <= LIKELY)
    likely = near[np.argmin(cost[near])]
    chosen = best if cost[best] < CLEARLY * cost[likely] else likely
    return float(grid[chosen]), bool(cost[chosen] < CLEARLY * np.median(cost))


def _step(logs: Mapping[int, Log]) -> tuple[Array, Array, int]:
    """The step of the offsets (K,) of all robots but the first, its covariance (K, K), and the number of sightings."""
    joined = join_robots(logs, placed=True)
    log = joined.log
    graph = Graph.from_log(log, edges="landmark+motion")
    solution = solve(graph, initialize="given")
    family = next(f for f in graph.families if isinstance(f, RelationEdges))
    edges = family.linearize(solution.state, solution.state)
    W = edges.information * family.kernel_weights(solution.state)[:, None, None]
    A, B = edges.jacobians
    robot = np.searchsorted(joined.starts, np.arange(log.num_poses), side="right") - 1
    assert log.controls is not None
    # the control that begins at a pose; the last pose has that which ends there
    control, last = log.controls[np.minimum(log.control_starts, len(log.controls) - 1)], np.array(joined.starts[1:]) - 1
    control[last] = log.controls[log.control_starts[last] - 1]
    heading = solution.poses[:, 2]
    v = np.column_stack([control[:, 0] * np.cos(heading), control[:, 0] * np.sin(heading), control[:, 1]])
    moved = (B @ v[family.second][:, :, None])[:, :, 0]
    J = np.zeros((*moved.shape, len(logs)))
    rows = np.arange(len(moved))
    J[rows, :, robot[family.first]] += moved
    J[rows, :, robot[family.second]] -= moved
    J = J[:, :, 1:]
    WJ = W @ J
    M = np.zeros((graph.num_nodes, 3, J.shape[2]))
    np.add.at(M, family.first, np.swapaxes(A, 1, 2) @ WJ)
    np.add.at(M, family.second, np.swapaxes(B, 1, 2) @ WJ)
    follows = Uncertainty(graph, solution.state).solve(M)
    S = np.einsum("eik,eil->kl", J, WJ) - np.einsum("nik,nil->kl", M, follows)
    gradient = np.einsum("eik,ei->k", WJ, edges.residuals)
    try:
        covariance = np.linalg.inv((S + S.T) / 2)
    except np.linalg.LinAlgError:
        covariance = np.full(S.shape, -1.0)
    if not np.all(np.diagonal(covariance) > 0):
        message = "the sightings of robots by each other do not determine the offsets of their clocks"
        raise GraphError(f"{message}: do the robots move?")
    return -covariance @ gradient, covariance, len(moved)
