from __future__ import annotations

import warnings
from dataclasses import replace
from importlib import import_module
from itertools import combinations
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from comparisons import evaluate, run
from comparisons.comparison import Comparison
from comparisons.importing import inspect_log
from comparisons.results import Displayed, EstimatorResult
from comparisons.show.canvas import (
    BACKENDS,
    CONSISTENCY,
    STYLES,
    colour_of,
    place_map,
    placement_of,
    reference_of,
    save_figure,
    style_of,
    true_landmarks,
)
from comparisons.show.figures import CORNERS, comparison_figure, ellipses
from comparisons.show.studies import study_figure
from comparisons.show.tables import RESULTS
from comparisons.studies.backends import BackendComparison, BackendRow
from comparisons.studies.consistency import Consistency, ConsistencyStudy
from comparisons.studies.execute import Outcome, row_of
from comparisons.studies.plan import Run
from comparisons.studies.summary import Summary
from comparisons.studies.sweep import ParticleStudy
from graphslam import FormatError, Log, OptionError, simulate
from graphslam.se2 import compose


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate(seed=2, steps=24, clean=True)


@pytest.fixture(scope="module")
def comparison(log: Log) -> Comparison:
    return run(log, particles=50)


def texts(figure: Figure) -> list[object]:
    """All text that is seen."""
    found = list(figure.legends[0].get_texts())
    for axes in figure.axes:
        found += [axes.title, axes.xaxis.label, axes.yaxis.label, getattr(axes, "_left_title")]  # noqa: B009
        found += axes.get_xticklabels() + axes.get_yticklabels()
    return [t for t in found if t.get_text() and t.get_visible()]


@pytest.mark.parametrize("name", ["sample", "a drive through the park on a rainy morning in May, the second one"])
def test_no_text_overlaps_or_leaves_the_page(comparison: Comparison, name: str) -> None:
    figure = comparison_figure(replace(comparison, log=comparison.log.replace(name=name)))
    figure.draw_without_rendering()
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    width, height = figure.bbox.size
    boxes = []
    for axes in figure.axes:
        low_x, high_x, low_y, high_y = *axes.get_xlim(), *axes.get_ylim()
        for label in axes.get_xticklabels():
            label.set_visible(low_x <= label.get_position()[0] <= high_x)
        for label in axes.get_yticklabels():
            label.set_visible(low_y <= label.get_position()[1] <= high_y)
    for text in texts(figure):
        box = text.get_window_extent(renderer)  # type: ignore[attr-defined]
        assert box.x0 >= 0
        assert box.y0 >= 0
        assert box.x1 <= width
        assert box.y1 <= height
        boxes.append((text.get_text(), box))  # type: ignore[attr-defined]
    overlapping = [(a, b) for (a, one), (b, other) in combinations(boxes, 2) if one.overlaps(other)]
    assert overlapping == []


