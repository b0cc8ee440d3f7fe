"""Bags of ROS 1 and ROS 2 become the same log as tables; every mistake is one sentence with the topic and likely cause."""

import gzip
import math

import numpy as np
import pytest

import comparisons

pytest.importorskip("rosbags")

from bags import Maker, point, pose, quaternion, transform, twist

from graphslam import FormatError, Graph, Log, LogError, load, solve
from graphslam.io.bag_drive import drive_of_bag, topics_of
from graphslam.io.bag_messages import Frames, rotation_of
from graphslam.io.bag_topics import getter, leaves
from graphslam.io.tables import Recipe
from graphslam.log.rows import ReadOptions, TableOptions

_READING = ReadOptions()
START = 1_716_000_000_123_456_789
TIMES = [START + k * 50_000_001 for k in range(400)]
NU, OMEGA = 0.5 + 0.1 * np.sin(np.arange(400) / 30), 0.3 * np.cos(np.arange(400) / 50)
#: (time, id, forward, left) of the sightings, in the axes of the sensor
SEEN = [(START + k * 700_000_003, k % 3, 2.0 + 0.1 * k, 0.5 - 0.07 * k) for k in range(20)]
OPTICAL = (-0.5, 0.5, -0.5, 0.5)


def odometry(maker, topic="/odom", **changes):
    for t, nu, omega in zip(TIMES, NU.tolist(), OMEGA.tolist()):
        fields = {
            "header": maker.header(t, "odom"),
            "child_frame_id": "base_link",
            "twist": {"twist": twist(nu, omega)},
        }
        maker.add(topic, "nav_msgs/Odometry", t + 1_000_000, **fields | {"pose": {"pose": pose(0, 0)}} | changes)


def tags(maker, topic="/tags", frame="base_link"):
    for t, j, x, y in SEEN:
        head = maker.header(t, frame)
        inner = {"pose": {"position": point(x, y), "orientation": quaternion(0.0)}}
        detection = {"id": [j], "size": [0.2], "pose": {"header": head, "pose": inner}}
        maker.add(topic, "apriltag_ros/AprilTagDetectionArray", t + 5_000_000, header=head, detections=[detection])


def mounted(maker, child, place=(0, 0, 0), turn=(0, 0, 0, 1), parent="base_link"):
    maker.add(
        "/tf_static", "tf2_msgs/TFMessage", START, transforms=[transform(maker, START, parent, child, place, turn)]
    )


@pytest.fixture(scope="module")
def expected():
    """The log of the same drive as tables."""
    return Log.from_tables(
        {"t": np.array(TIMES), "nu": NU, "omega": OMEGA},
        {name: np.array(column) for name, column in zip(("t", "id", "x", "y"), zip(*SEEN))},
        time="ns",
    )


@pytest.mark.parametrize(("ros", "name", "storage"), [(1, "a.bag", ""), (2, "a.mcap", "mcap"), (2, "a.db3", "sqlite")])
def test_every_kind_of_bag_gives_the_log_of_the_tables(ros, name, storage, expected, tmp_path):
    maker = Maker(ros)
    odometry(maker)
    tags(maker)
    log = load(maker.write(tmp_path / name, storage))
    assert log.equals(expected)
    # to a nanosecond, though the seconds since 1970 of a floating-point number are not
    steps = np.add.reduceat(log.dt, log.control_starts[:-1])
    assert np.rint(steps * 1e9).tolist() == np.diff([each[0] for each in SEEN]).tolist()


@pytest.mark.parametrize("compression", ["bz2", "lz4"])
def test_compressed_chunks_are_read(compression, expected, tmp_path):
    from rosbags.rosbag1 import Writer

    maker = Maker(1)
    odometry(maker)
    tags(maker)
    path = maker.write(tmp_path / "a.bag", compression=getattr(Writer.CompressionFormat, compression.upper()))
    assert load(path).equals(expected)


def test_csv_of_the_same_drive_gives_the_same_log(expected, tmp_path):
    def seconds(ns):
        return f"{ns // 10**9}.{ns % 10**9:09d}"

    lines = [f"{seconds(t)},{nu!r},{omega!r}" for t, nu, omega in zip(TIMES, NU.tolist(), OMEGA.tolist())]
    (tmp_path / "odometry.csv").write_text("\n".join(["t,nu,omega", *lines]))
    lines = [f"{seconds(t)},{j},{x!r},{y!r}" for t, j, x, y in SEEN]
    (tmp_path / "sightings.csv").write_text("\n".join(["t,id,x,y", *lines]))
    assert load(tmp_path).equals(expected)


