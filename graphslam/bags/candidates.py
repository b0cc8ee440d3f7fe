"""The possible roles of the topics of a bag, and which of them would be chosen."""

from __future__ import annotations

import re
from dataclasses import dataclass

from ..tables.columns import NAMES, plain
from .bag import Bag, Topic
from .paths import leaves, lists

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
    "geometry_msgs/msg/TransformStamped": ("truth", 1.5),
    "vision_msgs/msg/Detection3DArray": ("sightings", 4.0),
    "visualization_msgs/msg/MarkerArray": ("sightings", 2.0),
    "geometry_msgs/msg/PoseArray": ("sightings", 1.5),
    "vision_msgs/msg/Detection2DArray": ("sightings", 1.0),
}
TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")


@dataclass(frozen=True)
class Candidate:
    """A topic with what it could be, and how well it suits; ``chosen`` says what it would be taken for."""

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
    for each in found:
        if each.could_be and each.topic.count > 0 and each.score > 0:
            other = best.get(each.could_be)
            if other is None or (each.score, each.topic.count) > (other.score, other.topic.count):
                best[each.could_be] = each
    return [
        Candidate(each.topic, each.could_be, each.score, each.could_be if best.get(each.could_be) is each else "")
        for each in found
    ]


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
        inside = [path.removeprefix(f"{row}[].") if row else path for path in paths if lists(path) == row]
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