def test_landmarks_of_a_log_are_named_by_their_ids(log: Log) -> None:
    ids = np.arange(len(log.landmarks)) + 100
    axes = inspect_log(log.replace(landmarks=ids, true_landmarks=None)).figure().axes[1]
    assert [(text.get_position()[1] + 100, text.get_text()) for text in axes.get_yticklabels()] == [
        (id, str(id)) for id in ids[:: -(-len(ids) // 12)].tolist()
    ]


def test_the_legend_of_many_long_names_is_within_the_page(log: Log, tmp_path: Path) -> None:
    truth = np.column_stack([np.arange(log.num_poses), log.true_poses])
    files = [tmp_path / f"estimate_with_a_long_name_{k}.csv" for k in range(11)]
    for file in files:
        np.savetxt(file, truth, delimiter=",", header="t,x,y,theta", comments="")
    figure = evaluate(files[0], *files).figure()
    figure.draw_without_rendering()
    box = figure.legends[0].get_window_extent()
    assert 0 <= box.x0 < box.x1 <= figure.bbox.width
    assert len({(line.get_color(), line.get_linestyle()) for line in figure.axes[1].lines}) == len(files)


def test_the_map_has_equal_axes_and_shows_everything(comparison: Comparison, log: Log) -> None:
    figure = comparison_figure(comparison)
    axes = figure.axes[0]
    figure.draw_without_rendering()
    assert axes.get_aspect() == 1.0
    box = axes.get_window_extent()
    per_metre = box.width / np.ptp(axes.get_xlim()), box.height / np.ptp(axes.get_ylim())
    # matplotlib leaves limits alone that are equal to half a percent
    assert per_metre[0] == pytest.approx(per_metre[1], rel=6e-3)
    assert log.true_poses is not None
    assert axes.viewLim.count_contains(log.true_poses[:, :2]) == log.num_poses
    assert [axes.get_xlabel(), axes.get_ylabel()] == ["x [m]", "y [m]"]


def test_each_estimator_looks_different_in_colour_and_in_grey() -> None:
    looks = {(str(s.get("linestyle")), s.get("marker")) for s in STYLES.values()}
    assert len(looks) == len(STYLES)
    # markers lie on the thick light line of the graph and must stand out from it without colour
    grey = {name: float(np.dot(to_rgb(s["color"]), (0.299, 0.587, 0.114))) for name, s in STYLES.items()}
    assert grey["graph"] - grey["gtsam"] > 0.1
    assert grey["graph"] - grey["textbook"] > 0.1


def test_a_colour_means_one_thing() -> None:
    assert len({s["color"] for s in (*STYLES.values(), *CONSISTENCY.values())}) == len(STYLES) + len(CONSISTENCY)
    assert len({s["color"] for s in BACKENDS.values()}) == len(BACKENDS)
    assert {name for name in CONSISTENCY if name in STYLES} == set()
    # an estimator under another name keeps its colour
    assert (colour_of("graphslam"), colour_of("gtsam-lm")) == (colour_of("graph"), colour_of("gtsam"))


@pytest.mark.slow
def test_an_estimator_has_its_colour_in_every_figure() -> None:
    nees = np.ones((3, 5))
    consistency = ConsistencyStudy(3, 0.1, 5, 3, 0, 4.0, (Consistency("fastslam2", nees, nees[:, 0] * np.nan),))
    particles = ParticleStudy("log", tuple(
        row_of(
            Run("log", {}, 0, "fastslam2", f"fastslam2 particles={n}", {"particles": n}),
            Outcome(key="", ate_m=0.1 * n, mean_ate_m=0.1, ess_share=0.5, ancestors=2, seconds=0.1),
        )
        for n in (1, 2)
    ))  # fmt: skip
    for study in (consistency, particles):
        lines = [
            line for axes in study.figure().axes for line in axes.get_lines() if "fastslam2" in str(line.get_label())
        ]
        assert {line.get_color() for line in lines} == {STYLES["fastslam2"]["color"]}


def test_the_right_panel_shows_the_errors_whose_rms_is_the_ate(comparison: Comparison) -> None:
    lines = comparison_figure(comparison).axes[1].get_lines()
    assert len(lines) == len(comparison.results)
    for line, result in zip(lines, comparison.results):
        errors = np.asarray(line.get_ydata(), dtype=float)
        assert np.sqrt(np.mean(errors**2)) == pytest.approx(comparison.metrics[result.name].ate_m)


@pytest.mark.parametrize("name", ["graph", "dead-reckoning"])
def test_all_estimates_are_aligned_to_the_truth_the_same_way(log: Log, name: str) -> None:
    assert log.true_poses is not None
    # a path that leaves the true start and drifts: the alignment is that of the whole path, not of the start
    bent = compose([3, 4, 1], log.true_poses)
    bent[:, 0] += np.linspace(0, 2, len(bent)) ** 2
    result = EstimatorResult(name=name, poses=bent, estimated=np.ones(25, bool), seconds=0)
    figure = comparison_figure(Comparison(log, (result,)))
    drawn = next(line for line in figure.axes[0].get_lines() if line.get_color() == colour_of(name))
    off = np.asarray(drawn.get_xydata()) - log.true_poses[:, :2]
    errors = np.asarray(figure.axes[1].get_lines()[0].get_ydata())
    np.testing.assert_allclose(np.linalg.norm(off, axis=1), errors, atol=1e-12)
    # a rigid alignment to all positions leaves no mean error
    np.testing.assert_allclose(off.mean(axis=0), 0, atol=1e-12)


def test_a_moved_copy_of_the_truth_is_put_back(log: Log) -> None:
    assert log.true_poses is not None
    moved = compose([3, 4, 1], log.true_poses)
    np.testing.assert_allclose(compose(placement_of(log, moved), moved), log.true_poses, atol=1e-9)
    np.testing.assert_array_equal(placement_of(log.replace(true_poses=None), moved), 0)
    np.testing.assert_array_equal(placement_of(log, moved, np.zeros(25, bool)), 0)


def test_ellipses_by_hand() -> None:
    # variances 4 and 1 along the diagonals: three standard deviations are 6 and 3; a quarter turn swaps the diagonals
    c = np.sqrt(0.5)
    turn = np.array([[c, -c], [c, c]])
    S = np.eye(3)
    S[:2, :2] = turn @ np.diag([4.0, 1.0]) @ turn.T
    means, covariances = place_map(np.array([10.0, 0, np.pi / 2]), {4: np.array([1.0, 2, 9]), 5: np.zeros(2)}, {4: S})
    np.testing.assert_allclose(means[4], [8, 1])
    (curve,) = ellipses(means, covariances)
    assert curve.shape == (CORNERS + 1, 2)
    np.testing.assert_allclose(curve[0], curve[-1])
    off = curve - means[4]
    np.testing.assert_allclose(np.einsum("ki,ij,kj->k", off, np.linalg.inv(covariances[4]), off), 9)
    lengths = np.linalg.norm(off, axis=1)
    assert (lengths.max(), lengths.min()) == (pytest.approx(6), pytest.approx(3))
    farthest = off[lengths.argmax()]
    assert np.degrees(np.arctan2(farthest[1], farthest[0])) % 180 == pytest.approx(135)
    assert ellipses({}, {}).shape == (0, CORNERS + 1, 2)


def test_only_true_landmarks_that_were_seen_are_drawn(log: Log) -> None:
    assert log.true_landmarks is not None
    more = log.replace(true_landmarks={**log.true_landmarks, 99: np.array([500.0, 0, 0])})
    assert sorted(true_landmarks(more)) == sorted(set(log.landmark_ids.tolist()))


def test_without_truth_the_right_panel_shows_convergence(log: Log, tmp_path: Path) -> None:
    outcome = run(log.replace(true_poses=None), estimators=["dead-reckoning", "textbook", "graph", "gtsam"])
    figure = comparison_figure(outcome)
    assert "correction" in figure.axes[1].get_ylabel()
    assert [len(np.asarray(line.get_xdata())) for line in figure.axes[1].get_lines()] == [
        r.iterations for r in outcome.results[1:]
    ]
    save_figure(figure, [tmp_path / "a.png"])


def test_a_single_sighting_is_drawn_without_warnings(log: Log) -> None:
    one = log.replace(steps=log.steps[:1], landmarks=log.landmarks[:1], sightings=log.sightings[:1], true_poses=None)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run(one, estimators=["graph"]).figure()


@pytest.mark.slow
@pytest.mark.parametrize(
    "names",
    [
        ["mcl"],
        *(pytest.param(each, marks=pytest.mark.nightly) for each in (["dead-reckoning"], ["graph"])),
        ["fastslam1", "dead-reckoning"],
    ],
)
def test_any_selection_can_be_drawn(log: Log, names: list[str], tmp_path: Path) -> None:
    outcome = run(log, estimators=names, particles=20)
    save_figure(comparison_figure(outcome), [tmp_path / "a.png"])
    assert len(comparison_figure(outcome).legends[0].get_texts()) >= len(names) + 2


def test_poses_outside_the_graph_leave_gaps(log: Log) -> None:
    outcome = run(log, estimators=["graph"], edges="virtual")
    drawn = [np.asarray(line.get_xdata(), dtype=float) for line in comparison_figure(outcome).axes[0].get_lines()]
    (path,) = [x for x in drawn if len(x) == log.num_poses and np.isnan(x).any()]
    assert np.array_equal(np.isnan(path), ~outcome["graph"].estimated)


def test_a_truth_at_single_poses_is_drawn_as_points(log: Log) -> None:
    """As of GPS once a second: no line goes through poses whose neighbours have no true one."""
    truth = log.true_poses.copy()
    truth[1::2] = np.nan
    truth[:4] = log.true_poses[:4]
    figure = comparison_figure(run(log.replace(true_poses=truth), estimators=["dead-reckoning"]))
    for axes, color in zip(figure.axes, ("black", colour_of("dead-reckoning"))):
        points = [line for line in axes.lines if line.get_marker() == "." and to_rgb(line.get_color()) == to_rgb(color)]
        assert [len(line.get_xdata()) for line in points] == [np.sum(np.isfinite(truth[:, 0])) - 5]


def test_an_unknown_estimator_gets_a_style_of_its_own() -> None:
    assert style_of("new", 100) == style_of("new", 100)
    assert style_of("new")["linestyle"] not in ("none", "-")


def test_every_class_of_results_has_a_renderer() -> None:
    # the classes that are defined so far count
    for module in ("comparison", "datasets", "evaluation", "importing", "studies.summary", "studies.consistency"):
        import_module(f"comparisons.{module}")
    for module in ("backends", "sweep", "solvers"):
        import_module(f"comparisons.studies.{module}")
    kinds = {kind.__name__ for kind in Displayed.__subclasses__()}
    assert kinds | {"Calibration"} == set(RESULTS)
    with pytest.raises(NotImplementedError, match="no figure of ResultTable"):
        run(simulate(seed=1, steps=5), estimators="dead-reckoning").table.figure()


def test_nothing_to_draw_is_said() -> None:
    for empty in (BackendComparison(()), Summary(3, 0, None, (), (), {})):
        with pytest.raises(OptionError, match="nothing to draw"):
            empty.figure()
        assert "data:image" not in empty._repr_html_()
    with pytest.raises(OptionError, match="no executed run"):
        study_figure(Summary(3, 0, None, (), (), {}))


def test_the_backends_figure_shows_the_excess_over_the_best() -> None:
    trace = ((0.0, 30.0), (0.1, 20.0), (0.2, 11.0))
    rows = (
        BackendRow("a.g2o", "graphslam", 10.0, 3, 0.1, True, "", ((0.0, 30.0), (0.1, 10.0))),
        BackendRow("a.g2o", "g2o-gn", 11.0, 3, 0.1, False, "", trace),
    )
    figure = BackendComparison(rows).figure()
    ours, theirs = figure.axes[0].get_lines()
    np.testing.assert_allclose(theirs.get_xydata(), [[0.1, 1.0], [0.2, 0.1]])
    np.testing.assert_allclose(ours.get_xydata(), [[0.1, 1e-10]])
    assert ours.get_color() == colour_of("graph")


def test_the_backends_figure_of_a_graph_without_errors_can_be_drawn() -> None:
    rows = [
        BackendRow("a.g2o", name, cost, 3, 0.1, True, "", ((0.0, 1e6), (0.1, cost)))
        for name, cost in (("graphslam", 0.0), ("g2o-gn", 40.0))
    ]
    ours, theirs = BackendComparison(tuple(rows)).figure().axes[0].get_lines()
    assert ours.get_ydata()[-1] == 1e-10 and theirs.get_ydata()[-1] == pytest.approx(40.0 / 1e-10)


def test_a_figure_that_cannot_be_written_leaves_nothing(comparison: Comparison, tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="nowhere"):
        comparison.save_figure([tmp_path / "nowhere" / "figure.png"])
    comparison.save_figure([str(tmp_path / "figure.SVG")])
    assert [path.name for path in tmp_path.iterdir()] == ["figure.SVG"]


@pytest.mark.slow
def test_the_same_data_give_the_same_file(comparison: Comparison, tmp_path: Path) -> None:
    for name in ("a", "b"):
        save_figure(comparison_figure(comparison), [tmp_path / f"{name}.png", tmp_path / f"{name}.pdf"])
    for suffix in ("png", "pdf"):
        assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()


def test_matplotlib_is_left_as_it_was(comparison: Comparison) -> None:
    before = dict(matplotlib.rcParams)
    comparison_figure(comparison)
    assert dict(matplotlib.rcParams) == before


def test_the_sightings_are_those_of_an_estimate_and_not_of_dead_reckoning(log: Log) -> None:
    comparison = run(log, estimators=["dead-reckoning", "fastslam2"], particles=20)
    reference = reference_of(comparison)
    assert reference is not None and reference.name == "fastslam2"