def test_every_source_of_a_drive_with_truth_has_the_same_log_and_results(tmp_path):
    """MCAP, ROS 1 bag and CSV of one drive: the logs, with the truth, and the solved poses are equal to the last bit."""

    def seconds(ns):
        return f"{ns // 10**9}.{ns % 10**9:09d}"

    logs = []
    true = [(t + 3, 0.025 * k, 0.3 * math.sin(k / 40), 0.01 * k) for k, t in enumerate(TIMES)]
    for ros, name in ((1, "a.bag"), (2, "a.mcap")):
        maker = Maker(ros)
        odometry(maker)
        tags(maker)
        for t, x, y, theta in true:
            maker.add("/ground_truth", "geometry_msgs/PoseStamped", t, header=maker.header(t), pose=pose(x, y, theta))
        logs.append(load(maker.write(tmp_path / name)))
    folder = tmp_path / "tables"
    folder.mkdir()
    turns = [quaternion(theta) for *_, theta in true]
    for name, header, rows in (
        ("odometry", "t,nu,omega", zip(TIMES, NU.tolist(), OMEGA.tolist())), ("sightings", "t,id,x,y", SEEN),
        ("truth", "t,x,y,qx,qy,qz,qw", [(t, x, y, *turn.values()) for (t, x, y, _), turn in zip(true, turns)]),
    ):  # fmt: skip
        lines = [",".join([seconds(t), *map(repr, numbers)]) for t, *numbers in rows]
        (folder / f"{name}.csv").write_text("\n".join([header, *lines]))
    logs.append(load(folder))
    solved = [solve(Graph.from_log(log, edges="landmark+motion", kernel="none")) for log in logs]
    for log, solution in zip(logs[1:], solved[1:]):
        assert log.equals(logs[0])
        assert log.true_poses is not None and np.array_equal(log.true_poses, logs[0].true_poses, equal_nan=True)
        assert np.array_equal(log.true_path, logs[0].true_path, equal_nan=True)
        assert log.start_time == logs[0].start_time
        np.testing.assert_array_equal(solution.poses, solved[0].poses)
        assert solution.cost == solved[0].cost and solution.iterations == solved[0].iterations


def test_the_topics_and_what_they_could_be(tmp_path):
    maker = Maker()
    odometry(maker)
    odometry(maker, "/ground_truth/odom")
    tags(maker)
    maker.add("/cmd_vel", "geometry_msgs/Twist", START, **twist(0.1, 0.0))
    maker.add("/scan", "sensor_msgs/LaserScan", START, header=maker.header(START))
    found = {each.topic.name: (each.could_be, each.chosen) for each in topics_of(maker.write(tmp_path / "a.mcap"))}
    assert found == {
        "/odom": ("odometry", "odometry"),
        "/ground_truth/odom": ("truth", "truth"),
        "/tags": ("sightings", "sightings"),
        "/cmd_vel": ("odometry", ""),
        "/scan": ("", ""),
    }


