"""Alternative associations of a drive: which landmarks the robot may have returned to instead, and with what evidence.

A return begins where landmarks are seen again that were out of sight for long, an arrival where new ones are seen after a
blind stretch. All sightings from there on are taken for new landmarks (those in sight all along excepted), the graph is
solved, and the joint evidence for the association that was found is compared with that of the best alternatives in which
every landmark of the return is another one, or new.

The time out of sight is measured by a clock in steps that counts blind stretches as more steps. Within a moment of this
clock, odometry determines well enough where landmarks that were just seen must be.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..log import Log
from ..se2 import Array
from .classes import Classes
from .densities import Densities, Field
from .geometry import differences
from .given_ids import agree, id_of_each
from .hypotheses import log_density
from .k_best import CandidatePairs, Hypothesis
from .map_solution import Backbone, MapSolution
from .options import AssociationOptions

#: the most landmarks of what follows a return that are weighed
MOST_ITEMS = 40
#: and the most pairs
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
    first = {}
    for row in np.flatnonzero(labels >= 0)[::-1]:
        first[int(labels[row])] = int(steps[row])
    scans = np.unique(steps)
    found = []
    for before, step in zip(scans, scans[1:]):
        if times[step] - times[before] > moment + step - before:
            new = [j for j, at in first.items() if step <= at and times[at] <= times[step] + moment]
            if new:
                found.append(Return(int(step), int(before), np.sort(new), new=True))
    return found


def returns(steps: np.ndarray, times: np.ndarray, labels: np.ndarray, moment: int) -> list[Return]:
    """The returns of a drive: landmarks that were out of sight for more than a moment of the clock ``times`` (T+1,)."""
    order = np.lexsort((steps, labels))
    order = order[labels[order] >= 0]
    of, at = labels[order], steps[order]
    again = np.flatnonzero((of[1:] == of[:-1]) & (times[at[1:]] - times[at[:-1]] > moment))
    found: list[tuple[int, int, list[int]]] = []
    for step, last, label in sorted((int(at[k + 1]), int(at[k]), int(of[k])) for k in again):
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
    log: Log, backbone: Backbone, solved: MapSolution, field: Field, densities: Densities, classes: Classes,
    options: AssociationOptions, *, most: int, events: int | None = None,
) -> list[Alternative]:  # fmt: skip
    """The best alternatives, at most so many each, of the returns and arrivals after the longest absence."""
    labels = np.full(len(log.steps), -1)
    labels[solved.rows] = solved.labels[solved.which]
    moment = moment_of(backbone, options)
    times = clock(backbone, field, densities, moment)
    at = returns(log.steps, times, labels, moment) + arrivals(log.steps, times, labels, moment)
    found = []
    for back in sorted(at, key=lambda each: times[each.last] - times[each.step])[:events]:
        near = np.abs(times - times[back.step])[log.steps] <= moment
        found += alternatives(log, backbone, solved, labels, back, near, most, densities, classes)
    return found


def alternatives(
    log: Log, backbone: Backbone, solved: MapSolution, labels: np.ndarray, back: Return, near: np.ndarray, most: int,
    densities: Densities, classes: Classes,
) -> list[Alternative]:  # fmt: skip
    """The best alternatives of a return, at most so many, the best first; ``near`` (M,) sightings are of its moment."""
    after = log.steps >= back.step
    before_it = np.unique(labels[~after & (labels >= 0)])
    # landmarks that stay in sight tie both parts of the drive together in any alternative
    staying = np.setdiff1d(np.intersect1d(labels[near & after], labels[near & ~after]), back.landmarks)
    again = np.setdiff1d(np.unique(labels[after & (labels >= 0)]), staying)
    again = again[np.isin(again, before_it) | np.isin(again, back.landmarks)]
    if len(again) == 0 or len(before_it) == 0:
        return []
    first = {int(j): int(np.argmax((labels == j) & after)) for j in again}
    again = np.array(sorted(again, key=lambda j: first[int(j)])[:MOST_ITEMS])
    fresh = int(labels.max()) + 1
    split = np.where(after & np.isin(labels, again), labels + fresh, labels)
    apart = MapSolution.of(backbone, split, solved.poses) if np.isin(again, before_it).any() else solved
    if apart is solved:
        split, fresh = labels, 0
    place = {int(label): k for k, label in enumerate(apart.labels)}
    items = np.array([place[int(j) + fresh] for j in again])
    older = np.array([place[int(j)] for j in before_it])
    found = {place[int(j) + fresh]: place[int(j)] for j in again if j in before_it}
    pairs, item, other = _pairs(apart, items, older, found, densities, classes)
    ours = np.flatnonzero([found.get(int(a)) == b for a, b in zip(item, other)])
    of_group = np.isin(apart.labels[item] - fresh, back.landmarks)
    # what ids say is not doubted
    doubtful = of_group[ours] & (id_of_each(apart.which, backbone.known[apart.rows], len(apart.labels))[item[ours]] < 0)
    doubted, rest = ours[doubtful], ours[~doubtful]
    evidence = pairs.evidence(ours)
    allowed = np.ones(len(item), dtype=bool)
    allowed[doubted] = False
    others = [Hypothesis(rest, pairs.evidence(rest))] if len(doubted) else []
    seeds = np.flatnonzero(of_group & allowed)
    if len(seeds):
        others += pairs.several(seeds, most, allowed)
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
    apart: MapSolution,
    items: np.ndarray,
    older: np.ndarray,
    ours: dict[int, int],
    densities: Densities,
    classes: Classes,
) -> tuple[CandidatePairs, np.ndarray, np.ndarray]:
    """All pairs of an item and an older landmark within the gate, and those that were found in any case."""
    S = apart.covariances + apart.slack
    item, other = (each.ravel() for each in np.meshgrid(items, older, indexing="ij"))
    # the covariance of a difference is at most the sum, as errors of landmarks are correlated positively
    _, squares = log_density(differences(apart.landmarks[item], apart.landmarks[other]), S[item] + S[other])
    found = np.array([ours.get(int(i)) == int(j) for i, j in zip(item, other)], dtype=bool)
    order = np.argsort(np.where(found, -1.0, squares), kind="stable")[:MOST_PAIRS]
    order = order[found[order] | (squares[order] <= GATE)]
    item, other = item[order], other[order]
    chosen = np.unique(np.concatenate([item, other]))
    P = apart.joint_covariance(chosen)
    a, b = np.searchsorted(chosen, item), np.searchsorted(chosen, other)
    first, second = P[a], P[b]
    covariance = (first[:, :, a] - first[:, :, b] - second[:, :, a] + second[:, :, b]).copy()
    here = np.arange(len(a))
    covariance[here, :, here] += apart.slack_of(item, other)
    shown = classes.sums(apart.which, apart.rows, len(apart.labels))
    weights = -densities.new + classes.together(shown[item], shown[other])
    nu = differences(apart.landmarks[item], apart.landmarks[other])
    return CandidatePairs(item, other, nu, covariance, weights, GATE), item, other


#: a stretch is blind if it leaves landmarks a standard deviation above this part of their distance from each other
CERTAIN = 1 / 6
#: at most so many moments in a drive
MOST_MOMENTS = 150


def moment_of(backbone: Backbone, options: AssociationOptions) -> int:
    """The length of a moment [steps]."""
    return max(options.window, -(-backbone.log.num_poses // MOST_MOMENTS))


def clock(backbone: Backbone, field: Field, densities: Densities, moment: int) -> np.ndarray:
    """The time (T+1,) of each pose: its step, plus two moments for each blind stretch before it."""
    log = backbone.log
    noise = np.linalg.inv(backbone.motions.information)
    variance = np.linalg.norm(noise[:, :2, :2], 2, axis=(1, 2)) + noise[:, 2, 2] * (field.farthest / 2) ** 2
    total = np.concatenate([[0.0], np.cumsum(variance)])
    scans = np.unique(log.steps)
    per_area = densities.new + (np.log(2 * np.pi) if log.has_orientation else 0.0)
    blind = np.sqrt(np.diff(total[scans])) > CERTAIN * np.exp(-0.5 * per_area)
    leaps = np.zeros(log.num_poses, dtype=np.int64)
    leaps[scans[1:][blind]] = 2 * moment
    return np.arange(log.num_poses) + np.cumsum(leaps)
