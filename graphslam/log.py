"""What a robot did and saw: the one object that every estimator takes, and the truth where it is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .checks import check_positive
from .errors import LogError, OptionError
from .models import MotionModel, SensorModel
from .se2 import Array, wrap

#: the id of a landmark that the sensor could not tell
UNIDENTIFIED = int(np.iinfo(np.int64).min)


@dataclass(frozen=True, eq=False, kw_only=True)
class Log:
    """A log of T motions and M sightings. All arrays are copied, checked and made read-only.

    Odometry may be finer than the poses: then motion t is made of several controls, ``control_starts[t]`` to
    ``control_starts[t+1]`` - 1, one after the other, and S, the number of controls, is greater than T.

    Args:
        dt: how long each control is held [s], (S,) or one number; None together with ``controls``.
        controls: u = (nu, omega) [m/s, rad/s], (S, 2); None where there are none.
        control_starts: (T+1,), increasing, from 0 to S; default: one control a motion, row t drives pose t to pose t+1.
        control_variances: (S, 2) noise of single controls [m²/s², rad²/s²] beyond what the motion model says, as across
            a gap in the odometry; None for none.
        steps: the step in which each sighting was made, (M,), not decreasing.
        landmarks: the id of the landmark seen, (M,) integers; `UNIDENTIFIED` where the sensor cannot tell.
        sightings: (l, phi) or (l, phi, psi) [m, rad, rad], (M, 2) or (M, 3); angles are wrapped to [-pi, pi).
        initial_poses: (T+1, 3), the first guess of the trajectory; default: dead reckoning from (0, 0, 0). Headings
            may count turns (they are not wrapped).
        true_poses: (T+1, 3), or None where unknown. Rows of NaN where the truth does not say, (x, y, NaN) where it
            tells the position only.
        true_landmarks: {id: (x, y) or (x, y, heading)}, or None where unknown.
        start_time: the time of step 0 [s].
        motion, sensor: the noise models that the source of the data publishes, used where none are given; None where it
            publishes none.
        name: how messages and tables call the log.

    Raises:
        LogError: an argument has the wrong shape, is not finite, or is impossible (a range not above zero, ...).
    """

    dt: Array | None = None
    controls: Array | None = None
    steps: np.ndarray
    landmarks: np.ndarray
    sightings: Array
    initial_poses: Array = None  # type: ignore[assignment]  # filled in by __post_init__
    true_poses: Array | None = None
    true_landmarks: dict[int, Array] | None = None
    start_time: float = 0.0
    control_starts: np.ndarray = None  # type: ignore[assignment]  # None stays only where there are no controls
    control_variances: Array | None = None
    motion: MotionModel | None = None
    sensor: SensorModel | None = None
    name: str = field(default="log", compare=False)
    notes: tuple[str, ...] = field(default=(), compare=False)

    def __post_init__(self) -> None:
        controls = _floats("controls", self.controls, (None, 2)) if self.controls is not None else None
        if (controls is None) != (self.dt is None):
            raise LogError("dt and controls belong together: give both, or neither for a log without controls")
        dt = None
        if controls is not None:
            dt = np.asarray(self.dt, dtype=float)
            dt = _floats("dt", np.full(len(controls), dt) if dt.ndim == 0 else dt, (len(controls),))
            if np.any(dt <= 0):
                raise LogError(
                    f"dt[{np.argmax(dt <= 0)}] is {dt[dt <= 0][0]:g}, but a motion must last longer than 0 s"
                )
        starts = _checked_starts(self.control_starts, controls)
        variances = None
        if self.control_variances is not None:
            if controls is None:
                raise LogError("control_variances without controls: there is nothing that they belong to")
            variances = _floats("control_variances", self.control_variances, controls.shape)
            if np.any(variances < 0):
                raise LogError(f"control_variances has the entry {variances.min():g}, but a variance is not negative")
        initial = self.initial_poses
        if initial is None:
            if controls is None or starts is None:
                raise LogError("a log without controls needs initial_poses: there is nothing to reckon them from")
            initial = MotionModel().dead_reckoning(np.zeros(3), controls, dt)[starts]
        initial = _floats("initial_poses", initial, (None if starts is None else len(starts), 3))
        if len(initial) == 0:
            raise LogError("initial_poses is empty: a log has at least one pose")
        truth = _truth(self.true_poses, initial.shape) if self.true_poses is not None else None

        sightings = np.asarray(self.sightings, dtype=float)
        if sightings.size == 0:
            sightings = sightings.reshape(0, sightings.shape[-1] if sightings.ndim == 2 else 3)
        if sightings.ndim != 2 or sightings.shape[1] not in (2, 3):
            raise LogError(f"sightings must have shape (M, 2) or (M, 3), not {sightings.shape}")
        sightings = _floats("sightings", sightings, sightings.shape).copy()
        if np.any(sightings[:, 0] <= 0):
            k = int(np.argmax(sightings[:, 0] <= 0))
            raise LogError(f"sighting {k} has range {sightings[k, 0]:g} m; a range must be above zero")
        sightings[:, 1:] = wrap(sightings[:, 1:])
        steps = _integers("steps", self.steps, len(sightings))
        landmarks = _integers("landmarks", self.landmarks, len(sightings))
        if len(steps) and (steps.min() < 0 or steps.max() >= len(initial)):
            k = int(np.argmax((steps < 0) | (steps >= len(initial))))
            raise LogError(f"sighting {k} belongs to step {steps[k]}, but the log has steps 0 to {len(initial) - 1}")
        if np.any(np.diff(steps) < 0):
            k = int(np.argmax(np.diff(steps) < 0)) + 1
            raise LogError(
                f"sighting {k} runs backwards, from step {steps[k - 1]} to {steps[k]}: sort sightings by step"
            )

        true_landmarks = None
        if self.true_landmarks is not None:
            true_landmarks = {}
            for j, landmark in self.true_landmarks.items():
                landmark = np.asarray(landmark, dtype=float)
                if landmark.shape not in ((2,), (3,)):
                    raise LogError(
                        f"true_landmarks[{j}] must be (x, y) or (x, y, heading), not of shape {landmark.shape}"
                    )
                true_landmarks[int(j)] = _floats(f"true_landmarks[{j}]", landmark, landmark.shape)
        if not np.isfinite(self.start_time):
            raise LogError(f"start_time is {self.start_time}; it must be a finite number of seconds")
        values: dict[str, Any] = {
            "dt": dt,
            "controls": controls,
            "control_starts": starts,
            "control_variances": variances,
            "steps": steps,
            "landmarks": landmarks,
            "sightings": sightings,
        }
        values |= {"initial_poses": initial, "true_poses": truth, "true_landmarks": true_landmarks}
        values |= {"start_time": float(self.start_time)}
        for key, value in values.items():
            object.__setattr__(self, key, _frozen(value))

    @property
    def num_poses(self) -> int:
        """The number of poses, T + 1."""
        return len(self.initial_poses)

    @property
    def has_orientation(self) -> bool:
        """Whether the sightings have psi."""
        return self.sightings.shape[1] == 3

    @property
    def landmark_ids(self) -> np.ndarray:
        """The ids of the landmarks that were seen, sorted; none where the sensor could not tell them."""
        return np.setdiff1d(self.landmarks, [UNIDENTIFIED])

    @property
    def identified(self) -> bool:
        """Whether it is known of every sighting which landmark it is of."""
        return not np.any(self.landmarks == UNIDENTIFIED)

    @property
    def composite(self) -> bool:
        """Whether some motion is not one control of the motion model's own noise."""
        return self.controls is not None and (
            len(self.controls) != len(self.control_starts) - 1 or self.control_variances is not None
        )

    @property
    def times(self) -> Array | None:
        """The time of each pose [s], (T+1,); None without controls."""
        if self.dt is None:
            return None
        return self.start_time + np.concatenate([[0.0], np.cumsum(self.dt)])[self.control_starts]

    @property
    def covered(self) -> np.ndarray:
        """The poses of which the truth tells at least the position, (T+1,) bool."""
        if self.true_poses is None:
            return np.zeros(self.num_poses, dtype=bool)
        return np.isfinite(self.true_poses[:, 0])

    def dead_reckoning(self, motion: MotionModel | None = None) -> Array:
        """The poses (T+1, 3) that follow from the controls and the first initial pose, noise-free.

        Raises:
            LogError: the log has no controls.
        """
        if self.controls is None or self.dt is None:
            raise LogError(f"{self.name} has no controls to reckon poses from")
        motion = motion or self.motion or MotionModel()
        return motion.dead_reckoning(self.initial_poses[0], self.controls, self.dt)[self.control_starts]

    def motions(self, motion: MotionModel | None = None) -> tuple[Array, Array]:
        """Each motion (T, 3) and its covariance (T, 3, 3) in the frame of the pose it starts from.

        See `MotionModel.accumulate`.

        Raises:
            LogError: the log has no controls.
        """
        if self.controls is None or self.dt is None:
            raise LogError(f"{self.name} has no controls to accumulate motions from")
        motion = motion or self.motion or MotionModel()
        return motion.accumulate(self.controls, self.dt, self.control_starts, self.control_variances)

    def without_orientation(self) -> Log:
        """The same log as a range-bearing sensor would have written it: psi left out."""
        return replace(self, sightings=self.sightings[:, :2])

    def nearer_than(self, most: float) -> Log:
        """The same log without the sightings from farther than ``most`` [m]."""
        kept = self.sightings[:, 0] <= most
        return replace(self, steps=self.steps[kept], landmarks=self.landmarks[kept], sightings=self.sightings[kept])

    def with_corrected_ranges(self, scale: float, bias: float) -> Log:
        """The same log with ranges (l - bias) / scale, from a sensor that measured ranges as scale * l + bias [m].

        Raises:
            LogError: a corrected range would not be above zero.
            OptionError: the scale is not positive, or the bias not finite.
        """
        check_positive(range_scale=scale)
        if not np.isfinite(bias):
            raise OptionError(f"range_bias must be a finite number, not {bias!r}")
        sightings = self.sightings.copy()
        sightings[:, 0] = (sightings[:, 0] - bias) / scale
        if np.any(sightings[:, 0] <= 0):
            k = int(np.argmax(sightings[:, 0] <= 0))
            raise LogError(
                f"{self.name}: sighting {k} has a range of {self.sightings[k, 0]:g} m, which a range bias of {bias:g} m "
                "takes below zero; was it found on another sensor?"
            )
        return replace(self, sightings=sightings)

    def at_steps(self, steps: ArrayLike) -> Log:
        """The log with only these poses and what was seen from them; the motions between them are joined.

        Args:
            steps: increasing. Controls before the first and after the last drive nothing any more and are left out.

        Raises:
            LogError: there is no such step, or they do not increase.
        """
        kept = np.asarray(steps, dtype=np.int64)
        if kept.ndim != 1 or len(kept) == 0 or np.any(np.diff(kept) <= 0) or kept[0] < 0 or kept[-1] >= self.num_poses:
            raise LogError(f"steps to keep must increase and lie between 0 and {self.num_poses - 1}")
        changes: dict[str, Any] = {"initial_poses": self.initial_poses[kept]}
        if self.true_poses is not None:
            changes["true_poses"] = self.true_poses[kept]
        if self.controls is not None and self.dt is not None:
            starts = self.control_starts[kept]
            used = slice(starts[0], starts[-1])
            times = self.times
            assert times is not None
            changes |= {"controls": self.controls[used], "dt": self.dt[used], "control_starts": starts - starts[0]}
            changes["start_time"] = float(times[kept[0]])
            if self.control_variances is not None:
                changes["control_variances"] = self.control_variances[used]
        seen = np.isin(self.steps, kept)
        changes["steps"] = np.searchsorted(kept, self.steps[seen])
        return replace(self, landmarks=self.landmarks[seen], sightings=self.sightings[seen], **changes)

    def where_seen(self) -> Log:
        """The log with only the poses that saw something, see `at_steps`.

        Raises:
            LogError: nothing was seen at all.
        """
        if len(self.steps) == 0:
            raise LogError(f"{self.name} has no sightings at all, so no pose would be left")
        return self.at_steps(np.unique(self.steps))

    def replace(self, **changes: Any) -> Log:
        """The same log with some arguments exchanged.

        Other controls bring their own ``control_starts`` and ``control_variances``, unless there are as many as before.
        """
        if "controls" in changes and (
            changes["controls"] is None or self.controls is None or len(changes["controls"]) != len(self.controls)
        ):
            changes = {"control_starts": None, "control_variances": None} | changes
        return replace(self, **changes)

    def equals(self, other: Log) -> bool:
        """Whether both logs hold the same numbers, bit for bit (names and notes aside)."""
        for key in (
            "dt", "controls", "control_starts", "control_variances", "steps", "landmarks", "sightings", "initial_poses",
            "true_poses",
        ):  # fmt: skip
            a, b = getattr(self, key), getattr(other, key)
            if (a is None) != (b is None) or (a is not None and not np.array_equal(a, b, equal_nan=True)):
                return False
        for key in ("start_time", "motion", "sensor"):
            if getattr(self, key) != getattr(other, key):
                return False
        a, b = self.true_landmarks, other.true_landmarks
        if (a is None) != (b is None):
            return False
        return a is None or b is None or (a.keys() == b.keys() and all(np.array_equal(a[j], b[j]) for j in a))


