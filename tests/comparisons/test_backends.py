import math

import pytest

from comparisons.show.tables import as_text
from comparisons.studies.backends import (
    BACKENDS,
    BackendComparison,
    BackendRow,
    compare_backends,
    native_gtsam_graph,
)
from graphslam import Graph, GraphError, OptionError, solve

TRIANGLE = """VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1 0 1.5
VERTEX_SE2 2 1 1 3.0
VERTEX_XY 9 2 2
EDGE_SE2 0 1 1 0 1.57 10 1 0.5 20 0.2 30
EDGE_SE2 1 2 1 0 1.57 10 0 0 10 0 10
EDGE_SE2 2 0 1 1 3.1 10 0 0 10 0 10
EDGE_SE2_XY 0 9 2 2 5 0 5
EDGE_SE2_XY 2 9 -1 -1 5 1 5
"""


@pytest.fixture
def triangle(tmp_path):
    path = tmp_path / "triangle.g2o"
    path.write_text(TRIANGLE)
    return path


def row(backend, chi2, seconds, converged=True):
    return BackendRow("a.g2o", backend, chi2, 3, seconds, converged, "because")


def test_gtsam_and_this_solver_on_a_small_graph(triangle):
    outcome = compare_backends([triangle], backends=["graphslam", "gtsam-lm", "gtsam-gn"], repeat=1)
    ours = outcome.rows[0]
    assert ours.converged
    assert ours.chi2 == pytest.approx(solve(Graph.from_g2o(triangle)).cost, rel=1e-8)
    for theirs in outcome.rows[1:]:
        # the between factor measures through the logarithm: the same minimum up to the size of the residuals squared
        assert theirs.chi2 == pytest.approx(ours.chi2, rel=0.05)
    payload = outcome.to_json()
    assert {"file", "backend", "chi2", "iterations", "seconds", "converged", "reason"} <= set(payload["rows"][0])


def test_g2o_reaches_the_same_chi2(triangle):
    pytest.importorskip("g2opy", reason="needs the extra 'peers'")
    outcome = compare_backends([triangle], backends=["graphslam", "g2o-gn", "g2o-lm"], repeat=1)
    assert [r.chi2 for r in outcome.rows] == pytest.approx([outcome.rows[0].chi2] * 3, rel=1e-6)


@pytest.mark.parametrize("edge", ["EDGE_RANGE_SE2_XY 1 9 1.4 10", "EDGE_PRIOR_SE2_XY 1 1.1 0.1 4 0 4"])
def test_peers_take_no_edges_that_they_would_ignore(triangle, edge):
    triangle.write_text(f"{TRIANGLE}{edge}\n")
    outcome = compare_backends([triangle], repeat=1)
    assert [row.backend for row in outcome.rows] == ["graphslam"]
    assert [each.backend for each in outcome.skipped] == list(BACKENDS[1:])
    assert "triangle.g2o: gtsam-lm, gtsam-gn" in (text := as_text(outcome, 500)) and "do not belong to a pose" in text
    for name in BACKENDS[1:]:
        with pytest.raises(OptionError, match="do not belong to a pose graph|needs the package"):
            compare_backends([triangle], backends=[name], repeat=1)


def test_information_goes_back_to_what_the_file_says(triangle):
    omega = native_gtsam_graph(Graph.from_g2o(triangle)).at(0).noiseModel().information()
    assert omega.ravel().tolist() == pytest.approx([10, 1, 0.5, 1, 20, 0.2, 0.5, 0.2, 30])


def test_ratios_count_only_runs_that_reached_the_best(triangle):
    rows = (
        row("graphslam", 10.0, 0.1),
        row("g2o-gn", 10.0, 0.4),
        row("gtsam-lm", 900.0, 0.01),
        row("g2o-lm", 10.0, 1.6),
    )
    outcome = BackendComparison(rows)
    assert outcome.ratio(rows[1]) == pytest.approx(0.25)
    assert outcome.ratio(rows[2]) is None
    assert outcome.geometric_mean("gtsam-lm") is None
    two = BackendComparison((*rows, BackendRow("b.g2o", "graphslam", 1.0, 3, 0.1, True, "")))
    assert two.geometric_mean("g2o-lm") == pytest.approx(1 / 16)
    assert not outcome.reached(rows[2])
    assert outcome.reached(row("x", math.nan, 1.0)) is False


def test_python_callbacks_are_in_no_mean(triangle, tmp_path):
    poses = tmp_path / "poses.g2o"
    poses.write_text("".join(line for line in TRIANGLE.splitlines(keepends=True) if "XY" not in line))
    outcome = compare_backends([triangle, poses], backends=["graphslam", "gtsam-lm"], repeat=1)
    assert [r.native for r in outcome.rows] == [True, False, True, True]
    # three poses, one fixed, and a landmark: 3 edges of 3 numbers and 2 of 2, for 8 unknowns
    assert outcome.rows[0].chi2_per_dof == pytest.approx(outcome.rows[0].chi2 / (13 - 8))
    rows = [BackendRow(f"{file}.g2o", "graphslam", 10.0, 3, 0.1, True, "") for file in "ab"]
    rows.append(BackendRow("a.g2o", "gtsam-lm", 10.0, 3, 0.4, True, ""))
    rows.append(BackendRow("b.g2o", "gtsam-lm", 10.0, 3, 100.0, True, "", native=False))
    mixed = BackendComparison(tuple(rows))
    assert mixed.geometric_mean("gtsam-lm") == pytest.approx(0.25)
    text = as_text(mixed, 80)
    assert "gtsam-lm (Python)" in text
    assert "graphslam takes 1/4.0 of the time of gtsam-lm" in text
    payload = mixed.to_json()
    assert [entry["native"] for entry in payload["rows"]] == [True, True, True, False]


def test_all_can_start_from_the_same_state(triangle):
    outcome = compare_backends(triangle, backends=["graphslam"], repeat=1, same_start=True)
    assert outcome.rows[0].trace[0][1] < Graph.from_g2o(triangle).cost(Graph.from_g2o(triangle).initial)


def test_impossible_options(triangle):
    assert BACKENDS == ("graphslam", "gtsam-lm", "gtsam-gn", "g2o-gn", "g2o-lm")
    for options, message in (
        ({"backends": ["ceres"]}, "backends must be one of"),
        ({"repeat": 0}, "repeat must be at least 1"),
        ({"initialize": "zero"}, "initialize must be one of"),
    ):
        with pytest.raises(OptionError, match=message):
            compare_backends([triangle], **options)
    triangle.write_text(TRIANGLE + "VERTEX_SE2 5 0 0 0\nVERTEX_SE2 6 0 0 0\nEDGE_SE2 5 6 1 0 0 1 0 0 1 0 1\n")
    with pytest.raises(GraphError, match="several pieces"):
        compare_backends([triangle])
