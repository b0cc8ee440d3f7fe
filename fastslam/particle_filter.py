"""What Monte Carlo localisation and FastSLAM have in common: particles that move, are weighed and resampled.

Sources: Ueda, *LNPR*, chapters 5 and 8; Thrun, Burgard and Fox, *Probabilistic Robotics*, sections 4.3 and 8.3.
"""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from graphslam.errors import LogError, OptionError
from graphslam.log import Log
from graphslam.models import MotionModel, SensorModel
from graphslam.se2 import Array, transform, wrap

from . import motion_kernels
from .arguments import instance, real, reals, whole
from .crew import Crew, Job
from .genealogy import Genealogy
from .noise import draw_key
from .resampling import resampling_scheme
from .state import FilterResult, LandmarkEstimate, ParticleState
from .weight_kernels import multiply, normalize

#: a turn in one step beyond this [rad] is a mistake, and the compiled sine is not made for it
MOST_TURN = 1e5
#: a way in one step beyond this [m], 25 times round the Earth, is a mistake
MOST_WAY = 1e9


class VanishedWeightsWarning(RuntimeWarning):
    """The sightings of a step are impossible for every particle; the step's weights were taken back."""


class ParticleFilter(ABC):
    """N weighted particles on a log, or fed by hand with `move` and `observe`.

    Iterating goes over the rest of the log and yields a `ParticleState` per step; `run` goes to the end at once.

    Motion: each particle draws a control u' ~ N(u, M) and moves to f(x, u') + e, e ~ N(0, epsilon I). The lectures have
    no e, but the graph's motion edges have covariance A M A' + epsilon I, and with it both ask for the same posterior.

    A motion of several controls, and every motion of a robot whose sensor sits at an offset, is drawn at once: x_{t-1} is
    moved, in its own axes, by a draw of the Gaussian of the whole motion, `MotionModel.accumulate`. Drawing control by
    control would cost as many draws as there are controls, for a difference of second order in the noise between two
    sightings, and FastSLAM 2.0 and the graph take the Gaussian anyhow. With an offset the particles are poses of the
    sensor, from which sightings are seen; all that is handed out is poses of the robot.

    Weights: logarithms, with the determinant of the likelihood's covariance; Q is taken at the measured range, as in
    the graph's edges. Where a step's sightings are impossible (likelihood 0) for some particles, those have weight
    zero; where they are for all, a `VanishedWeightsWarning` is issued, the weights from before the step stay, nothing
    is resampled, and the filter goes on. In log space that takes more than a bad guess: every particle exactly on the
    landmark, or numbers beyond the range of floating point.

    Random numbers come from one generator in this order: for each motion `noise.standard_normals`, five per particle
    (nu, omega, x, y, theta; the first three for a Gaussian drawn at once), for each resampling what the scheme draws.
    The same seed gives the same result, bit for bit, whatever the number of threads.
    """

    def __init__(
        self,
        log: Log | None = None,
        *,
        particles: int = 1000,
        seed: int | np.random.Generator = 0,
        motion: MotionModel | None = None,
        sensor: SensorModel | None = None,
        resampling: str = "systematic",
        ess_threshold: float = 0.5,
        start: ArrayLike | None = None,
        threads: int | None = None,
    ) -> None:
        for name, value, model in (("log", log, Log), ("motion", motion, MotionModel), ("sensor", sensor, SensorModel)):
            instance(name, value, model)
        self.particles = whole("particles", particles)
        if self.particles < 1:
            raise OptionError(f"particles must be at least 1, not {particles}")
        between = "between 0 (never resample) and 1 (always)"
        ess_threshold = real("ess_threshold", ess_threshold, f"a number {between}")
        if not 0 <= ess_threshold <= 1:
            raise OptionError(f"ess_threshold must lie {between}, not {ess_threshold!r}")
        if log is not None and log.controls is None:
            raise LogError(
                f"{log.name} has no controls, and a particle filter moves its particles by them: use graph SLAM"
            )
        self.log = log
        known = (None, None) if log is None else (log.motion, log.sensor)
        self.motion, self.sensor = motion or known[0] or MotionModel(), sensor or known[1] or SensorModel()
        self._scheme, self._ess_threshold = resampling_scheme(resampling), ess_threshold
        try:
            self._rng = np.random.default_rng(seed)
        except (TypeError, ValueError):
            raise OptionError(
                f"seed must be a whole number, not below 0, or a numpy.random.Generator, not {seed!r}"
            ) from None
        self._crew = Crew(self.particles, threads)

        if start is None:
            start = np.zeros(3) if log is None else log.initial_poses[0]
        expected = f"a finite pose (3,) or one per particle ({self.particles}, 3)"
        pose = reals("start", start, expected)
        if pose.shape not in ((3,), (self.particles, 3)) or not np.all(np.isfinite(pose)):
            raise OptionError(f"start must be {expected}, not {start!r}")
        poses = np.empty((3, self.particles))
        mounted = self.sensor.mount(pose)
        poses[:] = mounted[:, None] if pose.ndim == 1 else mounted.T
        poses[2] = wrap(poses[2])

        self._needs_ids = True
        self._step, self._version, self._next = 0, 0, 0
        self._poses = _read_only(poses)
        self._uniform = _read_only(np.full(self.particles, -np.log(self.particles)))
        self._log_weights = self._uniform
        self._best, self._resampled = 0, False
        self._motion: Motion | Leap | None = None
        # whether the sensor has looked at this step, were it at nothing
        self._looked = False
        self._genealogy = Genealogy(self.particles)
        self._genealogy.record(self._poses)
        self._ess_history, self._resampled_history = [float(self.particles)], [False]

    # -- by hand -----------------------------------------------------------------------------------------------------

    def move(self, control: ArrayLike, dt: float) -> None:
        """Go to the next step: every particle draws its own motion under the control (nu, omega) [m/s, rad/s].

        dt = 0 [s] is a step in which nothing moves: no noise is added, although the random numbers are drawn.

        Raises:
            OptionError: the control is not two finite numbers, dt is negative or not finite, or the robot would, by the
                control or a standard deviation of its noise, go farther than 1e9 m or turn by more than 1e5 rad.
        """
        u = reals("control", control, "two finite numbers (nu, omega)")
        dt = real("dt", dt, "a finite number of seconds, not below 0")
        if u.shape != (2,) or not np.all(np.isfinite(u)):
            raise OptionError(f"control must be two finite numbers (nu, omega), not {control!r}")
        if not 0 <= dt < np.inf:
            raise OptionError(f"dt must be a finite number of seconds, not below 0, not {dt!r}")
        with np.errstate(over="ignore"):
            std = np.sqrt(np.diag(self.motion.M(u, dt))) if dt > 0 else np.zeros(2)
        _check_motion(u, std, dt)
        if self.sensor.centred:
            self._move(u, std, float(dt))
        elif dt > 0:
            motions, covariances = self.motion.accumulate(u[None], [dt], np.array([0, 1]))
            self._leap(*self._carried(motions, covariances))
        else:
            self._move(np.zeros(2), np.zeros(2), 0.0)

    def observe(self, ids: Sequence[int] | np.ndarray | None, sightings: ArrayLike) -> None:
        """Weigh the particles by what was seen at this step, (k,) ids and (k, 2 or 3) sightings, and resample if due.

        The sightings are folded in one after the other; there may be any number of them, and none changes nothing,
        except that with unknown association provisional landmarks in view are then missed. Several calls between two
        moves are one look around. Only where the association is unknown may ids be None.

        Raises:
            OptionError: a sighting is not finite or its range not above zero, the shapes do not fit, on a known map
                an id is not in it, or, with maps to make, a range is above 1e50 m or a standard deviation of its noise
                not between 1e-50 and 1e50: covariances would leave the range of floating point.
        """
        z = reals("sightings", sightings, "numbers of shape (k, 2) or (k, 3)")
        if ids is None and not self._needs_ids:
            ids = np.zeros(len(z), dtype=np.int64)
        if ids is None:
            raise OptionError("ids may be None only with association='maximum-likelihood': tell which landmark each is")
        try:
            ids = np.asarray(ids)
        except ValueError:
            raise OptionError(f"ids must be whole numbers (k,), not {ids!r}") from None
        if ids.size == 0 and z.size == 0:
            self._looked = True
            return
        if z.ndim != 2 or z.shape[1] not in (2, 3) or ids.shape != (len(z),):
            raise OptionError(
                f"observe takes whole numbers (k,) and sightings (k, 2) or (k, 3), not shapes {ids.shape} and {z.shape}"
            )
        if ids.dtype.kind not in "iu":
            raise OptionError(f"the ids of landmarks must be whole numbers, not {ids.tolist()!r}")
        if not np.all(np.isfinite(z)) or np.any(z[:, 0] <= 0):
            raise OptionError("sightings must be finite and their ranges above zero")
        z[:, 1:] = wrap(z[:, 1:])
        self._check_sightings(ids, z.shape[1])
        self._observe(ids, z)

    @property
    def state(self) -> ParticleState:
        """The particles as they are now."""
        version = self._version

        def fresh() -> None:
            if self._version != version:
                raise OptionError("the filter has gone on: ask a state for maps before the next move or observe")

        def one_map(particle: int, provisional: bool) -> dict[int, LandmarkEstimate]:
            fresh()
            return self._map(_particle(particle, self.particles), provisional)

        def mixture(weights: Array, provisional: bool) -> dict[int, LandmarkEstimate]:
            fresh()
            return self._mixture(weights, provisional)

        return ParticleState(
            self._step,
            self._of_robot(self._poses.T),
            self._log_weights,
            self._ess_history[-1],
            self._resampled,
            self._best,
            one_map,
            mixture,
        )

    def trajectory(self, particle: int | None = None) -> Array:
        """The history of one particle, by default the best, (steps so far + 1, 3).

        Raises:
            OptionError: there is no such particle.
        """
        history = self._genealogy.trajectory(self._best if particle is None else _particle(particle, self.particles))
        return self._of_robot(history)

    # -- over a log --------------------------------------------------------------------------------------------------

    def __iter__(self) -> Iterator[ParticleState]:
        """Go over the rest of the log; a second loop goes on where the first stopped.

        Raises:
            OptionError: the filter has no log, or a motion is absurd, as in `move`.
        """
        log = self.log
        if log is None:
            raise OptionError("this filter has no log to go over: give it one, or feed it with move and observe")
        if log.controls is None or log.dt is None:  # __init__ has refused such a log
            raise LogError(f"{log.name} has no controls")
        at_once = log.composite or not self.sensor.centred
        # what overflows is refused at its step
        with np.errstate(over="ignore", invalid="ignore"):
            if at_once:
                motions, covariances = self._carried(*log.motions(self.motion))
            else:
                control_std = np.sqrt(np.diagonal(self.motion.M(log.controls, log.dt), axis1=-2, axis2=-1))
        first = np.searchsorted(log.steps, np.arange(log.num_poses + 1))
        for t in range(self._next, log.num_poses):
            if t > 0 and at_once:
                self._leap(motions[t - 1 : t], covariances[t - 1 : t])
            elif t > 0:
                _check_motion(log.controls[t - 1], control_std[t - 1], log.dt[t - 1])
                self._move(log.controls[t - 1], control_std[t - 1], log.dt[t - 1])
            if first[t + 1] > first[t]:
                self._observe(log.landmarks[first[t] : first[t + 1]], log.sightings[first[t] : first[t + 1]])
            self._next = t + 1
            yield self.state

    def run(self) -> FilterResult:
        """Go over the rest of the log and return the estimate.

        Raises:
            OptionError: the filter has no log.
        """
        for _ in self:
            pass
        return self.result()

    def result(self) -> FilterResult:
        """The estimate so far."""
        mean_poses, ancestors = self._genealogy.summary(np.exp(self._log_weights))
        best_map = self._map(self._best, provisional=False)
        return FilterResult(
            poses=self.trajectory(),
            mean_poses=self._of_robot(mean_poses),
            landmarks={j: estimate.mean for j, estimate in best_map.items()},
            landmark_covariances={j: estimate.covariance for j, estimate in best_map.items()},
            log_weights=self._log_weights,
            ess=np.array(self._ess_history),
            resampled=np.array(self._resampled_history),
            ancestors=ancestors,
        )

    # -- the filter --------------------------------------------------------------------------------------------------

    @abstractmethod
    def _check_sightings(self, ids: np.ndarray, columns: int) -> None:
        """Raise `OptionError` where sightings of these ids with so many columns cannot be used."""

    @abstractmethod
    def _weigh(self, ids: np.ndarray, sightings: Array, q: Array) -> Array | None:
        """Fold sightings (k, n) with variances q (k, n) in; the log likelihoods (N,), None if none was weighed."""

    @abstractmethod
    def _map(self, particle: int, provisional: bool) -> dict[int, LandmarkEstimate]: ...

    @abstractmethod
    def _mixture(self, weights: Array, provisional: bool) -> dict[int, LandmarkEstimate]: ...

    def _move(self, control: Array, control_std: Array, dt: float) -> None:
        moved = np.empty_like(self._poses)
        motion = Motion(
            self._poses, draw_key(self._rng), control[0], control[1], control_std[0], control_std[1], dt,
            self.motion.epsilon**0.5 if dt > 0 else 0.0,
        )  # fmt: skip
        self._go((motion_kernels.move, (*motion, moved)), moved, motion if dt > 0 else None)

    def _leap(self, motions: Array, covariances: Array) -> None:
        """Move every particle by the Gaussian (1, 3), (1, 3, 3) of a whole motion of the sensor."""
        reach = np.abs(motions[0]) + np.sqrt(np.diagonal(covariances[0]))
        if not np.all(reach <= [MOST_WAY, MOST_WAY, MOST_TURN]):
            raise OptionError(
                f"step {self._step + 1}: its controls and their noise move the robot by up to {reach[:2].max():g} m and "
                f"turn it by up to {reach[2]:g} rad, and more than {MOST_WAY:g} m or {MOST_TURN:g} rad is a mistake"
            )
        moved = np.empty_like(self._poses)
        root = tuple(np.linalg.cholesky(covariances[0])[np.tril_indices(3)].tolist())
        motion = Leap(self._poses, draw_key(self._rng), tuple(motions[0].tolist()), covariances[0])
        self._go((motion_kernels.leap, (motion.poses, motion.key, motion.mean, root, moved)), moved, motion)

    def _go(self, job: Job, moved: Array, motion: Motion | Leap | None) -> None:
        if self._looked:
            self._end_step()
            self._looked = False
        self._crew.run_all([job, self._genealogy.recording(moved)])
        self._motion = motion
        self._poses = _read_only(moved)
        self._step += 1
        self._version += 1
        self._resampled = False
        self._ess_history.append(self._ess_history[-1])
        self._resampled_history.append(False)

    def _carried(self, motions: Array, covariances: Array) -> tuple[Array, Array]:
        """Motions (T, 3) of the robot and their covariances, as those of the sensor that it carries."""
        if self.sensor.centred:
            return motions, covariances
        end = self.sensor.mount(motions)
        begin = np.array([*self.sensor.offset, 0.0])
        lever = end[:, :2] - motions[:, :2]
        J = np.broadcast_to(np.eye(3), (len(motions), 3, 3)).copy()
        J[:, 0, 2], J[:, 1, 2] = -lever[:, 1], lever[:, 0]
        return end - begin, J @ covariances @ np.swapaxes(J, 1, 2)

    def _of_robot(self, poses: Array) -> Array:
        """Poses (..., 3) of the robot that carries the sensor at these poses."""
        if self.sensor.centred:
            return poses
        ahead, left = self.sensor.offset
        position = transform(poses, np.array([-ahead, -left]))
        return np.concatenate([position, poses[..., 2:]], axis=-1)

    def _set_poses(self, poses: Array) -> None:
        """Exchange the poses (3, N) of this step."""
        self._poses = _read_only(poses)
        self._genealogy.amend(poses)

    def _end_step(self) -> None:  # noqa: B027
        """What has to wait until a step that was looked at is over."""

    def _observe(self, ids: np.ndarray, sightings: Array) -> None:
        with np.errstate(over="ignore"):
            q = np.diagonal(self.sensor.Q(sightings), axis1=-2, axis2=-1).copy()
        # a copy: kernels are compiled once more for the read-only arrays of a log
        log_likelihood = self._weigh(ids, sightings.copy(), q)
        self._version, self._looked = self._version + 1, True
        # from here on the poses depend on the sightings: later ones of this step must not bend the motion again
        self._motion = None
        if log_likelihood is None:
            return
        log_weights = log_likelihood
        highest = multiply(self._crew, self._log_weights, log_weights)
        if highest == -np.inf:
            warnings.warn(
                f"step {self._step}: its sightings are impossible for all {self.particles} particles; "
                "the weights from before the step stay",
                VanishedWeightsWarning,
                stacklevel=3,
            )
            return
        weights, total, squares = normalize(self._crew, log_weights, highest)
        ess = min(total * total / squares, float(self.particles))
        self._log_weights, self._best = _read_only(log_weights), int(np.argmax(log_weights))
        self._ess_history[-1] = ess
        if ess <= self._ess_threshold * self.particles:
            self._resample(weights)

    def _resample(self, weights: Array) -> None:
        ancestors = self._scheme(weights, self._rng)
        copy = int(np.searchsorted(ancestors, self._best))
        if copy == self.particles or ancestors[copy] != self._best:
            # only where copies are drawn at random can the heaviest particle be left without one
            copy = int(np.argmax(self._log_weights[ancestors]))
        self._best = copy
        self._genealogy.branch(ancestors)
        survivors = np.empty_like(self._poses)
        self._crew.run_light(motion_kernels.pick, self._poses, ancestors, survivors)
        self._poses = _read_only(survivors)
        self._log_weights = self._uniform
        self._resampled = True
        self._resampled_history[-1] = True


