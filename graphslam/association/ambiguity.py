"""Alternatives to an association: places that may have been taken for others, and the evidence for them.

The evidence assumes that landmarks are distributed at random. So two places that look alike are taken for one wherever
odometry allows it, without a doubt, unless the drive itself has shown that there are two.

A return begins where landmarks are seen again that were out of sight for long, an arrival where new ones are seen after a
blind stretch. All sightings from there on are taken for new landmarks (those in sight all along excepted), the graph is
solved, and the joint evidence for the association that was found is compared with that of the best alternatives in which
every landmark of the return is another one, or new.

The time out of sight is measured by a clock in steps that counts blind stretches as more steps (`clock`). Within a moment of
this clock, odometry determines well enough where landmarks that were just seen must be.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..engine import engine
from ..se2 import Array, difference
from .assignment import log_density
from .map_solution import MapSolution, Problem, difference_covariance
from .problem import agree, id_of_each

#: the second pairs that are tried after each seed
SECOND = 3


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """The pairs (n,) that belong together, as places in the lists of pairs, and the evidence E for them over none."""

    pairs: np.ndarray
    evidence: float


@dataclass(frozen=True, eq=False)
class CandidatePairs:
    """Pairs (C,) of an item and an older landmark, with what is needed to weigh them jointly.

    After a long drive without sightings the covariance is so large that no pair is likely by itself. But the second pair is
    likely given the first, because both move together. So a hypothesis begins with a seed: a first pair, whatever its own
    evidence, then one of the pairs with the most evidence given the first, and so on while the evidence rises. Given the
    pairs so far, residuals and covariance of all others are conditioned on them (Schur complements), so that the sum of the
    steps is the joint evidence E of `assignment.Candidates`.

    Attributes:
        item, landmark: (C,) numbers from 0.
        residuals: (C, d), with ``covariance`` (C, d, C, d) if all of them are right.
        weights: (C,) what the evidence for each has beside log N.
        gate: the most that nu' S^-1 nu of a pair, given the others, may be.
    """

    item: np.ndarray
    landmark: np.ndarray
    residuals: Array
    covariance: Array
    weights: Array
    gate: float

    def evidence(self, chosen: np.ndarray) -> float:
        """E of the pairs (n,), without a gate."""
        return float(self._grown(np.atleast_2d(chosen), 1e300, grow=False)[1][0]) if len(chosen) else 0.0

    def k_best(self, seeds: np.ndarray, most: int, allowed: np.ndarray | None = None) -> list[Hypothesis]:
        """The best hypotheses, at most ``most``, begun from the pairs (n,), the best first; each has another set of pairs.

        Args:
            allowed: (C,) which pairs may be used; default: all.
        """
        seeds = seeds if allowed is None else seeds[allowed[seeds]]
        if len(seeds) == 0:
            return []
        _, _, second = self._grown(seeds[:, None], self.gate, allowed=allowed)
        # and each seed alone
        second = np.column_stack([second, np.full(len(seeds), -1)])
        begin = np.unique(np.column_stack([np.repeat(seeds, SECOND + 1), second.ravel()]), axis=0)
        return _best(*self._grown(begin, self.gate, allowed=allowed)[:2], most)

    def completed(self, chosen: np.ndarray, allowed: np.ndarray | None = None) -> Hypothesis:
        """The hypothesis that begins with the pairs (n,), to which pairs are added while the evidence rises."""
        members, evidence, _ = self._grown(np.atleast_2d(chosen), 1e300, allowed=allowed)
        return Hypothesis(np.flatnonzero(members[0]), float(evidence[0]))

    def _grown(
        self, begin: np.ndarray, gate: float, *, grow: bool = True, allowed: np.ndarray | None = None
    ) -> tuple[np.ndarray, Array, np.ndarray]:
        allowed = np.ones(len(self.residuals), dtype=bool) if allowed is None else allowed
        return engine.grow_hypotheses(
            begin, self.item, self.landmark, self.residuals, self.covariance, self.weights, allowed, gate, self.gate,
            grow,
        )  # fmt: skip


def _best(members: np.ndarray, evidence: Array, most: int) -> list[Hypothesis]:
    found: dict[bytes, Hypothesis] = {}
    for k in np.argsort(-evidence, kind="stable"):
        if np.isfinite(evidence[k]) and len(found) < most:
            found.setdefault(members[k].tobytes(), Hypothesis(np.flatnonzero(members[k]), float(evidence[k])))
    return list(found.values())


#: the most landmarks after a return that are compared with older ones
MOST_ITEMS = 40
#: the most pairs of such a landmark and an older one
MOST_PAIRS = 300
#: the most that nu' S^-1 nu of a pair may be: several pairs can outweigh odometry that is far off
GATE = 100.0


@dataclass(frozen=True, eq=False)
class Return:
    """A step at which landmarks (their labels) come into sight again, or ``new`` ones, and their last step before."""

    step: int
    last: int
    landmarks: np.ndarray
    new: bool = False


def arrivals(steps: np.ndarray, times: np.ndarray, labels: np.ndarray, moment: int) -> list[Return]:
    """Where, after a blind stretch, landmarks are seen that had not been seen before."""
    rows = np.flatnonzero(labels >= 0)
    names, first = np.unique(labels[rows], return_index=True)
    scans, at = np.unique(steps), steps[rows[first]]
    found = []
    for before, step in zip(scans.tolist(), scans[1:].tolist()):
        new = names[(at >= step) & (times[at] <= times[step] + moment)]
        if times[step] - times[before] > moment + step - before and len(new):
            found.append(Return(step, before, new, new=True))
    return found


def returns(steps: np.ndarray, times: np.ndarray, labels: np.ndarray, moment: int) -> list[Return]:
    """The returns of a drive: landmarks that were out of sight for more than a moment of the clock ``times`` (T+1,)."""
    order = np.lexsort((steps, labels))
    order = order[labels[order] >= 0]
    of, at = labels[order], steps[order]
    again = np.flatnonzero((of[1:] == of[:-1]) & (times[at[1:]] - times[at[:-1]] > moment))
    found: list[tuple[int, int, list[int]]] = []
    for step, last, label in sorted((int(at[k + 1]), int(at[k]), int(of[k])) for k in again.tolist()):
        if found and times[step] <= times[found[-1][0]] + moment:
            begin, before, members = found[-1]
            found[-1] = (begin, max(before, last) if last < begin else before, [*members, label])
        else:
            found.append((step, last, [label]))
    return [Return(step, last, np.unique(members)) for step, last, members in found]


@dataclass(frozen=True, eq=False)
class Alternative:
    """An alternative to what a robot saw from a return on.

    Attributes:
        back: the return.
        others: the labels of the landmarks that those of the return are instead; none where they are new.
        log_factor: the logarithm of the evidence for the association that was found over that for this alternative.
        labels: (M,) of all sightings.
        poses: (T+1, 3) with what follows the return taken for another place, whichever.
    """

    back: Return
    others: np.ndarray
    log_factor: float
    labels: np.ndarray
    poses: Array


def all_alternatives(
    problem: Problem, solution: MapSolution, *, most: int, events: int | None = None
) -> list[Alternative]:
    """The best alternatives, at most ``most`` each, of the ``events`` returns and arrivals after the longest absence."""
    log = problem.log
    labels = np.full(len(log.steps), -1)
    labels[solution.rows] = solution.labels[solution.which]
    moment = problem.moment
    times = clock(problem, moment)
    at = returns(log.steps, times, labels, moment) + arrivals(log.steps, times, labels, moment)
    found = []
    for back in sorted(at, key=lambda each: times[each.last] - times[each.step])[:events]:
        near = np.abs(times - times[back.step])[log.steps] <= moment
        found += alternatives(problem, solution, labels, back, near, most)
    return found


def alternatives(
    problem: Problem, solution: MapSolution, labels: np.ndarray, back: Return, near: np.ndarray, most: int
) -> list[Alternative]:
    """The best alternatives of a return, at most ``most``, the best first; ``near`` (M,) sightings are of its moment."""
    backbone, after = problem.backbone, problem.log.steps >= back.step
    before_it = np.unique(labels[~after & (labels >= 0)])
    # landmarks that stay in sight tie both parts of the drive together in any alternative
    staying = np.setdiff1d(np.intersect1d(labels[near & after], labels[near & ~after]), back.landmarks)
    again = np.setdiff1d(np.unique(labels[after & (labels >= 0)]), staying)
    again = again[np.isin(again, before_it) | np.isin(again, back.landmarks)]
    if len(again) == 0 or len(before_it) == 0:
        return []
    first = {int(j): int(np.argmax((labels == j) & after)) for j in again}
    again = np.array(sorted(again, key=lambda j: first[int(j)])[:MOST_ITEMS])
    fresh, apart = 0, solution
    if np.isin(again, before_it).any():
        fresh = int(labels.max()) + 1
        split = np.where(after & np.isin(labels, again), labels + fresh, labels)
        apart = MapSolution.of(backbone, split, solution.poses)
    place = {int(label): k for k, label in enumerate(apart.labels)}
    items = np.array([place[int(j) + fresh] for j in again])
    older = np.array([place[int(j)] for j in before_it])
    found = {place[int(j) + fresh]: place[int(j)] for j in again if j in before_it}
    pairs, item, other = _pairs(problem, apart, items, older, found)
    ours = np.flatnonzero([found.get(int(a)) == b for a, b in zip(item, other)])
    of_group = np.isin(apart.labels[item] - fresh, back.landmarks)
    # ids that the log gives are not doubted
    doubtful = of_group[ours] & (id_of_each(apart.which, backbone.known[apart.rows], len(apart.labels))[item[ours]] < 0)
    doubted, rest = ours[doubtful], ours[~doubtful]
    evidence = pairs.evidence(ours)
    allowed = np.ones(len(item), dtype=bool)
    allowed[doubted] = False
    others = [Hypothesis(rest, pairs.evidence(rest))] if len(doubted) else []
    seeds = np.flatnonzero(of_group & allowed)
    if len(seeds):
        others += pairs.k_best(seeds, most, allowed)
        others += [pairs.completed(rest, allowed)] if len(rest) else []
    if len(doubted) and len(rest):
        others.append(Hypothesis(np.zeros(0, dtype=np.int64), 0.0))
    # where ids leave no doubt, the best hypothesis may be the one that was found
    result, known = [], {tuple(ours)}
    for each in sorted(others, key=lambda each: -each.evidence):
        if (key := tuple(each.pairs)) in known or (back.new and not of_group[each.pairs].any()):
            continue
        known.add(key)
        to = np.arange(len(apart.labels))
        to[item[each.pairs]] = other[each.pairs]
        relabelled = np.full(len(labels), -1)
        relabelled[apart.rows] = apart.labels[to[apart.which]]
        if not agree(relabelled, backbone.known):
            continue
        instead = np.unique(apart.labels[other[each.pairs[of_group[each.pairs]]]])
        result.append(Alternative(back, instead, evidence - each.evidence, relabelled, apart.poses))
    return result[:most]


def _pairs(
    problem: Problem, apart: MapSolution, items: np.ndarray, older: np.ndarray, ours: dict[int, int]
) -> tuple[CandidatePairs, np.ndarray, np.ndarray]:
    """All pairs of an item and an older landmark within the gate, and those that were found in any case."""
    S = apart.covariances + apart.slack
    item, other = (each.ravel() for each in np.meshgrid(items, older, indexing="ij"))
    # the covariance of a difference is at most the sum, as errors of landmarks are correlated positively
    _, squares = log_density(difference(apart.landmarks[item], apart.landmarks[other]), S[item] + S[other])
    found = np.array([ours.get(int(i)) == int(j) for i, j in zip(item, other)], dtype=bool)
    order = np.argsort(np.where(found, -1.0, squares), kind="stable")[:MOST_PAIRS]
    order = order[found[order] | (squares[order] <= GATE)]
    item, other = item[order], other[order]
    chosen = np.unique(np.concatenate([item, other]))
    P = apart.joint_covariance(chosen)
    a, b = np.searchsorted(chosen, item), np.searchsorted(chosen, other)
    covariance = difference_covariance(P, a, b, apart.slack_of(item, other))
    shown = problem.classes.sums(apart.which, apart.rows, len(apart.labels))
    weights = -problem.densities.new + problem.classes.together(shown[item], shown[other])
    nu = difference(apart.landmarks[item], apart.landmarks[other])
    return CandidatePairs(item, other, nu, covariance, weights, GATE), item, other


#: a stretch is blind where odometry leaves landmarks a standard deviation above this share of their distance from each other
CERTAIN = 1 / 6


def clock(problem: Problem, moment: int) -> np.ndarray:
    """The time (T+1,) of each pose: its step, plus two moments for each blind stretch before it."""
    log = problem.log
    noise = np.linalg.inv(problem.backbone.motions.information)
    variance = np.linalg.norm(noise[:, :2, :2], 2, axis=(1, 2)) + noise[:, 2, 2] * (problem.field.farthest / 2) ** 2
    total = np.concatenate([[0.0], np.cumsum(variance)])
    scans = np.unique(log.steps)
    per_area = problem.densities.new + (np.log(2 * np.pi) if log.has_orientation else 0.0)
    blind = np.sqrt(np.diff(total[scans])) > CERTAIN * np.exp(-0.5 * per_area)
    leaps = np.zeros(log.num_poses, dtype=np.int64)
    leaps[scans[1:][blind]] = 2 * moment
    return np.arange(log.num_poses) + np.cumsum(leaps)


@dataclass(frozen=True)
class Ambiguity:
    """A place that may be another one.

    Attributes:
        step: where the landmarks come into sight again, or first.
        last: the last step before in which one of them, or else any landmark, was seen.
        landmarks: their ids.
        others: ids of the landmarks that they may be instead; empty where they may never have been seen before.
        new: whether they were taken for landmarks that had never been seen before.
        log_factor: the logarithm of the evidence for ``landmarks`` over that for the alternative.
    """

    step: int
    last: int
    landmarks: tuple[int, ...]
    others: tuple[int, ...]
    new: bool
    log_factor: float

    @property
    def factor(self) -> float:
        """The evidence for ``landmarks`` over that for the alternative."""
        return float(np.exp(np.clip(self.log_factor, -700, 700)))

    def __str__(self) -> str:
        which = _listed(self.landmarks)
        if self.new:
            begin, mine = f"the arrival at {which}", "that nothing there had been seen before"
            since = f"after a blind drive from step {self.last}"
        else:
            begin, mine, since = f"the return to {which}", "for it", f"last seen at step {self.last}"
        begin = f"{begin} at step {self.step}, {since}, is ambiguous"
        if self.others and set(self.others) <= set(self.landmarks):
            other = f"for {_listed(self.others)}, exchanged"
        else:
            other = f"for {_listed(self.others)} instead" if self.others else "for a place not seen before"
        if self.log_factor >= 0:
            return f"{begin}: the evidence {mine} is only {readable(self.log_factor)} times that {other}"
        more = f"the evidence {other} is {readable(-self.log_factor)} times that {mine}"
        return f"{begin}: taken by itself, {more}; for the drive as a whole no higher evidence was found"


def ambiguities(alternatives: list[Alternative], factor: float, ids: np.ndarray) -> tuple[Ambiguity, ...]:
    """The places for which the evidence is less than a factor times that for the best alternative, the worst first.

    ``ids`` (L,) are those of the labels.
    """
    best: dict[int, Ambiguity] = {}
    for each in sorted(alternatives, key=lambda each: each.log_factor):
        if each.log_factor < np.log(factor):
            back, (mine, others) = each.back, (tuple(ids[of].tolist()) for of in (each.back.landmarks, each.others))
            best.setdefault(back.step, Ambiguity(back.step, back.last, mine, others, back.new, each.log_factor))
    return tuple(best.values())


def readable(log_factor: float) -> str:
    """A factor of evidence in words, from its logarithm: three digits, or the power of ten above a million."""
    if log_factor < np.log(1e6):
        return f"{np.exp(log_factor):,.3g}" if log_factor < np.log(1000) else f"{np.exp(log_factor):,.0f}"
    return f"10^{log_factor / np.log(10):.0f}"


def _listed(landmarks: tuple[int, ...]) -> str:
    names = ", ".join(map(str, landmarks[:6])) + (", ..." if len(landmarks) > 6 else "")
    return f"landmark{'s' if len(landmarks) > 1 else ''} {names}"
