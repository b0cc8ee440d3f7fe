"""Make the files of this folder: ``python examples/own_robot/make_example.py [FOLDER]``.

A robot with wheel odometry and a camera drives for 75 seconds between poles with tags. The same drive is written
twice: as tables (odometry.csv, sightings.csv, truth.csv, map.csv, import.toml) and as a bag (drive.mcap, with recordings of
ROS 2). The tables are as people write them: milliseconds, degrees and columns with units in their names.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from graphslam import MotionModel, SensorModel
from graphslam.se2 import wrap

SECONDS, ODOMETRY_HZ, CAMERA_HZ, TRUTH_HZ = 75, 20, 4, 5
#: Unix time of the first message [ns]
START = 1_716_200_000_000_000_000
#: the camera is ahead of the wheels [m]
OFFSET = (0.18, 0.0)
SIGHT, VIEW = 5.0, np.deg2rad(110)
TAGS = """std_msgs/Header header
apriltag_ros/AprilTagDetection[] detections
================================================================================
MSG: apriltag_ros/AprilTagDetection
int32[] id
float64[] size
geometry_msgs/PoseWithCovarianceStamped pose
"""


def drive(seed: int = 5) -> dict[str, np.ndarray]:
    """The numbers of the drive: times [ms], odometry, sightings, truth and map."""
    rng = np.random.default_rng(seed)
    t = np.arange(SECONDS * ODOMETRY_HZ + 1) / ODOMETRY_HZ
    true = np.column_stack([0.45 + 0.1 * np.sin(t / 5), 0.26 + 0.14 * np.sin(t / 11)])
    poses = MotionModel().dead_reckoning(np.zeros(3), true[:-1], 1 / ODOMETRY_HZ)
    # wheels that differ by two percent, and noise
    measured = true * (1.02, 1.0) + [0.0, 0.006] + rng.normal(size=true.shape) * (0.03, 0.04)
    centre = poses[:, :2].mean(axis=0)
    angle = np.arange(14) * 2.4
    poles = centre + (1.0 + 0.33 * np.arange(14))[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    sensor, rows = SensorModel(offset=OFFSET), []
    for k in range(0, len(t) - 1, ODOMETRY_HZ // CAMERA_HZ):
        for j, (length, bearing) in enumerate(sensor.h(np.tile(poses[k], (len(poles), 1)), poles)):
            if length < SIGHT and abs(bearing) < VIEW / 2 and rng.random() > 0.1:
                rows.append(
                    (1000 * t[k] + 12, j + 1, length * (1 + 0.03 * rng.normal()), bearing + 0.015 * rng.normal())
                )
    truth = np.column_stack([1000 * t, poses[:, :2], wrap(poses[:, 2])])[:: ODOMETRY_HZ // TRUTH_HZ]
    return {
        "odometry": np.column_stack([1000 * t, measured]),
        "sightings": np.array(rows),
        "truth": truth,
        "map": np.column_stack([1 + np.arange(len(poles)), poles]),
    }


def write_tables(tables: dict[str, np.ndarray], folder: Path) -> None:
    """CSV with milliseconds and degrees, and a recipe that says where the camera is."""
    degrees = {name: table.copy() for name, table in tables.items()}
    degrees["sightings"][:, 3] = np.rad2deg(degrees["sightings"][:, 3])
    degrees["truth"][:, 3] = np.rad2deg(degrees["truth"][:, 3])
    heads = {
        "odometry": ("time_ms,speed,yaw_rate", "%d,%.4f,%.4f"),
        "sightings": ("time_ms,tag_id,distance_m,bearing_deg", "%d,%d,%.4f,%.3f"),
        "truth": ("time_ms,x,y,heading_deg", "%d,%.4f,%.4f,%.3f"),
        "map": ("id,x,y", "%d,%.4f,%.4f"),
    }
    for name, (head, format) in heads.items():
        np.savetxt(folder / f"{name}.csv", degrees[name], fmt=format, delimiter=",", header=head, comments="")
    recipe = "# what the tables do not say: the camera is 18 cm ahead of the wheels\nsensor_offset = [0.18, 0.0]\n"
    (folder / "import.toml").write_text(recipe, encoding="utf-8")


def write_bag(tables: dict[str, np.ndarray], path: Path) -> None:
    """The same drive as MCAP: /odom, /tag_detections in the optical axes of the camera, /tf_static, /ground_truth/pose."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(TAGS, "apriltag_ros/msg/AprilTagDetectionArray"))

    def make(type: str, **fields: Any) -> Any:
        values = {}
        for name, (node, kind) in store.fielddefs[type][1]:
            if name in fields:
                values[name] = fields[name]
            elif node == 2:
                values[name] = make(kind)
            elif node == 1:
                values[name] = "" if kind[0] == "string" else 0
            else:
                values[name] = np.zeros(kind[1] if node == 3 else 0)
        return store.types[type](**values)

    def header(milliseconds: float, frame: str) -> Any:
        ns = START + round(milliseconds * 1e6)
        stamp = make("builtin_interfaces/msg/Time", sec=ns // 10**9, nanosec=ns % 10**9)
        return make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def vector(type: str, x: float, y: float, z: float) -> Any:
        return make(f"geometry_msgs/msg/{type}", x=float(x), y=float(y), z=float(z))

    def turn(theta: float) -> Any:
        return make("geometry_msgs/msg/Quaternion", z=float(np.sin(theta / 2)), w=float(np.cos(theta / 2)))

    messages = []
    optical = make("geometry_msgs/msg/Quaternion", x=-0.5, y=0.5, z=-0.5, w=0.5)
    place = make("geometry_msgs/msg/Transform", translation=vector("Vector3", *OFFSET, 0.4), rotation=optical)
    mounted = make(
        "geometry_msgs/msg/TransformStamped",
        header=header(0, "base_link"),
        child_frame_id="camera_optical",
        transform=place,
    )
    messages.append((0.0, "/tf_static", "tf2_msgs/msg/TFMessage", make("tf2_msgs/msg/TFMessage", transforms=[mounted])))
    for t, nu, omega in tables["odometry"].tolist():
        twist = make(
            "geometry_msgs/msg/Twist", linear=vector("Vector3", nu, 0, 0), angular=vector("Vector3", 0, 0, omega)
        )
        stamped = make("geometry_msgs/msg/TwistStamped", header=header(t, "base_link"), twist=twist)
        messages.append((t, "/wheel_odometry", "geometry_msgs/msg/TwistStamped", stamped))
    for t in np.unique(tables["sightings"][:, 0]).tolist():
        seen = []
        for _, j, length, bearing in tables["sightings"][tables["sightings"][:, 0] == t].tolist():
            right, ahead = -length * np.sin(bearing), length * np.cos(bearing)
            at = make("geometry_msgs/msg/Pose", position=vector("Point", right, 0.1, ahead), orientation=turn(0.0))
            pose = make("geometry_msgs/msg/PoseWithCovariance", pose=at)
            pose = make("geometry_msgs/msg/PoseWithCovarianceStamped", header=header(t, "camera_optical"), pose=pose)
            ids, size = np.array([j], dtype=np.int32), np.array([0.16])
            seen.append(make("apriltag_ros/msg/AprilTagDetection", id=ids, size=size, pose=pose))
        array = make("apriltag_ros/msg/AprilTagDetectionArray", header=header(t, "camera_optical"), detections=seen)
        messages.append((t, "/tag_detections", "apriltag_ros/msg/AprilTagDetectionArray", array))
    for t, x, y, theta in tables["truth"].tolist():
        pose = make("geometry_msgs/msg/Pose", position=vector("Point", x, y, 0), orientation=turn(theta))
        stamped = make("geometry_msgs/msg/PoseStamped", header=header(t, "world"), pose=pose)
        messages.append((t, "/ground_truth/pose", "geometry_msgs/msg/PoseStamped", stamped))

    with tempfile.TemporaryDirectory() as temporary:
        writer = Writer(Path(temporary) / "drive", version=9, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with writer:
            connections = {}
            for t, topic, type, message in sorted(messages, key=lambda each: each[0]):
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, type, typestore=store)
                writer.write(connections[topic], START + round(t * 1e6), store.serialize_cdr(message, type))
        shutil.copyfile(Path(temporary) / "drive" / "drive.mcap", path)


def main(folder: Path) -> None:
    """Write all files."""
    tables = drive()
    # as the tables round them, so that both logs have the same numbers
    for name, digits in (
        ("odometry", (0, 4, 4)),
        ("sightings", (0, 0, 4, 6)),
        ("truth", (0, 4, 4, 5)),
        ("map", (0, 4, 4)),
    ):
        tables[name] = np.column_stack([np.round(column, d) for column, d in zip(tables[name].T, digits)])
    write_tables(tables, folder)
    write_bag(tables, folder / "drive.mcap")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
