"""The graph of sightings with labels, solved: landmarks with their joint covariance from the factor of Omega.

While labels change, the same motions and sightings enter many graphs. A `Backbone` computes them once. `Places` and
`seen_from` give sightings and landmarks as places in the robot's axes: their difference is the Cartesian residual of
`edges.observation`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..edges import ANCHOR_INFORMATION, AnchorEdges, EdgeFamily, RelativePointEdges, RelativePoseEdges, motion_edges
from ..graph import Graph
from ..linear.cholesky import analyze
from ..log import Log
from ..models import MotionModel, SensorModel
from ..se2 import Array, difference, transform, turn_matrix, wrap
from ..solvers.iteration import Run, gauss_newton
from ..solvers.uncertainty import Uncertainty
from .problem import AssociationOptions, Classes, Densities, Field, numbered


@dataclass(frozen=True, eq=False)
class Places:
    """The place (M, d) that each sighting gives its landmark, (x, y) or (x, y, heading), and its covariance (M, d, d)."""

    means: Array
    covariances: Array

    @classmethod
    def of(cls, log: Log, sensor: SensorModel) -> Places:
        """The places of the sightings of a log, in the robot's axes."""
        return cls(*sensor.places(log.sightings))

    def seen_at(self, poses: Array) -> Places:
        """The places in world axes, from places in the axes of the pose (M, 3) of each."""
        d = self.means.shape[1]
        means = transform(poses, self.means[:, :2])
        if d == 3:
            means = np.column_stack([means, wrap(poses[:, 2] + self.means[:, 2])])
        turn = turn_matrix(poses[:, 2])[:, :d, :d]
        return Places(means, turn @ self.covariances @ np.swapaxes(turn, 1, 2))


def seen_from(pose: Array, landmarks: Array) -> tuple[Array, Array, Array]:
    """Landmarks (n, d) in the axes of poses (3,) or (n, 3), and the derivatives by pose (n, d, 3) and landmark (n, d, d)."""
    n, d = landmarks.shape
    pose = np.broadcast_to(pose, (n, 3))
    by_landmark = turn_matrix(-pose[:, 2])[:, :d, :d]
    h = np.einsum("nij,nj->ni", by_landmark, difference(landmarks, pose[:, :d]))
    by_pose = np.zeros((n, d, 3))
    by_pose[:, :, :d] = -by_landmark
    by_pose[:, 0, 2], by_pose[:, 1, 2] = h[:, 1], -h[:, 0]
    return h, by_pose, by_landmark


def difference_covariance(P: Array, a: np.ndarray, b: np.ndarray, slack: Array) -> Array:
    """The covariance (C, d, C, d) of the differences of landmarks a (C,) and b (C,), with a slack (C, d, d) of their own.

    P is the covariance (k, d, k, d) of all of them.
    """
    first, second = P[a], P[b]
    covariance = first[:, :, a] - first[:, :, b] - second[:, :, a] + second[:, :, b]
    each = np.arange(len(a))
    covariance[each, :, each] += slack
    return covariance


#: the most steps of Gauss-Newton; the values it starts from are nearly right
STEPS = 8
#: errors of real sightings are correlated: a landmark is known no better than by this number of independent sightings
INDEPENDENT = 10


@dataclass(frozen=True, eq=False)
class Backbone:
    """The motion edges of a log, its sightings as places in the robot's axes with information, and the sensor's place."""

    log: Log
    places: Places
    information: Array
    motions: RelativePoseEdges
    origin: tuple[float, float]

    @classmethod
    def of(cls, log: Log, sensor: SensorModel, motion: MotionModel) -> Backbone:
        """The backbone of a log."""
        assert log.controls is not None and log.dt is not None
        places = Places.of(log, sensor)
        information = np.linalg.inv(places.covariances)
        motions = motion_edges(
            np.arange(log.num_poses), log.controls, log.dt, motion, starts=log.control_starts,
            control_variances=log.control_variances, recorded_dt=log.recorded_dt,
        )  # fmt: skip
        return cls(log, places, (information + np.swapaxes(information, 1, 2)) / 2, motions, sensor.offset)

    @cached_property
    def known(self) -> np.ndarray:
        """The ids (M,) of the sightings, numbered from 0, -1 for none; see `association.problem`."""
        return numbered(self.log.landmarks)

    def graph(self, labels: np.ndarray, poses: Array) -> tuple[Graph, np.ndarray]:
        """The graph of the first poses (t, 3) and the sightings from them with labels (m,) of 0 or above, and their rows."""
        count, rows = len(poses), np.flatnonzero(labels >= 0)
        ids, which = np.unique(labels[rows], return_inverse=True)
        steps, measured = self.log.steps[rows], self.places.means[rows]
        landmarks = np.zeros((len(ids), 3))
        # each landmark begins at the mean of the places where its sightings put it
        np.add.at(landmarks[:, :2], which, transform(poses[steps], measured[:, :2]))
        landmarks[:, :2] /= np.maximum(np.bincount(which, minlength=len(ids)), 1)[:, None]
        if measured.shape[1] == 3:
            facing = poses[steps, 2] + measured[:, 2]
            sums = (np.bincount(which, f(facing), len(ids)) for f in (np.sin, np.cos))
            landmarks[:, 2] = np.arctan2(*sums)
        kind = RelativePoseEdges if measured.shape[1] == 3 else RelativePointEdges
        m, driven = self.motions, slice(0, count - 1)
        families: tuple[EdgeFamily, ...] = (
            AnchorEdges(np.zeros(1, dtype=int), poses[:1].copy(), ANCHOR_INFORMATION[None]),
            kind(steps, count + which, measured, self.information[rows]),
            RelativePoseEdges(m.first[driven], m.second[driven], m.measured[driven], m.information[driven]),
        )
        numbers = np.arange(count)
        return Graph(
            np.concatenate([poses, landmarks]), families=families, steps=numbers, trajectory=poses, pose_ids=numbers,
            landmark_ids=ids, landmark_dimension=measured.shape[1],
        ), rows  # fmt: skip


