"""Bags for tests: messages of common types, written by rosbags as ROS 1 bag, ROS 2 SQLite or MCAP."""

from pathlib import Path

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

TAGS = """std_msgs/Header header
apriltag_ros/AprilTagDetection[] detections
================================================================================
MSG: apriltag_ros/AprilTagDetection
int32[] id
float64[] size
geometry_msgs/PoseWithCovarianceStamped pose
"""
VISION = """std_msgs/Header header
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
BEACONS = """std_msgs/Header header
my_robot/Beacon[] beacons
================================================================================
MSG: my_robot/Beacon
uint16 beacon_id
float64 distance
float64 azimuth
"""
CUSTOM = {
    "apriltag_ros/msg/AprilTagDetectionArray": TAGS,
    "vision_msgs/msg/Detection3DArray": VISION,
    "vision_msgs/msg/Detection2DArray": VISION.replace("Detection3D", "Detection2D"),
    "my_robot/msg/Beacons": BEACONS,
}


class Maker:
    """Makes messages and writes them; ``ros`` is 1 or 2."""

    def __init__(self, ros=2, custom=CUSTOM):
        self.ros = ros
        self.store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
        for name, text in custom.items():
            self.store.register(get_types_from_msg(text, name))
        if ros == 1:
            text = "geometry_msgs/TransformStamped[] transforms\n"
            self.store.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))
        self.messages = []

    def __call__(self, type, **fields):
        """A message with some fields; the others are zero. A dict stands for an inner message."""
        package, _, name = type.partition("/")
        full = f"{package}/msg/{name}"
        values = {}
        for field, (node, value) in self.store.fielddefs[full][1]:
            given = fields.pop(field, None)
            if node == 2:
                inner = value.replace("/msg/", "/")
                values[field] = (
                    given if given is not None and not isinstance(given, dict) else self(inner, **(given or {}))
                )
                continue
            if node == 1:
                values[field] = given if given is not None else "" if value[0] == "string" else 0
            elif value[0][0] == 2:
                inner = value[0][1].replace("/msg/", "/")
                values[field] = [self(inner, **each) if isinstance(each, dict) else each for each in given or []]
            else:
                dtype = {"float64": np.float64, "int32": np.int32, "float32": np.float32}.get(value[0][1][0], np.uint8)
                values[field] = np.array(given if given is not None else np.zeros(value[1] if node == 3 else 0), dtype)
        assert not fields, f"{type} has no {sorted(fields)}"
        return self.store.types[full](**values)

    def header(self, ns, frame=""):
        return {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}, "frame_id": frame}

    def add(self, topic, type, ns, **fields):
        """Add a message that is recorded at a time [ns]."""
        package, _, name = type.partition("/")
        self.messages.append((topic, f"{package}/msg/{name}", ns, self(type, **fields)))

    def write(self, path, storage="mcap", compression=None):
        """Write all messages; returns the path of the bag."""
        path = Path(path)
        messages = sorted(self.messages, key=lambda each: each[2])
        if self.ros == 1:
            writer = Writer1(path)
            if compression:
                writer.set_compression(compression)
        else:
            plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
            writer = Writer2(path.with_suffix(""), version=9, storage_plugin=plugin)
        with writer:
            connections = {}
            for topic, type, ns, message in messages:
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, type, typestore=self.store)
                serialize = self.store.serialize_ros1 if self.ros == 1 else self.store.serialize_cdr
                writer.write(connections[topic], ns, serialize(message, type))
        if self.ros == 1 or storage != "mcap":
            return path if self.ros == 1 else path.with_suffix("")
        folder = path.with_suffix("")
        (folder / f"{folder.name}.mcap").rename(path)
        (folder / "metadata.yaml").unlink()
        folder.rmdir()
        return path


def quaternion(theta):
    return {"x": 0.0, "y": 0.0, "z": float(np.sin(theta / 2)), "w": float(np.cos(theta / 2))}


def point(x, y, z=0.0):
    return {"x": float(x), "y": float(y), "z": float(z)}


def pose(x, y, theta=0.0, z=0.0):
    return {"position": point(x, y, z), "orientation": quaternion(theta)}


def twist(nu, omega):
    return {"linear": point(nu, 0.0), "angular": point(0.0, 0.0, omega)}


def transform(maker, ns, parent, child, place=(0, 0, 0), turn=(0, 0, 0, 1)):
    rotation = dict(zip("xyzw", map(float, turn)))
    return {
        "header": maker.header(ns, parent), "child_frame_id": child,
        "transform": {"translation": point(*place), "rotation": rotation},
    }  # fmt: skip


__all__ = ["Maker", "point", "pose", "quaternion", "transform", "twist"]
