"""`Log`: the controls and sightings of a robot, which every estimator takes, and the ground truth where it is known."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..errors import LogError, OptionError, checks, printable, quoted
from ..models import MotionModel, SensorModel, additional_variances
from ..se2 import Array, mounted, wrap
from . import measurements
from .measurements import finite_floats, length_of, whole_numbers
from .rows import NO_CLASS, NO_ID, UNIDENTIFIED, without_no_id


@dataclass(frozen=True, eq=False, kw_only=True)
class Log:
    """A log of T motions and M sightings. All arrays are copied, checked and made read-only.

    Controls may be more frequent than poses: then motion t consists of several controls, ``control_starts[t]`` to
    ``control_starts[t+1]`` - 1, one after the other, and S, the number of controls, is greater than T.

    Args:
        dt: duration of each control [s], (S,) or one number; None together with ``controls``.
        controls: u = (nu, omega) [m/s, rad/s], (S, 2); None where there are none.
        control_starts: (T+1,), increasing, from 0 to S; default: one control per motion, row t moves pose t to pose t+1.
        control_variances: (S, 3) variances of single controls in addition to those of the motion model, for example across
            a gap in the odometry: of the speed, the turn rate and the speed sideways [m²/s², rad²/s², m²/s²]; (S, 2)
            without the last; or None.
        recorded_dt: (S,) the duration [s] of the recorded control of which each control is a piece, where sightings cut
            controls; its pieces share the variance that the motion model gives it (`MotionModel.M`). Default: ``dt``.
        steps: the step of each sighting, (M,), not decreasing; default: there are no sightings.
        landmarks: the id of the landmark of each sighting, (M,) integers; `UNIDENTIFIED` where the sensor gives none. -1
            is taken for that, with a note.
        sightings: (l, phi) or (l, phi, psi) [m, rad, rad], (M, 2) or (M, 3); angles are wrapped to [-pi, pi).
        classes: what each sighting looks like, such as the colour of a cone: (M,) words, or integers; None where the sensor
            tells none. Where the class of a sighting is not known it is "", or `UNIDENTIFIED`. `fastslam.associate` and
            FastSLAM use classes where they find the ids.
        relations: measured relations between two poses, such as loop closures; None where there are none.
        positions: measured places of a point of the robot in the world, such as GPS; None where there are none.
        partial_sightings: sightings with a range or a bearing alone; None where there are none.
        initial_poses: (T+1, 3), the initial guess of the trajectory; default: dead reckoning from (0, 0, 0). Headings
            are not wrapped, so that they can count turns.
        true_poses: the ground truth, (T+1, 3), or None where unknown. A row is NaN where the pose is unknown, and (x, y,
            NaN) where only the position is known.
        true_path: (S+1, 3) the true poses at the ends of all controls, where they are known; ``true_poses`` are the rows
            ``control_starts`` of it.
        truth_offset: the point of the robot to which the positions of ``true_poses`` belong, (ahead, left) [m] of its
            pose: where the GPS antenna or the marker sits. A single number is the distance ahead. Errors are measured
            at this point.
        true_landmarks: {id: (x, y) or (x, y, heading)}, or None where unknown.
        start_time: the time of step 0 [s].
        motion, sensor: the noise models published with the data, the default of all estimators; None where there are
            none.
        uncertain: {name of a bias of `PARAMETERS`: standard deviation of its prior} of the biases that were
            estimated and taken out of this log. Covariances of graphs then contain what is still unknown of them.
        simulated: whether `simulate` made the log. All other logs count as real data, whose sightings may be wrong.
        sessions: the drives or robots that the log was joined from (`graphslam.join_logs`); empty for one drive. Nothing is
            known of the way from the end of one to the start of the next.
        name: the name of the log in messages and tables.
        notes: remarks of the reader about the data, one sentence each.
        doubts: probable mistakes that the reader or the estimate of noise found, (name of the check, sentence) each;
            `check_log` returns them. A check without a sentence is answered, as that of a unit that was stated.

    Raises:
        LogError: an argument has the wrong shape, is not finite, or is impossible (a range not above zero, ...).
        OptionError: ``truth_offset`` is no place on the robot, or an argument is of another type.
    """

    dt: Array | None = None
    controls: Array | None = None
    steps: np.ndarray = ()  # type: ignore[assignment]  # arrays after __post_init__, as all others
    landmarks: np.ndarray = ()  # type: ignore[assignment]
    sightings: Array = ()  # type: ignore[assignment]
    classes: np.ndarray | None = None
    relations: measurements.PoseRelations | None = None
    positions: measurements.AbsolutePositions | None = None
    partial_sightings: measurements.PartialSightings | None = None
    initial_poses: Array = None  # type: ignore[assignment]  # filled in by __post_init__
    true_poses: Array | None = None
    true_path: Array | None = None
    truth_offset: tuple[float, float] = (0.0, 0.0)
    true_landmarks: dict[int, Array] | None = None
    start_time: float = 0.0
    control_starts: np.ndarray = None  # type: ignore[assignment]  # None stays only where there are no controls
    control_variances: Array | None = None
    recorded_dt: Array | None = None
    motion: MotionModel | None = None
    sensor: SensorModel | None = None
    uncertain: Mapping[str, float] | None = field(default=None, compare=False)
    simulated: bool = field(default=False, compare=False)
    sessions: tuple[measurements.Session, ...] = field(default=(), compare=False)
    name: str = field(default="log", compare=False)
    notes: tuple[str, ...] = field(default=(), compare=False)
    doubts: tuple[tuple[str, str], ...] = field(default=(), compare=False)
    #: the log of tables of your own robot; `log.join`, which reads them, adds it
    from_tables: ClassVar[Callable[..., Log]]

    def __post_init__(self) -> None:
        checks.check_type(MotionModel, motion=self.motion)
        checks.check_type(SensorModel, sensor=self.sensor)
        values = self._checked_controls()
        values["name"] = printable(str(self.name))
        starts = values["control_starts"]
        initial = self.initial_poses
        if initial is None:
            if starts is None:
                raise LogError("a log without controls needs initial_poses: there is nothing to compute them from")
            initial = MotionModel().dead_reckoning(np.zeros(3), values["controls"], values["dt"])[starts]
        initial = finite_floats("initial_poses", initial, (None if starts is None else len(starts), 3))
        if len(initial) == 0:
            raise LogError("initial_poses is empty: a log has at least one pose")
        values["initial_poses"] = initial
        values |= self._checked_sightings(len(initial))
        if self.true_poses is not None:
            values["true_poses"] = measurements.checked_truth(self.true_poses, initial.shape)
        if self.true_path is not None:
            if self.true_poses is None or starts is None:
                raise LogError("true_path without true_poses or controls: leave it out")
            values["true_path"] = measurements.checked_truth(self.true_path, (starts[-1] + 1, 3), "true_path")
        for name, kind in measurements.MEASURED.items():
            checks.check_type(kind, **{name: getattr(self, name)})
        for name, measured in self.measured.items():
            measured.check_steps(name, len(initial))
        measurements.check_sessions(self.sessions, len(initial))
        values["truth_offset"] = checks.checked_offset("truth_offset", self.truth_offset)
        if self.true_landmarks is not None:
            values["true_landmarks"] = measurements.checked_landmarks(self.true_landmarks)
            if NO_ID in values["true_landmarks"]:
                raise LogError("true_landmarks has the id -1, which stands for no id: give this landmark another one")
        if self.uncertain is not None:
            values["uncertain"] = checks.checked_deviations("uncertain", self.uncertain)
        start = checks.array_of("start_time", self.start_time)
        if start.shape != () or not np.isfinite(start):
            raise LogError(f"start_time is {quoted(self.start_time)}; it must be a finite number of seconds")
        values["start_time"] = float(start)
        for name, value in values.items():
            for array in value.values() if isinstance(value, dict) else [value]:
                if isinstance(array, np.ndarray):
                    array.flags.writeable = False
            object.__setattr__(self, name, value)

    def _checked_controls(self) -> dict[str, Any]:
        """dt, controls, control_starts, control_variances and recorded_dt, checked and complete."""
        if (self.controls is None) != (self.dt is None):
            raise LogError("dt and controls belong together: give both, or neither for a log without controls")
        if self.controls is None:
            for name in ("control_starts", "control_variances", "recorded_dt"):
                if getattr(self, name) is not None:
                    raise LogError(f"{name} without controls: there is nothing that they belong to")
            return {"control_starts": None}
        empty = np.zeros((0, 2))  # [] has no columns
        controls = empty if length_of(self.controls) == 0 else finite_floats("controls", self.controls, (None, 2))
        dt = checks.array_of("dt", self.dt)
        dt = finite_floats("dt", np.full(len(controls), dt) if dt.ndim == 0 else dt, (len(controls),))
        if (k := checks.first(dt <= 0)) is not None:
            raise LogError(f"dt[{k}] is {dt[k]:g}, but a motion must last longer than 0 s")
        values = {"dt": dt, "controls": controls, "control_starts": np.arange(len(controls) + 1)}
        if self.control_starts is not None:
            values["control_starts"] = measurements.checked_starts(self.control_starts, len(controls))
        if self.control_variances is not None:
            given = checks.array_of("control_variances", self.control_variances)
            columns = 2 if given.ndim == 2 and given.shape[1] == 2 else 3
            variances = finite_floats("control_variances", given, (len(controls), columns))
            values["control_variances"] = additional_variances(variances, len(controls))
            if np.any(variances < 0):
                raise LogError(f"control_variances has the entry {variances.min():g}, but a variance is not negative")
        if self.recorded_dt is not None:
            recorded = finite_floats("recorded_dt", self.recorded_dt, (len(controls),))
            if (k := checks.first(recorded < dt * (1 - 1e-9))) is not None:
                raise LogError(f"recorded_dt[{k}] is {recorded[k]:g} s, less than dt[{k}], {dt[k]:g} s, a piece of it")
            # whole controls need no mention
            whole = np.allclose(recorded, dt, rtol=1e-9, atol=0)
            return values | {"recorded_dt": None if whole else recorded}
        return values

    def _checked_sightings(self, poses: int) -> dict[str, Any]:
        """Steps, landmarks and sightings, checked."""
        sightings = checks.array_of("sightings", self.sightings)
        if sightings.size == 0:
            sightings = sightings.reshape(0, sightings.shape[-1] if sightings.ndim == 2 else 3)
        if sightings.ndim != 2 or sightings.shape[1] not in (2, 3):
            raise LogError(f"sightings must have shape (M, 2) or (M, 3), not {sightings.shape}")
        sightings = finite_floats("sightings", sightings, sightings.shape)
        if (k := checks.first(sightings[:, 0] <= 0)) is not None:
            raise LogError(f"sighting {k} has range {sightings[k, 0]:g} m; a range must be above zero")
        # single angles may have turns in them, but most of them only in degrees
        usual = np.median(np.abs(sightings[:, 1:]), axis=0).max() if len(sightings) > 2 else 0.0
        if usual > checks.WHOLE_TURN:
            raise LogError(
                f"half of the bearings or orientations are beyond 2 pi (median {usual:.3g} rad): are they in degrees? Give "
                "radians, np.deg2rad(...); if they are in radians, wrap them to [-pi, pi) with graphslam.se2.wrap"
            )
        sightings[:, 1:] = wrap(sightings[:, 1:])
        steps, landmarks = (whole_numbers(name, getattr(self, name), len(sightings)) for name in ("steps", "landmarks"))
        if (k := checks.first((steps < 0) | (steps >= poses))) is not None:
            raise LogError(f"sighting {k} belongs to step {steps[k]}, but the log has steps 0 to {poses - 1}")
        if (k := checks.first(np.diff(steps) < 0)) is not None:
            message = f"sighting {k + 1} runs backwards, from step {steps[k]} to {steps[k + 1]}: sort sightings by step"
            raise LogError(message)
        if note := without_no_id(landmarks, "sighting"):
            object.__setattr__(self, "notes", (*self.notes, *note))
        classes = None if self.classes is None else measurements.checked_classes(self.classes, len(sightings))
        return {"steps": steps, "landmarks": landmarks, "sightings": sightings, "classes": classes}

    def with_sightings(self, kept: np.ndarray, **changes: Any) -> Log:
        """The same log with some of its sightings, given by their rows or a mask (M,), and with other arguments replaced."""
        rows = ("steps", "landmarks", "sightings", "classes")
        chosen = {name: values[kept] for name in rows if (values := getattr(self, name)) is not None}
        return replace(self, **(chosen | changes))

    def __repr__(self) -> str:
        """One line: name, sizes, and what is known."""
        parts = {
            "psi": self.has_orientation,
            "classes": self.classes is not None,
            "controls": self.controls is not None,
            **dict.fromkeys(self.measured, True),
            "truth": self.true_poses is not None,
        }
        known = ", ".join(part for part, present in parts.items() if present)
        return f"<Log {self.name}: {self.sizes}, with {known or 'neither psi nor controls nor truth'}>"

    @property
    def measured(self) -> dict[str, measurements.Measured]:
        """The relations, positions and partial sightings by the names of `MEASURED`, as far as the log has them."""
        return {name: each for name in measurements.MEASURED if (each := getattr(self, name)) is not None}

    def warn_of_unused(self, who: str, but: Sequence[str] = ()) -> None:
        """Warn that ``who`` does not use relations, positions and partial sightings of the log, ``but`` for some kinds."""
        if unused := [name for name in self.measured if name not in but]:
            which = " and ".join(unused).replace("_", " ")
            warnings.warn(f"{who} does not use the {which} of the log", UserWarning, stacklevel=3)

    @property
    def num_poses(self) -> int:
        """The number of poses, T + 1."""
        return len(self.initial_poses)

    @property
    def drives(self) -> list[slice]:
        """The steps of each of the ``sessions``; all steps where there is one drive."""
        starts = [each.start for each in self.sessions] or [0]
        return [slice(*pair) for pair in zip(starts, [*starts[1:], self.num_poses])]

    @property
    def has_orientation(self) -> bool:
        """Whether the sightings have psi."""
        return self.sightings.shape[1] == 3

    @property
    def landmark_ids(self) -> np.ndarray:
        """The ids of the landmarks that were seen, sorted; empty where the sensor gives no ids."""
        return np.setdiff1d(self.landmarks, [UNIDENTIFIED])

    @property
    def sizes(self) -> str:
        """The numbers of poses, sightings and landmarks, in words."""
        return checks.singular(f"{self.num_poses} poses, {self.seen}")

    @property
    def seen(self) -> str:
        """The numbers of sightings and landmarks, in words."""
        total, without = len(self.steps), int(np.count_nonzero(self.landmarks == UNIDENTIFIED))
        if 0 < without == total:
            return checks.singular(f"{total} sightings of unidentified landmarks")
        some, ids, alone = f" ({without} without an id)" if without else "", self.landmark_ids, ""
        if (single := self.partial_sightings) is not None:
            ids, alone = np.union1d(ids, single.landmarks), f" and {len(single)} with a range or a bearing alone"
        return checks.singular(f"{total} sightings{some}{alone} of {len(ids)} landmarks")

    @property
    def identified(self) -> bool:
        """Whether the landmark of every sighting is known."""
        return not np.any(self.landmarks == UNIDENTIFIED)

    @property
    def classified(self) -> np.ndarray:
        """Whether the class of each sighting is known, (M,) bool."""
        if self.classes is None:
            return np.zeros(len(self.steps), dtype=bool)
        return np.asarray(self.classes != (NO_CLASS if self.classes.dtype.kind == "U" else UNIDENTIFIED))

    @property
    def composite(self) -> bool:
        """Whether some motion consists of several controls, or of a piece of one, or has additional variances."""
        pieces = self.control_variances is not None or self.recorded_dt is not None
        return self.controls is not None and (pieces or len(self.controls) != len(self.control_starts) - 1)

    @property
    def control_times(self) -> Array:
        """The times since the first pose at which each control starts, and at which the last one ends [s], (S+1,)."""
        return np.concatenate([[0.0], np.cumsum(() if self.dt is None else self.dt)])

    @cached_property
    def times(self) -> Array | None:
        """The time of each pose [s], (T+1,), read-only; None without controls."""
        if self.dt is None:
            return None
        times = self.start_time + self.control_times[self.control_starts]
        times.flags.writeable = False
        return times

    @property
    def covered(self) -> np.ndarray:
        """The poses whose true position is known, (T+1,) bool."""
        return np.zeros(self.num_poses, dtype=bool) if self.true_poses is None else np.isfinite(self.true_poses[:, 0])

    def at_truth(self, poses: ArrayLike) -> Array:
        """Poses (..., 3) of the robot, as poses of the point to which the ground truth belongs (``truth_offset``)."""
        return mounted(poses, self.truth_offset)

    @property
    def truth_place(self) -> str:
        """``truth_offset`` in words, "3.78 m ahead and 0.5 m to the left"; empty where it is zero."""
        names = (("ahead", "behind"), ("to the left", "to the right"))
        return " and ".join(f"{abs(d):g} m {side[d < 0]}" for d, side in zip(self.truth_offset, names) if d)

    @property
    def robot_truth(self) -> Array | None:
        """The true poses of the robot itself, (T+1, 3); ``true_poses`` where ``truth_offset`` is zero.

        With an offset a row is NaN where the true heading is not known, which the direction to the robot depends on.
        """
        if self.true_poses is None or self.truth_offset == (0.0, 0.0):
            return self.true_poses
        poses = mounted(self.true_poses, (-self.truth_offset[0], -self.truth_offset[1]))
        poses[np.isnan(poses[:, 2])] = np.nan
        return poses

    def dead_reckoning(self, motion: MotionModel | None = None) -> Array:
        """The poses (T+1, 3) that follow from the controls and the first initial pose of each session, noise-free.

        Raises:
            LogError: the log has no controls.
        """
        controls, dt, motion = self._driven(motion)
        drives = []
        for drive in self.drives:
            ends = self.control_starts[drive]
            rows = slice(ends[0], ends[-1])
            poses = motion.dead_reckoning(self.initial_poses[drive.start], controls[rows], dt[rows])
            drives.append(poses[ends - ends[0]])
        return np.concatenate(drives)

    def motions(self, motion: MotionModel | None = None) -> tuple[Array, Array]:
        """Each motion (T, 3) and its covariance (T, 3, 3), in the frame of the pose at its start.

        `MotionModel.accumulate` computes both.

        Raises:
            LogError: the log has no controls.
        """
        controls, dt, motion = self._driven(motion)
        return motion.accumulate(controls, dt, self.control_starts, self.control_variances, self.recorded_dt)

    def noise_models(
        self, motion: MotionModel | None = None, sensor: SensorModel | None = None
    ) -> tuple[MotionModel, SensorModel]:
        """The noise models that are given, else those of the log, else the book's.

        Raises:
            OptionError: one of them is no such model.
        """
        checks.check_type(MotionModel, motion=motion)
        checks.check_type(SensorModel, sensor=sensor)
        return motion or self.motion or MotionModel(), sensor or self.sensor or SensorModel()

    def _driven(self, motion: MotionModel | None) -> tuple[Array, Array, MotionModel]:
        if self.controls is None or self.dt is None:
            raise LogError(f"{self.name} has no controls to compute motions from")
        return self.controls, self.dt, self.noise_models(motion)[0]

    def without_orientation(self) -> Log:
        """The same log without psi, as from a range-bearing sensor."""
        return replace(self, sightings=self.sightings[:, :2])

    def nearer_than(self, most: float) -> Log:
        """The same log without sightings from farther than ``most`` [m]; bearings alone stay."""
        checks.check_positive(most=most)
        partial = self.partial_sightings
        near = None if partial is None else partial.among(~(partial.ranges > most))
        return self.with_sightings(self.sightings[:, 0] <= most, partial_sightings=near)

    def at_steps(self, steps: ArrayLike) -> Log:
        """The log with only these poses and what was measured from them; the motions between them are joined.

        Relations of poses that are left out are left out, too, and so are positions, with a note.

        Args:
            steps: increasing. Controls before the first and after the last step are left out.

        Raises:
            LogError: there is no such step, or they do not increase.
        """
        kept = measurements.checked_steps(steps, self.num_poses)
        changes: dict[str, Any] = {"initial_poses": self.initial_poses[kept]}
        if self.true_poses is not None:
            changes["true_poses"] = self.true_poses[kept]
        if (times := self.times) is not None:
            starts = self.control_starts[kept]
            path = self.true_poses if self.true_path is None and not self.composite else self.true_path
            if path is not None:
                changes["true_path"] = path[starts[0] : starts[-1] + 1]
            for name in ("controls", "dt", "control_variances", "recorded_dt"):
                if (rows := getattr(self, name)) is not None:
                    changes[name] = rows[starts[0] : starts[-1]]
            changes |= {"control_starts": starts - starts[0], "start_time": float(times[kept[0]])}
        for name, measured in self.measured.items():
            changes[name] = measured.within(kept)
            if left_out := len(measured) - len(changes[name]):
                note = f"{left_out:,} of {len(measured):,} {name.replace('_', ' ')} are left out with their poses"
                changes["notes"] = (*changes.get("notes", self.notes), note)
        since = np.zeros(self.num_poses) if times is None else self.control_times[self.control_starts]
        moved = list[measurements.Session]()
        for each in self.sessions:
            start = int(np.searchsorted(kept, each.start))
            later = float(since[kept[min(start, len(kept) - 1)]] - since[each.start])
            moved.append(replace(each, start=start, start_time=each.start_time + later))
        # a session of which no pose is left ends where it starts
        ends = [*(each.start for each in moved[1:]), len(kept)]
        changes["sessions"] = tuple(each for each, end in zip(moved, ends) if each.start < end)
        seen = np.isin(self.steps, kept)
        changes["steps"] = np.searchsorted(kept, self.steps[seen])
        return self.with_sightings(seen, **changes)

    def replace(self, **changes: Any) -> Log:
        """The same log with some arguments replaced.

        With another number of controls the old ``control_starts``, ``control_variances``, ``recorded_dt`` and ``true_path``
        are dropped, with another number of sightings ``classes``, and with other ``true_poses`` ``true_path``.
        """
        if "sightings" in changes and length_of(changes["sightings"]) != len(self.sightings):
            changes = {"classes": None} | changes
        if "controls" in changes and (self.controls is None or length_of(changes["controls"]) != len(self.controls)):
            changes = dict.fromkeys(("control_starts", "control_variances", "recorded_dt", "true_path")) | changes
        if "true_poses" in changes:
            changes = {"true_path": None} | changes
        return replace(self, **changes)

    def equals(self, other: Log) -> bool:
        """Whether both logs hold exactly the same numbers; names and notes are not compared."""
        return all(measurements.same(getattr(self, f.name), getattr(other, f.name)) for f in fields(self) if f.compare)


def check_is_log(log: object) -> None:
    """Raise `OptionError` unless this is a `Log`."""
    if not isinstance(log, Log):
        inside = isinstance(getattr(log, "log", None), Log)
        remedy = "take its attribute log" if inside else "graphslam.load(path) reads one"
        if isinstance(log, (list, tuple)):
            remedy = "give one log; Graph.from_logs and join_logs make one of several"
        elif hasattr(log, "save_g2o") and not inside:
            remedy = "Graph.save_g2o writes a graph, and Graph.from_g2o reads one"
        raise OptionError(f"log must be a Log, not {quoted(log)}; {remedy}")
