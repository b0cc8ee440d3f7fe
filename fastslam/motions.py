"""A log as a particle filter takes it, and trajectories drawn from all that a run of the filter has computed.

Motions are turned into those of a sensor that sits at an offset to the robot; sightings are linearised in the axes of the
robot. Absolute positions weigh particles, if they have the frame of the first poses; a start in a map is found there.

Backward simulation. The histories of the particles at the end of a run have few ancestors in common steps: resampling has
removed the others. Backward simulation draws the steps one after the other, from the last to the first, among all particles
that the filter ever had. The motions are relative to the pose before: what is drawn is where the rigid rest of the trajectory
is attached, by the landmarks that both sides have seen. A density of the motion is never needed, and a precise motion does
not tie the rest to its own ancestor. The engine draws; equations and sources are in
``engine/include/vmslam/gibbs/backward.hpp``.

Of more than `CANDIDATES` particles, that many are considered at each step: the ancestor in the filter, and draws by weight.
This is a step of a conditional SMC, which leaves the distribution unchanged.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from graphslam import AbsolutePositions, Graph, GraphError, LandmarkMap, Log, OptionError, solve
from graphslam.edges import AnchorEdges
from graphslam.engine import available_threads, engine
from graphslam.errors.checks import finite_numbers
from graphslam.maps.localization import SURE, Fix, first_fix
from graphslam.models import MotionModel, SensorModel
from graphslam.se2 import Array, between, difference, mounted, perpendicular, transform, wrap

from .options import GIGABYTE, available_memory, smoothing_memory
from .particles import Samples


def sensor_motions(sensor: SensorModel, motions: Array, covariances: Array) -> tuple[Array, Array]:
    """Return the motions (T, 3) and covariances (T, 3, 3) of the sensor, given those of the robot that carries it."""
    if sensor.centred:
        return motions, covariances
    end = sensor.mount(motions)
    lever = end[:, :2] - motions[:, :2]
    J = np.broadcast_to(np.eye(3), (len(motions), 3, 3)).copy()
    J[:, :2, 2] = perpendicular(lever)
    return end - np.array([*sensor.offset, 0.0]), J @ covariances @ np.swapaxes(J, 1, 2)


def robot_poses(sensor: SensorModel, poses: Array) -> Array:
    """Return the poses (..., 3) of the robot, given those of the sensor that it carries."""
    ahead, left = sensor.offset
    return mounted(poses, (-ahead, -left))


@dataclass(frozen=True, eq=False, kw_only=True)
class Sightings:
    """Sightings of the sensor with their linearisation.

    Attributes:
        first: (T + 2,), the sightings of step t are first[t] to first[t + 1]; ``marks``: (K,) their landmarks, 0 to J - 1.
        z, q: (K, 3) the sightings and their variances; without psi the third column is 0 and 1.
        y, C: (K, 3), (K, 6): the sightings as relative places q = (R(theta)' (m - p), m_h - theta) with Gaussian noise.
        ids: (J,) of the landmarks; ``columns``: 2 or 3.
    """

    first: np.ndarray
    marks: np.ndarray
    z: Array
    q: Array
    y: Array
    C: Array
    ids: np.ndarray
    columns: int

    @classmethod
    def taken(
        cls, poses: int, steps: np.ndarray, landmarks: np.ndarray, sightings: Array, sensor: SensorModel, **more: Array
    ) -> Self:
        """Return sightings (K, 2 or 3) of ``landmarks`` (K,) from ``poses`` poses, linearised where they were measured.

        Args:
            steps: (K,), ascending; ``more``: the fields of a class derived from this one.
        """
        ids, marks = np.unique(landmarks, return_inverse=True)
        n, size = sightings.shape[1], len(steps)
        z, q = np.zeros((size, 3)), np.ones((size, 3))
        z[:, :n] = sightings
        q[:, :n] = np.diagonal(sensor.Q(sightings), axis1=-2, axis2=-1)
        taken = cls(
            first=np.searchsorted(steps, np.arange(poses + 1)), marks=marks.astype(np.int64).ravel(), z=z, q=q, y=z,
            C=np.zeros((size, 6)), ids=ids, columns=n, **more,
        )  # fmt: skip
        return taken._linearised(z[:, 0], z[:, 1], wrap(z[:, 1] - z[:, 2]))

    @property
    def steps(self) -> np.ndarray:
        """The step (K,) of each sighting."""
        return np.repeat(np.arange(len(self.first) - 1), np.diff(self.first))

    def _linearised(self, r: Array, bearing: Array, heading: Array) -> Self:
        """Linearise h(q) = (|q|, atan2 q, atan2 q - q_h) at relative places, given by range, bearing and heading.

        y = q + R (z - h(q)) and C = R Q R', with R = dh^-1/dz = [[c, -r s, 0], [s, r c, 0], [0, 1, -1]].
        """
        c, s, zero = np.cos(bearing), np.sin(bearing), np.zeros_like(r)
        third = 1.0 if self.columns == 3 else 0.0
        R = np.array([[c, -r * s, zero], [s, r * c, zero], [zero, zero + third, zero - (1.0 if third else -1.0)]])
        R = np.moveaxis(R, -1, 0)
        residual = self.z - np.stack([r, bearing, third * (bearing - heading)], axis=-1)
        residual[:, 1:] = wrap(residual[:, 1:])
        y = np.stack([r * c, r * s, third * heading], axis=-1) + (R @ residual[..., None])[..., 0]
        y[:, 2] = wrap(y[:, 2])
        C = R @ (self.q[:, :, None] * np.swapaxes(R, 1, 2))
        rows, columns = np.tril_indices(3)
        return replace(self, y=y, C=np.ascontiguousarray(C[:, rows, columns]))

    def in_engine(
        self, motions: Array, information: Array, weights: Array, *, exact: bool = False, degrees: float = 0.0
    ) -> Any:
        """Return the engine's problem with motions (T, 3) of information (T, 6).

        Args:
            weights: (K, 6) the information of the linearised sightings.
            exact, degrees: see `GibbsOptions`; 0 degrees of freedom stand for a Gaussian.
        """
        indices = (np.ascontiguousarray(numbers, dtype=np.int64) for numbers in (self.first, self.marks))
        sightings = np.hstack([self.y, self.C, weights, self.z, self.q])
        moved = np.hstack([motions, information])
        return engine.GibbsProblem(moved, *indices, sightings, len(self.ids), self.columns, exact, degrees)

    def linearised_at(self, trajectories: Array, maps: Array) -> Self:
        """Return the same problem, linearised at the mean relative places of samples (S, T + 1, 3) and (S, J, 3)."""
        steps = self.steps
        total, heading = np.zeros((len(steps), 2)), np.zeros(len(steps))
        for x, m in zip(trajectories, maps, strict=True):
            mark = between(x[steps], m[self.marks])
            total += mark[:, :2]
            heading += wrap(mark[:, 2] - self.y[:, 2])
        place = total / len(trajectories)
        bearing = np.arctan2(place[:, 1], place[:, 0])
        heading = wrap(self.y[:, 2] + heading / len(trajectories))
        return self._linearised(np.maximum(np.hypot(*place.T), 1e-3), bearing, heading)


@dataclass(frozen=True, eq=False, kw_only=True)
class Problem(Sightings):
    """The sightings of a log with its motions.

    Attributes:
        motions, information: (T, 3) and the upper triangles (T, 6) of the inverse covariances, of the sensor.
    """

    motions: Array
    information: Array

    @classmethod
    def of(cls, log: Log, motion: MotionModel, sensor: SensorModel) -> Problem:
        """Return a log's problem, the sightings linearised where they were measured."""
        motions, covariances = sensor_motions(sensor, *log.motions(motion))
        rows, columns = np.tril_indices(3)
        return cls.taken(
            log.num_poses, log.steps, log.landmarks, log.sightings, sensor, motions=np.ascontiguousarray(motions),
            information=np.linalg.inv(covariances)[:, rows, columns],
        )  # fmt: skip

    def motions_of(self, trajectories: Array) -> Array:
        """Return the mean motions (T, 3) of sampled trajectories (S, T + 1, 3)."""
        return self.motions + difference(between(trajectories[:, :-1], trajectories[:, 1:]), self.motions).mean(axis=0)


#: the most particles considered at each step
CANDIDATES = 200


class Record:
    """The sightings of a run whose particles the engine keeps."""

    def __init__(self) -> None:
        self._seen: list[tuple[int, int, Array]] = []

    def observe(self, step: int, ids: np.ndarray, sightings: Array) -> None:
        """Add the sightings of a step."""
        self._seen += ((step, id, z) for id, z in zip(ids.tolist(), sightings, strict=True))

    def smooth(
        self, particles: Any, count: int, rng: np.random.Generator, sensor: SensorModel, trajectory: Array, marks: Array,
        threads: int | None,
    ) -> Samples:  # fmt: skip
        """Return ``count`` trajectories drawn backwards, each with a map drawn given the trajectory.

        Args:
            particles: the engine's filter, with the particles of all steps.
            trajectory, marks: (T + 1, 3) poses of the sensor and (J, 2 or 3) landmarks at which sightings are linearised.

        Raises:
            OptionError: the record needs more memory than there is.
        """
        T, N = len(trajectory) - 1, len(particles.poses)
        steps, ids, sightings = map(np.array, zip(*self._seen, strict=True))
        seen = Sightings.taken(T + 1, steps, ids, sightings, sensor)
        J = len(seen.ids)
        at = np.zeros((J, 3))
        at[:, : marks.shape[1]] = marks
        seen = seen.linearised_at(trajectory[None], at[None])
        # an event is a step at which a landmark was seen
        events = len(np.unique(seen.steps * J + seen.marks))
        need, there = smoothing_memory(N, T + 1, J, events, count), available_memory()
        if there is not None and need > there:
            raise OptionError(
                f"smoothing {N:,} particles over {T} steps by {count:,} trajectories needs {need / GIGABYTE:.3g} GB of "
                f"memory, and {there / GIGABYTE:.2g} GB are available; take fewer particles or trajectories"
            )
        problem = seen.in_engine(np.zeros((T, 3)), np.zeros((T, 6)), seen.C)
        sampler = engine.BackwardSampler(particles, problem, CANDIDATES)
        trajectories, maps = np.empty((count, T + 1, 3)), np.empty((count, J, 3))

        def draw(s: int, key: int) -> None:
            # of its own, so that the result does not depend on the threads
            trajectories[s], maps[s] = sampler.draw(key)

        with ThreadPoolExecutor(threads or available_threads()) as pool:
            list(pool.map(draw, range(count), rng.integers(2**63, size=count).tolist()))
        return Samples(robot_poses(sensor, trajectories)[None], maps[None, ..., : seen.columns], seen.ids)


#: the standard deviations of particles around a first fix, over those of the fix
SPREAD = 2.0
#: from this distance on, in standard deviations, a start is in another frame than the positions; far, because covariances of
#: pairs of sightings, and those of odometry with other noise than its model, are too small
OTHER_FRAME = 10.0


def first_poses(start: ArrayLike | Fix | None, log: Log | None, particles: int, rng: np.random.Generator) -> Array:
    """The first poses of the robot, (N, 3): where `ParticleFilter` has its ``start``, one for all or one per particle."""
    if start is None:
        start = np.zeros(3) if log is None else log.initial_poses[0]
    elif isinstance(start, Fix):
        start = rng.multivariate_normal(start.pose, SPREAD**2 * start.covariance, particles)
    poses = np.empty((particles, 3))
    poses[:] = finite_numbers("start", start, (3,), (particles, 3))
    poses[:, 2] = wrap(poses[:, 2])
    return poses


def in_map(
    start: ArrayLike | Fix | None, log: Log | None, known: LandmarkMap | None, motion: MotionModel, sensor: SensorModel
) -> ArrayLike | Fix | None:
    """A start that is given; else the first fix in a map where the log's own first pose is in another frame, or None.

    As with positions (`in_frame`), the two are compared by the Mahalanobis distance. With positions, `in_frame` finds the
    start. Without a fix, or with one that is not sure, the filter begins at the log's own first pose.
    """
    if start is not None or log is None or known is None or log.positions is not None or not len(log.steps):
        return start
    try:
        # the filter itself refuses a log with impossible numbers
        with np.errstate(all="ignore"):
            fix = first_fix(log, known, motion=motion, sensor=sensor)
    except (GraphError, np.linalg.LinAlgError):
        return None
    way = log.initial_poses[0] - fix.pose
    way[2] = wrap(way[2])
    far = way @ np.linalg.solve(fix.covariance, way) > OTHER_FRAME**2
    return fix if far and fix.odds > SURE else None


def log_likelihoods(positions: AbsolutePositions, poses: Array) -> Array:
    """The sums over positions of log N(e; 0, C), e = p + R(theta) a - (x, y), for poses (N, 3); (N,).

    Where the heading is measured, theta - theta_z is the third number of e.
    """
    total = np.zeros(len(poses))
    for z, C, lever, oriented in zip(positions.places, positions.covariances, positions.levers, positions.oriented):
        d = 3 if oriented else 2
        e = np.column_stack([transform(poses, lever) - z[:2], wrap(poses[:, 2] - z[2])])[:, :d]
        root = np.linalg.cholesky(C[:d, :d])
        # einsum adds in one order, whatever the number of threads
        whitened = np.einsum("ij,nj->ni", np.linalg.inv(root), e)
        total -= 0.5 * np.sum(whitened**2, axis=1) + np.log(np.diag(root)).sum() + d / 2 * np.log(2 * np.pi)
    return total


def in_frame(
    poses: Array, log: Log, motion: MotionModel, sensor: SensorModel, rng: np.random.Generator, given: bool
) -> Array:
    """First poses (N, 3) in the frame of the positions of a log; without a start that was given they are drawn there.

    The graph of the log puts the first pose at x with covariance P; under Cauchy's kernel one wrong position counts little.
    A start m is compared by the Mahalanobis distance (m - x)' (P + C)^-1 (m - x), C the covariance of the poses.

    Raises:
        OptionError: a start that was given contradicts the positions.
    """
    assert log.positions is not None
    if not len(log.positions.steps):
        return poses
    used = log if log.identified else log.with_sightings(np.zeros(len(log.steps), dtype=bool))
    used = used.replace(partial_sightings=None, relations=None)
    graph = Graph.from_log(used, motion=motion, sensor=sensor, kernel="cauchy")
    solution = solve(graph)
    x, P = solution.poses[0], solution.covariance(poses=[0])[0]
    if not given:
        drawn = rng.multivariate_normal(x, SPREAD**2 * P, len(poses))
        return np.column_stack([drawn[:, :2], wrap(drawn[:, 2])])
    mean = np.array([*poses[:, :2].mean(axis=0), np.angle(np.exp(1j * poses[:, 2]).mean())])
    e = np.column_stack([poses[:, :2] - mean[:2], wrap(poses[:, 2] - mean[2])])
    off = np.array([*(mean - x)[:2], wrap(mean[2] - x[2])])
    distance = np.sqrt(off @ np.linalg.solve(P + e.T @ e / len(e), off))
    if distance <= OTHER_FRAME:
        return poses
    # the positions may leave the direction open; then the anchor holds that of the odometry, which a start may differ from
    if any(isinstance(family, AnchorEdges) for family in graph.families):
        return poses

    def place(pose: Array) -> str:
        return f"({pose[0]:.2f}, {pose[1]:.2f}) m, {np.degrees(pose[2]):.0f} deg"

    raise OptionError(
        f"the start {place(mean)} is {distance:.0f} standard deviations from {place(x)}, where the positions of {log.name} "
        "put the first pose: give a start in their frame, or none, or leave the positions out by log.replace(positions=None)"
    )
