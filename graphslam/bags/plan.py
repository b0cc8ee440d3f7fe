"""Which fields of a message type make the columns of a stream, decided by the type's definition."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..checks import suggestion
from ..errors import FormatError, named, quoted
from .candidates import matches
from .paths import leaves, lists

#: what columns a stream can have beside poses
_PLAIN = {
    "odometry": ("nu", "omega", "x", "y", "theta"),
    "sightings": ("range", "bearing", "orientation", "x", "y"),
    "truth": ("x", "y", "theta"),
}
#: message types that give each stream, for messages
_GIVES = {
    "odometry": "nav_msgs/Odometry, geometry_msgs/Twist, TwistStamped and TF do",
    "sightings": "arrays of detections with ids and poses do (apriltag, vision_msgs, MarkerArray, PoseArray), and TF",
    "truth": "nav_msgs/Odometry, geometry_msgs/PoseStamped and TF do",
}
_PLACES = ("position", "translation", "point")
_TURNS = {"position": "orientation", "translation": "rotation"}


@dataclass(frozen=True)
class Plan:
    """The conversion of messages to rows.

    Attributes:
        row: the list whose elements are rows; empty where each message is one.
        columns: {column: path in a row}. A pose whose position is at P has columns "P.x", "P.y", "P.z" and, where it has an
            orientation, "P.qx" to "P.qw".
        places: the positions P, best first.
        id, look: paths of the id and of the class; empty where there is none.
        stamp: whether the "row" or the "message" has the time; empty where neither has.
        frame: path of the name of the frame in the row or message that has the time.
        child: path of the name of the frame that moves; empty where there is none.
        action: whether rows can be deletions (visualization_msgs/Marker).
    """

    row: str
    columns: Mapping[str, str]
    places: tuple[str, ...]
    id: str = ""
    look: str = ""
    stamp: str = ""
    child: str = ""
    action: bool = False


def plan_of(source: str, kind: str, type: str, types: Any, stated: Mapping[str, str | int]) -> Plan:
    """The plan for a topic.

    Args:
        source: bag and topic, for messages.
        kind: odometry, sightings or truth.
        type: of the messages.
        types: definitions of ``rosbags``.
        stated: {role: path of the field}, what the user says.

    Raises:
        FormatError: the type has no such fields.
    """
    paths = leaves(types, type)
    row = _row(kind, paths, stated)
    inside = [_in_row(path, row) for path in paths if lists(path) == row]
    columns: dict[str, str] = {}
    for role, path in stated.items():
        columns[role] = _stated(source, role, str(path), inside, row)
    places: list[str] = []
    if not columns.keys() - {"id", "class"}:
        places = _places(inside)
        for place in places:
            columns |= {f"{place}.{axis}": f"{place}.{axis}" for axis in "xyz"}
            turn = _turn(place)
            if f"{turn}.w" in inside:
                columns |= {f"{place}.q{axis}": f"{turn}.{axis}" for axis in "xyzw"}
        twist = next((path.removesuffix("linear.x") for path in inside if path.endswith("linear.x")), None)
        if kind == "odometry" and twist is not None and f"{twist}angular.z" in inside:
            columns |= {"nu": f"{twist}linear.x", "omega": f"{twist}angular.z"}
        elif not places:
            for role in _PLAIN[kind]:
                if path := next((path for path in inside if matches(role, path)), ""):
                    columns[role] = path
    look = columns.pop("class", "")
    id = columns.pop("id", "") or _id([path for path in inside if path != look])
    look = look or _look([path for path in inside if path != id])
    if not _enough(kind, columns, places):
        raise FormatError(source, None, f"its messages, {type}, give no {kind}; {_GIVES[kind]}")
    return Plan(
        row,
        columns,
        tuple(places),
        id if kind == "sightings" else "",
        look if kind == "sightings" else "",
        "row" if "header.stamp.sec" in inside else "message" if "header.stamp.sec" in paths else "",
        "child_frame_id" if "child_frame_id" in inside else "",
        row == "markers" and "action" in inside,
    )


def _row(kind: str, paths: Mapping[str, str], stated: Mapping[str, str | int]) -> str:
    """The list whose elements are the rows."""
    for path in map(str, stated.values()):
        for known in paths:
            if path.replace("[]", "") in (known.replace("[]", ""), _in_row(known, lists(known)).replace("[]", "")):
                return lists(known)
    of_lists = {lists(path) for path in paths} - {""}
    # transforms of TF are rows for every kind
    return next(iter(sorted(of_lists)), "") if kind == "sightings" or of_lists == {"transforms"} else ""


def _in_row(path: str, row: str) -> str:
    return path.removeprefix(f"{row}[].") if row else path


def _stated(source: str, role: str, path: str, inside: list[str], row: str) -> str:
    wanted = _in_row(path, row).removeprefix(f"{row}.").replace("[]", "")
    for known in inside:
        if known.replace("[]", "") == wanted:
            return known
    hint = suggestion(wanted, inside) or f"; it has {named(inside)}"
    raise FormatError(source, None, f"its messages have no field {quoted(path)} for {role}{hint}")


def _places(inside: list[str]) -> list[str]:
    """Positions in space, results before boxes."""
    found = [
        path.removesuffix(".x")
        for path in inside
        if path.endswith(tuple(f"{place}.x" for place in _PLACES)) and f"{path[:-1]}z" in inside
    ]
    return sorted(found, key=lambda place: ("bbox" in place, "transform" not in place, place.count(".")))


def _turn(place: str) -> str:
    head, _, last = place.rpartition(".")
    return ".".join(filter(None, [head, _TURNS.get(last, "orientation")]))


def _id(inside: list[str]) -> str:
    """The id of a row: a field of its own before a class, the frame of TF otherwise."""
    fits = [path for path in inside if matches("id", path) and "frame" not in path and "seq" not in path]
    fits.sort(key=lambda path: (path.replace("[]", "") != "id", "class" not in path, path.count(".")))
    return fits[0] if fits else "child_frame_id" if "child_frame_id" in inside else ""


def _look(inside: list[str]) -> str:
    """The class of a row; the type of a message says nothing about what was seen."""
    fits = [path for path in inside if matches("class", path) and path.rpartition(".")[2] not in ("type", "kind")]
    return min(fits, key=lambda path: path.count("."), default="")


def _enough(kind: str, columns: Mapping[str, str], places: list[str]) -> bool:
    if kind == "odometry":
        return {"nu", "omega"} <= columns.keys() or {"x", "y", "theta"} <= columns.keys() or bool(places)
    if kind == "sightings":
        return {"range", "bearing"} <= columns.keys() or {"x", "y"} <= columns.keys() or bool(places)
    return {"x", "y"} <= columns.keys() or bool(places)