#: the most moments of a drive
MOST_MOMENTS = 150


@dataclass(frozen=True, eq=False)
class Problem:
    """A log whose sightings are to be associated, and all that decides how: its backbone, what the sensor sees, densities,
    classes and options."""

    log: Log
    backbone: Backbone
    field: Field
    densities: Densities
    classes: Classes
    options: AssociationOptions

    @classmethod
    def of(cls, log: Log, motion: MotionModel, sensor: SensorModel, options: AssociationOptions) -> Problem:
        """The problem of a log, with the densities before its landmarks are known."""
        field = Field.of(log, sensor)
        densities, classes = Densities.of(log, field, options.clutter), Classes.of(log, options.confusion)
        return cls(log, Backbone.of(log, sensor, motion), field, densities, classes, options)

    @property
    def moment(self) -> int:
        """A moment [steps]: within it odometry determines well enough where landmarks that were just seen must be."""
        return max(self.options.window, -(-self.log.num_poses // MOST_MOMENTS))


@dataclass(frozen=True, eq=False)
class MapSolution:
    """A graph with landmark nodes and motion edges at its minimum.

    Attributes:
        graph: whose landmark ids are the labels.
        state: (n, 3).
        rows: (m,) the sightings with a label, and ``which`` (m,) the place of their landmark in `landmarks`.
    """

    graph: Graph
    state: Array
    rows: np.ndarray
    which: np.ndarray

    @classmethod
    def of(cls, backbone: Backbone, labels: np.ndarray, poses: Array) -> MapSolution:
        """The graph of `Backbone.graph`, solved from poses (t, 3)."""
        graph, rows = backbone.graph(labels, poses)
        run = Run(graph.initial.copy(), tolerance=1e-3 * len(poses) ** 0.5, max_iterations=STEPS)
        gauss_newton(graph, run)
        return cls(graph, run.state, rows, np.searchsorted(graph.landmark_ids, labels[rows]))

    @property
    def poses(self) -> Array:
        """(t, 3)."""
        return self.state[: len(self.graph.steps)]

    def seen(self, steps: np.ndarray) -> list[np.ndarray]:
        """The steps, sorted, in which each landmark was seen; ``steps`` (M,) are those of all sightings."""
        order = np.argsort(self.which, kind="stable")
        return np.split(steps[self.rows[order]], np.cumsum(np.bincount(self.which))[:-1])

    @property
    def labels(self) -> np.ndarray:
        """The label (L,) of each landmark."""
        return self.graph.landmark_ids

    @property
    def landmarks(self) -> Array:
        """(L, d)."""
        return self.state[len(self.graph.steps) :, : self.graph.landmark_dimension]

    @cached_property
    def cost(self) -> float:
        """J."""
        return self.graph.cost(self.state)

    @cached_property
    def log_determinant(self) -> float:
        """log det Omega."""
        return self.graph.information(self.state).factorize().log_determinant

    @cached_property
    def covariances(self) -> Array:
        """The marginal covariance (L, d, d) of each landmark."""
        d = self.graph.landmark_dimension
        return Uncertainty(self.graph, self.state).diagonal[len(self.graph.steps) :, :d, :d]

    @cached_property
    def own_covariances(self) -> Array:
        """The covariance (L, d, d) that the sightings of each landmark leave where the poses are known."""
        d = self.graph.landmark_dimension
        system = self.graph.information(self.state)
        return np.linalg.inv(system.values[system.diagonal_slots[len(self.graph.steps) :]][:, :d, :d])

    @cached_property
    def slack(self) -> Array:
        """A covariance (L, d, d) for errors that sightings have in common: their mean one, over `INDEPENDENT`."""
        return self.own_covariances * (np.bincount(self.which)[:, None, None] / INDEPENDENT)

    def slack_of(self, a: np.ndarray, b: np.ndarray) -> Array:
        """The slack (k, d, d) in the difference of landmarks a (k,) and b (k,)."""
        return self.slack[a] + self.slack[b]

    def joint_covariance(self, chosen: np.ndarray) -> Array:
        """The covariance (k, d, k, d) of some landmarks together, given by their places (k,) in ``landmarks``.

        They are eliminated last, so that the factor of the others leaves their information as one dense block.
        """
        system = self.graph.information(self.state)
        nodes = len(self.graph.steps) + chosen
        order = system.symbolic.order
        last = np.isin(order, nodes)
        ordering = np.concatenate([order[~last], order[last]])
        symbolic = analyze(system.indptr, system.indices, ordering=ordering, points=system.structure.points)
        factor = symbolic.factorize(system.values.copy())
        d = self.graph.landmark_dimension
        return factor.joint_covariance(nodes).reshape(len(nodes), 3, len(nodes), 3)[:, :d, :, :d]
