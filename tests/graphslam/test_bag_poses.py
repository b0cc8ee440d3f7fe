"""Topics of poses and of GPS become relations and absolute positions of the log."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")

from bags import Maker, point, pose, quaternion, transform, twist
from rosbags.convert.converter import convert

import comparisons
from comparisons.show.recordings import write_mcap
from graphslam import AbsolutePositions, FormatError, Graph, Log, PoseRelations, load, simulate, solve
from graphslam.io.bag_drive import drive_of_bag
from graphslam.io.bag_messages import Frames, Poses, positions_table, relations_table
from graphslam.io.bag_topics import open_bag
from graphslam.io.tables import Recipe, read_recipe
from graphslam.log.geometry import local_plane
from graphslam.log.rows import ReadOptions
from graphslam.log.table import Columns
from graphslam.se2 import between, compose

START = 1_716_000_000_000_000_000
STEP = 100_000_000
COUNT = 200
TIMES = [START + k * STEP for k in range(COUNT)]
#: a circle of 5 m, and its poses
NU, OMEGA = 0.5, 0.1
ANGLES = OMEGA * 0.1 * np.arange(COUNT)
TRUTH = np.column_stack([5 * np.sin(ANGLES), 5 * (1 - np.cos(ANGLES)), ANGLES])
DATUM = (35.0, 139.0, 40.0)


def whole(variances: dict[tuple[int, int], float]) -> np.ndarray:
    """A covariance (36,) of ROS with some entries."""
    C = np.zeros((6, 6))
    for (i, j), value in variances.items():
        C[i, j] = C[j, i] = value
    return C.ravel()


def drive(ros: int = 2) -> Maker:
    maker = Maker(ros)
    for t in TIMES:
        fields = {
            "header": maker.header(t, "odom"),
            "child_frame_id": "base_link",
            "twist": {"twist": twist(NU, OMEGA)},
        }
        maker.add("/odom", "nav_msgs/Odometry", t, **fields)
    for k in range(0, COUNT, 10):
        seen = between(TRUTH[k], np.array([2.0, 6.0, 0.0]))
        inner = {"pose": {"position": point(*seen[:2]), "orientation": quaternion(0.0)}}
        head = maker.header(TIMES[k], "base_link")
        detection = {"id": [1], "size": [0.2], "pose": {"header": head, "pose": inner}}
        maker.add("/tags", "apriltag_ros/AprilTagDetectionArray", TIMES[k], header=head, detections=[detection])
    return maker


def degrees_of(places: np.ndarray) -> np.ndarray:
    """Latitude and longitude of places (N, 2) [m] near the datum, by Newton's method on `local_plane`."""
    found = np.tile(DATUM[:2], (len(places), 1)).astype(float)
    for _ in range(5):
        off = places - local_plane(found, np.array(DATUM))
        found += off[:, ::-1] / np.array([110_941.0, 91_288.0])
    return found


def log_of(path: Path, topics: dict[str, str], numbers: dict[str, dict[str, list[float]]] | None = None) -> Log:
    places = {kind: {"file": topic, "topic": topic} for kind, topic in topics.items()}
    return drive_of_bag(path, Recipe(places=places, numbers=numbers or {})).log(ReadOptions(), "bag")


def gps(maker: Maker, places: np.ndarray, kind: int = 2, status: int = 0) -> None:
    for k, (latitude, longitude) in enumerate(degrees_of(places).tolist()):
        C = [0.04, 0.01, 0, 0.01, 0.09, 0, 0, 0, 1.0]
        fields = {"latitude": latitude, "longitude": longitude, "altitude": 40.0, "status": {"status": status}}
        maker.add(
            "/gps/fix", "sensor_msgs/NavSatFix", TIMES[10 * k], header=maker.header(TIMES[10 * k], "gps_link"), **fields,
            position_covariance=C, position_covariance_type=kind,
        )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("ros", "name", "storage"), [(1, "a.bag", ""), (2, "a.mcap", "mcap"), (2, "a.db3", "sqlite")])
