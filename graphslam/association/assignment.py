"""The assignment of all sightings of a log to the landmarks of one map, scan by scan, each landmark once in a scan."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from ..log import UNIDENTIFIED, Log
from ..models import SensorModel
from ..se2 import Array, transform, turn_matrix, wrap
from .classes import LEAST, Classes
from .densities import Densities, Field
from .geometry import Places, differences
from .hypotheses import gates, log_density
from .options import AssociationOptions


@dataclass(frozen=True, eq=False)
class PlacedSightings:
    """Sightings from given poses: the position (M, d) of the landmark in world axes, with its covariance (M, d, d)."""

    means: Array
    covariances: Array

    @classmethod
    def of(cls, places: Places, at: Array) -> PlacedSightings:
        """Sightings placed from the pose (M, 3) of each."""
        y = places.means
        d = y.shape[1]
        means = transform(at, y[:, :2])
        if d == 3:
            means = np.column_stack([means, wrap(at[:, 2] + y[:, 2])])
        turn = turn_matrix(at[:, 2])[:, :d, :d]
        return cls(means, turn @ places.covariances @ np.swapaxes(turn, 1, 2))


def assign(
    world: PlacedSightings, steps: np.ndarray, landmarks: Array, own: Array, gate: float,
    weights: Callable[[np.ndarray, np.ndarray], Array],
) -> tuple[np.ndarray, Array]:  # fmt: skip
    """The landmark (M,) of each sighting, -1 for none, and its margin: the assignment of every scan with most evidence.

    Args:
        steps: (M,) of the sightings.
        landmarks: (L, d), with covariances ``own`` (L, d, d).
        gate: share of correct sightings that are within the gate.
        weights: from the sightings (C,) and landmarks (C,) of pairs to what the evidence has beside log N.
    """
    limit = float(gates(gate, world.means.shape[1], 1)[1])
    spread = np.trace(world.covariances[:, :2, :2], axis1=1, axis2=2)
    radius = np.sqrt(limit * (spread + np.max(own[:, :2, :2], initial=0.0)))
    lists = cKDTree(landmarks[:, :2]).query_ball_point(world.means[:, :2], radius)
    item = np.repeat(np.arange(len(lists)), [len(each) for each in lists])
    landmark = np.fromiter((j for each in lists for j in each), dtype=np.int64, count=len(item))
    nu = differences(world.means[item], landmarks[landmark])
    density, squares = log_density(nu, world.covariances[item] + own[landmark])
    evidence = density + weights(item, landmark)
    kept = (squares <= limit) & (evidence > 0)
    item, landmark, evidence = item[kept], landmark[kept], evidence[kept]
    chosen, margins = np.full(len(steps), -1), np.full(len(steps), np.inf)
    for begin, end in _runs(steps[item]):
        k, j, e = item[begin:end], landmark[begin:end], evidence[begin:end]
        rows, row = np.unique(k, return_inverse=True)
        names, column = np.unique(j, return_inverse=True)
        if len(names) == len(k) == len(rows):
            chosen[k], margins[k] = j, e
            continue
        table = np.zeros((len(rows), len(names) + len(rows)))
        table[row, column] = e
        a, b = linear_sum_assignment(table, maximize=True)
        good = table[a, b] > 0
        a, b = a[good], b[good]
        chosen[rows[a]] = names[b]
        others = table[a].copy()
        others[np.arange(len(a)), b] = 0.0
        margins[rows[a]] = table[a, b] - others.max(axis=1)
    return chosen, margins


def _runs(values: np.ndarray) -> list[tuple[int, int]]:
    """The beginnings and ends of runs of equal values."""
    cuts = np.flatnonzero(np.diff(values)) + 1
    return list(zip([0, *cuts.tolist()], [*cuts.tolist(), len(values)], strict=True)) if len(values) else []


def ids_by_map(
    log: Log, poses: Array, means: Mapping[int, Array], covariances: Mapping[int, Array], sensor: SensorModel,
    classes: Classes | None = None, probabilities: Mapping[int, Array] | None = None,
) -> np.ndarray:  # fmt: skip
    """The id (M,) of the landmark of a map to which each sighting belongs, `UNIDENTIFIED` for none.

    Args:
        log: the sightings; their own ids are not used.
        poses: (T+1, 3) the trajectory to which the map belongs.
        means, covariances: the map, {id: (d,)} and {id: (d, d)}.
        sensor: the noise model.
        classes: of the sightings, with the ``probabilities`` {id: (n,)} that each landmark is of each class.
    """
    if not means or len(log.steps) == 0:
        return np.full(len(log.steps), UNIDENTIFIED)
    options, names = AssociationOptions(), np.array(list(means))
    densities = Densities.of(log, Field.of(log, sensor), options.clutter)
    world = PlacedSightings.of(Places.of(log, sensor), np.asarray(poses)[log.steps])
    own = np.array([covariances[j] for j in means])

    def weights(item: np.ndarray, landmark: np.ndarray) -> Array:
        constant = np.full(len(item), densities.seen - densities.clutter)
        if classes is None or probabilities is None or classes.count == 1:
            return constant
        of_landmarks = np.log(np.maximum([probabilities[j] for j in means], LEAST))
        return constant + classes.together(classes.of_sightings(item), of_landmarks[landmark])

    chosen, _ = assign(world, log.steps, np.array(list(means.values())), own, options.gate, weights)
    return np.where(chosen < 0, UNIDENTIFIED, names[chosen])
