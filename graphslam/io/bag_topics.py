"""An open bag: its topics and messages, and what each topic can be.

Errors of ``rosbags`` become one sentence with the file and the likely cause. Which fields of a message type make the columns
of a stream is decided by the type's definition. A field is named by its path: ``pose.pose.position.x``, or
``detections[].id`` in each element of a list.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path
from typing import Any

from ..errors import FormatError, checks, named, quoted, shortened
from ..files import check_unpacked, first_bytes
from ..log.table import NAMES, plain

#: the first bytes of files
MAGIC = {"ROS 1": b"#ROSBAG V", "MCAP": b"\x89MCAP0\r\n", "SQLite": b"SQLite format 3\x00"}
#: the suffix of each kind of file
SUFFIXES = {".bag": "ROS 1", ".mcap": "MCAP", ".db3": "SQLite"}
INSTALL = "bags are read by the package rosbags: pip install -e '.[ros]' in the clone, or pip install rosbags"


@dataclass(frozen=True)
class Topic:
    """A topic of a bag.

    Attributes:
        name, type: "/odom", "nav_msgs/msg/Odometry".
        count: the number of its messages.
    """

    name: str
    type: str
    count: int


@dataclass(frozen=True)
class Bag:
    """An open bag.

    Attributes:
        path: the file or folder.
        topics: in the order of their names.
        types: field definitions by type, of ``rosbags``.
        reader: of ``rosbags``.
    """

    path: Path
    topics: tuple[Topic, ...]
    types: Any
    reader: Any

    def messages(self, topics: Sequence[str]) -> Iterator[tuple[str, int, Any]]:
        """(topic, time of recording [ns], message) of some topics; the bag is streamed.

        Raises:
            FormatError: a message cannot be read.
        """
        connections = [each for each in self.reader.connections if each.topic in topics]
        if not connections:
            return
        count = 0
        with _errors(self.path, lambda: f" after {count} messages"):
            for connection, time, raw in self.reader.messages(connections=connections):
                count += 1
                yield connection.topic, time, self.reader.deserialize(raw, connection.msgtype)


def is_bag(path: Path, head: bytes) -> bool:
    """Whether a file or folder is a bag, by its first bytes or its metadata."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    return head.startswith((MAGIC["ROS 1"], MAGIC["MCAP"])) or path.suffix.lower() in SUFFIXES


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Open a bag.

    Raises:
        FormatError: it cannot be read; the message has the likely cause.
    """
    _check_head(path)
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise FormatError(path, None, INSTALL) from None
    with _errors(path):
        # the definitions of older bags of ROS 2, which have none of their own
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        reader.open()
    try:
        with _errors(path):
            found = sorted(reader.topics.items())
            topics = tuple(Topic(name, info.msgtype or "several types", info.msgcount) for name, info in found)
        if not all(isinstance(text, str) for topic in topics for text in (topic.name, topic.type)):
            raise FormatError(path, None, "the name or type of a topic is no text; was the file damaged?")
        yield Bag(path, topics, reader.typestore.fielddefs, reader)
    finally:
        reader.close()


def _check_head(path: Path) -> None:
    """Raise `FormatError` for a file that is empty, compressed as a whole, or begins as no bag does."""
    if path.is_dir():
        return
    if not (head := first_bytes(path)):
        raise FormatError(path, None, "the file is empty; was the recording ended before anything was written?")
    check_unpacked(path, head)
    for suffix, kind in SUFFIXES.items():
        if head.startswith(MAGIC[kind]) and path.suffix.lower() in SUFFIXES and path.suffix.lower() != suffix:
            message = f"its content is that of {kind}; give it the name {path.with_suffix(suffix).name}"
            raise FormatError(path, None, message)
    if not head.startswith(tuple(MAGIC.values())):
        cause = "was it overwritten, or is it another kind of file with this name?"
        raise FormatError(path, None, f"not a readable bag: it does not begin as one of ROS 1, MCAP or SQLite; {cause}")


@contextmanager
def _errors(path: Path, where: Any = lambda: "") -> Iterator[None]:
    """Turn whatever ``rosbags`` raises about damaged files into a `FormatError`."""
    try:
        yield
    except FormatError:
        raise
    except OSError as error:
        raise FormatError(path, None, f"cannot be read: {error.strerror or error}") from None
    except Exception as error:  # damaged files raise whatever the parser stumbles over
        raise FormatError(path, None, _cause(path, error) + where()) from None


def _cause(path: Path, error: Exception) -> str:
    """A sentence on a damaged or unknown file."""
    text = shortened(" ".join(str(error).split()).rstrip(".")) or type(error).__name__
    kind = "folder" if path.is_dir() else path.suffix.lower()
    if "not indexed" in text or "index looks damaged" in text:
        return f"the bag has no complete index, it was cut short; repair it first: rosbag reindex {path.name}"
    if "end magic" in text or "footer" in text or "Truncated" in text or "summary offset" in text:
        return f"the bag was cut short ({text}); repair it first: mcap recover {path.name} -o repaired.mcap"
    if "Profile is not ros2" in text or (kind == ".mcap" and isinstance(error, KeyError)):
        reason = "the messages of this MCAP file are not those of ROS 2 (Protobuf, JSON, or ROS 1)"
        return f"{reason}; convert it to ROS 2 first, or export tables"
    if "CDR encapsulation" in text and path.is_file():
        folder = "name the folder of the recording, with metadata.yaml, where messages are compressed one by one"
        return f"its messages cannot be decoded; {folder}; or the file is damaged"
    if "no type definitions" in text or "TypesysError" in type(error).__name__:
        return f"the bag lacks the definition of a message type ({text}); convert it to MCAP, which holds them"
    return f"not a readable bag ({text}); was it cut short?"


#: nodes of definitions in rosbags: a base type, a named type, an array and a sequence
_BASE, _NAME, _ARRAY, _SEQUENCE = 1, 2, 3, 4
_DEEPEST = 8


def leaves(types: Any, type: str) -> dict[str, str]:
    """The fields of a message type that hold numbers or text: {path: base type}.

    A list of messages adds [] to the path. Lists of numbers are left out, except those that could be an id.
    """
    return dict(_leaves(types, type, "", 0))


def _leaves(types: Any, type: str, prefix: str, depth: int) -> Iterator[tuple[str, str]]:
    if depth > _DEEPEST or type not in types:
        return
    for name, (node, value) in types[type][1]:
        path = f"{prefix}{name}"
        if node == _BASE:
            yield path, value[0]
        elif node == _NAME:
            yield from _leaves(types, value, f"{path}.", depth + 1)
        else:
            inner, content = value[0]
            if inner == _NAME:
                yield from _leaves(types, content, f"{path}[].", depth + 1)
            elif name.endswith("id"):
                yield f"{path}[]", content[0]


def lists(path: str) -> str:
    """The path of the list whose elements are rows, "detections" of "detections[].id"; empty where there is none."""
    return path.partition("[].")[0] if "[]." in path else ""


def getter(path: str) -> Callable[[Any], Any]:
    """The value of a path in a message or element; of a list within it the first entry, None where it is empty."""
    begin, brackets, rest = path.partition("[]")
    first, inner = attrgetter(begin), getter(rest.lstrip(".")) if rest else None
    if not brackets:
        return first

    def value(message: Any) -> Any:
        entries = first(message)
        if len(entries) == 0:
            return None
        return inner(entries[0]) if inner else entries[0]

    return value


_TRUTH = re.compile(r"truth|(^|[/_])gt([/_]|$)|ground|vicon|mocap|optitrack|vrpn|qualisys|natnet|gazebo|reference|rtk")
_WHEELS = re.compile(r"odom|wheel|encoder")
_SEEN = re.compile(r"tag|landmark|detect|marker|obs|sight|fiducial|aruco|beacon|cone|tree|pole|feature")
_NOT_SEEN = re.compile(r"particle|map|path|plan|goal|visual|rviz|debug|costmap")
#: packages whose types are known: only these of them can be anything
_STANDARD = (
    "nav_msgs", "sensor_msgs", "geometry_msgs", "tf2_msgs", "tf", "std_msgs", "rcl_interfaces", "diagnostic_msgs",
    "visualization_msgs", "rosgraph_msgs", "vision_msgs", "statistics_msgs", "action_msgs", "trajectory_msgs", "stereo_msgs",
    "builtin_interfaces", "dynamic_reconfigure", "actionlib_msgs", "shape_msgs", "lifecycle_msgs", "foxglove_msgs",
)  # fmt: skip
#: type -> (what it could be, how well it suits)
_KNOWN = {
    "nav_msgs/msg/Odometry": ("odometry", 4.0),
    "geometry_msgs/msg/TwistStamped": ("odometry", 3.0),
    "geometry_msgs/msg/TwistWithCovarianceStamped": ("odometry", 3.0),
    "geometry_msgs/msg/Twist": ("odometry", 2.0),
    "geometry_msgs/msg/PoseStamped": ("truth", 2.0),
    "geometry_msgs/msg/PoseWithCovarianceStamped": ("truth", 1.0),
    "sensor_msgs/msg/NavSatFix": ("positions", 0.0),
    "geometry_msgs/msg/TransformStamped": ("truth", 1.5),
    "vision_msgs/msg/Detection3DArray": ("sightings", 4.0),
    "visualization_msgs/msg/MarkerArray": ("sightings", 2.0),
    "geometry_msgs/msg/PoseArray": ("sightings", 1.5),
    "vision_msgs/msg/Detection2DArray": ("sightings", 1.0),
}
TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")


@dataclass(frozen=True)
class Candidate:
    """A topic with its possible role and the score of that; ``chosen`` is the role for which it would be read."""

    topic: Topic
    could_be: str = ""
    score: float = 0.0
    chosen: str = ""


def candidates(bag: Bag) -> list[Candidate]:
    """Every topic of a bag with what it could be; the best of each kind is chosen.

    Truth is chosen only where the name of a topic says that it is one.
    """
    found = [Candidate(topic, *_could_be(bag, topic)) for topic in bag.topics]
    best: dict[str, Candidate] = {}
    for each in sorted(found, key=lambda each: (each.score, each.topic.count), reverse=True):
        if each.could_be and each.topic.count > 0 and each.score > 0:
            best.setdefault(each.could_be, each)
    return [replace(each, chosen=each.could_be) if best.get(each.could_be) is each else each for each in found]


def _could_be(bag: Bag, topic: Topic) -> tuple[str, float]:
    name = topic.name.lower()
    kind, score = _KNOWN.get(topic.type) or _by_fields(bag, topic)
    if not kind:
        return "", 0.0
    if kind == "odometry" and _TRUTH.search(name):
        return "truth", score
    if kind == "odometry":
        return kind, score + (2.0 if _WHEELS.search(name) else 0.0) - (1.0 if "cmd" in name else 0.0)
    if kind == "truth":
        return kind, score if _TRUTH.search(name) else 0.0
    return kind, score + (1.0 if _SEEN.search(name) else 0.0) - (3.0 if _NOT_SEEN.search(name) else 0.0)


def _by_fields(bag: Bag, topic: Topic) -> tuple[str, float]:
    """The role of a message type of another package, by the names of its fields."""
    if topic.type.partition("/")[0] in _STANDARD:
        return "", 0.0
    paths = leaves(bag.types, topic.type)
    rows = {lists(path) for path in paths}
    for row in sorted(rows, reverse=True):
        inside = [_in_row(path, row) for path in paths if lists(path) == row]
        has = {role for role in NAMES if any(matches(role, path) for path in inside)}
        place = {"range", "bearing"} <= has or any(path.endswith((".position.x", ".translation.x")) for path in inside)
        if "id" in has and (place or {"x", "y"} <= has):
            return "sightings", 5.0 if row else 3.0
        if not row and {"nu", "omega"} <= has:
            return "odometry", 2.5
    return "", 0.0


def matches(role: str, path: str) -> bool:
    """Whether the name of a field is one that a column of this role has."""
    own, _ = plain(path.replace("[]", ""))
    if role == "id" and ("frame" in own or "seq" in own):
        return False
    return own in NAMES[role] or any(len(each) > 1 and own.endswith(f"_{each}") for each in NAMES[role])


#: what columns a stream can have beside poses
_PLAIN = {
    "odometry": ("nu", "omega", "x", "y", "theta"),
    "sightings": ("range", "bearing", "orientation", "x", "y"),
    "truth": ("x", "y", "theta"),
}
#: which of them are enough
_NEEDS = {
    "odometry": ({"nu", "omega"}, {"x", "y", "theta"}),
    "sightings": ({"range", "bearing"}, {"x", "y"}),
    "truth": ({"x", "y"},),
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
    columns = {role: _stated(source, role, str(path), inside, row) for role, path in stated.items()}
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
            if f"{twist}linear.y" in inside:
                columns["vy"] = f"{twist}linear.y"
        elif not places:
            for role in _PLAIN[kind]:
                if path := next((path for path in inside if matches(role, path)), ""):
                    columns[role] = path
    look = columns.pop("class", "")
    id = columns.pop("id", "") or _id([path for path in inside if path != look])
    look = look or _look([path for path in inside if path != id])
    if not places and not any(need <= columns.keys() for need in _NEEDS[kind]):
        raise FormatError(source, None, f"its messages, {type}, give no {kind}; {_GIVES[kind]}")
    if kind != "sightings":
        id = look = ""
    stamp = "row" if "header.stamp.sec" in inside else "message" if "header.stamp.sec" in paths else ""
    child = "child_frame_id" if "child_frame_id" in inside else ""
    return Plan(row, columns, tuple(places), id, look, stamp, child, action=row == "markers" and "action" in inside)


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
    hint = checks.suggestion(wanted, inside) or f"; it has {named(inside)}"
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