def test_fixes_are_positions_of_the_antenna(tmp_path: Path, ros: int, name: str, storage: str) -> None:
    maker = drive(ros)
    antenna = compose(TRUTH[::10], [0.3, 0.1, 0.0])[:, :2]
    gps(maker, antenna)
    mounted = transform(maker, START, "base_link", "gps_link", (0.3, 0.1, 1.0))
    maker.add("/tf_static", "tf2_msgs/TFMessage", START, transforms=[mounted])
    path = maker.write(tmp_path / name, storage)
    log = log_of(path, {"positions": "/gps/fix"})
    positions = log.positions
    assert positions is not None and len(positions) == 20
    # the datum is the first fix
    assert np.allclose(positions.places[:, :2], antenna - antenna[0], atol=2e-5)
    assert np.allclose(positions.covariances[:, :2, :2], [[0.04, 0.01], [0.01, 0.09]])
    assert np.allclose(positions.levers, [0.3, 0.1]) and not positions.oriented.any()
    assert "latitude 35.0000009" in " ".join(log.notes) and "(WGS 84)" in " ".join(log.notes)
    solution = solve(Graph.from_log(log, kernel="none"))
    assert np.abs(compose(solution.poses, [0.3, 0.1, 0.0])[:, :2] - (antenna - antenna[0])).max() < 0.01
    # a topic that is not named is not used
    assert log_of(path, {}).positions is None
    assert "positions='/gps/fix'" in " ".join(log_of(path, {}).notes)


def test_the_plane_is_that_of_the_earth() -> None:
    # a minute of latitude at 45 degrees is one of a circle with the meridian's radius of curvature there, 6,367,382 m; one of
    # longitude at the equator is a 21,600th of the circumference
    north = local_plane(np.array([[45 + 1 / 120, 7.0], [45 - 1 / 120, 7.0]]), np.array([45.0, 7.0, 0.0]))
    assert north[0, 1] - north[1, 1] == pytest.approx(6_367_381.8 * np.pi / 180 / 60, rel=1e-6)
    east = local_plane(np.array([[0.0, 1 / 60]]), np.zeros(3))
    assert east[0] == pytest.approx([2 * np.pi * 6_378_137 / 21_600, 0.0], rel=1e-6, abs=1e-9)


def test_fixes_without_a_covariance_or_without_a_fix_are_said(tmp_path: Path) -> None:
    maker = drive()
    gps(maker, TRUTH[::10, :2], kind=0)
    maker.add(
        "/gps/fix",
        "sensor_msgs/NavSatFix",
        TIMES[5],
        header=maker.header(TIMES[5]),
        latitude=np.nan,
        status={"status": -1},
    )
    path = maker.write(tmp_path / "a.mcap")
    log = log_of(path, {"positions": "/gps/fix"})
    assert log.positions is not None and np.allclose(log.positions.covariances[:, 0, 0], 25.0)
    notes = " ".join(log.notes)
    assert "20 of 20 fixes" in notes and "standard deviation of 5 m is assumed" in notes
    assert "1 of 21 messages" in notes and "have no fix" in notes
    stated = log_of(path, {"positions": "/gps/fix"}, {"positions": {"std": [0.5], "lever": [0.2, 0.0]}}).positions
    assert (
        stated is not None
        and np.allclose(stated.covariances[:, 0, 0], 0.25)
        and stated.levers[0].tolist() == [0.2, 0.0]
    )


def test_poses_with_covariance_are_positions_with_headings(tmp_path: Path) -> None:
    maker = drive()
    for k in range(0, COUNT, 20):
        known = {(0, 0): 0.01, (0, 1): 0.002, (1, 1): 0.02, (5, 5): 0.003 if k % 40 == 0 else 1e6, (0, 5): 1e-4}
        inner = {"pose": pose(*TRUTH[k]), "covariance": whole(known)}
        maker.add(
            "/pose",
            "geometry_msgs/PoseWithCovarianceStamped",
            TIMES[k],
            header=maker.header(TIMES[k], "map"),
            pose=inner,
        )
    positions = log_of(maker.write(tmp_path / "a.mcap"), {"positions": "pose"}).positions
    assert positions is not None
    assert np.allclose(positions.places[:, :2], TRUTH[::20, :2])
    assert positions.oriented.tolist() == [True, False] * 5
    assert np.allclose(positions.places[::2, 2], TRUTH[::40, 2])
    assert np.allclose(positions.covariances[0], [[0.01, 0.002, 1e-4], [0.002, 0.02, 0], [1e-4, 0, 0.003]])


