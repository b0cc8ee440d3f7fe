"""Figures, films, the report and TUM files follow the recorded controls between the poses of a log."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from comparisons.comparison import Comparison, run
from comparisons.importing import inspect_log
from comparisons.show.canvas import colour_of, placement_of_result
from comparisons.show.figures import comparison_figure
from comparisons.show.films import animate
from comparisons.show.films.scene import Scene
from comparisons.show.log_tables import plan
from comparisons.show.report import charts
from comparisons.show.report.view import view_of
from graphslam import Log, MotionModel, control_path, save, simulate
from graphslam.se2 import compose


@pytest.fixture(scope="module")
def log() -> Log:
    """A drive on a circle in which every fifth pose is kept: chords between them would cut it."""
    return simulate(seed=2, steps=60, clean=True).at_steps(np.arange(0, 61, 5))


@pytest.fixture(scope="module")
def comparison(log: Log) -> Comparison:
    return run(log, estimators=["dead-reckoning", "graph"])


@pytest.fixture(scope="module")
def expected(comparison: Comparison) -> np.ndarray:
    result = comparison["graph"]
    path = control_path(comparison.log).through(result.poses)
    return compose(placement_of_result(comparison.log, result), path)[:, :2]


def test_the_figure(comparison: Comparison, expected: np.ndarray) -> None:
    lines = comparison_figure(comparison).axes[0].get_lines()
    drawn = next(line for line in lines if line.get_color() == colour_of("graph"))
    np.testing.assert_allclose(drawn.get_xydata(), expected, atol=1e-12)
    truth = next(line for line in lines if line.get_color() == "black")
    assert comparison.log.true_path is not None
    np.testing.assert_array_equal(truth.get_xydata(), comparison.log.true_path[:, :2])


def test_the_figure_and_plan_of_a_log_before_it_is_solved(log: Log) -> None:
    overview = inspect_log(log)
    assert log.controls is not None and log.dt is not None and log.true_path is not None
    driven = MotionModel().dead_reckoning(log.initial_poses[0], log.controls, log.dt)[:, :2]
    _, ours, truth, *_ = overview.figure().axes[0].get_lines()
    np.testing.assert_allclose(ours.get_xydata(), driven, atol=1e-9)
    np.testing.assert_array_equal(truth.get_xydata(), log.true_path[:, :2])
    coarse = plan(overview.path[:, :2], overview.seen_at)
    assert str(overview).count("·") > "".join(coarse).count("·")


def test_the_film(log: Log, expected: np.ndarray) -> None:
    film = animate(log, max_frames=2)
    figure = Figure()
    Scene(figure, film).at(film.frames[-1])
    drawn = next(line for line in figure.axes[0].get_lines() if line.get_color() == colour_of("graph"))
    np.testing.assert_allclose(drawn.get_xydata(), expected, atol=1e-6)
    # step by step there are the first poses only
    steps = animate(log, estimator="fastslam1", particles=20, max_frames=3)
    scene = Scene(figure := Figure(), steps)
    scene.at(steps.frames[1])
    drawn = [line for line in figure.axes[0].get_lines() if line.get_color() == colour_of("fastslam1")]
    assert 5 * steps.frames[1].number + 1 in [len(np.asarray(line.get_xydata())) for line in drawn]


def test_the_report(comparison: Comparison, expected: np.ndarray) -> None:
    view = view_of(comparison)
    np.testing.assert_allclose(view.estimates[1].line[:, :2], expected, atol=1e-12)
    assert view.times is not None and view.times[0] == 0
    traces = [t for t in charts.paths_figure(view)["data"] if t["meta"].get("layer") == "path"]
    of_graph = [t for t in traces if t["meta"]["estimator"] == "graph"]
    assert [len(t["x"]) for t in of_graph] == [61, 13]
    assert [t["mode"] for t in of_graph] == ["lines", "markers"]


def test_tum_files(comparison: Comparison, log: Log, tmp_path: Path) -> None:
    comparison.save(tmp_path, figures=[])
    rows = np.loadtxt(tmp_path / "graph.tum")
    assert log.times is not None
    assert len(rows) == 61 and np.isin(log.times, rows[:, 0]).all()
    np.testing.assert_allclose(rows[:, 1:3], control_path(log).through(comparison["graph"].poses)[:, :2], atol=1e-12)
    # where errors are measured, so that other programs find the same
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "truth.tum")[:, 0], log.times)


def test_further_poses_of_every_log(log: Log, tmp_path: Path) -> None:
    save(log, tmp_path / "log.npz")
    for given in (log, tmp_path / "log.npz"):
        assert run(given, estimators=["dead-reckoning"], keep_every=3.0).log.num_poses == 61
