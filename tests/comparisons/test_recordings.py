"""Results as MCAP and Rerun recordings have the same numbers when the official readers read them back."""

import numpy as np
import pytest
from typer.testing import CliRunner

import comparisons
from comparisons.cli import app
from comparisons.show.recordings import _messages, tracks, write_mcap, write_rerun
from graphslam import load, sample_log_path


@pytest.fixture(scope="module")
def comparison():
    log = load(sample_log_path()).at_steps(range(0, 60))
    # a clock since 1970 keeps its nanoseconds
    return comparisons.run(log.replace(start_time=1_716_000_000.25), estimators=["dead-reckoning", "graph"])


@pytest.fixture(scope="module")
def messages(comparison, tmp_path_factory):
    """{topic: [(schema, log time, message)]} of the MCAP file, by the official reader."""
    mcap_reader = pytest.importorskip("mcap.reader")
    decoder = pytest.importorskip("mcap_ros2.decoder")
    path = tmp_path_factory.mktemp("mcap") / "out.mcap"
    write_mcap(comparison, path)
    found = {}
    with path.open("rb") as stream:
        reader = mcap_reader.make_reader(stream, decoder_factories=[decoder.DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append((schema.name, message.log_time, decoded))
    return found


def planar(pose):
    turn = pose.orientation
    return [pose.position.x, pose.position.y, 2 * np.arctan2(turn.z, turn.w)]


def test_poses_and_covariances_of_mcap(comparison, messages):
    result = comparison["graph"]
    found = messages["/graph/pose"]
    assert {schema for schema, _, _ in found} == {"geometry_msgs/msg/PoseWithCovarianceStamped"}
    poses = np.array([planar(message.pose.pose) for _, _, message in found])
    np.testing.assert_array_equal(poses[:, :2], result.poses[:, :2])
    np.testing.assert_allclose(np.angle(np.exp(1j * (poses[:, 2] - result.poses[:, 2]))), 0, atol=1e-15)
    covariances = np.array([np.reshape(m.pose.covariance, (6, 6)) for _, _, m in found])[:, [[0], [1], [5]], [0, 1, 5]]
    np.testing.assert_array_equal(covariances, result.pose_covariances)
    log = comparison.log
    expected = 1_716_000_000_250_000_000 + np.rint(np.concatenate([[0], np.cumsum(log.dt)]) * 1e9).astype(np.int64)
    assert [time for _, time, _ in found] == expected[log.control_starts].tolist()
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for _, _, m in found]
    assert stamps == [time for _, time, _ in found]


def test_maps_of_mcap(comparison, messages):
    result = comparison["graph"]
    ((schema, _, message),) = messages["/graph/landmarks"]
    assert schema == "vision_msgs/msg/Detection3DArray"
    assert [int(each.id) for each in message.detections] == sorted(result.landmarks)
    for each in message.detections:
        pose, covariance = each.results[0].pose.pose, np.reshape(each.results[0].pose.covariance, (6, 6))
        np.testing.assert_array_equal(planar(pose)[:2], result.landmarks[int(each.id)][:2])
        expected = result.landmark_covariances[int(each.id)]
        np.testing.assert_array_equal(covariance[np.ix_([0, 1, 5], [0, 1, 5])], expected)
    ((_, _, markers),) = messages["/graph/markers"]
    assert len(markers.markers) == 2 * len(result.landmarks)
    shape = markers.markers[0]
    values = np.linalg.eigvalsh(result.landmark_covariances[sorted(result.landmarks)[0]][:2, :2])
    np.testing.assert_allclose(sorted([shape.scale.x, shape.scale.y]), 6 * np.sqrt(values))


def test_paths_truth_and_frames_of_mcap(comparison, messages):
    log = comparison.log
    assert {"/truth/pose", "/truth/landmarks", "/dead_reckoning/path", "/tf"} <= messages.keys()
    ((_, _, path),) = messages["/dead_reckoning/path"]
    assert len(path.poses) >= log.num_poses
    moved = messages["/tf"][7][2].transforms[0]
    assert (moved.header.frame_id, moved.child_frame_id) == ("map", "base_link")
    assert moved.transform.translation.x == comparison.results[0].poses[7, 0]


def test_joined_drives_have_a_path_each():
    """One line would cross the gap between them, where nobody knows the way."""
    log = load(sample_log_path())
    halves = [log.at_steps(range(0, 30)), log.at_steps(range(30, 60))]
    found = comparisons.run(halves, estimators=["dead-reckoning"])
    for track in tracks(found):
        assert [len(path) >= 30 for path in track.paths] == [True, True]
        np.testing.assert_allclose([path[0] for path in track.paths], track.poses[[0, 30]])
    paths = [message for _, topic, _, message in _messages(found) if topic == "/dead_reckoning/path"]
    assert [len(path["poses"]) for path in paths] == [len(path) for path in track.paths]


def test_our_own_reader_opens_it(comparison, tmp_path):
    from graphslam.io.bag_drive import topics_of

    write_mcap(comparison, tmp_path / "out.mcap")
    counts = {each.topic.name: each.topic.count for each in topics_of(tmp_path / "out.mcap")}
    assert counts["/graph/pose"] == comparison.log.num_poses


def rerun_columns(path, entity):
    """{column: values} of an entity, by the official reader."""
    chunk = pytest.importorskip("rerun.chunk")
    columns = {}
    for each in chunk.RrdReader(path).stream().to_chunks():
        if each.entity_path.strip("/") == entity:
            batch = each.to_record_batch()
            columns |= dict(zip(batch.schema.names, (column.to_pylist() for column in batch.columns)))
    return columns


@pytest.mark.nightly
def test_rerun_has_the_same_numbers(comparison, tmp_path):
    pytest.importorskip("rerun")
    path = tmp_path / "out.rrd"
    write_rerun(comparison, path)
    result, log = comparison["graph"], comparison.log
    columns = rerun_columns(path, "graph/pose")

    def column(name):
        return np.array(
            [values[0] for key, values_of in columns.items() if key.split(":")[-1] == name for values in values_of]
        )

    order = np.argsort([t.total_seconds() for t in columns["time"]])
    seconds = np.array([t.total_seconds() for t in columns["time"]])[order]
    np.testing.assert_allclose(seconds, log.times - log.times[0], atol=1e-6)
    for k, name in enumerate(("x", "y", "heading")):
        np.testing.assert_array_equal(column(name)[order], result.poses[:, k])
    np.testing.assert_array_equal(column("cov_xy")[order], result.pose_covariances[:, 0, 1])
    columns = rerun_columns(path, "graph/landmarks")
    (ids,) = next(values for key, values in columns.items() if key.endswith(":id") or key == "id")
    assert list(np.ravel(ids)) == sorted(result.landmarks)
    columns = rerun_columns(path, "error/graph")
    assert any("calars" in key for key in columns)


def test_the_verb_writes_both(tmp_path, monkeypatch):
    pytest.importorskip("rerun")
    monkeypatch.chdir(tmp_path)
    words = [
        "run",
        "--estimators",
        "dead-reckoning",
        "--out",
        "out",
        "--figures",
        "",
        "--mcap",
        "a.mcap",
        "--rerun",
        "a.rrd",
    ]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    assert "Wrote a.mcap." in result.output and "Wrote a.rrd." in result.output
    assert (tmp_path / "a.mcap").read_bytes().startswith(b"\x89MCAP0\r\n") and (
        tmp_path / "a.rrd"
    ).stat().st_size > 1000


@pytest.mark.parametrize(
    ("words", "module", "message"),
    [
        (["--mcap", "a.txt"], None, "a.txt: the name of this file must end in .mcap"),
        (
            ["--mcap", "a.mcap"],
            "mcap_ros2.writer",
            "MCAP files are written by the packages mcap-ros2-support and rosbags",
        ),
        (["--rerun", "a.rrd"], "rerun", "Rerun recordings are written by the package rerun-sdk: pip install"),
    ],
)
def test_mistakes_are_said_before_the_work(words, module, message, monkeypatch, tmp_path):
    import sys

    monkeypatch.chdir(tmp_path)
    if module:
        monkeypatch.setitem(sys.modules, module, None)
    result = CliRunner().invoke(app, ["run", *words])
    assert result.exit_code == 2 and message in result.output