def second_odometry(
    maker: Maker, poses: np.ndarray, covariances: np.ndarray, frame: str = "lidar", speeds: float = 0.0
) -> None:
    for k, t in enumerate(TIMES):
        if 95 <= k < 130:
            continue  # a pause of 3.5 s
        C = np.zeros((6, 6))
        C[np.ix_([0, 1, 5], [0, 1, 5])] = covariances[k]
        moving = {"twist": twist(NU, OMEGA), "covariance": whole({(0, 0): speeds, (5, 5): speeds})}
        inner = {"pose": pose(*poses[k]), "covariance": C.ravel()}
        maker.add(
            "/lio",
            "nav_msgs/Odometry",
            t,
            header=maker.header(t, "lio"),
            child_frame_id=frame,
            pose=inner,
            twist=moving,
        )


def test_a_second_odometry_is_relations(tmp_path: Path) -> None:
    """Poses of a lidar that is mounted turned; its covariances grow as those of dead reckoning do."""
    mounted, Q = np.array([0.2, 0.1, np.pi / 2]), np.diag([1e-5, 2e-5, 1e-6])
    start = np.array([1.0, 2.0, 0.5])
    poses = compose(start, between(mounted, compose(TRUTH, mounted)))
    P = [np.zeros((3, 3))]
    for a, b in zip(poses, poses[1:]):
        F = np.array([[1, 0, a[1] - b[1]], [0, 1, b[0] - a[0]], [0, 0, 1]])
        c, s = np.cos(a[2]), np.sin(a[2])
        J = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        P.append(F @ P[-1] @ F.T + J @ Q @ J.T)
    maker = drive()
    second_odometry(maker, poses, np.array(P))
    half = np.sqrt(0.5)
    turn = transform(maker, START, "base_link", "lidar", (0.2, 0.1, 0), (0, 0, half, half))
    maker.add("/tf_static", "tf2_msgs/TFMessage", START, transforms=[turn])
    log = log_of(maker.write(tmp_path / "a.mcap"), {"relations": "/lio"})
    relations = log.relations
    # a relation a second, but for the one across the pause
    assert relations is not None and log.times is not None and len(relations) == 15
    at = np.rint((log.times - START / 1e9) * 10).astype(int)
    expected = between(TRUTH[at[relations.first]], TRUTH[at[relations.second]])
    assert np.allclose(relations.motions, expected, atol=1e-6)
    # ten motions, whose heading errors move what follows
    assert np.allclose(relations.covariances[:, 2, 2], 1e-5, rtol=1e-6)
    assert np.all(np.linalg.eigvalsh(relations.covariances)[:, 0] > 0.9e-5 / 10)
    notes = " ".join(log.notes)
    assert "what the covariances of its poses grow by" in notes and "because of 1 pauses and 0 jumps" in notes


def test_the_noise_of_a_second_odometry_may_be_that_of_its_speeds_or_is_stated(tmp_path: Path) -> None:
    maker, poses = drive(), TRUTH.copy()
    poses[150:, 0] += 30.0  # the program lost its way
    second_odometry(maker, poses, np.tile(0.01 * np.eye(3), (COUNT, 1, 1)), "base_link", speeds=4e-4)
    path = maker.write(tmp_path / "a.mcap")
    log = log_of(path, {"relations": "/lio"})
    assert log.relations is not None and "because of 1 pauses and 1 jumps" in " ".join(log.notes)
    assert np.abs(log.relations.motions[:, 0]).max() < 1.0
    # ten messages of 0.1 s
    assert np.allclose(np.diagonal(log.relations.covariances, axis1=1, axis2=2), 10 * 4e-4 * 0.01)
    maker = drive()
    second_odometry(maker, TRUTH, np.zeros((COUNT, 3, 3)), "base_link")
    path = maker.write(tmp_path / "b.mcap")
    with pytest.raises(
        FormatError, match=r"covariances of its messages are zero.*\[relations\] std = \[METRES, RADIANS\]"
    ):
        log_of(path, {"relations": "/lio"})
    stated = log_of(path, {"relations": "/lio"}, {"relations": {"std": [0.02, 0.01]}}).relations
    assert stated is not None and np.allclose(stated.covariances[0], np.diag([4e-4, 4e-4, 1e-4]))


