"""Odometry of a robot with two driven wheels: the columns of their speeds, and (nu, omega) from them.

    nu = (v_right + v_left) / 2,   omega = (v_right - v_left) / track

Errors of the track and of the scales of both wheels are errors of nu and omega with constant factors, which the biases
``wheel_scale``, ``turn_scale`` and ``curvature_bias`` are.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from ..errors import named
from ..errors.checks import QUICKEST
from ..se2 import Array
from .table import Chosen, Table, plain

#: the roles of the columns
WHEELS = ("left", "right")
_SIDES = ({"left", "l"}, {"right", "r"})
_STATE = "columns='odometry.left=NAME,odometry.right=NAME'"


def _two(names: Collection[str]) -> list[str]:
    """The names of columns of a left and a right wheel; empty unless there are both."""
    words = {name: set(plain(name)[0].split("_")) for name in names}
    sides = [[name for name, parts in words.items() if parts & side] for side in _SIDES]
    return [*sides[0], *sides[1]] if all(sides) else []


def motion_of(table: Table, found: Mapping[str, Chosen], track: float | None) -> tuple[str, ...]:
    """The roles of the columns of the motion: nu and omega, x and y, or the speeds of two wheels, with omega or a track.

    A track says that the speeds of the wheels are used.

    Raises:
        LogError: columns of wheels cannot be used as they are; with what to state.
    """
    has = found.keys()
    if {"nu", "omega"} <= has and track is None:
        if table.names and (sides := _two([table.names[found[role].column] for role in ("nu", "omega")])):
            raise table.error(
                None,
                f"{named(sides)} seem to be speeds of the left and the right wheel, and not nu and omega, which are made of "
                f"them: columns='odometry.left={sides[0]},odometry.right={sides[1]}', track=METRES",
            )
        return "nu", "omega"
    if {"x", "y"} <= has and track is None:
        return "x", "y"
    if not {*WHEELS} <= has:
        if track is not None:
            raise table.error(None, f"there is a track, but no speeds of two wheels; say which they are: {_STATE}")
        if sides := _two(table.names):
            raise table.error(
                None,
                f"{named(sides)} seem to be of the left and the right wheel. If they are speeds, add {_STATE}, track=METRES "
                "(the distance between the wheels); travel and ticks are not read: make speeds of their differences from row "
                "to row",
            )
        return "nu", "omega"
    titles = " and ".join(table.title(found[role].column) for role in WHEELS)
    if any(found[role].unit in ("radians", "degrees") for role in WHEELS):
        raise table.error(
            None, f"{titles} are turn rates of the wheels; multiply them by the radius, so that they are in m/s"
        )
    if track is None and "omega" not in has:
        raise table.error(
            None,
            f"{titles} seem to be the speeds of the left and the right wheel; add the distance between the wheels: "
            "track=METRES",
        )
    return (*WHEELS, "omega") if track is None else WHEELS


def controls_of(table: Table, speeds: Array, track: float | None) -> tuple[Array, tuple[str, ...]]:
    """The controls (N, 2) of the speeds (N, 2) of the left and the right wheel, or (N, 3) with the turn rate; and a note.

    Raises:
        LogError: the robot would turn faster than robots do.
    """
    left, right = speeds[:, 0], speeds[:, 1]
    if track is None:
        note = "nu is the mean of the speeds of the left and the right wheel"
        return np.column_stack([(left + right) / 2, speeds[:, 2]]), (f"{table.source}: {note}",)
    omega = (right - left) / track
    if len(omega) and (usual := float(np.quantile(np.abs(omega), 0.95))) > QUICKEST:
        raise table.error(
            None, f"by the speeds of the wheels the robot turns by {usual:.3g} rad/s: is track in metres?"
        )
    note = (
        f"nu and omega are those of the left and the right wheel, {track:g} m apart; errors of this track and of the wheels' "
        "scales are wheel_scale, turn_scale and curvature_bias"
    )
    return np.column_stack([(left + right) / 2, omega]), (f"{table.source}: {note}",)