def test_a_camera_on_the_robot(expected, tmp_path):
    """Positions in the axes of a camera (z forward, x to the right) that looks to the left of the robot."""
    maker, yaw = Maker(), math.pi / 2
    odometry(maker)
    half = (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
    mounted(maker, "mast", (0.3, 0.1, 1.0), half)
    mounted(maker, "camera_optical", (0.0, 0.0, 0.2), OPTICAL, parent="mast")
    for t, j, x, y in SEEN:
        forward, left = y, -x  # of the camera
        head = maker.header(t, "camera_optical")
        inner = {"pose": {"position": point(-left, 0.4, forward), "orientation": quaternion(0.3)}}
        detection = {"id": [j], "size": [0.2], "pose": {"header": head, "pose": inner}}
        maker.add("/tags", "apriltag_ros/AprilTagDetectionArray", t, header=head, detections=[detection])
    log = load(maker.write(tmp_path / "a.mcap"))
    assert log.sensor.offset == pytest.approx((0.3, 0.1))
    np.testing.assert_allclose(log.sightings, expected.sightings, atol=1e-12)


def detections(maker, t, j, x, y, place):
    hypothesis = {"hypothesis": {"class_id": f"tag_{j}", "score": 1.0}, "pose": {"pose": pose(0, 0)}}
    at = {"position": point(x, y), "orientation": quaternion(0.0)}
    if place == "results":
        hypothesis["pose"] = {"pose": at}
    return {"results": [hypothesis], "bbox": {"center": at if place == "box" else pose(0, 0)}, "id": str(j)}


@pytest.mark.slow
@pytest.mark.parametrize(
    "make",
    [
        lambda m, t, j, x, y: (
            "vision_msgs/Detection3DArray", {"detections": [detections(m, t, j, x, y, "results")]}
        ),
        lambda m, t, j, x, y: ("vision_msgs/Detection3DArray", {"detections": [detections(m, t, j, x, y, "box")]}),
        lambda m, t, j, x, y: ("vision_msgs/Detection2DArray", {"detections": [detections(m, t, j, x, y, "results")]}),
        lambda m, t, j, x, y: (
            "visualization_msgs/MarkerArray",
            {"markers": [{"header": m.header(t, "base_link"), "id": j, "pose": pose(x, y)},
                         {"header": m.header(t, "base_link"), "id": 77, "action": 2, "pose": pose(9, 9)}]},
        ),
        lambda _m, _t, j, x, y: (
            "my_robot/Beacons",
            {"beacons": [{"beacon_id": j, "distance": float(np.hypot(x, y)), "azimuth": float(np.arctan2(y, x))}]},
        ),
    ],
    ids=["Detection3D results", "Detection3D box", "Detection2D results", "MarkerArray", "custom"],
)  # fmt: skip
def test_types_of_sightings(make, expected, tmp_path):
    maker = Maker()
    odometry(maker)
    for t, j, x, y in SEEN:
        type, fields = make(maker, t, j, x, y)
        if type != "visualization_msgs/MarkerArray":
            fields["header"] = maker.header(t, "base_link")
        maker.add("/seen", type, t, **fields)
    log = load(maker.write(tmp_path / "a.mcap"))
    assert log.replace(classes=None).equals(expected)
    if "vision" in type:
        assert log.classes.tolist() == [f"tag_{j}" for j in log.landmarks]
    else:
        assert log.classes is None


@pytest.mark.parametrize("stated", [True, False])
def test_a_class_alone_names_landmarks_unless_it_is_stated(stated, expected, tmp_path):
    maker = Maker()
    odometry(maker)
    for t, j, x, y in SEEN:
        item = detections(maker, t, j, x, y, "results") | {"id": ""}
        header = maker.header(t, "base_link")
        maker.add("/seen", "vision_msgs/Detection3DArray", t, header=header, detections=[item])
    path = maker.write(tmp_path / "a.mcap")
    if stated:
        (tmp_path / "a.toml").write_text('[sightings]\nclass = "results.hypothesis.class_id"\n')
        log = load(path)
        assert log.classes.tolist() == [f"tag_{row[1]}" for row in SEEN] and len(log.landmark_ids) == 0
    else:
        assert load(path).equals(expected)


def test_poses_without_ids(expected, tmp_path):
    maker = Maker()
    odometry(maker)
    for t, _, x, y in SEEN:
        maker.add("/cones", "geometry_msgs/PoseArray", t, header=maker.header(t, "base_link"), poses=[pose(x, y)])
    log = load(maker.write(tmp_path / "a.mcap"))
    np.testing.assert_array_equal(log.sightings, expected.sightings)
    assert not log.identified and any("no landmark is identified" in note for note in log.notes)


@pytest.mark.parametrize("type", ["Twist", "TwistStamped", "pose", "TF"])
def test_types_of_odometry(type, expected, tmp_path):
    maker = Maker()
    poses = np.zeros((len(TIMES), 3))
    steps = np.diff(TIMES) / 1e9
    from graphslam import MotionModel

    poses = MotionModel().dead_reckoning(np.zeros(3), np.column_stack([NU, OMEGA])[:-1], steps)
    for t, nu, omega, at in zip(TIMES, NU.tolist(), OMEGA.tolist(), poses.tolist()):
        if type == "Twist":
            maker.add("/cmd_vel", "geometry_msgs/Twist", t, **twist(nu, omega))
        elif type == "TwistStamped":
            maker.add("/wheels", "geometry_msgs/TwistStamped", t, header=maker.header(t), twist=twist(nu, omega))
        elif type == "pose":
            maker.add("/odom", "nav_msgs/Odometry", t, header=maker.header(t), pose={"pose": pose(*at)},
                      child_frame_id="base_link", twist={"twist": twist(0, 0)})  # fmt: skip
        else:
            turn = tuple(quaternion(at[2]).values())
            moved = transform(maker, t, "odom", "base_link", (at[0], at[1], 0), turn)
            maker.add("/tf", "tf2_msgs/TFMessage", t, transforms=[moved, transform(maker, t, "base_link", "wheel")])
    tags(maker)
    log = load(maker.write(tmp_path / "a.mcap"))
    exact = type.startswith("Twist")
    np.testing.assert_allclose(log.controls, expected.controls, atol=0 if exact else 1e-9)
    assert any("no stamp" in note for note in log.notes) == (type == "Twist")
    assert any("the twist is zero" in note for note in log.notes) == (type == "pose")


def test_truth_and_landmarks_of_tf(tmp_path, expected):
    """Odometry as messages; landmarks that a detector publishes as frames; truth of a motion capture system."""
    maker = Maker()
    odometry(maker)
    for t, j, x, y in SEEN:
        moved = transform(maker, t, "base_link", f"tag36h11:{j}", (x, y, 0.0))
        maker.add("/tf", "tf2_msgs/TFMessage", t, transforms=[moved])
    for k, t in enumerate(TIMES):
        maker.add(
            "/vicon/robot/pose", "geometry_msgs/PoseStamped", t, header=maker.header(t, "world"), pose=pose(0.01 * k, 1)
        )
    log = load(maker.write(tmp_path / "a.mcap"))
    assert log.replace(true_poses=None, initial_poses=None).equals(expected.replace(initial_poses=None))
    seconds = (log.times - log.start_time) + (SEEN[0][0] - START) / 1e9
    np.testing.assert_allclose(log.true_poses[:, 0], 0.01 * seconds / 0.050000001, atol=1e-6)


def test_orientations_become_psi(tmp_path):
    maker = Maker()
    odometry(maker)
    for k, (t, j, x, y) in enumerate(SEEN):
        markers = [{"header": maker.header(t, "base_link"), "id": j, "pose": pose(x, y, 0.1 * k)}]
        maker.add("/markers", "visualization_msgs/MarkerArray", t, markers=markers)
    log = load(maker.write(tmp_path / "a.mcap"))
    np.testing.assert_allclose(
        log.sightings[:, 2], [math.atan2(y, x) - 0.1 * k for k, (_, _, x, y) in enumerate(SEEN)], atol=1e-12
    )


def test_a_recipe_names_topics_and_fields(tmp_path, expected):
    maker = Maker()
    odometry(maker)
    odometry(maker, "/other_odom", twist={"twist": twist(9.0, 9.0)})
    for t, j, x, y in SEEN:
        beacon = {
            "beacon_id": j,
            "distance": float(np.rad2deg(np.arctan2(y, x))),
            "azimuth": float(1000 * np.hypot(x, y)),
        }
        maker.add("/seen", "my_robot/Beacons", t, header=maker.header(t, "x"), beacons=[beacon])
    path = maker.write(tmp_path / "drive.mcap")
    (tmp_path / "drive.toml").write_text(
        '[odometry]\ntopic = "/odom"\n[sightings]\ntopic = "seen"\nrange = "azimuth"\nbearing = "beacons.distance"\n'
        'id = "beacon_id"\nangles = "degrees"\nlengths = "mm"\n'
    )
    np.testing.assert_allclose(load(path).sightings, expected.sightings, rtol=1e-12)
    (tmp_path / "drive.toml").write_text('[sightings]\nrange = "azimut"\n')
    with pytest.raises(
        FormatError, match=r"drive.mcap: /seen: .*no field 'azimut' for range; did you mean 'azimuth'\?"
    ):
        load(path)


def test_twist_and_poses_that_disagree_are_remarked(tmp_path):
    maker = Maker()
    for k, t in enumerate(TIMES):
        maker.add("/odom", "nav_msgs/Odometry", t, header=maker.header(t), child_frame_id="base_link",
                  pose={"pose": pose(0.1 * k, 0)}, twist={"twist": twist(0.5, 0)})  # fmt: skip
    tags(maker)
    log = load(maker.write(tmp_path / "a.mcap"))
    assert any("the twist drives 10.0 m and the poses 39.9 m" in note for note in log.notes)


def broken(tmp_path, name):
    """The path of a bag with one mistake, and the recipe."""
    maker, recipe = Maker(1 if name == "cut ROS 1" else 2), Recipe()
    if name != "no odometry":
        odometry(maker)
    if name == "unknown frame":
        tags(maker, frame="camera_link")
        mounted(maker, "laser")
    elif name == "moving frame":
        tags(maker, frame="camera_link")
        for k, t in enumerate(TIMES[:20]):
            moved = transform(maker, t, "base_link", "camera_link", (0.1 * k, 0, 0))
            maker.add("/tf", "tf2_msgs/TFMessage", t, transforms=[moved])
    elif name == "no positions":
        for t, *_ in SEEN:
            item = {"results": [], "bbox": {"center": pose(0, 0)}, "id": "1"}
            maker.add("/seen", "vision_msgs/Detection2DArray", t, header=maker.header(t), detections=[item])
    elif name == "other clock":
        for t, j, x, y in SEEN:
            markers = [{"header": maker.header(t - START + 10**9, "base_link"), "id": j, "pose": pose(x, y)}]
            maker.add("/markers", "visualization_msgs/MarkerArray", t, markers=markers)
    elif name != "no sightings":
        tags(maker)
    if name == "quaternions not normalised":
        recipe = Recipe(places={"odometry": {"use": "pose"}})
        maker.messages.clear()
        bad = {"pose": {"position": point(0, 0), "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.0}}}
        odometry(maker, pose=bad)
        tags(maker)
    path = maker.write(tmp_path / ("a.bag" if name == "cut ROS 1" else "a.mcap"))
    if name.startswith("cut"):
        path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    elif name == "packed":
        path = path.with_suffix(".mcap.gz")
        path.write_bytes(gzip.compress(b"anything"))
    elif name == "empty":
        path.write_bytes(b"")
    elif name == "another suffix":
        path = path.rename(path.with_suffix(".bag"))
    elif name == "no bag":
        path.write_bytes(b"something else entirely, but long enough for a header")
    elif name == "damaged":
        content = bytearray(path.read_bytes())
        content[2000:2600] = bytes(600)
        path.write_bytes(bytes(content))
    elif name == "absent topic":
        recipe = Recipe(places={"odometry": {"topic": "/odmo"}})
    elif name == "wrong type":
        recipe = Recipe(places={"odometry": {"topic": "/tags"}})
    elif name == "frames of TF":
        recipe = Recipe(places={"sightings": {"parent": "camera", "child": "tag*"}})
    return path, recipe


MISTAKES = {
    "no odometry": r"a.mcap: no topic gives odometry: there are /tags \(apriltag_ros/msg/AprilTagDetectionArray\); name one: "
    "--odometry TOPIC",
    "no sightings": r"no topic gives sightings: there are /odom",
    "absent topic": r"a.mcap: there is no topic '/odmo'; did you mean '/odom'\?",
    "wrong type": r"a.mcap: /tags: its messages, apriltag_ros/msg/AprilTagDetectionArray, give no odometry; "
    "nav_msgs/Odometry, geometry_msgs/Twist, TwistStamped and TF do",
    "unknown frame": r"a.mcap: /tags: its positions are in the frame 'camera_link', and no fixed transform in TF leads from "
    r"there to 'base_link', the robot; state where the sensor is: sensor_offset=\[FORWARD, LEFT\]",
    "moving frame": "no fixed transform in TF leads from there to 'base_link'",
    "frames of TF": "there is no topic of TF, which should have sightings from frames",
    "no positions": "a.mcap: /seen: its detections have no positions, all are zero or absent",
    "other clock": r"the clocks of .*a.mcap: /odom \(1716000000.123 to 1716000020.073 s\) and .*a.mcap: /markers \(1.000 to "
    r"14.300 s\) do not overlap: one counts from 1970 and the other from its own start",
    "quaternions not normalised": "a.mcap: /odom, message 1: the quaternion has length 0, but a rotation has length 1: no "
    "orientation was measured",
    "cut": r"a.mcap: the bag was cut short .*mcap recover a.mcap",
    "cut ROS 1": "a.bag: the bag has no complete index, it was cut short; repair it first: rosbag reindex a.bag",
    "packed": "a.mcap.gz: the file is compressed as a whole; unpack it first: gunzip a.mcap.gz",
    "empty": "a.mcap: the file is empty; was the recording ended before anything was written?",
    "no bag": "a.mcap: not a readable bag: it does not begin as one of ROS 1, MCAP or SQLite; was it overwritten",
    "another suffix": "a.bag: its content is that of MCAP; give it the name a.mcap",
    "damaged": "a.mcap: .*",
}


@pytest.mark.slow
@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes(name, tmp_path):
    path, recipe = broken(tmp_path, name)
    with pytest.raises(LogError, match=MISTAKES[name]) as caught:
        drive_of_bag(path, recipe).log(_READING, "a")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "first", "program"),
    [
        ("drive.mcap.gz", b"\x1f\x8b", "gunzip"), ("drive.mcap.zst", b"\x28\xb5\x2f\xfd", "unzstd"),
        ("drive.bag.bz2", b"BZh9", "bunzip2"), ("drive.bag.zip", b"PK\x03\x04", "unzip"),
    ],
)  # fmt: skip
def test_files_that_are_compressed_as_a_whole(name, first, program, tmp_path):
    path = tmp_path / name
    path.write_bytes(first + bytes(range(256)))
    message = f"{name}: the file is compressed as a whole; unpack it first: {program} {name}$"
    with pytest.raises(FormatError, match=message):
        load(path)
    with pytest.raises(FormatError, match=message):
        comparisons.import_log(path)


def test_a_stated_place_of_the_sensor_needs_no_frames(expected, tmp_path):
    path, _ = broken(tmp_path, "unknown frame")
    recipe = Recipe(TableOptions(sensor_offset=(0.1, 0.0)))
    log = drive_of_bag(path, recipe).log(_READING, "a")
    np.testing.assert_array_equal(log.sightings, expected.sightings)
    assert log.sensor.offset == (0.1, 0.0)


def test_truth_that_is_of_no_use_is_left_out_with_a_note(tmp_path):
    maker = Maker()
    odometry(maker)
    tags(maker)
    for k in range(10):
        t = START + 10**15 + k * 10**8
        maker.add("/vicon/pose", "geometry_msgs/PoseStamped", TIMES[k], header=maker.header(t), pose=pose(0, 0))
    path = maker.write(tmp_path / "a.mcap")
    assert any("the truth was left out: the clocks of" in note for note in load(path).notes)
    with pytest.raises(LogError, match="do not overlap"):
        drive_of_bag(path, Recipe(places={"truth": {"topic": "/vicon/pose"}}))


def test_without_rosbags_a_hint_is_given(tmp_path, monkeypatch):
    import sys

    maker = Maker()
    odometry(maker)
    path = maker.write(tmp_path / "a.mcap")
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(FormatError, match=r"a.mcap: bags are read by the package rosbags: pip install -e '.\[ros\]'"):
        load(path)


def test_frames_compose_both_ways():
    frames, maker = Frames(), Maker()
    turn = (0.0, 0.0, math.sin(0.4), math.cos(0.4))
    for parent, child, place in (("base", "mast", (1, 2, 3)), ("mast", "camera", (0.5, 0, 0))):
        frames.add(maker("tf2_msgs/TFMessage", transforms=[transform(maker, 0, parent, child, place, turn)]).transforms,
                   static=True)  # fmt: skip
    position, rotation = frames.between("base", "camera")
    back, inverse = frames.between("camera", "base")
    np.testing.assert_allclose(position, np.array([1, 2, 3]) + rotation_of(turn) @ [0.5, 0, 0])
    np.testing.assert_allclose(rotation @ inverse, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(rotation @ back + position, 0, atol=1e-15)
    assert frames.between("base", "laser") is None


def test_frames_in_a_circle_are_refused():
    frames, maker, place = Frames(source="a.bag"), Maker(), (1, 0, 0)
    circle = [transform(maker, 0, *pair, place) for pair in (("mast", "base"), ("base", "mast"), ("mast", "eye"))]
    frames.add(maker("tf2_msgs/TFMessage", transforms=circle).transforms, static=True)
    with pytest.raises(
        FormatError, match="a.bag: the parents of frames in TF form a circle: 'mast', 'base', 'mast'; each"
    ):
        frames.between("eye", "base")


def test_paths_of_fields():
    maker = Maker()
    paths = leaves(maker.store.fielddefs, "apriltag_ros/msg/AprilTagDetectionArray")
    assert "detections[].id[]" in paths and "detections[].pose.pose.pose.position.x" in paths
    message = maker("my_robot/Beacons", beacons=[{"beacon_id": 4}])
    assert getter("beacons[].beacon_id")(message) == 4
    assert getter("beacons[].beacon_id")(maker("my_robot/Beacons")) is None
