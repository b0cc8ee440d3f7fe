"""Medians, bootstrap intervals and paired differences, on rows whose figures are known."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from comparisons.show.studies import study_figure
from comparisons.show.tables import write_latex
from comparisons.studies.execute import COLUMNS
from comparisons.studies.summary import (
    ALL,
    median_of,
    summarise,
    write_csv,
    write_json_lines,
    write_summary_csv,
)
from graphslam import OptionError


def row(
    method: str, seed: int, ate: float | None, *, log: str = "w", file: bool = False, **rest: Any
) -> dict[str, Any]:
    plain: dict[str, Any] = dict.fromkeys(COLUMNS)
    plain |= {
        "key": f"{log}{method}{seed}", "log": log, "seed": seed, "estimator": method.split()[0], "method": method,
        "source": {"file": log} if file else {"simulate": {}}, "options": {}, "status": "done", "ate_m": ate,
    }  # fmt: skip
    return plain | rest


def test_the_median_and_an_interval_that_covers_it() -> None:
    found = median_of([3.0, 1.0, 2.0], [0, 1, 2])
    assert found is not None
    assert (found.median, found.count, found.low, found.high) == (2.0, 3, 1.0, 3.0)
    alone = median_of([3.0, 5.0], ["a", "a"])
    assert alone is not None
    assert (alone.median, alone.low, alone.high) == (4.0, None, None)
    assert median_of([], []) is None


def test_quartiles_of_five_values() -> None:
    rows = [row("fastslam1", seed, ate) for seed, ate in enumerate([5, 1, 3, None, 2, 4])]
    found = summarise(rows).methods[0].figures
    assert found["ate_m"] is not None
    assert (found["ate_m"].median, found["ate_m"].quartiles) == (3.0, (2.0, 4.0))
    assert found["ess_share"] is None


@pytest.mark.slow
def test_the_interval_covers_the_true_median_as_often_as_it_says() -> None:
    rng = np.random.default_rng(0)
    covered = 0
    for _ in range(300):
        found = median_of(list(rng.standard_normal(41)), range(41))
        assert found is not None and found.low is not None and found.high is not None
        covered += found.low <= 0.0 <= found.high
    # 95 % of 300 is 285; three standard deviations of a binomial are 11.3
    assert 274 <= covered <= 296


def test_values_of_one_unit_do_not_pass_for_independent_ones() -> None:
    rng = np.random.default_rng(1)
    per_log = rng.standard_normal(12)
    values = list(np.repeat(per_log, 30) + 0.01 * rng.standard_normal(360))
    together = median_of(values, list(np.repeat(np.arange(12), 30)))
    apart = median_of(values, range(360))
    assert together is not None and apart is not None
    assert together.median == apart.median
    assert together.high - together.low > 3 * (apart.high - apart.low)  # type: ignore[operator]


def test_repeats_of_a_deterministic_estimator_on_a_file_are_one_measurement() -> None:
    same = {"file": True, "log": "a.npz"}
    rows = [row("graph", s, 0.5, poses_sha256="aa", seconds=float(s), **same) for s in range(9)]
    rows += [row("gtsam", s, 0.4, poses_sha256="bb", **same) for s in range(9)]
    rows += [row("fastslam1", s, 0.1 * s, poses_sha256=f"f{s}", **same) for s in range(9)]
    summary = summarise(rows)
    graph, _, filtered = summary.methods
    assert graph.runs == 9
    ate = graph.figures["ate_m"]
    assert ate is not None
    assert (ate.median, ate.low, ate.high, ate.count) == (0.5, None, None, 1)
    assert graph.figures["seconds"].median == 4.0  # type: ignore[union-attr]
    assert filtered.figures["ate_m"].count == 9  # type: ignore[union-attr]
    gtsam, fastslam1 = summary.differences
    assert gtsam.figures["ate_m"].count == 1  # type: ignore[union-attr]
    assert gtsam.figures["ate_m"].low is None  # type: ignore[union-attr]
    assert gtsam.lower["ate_m"] == 1
    # nine draws of the filter against one result
    assert fastslam1.figures["ate_m"].count == 9  # type: ignore[union-attr]
    assert fastslam1.figures["ate_m"].median == pytest.approx(-0.1)  # type: ignore[union-attr]
    assert fastslam1.lower["ate_m"] == 5
    # with the filter as the baseline, too
    backwards = summarise(rows, baseline="fastslam1").differences[0]
    assert backwards.figures["ate_m"].count == 9  # type: ignore[union-attr]
    assert backwards.figures["ate_m"].low is not None  # type: ignore[union-attr]


def test_equal_poses_in_simulated_worlds_stay_apart() -> None:
    rows = [row("graph", s, 0.5, poses_sha256="aa") for s in range(9)]
    assert summarise(rows).methods[0].figures["ate_m"].count == 9  # type: ignore[union-attr]


def test_differences_are_of_the_same_log_and_seed() -> None:
    # the noise of the seeds is large and common; the difference is a tenth of it, and exact
    rows = [row("graph", s, float(s)) for s in range(9)] + [row("fastslam1 particles=9", s, s + 0.5) for s in range(9)]
    summary = summarise(rows)
    assert (summary.planned, summary.done, summary.baseline) == (18, 18, "graph")
    (gap,) = summary.differences
    found = gap.figures["ate_m"]
    assert found is not None
    assert (gap.method, found.median, found.low, found.high, found.count) == ("fastslam1 particles=9", 0.5, 0.5, 0.5, 9)
    assert gap.lower["ate_m"] == 0
    (turned,) = summarise(rows, baseline="fastslam1 particles=9").differences
    assert turned.figures["ate_m"].median == -0.5  # type: ignore[union-attr]
    assert turned.lower["ate_m"] == 9


def test_failures_count_and_leave_their_pair_out() -> None:
    rows = [row("graph", s, 1.0, converged=s > 0) for s in range(4)]
    rows += [row("gtsam", s, 2.0) for s in range(2)]
    rows += [row("gtsam", 2, None, status="error", error="no"), row("gtsam", 3, None, status="timeout", error="late")]
    summary = summarise(rows)
    graph, gtsam = summary.methods
    assert (graph.runs, graph.failed, graph.converged) == (4, 0, 0.75)
    assert (gtsam.runs, gtsam.failed, gtsam.timeouts, gtsam.converged) == (4, 1, 1, None)
    assert summary.differences[0].figures["ate_m"].count == 2  # type: ignore[union-attr]
    assert summary.differences[0].figures["rpe_m"] is None
    assert summary.errors == {"no": 1, "late": 1}


def test_several_logs_are_also_summarised_together() -> None:
    rows = [row("graph", s, value, log=log, file=True) for log, value in (("a", 1.0), ("b", 3.0)) for s in range(3)]
    summary = summarise(rows)
    assert [(line.log, line.figures["ate_m"].median) for line in summary.methods] == [  # type: ignore[union-attr]
        ("a", 1.0), ("b", 3.0), (ALL, 2.0),
    ]  # fmt: skip
    # two files are two units, whatever the number of seeds
    everything = summary.methods[-1].figures["ate_m"]
    assert everything is not None
    assert (everything.low, everything.high) == (1.0, 3.0)


def test_an_unknown_baseline_and_no_rows() -> None:
    with pytest.raises(OptionError, match="did you mean 'graph'"):
        summarise([row("graph", 0, 1.0)], baseline="grph")
    empty = summarise([])
    assert (empty.done, empty.methods, empty.differences, empty.baseline) == (0, (), (), None)


def test_export_keeps_every_digit(tmp_path: Path) -> None:
    rows = [row("graph", 0, 0.1 + 0.2, log='a, "b"', converged=True), row("graph", 1, None)]
    write_csv(rows, tmp_path / "r.csv")
    with (tmp_path / "r.csv").open(newline="") as stream:
        read = list(csv.DictReader(stream))
    assert list(read[0]) == list(COLUMNS)
    assert (float(read[0]["ate_m"]), read[0]["log"], read[1]["ate_m"]) == (0.30000000000000004, 'a, "b"', "")
    assert json.loads(read[0]["source"]) == {"simulate": {}}
    write_json_lines(rows, tmp_path / "r.jsonl")
    assert [json.loads(line) for line in (tmp_path / "r.jsonl").read_text().splitlines()] == rows


def _two_methods(factor: float) -> list[dict[str, Any]]:
    rows = [row("graph", s, 0.1 + 0.01 * s, log="a_1 & 50 %") for s in range(3)]
    return rows + [row("fastslam1 particles=10", s, factor * (0.1 + 0.01 * s), log="a_1 & 50 %") for s in range(3)]


def test_the_summary_as_csv(tmp_path: Path) -> None:
    summary = summarise(_two_methods(2.0))
    write_summary_csv(summary, tmp_path / "s.csv")
    with (tmp_path / "s.csv").open(newline="") as stream:
        graph, other = csv.DictReader(stream)
    assert (graph["log"], graph["method"], graph["runs"], graph["failed"]) == ("a_1 & 50 %", "graph", "3", "0")
    assert (float(graph["ate_m"]), float(graph["ate_m_low"]), float(graph["ate_m_high"])) == (0.11, 0.1, 0.1 + 0.02)
    assert graph["ate_m_difference"] == "" and graph["rpe_m"] == ""
    assert float(other["ate_m_difference"]) == pytest.approx(0.11, abs=1e-12)
    assert (other["ate_m_lower"], other["ate_m_pairs"]) == ("0", "3")


def test_the_summary_for_latex(tmp_path: Path) -> None:
    write_latex(summarise(_two_methods(2.0)), tmp_path / "s.tex")
    text = (tmp_path / "s.tex").read_text()
    assert text.count("\\begin{tabular}") == text.count("\\end{tabular}") == text.count("\\bottomrule") == 2
    rows = [line for line in text.splitlines() if line.endswith(" \\\\")]
    # the heads and the rows of the two tables: as many cells as columns
    first, second = (line for line in text.splitlines() if line.startswith("\\begin{tabular}"))
    widths = [len(line.split("}{")[1].rstrip("}")) for line in (first, second)]
    cells = [len(re.split(r"(?<!\\)&", line)) for line in rows]
    assert cells == [widths[0]] * 3 + [widths[1]] * 2
    assert rows[1].startswith("a\\_1 \\& 50 \\% & graph & 3 & 0 & ") and " 0.110 [0.100, 0.120] " in rows[1]
    assert rows[2].startswith(" & fastslam1 particles=10 & ")
    assert "95 \\% bootstrap" in text


@pytest.mark.parametrize(("factor", "scale"), [(5.0, "linear"), (20.0, "log")])
def test_the_figure_has_a_logarithmic_axis_where_errors_span_more_than_a_decade(factor: float, scale: str) -> None:
    left, right = study_figure(summarise(_two_methods(factor))).axes[:2]
    assert (left.get_xscale(), right.get_xscale()) == (scale, "linear")
    shown = left.get_xlim()
    for x in (0.1, 0.12, 0.1 * factor, 0.12 * factor):
        assert shown[0] < x < shown[1]
