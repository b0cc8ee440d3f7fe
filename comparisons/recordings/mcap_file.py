"""Results as MCAP with messages of ROS 2, for Foxglove, RViz and every other reader of bags.

Topics of each estimate, NAME with underscores (and of the ground truth, truth)::

    /NAME/pose        geometry_msgs/PoseWithCovarianceStamped   at the time of each pose
    /NAME/path        nav_msgs/Path                             the whole drive, at its beginning
    /NAME/landmarks   vision_msgs/Detection3DArray              ids, places and covariances of the map, at its beginning
    /NAME/markers     visualization_msgs/MarkerArray            the same with ellipses of three standard deviations
    /tf               tf2_msgs/TFMessage                        map -> base_link of the first estimate

Stamps are by the clock of the log, so that the file can be opened beside the bag that the log came from.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from graphslam import OptionError
from graphslam.files import write_whole
from graphslam.se2 import Array

from ..comparison import Comparison
from ..show.style import colour_of
from .tracks import Track, tracks

INSTALL = "MCAP files are written by the packages mcap and rosbags: pip install -e '.[ros]' in the clone"
FRAME = "map"
#: places of x, y and heading in the 6 x 6 covariances of ROS
_PLANE = np.array([0, 1, 5])
#: vision_msgs is not among the types that come with rosbags
_DETECTIONS = """std_msgs/Header header
vision_msgs/Detection3D[] detections
================================================================================
MSG: vision_msgs/Detection3D
std_msgs/Header header
vision_msgs/ObjectHypothesisWithPose[] results
vision_msgs/BoundingBox3D bbox
string id
================================================================================
MSG: vision_msgs/ObjectHypothesisWithPose
vision_msgs/ObjectHypothesis hypothesis
geometry_msgs/PoseWithCovariance pose
================================================================================
MSG: vision_msgs/ObjectHypothesis
string class_id
float64 score
================================================================================
MSG: vision_msgs/BoundingBox3D
geometry_msgs/Pose center
geometry_msgs/Vector3 size
"""


def check_mcap() -> None:
    """Raise `OptionError` with what to install where the optional packages are missing."""
    try:
        import mcap.writer  # noqa: F401
        import rosbags.typesys  # noqa: F401
    except ImportError:
        raise OptionError(INSTALL) from None


def write_mcap(comparison: Comparison, path: Path) -> None:
    """Write the results of a comparison as MCAP, whole or not at all.

    Raises:
        OptionError: a package is missing.
        FormatError: the file cannot be written.
    """
    check_mcap()
    from mcap.writer import Writer

    ros = _Ros()
    messages = sorted(_messages(comparison, ros), key=lambda each: each[0])
    with write_whole(path) as temporary, temporary.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="virtual-motion-slam")
        channels: dict[str, int] = {}
        schemas: dict[str, int] = {}
        for time, topic, type, message in messages:
            if type not in schemas:
                schemas[type] = writer.register_schema(type, "ros2msg", ros.definition(type).encode())
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "cdr", schemas[type])
            # MCAP knows no times before 1970
            log_time = max(0, time)
            writer.add_message(channels[topic], log_time, ros.bytes_of(message, type), log_time)
        writer.finish()


class _Ros:
    """Messages of ROS 2."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self._store.register(get_types_from_msg(_DETECTIONS, "vision_msgs/msg/Detection3DArray"))

    def definition(self, type: str) -> str:
        return str(self._store.generate_msgdef(type, ros_version=2)[0])

    def bytes_of(self, message: Any, type: str) -> bytes:
        return bytes(self._store.serialize_cdr(message, type))

    def make(self, type: str, /, **fields: Any) -> Any:
        """A message; numbers that are not given are 0, texts and lists empty."""
        package, _, name = type.partition("/")
        full = f"{package}/msg/{name}"
        values = {}
        for field, (node, kind) in self._store.fielddefs[full][1]:
            if field in fields:
                values[field] = fields.pop(field)
            elif node == 2:
                values[field] = self.make(kind.replace("/msg/", "/"))
            elif node == 1:
                values[field] = "" if kind[0] == "string" else False if kind[0] == "bool" else 0
            elif kind[0][0] == 2:
                values[field] = []
            else:
                values[field] = np.zeros(kind[1] if node == 3 else 0, dtype=kind[0][1][0].replace("octet", "uint8"))
        return self._store.types[full](**values)

    def header(self, ns: int) -> Any:
        stamp = self.make("builtin_interfaces/Time", sec=int(ns // 10**9), nanosec=int(ns % 10**9))
        return self.make("std_msgs/Header", stamp=stamp, frame_id=FRAME)

    def pose(self, pose: Array) -> Any:
        x, y, theta = (*map(float, pose), 0.0)[:3]
        turn = self.make("geometry_msgs/Quaternion", z=float(np.sin(theta / 2)), w=float(np.cos(theta / 2)))
        return self.make("geometry_msgs/Pose", position=self.make("geometry_msgs/Point", x=x, y=y), orientation=turn)

    def pose_with_covariance(self, pose: Array, covariance: Array | None) -> Any:
        whole = np.zeros((6, 6))
        if covariance is not None and np.isfinite(covariance).all():
            rows = _PLANE[: len(covariance)]
            whole[np.ix_(rows, rows)] = covariance
        return self.make("geometry_msgs/PoseWithCovariance", pose=self.pose(pose), covariance=whole.ravel())


def _messages(comparison: Comparison, ros: _Ros) -> Iterator[tuple[int, str, str, Any]]:
    """(time [ns], topic, type, message)."""
    moving: str | None = None
    for track in tracks(comparison):
        if len(track.poses) == 0:
            continue
        prefix = "/" + track.name.replace("-", "_")
        begin = int(track.nanoseconds[0])
        for k, ns in enumerate(track.nanoseconds.tolist()):
            pose = ros.pose_with_covariance(track.poses[k], None if track.covariances is None else track.covariances[k])
            stamped = ros.make("geometry_msgs/PoseWithCovarianceStamped", header=ros.header(ns), pose=pose)
            yield ns, f"{prefix}/pose", "geometry_msgs/msg/PoseWithCovarianceStamped", stamped
        along = [
            ros.make("geometry_msgs/PoseStamped", header=ros.header(begin), pose=ros.pose(at)) for at in track.path
        ]
        path = ros.make("nav_msgs/Path", header=ros.header(begin), poses=along)
        yield begin, f"{prefix}/path", "nav_msgs/msg/Path", path
        if track.landmarks:
            yield begin, f"{prefix}/landmarks", "vision_msgs/msg/Detection3DArray", _detections(ros, track, begin)
            yield begin, f"{prefix}/markers", "visualization_msgs/msg/MarkerArray", _markers(ros, track, begin)
        if moving is None and track.name != "truth":
            moving = track.name
            for pose, ns in zip(track.poses, track.nanoseconds.tolist()):
                yield ns, "/tf", "tf2_msgs/msg/TFMessage", _transform(ros, pose, ns)


def _transform(ros: _Ros, pose: Array, ns: int) -> Any:
    at = ros.pose(pose)
    place = ros.make("geometry_msgs/Vector3", x=at.position.x, y=at.position.y)
    transform = ros.make("geometry_msgs/Transform", translation=place, rotation=at.orientation)
    stamped = ros.make(
        "geometry_msgs/TransformStamped", header=ros.header(ns), child_frame_id="base_link", transform=transform
    )
    return ros.make("tf2_msgs/TFMessage", transforms=[stamped])


def _detections(ros: _Ros, track: Track, ns: int) -> Any:
    detections = []
    for id, place in sorted(track.landmarks.items()):
        pose = ros.pose_with_covariance(place, track.landmark_covariances.get(id))
        hypothesis = ros.make("vision_msgs/ObjectHypothesis", class_id=str(id), score=1.0)
        result = ros.make("vision_msgs/ObjectHypothesisWithPose", hypothesis=hypothesis, pose=pose)
        box = ros.make("vision_msgs/BoundingBox3D", center=ros.pose(place))
        detections.append(
            ros.make("vision_msgs/Detection3D", header=ros.header(ns), results=[result], bbox=box, id=str(id))
        )
    return ros.make("vision_msgs/Detection3DArray", header=ros.header(ns), detections=detections)


def _markers(ros: _Ros, track: Track, ns: int) -> Any:
    from matplotlib.colors import to_rgb

    red, green, blue = to_rgb("black" if track.name == "truth" else colour_of(track.name))
    markers = []
    for number, (id, place) in enumerate(sorted(track.landmarks.items())):
        axes, turn = _ellipse(track.landmark_covariances, id)
        size = ros.make("geometry_msgs/Vector3", x=axes[0], y=axes[1], z=0.02)
        for kind, text in ((3, ""), (9, str(id))):
            pose = ros.pose(np.array([*place[:2], turn if kind == 3 else 0.0]))
            pose.position.z = 0.0 if kind == 3 else 0.2
            markers.append(
                ros.make(
                    "visualization_msgs/Marker", header=ros.header(ns), ns=track.name if kind == 3 else f"{track.name} ids",
                    id=number, type=kind, pose=pose, text=text,
                    scale=size if kind == 3 else ros.make("geometry_msgs/Vector3", z=0.2),
                    color=ros.make("std_msgs/ColorRGBA", r=red, g=green, b=blue, a=0.5 if kind == 3 else 1.0),
                )
            )  # fmt: skip
    return ros.make("visualization_msgs/MarkerArray", markers=markers)


def _ellipse(covariances: Mapping[int, Array], id: int) -> tuple[tuple[float, float], float]:
    """The diameters of the ellipse of three standard deviations [m], and the direction of the first one [rad]."""
    covariance = covariances.get(id)
    if covariance is None or not np.isfinite(covariance).all():
        return (0.1, 0.1), 0.0
    values, vectors = np.linalg.eigh(np.asarray(covariance)[:2, :2])
    sizes = 6 * np.sqrt(np.maximum(values, 1e-6))
    return (float(sizes[0]), float(sizes[1])), float(np.arctan2(vectors[1, 0], vectors[0, 0]))
