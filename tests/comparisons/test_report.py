"""The report without a browser: numbers against other sources, text that cannot break out, files written whole."""

from __future__ import annotations

import json
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plotly import graph_objects
from typer.testing import CliRunner

from comparisons import run
from comparisons.cli import app
from comparisons.comparison import Comparison
from comparisons.estimators import make_graph
from comparisons.results import EstimatorResult, dead_reckoning_covariances
from comparisons.show import report as page
from comparisons.show.report import charts, page_of, write_report
from comparisons.show.report.charts import convergence_figure, costs_figure, errors_figure, iterations, plain_steps
from comparisons.show.report.view import line_of, view_of
from comparisons.show.tables import comparison_tables
from graphslam import Graph, Log, MotionModel, OptionError, SlamError, save, simulate, solve, textbook
from graphslam.linear.cholesky import analyze
from graphslam.log import UNIDENTIFIED
from graphslam.metrics import position_errors

EVIL = "</script><img src=x onerror=alert(1)> & \"quoted\" 'log' ${title} $$"


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate(seed=2, steps=24, clean=True).replace(name=EVIL)


@pytest.fixture(scope="module")
def comparison(log: Log) -> Comparison:
    return run(log, particles=20)


@pytest.fixture(scope="module")
def html(comparison: Comparison) -> str:
    return page_of(comparison)


