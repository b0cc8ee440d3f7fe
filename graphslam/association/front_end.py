"""Association along the drive: tracks from a local filter, joined to landmarks by graphs of the drive so far.

The local filter (`LocalMap`) is a Kalman filter of the robot and the landmarks that it saw last. It joins sightings of
neighbouring scans to tracks. Its state is the pose and the tracks seen within some steps. Older ones are marginalised:
whether a track is a landmark that was seen before is decided by the graph (`run_front_end`), not by the filter.
"""

from __future__ import annotations

import numpy as np

from ..errors import GraphError
from ..graph import Graph
from ..models import MotionModel, SensorModel
from ..se2 import Array, between, compose, difference, lever_matrix, perpendicular, turn_matrix, wrap
from ..solvers.solve import solve
from .assignment import Candidates, disjoint, gates, log_density, merges
from .map_solution import MapSolution, Problem, seen_from
from .problem import id_of_each, may_be_one

#: the most hypotheses that are compared for a scan
MOST_IN_SCAN = 1_000
#: the logarithm of the evidence that a sighting needs to continue a track rather than begin one or belong to another
SURE = np.log(5.0)


class LocalMap:
    """The pose (3,), the tracks (n, d) and their joint covariance; the first pose is known."""

    def __init__(self, pose: Array, problem: Problem, memory: int) -> None:
        places, classes, options = problem.backbone.places, problem.classes, problem.options
        self.pose, self.covariance = np.array(pose, dtype=float), np.zeros((3, 3))
        self.d = places.means.shape[1]
        self.tracks, self.last = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        self.landmarks, self._shown = np.zeros((0, self.d)), np.zeros((0, classes.count))
        self._places, self._densities, self._classes = places, problem.densities, classes
        self._memory, self._options = memory, options
        self._gate = float(gates(options.gate, self.d, 1)[1])

    def move(self, motion: Array, noise: Array) -> None:
        """The robot moves by a motion (3,) with covariance (3, 3), both in its own axes."""
        before = self.pose
        self.pose = compose(before, motion)
        P, J = self.covariance, turn_matrix(before[2])
        F = lever_matrix(perpendicular(self.pose[:2] - before[:2]))
        P[:3] = F @ P[:3]
        P[:, :3] = P[:, :3] @ F.T
        P[:3, :3] += J @ noise @ J.T

    def scan(self, rows: np.ndarray, step: int, fresh: int) -> np.ndarray:
        """The tracks (k,) of the sightings in rows (k,), new ones numbered from ``fresh`` on, -1 for doubtful ones."""
        self._keep(self.last >= step - self._memory)
        item, landmark, nu, S, H = pairs = self._pairs(rows)
        chosen, doubtful = self._chosen(rows, *pairs[:-1])
        matched, used = item[chosen], landmark[chosen]
        tracks = np.full(len(rows), -1)
        tracks[matched] = self.tracks[used]
        self.last[used] = step
        self._shown[used] += self._classes.of_sightings(rows[matched])
        self._correct(nu[chosen], *(each[_columns(chosen, self.d)] for each in (H, S[:, _columns(chosen, self.d)])))
        # sightings of one of several tracks are left out for now
        new = np.setdiff1d(np.flatnonzero(tracks < 0), item[doubtful])
        tracks[new] = fresh + np.arange(len(new))
        self._add(rows[new], tracks[new], step)
        return tracks

    def remove(self, tracks: np.ndarray) -> None:
        """Marginalise tracks."""
        self._keep(~np.isin(self.tracks, tracks))

    def _keep(self, kept: np.ndarray) -> None:
        if kept.all():
            return
        rows = np.concatenate([np.ones(3, dtype=bool), np.repeat(kept, self.d)])
        self.covariance = self.covariance[np.ix_(rows, rows)]
        self.tracks, self.last, self.landmarks = self.tracks[kept], self.last[kept], self.landmarks[kept]
        self._shown = self._shown[kept]

    def _weights(self, rows: np.ndarray) -> Array:
        """w (k, n) of each sighting and track."""
        own = self._classes.of_sightings(rows)[:, None]
        return self._densities.weight + self._classes.together(own, self._shown[None])

    def _pairs(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, Array, Array, Array]:
        """Pairs of a sighting of the scan and a track within the gate.

        Returns:
            The sighting (C,) and the track (C,) of each, its residual (C, d), their covariance (C d, C d), and the derivative
            (C d, 3 + n d) of what is predicted.
        """
        n, d = len(self.tracks), self.d
        y, Q = self._places.means[rows], self._places.covariances[rows]
        h, by_pose, by_landmark = seen_from(self.pose, self.landmarks)
        each, blocks = np.arange(n), np.zeros((n, d, n, d))
        blocks[each, :, each] = by_landmark
        H = np.hstack([by_pose.reshape(n * d, 3), blocks.reshape(n * d, n * d)])
        joint = H @ self.covariance @ H.T
        own = joint.reshape(n, d, n, d)[each, :, each]
        nu = difference(y[:, None], h[None])
        density, squares = log_density(nu, own[None] + Q[:, None])
        # a wrong new track is joined later, a wrong match stays: so doubtful sightings begin a track
        item, landmark = np.nonzero((squares <= self._gate) & (density + self._weights(rows) > SURE))
        columns = _columns(landmark, d)
        S, each, count = joint[np.ix_(columns, columns)], np.arange(len(item)), len(item)
        S.reshape(count, d, count, d)[each, :, each] += Q[item]
        return item, landmark, nu[item, landmark], S, H[columns]

    def _chosen(
        self, rows: np.ndarray, item: np.ndarray, landmark: np.ndarray, nu: Array, S: Array
    ) -> tuple[np.ndarray, np.ndarray]:
        """Which of the pairs are right, and which are the best but doubtful."""
        if len(item) == 0:
            return item, item
        weights, noise = self._weights(rows)[item, landmark], self._places.covariances[rows[item]]
        numbers = np.unique(item, return_inverse=True)[1]
        candidates, order = Candidates.of(numbers, landmark, nu, S, weights, noise)
        if self._options.method == "nearest":
            best = nearest(candidates)
            return order[best[best >= 0]], order[:0]
        best, evidence = candidates.best(self._options.gate, most=MOST_IN_SCAN)
        # only sightings with several candidates can be doubtful
        others = np.where(np.diff(candidates.starts) > 1, best, -1)
        doubtful = candidates.margins(others, evidence, self._options.gate, most=MOST_IN_SCAN // 5) < SURE
        return order[best[(best >= 0) & ~doubtful]], order[best[(best >= 0) & doubtful]]

    def _correct(self, nu: Array, H: Array, S: Array) -> None:
        """The joint Kalman update by residuals (k, d)."""
        if len(nu) == 0:
            return
        d = self.d
        HP = H @ self.covariance
        K = np.linalg.solve(S, HP).T
        delta = K @ nu.ravel()
        self.covariance -= K @ HP
        self.covariance = (self.covariance + self.covariance.T) / 2
        self.pose = self.pose + delta[:3]
        self.pose[2] = wrap(self.pose[2])
        self.landmarks = difference(self.landmarks + delta[3:].reshape(-1, d), np.zeros(d))

    def _add(self, rows: np.ndarray, tracks: np.ndarray, step: int) -> None:
        """New tracks where sightings (k,) put them: m = x + R y, with the derivatives of that."""
        if len(rows) == 0:
            return
        k, d = len(rows), self.d
        y, R = self._places.means[rows], turn_matrix(self.pose[2])[:d, :d]
        means = y @ R.T
        by_pose = lever_matrix(perpendicular(means[:, :2]))[:, :d]
        means = difference(means + self.pose[:d], np.zeros(d))
        G = by_pose.reshape(k * d, 3)
        lower, own, each = G @ self.covariance[:3], G @ self.covariance[:3, :3] @ G.T, np.arange(k)
        own.reshape(k, d, k, d)[each, :, each] += R @ self._places.covariances[rows] @ R.T
        self.covariance = np.block([[self.covariance, lower.T], [lower, own]])
        self.landmarks = np.concatenate([self.landmarks, means])
        self.tracks = np.concatenate([self.tracks, tracks])
        self.last = np.concatenate([self.last, np.full(k, step)])
        self._shown = np.concatenate([self._shown, self._classes.of_sightings(rows)])


def _columns(places: np.ndarray, d: int) -> np.ndarray:
    return (places[:, None] * d + np.arange(d)).ravel()


def nearest(candidates: Candidates) -> np.ndarray:
    """The most likely candidate (I,) of each item by itself, the most likely pair first; no landmark is used twice."""
    (count, d), chosen = candidates.residuals.shape, np.full(len(candidates.starts) - 1, -1)
    blocks = candidates.covariance.reshape(count, d, count, d)[np.arange(count), :, np.arange(count)]
    evidence = candidates.weights + log_density(candidates.residuals, blocks)[0]
    item = np.repeat(np.arange(len(chosen)), np.diff(candidates.starts))
    used: set[int] = set()
    for c in np.argsort(-evidence):
        if chosen[item[c]] < 0 and evidence[c] > 0 and candidates.landmarks[c] not in used:
            chosen[item[c]] = c
            used.add(int(candidates.landmarks[c]))
    return chosen


#: the most solutions of the graph along a drive
MOST_WINDOWS = 150
#: a new landmark can still be joined to an older one for this many windows after its first sighting
OPEN = 4


def run_front_end(problem: Problem, motion: MotionModel, sensor: SensorModel) -> tuple[np.ndarray, Array]:
    """Drive along the log once: the label (M,) of each sighting, -1 where it was left out, and the poses (T+1, 3).

    Where some sightings have ids, the robot moves as the graph of these alone says: after a long way, where it is decides
    which landmarks the others are of.
    """
    log, backbone, options = problem.log, problem.backbone, problem.options
    motions, noises = log.motions(motion)
    if np.any(kept := backbone.known >= 0):
        named = log.with_sightings(kept)
        graph = Graph.from_log(named, motion=motion, sensor=sensor, edges="landmark+motion", kernel="none")
        guide = solve(graph).poses
        motions = between(guide[:-1], guide[1:])
    window = max(options.window, -(-log.num_poses // MOST_WINDOWS))
    local = LocalMap(log.initial_poses[0], problem, window)
    first = np.searchsorted(log.steps, np.arange(log.num_poses + 1))
    filtered = np.empty((log.num_poses, 3))
    tracks, fresh = np.full(len(log.steps), -1), 0
    root = np.arange(len(log.steps))
    poses, done = filtered[:0], 0
    for t in range(log.num_poses):
        if t:
            local.move(motions[t - 1], noises[t - 1])
        if first[t + 1] > first[t]:
            rows = np.arange(first[t], first[t + 1])
            tracks[rows] = local.scan(rows, t, fresh)
            fresh = max(fresh, int(tracks[rows].max()) + 1)
        filtered[t] = local.pose
        if ((t + 1) % window and t + 1 < log.num_poses) or first[t + 1] == 0:
            continue
        # the graph of the drive so far
        if done:
            ahead = compose(poses[-1], between(filtered[done - 1], filtered[done : t + 1]))
            poses = np.concatenate([poses, ahead])
        else:
            poses = filtered[: t + 1].copy()
        done = t + 1
        _join_by_ids(root, tracks, backbone.known)
        for _ in range(3):
            labels = np.where(tracks >= 0, root[tracks], -1)[: first[t + 1]]
            labels[_alone(labels, log.steps[: first[t + 1]], t - OPEN * window)] = -1
            if not np.any(labels >= 0):
                break
            try:
                solution = MapSolution.of(backbone, labels, poses)
            except GraphError:
                # the labels contradict the motions so much that solving diverges; `refine` finds it, too
                break
            poses = solution.poses
            joined = _join(problem, solution, t - OPEN * window)
            if not joined:
                break
            for new, old in joined.items():
                root[root == new] = old
            active = root[local.tracks]
            doubled = [k for k in range(len(active)) if active[k] in active[k + 1 :]]
            local.remove(local.tracks[doubled])
    labels = np.where(tracks >= 0, root[tracks], -1) if len(tracks) else tracks
    return labels, poses if done == log.num_poses else filtered


def _alone(labels: np.ndarray, steps: np.ndarray, since: int) -> np.ndarray:
    """Which sightings are the only one of their landmark, and old."""
    _, which, counts = np.unique(labels, return_inverse=True, return_counts=True)
    return (counts[which] == 1) & (steps < since)


def _join_by_ids(root: np.ndarray, tracks: np.ndarray, known: np.ndarray) -> None:
    """Give tracks of which most sightings have one id the ``root`` of the oldest of them."""
    ids = id_of_each(tracks, known, len(root))
    for j in np.unique(ids[ids >= 0]):
        roots = np.unique(root[ids == j])
        root[np.isin(root, roots[1:])] = roots[0]


def _join(problem: Problem, solution: MapSolution, since: int) -> dict[int, int]:
    """{new: old} labels of landmarks that are one; ambiguous decisions are left for later."""
    seen = solution.seen(problem.log.steps)
    found = merges(problem, solution, np.flatnonzero([steps[0] >= since for steps in seen]))
    # one landmark may be near an old one by chance; a place that is seen again has several
    least = np.log(problem.options.factor)
    ids = id_of_each(solution.which, problem.backbone.known[solution.rows], len(seen))
    sure = [m for m in found if m.margin >= least and m.evidence >= 2 * least and may_be_one(ids[m.item], ids[m.into])]
    # chains, of which each member was seen with another one, are joined in several rounds
    return {int(solution.labels[m.item]): int(solution.labels[m.into]) for m in disjoint(sure)}
