"""Time and memory of ``slam-compare import`` of own tables and bags: ``python benchmarks/own_robot.py [--bag-gb 2]``.

Each import is a process of its own: it reads, checks for plausibility and writes a log. Files are made in a temporary folder.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROWS, SIGHTINGS = 1_000_000, 200_000
START = 1_716_000_000


def make_tables(folder: Path) -> None:
    """1,000,000 rows of odometry at 100 Hz with times since 1970, and 200,000 sightings."""
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(ROWS, 2)).tolist()
    with (folder / "odometry.csv").open("w") as stream:
        stream.write("timestamp,nu,omega\n")
        stream.writelines(
            f"{START + k // 100}.{k % 100 * 10_000_000:09d},{0.5 + 0.05 * a:.6f},{0.2 * b:.6f}\n"
            for k, (a, b) in enumerate(noise)
        )
    at = np.sort(rng.uniform(0, ROWS / 100 - 1, SIGHTINGS)).round(6).tolist()
    ids, rows = rng.integers(0, 200, SIGHTINGS).tolist(), rng.uniform([0.5, -1], [8, 1], (SIGHTINGS, 2)).tolist()
    with (folder / "sightings.csv").open("w") as stream:
        stream.write("timestamp,id,range,bearing\n")
        stream.writelines(f"{START + t:.6f},{j},{r:.6f},{b:.6f}\n" for t, j, (r, b) in zip(at, ids, rows))


def make_bag(path: Path, gigabytes: float) -> None:
    """A bag whose size is mostly images, with odometry at 50 Hz and ten sightings a second."""
    from mcap.writer import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    Time, Header = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    Vector3, Point, Quaternion = (types[f"geometry_msgs/msg/{name}"] for name in ("Vector3", "Point", "Quaternion"))
    Pose, Twist, TwistStamped = (types[f"geometry_msgs/msg/{name}"] for name in ("Pose", "Twist", "TwistStamped"))
    kinds = {
        "/odom": "geometry_msgs/msg/TwistStamped", "/markers": "visualization_msgs/msg/MarkerArray",
        "/image": "sensor_msgs/msg/CompressedImage",
    }  # fmt: skip
    image = np.random.default_rng(0).integers(0, 256, 500_000).astype(np.uint8)
    count = int(gigabytes * 1e9 / len(image))
    with path.open("wb") as stream:
        from mcap.writer import CompressionType

        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start(profile="ros2", library="benchmark")
        channels = {}
        for topic, kind in kinds.items():
            schema = writer.register_schema(kind, "ros2msg", store.generate_msgdef(kind, ros_version=2)[0].encode())
            channels[topic] = writer.register_channel(topic, "cdr", schema)

        def add(topic: str, ns: int, message: object) -> None:
            writer.add_message(channels[topic], ns, bytes(store.serialize_cdr(message, kinds[topic])), ns)

        none = Vector3(x=0.0, y=0.0, z=0.0)
        for k in range(count):
            ns = START * 10**9 + k * 100_000_000
            header = Header(stamp=Time(sec=ns // 10**9, nanosec=ns % 10**9), frame_id="base_link")
            add("/image", ns, types["sensor_msgs/msg/CompressedImage"](header=header, format="jpeg", data=image))
            for i in range(5):
                later = ns + i * 20_000_000
                at = Header(stamp=Time(sec=later // 10**9, nanosec=later % 10**9), frame_id="base_link")
                twist = Twist(linear=Vector3(x=0.5, y=0.0, z=0.0), angular=Vector3(x=0.0, y=0.0, z=0.1))
                add("/odom", later, TwistStamped(header=at, twist=twist))
            pose = Pose(position=Point(x=2.0, y=0.5, z=0.0), orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))
            marker = types["visualization_msgs/msg/Marker"](
                header=header, ns="", id=k % 9, type=0, action=0, pose=pose, scale=none,
                color=types["std_msgs/msg/ColorRGBA"](r=0.0, g=0.0, b=0.0, a=1.0),
                lifetime=types["builtin_interfaces/msg/Duration"](sec=0, nanosec=0), frame_locked=False, points=[],
                colors=[], texture_resource="", texture=types["sensor_msgs/msg/CompressedImage"](
                    header=header, format="", data=np.zeros(0, np.uint8)
                ), uv_coordinates=[], text="",
                mesh_resource="", mesh_file=types["visualization_msgs/msg/MeshFile"](filename="", data=np.zeros(0, np.uint8)),
                mesh_use_embedded_materials=False,
            )  # fmt: skip
            add("/markers", ns, types["visualization_msgs/msg/MarkerArray"](markers=[marker]))
        writer.finish()


def measure(source: Path) -> None:
    """Import tables or a bag by the command line, and print time and peak memory of the whole process."""
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "comparisons", "import", str(source), f"{folder}/drive.npz", "-q"]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = used.ru_utime + used.ru_stime - before.ru_utime - before.ru_stime
    seconds = time.perf_counter() - begin
    print(f"{source.name}: {seconds:.2f} s ({cpu:.2f} s of one core), peak of all so far {used.ru_maxrss / 1e6:.2f} GB")


def main() -> None:
    """Make the files and measure each three times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bag-gb", type=float, default=2.0, help="size of the bag [GB]; 0 leaves it out")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "tables").mkdir()
        make_tables(folder / "tables")
        paths = [folder / "tables"]
        if arguments.bag_gb > 0:
            make_bag(folder / "large.mcap", arguments.bag_gb)
            print(f"large.mcap: {(folder / 'large.mcap').stat().st_size / 1e9:.2f} GB")
            paths.append(folder / "large.mcap")
        for path in paths:
            for _ in range(3):
                measure(path)


if __name__ == "__main__":
    main()
