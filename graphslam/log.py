"""What a robot did and saw: the one object that every estimator takes, and the truth where it is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .errors import LogError
from .models import MotionModel
from .se2 import Array, wrap


@dataclass(frozen=True, eq=False, kw_only=True)
class Log:
    """A log of T motions and M sightings. All arrays are copied, checked and made read-only.

    Args:
        dt: duration of each motion [s], (T,) or one number; None together with ``controls``.
        controls: u_t = (nu, omega) [m/s, rad/s], (T, 2); row t drives pose t to pose t+1. None where there are none.
        steps: the step in which each sighting was made, (M,), not decreasing.
        landmarks: the id of the landmark seen, (M,) integers.
        sightings: (l, phi) or (l, phi, psi) [m, rad, rad], (M, 2) or (M, 3); angles are wrapped to [-pi, pi).
        initial_poses: (T+1, 3), the first guess of the trajectory; default: dead reckoning from (0, 0, 0). Headings
            may count turns (they are not wrapped).
        true_poses: (T+1, 3), or None where unknown.
        true_landmarks: {id: (x, y) or (x, y, heading)}, or None where unknown.
        start_time: the time of step 0 [s].
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
        initial = self.initial_poses
        if initial is None:
            if controls is None:
                raise LogError("a log without controls needs initial_poses: there is nothing to reckon them from")
            initial = MotionModel().dead_reckoning(np.zeros(3), controls, dt)
        initial = _floats("initial_poses", initial, (None if controls is None else len(controls) + 1, 3))
        if len(initial) == 0:
            raise LogError("initial_poses is empty: a log has at least one pose")
        truth = _floats("true_poses", self.true_poses, initial.shape) if self.true_poses is not None else None

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
        """The ids of the landmarks that were seen, sorted."""
        return np.unique(self.landmarks)

    @property
    def times(self) -> Array | None:
        """The time of each pose [s], (T+1,); None without controls."""
        if self.dt is None:
            return None
        return self.start_time + np.concatenate([[0.0], np.cumsum(self.dt)])

    def without_orientation(self) -> Log:
        """The same log as a range-bearing sensor would have written it: psi left out."""
        return replace(self, sightings=self.sightings[:, :2])

    def replace(self, **changes: Any) -> Log:
        """The same log with some arguments exchanged."""
        return replace(self, **changes)

    def equals(self, other: Log) -> bool:
        """Whether both logs hold the same numbers, bit for bit (names and notes aside)."""
        for key in ("dt", "controls", "steps", "landmarks", "sightings", "initial_poses", "true_poses"):
            a, b = getattr(self, key), getattr(other, key)
            if (a is None) != (b is None) or (a is not None and not (a.shape == b.shape and np.array_equal(a, b))):
                return False
        a, b = self.true_landmarks, other.true_landmarks
        if (a is None) != (b is None) or self.start_time != other.start_time:
            return False
        return a is None or b is None or (a.keys() == b.keys() and all(np.array_equal(a[j], b[j]) for j in a))


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