def test_topics_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    maker = drive()
    gps(maker, TRUTH[::10, :2])
    path = maker.write(tmp_path / "a.mcap")
    with pytest.raises(FormatError, match="give no relations; PoseWithCovarianceStamped, Odometry, PoseStamped do"):
        log_of(path, {"relations": "/gps/fix"})
    with pytest.raises(FormatError, match="there is no topic '/gps/fixx'; did you mean '/gps/fix'"):
        log_of(path, {"positions": "/gps/fixx"})
    recipe = tmp_path / "a.toml"
    recipe.write_text('[positions]\ntopic = "/gps/fix"\nstd = [0.5]\nlever = [0.1, 0.0]\n')
    assert read_recipe(recipe).numbers == {"positions": {"std": [0.5], "lever": [0.1, 0.0]}}
    recipe.write_text("[positions]\nstd = [-0.5]\n")
    with pytest.raises(FormatError, match=r"a.toml:2: .*std should be \[METRES\] or \[METRES, RADIANS\]"):
        read_recipe(recipe)


def test_the_export_of_a_run_gives_them_back(tmp_path: Path) -> None:
    log = simulate(seed=1, steps=40, clean=True)
    C = np.array([[0.01, 0.002, 0.0], [0.002, 0.02, 0.001], [0.0, 0.001, 0.03]])
    log = log.replace(
        start_time=1000.5,
        relations=PoseRelations(
            first=[0, 30], second=[20, 2], motions=[[1.0, 2.0, 0.5], [3.0, 0.1, np.nan]], covariances=C
        ),
        positions=AbsolutePositions(steps=[3, 9], places=[[1.0, 2.0, 0.3], [3.0, 4.0, np.nan]], covariances=C),
    )
    write_mcap(comparisons.run(log, estimators=["dead-reckoning"]), tmp_path / "run.mcap")
    found: dict[str, Columns] = {}
    with open_bag(tmp_path / "run.mcap") as bag:
        for kind in ("relations", "positions"):
            topic = next(each for each in bag.topics if each.name == f"/{kind}")
            collected = Poses(f"run.mcap: /{kind}", kind, topic.type)
            for _, time, message in bag.messages([topic.name]):
                collected.add(time, message)
            if kind == "relations":
                found[kind] = relations_table(collected, Frames(), "base_link", None)[0]
            else:
                found[kind] = positions_table(collected, Frames(), "base_link", None, None)[0]

    def columns(table: Columns) -> dict[str, np.ndarray]:
        return dict(zip(table.names, table._columns))

    assert log.times is not None and log.relations is not None and log.positions is not None
    seen = {
        "t": log.times[log.steps],
        "id": log.landmarks,
        "range": log.sightings[:, 0],
        "bearing": log.sightings[:, 1],
    }
    again = Log.from_tables(
        {"t": log.times, "nu": np.ones(41), "omega": np.zeros(41)}, seen, relations=columns(found["relations"]),
        positions=columns(found["positions"]), time={"relations": "ns", "positions": "ns"},
    )  # fmt: skip
    assert again.relations is not None and again.positions is not None and again.times is not None
    order = np.argsort(again.relations.motions[:, 0])
    for end in ("first", "second"):
        assert np.allclose(log.times[getattr(log.relations, end)], again.times[getattr(again.relations, end)[order]])
    assert np.allclose(again.relations.motions[order], log.relations.motions)
    assert np.allclose(again.relations.covariances[order], log.relations.covariances)
    assert np.allclose(again.positions.places, log.positions.places, equal_nan=True)
    assert np.allclose(again.positions.covariances[:, :2, :2], log.positions.covariances[:, :2, :2])


@pytest.mark.slow
def test_messages_that_are_compressed_one_by_one_need_the_folder(tmp_path: Path) -> None:
    """Their file alone does not say so, and was called "cut short"."""
    source, folder = drive().write(tmp_path / "a.mcap"), tmp_path / "packed"
    convert([source], folder, "mcap", 9, "zstd", "message", None, None, (), (), (), ())
    assert load(folder).equals(load(source))
    with pytest.raises(
        FormatError, match="messages cannot be decoded; name the folder of the recording, with metadata.yaml"
    ):
        load(folder / "packed.mcap")
