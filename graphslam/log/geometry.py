"""The geometry of robot and sensor, where tables leave it open: motions between poses, and the axes of places.

The poses of odometry become the controls between them.

**Latitude and longitude** become metres east and north in the plane that touches the Earth (WGS 84) at a datum, the height of
which all places are taken to have: with a the half axis, e² the squared eccentricity and N = a / sqrt(1 - e² sin² lat),

    p = ((N + h) cos lat cos lon, (N + h) cos lat sin lon, (N (1 - e²) + h) sin lat),
    east = (-sin lon_0, cos lon_0, 0) (p - p_0),
    north = (-sin lat_0 cos lon_0, -sin lat_0 sin lon_0, cos lat_0) (p - p_0).

Source: Torge and Müller, *Geodesy*, 4th edition, section 4.1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..se2 import Array, between, sinc
from .cells import Doubt
from .table import Chosen, Table

if TYPE_CHECKING:
    from .log import Log

#: the major half-axis [m] and the squared eccentricity of the ellipsoid
_AXIS, _ECCENTRICITY = 6378137.0, 6.69437999014e-3


def _earth(degrees: Array, height: float) -> Array:
    """The point (..., 3) [m] at latitude and longitude (..., 2) and this height above the ellipsoid [m]."""
    latitude, longitude = np.moveaxis(np.radians(degrees), -1, 0)
    N = _AXIS / np.sqrt(1 - _ECCENTRICITY * np.sin(latitude) ** 2)
    along = (N + height) * np.cos(latitude)
    up = (N * (1 - _ECCENTRICITY) + height) * np.sin(latitude)
    return np.stack([along * np.cos(longitude), along * np.sin(longitude), up], axis=-1)


def _axes(datum: Array) -> Array:
    """The directions (2, 3) of east and north at a datum (latitude, longitude, height)."""
    phi, lam = np.radians(datum[:2])
    return np.array([
        [-np.sin(lam), np.cos(lam), 0.0],
        [-np.sin(phi) * np.cos(lam), -np.sin(phi) * np.sin(lam), np.cos(phi)],
    ])  # fmt: skip


def local_plane(fixes: Array, datum: Array) -> Array:
    """East and north (N, 2) [m] of latitudes and longitudes (N, 2) [degrees], in the plane that touches at the datum (3,).

    All are taken at the height of the datum.
    """
    return np.asarray((_earth(fixes, datum[2]) - _earth(datum[:2], datum[2])) @ _axes(datum).T)


def on_plane_of(datum: Array, places: Array, own: Array) -> Array:
    """Places (N, 2) [m] east and north of their own datum (3,) as those of another one; further columns stay."""
    way = _earth(own[:2], own[2]) - _earth(datum[:2], datum[2])
    return np.column_stack([(way + places[:, :2] @ _axes(own)) @ _axes(datum).T, places[:, 2:]])


def datum_note(datum: Array, what: str) -> str:
    """The sentence about the origin of positions, and what that is."""
    latitude, longitude = (f"{number:.8f}" for number in datum[:2])
    return f"positions are metres east and north of latitude {latitude}, longitude {longitude} degrees (WGS 84), {what}"


def with_datum(log: Log, datum: Array | None, what: str) -> Log:
    """The log with its positions as metres east and north of another datum, and a note on it, in which ``what`` it is.

    Positions without a datum stay as they are.
    """
    positions = log.positions
    if positions is None or datum is None:
        return log
    places, notes = positions.places.copy(), list(log.notes)
    for own in np.unique(positions.datums[np.isfinite(positions.datums[:, 0])], axis=0):
        if not np.array_equal(own, datum):
            rows = np.all(positions.datums == own, axis=1)
            places[rows] = on_plane_of(datum, places[rows], own)
            notes = [note for note in notes if datum_note(own, "") not in note] + [datum_note(datum, what)]
    if np.array_equal(places, positions.places, equal_nan=True):
        return log
    datums = np.where(np.isnan(positions.datums), np.nan, datum)
    return log.replace(positions=replace(positions, places=places, datums=datums), notes=tuple(dict.fromkeys(notes)))


def controls_between(poses: Array, dt: Array) -> tuple[Array, float]:
    """The controls (N, 2) that lead from each pose (N, 3) to the next on an arc, the last one zero.

    Args:
        poses: of the odometry.
        dt: (N-1,) [s], positive.

    Returns:
        The controls, and the share of the distance that is driven sideways, which arcs leave out.
    """
    relative = between(poses[:-1], poses[1:])
    half = relative[:, 2] / 2
    c, s = np.cos(half), np.sin(half)
    # the chord of an arc looks along half its turn
    along, across = c * relative[:, 0] + s * relative[:, 1], c * relative[:, 1] - s * relative[:, 0]
    controls = np.zeros((len(poses), 2))
    controls[:-1, 0] = along / (sinc(half) * dt)
    controls[:-1, 1] = relative[:, 2] / dt
    driven = float(np.sum(np.hypot(along, across)))
    return controls, float(np.sum(np.abs(across))) / driven if driven > 0 else 0.0


#: the check that finds robots that drive sideways: controls (nu, omega) do not
SIDEWAYS = "sideways"
#: poses, whose positions may jitter, and speeds that are sideways for a larger share of the way are no odometry of wheels
_POSES, _SPEEDS = 0.3, 0.1
#: where other motions are taken
_OTHER = "OnlineSolver.move(motion=..., covariance=...) takes motions in any direction"


def counts_turns(poses: Array) -> bool:
    """Whether the motion of poses (N, 3) says that headings of many turns are radians: as degrees, they move sideways."""
    shares = [controls_between(poses * [1, 1, unit], np.ones(len(poses) - 1))[1] for unit in (1, np.pi / 180)]
    return shares[0] < _POSES < shares[1]


def sideways_poses(table: Table, share: float) -> tuple[Doubt, ...]:
    """A doubt where the poses of odometry move sideways for a large share of their way."""
    message = (
        f"{table.source}: the poses move sideways for {share:.0%} of their way, which wheels cannot; the heading may be in "
        f"another unit, turn the other way, or not be the robot's. If the robot does drive sideways, {_OTHER}"
    )
    return ((SIDEWAYS, message),) if share > _POSES else ()


def sideways_speed(table: Table, title: str, speed: Array, lateral: Array) -> tuple[Doubt, ...]:
    """A doubt where the speeds sideways (N,), of the column ``title``, are a large share of those ahead (N,) and sideways."""
    lateral = np.abs(np.nan_to_num(lateral))
    driven = float(np.sum(np.hypot(speed, lateral)))
    share = float(np.sum(lateral)) / driven if driven > 0 else 0.0
    message = (
        f"{table.source}: the robot drives sideways ({title}) for {share:.0%} of its way, which controls (nu, omega) leave "
        f"out: dead reckoning is wrong, and estimates rest on the sightings; {_OTHER}"
    )
    return ((SIDEWAYS, message),) if share > _SPEEDS else ()


def polar(places: Array) -> Array:
    """Range and bearing (N, 2) of places (N, 2), forward and left."""
    forward, left = places.T
    return np.column_stack([np.hypot(forward, left), np.arctan2(left, forward)])


def seen_from(place: tuple[float, float], sightings: Array) -> Array:
    """Sightings (N, 2 or 3) from the origin of the robot's axes, as from a place in them; psi turns with the bearing."""
    r, phi = sightings[:, :2].T
    seen = polar(np.column_stack([r * np.cos(phi), r * np.sin(phi)]) - place)
    return np.column_stack([seen, sightings[:, 2:] + (seen[:, 1] - phi)[:, None]])


def chosen_axes(table: Table, found: Mapping[str, Chosen], stated: str | None) -> str:
    """The axes of Cartesian sightings, one of `rows.AXES`: those that are ``stated``, else forward-left.

    Raises:
        LogError: none are stated, and there is a z among the columns ``found``: it may be the height, or ahead of a camera.
    """
    if stated is None and "z" in found:
        raise table.error(
            None,
            "the sightings have a z: state axes='optical' (x right, y down, z ahead, as of a camera: OpenCV, AprilTag), or "
            "axes='forward-left' (x ahead, y left, z up)",
        )
    return stated or "forward-left"