class Elements(HTMLParser):
    """The elements of a page with their attributes, the text, and what the JSON scripts hold."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.data: dict[str, Any] = {}
        self._inside: str | None = None
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))
        self._inside = dict(attrs).get("id") or "script" if tag == "script" else None

    def handle_endtag(self, _: str) -> None:
        self._inside = None

    def handle_data(self, data: str) -> None:
        if self._inside in ("figures", "facts"):
            self.data[self._inside] = json.loads(data)
        elif self._inside is None:
            self.text += data


# -- text and form -----------------------------------------------------------------------------------------------------


def test_names_cannot_break_out_of_their_place(html: str) -> None:
    elements = Elements(html)
    assert EVIL in elements.text
    assert "<img src=x" not in html
    assert "img" not in {tag for tag, _ in elements.found}


def test_what_is_embedded_comes_back_and_holds_nothing_that_ends_a_script() -> None:
    value = {"name": EVIL + "\u2028\u2029<!--", "x": [1.5, float("nan")]}
    text = page.embedded(value)
    assert not set("<>&\u2028\u2029") & set(text)
    assert json.loads(text) == {"name": value["name"], "x": [1.5, None]}


def test_the_page_needs_nothing_but_itself(html: str) -> None:
    assert len(html.encode()) < 8e6
    for tag, attributes in Elements(html).found:
        assert tag not in ("iframe", "object", "embed", "base")
        for name in ("src", "href"):
            assert (attributes.get(name) or "data:").startswith("data:"), (tag, attributes)
    assert "default-src 'none'" in html


def test_every_check_box_has_a_label_and_every_figure_words(html: str) -> None:
    elements = Elements(html)
    figures = [a for tag, a in elements.found if tag == "div" and "figure" in (a.get("class") or "").split()]
    assert len(figures) == 5
    assert all(a["role"] == "img" and a["aria-label"] for a in figures)
    boxes = [a for tag, a in elements.found if tag == "input" and a["type"] == "checkbox"]
    shown = html.count('<label><input type="checkbox"')
    assert len(boxes) == shown > 8


def test_the_table_and_the_configuration_are_there(html: str, comparison: Comparison) -> None:
    text = Elements(html).text
    for row in comparison.table:
        assert row.name in text
        if row.ate_m is not None:
            assert f"{row.ate_m:.3f}" in text
        if row.nees is not None:
            assert f"{row.nees:.2f}" in text
    assert comparison.config in text
    assert "particles = 20" in comparison.config
    for package in ("numpy 2", "gtsam", "plotly.js", "Python 3"):
        assert package in text


def test_all_figures_are_what_plotly_knows(html: str) -> None:
    figures = Elements(html).data["figures"]
    assert set(figures) == {"map", "errors", "costs", "convergence", "matrix"}
    for figure in figures.values():
        # raises ValueError for a property that does not exist, or a value that is impossible
        graph_objects.Figure(data=figure["data"], layout=figure["layout"])


# -- numbers -----------------------------------------------------------------------------------------------------------


def test_a_path_has_step_time_error_and_covariance(comparison: Comparison, log: Log) -> None:
    view = view_of(comparison)
    estimate = next(e for e in view.estimates if e.name == "graph")
    rows = np.array(charts.pose_columns(view, estimate), dtype=float)
    result = comparison["graph"]
    assert log.times is not None and log.true_poses is not None
    np.testing.assert_array_equal(rows[:, 0], np.arange(25))
    np.testing.assert_allclose(rows[:, 1], log.times, rtol=1e-7)
    np.testing.assert_allclose(rows[:, 3], position_errors(log.true_poses, result.poses), rtol=1e-3)
    # a rigid motion changes neither the sum of the variances of x and y nor that of the heading
    solved = solve(make_graph(log, comparison.options), initialize="auto").covariance()
    np.testing.assert_allclose(rows[:, 4] ** 2 + rows[:, 5] ** 2, solved[:, 0, 0] + solved[:, 1, 1], rtol=2e-3)
    np.testing.assert_allclose(rows[:, 7] ** 2, solved[:, 2, 2], rtol=2e-3)


@pytest.mark.parametrize("edges", ["virtual", "virtual+motion", "landmark+motion"])
def test_covariances_are_those_of_the_solution(log: Log, edges: str) -> None:
    comparison = run(log, estimators="graph", edges=edges, weight="tempered", motion_weight=2.0, initialize="given")
    expected = solve(make_graph(log, comparison.options), initialize="given").covariance()
    covariances = (
        view_of(Comparison(log.replace(true_poses=None, true_landmarks=None), comparison.results))
        .estimates[0]
        .covariances
    )
    assert covariances is not None
    np.testing.assert_allclose(covariances, expected, rtol=1e-6, atol=1e-14)


def test_covariances_turn_with_the_path(log: Log) -> None:
    # the truth, turned by a quarter: what was uncertain along x is uncertain along y
    comparison = run(log, estimators="graph")
    assert log.true_poses is not None
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    turned = log.true_poses @ quarter.T + [0, 0, np.pi / 2]
    before = view_of(comparison).estimates[0].covariances
    after = view_of(Comparison(log.replace(true_poses=turned), comparison.results)).estimates[0].covariances
    assert before is not None and after is not None
    np.testing.assert_allclose(after, quarter @ before @ quarter.T, atol=1e-12)


def test_gnc_has_covariances_too(log: Log) -> None:
    comparison = run(log, estimators="graph", kernel="gnc")
    (estimate,) = view_of(comparison).estimates
    solution = comparison["graph"].origin
    assert estimate.covariances is not None
    np.testing.assert_allclose(estimate.covariances[:, 2, 2], solution.covariance()[:, 2, 2], rtol=1e-6)  # type: ignore[union-attr]
    assert "Ω of graph: 25 nodes" in page_of(comparison)


def test_dead_reckoning_is_as_uncertain_as_a_graph_of_its_motions_alone() -> None:
    # one landmark, seen once, tells nothing of the poses: what is left are the motion edges and the anchor, 1e-6
    motions = {"dt": 0.5, "controls": [[1.0, 0.3], [0.8, -0.5], [1.2, 0.1], [0.0, 0.4]]}
    log = Log(**motions, steps=[2], landmarks=[0], sightings=[[2.0, 0.1, 0.2]])
    graph = Graph.from_log(log, edges="landmark+motion", kernel="none")
    expected = solve(graph).covariance()
    found = dead_reckoning_covariances(log, MotionModel())
    start = np.zeros((3, 3))
    for covariance, known, pose in zip(found, expected, solve(graph).poses):
        # the anchor's own variance travels along
        F = np.array([[1, 0, -pose[1]], [0, 1, pose[0]], [0, 0, 1]])
        np.testing.assert_allclose(covariance + F @ (1e-6 * np.eye(3)) @ F.T, known, rtol=1e-6, atol=1e-12)
    np.testing.assert_array_equal(found[0], start)


def test_covariances_of_particle_filters_stay_unknown(comparison: Comparison) -> None:
    view = view_of(comparison)
    assert [e.name for e in view.estimates if e.covariances is None] == ["mcl", "fastslam1", "fastslam2"]
    mcl = next(e for e in view.estimates if e.name == "mcl")
    assert all(row[4:] == [None] * 4 for row in charts.pose_columns(view, mcl))


def test_ellipses_of_the_page_lie_at_three_standard_deviations(comparison: Comparison) -> None:
    view = view_of(comparison)
    estimate = next(e for e in view.estimates if e.name == "graph")
    traces = [t for t in charts.paths_figure(view)["data"] if t["meta"].get("estimator") == "graph"]
    (trace,) = (t for t in traces if t["meta"]["layer"] == "landmark-ellipses")
    points = np.array([trace["x"], trace["y"]], dtype=float).T.reshape(len(estimate.landmarks), -1, 2)
    assert np.isnan(points[:, -1]).all()
    for curve, j in zip(points[:, :-1], estimate.landmarks):
        off = curve - estimate.landmarks[j]
        squares = np.einsum("ki,ij,kj->k", off, np.linalg.inv(estimate.landmark_covariances[j]), off)
        np.testing.assert_allclose(squares, 9, rtol=0.02)  # coordinates are rounded to a tenth of a millimetre


def test_the_textbook_iterations_are_those_of_the_textbook(log: Log) -> None:
    world = Graph.from_log(log, edges="virtual+motion", frame="world", kernel="none")
    drifting = plain_steps("", world, anchored=False)
    lectures = textbook.solve(log, edges="virtual+motion", threshold=1e-30, max_iterations=len(drifting.costs))
    np.testing.assert_allclose(drifting.costs, lectures.costs, rtol=1e-7)
    np.testing.assert_allclose(drifting.step_norms, lectures.step_norms, rtol=1e-4)


def test_the_textbook_drifts_and_the_body_frame_converges_fast(log: Log, comparison: Comparison) -> None:
    drifting, held, _, body = iterations(log, comparison.options)
    assert drifting.step_norms[-1] > 1e-7
    # by the same amount, step after step
    assert drifting.step_norms[-1] == pytest.approx(drifting.step_norms[-5], rel=0.05)
    assert held.step_norms[-1] < 1e-10
    assert len(body.step_norms) < 0.7 * len(held.step_norms)


def test_the_fill_in_is_that_of_a_factorisation() -> None:
    random = np.random.default_rng(3)
    n = 40
    dense = np.eye(n) * 6 + np.triu((random.random((n, n)) < 0.06) * random.uniform(0.5, 1, (n, n)), 1)
    dense = dense + dense.T
    rows, cols = np.nonzero(np.tril(dense))
    pattern = charts.factor_pattern(n, rows, cols)
    np.testing.assert_array_equal(pattern, np.linalg.cholesky(dense) != 0)
    columns, upper = np.nonzero(np.tril(dense))
    indptr = np.concatenate([[0], np.cumsum(np.bincount(columns, minlength=n))])
    assert pattern.sum() == analyze(indptr, upper, ordering=np.arange(len(indptr) - 1)).blocks


def test_both_pictures_show_the_same_matrix(log: Log, comparison: Comparison) -> None:
    graph = make_graph(log, comparison.options)
    before, after = charts.pictures(graph)
    solve(graph)
    omega = np.abs(graph.system.to_sparse().toarray()).reshape(25, 3, 25, 3).max(axis=(1, 3)) > 0
    np.testing.assert_array_equal(before.cells == charts.ENTRY, omega)
    order = analyze(graph.system.indptr, graph.system.indices).order
    np.testing.assert_array_equal(after.cells == charts.ENTRY, omega[np.ix_(order, order)])
    for picture in (before, after):
        assert np.count_nonzero(np.tril(picture.cells)) == picture.factor_blocks


def test_curves_over_the_drive_are_the_errors(comparison: Comparison) -> None:
    figure = errors_figure(view_of(comparison))
    assert figure is not None
    for trace, result in zip(figure["data"], comparison.results):
        assert trace["meta"]["estimator"] == result.name
        errors = np.array(trace["y"], dtype=float)
        assert np.sqrt(np.mean(errors**2)) == pytest.approx(comparison.metrics[result.name].ate_m, rel=1e-3)


def test_costs_end_where_the_estimators_say(comparison: Comparison) -> None:
    figure = costs_figure(comparison)
    assert figure is not None
    ends = {t["meta"]["estimator"]: (t["x"][-1], t["y"][-1]) for t in figure["data"] if "xaxis" not in t}
    for name in ("graph", "gtsam"):
        result = comparison[name]
        assert ends[name] == (result.iterations, pytest.approx(result.cost, rel=1e-6))
    assert costs_figure(Comparison(comparison.log, (comparison["mcl"],))) is None


def test_dashes_are_in_pixels() -> None:
    # five and one and a half widths of 1.1 points, which are 1.35 times as wide on a screen
    assert line_of("dead-reckoning")["line"]["dash"] == "7.4px,2.2px"
    assert line_of("graph")["line"]["dash"] == "solid"


# -- logs of all kinds -------------------------------------------------------------------------------------------------


def variants(log: Log) -> dict[str, Log]:
    some = np.full((25, 3), np.nan)
    assert log.true_poses is not None
    some[5:15] = log.true_poses[5:15]
    bare = log.replace(controls=None, dt=None)
    return {
        "no truth": log.replace(true_poses=None, true_landmarks=None),
        "truth of some steps": log.replace(true_poses=some),
        "no psi": log.without_orientation(),
        "no controls": bare,
        "one sighting": log.replace(steps=log.steps[:1], landmarks=log.landmarks[:1], sightings=log.sightings[:1]),
    }


@pytest.mark.parametrize("kind", ["no truth", "truth of some steps", "no psi", "no controls", "one sighting"])
def test_every_kind_of_log_has_a_page(log: Log, kind: str) -> None:
    changed = variants(log)[kind]
    names = ["dead-reckoning"] if kind == "one sighting" else ["dead-reckoning", "graph"]
    elements = Elements(page_of(run(changed, estimators=names)))
    figures = elements.data["figures"]
    assert "map" in figures
    assert ("errors" in figures) == (kind != "one sighting" or changed.true_poses is not None)
    if kind == "no truth":
        assert "distance from graph" in figures["errors"]["layout"]["yaxis"]["title"]["text"]
        assert "The log has no true poses" in elements.text
    if kind == "no controls":
        assert elements.data["facts"]["times"] is None
    if kind == "one sighting":
        assert "Left out: no estimator of this comparison solved a graph" in elements.text
        assert "matrix" not in figures


def test_several_logs_have_a_page_with_their_errors_and_all_notes(log: Log) -> None:
    middle = log.num_poses // 2
    parts = [log.at_steps(np.arange(*ends)) for ends in ((0, middle), (middle, log.num_poses))]
    named = [part.replace(name=f"day{k}", notes=tuple(f"note {n}" for n in range(8))) for k, part in enumerate(parts)]
    outcome = run(named, estimators=["graph"])
    text = Elements(page_of(outcome)).text
    assert "Errors in each log" in text and "day0: note 7" in text and "day1: note 7" in text
    # the terminal leaves them out
    remarks = comparison_tables(outcome, brief=True)[1]
    assert any("notes about reading, noise and ids of single logs are in the JSON" in each for each in remarks)
    assert not any("note 7" in each for each in remarks)
    # no line leads from the end of one log to the start of the next one
    figures = [charts.paths_figure(view_of(outcome)), errors_figure(view_of(outcome))]
    lines = [t for figure in figures for t in figure["data"] if t["meta"]["layer"] in ("path", "truth", "error")]
    lines = [trace for trace in lines if trace["mode"] == "lines"]
    assert [trace["meta"]["layer"] for trace in lines] == ["path", "truth", "error"]
    assert all([k for k, y in enumerate(trace["y"]) if y is None] == [middle] for trace in lines)


def test_only_true_landmarks_that_were_seen_are_drawn(log: Log) -> None:
    assert log.true_landmarks is not None
    more = log.replace(true_landmarks={**log.true_landmarks, 99: np.array([500.0, 0])})
    figure = Elements(page_of(run(more, estimators="dead-reckoning"))).data["figures"]["map"]
    drawn = next(t for t in figure["data"] if "true landmark" in t.get("hovertemplate", ""))
    assert drawn["customdata"] == log.landmark_ids.tolist()
    assert figure["layout"]["xaxis"]["range"][1] < 100


def test_sightings_of_unidentified_landmarks_have_a_page(log: Log) -> None:
    unknown = log.replace(landmarks=np.full(len(log.landmarks), UNIDENTIFIED))
    names = ["dead-reckoning", "fastslam1"]
    elements = Elements(page_of(run(unknown, estimators=names, particles=5, association="maximum-likelihood")))
    assert "of unidentified landmarks" in elements.text
    assert set(elements.data["figures"]) == {"map", "errors"}


@pytest.mark.slow
def test_long_logs_are_thinned_and_the_page_mentions_it() -> None:
    steps = 6000
    log = simulate(seed=1, steps=60, clean=True)
    poses = np.column_stack([np.linspace(0, 90, steps), np.zeros(steps), np.zeros(steps)])
    long = log.replace(controls=None, dt=None, initial_poses=poses, true_poses=poses)
    result = EstimatorResult(name="dead-reckoning", poses=poses, estimated=np.ones(steps, bool), seconds=0)
    others = [EstimatorResult(name=n, poses=poses, estimated=np.ones(steps, bool), seconds=0) for n in "abcdefg"]
    html = page_of(Comparison(long, (result, *others)))
    elements = Elements(html)
    assert len(html.encode()) < 8e6
    assert elements.data["facts"]["steps"][-1] == steps - 1
    assert f"of {steps} steps are shown" in elements.text


def test_too_many_pairs_are_left_out_with_a_reason(log: Log, comparison: Comparison, monkeypatch: Any) -> None:
    monkeypatch.setattr("comparisons.show.report.charts.MOST_PAIRS", 3)
    with pytest.raises(SlamError, match="pairs of sightings"):
        iterations(log, comparison.options)
    assert "pairs of sightings, more than" in Elements(page_of(comparison)).text


def test_convergence_is_drawn_with_every_variant(log: Log, comparison: Comparison) -> None:
    variants = iterations(log, comparison.options)
    figure = convergence_figure(variants)
    names = [t["name"] for t in figure["data"] if t.get("showlegend")]
    assert names == [variant.name for variant in variants]
    assert len(set(names)) == 4


# -- files and the command line ----------------------------------------------------------------------------------------


def test_the_page_is_written_whole_or_not_at_all(comparison: Comparison, tmp_path: Path, monkeypatch: Any) -> None:
    path = tmp_path / "page.html"
    path.write_text("before")

    def fail(*_: object) -> str:
        raise SlamError("no")

    monkeypatch.setattr(page, "page_of", fail)
    with pytest.raises(SlamError, match="no"):
        write_report(comparison, path)
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", ["page.pdf", "page", "folder.html", "nowhere/page.html"])
def test_a_bad_place_is_refused(comparison: Comparison, tmp_path: Path, name: str) -> None:
    (tmp_path / "folder.html").mkdir()
    with pytest.raises(SlamError, match=name):
        write_report(comparison, tmp_path / name)


def test_without_plotly_the_extra_is_named(comparison: Comparison, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(page, "find_spec", lambda _: None)
    with pytest.raises(OptionError, match=r"pip install -e '\.\[report\]'"):
        write_report(comparison, tmp_path / "page.html")
    assert list(tmp_path.iterdir()) == []


def invoke(*arguments: object) -> Any:
    return CliRunner().invoke(app, [str(a) for a in arguments])


@pytest.mark.slow
def test_both_verbs_write_the_page(log: Log, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    save(log, tmp_path / "log.npz")
    quick = ["--estimators", "dead-reckoning,graph"]
    result = invoke("report", "log.npz", "page.html", *quick, "--json", "-")
    assert result.exit_code == 0, result.output
    assert [e["name"] for e in json.loads(result.stdout)["estimators"]] == ["dead-reckoning", "graph"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["log.npz", "page.html"]
    result = invoke("run", "log.npz", "--html", "run.html", "--out", "out", *quick, "--json", "run.json")
    assert result.exit_code == 0, result.output
    assert "Wrote the interactive report run.html" in result.output
    assert json.loads((tmp_path / "run.json").read_text())["files"]["html"] == "run.html"
    assert Elements((tmp_path / "run.html").read_text()).data["facts"]["estimators"] == ["dead-reckoning", "graph"]
    # the log of the configuration, and its estimators
    result = invoke("report", "again.html", "--config", "out/config.toml")
    assert result.exit_code == 0, result.output
    pages = [Elements(Path(name).read_text()).data for name in ("page.html", "again.html")]
    assert pages[0]["figures"]["map"] == pages[1]["figures"]["map"]


@pytest.mark.parametrize(
    "arguments",
    [("report", "log.npz", "page.pdf"), ("report", "log.npz", "more", "page.html"), ("run", "--html", "page.txt")],
)
def test_wrong_use_is_refused_before_the_work_begins(tmp_path: Path, monkeypatch: Any, arguments: tuple[str]) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("comparisons.comparison.compare", lambda *_, **__: pytest.fail("the work began"))
    result = invoke(*arguments)
    assert result.exit_code == 2, result.output
    assert result.stderr.startswith("error: ") and result.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_figure_of_the_page_that_fails_is_a_sentence(comparison: Comparison, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise ValueError("too large")

    monkeypatch.setattr("comparisons.show.report.charts.pictures", fails)
    monkeypatch.setattr("comparisons.show.report.charts.iterations", fails)
    elements = Elements(page_of(comparison))
    assert elements.text.count("Left out: ValueError: too large.") == 2
    assert set(elements.data["figures"]) == {"map", "errors", "costs"}
