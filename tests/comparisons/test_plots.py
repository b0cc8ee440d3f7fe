from __future__ import annotations

import subprocess
import sys
from itertools import combinations
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from comparisons import plots
from comparisons.comparison import Comparison, compare
from comparisons.estimator import EstimatorResult, RunOptions
from comparisons.plots import comparison_figure, save_figure
from graphslam import Log, simulate
from graphslam.se2 import compose


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate(seed=2, steps=24, clean=True)


@pytest.fixture(scope="module")
def comparison(log: Log) -> Comparison:
    return compare(log, options=RunOptions(particles=50))


def texts(figure: Figure) -> list[object]:
    """All text that is seen."""
    found = list(figure.legends[0].get_texts())
    for axes in figure.axes:
        found += [axes.title, axes.xaxis.label, axes.yaxis.label, getattr(axes, "_left_title")]  # noqa: B009
        found += axes.get_xticklabels() + axes.get_yticklabels()
    return [t for t in found if t.get_text() and t.get_visible()]


def test_no_text_overlaps_or_leaves_the_page(comparison: Comparison) -> None:
    figure = comparison_figure(comparison)
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


def test_the_map_has_equal_axes_and_shows_everything(comparison: Comparison, log: Log) -> None:
    figure = comparison_figure(comparison)
    axes = figure.axes[0]
    figure.draw_without_rendering()
    assert axes.get_aspect() == 1.0
    box = axes.get_window_extent()
    per_metre = box.width / np.ptp(axes.get_xlim()), box.height / np.ptp(axes.get_ylim())
    assert per_metre[0] == pytest.approx(per_metre[1], rel=1e-6)
    assert log.true_poses is not None
    assert axes.viewLim.count_contains(log.true_poses[:, :2]) == log.num_poses
    assert [axes.get_xlabel(), axes.get_ylabel()] == ["x [m]", "y [m]"]


def test_each_estimator_looks_different_in_colour_and_in_grey() -> None:
    looks = {(str(s.get("linestyle")), s.get("marker")) for s in plots._STYLES.values()}
    assert len(looks) == len(plots._STYLES)
    assert len({s["color"] for s in plots._STYLES.values()}) == len(plots._STYLES)
    # markers lie on the thick light line of the graph and must stand out from it without colour
    grey = {name: float(np.dot(to_rgb(s["color"]), (0.299, 0.587, 0.114))) for name, s in plots._STYLES.items()}
    assert grey["graph"] - grey["gtsam"] > 0.1
    assert grey["graph"] - grey["textbook"] > 0.1


def test_the_right_panel_shows_the_errors_whose_rms_is_the_ate(comparison: Comparison) -> None:
    lines = comparison_figure(comparison).axes[1].get_lines()
    assert len(lines) == len(comparison.results)
    for line, result in zip(lines, comparison.results):
        errors = np.asarray(line.get_ydata(), dtype=float)
        assert np.sqrt(np.mean(errors**2)) == pytest.approx(comparison.metrics[result.name].ate_m)


def test_estimates_are_laid_onto_the_truth_and_dead_reckoning_starts_there(log: Log) -> None:
    assert log.true_poses is not None
    for name, expected in (("other", log.true_poses), ("dead-reckoning", log.true_poses)):
        result = EstimatorResult(
            name=name, poses=compose([3, 4, 1], log.true_poses), estimated=np.ones(25, bool), seconds=0
        )
        outcome = Comparison(log, (result,))
        np.testing.assert_allclose(compose(plots.frame_of(outcome, result), result.poses), expected, atol=1e-9)


def test_ellipses_by_hand(log: Log) -> None:
    # variances 4 and 1 along the diagonals: three standard deviations are 6 and 3, drawn with twice that as full axes
    c = np.sqrt(0.5)
    turn = np.array([[c, -c], [c, c]])
    result = EstimatorResult(
        name="x", poses=log.initial_poses, estimated=np.ones(25, bool), seconds=0, landmarks={4: np.array([1.0, 2])},
        landmark_covariances={4: turn @ np.diag([4.0, 1.0]) @ turn.T},
    )  # fmt: skip
    means, long, short, angle = plots._ellipses(result, np.array([10.0, 0, np.pi / 2]))
    np.testing.assert_allclose(means, [[8, 1]])
    np.testing.assert_allclose([long[0], short[0]], [12, 6])
    assert angle[0] % 180 == pytest.approx(135)


def test_without_truth_the_right_panel_shows_convergence(log: Log, tmp_path: Path) -> None:
    outcome = compare(log.replace(true_poses=None), ["dead-reckoning", "textbook", "graph", "gtsam"])
    figure = comparison_figure(outcome)
    assert "correction" in figure.axes[1].get_ylabel()
    assert [len(np.asarray(line.get_xdata())) for line in figure.axes[1].get_lines()] == [
        r.iterations for r in outcome.results[1:]
    ]
    save_figure(figure, [tmp_path / "a.png"])


@pytest.mark.parametrize("names", [["dead-reckoning"], ["mcl"], ["graph"], ["fastslam1", "dead-reckoning"]])
def test_any_selection_can_be_drawn(log: Log, names: list[str], tmp_path: Path) -> None:
    outcome = compare(log, names, RunOptions(particles=20))
    save_figure(comparison_figure(outcome), [tmp_path / "a.png"])
    assert len(comparison_figure(outcome).legends[0].get_texts()) >= len(names) + 2


def test_poses_outside_the_graph_leave_gaps(log: Log) -> None:
    outcome = compare(log, ["graph"], RunOptions(edges="virtual"))
    drawn = [np.asarray(line.get_xdata(), dtype=float) for line in comparison_figure(outcome).axes[0].get_lines()]
    (path,) = [x for x in drawn if len(x) == log.num_poses and np.isnan(x).any()]
    assert np.array_equal(np.isnan(path), ~outcome["graph"].estimated)


def test_an_unknown_estimator_gets_a_style() -> None:
    assert plots.style_of("isam2", 100) == plots.style_of("isam2", 100)
    assert "color" in plots.style_of("isam2", 100)


def test_the_same_data_give_the_same_file(comparison: Comparison, tmp_path: Path) -> None:
    for name in ("a", "b"):
        save_figure(comparison_figure(comparison), [tmp_path / f"{name}.png", tmp_path / f"{name}.pdf"])
    for suffix in ("png", "pdf"):
        assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()


def test_matplotlib_is_left_as_it_was(comparison: Comparison) -> None:
    before = dict(matplotlib.rcParams)
    comparison_figure(comparison)
    assert dict(matplotlib.rcParams) == before


def test_pyplot_is_never_imported() -> None:
    code = "import sys, comparisons.plots; assert 'matplotlib.pyplot' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).parents[2])
