"""Cartesian sightings: range and bearing of places, and which axes x, y and z have where nobody says it.

On a robot that drives in the plane a landmark keeps its height over the sensor, while the two other coordinates change. A
camera has the height in y (right, down, ahead: OpenCV, AprilTag), other sensors in z.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress

import numpy as np

from ..errors import LogError
from ..se2 import Array
from .cells import Doubt
from .table import Chosen, Table

#: sightings that are needed, of landmarks that are seen several times or else of all
_FEWEST = 10
#: a coordinate stays where its spread is below this part of that of the others
_STAYS = 0.5
#: what is seen is ahead in this part of the sightings
_AHEAD = 0.99


def polar(places: Array) -> Array:
    """Range and bearing (N, 2) of places (N, 2), forward and left."""
    forward, left = places.T
    return np.column_stack([np.hypot(forward, left), np.arctan2(left, forward)])


def chosen_axes(
    table: Table, found: Mapping[str, Chosen], stated: str | None
) -> tuple[str, tuple[str, ...], tuple[Doubt, ...]]:
    """The axes of Cartesian sightings, one of `rows.AXES`, with notes and doubts about the choice.

    Args:
        table: the sightings.
        found: its columns, among them x and y, or x and z, or all of them.
        stated: the axes that the user states.
    """
    plain = "forward-left"
    if "z" not in found:
        return stated or plain, (), ()
    if "y" not in found:
        note = (
            f"{table.source}: x and z are taken as right and ahead, the axes of a camera (axes='optical'), because there is "
            "no y"
        )
        return stated or "optical", () if stated else (note,), ()
    shown = _shown(table, {role: each.column for role, each in found.items()})
    if shown == "unknown" or (stated and shown in (None, "optical" if stated == "optical" else plain)):
        return stated or plain, (), ()
    if stated:
        one, other = ("y", "z") if shown == "optical" else ("z", "y")
        message = (
            f"{table.source}: axes='{stated}' is stated, but {one} rather than {other} seems to be the height of the "
            f"landmarks; compare with axes='{shown}'"
        )
        return stated, (), (("axes", message),)
    if shown is None:
        message = (
            f"{table.source}: x and y are taken as ahead and left, and z as the height, but the numbers do not show that; if "
            "they are right, down and ahead, as of a camera, add axes='optical', and else axes='forward-left'"
        )
        return plain, (), (("axes", message),)
    notes = {
        plain: "x and y are taken as ahead and left, because z seems to be the height of the landmarks; if y is the height, "
        "add axes='optical'",
        "optical": "x, y and z are taken as right, down and ahead, the axes of a camera (axes='optical'), because y seems to "
        "be the height of the landmarks; if z is the height, add axes='forward-left'",
    }  # fmt: skip
    return shown, (f"{table.source}: {notes[shown]}",), ()


def _shown(table: Table, columns: dict[str, int]) -> str | None:
    """The axes that the numbers show, "optical" or "forward-left"; None where they show none, "unknown" if too few."""
    places = np.full((0, 3), np.nan)
    # a column of words has its error where it is read
    with suppress(LogError):
        places = table.numbers([columns[axis] for axis in "xyz"])
    known = np.isfinite(places).all(axis=1)
    places = places[known]
    landmarks, often = np.zeros(len(places), dtype=int), np.ones(len(places), dtype=bool)
    if "id" in columns:
        _, names = np.unique(table.texts(columns["id"])[known], return_inverse=True)
        again = np.bincount(names)[names] > 2
        if np.sum(again) >= _FEWEST:
            landmarks, often = names, again
    if len(places) < _FEWEST:
        return "unknown"
    from_middle = places.copy()
    for rows in np.split(np.argsort(landmarks, kind="stable"), np.cumsum(np.bincount(landmarks))[:-1]):
        from_middle[rows] -= np.median(places[rows], axis=0)
    x, y, z = np.mean(np.abs(from_middle[often]), axis=0)
    ahead = np.mean(places > 0, axis=0) > _AHEAD
    # along a straight way the distance to the side stays, too, so that the one ahead changes by far the most
    optical = ahead[2] and (y < _STAYS * min(x, z) or max(x, y) < _STAYS * z)
    robot = z < _STAYS * min(x, y) or (ahead[0] and max(y, z) < _STAYS * x)
    if optical == robot:
        return None
    return "optical" if optical else "forward-left"