class Motion(NamedTuple):
    """The motion that led to this step: the arguments of the compiled motion."""

    poses: Array
    key: np.uint64
    nu: float
    omega: float
    nu_std: float
    omega_std: float
    dt: float
    pose_std: float


class Leap(NamedTuple):
    """The motion that led to this step, drawn at once: where from, and the Gaussian in the axes of each pose."""

    poses: Array
    key: np.uint64
    mean: tuple[float, ...]
    covariance: Array


def _check_motion(control: Array, std: Array, dt: float) -> None:
    """Raise `OptionError` where a control with this noise is a mistake, or leaves the range of floating point."""
    # as Python's numbers, which overflow to infinity in silence
    way, turn = ((abs(float(u)) + float(s)) * float(dt) for u, s in zip(control, std, strict=True))
    if not way <= MOST_WAY:
        raise OptionError(
            f"nu = {control[0]:g} m/s (noise {std[0]:g}) for {dt:g} s moves the robot by more than {MOST_WAY:g} m"
        )
    if not turn <= MOST_TURN:
        raise OptionError(
            f"omega = {control[1]:g} rad/s (noise {std[1]:g}) for {dt:g} s turns the robot by more than {MOST_TURN:g} rad"
        )


def _particle(particle: int, particles: int) -> int:
    particle = whole("particle", particle)
    if not 0 <= particle < particles:
        raise OptionError(f"there is no particle {particle}: they are numbered 0 to {particles - 1}")
    return particle


def _read_only(array: Array) -> Array:
    array.flags.writeable = False
    return array