def _checked_starts(starts: np.ndarray | None, controls: Array | None) -> np.ndarray | None:
    if controls is None:
        if starts is not None:
            raise LogError("control_starts without controls: there is nothing that they divide")
        return None
    if starts is None:
        return np.arange(len(controls) + 1)
    starts = np.array(starts)
    if starts.ndim != 1 or len(starts) == 0 or starts.dtype.kind not in "iu":
        raise LogError(
            f"control_starts must be whole numbers, one per pose, not {starts.dtype} of shape {starts.shape}"
        )
    if starts[0] != 0 or starts[-1] != len(controls) or np.any(np.diff(starts) <= 0):
        raise LogError(
            f"control_starts must increase from 0 to the number of controls, {len(controls)}: every motion has a control"
        )
    return starts.astype(np.int64)


def _truth(value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """True poses checked: rows that are whole, or positions, or not known at all."""
    array = np.array(value, dtype=float)
    if array.shape == shape and len(array):
        unknown = np.isnan(array)
        # x and y are known together, a heading only with them
        rows = (unknown[:, 0] == unknown[:, 1]) & (unknown[:, 2] | ~unknown[:, 0])
        if not np.all(rows):
            raise LogError(
                f"true_poses[{int(np.argmin(rows))}] is {array[np.argmin(rows)]}; a row is whole, (x, y, NaN) or all NaN"
            )
        array[unknown] = 0.0
        array = _floats("true_poses", array, shape)
        array[unknown] = np.nan
        return array
    return _floats("true_poses", array, shape)


def _floats(name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> Array:
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise LogError(f"{name} must be an array of numbers: {error}") from None
    if array.ndim != len(shape) or any(want is not None and want != have for want, have in zip(shape, array.shape)):
        wanted = ", ".join("any" if want is None else str(want) for want in shape)
        raise LogError(f"{name} must have shape ({wanted}), not {array.shape}")
    if not np.all(np.isfinite(array)):
        where = np.argwhere(~np.isfinite(array))[0].tolist()
        raise LogError(f"{name}{where} is {array[tuple(where)]}; all numbers must be finite")
    return array


def _integers(name: str, value: ArrayLike, length: int) -> np.ndarray:
    array = np.asarray(value)
    if array.size == 0:
        array = array.astype(np.int64).reshape(-1)
    if array.shape != (length,):
        raise LogError(f"{name} must have one entry per sighting, shape ({length},), not {array.shape}")
    with np.errstate(invalid="ignore"):
        whole = array.astype(np.int64)
    if not np.array_equal(whole, array):
        raise LogError(f"{name} must be whole numbers")
    return whole.copy()


def _frozen(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        value.flags.writeable = False
    elif isinstance(value, Mapping):
        for array in value.values():
            array.flags.writeable = False
    return value
