"""`ParticleFilter`, the base of Monte Carlo localisation and FastSLAM: particles move, are weighed and are resampled.

Sources: Ueda, *LNPR*, chapters 5 and 8; Thrun, Burgard and Fox, *Probabilistic Robotics*, sections 4.3 and 8.3.
"""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from dataclasses import fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from graphslam import AbsolutePositions, Log, MotionModel, SensorModel
from graphslam.association import known_noise
from graphslam.engine import available_threads, engine
from graphslam.errors import LogError, OptionError, checks, quoted
from graphslam.graph.build import noise_in_map
from graphslam.log.geometry import with_datum
from graphslam.maps.localization import Fix
from graphslam.se2 import Array, difference

from ..doubts import noted
from ..motions import Record, first_poses, in_frame, in_map, log_likelihoods, robot_poses, sensor_motions
from ..options import (
    FilterOptions,
    check_memory,
    check_motion,
    check_one_drive,
    checked_control,
    checked_motion,
    index,
    measurements,
    one_position,
)
from ..particles import RESAMPLING_SCHEMES, FilterResult, LandmarkEstimate, ParticleState, Samples, draw_key

#: the variance of a number that was not measured: it multiplies all likelihoods by the same factor
NOT_MEASURED = 1e12


class VanishedWeightsWarning(RuntimeWarning):
    """The sightings or positions of a step are impossible for every particle; the weights from before the step were kept."""


