"""Recordings of a comparison: each estimate's poses over time with covariances, and its map, as MCAP or for Rerun.

`write_mcap` writes messages of ROS 2, for Foxglove, RViz and every other reader of bags. Topics of each estimate, NAME with
underscores (and of the ground truth, truth)::

    /NAME/pose        geometry_msgs/PoseWithCovarianceStamped   at the time of each pose
    /NAME/path        nav_msgs/Path                             the whole drive, at its beginning; each of joined ones
    /NAME/landmarks   vision_msgs/Detection3DArray              ids, places and covariances of the map, at its beginning
    /NAME/markers     visualization_msgs/MarkerArray            the same with ellipses of three standard deviations
    /tf               tf2_msgs/TFMessage                        map -> base_link of the first estimate
    /positions        geometry_msgs/PoseWithCovarianceStamped   absolute positions; headings not measured: variance 1e6
    /relations        geometry_msgs/PoseWithCovarianceStamped   relations: a pose in the frame "base_link@T", T its time [ns]

Stamps are by the clock of the log, so that the file can be opened beside the bag that the log came from.

`write_rerun` writes a recording of Rerun (.rrd). Entities of each estimate NAME, and of the ground truth, truth; the timeline
"time" counts seconds since the first pose::

    NAME/pose        the robot as a point and an arrow; x, y, heading and their covariance as numbers in full precision
    NAME/path        the whole drive; of joined ones a line each
    NAME/landmarks   the map with ellipses of three standard deviations; ids, x, y and covariances as numbers
    error/NAME       position error [m], where the truth is known
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb

from graphslam import Log, OptionError, control_path
from graphslam.files import write_whole
from graphslam.log.measurements import NO_HEADING
from graphslam.maps.map_files import COVARIANCE, UPPER
from graphslam.se2 import Array

from ..comparison import Comparison
from ..results.files import elapsed_of
from .canvas import colour_of
from .figures import ellipses

#: controls that turn farther [rad] are drawn as arcs
_ARC = 0.2


@dataclass(frozen=True)
class Track:
    """The estimate of one estimator, or the ground truth.

    Attributes:
        name: of the estimator, or "truth".
        seconds: the time of each pose since the first pose of the log (n,).
        nanoseconds: the same by the clock of the log, (n,) whole numbers.
        poses: (n, 3), covariances: (n, 3, 3) or None.
        paths: (k, 3) along each drive of the log.
        landmarks, landmark_covariances: the map.
    """

    name: str
    seconds: Array
    nanoseconds: np.ndarray
    poses: Array
    covariances: Array | None
    paths: Sequence[Array]
    landmarks: Mapping[int, Array] = field(default_factory=dict)
    landmark_covariances: Mapping[int, Array] = field(default_factory=dict)

    @property
    def color(self) -> tuple[float, float, float]:
        """Red, green and blue from 0 to 1."""
        return to_rgb("black" if self.name == "truth" else colour_of(self.name))


def tracks(comparison: Comparison) -> Iterator[Track]:
    """The ground truth where it is known, and every estimate. In a log without times a step counts as a second."""
    log = comparison.log
    seconds, clock = elapsed_of(log), _clock(log)
    if log.true_poses is not None:
        known = np.asarray(np.isfinite(log.true_poses).all(axis=1))
        poses = log.true_poses[known]
        whole = (
            (log.true_poses, np.arange(log.num_poses)) if log.true_path is None else (log.true_path, log.control_starts)
        )
        yield Track(
            "truth", seconds[known], clock[known], poses, None, _of_drives(log, *whole), log.true_landmarks or {}
        )
    between = control_path(log, comparison.options.motion, most_turn=_ARC)
    for result in comparison.results:
        used = result.estimated
        covariances = result.pose_covariances
        along = between.through(np.where(used[:, None], result.poses, np.nan))
        yield Track(
            result.name, seconds[used], clock[used], result.poses[used], None if covariances is None else covariances[used],
            _of_drives(log, along, between.rows), result.landmarks, result.landmark_covariances,
        )  # fmt: skip


def _of_drives(log: Log, path: Array, rows: np.ndarray) -> list[Array]:
    """The known places of a path along each drive; ``rows`` (T+1,) of it are the poses of the log."""
    parts = (path[rows[drive.start] : rows[drive.stop - 1] + 1] for drive in log.drives)
    # a position whose heading is unknown is a point of the path
    return [np.nan_to_num(part[np.isfinite(part[:, :2]).all(axis=1)]) for part in parts]


def _clock(log: Log) -> np.ndarray:
    """The time of each pose (T+1,) [ns], by the clock of the log."""
    # added as whole numbers: seconds since 1970 are not exact to a nanosecond
    whole, part = divmod(log.start_time, 1)
    return int(whole) * 1_000_000_000 + round(part * 1e9) + np.rint(elapsed_of(log) * 1e9).astype(np.int64)


INSTALL_MCAP = (
    "MCAP files are written by the packages mcap-ros2-support and rosbags: pip install -e '.[ros]' in the clone"
)
FRAME = "map"
#: places of x, y and heading in the 6 x 6 covariances of ROS
_PLANE = np.array([0, 1, 5])


def _check_installed(advice: str, *modules: str) -> None:
    try:
        for module in modules:
            import_module(module)
    except ImportError:
        raise OptionError(advice) from None


def check_mcap() -> None:
    """Raise `OptionError` with what to install where the optional packages are missing."""
    _check_installed(INSTALL_MCAP, "mcap_ros2.writer", "rosbags.typesys")


def write_mcap(comparison: Comparison, path: Path) -> None:
    """Write the results of a comparison as MCAP, whole or not at all.

    Raises:
        OptionError: a package is missing.
        FormatError: the file cannot be written.
    """
    check_mcap()
    from mcap_ros2.writer import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    # vision_msgs is not among the types that come with rosbags
    detections = files("comparisons.show").joinpath("Detection3DArray.msg").read_text(encoding="utf-8")
    store.register(get_types_from_msg(detections, "vision_msgs/msg/Detection3DArray"))
    with write_whole(path) as temporary, temporary.open("wb") as stream:
        writer = Writer(stream)
        schema = cache(lambda kind: writer.register_msgdef(kind, store.generate_msgdef(kind, ros_version=2)[0]))
        for time, topic, kind, message in sorted(_messages(comparison), key=lambda each: each[0]):
            # MCAP knows no times before 1970
            writer.write_message(topic, schema(kind), message, log_time=max(0, time))
        writer.finish()


#: a message of ROS 2: numbers that are not given are 0, texts and lists empty
Message = dict[str, Any]
STAMPED = "geometry_msgs/msg/PoseWithCovarianceStamped"


def _messages(comparison: Comparison) -> Iterator[tuple[int, str, str, Message]]:
    """(time [ns], topic, type, message)."""
    log = comparison.log
    for ns, topic, message in _measured(log):
        yield ns, topic, STAMPED, message
    moving: str | None = None
    for track in tracks(comparison):
        if len(track.poses) == 0:
            continue
        prefix = "/" + track.name.replace("-", "_")
        begin = int(track.nanoseconds[0])
        for k, ns in enumerate(track.nanoseconds.tolist()):
            covariance = None if track.covariances is None else track.covariances[k]
            yield ns, f"{prefix}/pose", STAMPED, _stamped(ns, track.poses[k], covariance)
        head = _header(begin)
        for ns, path in zip(_clock(log)[[drive.start for drive in log.drives]].tolist(), track.paths):
            along = [{"header": _header(ns), "pose": _pose(at)} for at in path]
            yield ns, f"{prefix}/path", "nav_msgs/msg/Path", {"header": _header(ns), "poses": along}
        if track.landmarks:
            detections = {"header": head, "detections": _detections(track, head)}
            yield begin, f"{prefix}/landmarks", "vision_msgs/msg/Detection3DArray", detections
            yield begin, f"{prefix}/markers", "visualization_msgs/msg/MarkerArray", {"markers": _markers(track, head)}
        if moving is None and track.name != "truth":
            moving = track.name
            for pose, ns in zip(track.poses, track.nanoseconds.tolist()):
                yield ns, "/tf", "tf2_msgs/msg/TFMessage", {"transforms": [_transform(pose, ns)]}


def _measured(log: Log) -> Iterator[tuple[int, str, Message]]:
    """The relations and absolute positions of the log, as `graphslam.io.bag_messages` reads them."""
    clock = _clock(log).tolist()
    if (relations := log.relations) is not None:
        ends = zip(relations.first.tolist(), relations.second.tolist())
        for (a, b), z, C in zip(ends, relations.motions, relations.covariances):
            yield clock[b], "/relations", _stamped(clock[b], z, C, f"base_link@{clock[a]}")
    if (positions := log.positions) is not None:
        open_ = ~positions.oriented
        places, covariances = positions.places.copy(), positions.covariances.copy()
        places[open_, 2] = covariances[open_, 2] = covariances[open_, :, 2] = 0.0
        covariances[open_, 2, 2] = NO_HEADING
        for k, z, C in zip(positions.steps.tolist(), places, covariances):
            yield clock[k], "/positions", _stamped(clock[k], z, C)


def _header(ns: int, frame: str = FRAME) -> Message:
    return {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}, "frame_id": frame}


def _pose(pose: Array) -> Message:
    x, y, theta = (*map(float, pose), 0.0)[:3]
    return {"position": {"x": x, "y": y}, "orientation": {"z": float(np.sin(theta / 2)), "w": float(np.cos(theta / 2))}}


def _with_covariance(pose: Array, covariance: Array | None) -> Message:
    whole = np.zeros((6, 6))
    if covariance is not None and np.isfinite(covariance).all():
        rows = _PLANE[: len(covariance)]
        whole[np.ix_(rows, rows)] = covariance
    return {"pose": _pose(pose), "covariance": whole.ravel().tolist()}


def _stamped(ns: int, pose: Array, covariance: Array | None, frame: str = FRAME) -> Message:
    return {"header": _header(ns, frame), "pose": _with_covariance(pose, covariance)}


def _transform(pose: Array, ns: int) -> Message:
    at = _pose(pose)
    transform = {"translation": at["position"], "rotation": at["orientation"]}
    return {"header": _header(ns), "child_frame_id": "base_link", "transform": transform}


def _detections(track: Track, head: Message) -> list[Message]:
    detections = []
    for id, place in sorted(track.landmarks.items()):
        pose = _with_covariance(place, track.landmark_covariances.get(id))
        result = {"hypothesis": {"class_id": str(id), "score": 1.0}, "pose": pose}
        detections.append({"header": head, "id": str(id), "results": [result], "bbox": {"center": pose["pose"]}})
    return detections


def _markers(track: Track, head: Message) -> list[Message]:
    """For each landmark a flat cylinder, and above it the id as a text that faces the viewer."""
    color = dict(zip("rgb", track.color))
    markers = []
    for number, (id, place) in enumerate(sorted(track.landmarks.items())):
        (wide, high), turn = _ellipse(track.landmark_covariances, id)
        above = _pose(place[:2])
        above["position"]["z"] = 0.2
        markers.append({
            "header": head, "ns": track.name, "id": number, "type": 3, "pose": _pose(np.array([*place[:2], turn])),
            "scale": {"x": wide, "y": high, "z": 0.02}, "color": color | {"a": 0.5},
        })  # fmt: skip
        markers.append({
            "header": head, "ns": f"{track.name} ids", "id": number, "type": 9, "pose": above, "text": str(id),
            "scale": {"z": 0.2}, "color": color | {"a": 1.0},
        })  # fmt: skip
    return markers


def _ellipse(covariances: Mapping[int, Array], id: int) -> tuple[tuple[float, float], float]:
    """The diameters of the ellipse of three standard deviations [m], and the direction of the first one [rad]."""
    covariance = covariances.get(id)
    if covariance is None or not np.isfinite(covariance).all():
        return (0.1, 0.1), 0.0
    values, vectors = np.linalg.eigh(np.asarray(covariance)[:2, :2])
    sizes = 6 * np.sqrt(np.maximum(values, 1e-6))
    return (float(sizes[0]), float(sizes[1])), float(np.arctan2(vectors[1, 0], vectors[0, 0]))


INSTALL_RERUN = "Rerun recordings are written by the package rerun-sdk: pip install -e '.[rerun]' in the clone"
TIMELINE = "time"


def check_rerun() -> None:
    """Raise `OptionError` with what to install where the optional package is missing."""
    _check_installed(INSTALL_RERUN, "rerun")


def write_rerun(comparison: Comparison, path: Path) -> None:
    """Write the results of a comparison as a Rerun recording, whole or not at all.

    Raises:
        OptionError: the package is missing.
        FormatError: the file cannot be written.
    """
    check_rerun()
    import rerun as rr

    with write_whole(path) as temporary:
        recording = rr.RecordingStream("virtual-motion-slam", recording_id=comparison.log.name)
        recording.save(temporary)
        for track in tracks(comparison):
            if len(track.poses):
                _write_track(rr, recording, track)
        for name, errors in comparison.position_errors.items():
            known = np.isfinite(errors)
            times = rr.TimeColumn(TIMELINE, duration=elapsed_of(comparison.log)[known])
            rr.send_columns(f"error/{name}", [times], rr.Scalars.columns(scalars=errors[known]), recording=recording)
        recording.flush()
        recording.disconnect()


def _write_track(rr: Any, recording: Any, track: Track) -> None:
    color = track.color
    x, y, heading = track.poses.T
    times = rr.TimeColumn(TIMELINE, duration=track.seconds)
    numbers = {"x": x, "y": y, "heading": heading}
    if track.covariances is not None:
        numbers |= _named(track.covariances)
    arrows = np.column_stack([np.cos(heading), np.sin(heading)]) * 0.3
    robot = rr.Arrows2D.columns(origins=track.poses[:, :2], vectors=arrows, colors=[color] * len(x))
    rr.send_columns(f"{track.name}/pose", [times], [*robot, *rr.AnyValues.columns(**numbers)], recording=recording)
    recording.log(
        f"{track.name}/path", rr.LineStrips2D([path[:, :2] for path in track.paths], colors=[color]), static=True
    )
    if not track.landmarks:
        return
    ids = sorted(track.landmarks)
    places = np.array([np.append(track.landmarks[id], np.nan)[:3] for id in ids])
    known = {id: C for id in ids if (C := track.landmark_covariances.get(id)) is not None and np.isfinite(C).all()}
    covariances = np.full((len(ids), 3, 3), np.nan)
    for row, id in enumerate(ids):
        if (C := known.get(id)) is not None:
            covariances[row, : len(C), : len(C)] = C
    values = {"id": np.array(ids), **dict(zip(("x", "y", "heading"), places.T)), **_named(covariances)}
    recording.log(
        f"{track.name}/landmarks", rr.Points2D(places[:, :2], colors=[color], labels=[str(id) for id in ids], radii=0.04),
        rr.AnyValues(**values), static=True,
    )  # fmt: skip
    if known:
        curves = ellipses(track.landmarks, known)
        recording.log(f"{track.name}/landmarks/ellipses", rr.LineStrips2D(list(curves), colors=[color]), static=True)


def _named(covariances: Array) -> dict[str, Array]:
    """The numbers of covariances (n, 3, 3) by their names in tables."""
    return {name: covariances[:, i, j] for name, (i, j) in zip(COVARIANCE, UPPER)}
