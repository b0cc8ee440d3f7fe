"""Arguments of particle filters: numbers, or an `OptionError` that says what was expected."""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from graphslam.errors import OptionError, quoted
from graphslam.errors.checks import (
    check_number,
    check_sighted,
    checked_covariance,
    checked_pose,
    finite_numbers,
    real_array,
)
from graphslam.log.measurements import AbsolutePositions
from graphslam.log.rows import NO_ID, UNIDENTIFIED
from graphslam.se2 import Array, wrap

#: a larger turn in one step [rad] is an error in the input, and the engine's sine is not made for it
LARGEST_TURN = 1e5
#: a longer way in one step [m], 25 times round the Earth, is an error in the input
LARGEST_WAY = 1e9


def index(name: str, value: Any, count: int) -> int:
    """Return a whole number between 0 and count - 1, of Python or NumPy; True and False are refused."""
    try:
        if isinstance(value, (bool, np.bool_)):
            raise TypeError
        number = operator.index(value)
    except TypeError:
        raise OptionError(f"{name} must be a whole number, not {quoted(value)}") from None
    if not 0 <= number < count:
        raise OptionError(f"there is no {name} {number}: they are numbered 0 to {count - 1}")
    return number


def measurements(ids: Any, sightings: ArrayLike, by_ids: bool) -> tuple[np.ndarray, Array]:
    """Return ids (k,) and sightings (k, 2 or 3) as arrays, angles wrapped; ids None stands for k unknown ids.

    One of range and bearing may be NaN, which was not measured then, if the sightings have no psi. Where the association is
    ``by_ids``, each sighting needs the id of its landmark.
    """
    if ids is None and by_ids:
        raise OptionError(
            "ids may be None only if they are ignored (association maximum-likelihood); give the id of each sighting"
        )
    try:
        z = real_array(sightings).copy()
        numbers = np.zeros(len(z), dtype=np.int64) if ids is None else np.asarray(ids)
        if numbers.size == 0 and z.size == 0:
            return numbers, np.empty((0, 2))
        if z.ndim != 2 or z.shape[1] not in (2, 3) or numbers.shape != (len(z),):
            raise ValueError
    except (TypeError, ValueError, OverflowError):
        expected = "whole numbers (k,) and sightings (k, 2) or (k, 3)"
        raise OptionError(f"observe takes {expected}, not {quoted(ids)} and {quoted(sightings)}") from None
    if numbers.dtype.kind not in "iu":
        raise OptionError(f"the ids of landmarks must be whole numbers, not {quoted(numbers.tolist())}")
    if numbers.dtype.kind == "u" and np.any(numbers > np.iinfo(np.int64).max):
        raise OptionError(f"the ids of landmarks must be below 2^63, not {quoted(int(np.max(numbers)))}")
    numbers = numbers.astype(np.int64)
    if by_ids and np.isin(numbers, (UNIDENTIFIED, NO_ID)).any():
        raise OptionError(
            "the filter takes identified landmarks only: leave out what nobody has identified, or use FastSLAM with the "
            "association maximum-likelihood"
        )
    missing = np.isnan(z)
    if not np.all(np.isfinite(z) | missing) or np.any(z[:, 0] <= 0) or np.any(missing.sum(axis=1) > (z.shape[1] == 2)):
        raise OptionError(
            "sightings must be finite and their ranges above zero; NaN stands for a range or a bearing that was not "
            "measured, in sightings without psi"
        )
    check_sighted("sightings", (np.nanmin(z[:, 1:], initial=0.0), np.nanmax(z[:, 1:], initial=0.0)))
    z[:, 1:] = wrap(z[:, 1:])
    return numbers, z


def check_motion(step: int, way: float, turn: float) -> None:
    """Raise `OptionError` where the way [m] or the turn [rad] of a step, with its noise, is an error in the input."""
    if not (way <= LARGEST_WAY and turn <= LARGEST_TURN):
        raise OptionError(
            f"step {step}: the control and its noise move the robot by up to {way:g} m and turn it by up to {turn:g} rad; "
            f"more than {LARGEST_WAY:g} m or {LARGEST_TURN:g} rad is refused"
        )


def checked_control(control: Any, dt: Any) -> tuple[Array, float]:
    """Return a control (nu, omega) and its time [s], or raise `OptionError`."""
    u = finite_numbers("control", control, (2,))
    check_number(dt=dt)
    if dt < 0:
        raise OptionError(f"dt must be 0 s or longer, not {quoted(dt)}")
    return u, float(dt)


def checked_motion(motion: Any, covariance: Any) -> tuple[Array, Array]:
    """Return a motion (1, 3) and its covariance (1, 3, 3), or raise `OptionError`."""
    z, P = checked_pose("motion", motion), finite_numbers("covariance", covariance, (3, 3))
    if not np.allclose(P, P.T) or np.linalg.eigvalsh(P)[0] < -1e-12 * np.abs(P).max():
        raise OptionError(f"covariance must be symmetric positive semidefinite, not {quoted(covariance)}")
    return z[None], P[None]


def one_position(position: Any, covariance: Any, lever: Any) -> AbsolutePositions:
    """A position (x, y) or (x, y, theta) as the only row of positions, or `OptionError`."""
    place, arm = finite_numbers("position", position, (2,), (3,)), finite_numbers("lever", lever, (2,))
    return AbsolutePositions(
        steps=np.zeros(1, dtype=np.int64), places=place[None], covariances=checked_covariance(covariance, len(place)),
        levers=arm,
    )  # fmt: skip