class ParticleFilter(ABC):
    """N weighted particles that process a log, or measurements handed in with `move` and `observe`.

    Iterating processes the rest of the log and yields a `ParticleState` per step; `run` processes it and returns the
    estimate.

    Motion: each particle draws a control u' ~ N(u, M) and moves to f(x, u') + e, e ~ N(0, epsilon I). The lectures have
    no e, but the graph's motion edges have covariance A M A' + epsilon I, and with e both estimate the same posterior.

    A motion of several controls, and every motion of a robot that slips or whose sensor sits at an offset, is drawn at
    once: x_{t-1} moves, in its own axes, by a draw of the Gaussian of the whole motion, `MotionModel.accumulate`. Drawing
    each control would cost one draw per control, for a difference of second order in the noise between two sightings, and
    FastSLAM 2.0 and the graph use the Gaussian in any case. With an offset the particles are poses of the sensor; all
    poses that are returned are poses of the robot.

    Weights: logarithms, with the determinant of the likelihood's covariance; Q is taken at the measured range, as in
    the graph's edges. A particle for which the sightings are impossible (likelihood 0) gets weight zero. If they are
    impossible for all particles, a `VanishedWeightsWarning` is issued, the weights from before the step are kept, nothing
    is resampled, and the filter continues. In log space this needs more than a bad initial pose: every particle exactly
    on the landmark, or numbers outside the range of floating point.

    Sightings with one number, a range or a bearing, weigh the particles by its likelihood (`Log.partial_sightings`, or NaN in
    the other column of `observe`).

    Absolute positions multiply the weights by N(p + R(theta) a - (x, y); 0, C), a the lever, before a step is resampled,
    also in FastSLAM 2.0: its proposal does not use them. Without ``start`` the filter begins where they put the first pose.
    With smoothing they are left out with a warning.

    Random numbers come from one generator in this order: for each motion `particles.standard_normals`, five per particle
    (nu, omega, x, y, theta; the first three for a Gaussian drawn at once), for each resampling what the scheme draws.
    The same seed gives exactly the same result for any number of threads.

    Args:
        log: controls and sightings; None for a filter that is used with `move` and `observe`. Where its noise is not
            known and neither ``motion`` nor ``sensor`` is given, `graphslam.association.known_noise` estimates it first;
            without ids that takes two associations.
        options: the options; ``keywords`` replace single options and are the fields of `FilterOptions`.
        motion, sensor: the models; default: those of the log, else the book's.
        start: the known first pose (3,), or one per particle (N, 3); default: where the graph of a log with positions puts
            it, or the log's first initial pose, or the first fix in ``map`` where that is far from it. Of a `Fix`, and of the
            graph's first pose, poses are drawn with `motions.SPREAD` times its standard deviations, because its sightings
            weigh the particles again.
        map: of landmarks that is known; `FastSLAM1` and `MonteCarloLocalization` say how they use it.

    Raises:
        OptionError: an option has an impossible value, the log has sightings without ids and the filter needs them, or the
            particles need more memory than there is, ``start`` contradicts the log's positions, or the log was joined from
            several, which only FastSLAM 2.0 follows.
        LogError: the log has no controls.
    """

    #: whether each particle has a map of its own
    HAS_MAPS = True
    #: the number of coordinates of these landmarks, None before the first sighting
    _coordinates: int | None = None
    #: whether it finds the robot where the next of several joined logs begins, which may be anywhere
    _crosses_logs = False
    #: what to do where a log has no ids and the filter needs them
    _HOW_WITHOUT_IDS = "and the association is known: leave it out, or take maximum-likelihood"

    def __init__(
        self, log: Log | None = None, *, options: FilterOptions | None = None, motion: MotionModel | None = None,
        sensor: SensorModel | None = None, start: ArrayLike | Fix | None = None, map: Any = None, **keywords: Any,
    ) -> None:  # fmt: skip
        for name, value, kind in (("log", log, Log), ("motion", motion, MotionModel), ("sensor", sensor, SensorModel)):
            checks.check_type(kind, **{name: value})
        kind_of_filter = type(self).__name__
        if given := {"landmarks", "landmark_map"}.intersection(keywords):
            message = f"{kind_of_filter} has no option {quoted(min(given))}; a map of landmarks is given as map"
            raise OptionError(message)
        checks.check_known(kind_of_filter, keywords, [field.name for field in fields(FilterOptions)])
        self.options = replace(options or FilterOptions(), **keywords).for_ids(log is None or log.identified)
        self._check_options()
        self.particles = self.options.particles
        if log is not None:
            if log.controls is None:
                raise LogError(f"{log.name} has no controls, which move the particles of a filter: use graph SLAM")
            if not self._crosses_logs:
                check_one_drive(type(self).__name__, log, is_class=True)
            if self._needs_ids and not log.identified:
                raise OptionError(f"{log.name} has sightings without ids, {self._HOW_WITHOUT_IDS}")
            used = {"partial_sightings": self._takes_single_numbers, "positions": self._takes_positions}
            log.warn_of_unused("a particle filter", [name for name, is_used in used.items() if is_used])
            single_numbers = self._takes_single_numbers and log.partial_sightings is not None
            if single_numbers and log.has_orientation and len(log.steps):
                what = f"{log.name} has sightings with psi beside ranges or bearings alone"
                raise OptionError(f"{what}, which have none: take log.without_orientation()")
            check_memory(log, self.options, maps=self.HAS_MAPS)
            if motion is None and sensor is None:
                # for logs with ids the same choice as that of `Graph.from_log`
                log = known_noise(log)[0] if map is None else noise_in_map(log, map, None, None, None)[0]
            if map is not None:
                log = with_datum(log, map.datum, "the datum of the map")
        positions = log.positions if log is not None and self._takes_positions else None
        #: the origin of poses and landmarks
        self._datum = map.datum if map is not None else positions.datum if positions is not None else None
        self.log = log
        self.motion = motion or getattr(log, "motion", None) or MotionModel()
        self.sensor = sensor or getattr(log, "sensor", None) or SensorModel()
        self._rng = np.random.default_rng(self.options.seed)
        poses = first_poses(in_map(start, log, map, self.motion, self.sensor), log, self.particles, self._rng)
        if log is not None and log.positions is not None and self._takes_positions:
            poses = in_frame(poses, log, self.motion, self.sensor, self._rng, given=start is not None)
        poses = self.sensor.mount(poses)
        self._step, self._version, self._next = 0, 0, 0
        # the sightings of all steps, for backward simulation
        self._record = Record() if self.options.smoothing and self.HAS_MAPS else None
        threads = self.options.threads or available_threads()
        # the particles and their maps
        self._engine = engine.ParticleFilter(poses, threads, self._record is not None)
        self._log_evidence = 0.0
        # whether this step has been observed, even if nothing was seen
        self._observed = False
        self._ess_history, self._resampled_history = [float(self.particles)], [False]

    def __copy__(self) -> Self:
        """A filter of its own, as `copy.deepcopy` makes one; both continue with the same random numbers."""
        return deepcopy(self)

    def __repr__(self) -> str:
        on, steps = ("", "") if self.log is None else (f" on {self.log.name}", f" of {self.log.num_poses - 1}")
        return f"<{type(self).__name__}{on}: {self.particles} particles, step {self._step}{steps}>"

    def move(
        self, control: ArrayLike | None = None, dt: float | None = None, *, motion: ArrayLike | None = None,
        covariance: ArrayLike | None = None,
    ) -> None:  # fmt: skip
        """Go to the next step: every particle draws its own motion.

        Args:
            control, dt: (nu, omega) [m/s, rad/s] for dt [s]. dt = 0 is a step in which nothing moves: no noise is added,
                although the random numbers are drawn.
            motion, covariance: instead of a control and dt, the new pose (3,) of the robot measured from the one before,
                with (3, 3).

        Raises:
            OptionError: a value is impossible, or the robot would, by its motion or a standard deviation of its noise, go
                farther than 1e9 m or turn by more than 1e5 rad.
        """
        checks.check_move(control, dt, motion, covariance)
        if motion is not None:
            self._move_by_gaussian(*sensor_motions(self.sensor, *checked_motion(motion, covariance)))
            return
        u, dt = checked_control(control, dt)
        with np.errstate(over="ignore"):
            std = np.sqrt(np.diag(self.motion.M(u, dt))) if dt > 0 else np.zeros(2)
        if dt > 0 and self._gaussian_motions:
            self._check_control(u, std, dt)
            motions, covariances = self.motion.accumulate(u[None], [dt], np.array([0, 1]))
            self._move_by_gaussian(*sensor_motions(self.sensor, motions, covariances))
        else:
            self._move_by_control(u, std, dt)

    def observe(self, ids: Sequence[int] | np.ndarray | None, sightings: ArrayLike) -> None:
        """Weigh the particles by the sightings of this step, (k,) ids and (k, 2 or 3) sightings, and resample if due.

        NaN stands for a range or a bearing that was not measured.

        The sightings are processed one after the other. There may be any number of them, and none changes nothing,
        except that with unknown association provisional landmarks in view then count as missed. Several calls between
        two moves are one observation. Where the association is unknown ids are ignored, and may be None.

        Raises:
            OptionError: a sighting is not finite or its range not above zero, the shapes do not fit, an id that is used is
                missing (None, `graphslam.log.UNIDENTIFIED`) or not on the known map, or, for FastSLAM, a range is above
                1e50 m or a standard deviation of its noise not between 1e-50 and 1e50: covariances would leave the range of
                floating point.
        """
        ids, z = measurements(ids, sightings, self._needs_ids)
        if len(z) == 0:
            self._observed = True
            return
        self._check_sightings(ids, z.shape[1])
        if np.isnan(z).any() and not self._takes_single_numbers:
            raise OptionError(
                "a range or a bearing alone needs ids, landmark_update kalman, no smoothing, and no range_noise estimated"
            )
        if self._observe(ids, z):
            self._resample_if_due()

    def locate(self, position: ArrayLike, covariance: ArrayLike, *, lever: ArrayLike = (0.0, 0.0)) -> None:
        """Weigh the particles by an absolute position of this step, and resample if due.

        Call it after `observe`: sightings of the same step that come later only change the weights, as in FastSLAM 1.0.

        The arguments are those of `OnlineSolver.locate`, in the frame of the first pose.

        Raises:
            OptionError: a value is impossible, or trajectories are drawn backwards (smoothing).
        """
        if not self._takes_positions:
            raise OptionError("trajectories that are drawn backwards do not know positions: leave out smoothing")
        if self._locate(one_position(position, covariance, lever)):
            self._resample_if_due()

    @property
    def state(self) -> ParticleState:
        """The present particles."""
        particles, last = self._engine, (self._ess_history[-1], self._resampled_history[-1])
        poses, weights = robot_poses(self.sensor, particles.poses), particles.log_weights
        return ParticleState(self._step, poses, weights, *last, particles.best, self, self._version)

    @property
    def pose(self) -> Array:
        """The weighted mean of the particles' poses, (3,)."""
        return self.state.mean_pose

    @property
    def landmarks(self) -> dict[int, Array]:
        """{id: (x, y) or (x, y, heading)}: the means of all maps, by increasing id; `FilterResult` has one particle's."""
        return {j: estimate.mean for j, estimate in sorted(self.state.mixture_map().items())}

    def covariance(self, poses: Any = None, landmarks: Any = None, *, joint: bool = False) -> Any:
        """Covariances of the present pose and of landmarks; see `ParticleState.covariance`."""
        return self.state.covariance(poses, landmarks, joint=joint)

    def trajectory(self, particle: int | None = None) -> Array:
        """Return the history of one particle, by default the best, (steps so far + 1, 3).

        Raises:
            OptionError: there is no such particle.
        """
        chosen = self._engine.best if particle is None else index("particle", particle, self.particles)
        return robot_poses(self.sensor, self._engine.trajectory(chosen))

    def __iter__(self) -> Iterator[ParticleState]:
        """Process the rest of the log step by step; a second loop continues where the first stopped.

        Raises:
            OptionError: the filter has no log, or a motion is out of range, as in `move`.
        """
        log = self.log
        if log is None:
            raise OptionError("this filter has no log: give it one, or use move and observe")
        assert log.controls is not None and log.dt is not None  # checked by __init__
        whole_motions = log.composite or self._gaussian_motions
        # a step that overflows is refused when it is reached
        with np.errstate(over="ignore", invalid="ignore"):
            if whole_motions:
                motions, covariances = sensor_motions(self.sensor, *log.motions(self.motion))
            else:
                control_std = np.sqrt(np.diagonal(self.motion.M(log.controls, log.dt), axis1=-2, axis2=-1))
        first = np.searchsorted(log.steps, np.arange(log.num_poses + 1))
        single = log.partial_sightings if self._takes_single_numbers else None
        alone = set() if single is None else set(single.steps.tolist())
        positions = log.positions if self._takes_positions else None
        located = set() if positions is None else set(positions.steps.tolist())
        for t in range(self._next, log.num_poses):
            if t > 0 and whole_motions:
                self._move_by_gaussian(motions[t - 1 : t], covariances[t - 1 : t])
            elif t > 0:
                self._move_by_control(log.controls[t - 1], control_std[t - 1], log.dt[t - 1])
            rows = slice(first[t], first[t + 1])
            ids, sightings = log.landmarks[rows], log.sightings[rows]
            if single is not None and t in alone:
                now = single.among(single.steps == t)
                ids = np.append(ids, now.landmarks)
                # a log without whole sightings has room for psi in none of its rows
                sightings = np.concatenate([sightings[:, :2], np.column_stack([now.ranges, now.bearings])])
            weighed = len(ids) > 0 and self._observe(ids, sightings, rows)
            if positions is not None and t in located:
                weighed |= self._locate(positions.among(positions.steps == t))
            if weighed:
                self._resample_if_due()
            self._next = t + 1
            yield self.state

    def run(self) -> FilterResult:
        """Process the rest of the log and return the estimate.

        Raises:
            OptionError: the filter has no log.
        """
        for _ in self:
            pass
        return self.result()

    def result(self) -> FilterResult:
        """Return the estimate so far."""
        ahead, left = self.sensor.offset
        mean_poses, ancestors = self._engine.summary((-ahead, -left))
        best_map = self._map(self._engine.best, provisional=False)
        poses = self.trajectory()
        result = FilterResult(
            estimator=type(self).__name__, log="" if self.log is None else self.log.name, options=self.options,
            motion=self.motion, sensor=self.sensor, poses=poses, mean_poses=mean_poses,
            landmarks={j: estimate.mean for j, estimate in best_map.items()},
            landmark_covariances=self._errors_of(best_map),
            log_weights=self._engine.log_weights, log_evidence=self._log_evidence, ess=np.array(self._ess_history),
            resampled=np.array(self._resampled_history), ancestors=ancestors, smoothed=self._smoothed(mean_poses),
            datum=self._datum, **self._association(poses),
        )  # fmt: skip
        # measurements that are handed in between those of the log are not in it
        return noted(result, self.log if self._next == self._step + 1 else None, self.HAS_MAPS)

    def _errors_of(self, best_map: dict[int, LandmarkEstimate]) -> dict[int, Array]:
        """The covariance of each landmark about its place in the best map, E[(m - m_best)(m - m_best)'], over all particles.

        That of the best particle holds where its history is right: of 12 drives it had an NEES/2 of 2 to 260.
        """
        every = self._mixture(np.exp(self._engine.log_weights), provisional=True) if self.HAS_MAPS else {}
        found = {j: estimate.covariance for j, estimate in best_map.items()}
        for j in found.keys() & every.keys():
            off = difference(best_map[j].mean, every[j].mean)
            found[j] = every[j].covariance + np.outer(off, off)
        return found

    def _smoothed(self, mean_poses: Array) -> Samples | None:
        """Trajectories drawn by backward simulation, linearised at the mean history, if there are any."""
        if self._record is None:
            return None
        if not (mixture := self._mixture(np.exp(self._engine.log_weights), provisional=False)):
            return None
        marks, o = np.array([mixture[j].mean for j in sorted(mixture)]), self.options
        # a copy: what the filter draws later does not depend on whether it was asked for a result
        rng, middle = deepcopy(self._rng), self.sensor.mount(mean_poses)
        return self._record.smooth(self._engine, o.smoothing, rng, self.sensor, middle, marks, o.threads)

    def _association(self, poses: Array) -> dict[str, Any]:  # noqa: ARG002
        """The fields ``association`` and ``unconfirmed`` of the result, where they are defined."""
        return {}

    def _check_options(self) -> None:  # noqa: B027
        """Raise `OptionError` where the filter cannot use its options."""

    @property
    def _needs_ids(self) -> bool:
        """Whether every sighting must have the id of its landmark."""
        return True

    @property
    def _takes_single_numbers(self) -> bool:
        """Whether sightings with one number are used."""
        return self._needs_ids

    @property
    def _takes_positions(self) -> bool:
        """Whether absolute positions are used: backward simulation moves later poses, which it takes as relative."""
        return not (self.options.smoothing and self.HAS_MAPS)

    def _with_place(self, ids: np.ndarray, sightings: Array) -> np.ndarray:  # noqa: ARG002
        """Which sightings (k,) are of landmarks that have a place."""
        return np.ones(len(ids), dtype=bool)

    @abstractmethod
    def _check_sightings(self, ids: np.ndarray, columns: int) -> None:
        """Raise `OptionError` where sightings of these ids with this number of columns cannot be used."""

    @abstractmethod
    def _weigh(self, ids: np.ndarray, sightings: Array, q: Array, rows: slice | None = None) -> bool:
        """Compute the log likelihoods of sightings (k, n) with variances q (k, n); False if none was weighed.

        ``rows``: which sightings of the log these are; None for those that are handed in.
        """

    @abstractmethod
    def _map(self, particle: int, provisional: bool) -> dict[int, LandmarkEstimate]:
        """Return the map of a particle, as `ParticleState.map`."""

    @abstractmethod
    def _mixture(self, weights: Array, provisional: bool) -> dict[int, LandmarkEstimate]:
        """Return the mixture of all maps under weights (N,), as `ParticleState.mixture_map`."""

    @abstractmethod
    def _gaussians_of(self, id: int) -> tuple[Array, Array, np.ndarray]:
        """Return means (N, n), covariances (N, n, n) of a landmark in all particles, and whether they have it (N,)."""

    @property
    def _gaussian_motions(self) -> bool:
        """Whether motions are drawn from their Gaussian even where they have one control only."""
        return not self.sensor.centred or self.motion.slip > 0

    def _check_control(self, control: Array, std: Array, dt: float) -> None:
        # as Python's numbers, which overflow to infinity without a warning
        way, turn = ((abs(float(u)) + float(s)) * float(dt) for u, s in zip(control, std, strict=True))
        check_motion(self._step + 1, way, turn)

    def _move_by_control(self, control: Array, std: Array, dt: float) -> None:
        """Move every particle by its own draw of the control; nothing moves where dt = 0."""
        self._check_control(control, std, dt)
        numbers = (*control, *std, dt, self.motion.epsilon if dt > 0 else 0.0)
        self._advance(lambda key: self._engine.move_by_control(key, numbers, bool(dt > 0)))

    def _move_by_gaussian(self, motions: Array, covariances: Array) -> None:
        """Move every particle by a draw of the Gaussian (1, 3), (1, 3, 3) of a whole motion of the sensor."""
        reach = np.abs(motions[0]) + np.sqrt(np.diagonal(covariances[0]))
        check_motion(self._step + 1, reach[:2].max(), reach[2])
        self._advance(lambda key: self._engine.move_by_gaussian(key, motions[0], covariances[0], True))

    def _advance(self, draw: Callable[[int], None]) -> None:
        """Finish the previous step, and go to the next one by ``draw``, which moves all particles, given a random key."""
        if self._observed:
            self._engine.end_step()
            self._observed = False
        draw(draw_key(self._rng))
        self._step, self._version = self._step + 1, self._version + 1
        self._ess_history.append(self._ess_history[-1])
        self._resampled_history.append(False)

    def _locate(self, positions: AbsolutePositions) -> bool:
        """Weigh the particles by positions of this step; whether the weights are new."""
        self._version += 1
        if self.options.stage == "motion":
            return False
        self._engine.weigh_by(log_likelihoods(positions, robot_poses(self.sensor, self._engine.poses)))
        return self._reweigh("positions")

    def _observe(self, ids: np.ndarray, sightings: Array, rows: slice | None = None) -> bool:
        """Weigh the particles by sightings of this step; whether the weights are new."""
        missing = np.isnan(sightings)
        if missing.any():
            # whole sightings first: a landmark has its place from one, also where a number alone was named before it
            order = np.argsort(missing.any(axis=1), kind="stable")
            ids, sightings, missing = ids[order], sightings[order], missing[order]
            placed = self._with_place(ids, sightings)
            ids, sightings, missing = ids[placed], np.where(missing, (1.0, 0.0), sightings)[placed], missing[placed]
            if not len(ids):
                self._version, self._observed = self._version + 1, True
                return False
        with np.errstate(over="ignore"):
            q = np.diagonal(self.sensor.Q(sightings), axis1=-2, axis2=-1).copy()
        q[missing] = NOT_MEASURED
        weighed = self._weigh(ids, sightings, q, rows)
        self._version, self._observed = self._version + 1, True
        possible = weighed and self.options.stage != "motion" and self._reweigh("sightings")
        if self._record is not None:
            self._engine.remember()
            self._record.observe(self._step, ids, sightings)
        if possible:
            # without the density of what was not measured
            self._log_evidence += 0.5 * np.count_nonzero(missing) * float(np.log(2 * np.pi * NOT_MEASURED))
        return possible

    def _reweigh(self, what: str) -> bool:
        """Multiply the weights by the last likelihoods; False where these are 0 for all particles."""
        possible, log_evidence, ess = self._engine.reweigh()
        if not possible:
            warnings.warn(
                f"step {self._step}: its {what} are impossible for all {self.particles} particles; "
                "the weights from before the step are kept", VanishedWeightsWarning, stacklevel=4,
            )  # fmt: skip
            return False
        self._log_evidence += log_evidence
        self._ess_history[-1] = ess
        return True

    def _resample_if_due(self) -> None:
        if self.options.stage != "resampling" or self._ess_history[-1] > self.options.ess_threshold * self.particles:
            return
        self._engine.branch(RESAMPLING_SCHEMES[self.options.resampling](self._engine.weights(), self._rng))
        self._resampled_history[-1] = True
