"""`evaluate`: trajectories and maps of any program against the ground truth."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import comparisons
from comparisons.cli import make_app
from comparisons.results.files import tum_text
from graphslam import (
    FormatError,
    LandmarkMap,
    LogError,
    OptionError,
    join_logs,
    load,
    metrics,
    sample_log_path,
    save,
    simulate,
)
from graphslam.maps.map_files import COVARIANCE, UPPER
from graphslam.se2 import compose

TIMES = 100.0 + 0.1 * np.arange(200)
#: half a circle of 10 m in 20 s
TRUE = np.column_stack([
    10 * np.sin(np.pi * (TIMES - 100) / 20), 10 - 10 * np.cos(np.pi * (TIMES - 100) / 20), np.pi * (TIMES - 100) / 20
])  # fmt: skip


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    path = tmp_path / "truth.tum"
    path.write_text(tum_text(TIMES, TRUE))
    return path


def written(path: Path, times: np.ndarray, poses: np.ndarray, covariances: np.ndarray | None = None) -> Path:
    names, columns = ["t", "x", "y", "theta"], [times, *poses.T]
    if covariances is not None:
        names += COVARIANCE
        columns += [covariances[:, i, j] for i, j in UPPER]
    rows = [",".join(map(repr, map(float, row))) for row in zip(*columns)]
    path.write_text("\n".join([",".join(names), *rows]) + "\n")
    return path


def test_the_errors_are_those_of_the_metrics(truth: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    poses = compose([3.0, -2.0, 0.7], TRUE) + rng.normal(0, [0.1, 0.1, 0.02], TRUE.shape)
    found = comparisons.evaluate(truth, written(tmp_path / "mine.csv", TIMES, poses)).estimates[0]
    assert (found.name, found.poses, found.compared) == ("mine", 200, 200)
    assert found.ate_m == pytest.approx(metrics.ate(TRUE, poses), rel=1e-6)
    assert (found.rpe_m, found.rpe_rad) == pytest.approx(metrics.rpe(TRUE, poses), rel=1e-6)
    assert found.heading_rad == pytest.approx(metrics.heading_rmse(TRUE, poses), rel=1e-6)
    assert found.most_m == pytest.approx(metrics.position_errors(TRUE, poses).max(), rel=1e-6)
    assert found.nees is None and found.gospa_m is None


def test_the_truth_is_taken_at_the_times_of_the_estimate(truth: Path, tmp_path: Path) -> None:
    """Between two true poses on their arc: a chord of this circle would be 0.3 mm off."""
    times = np.arange(99.05, 125.0, 0.1)
    turned = np.pi * (times - 100) / 20
    poses = np.column_stack([10 * np.sin(turned), 10 - 10 * np.cos(turned), turned])
    found = comparisons.evaluate(truth, written(tmp_path / "mine.csv", times, poses)).estimates[0]
    assert found.compared == np.count_nonzero((times >= TIMES[0]) & (times <= TIMES[-1]))
    assert found.ate_m < 1e-6
    # with gaps of five seconds in the truth
    rare = tmp_path / "rare.tum"
    rare.write_text(tum_text(TIMES[::50], TRUE[::50]))
    few = comparisons.evaluate(rare, tmp_path / "mine.csv", longest_gap=5.5).estimates[0]
    assert few.compared == np.count_nonzero((times >= 100.0) & (times <= 115.0)) and few.ate_m < 1e-4
    with pytest.raises(
        LogError, match="0 of 260 poses are at a time at which the truth is known; the truth goes from 100"
    ):
        comparisons.evaluate(rare, tmp_path / "mine.csv")


def test_no_motion_leads_across_a_gap_in_the_truth(tmp_path: Path) -> None:
    """Every step is 10 % too long, so that one across the gap would be off by ten times as much as the others."""
    known = (TIMES < 108) | (TIMES > 109.05)
    gap = tmp_path / "gap.tum"
    gap.write_text(tum_text(TIMES[known], TRUE[known]))
    found = comparisons.evaluate(gap, written(tmp_path / "mine.csv", TIMES, TRUE * [1.1, 1.1, 1.0])).estimates[0]
    assert found.compared == np.count_nonzero(known) < 200
    step = 20 * np.sin(np.pi / 20 * 0.05)
    assert found.rpe_m == pytest.approx(0.1 * step, rel=1e-6)


@pytest.mark.parametrize("held", [True, False])
def test_right_covariances_have_a_nees_of_one(truth: Path, tmp_path: Path, held: bool) -> None:
    rng = np.random.default_rng(1)
    root = np.array([[0.1, 0, 0], [0.05, 0.2, 0], [0.01, 0.02, 0.03]])
    poses = TRUE + rng.normal(size=TRUE.shape) @ root.T
    covariances = np.broadcast_to(root @ root.T, (len(poses), 3, 3)).copy()
    if held:
        # the errors of the others are those in the frame of the first pose, wherever it is said to be
        poses[0], covariances[0] = TRUE[0], 0.0
        frame = np.array([5.0, 1.0, 0.0])
        poses = compose(frame, poses)
    found = comparisons.evaluate(truth, written(tmp_path / "mine.csv", TIMES, poses, covariances)).estimates[0]
    # the mean of 200 values of chi-square / 3, whose standard deviation is sqrt(2/3)
    assert found.nees == pytest.approx(1.0, abs=4 * (2 / 3 / 200) ** 0.5)


def test_units_of_the_truth_are_not_those_of_the_estimate(tmp_path: Path) -> None:
    degrees = TRUE * [1.0, 1.0, 180 / np.pi]
    truth = written(tmp_path / "truth.csv", TIMES, degrees)
    estimate = written(tmp_path / "mine.csv", TIMES, TRUE)
    found = comparisons.evaluate(truth, estimate, angles="truth=degrees").estimates[0]
    assert found.heading_rad is not None and found.heading_rad < 1e-9
    both = comparisons.evaluate(truth, written(tmp_path / "theirs.csv", TIMES, degrees), angles="degrees").estimates[0]
    assert both.heading_rad is not None and both.heading_rad < 1e-9
    theirs = comparisons.evaluate(estimate, tmp_path / "theirs.csv", angles="estimates=degrees").estimates[0]
    assert theirs.heading_rad is not None and theirs.heading_rad < 1e-9
    nameless = tmp_path / "names.csv"
    nameless.write_text(estimate.read_text().replace("t,x,y", "when,x,y", 1))
    # the advice is one that helps
    with pytest.raises(LogError, match=r"columns='estimates\.t=NAME'"):
        comparisons.evaluate(estimate, nameless)
    assert comparisons.evaluate(estimate, nameless, columns="estimates.t=when").estimates[0].ate_m < 1e-9
    covariances = np.broadcast_to(np.eye(3), (len(TIMES), 3, 3))
    path = written(tmp_path / "units.csv", TIMES, degrees, covariances)
    with pytest.raises(LogError, match="poses with covariances must be in metres and radians"):
        comparisons.evaluate(truth, path, angles="degrees")


def test_maps_are_compared_by_id_and_by_place(truth: Path, tmp_path: Path) -> None:
    estimate = written(tmp_path / "mine.csv", TIMES, compose([1.0, 2.0, 0.5], TRUE))
    right = LandmarkMap({j: [2.0 * j, 3.0] for j in range(5)})
    right.save(tmp_path / "true.csv")
    # 0 is missed, 3 and 4 are exchanged, 9 does not exist; all others are 0.1 m off
    places = {1: [2.1, 3.0], 2: [4.1, 3.0], 4: [6.1, 3.0], 3: [8.1, 3.0], 9: [50.0, 50.0]}
    LandmarkMap({j: compose([1.0, 2.0, 0.5], [*p, 0.0])[:2] for j, p in places.items()}).save(tmp_path / "map.csv")
    options = {"true_map": tmp_path / "true.csv", "map": (str(tmp_path / "map.csv"),)}
    by_id = comparisons.evaluate(truth, estimate, **options).estimates[0]
    assert (by_id.landmarks, by_id.missed, by_id.false) == (5, 1, 1)
    assert by_id.landmark_rmse_m == pytest.approx(np.sqrt((2 * 0.1**2 + 1.9**2 + 2.1**2) / 4), rel=1e-6)
    assert by_id.gospa_m == pytest.approx(np.sqrt(4 * 0.1**2 + 2 / 2), rel=1e-6)
    by_place = comparisons.evaluate(truth, estimate, match="place", cutoff=0.5, **options).estimates[0]
    assert by_place.landmark_rmse_m == pytest.approx(0.1, rel=1e-6)
    assert by_place.gospa_m == pytest.approx(np.sqrt(4 * 0.1**2 + 2 * 0.25 / 2), rel=1e-6)
    assert not by_id.notes


def test_a_map_with_other_ids_has_no_error_and_a_note_says_so(truth: Path, tmp_path: Path) -> None:
    estimate = written(tmp_path / "mine.csv", TIMES, TRUE)
    places = {j: [2.0 * j, 3.0] for j in range(5)}
    LandmarkMap(places).save(tmp_path / "true.csv")
    LandmarkMap({j + 100: place for j, place in places.items()}).save(tmp_path / "map.csv")
    options = {"true_map": tmp_path / "true.csv", "map": (str(tmp_path / "map.csv"),)}
    by_id = comparisons.evaluate(truth, estimate, **options)
    assert by_id.estimates[0].landmark_rmse_m is None
    assert by_id.notes == (
        "mine: the map has no id of the true map, so that its error is not known; --match place finds pairs by place",
    )
    by_place = comparisons.evaluate(truth, estimate, match="place", **options)
    assert by_place.estimates[0].landmark_rmse_m == pytest.approx(0.0, abs=1e-9) and not by_place.notes


def test_gospa_against_all_assignments() -> None:
    from itertools import permutations

    rng = np.random.default_rng(3)
    true, found = ({j: rng.uniform(0, 3, 2) for j in range(n)} for n in (4, 5))
    c = 1.2
    best = min(
        sum(min(np.sum((true[j] - found[k]) ** 2), c**2) for j, k in zip(true, chosen)) + c**2 / 2
        for chosen in permutations(found, 4)
    )
    assert metrics.gospa(true, found, c) == pytest.approx(best**0.5, rel=1e-12)
    assert metrics.gospa(true, {}, c) == pytest.approx((4 * c**2 / 2) ** 0.5)
    assert metrics.gospa({}, {}, c) == 0.0


def test_what_run_writes_has_the_errors_of_its_table(tmp_path: Path) -> None:
    """Also against the log, whose true poses and map count."""
    comparison = comparisons.run(sample_log_path(), estimators=["graph"])
    comparison.save(tmp_path, figures=())
    save(load(sample_log_path()), tmp_path / "log.npz")
    for right in (tmp_path / "truth.tum", tmp_path / "log.npz"):
        options = {"map": [str(tmp_path / "graph-map.npz")], "true_map": str(tmp_path / "truth-map.csv")}
        if right.suffix == ".npz":
            del options["true_map"]
        found = comparisons.evaluate(right, tmp_path / "graph.tum", **options).estimates[0]
        row = comparison.table["graph"]
        assert found.ate_m == pytest.approx(row.ate_m, abs=1e-6)
        assert found.rpe_m == pytest.approx(row.rpe_m, abs=1e-6)
        assert found.landmark_rmse_m == pytest.approx(row.landmark_rmse_m, abs=1e-6)


def test_a_joined_log_is_no_truth_for_the_clocks_of_each(tmp_path: Path) -> None:
    log = simulate(seed=11, steps=90, clean=True)
    parts = [log.at_steps(np.arange(45)), log.at_steps(np.arange(45, 91)).replace(start_time=0.0)]
    comparison = comparisons.run(join_logs(parts).log, estimators=["graph"], noise="book")
    comparison.save(tmp_path, figures=())
    save(comparison.log, tmp_path / "joined.npz")
    # at the times of the second the joined log has the poses of the first
    with pytest.raises(LogError, match=r"joined from several logs, .* take truth-1\.tum, truth-2\.tum"):
        comparisons.evaluate(tmp_path / "joined.npz", tmp_path / "graph-2.tum")
    found = comparisons.evaluate(tmp_path / "truth-2.tum", tmp_path / "graph-2.tum").estimates[0]
    assert found.compared == found.poses == 46 and found.ate_m < 0.5


def test_unknown_headings_that_run_writes_as_zero_stay_unknown(tmp_path: Path) -> None:
    log = simulate(seed=1, steps=60)
    assert log.true_poses is not None
    log = log.replace(true_poses=log.true_poses * [1, 1, np.nan])
    comparison = comparisons.run(log, estimators=["graph"], noise="book")
    comparison.save(tmp_path, figures=())
    found = comparisons.evaluate(tmp_path / "truth.tum", tmp_path / "graph.tum").estimates[0]
    assert found.ate_m == pytest.approx(comparison.table["graph"].ate_m, abs=1e-6)
    assert (found.rpe_m, found.rpe_rad, found.heading_rad) == (None, None, None)


def test_the_verb_writes_table_json_and_figure(truth: Path, tmp_path: Path) -> None:
    mine = written(tmp_path / "mine.csv", TIMES, TRUE + [0.1, 0.0, 0.0] * np.sin(TIMES)[:, None])
    flat = tmp_path / "flat.csv"
    flat.write_text("t,x,y\n" + "\n".join(f"{t!r},{x!r},{y!r}" for t, (x, y, _) in zip(TIMES.tolist(), TRUE.tolist())))
    words = [truth, mine, flat, "--json", tmp_path / "e.json", "--figure", tmp_path / "e.png"]
    done = CliRunner().invoke(make_app(["evaluate"]), ["evaluate", *map(str, words)])
    assert done.exit_code == 0, done.output
    assert "mine" in done.output and "200 of 200" in done.output and "NEES" not in done.output
    content = json.loads((tmp_path / "e.json").read_text())
    assert [each["name"] for each in content["estimates"]] == ["mine", "flat"]
    assert content["estimates"][1]["rpe_m"] is None and content["estimates"][1]["ate_m"] < 1e-6
    assert (tmp_path / "e.png").read_bytes().startswith(b"\x89PNG")


def test_the_figure_has_no_lines_across_gaps(tmp_path: Path) -> None:
    near, far = TIMES[80] > TIMES, TIMES[120] < TIMES
    truth = written(tmp_path / "truth.csv", TIMES[near | far], TRUE[near | far])
    late = written(tmp_path / "late.csv", TIMES[TIMES[40] < TIMES], TRUE[TIMES[40] < TIMES])
    lost = written(tmp_path / "lost.csv", TIMES[near | far], TRUE[near | far])
    left, right = comparisons.evaluate(truth, late, lost).figure().axes
    assert [np.isnan(line.get_xdata()).any() for line in left.lines] == [True, False, True]
    assert [np.isnan(line.get_ydata()).any() for line in right.lines] == [True, True]


def test_impossible_input_is_refused_with_a_sentence(truth: Path, tmp_path: Path) -> None:
    estimate = written(tmp_path / "mine.csv", TIMES, TRUE)
    with pytest.raises(OptionError, match="name at least one estimate"):
        comparisons.evaluate(truth)
    with pytest.raises(OptionError, match="there are 2 maps for 1 estimates; name one for each, - for none"):
        comparisons.evaluate(truth, estimate, map=["-", "-"])
    with pytest.raises(OptionError, match="name it with --true-map FILE"):
        comparisons.evaluate(truth, estimate, map=["map.csv"])
    with pytest.raises(LogError, match="a trajectory is a table"):
        comparisons.evaluate(truth, tmp_path / "graph.g2o")
    with pytest.raises(FormatError):
        comparisons.evaluate(truth, tmp_path / "missing.csv")
    save(simulate(seed=0).replace(true_poses=None, true_landmarks=None), tmp_path / "log.npz")
    with pytest.raises(
        FormatError, match="it is a log; 'slam-compare run LOG --out FOLDER' solves a log and writes traj"
    ):
        comparisons.evaluate(truth, tmp_path / "log.npz")
    with pytest.raises(LogError, match="the log has no true poses with times"):
        comparisons.evaluate(tmp_path / "log.npz", estimate)
    gap = TRUE.copy()
    gap[7] = np.nan
    with pytest.raises(LogError, match="rows with covariances must be in the order of time, and each needs a pose"):
        comparisons.evaluate(truth, written(tmp_path / "gap.csv", TIMES, gap, np.zeros((len(TRUE), 3, 3))))


def test_tables_archives_and_bags_of_one_estimate_have_the_same_errors(truth: Path, tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    rng = np.random.default_rng(0)
    C = np.diag([0.01, 0.02, 0.001])
    poses = TRUE + rng.multivariate_normal(np.zeros(3), C, len(TIMES))
    covariances = np.tile(C, (len(TIMES), 1, 1))
    table = written(tmp_path / "mine.csv", TIMES, poses, covariances)
    np.savez(tmp_path / "mine.npz", times=TIMES, poses=poses, covariances=covariances)
    store = get_typestore(Stores.ROS2_HUMBLE)
    make = {name.rpartition("/")[2]: store.types[name] for name in store.types}
    whole = np.zeros((6, 6))
    whole[np.ix_([0, 1, 5], [0, 1, 5])] = C
    with Writer(tmp_path / "mine", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
        topics = [writer.add_connection(name, kind, typestore=store) for name in ("/mine", "/other/pose")]
        for t, (x, y, theta) in zip(TIMES, poses):
            # a nanosecond off, as clocks of other programs round
            ns = round(t * 1e9) + 1
            stamp = make["Time"](sec=ns // 10**9, nanosec=ns % 10**9)
            turn = make["Quaternion"](x=0.0, y=0.0, z=float(np.sin(theta / 2)), w=float(np.cos(theta / 2)))
            pose = make["Pose"](position=make["Point"](x=float(x), y=float(y), z=0.0), orientation=turn)
            inner = make["PoseWithCovariance"](pose=pose, covariance=whole.ravel())
            message = make["PoseWithCovarianceStamped"](header=make["Header"](stamp=stamp, frame_id="map"), pose=inner)
            for topic in topics:
                writer.write(topic, ns, store.serialize_cdr(message, kind))
    bag = f"{tmp_path / 'mine'}:/mine"
    found = comparisons.evaluate(truth, table, tmp_path / "mine.npz", bag).estimates
    assert [each.name for each in found[:2]] == ["mine.csv", "mine.npz"]
    for each in found[1:]:
        assert each.ate_m == pytest.approx(found[0].ate_m, rel=1e-6)
        assert each.nees == pytest.approx(found[0].nees, rel=1e-6)
    assert found[0].nees == pytest.approx(1.0, abs=4 * np.sqrt(2 / (3 * len(TIMES))))
    assert comparisons.evaluate(bag, table).estimates[0].ate_m == pytest.approx(0.0, abs=1e-6)
    # clocks hold for all kinds, of the truth as of estimates
    late = comparisons.evaluate(truth, table, tmp_path / "mine.npz", bag, clocks="estimates=2").estimates
    assert [each.compared for each in late] == [180, 180, 180]
    for right in (table, tmp_path / "mine.npz", bag):
        shifted = comparisons.evaluate(right, table, clocks="truth=2,estimates=2").estimates[0]
        assert shifted.compared == 200 and shifted.ate_m == pytest.approx(0.0, abs=1e-6)
    with pytest.raises(
        FormatError, match=r"several topics have poses: it has /mine, /other/pose; name one, as in mine:/mine"
    ):
        comparisons.evaluate(truth, tmp_path / "mine")
    with pytest.raises(FormatError, match=r"there is no topic /his of poses: it has /mine"):
        comparisons.evaluate(truth, f"{tmp_path / 'mine'}:/his")
    np.savez(tmp_path / "wrong.npz", t=TIMES)
    with pytest.raises(FormatError, match=r"has the arrays times \[s\] and poses \(x, y, theta\), and it has t"):
        comparisons.evaluate(truth, tmp_path / "wrong.npz")


def test_gaps_of_the_truth_are_named_where_they_are_the_reason(tmp_path: Path) -> None:
    rare = tmp_path / "rare.tum"
    rare.write_text(tum_text(TIMES[::50], TRUE[::50]))
    mine = written(tmp_path / "mine.csv", TIMES + 0.01, TRUE)
    with pytest.raises(LogError, match=r"True poses are 5 s apart: --longest-gap 5 interpolates"):
        comparisons.evaluate(rare, mine)
