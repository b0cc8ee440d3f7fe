"""Tables and the sentences below them: what they say, and that no number is ever cut."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from rich.table import Table

from comparisons.comparison import Comparison, ResultTable, run
from comparisons.datasets import DATA_SETS, Found, Survey
from comparisons.estimators.attempt import Skipped
from comparisons.evaluation import Evaluated
from comparisons.options import METRICS, SummaryOptions
from comparisons.options.declaration import options_of
from comparisons.results import EstimatorResult
from comparisons.results.documents import SessionErrors, shown_by
from comparisons.results.results import Row
from comparisons.show.tables import LeanTable, as_html, as_text, number, seconds, tables_of
from comparisons.studies.backends import BackendComparison, BackendRow
from comparisons.studies.consistency import Consistency, ConsistencyStudy
from comparisons.studies.execute import COLUMNS, Outcome, row_of
from comparisons.studies.plan import Run
from comparisons.studies.solvers import SkippedVariant, SolverComparison, VariantResult
from comparisons.studies.summary import Median, MethodSummary, PairedDifference, Summary
from comparisons.studies.sweep import ParticleStudy
from fastslam import FastSLAM1, MonteCarloLocalization, ParticleGibbs
from graphslam import Graph, Log, MotionModel, SensorModel, load, sample_log_path, simulate
from graphslam.calibration import Calibration
from graphslam.metrics import METRICS as ERRORS

LONG = "a-long-name-that-must-wrap/of-a-method with its options lambda=10"


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate(seed=2, steps=5).replace(notes=("a control was dropped",))


def printed(table: Table, width: int) -> str:
    console = Console(file=io.StringIO(), width=width)
    console.print(table)
    return console.file.getvalue()  # type: ignore[attr-defined, no-any-return]


def result(log: Log, name: str, /, **rest: object) -> EstimatorResult:
    return EstimatorResult(name=name, poses=log.initial_poses, estimated=np.ones(6, bool), seconds=0.0123, **rest)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "–"), (float("nan"), "–"), (0.0, "0.000"), (0.1234, "0.123"), (12.0, "12.000"), (1e-4, "1.00e-04"),
     (2.5e7, "2.50e+07")],
)  # fmt: skip
def test_numbers(value: float | None, text: str) -> None:
    assert number(value) == text


@pytest.mark.parametrize(("value", "text"), [(None, "–"), (2e-5, "20 µs"), (0.0123, "12.3 ms"), (3.0, "3.00 s")])
def test_seconds(value: float | None, text: str) -> None:
    assert seconds(value) == text


# -- no number is ever cut ---------------------------------------------------------------------------------------------


def _comparison() -> object:
    rows = [
        Row(
            name=LONG,
            converged=True,
            iterations=1234,
            seconds=1234.5678,
            cost=98765.4321,
            ate_m=12345.678,
            rpe_m=23456.789,
            rpe_rad=34567.891,
            landmark_rmse_m=45678.912,
            nees=56789.123,
        ),
        Row(
            name="graph",
            converged=False,
            iterations=100,
            seconds=0.1234,
            cost=1.5e7,
            ate_m=0.123,
            rpe_m=0.456,
            rpe_rad=0.789,
            landmark_rmse_m=0.987,
            nees=1.234,
        ),
    ]
    return ResultTable("a log", tuple(rows))


def _solvers() -> object:
    variant = VariantResult("virtual+motion world tempered 3-D lambda=10 geman-mcclure", 1.2e-11, 3.4e-13, 5.0, 123, 456,
                            0.1234, 1234.5, True, True)  # fmt: skip
    return SolverComparison((variant,))


def _backends() -> object:
    rows = (
        BackendRow(f"/somewhere/{LONG}.g2o", "graphslam", 98765.432109, 123, 0.12345, True, ""),
        BackendRow(f"/somewhere/{LONG}.g2o", "gtsam-lm", 98765.432108, 456, 1234.567, True, ""),
    )
    return BackendComparison(rows)


def _particles() -> object:
    outcome = Outcome(key="", ate_m=12345.678, mean_ate_m=23456.789, landmark_rmse_m=34567.891, ess_share=0.123,
                      ancestors=98765, seconds=1234.56)  # fmt: skip
    runs = (Run(LONG, {}, 0, "fastslam1", str(n), {"particles": n}) for n in (31_623, 1_000_000))
    return ParticleStudy(LONG, tuple(row_of(run, outcome) for run in runs))


def _consistency() -> object:
    nees = np.full((200, 7), 12345.678)
    return ConsistencyStudy(200, 0.1, 7, 3, 0, 4.0, (Consistency("landmark nodes", nees, nees[:, 0]),))


def _study() -> object:
    figures = {metric: Median(12345.678, 11111.111, 23456.789, 500, (11111.111, 23456.789)) for metric in METRICS}
    method = MethodSummary("simulated world noise=0.1", LONG, 12345, 12, 34, 0.875, figures)
    other = PairedDifference("simulated world noise=0.1", LONG, "graph", figures, dict.fromkeys(METRICS, 321))
    return Summary(12345, 12345, "graph", (method,), (other,), {})


def _survey() -> object:
    entry = Found(path=Path("/data") / LONG / "log.g2o", robot=5, poses=1234567, sightings=7654321, landmarks=98765,
                  controls=1357911, seconds=98765.4, poses_covered=617284)  # fmt: skip
    return Survey(Path("/data"), {known.name: (entry,) for known in DATA_SETS})


def _calibration() -> object:
    return Calibration(motion=MotionModel(), sensor=SensorModel(), errors={"nn": 0.0123, "orientation_std": 0.02},
                       counts={"motion": 160, "sensor": 283})  # fmt: skip


RESULTS = {
    f.__name__[1:]: f()
    for f in (_comparison, _solvers, _backends, _particles, _consistency, _study, _survey, _calibration)
}


@pytest.mark.parametrize("width", [80, 100])
@pytest.mark.parametrize("name", RESULTS)
def test_every_number_is_whole_at_any_width(name: str, width: int) -> None:
    for table in tables_of(RESULTS[name])[0]:
        text = printed(table, width)
        assert "…" not in text
        assert max(map(len, text.splitlines())) <= width
        words = set(re.split(r"\s{2,}|\n", text)) | set(text.split())
        for column in table.columns:
            if column.no_wrap:
                for heading in str(column.header).split("\n"):
                    assert heading in text
                    assert not heading.endswith("-")
                cells = [str(cell) for cell in column.cells]
                assert [cell for cell in cells if not set(cell.split()) <= words] == []
                # whole cells stand on one line
                assert all(any(cell in line for line in text.splitlines()) for cell in cells)
        # of the names no letter is lost
        for column in table.columns:
            if not column.no_wrap:
                squeezed = re.sub(r"\s", "", text)
                for cell in column.cells:
                    assert all(part[:10] in squeezed for part in str(cell).split())


def test_a_narrow_terminal_gets_as_few_tables_as_possible() -> None:
    table = LeanTable("title", ["name"], ["first", "second", "third", "fourth"])
    table.add_row("x", *["12345.678"] * 4)
    # 4 + 4 (9 + 2) characters in one table; with single gaps 44; else two and two
    for width, rows in ((48, 1), (44, 1), (43, 2), (26, 2), (23, 4)):
        text = printed(table, width)
        assert text.count("x") == rows, width
        assert text.count("12345.678") == 4
    assert printed(table, 43).splitlines()[1].split() == ["name", "first", "second"]


def test_the_table_of_the_sample_fits_into_80_characters() -> None:
    row = Row(
        name="graph-marginal",
        converged=True,
        iterations=100,
        seconds=0.1234,
        cost=12345.678,
        ate_m=0.123,
        rpe_m=0.123,
        rpe_rad=0.123,
        landmark_rmse_m=0.123,
        nees=22.702,
        cost_per_dof=14.123,
    )
    (table,), _ = tables_of(ResultTable("sample", (row,)))
    text = printed(table, 80)
    line = "graph-marginal   yes, 100 123.4 ms 12345.68 14.12 0.123 0.123 0.123 0.123 22.70"
    assert [each.strip() for each in text.splitlines() if "graph" in each] == [line]


# -- what they say -----------------------------------------------------------------------------------------------------


def test_table_keeps_its_units_and_dashes() -> None:
    rows = Row(name="graph", converged=True, iterations=7, cost=12.5, seconds=0.0123, ate_m=0.0), Row(name="mcl")
    text = as_text(ResultTable("t", rows))
    for word in ("ATE", "[m]", "graph", "yes, 7", "12.3 ms", "12.50", "mcl"):
        assert word in text
    (row,) = [line for line in text.splitlines() if line.startswith("mcl  ")]
    assert row.split() == ["mcl", *["–"] * 5]


def test_estimators_without_a_result_have_a_sentence_and_no_row() -> None:
    text = as_text(ResultTable("t", (Row(name="graph", cost=12.5), Row(name="mcl", skipped="no map"))))
    assert [line for line in text.splitlines() if "mcl" in line] == ["mcl has no result: no map."]
    assert "ATE" not in text


def test_the_nees_is_a_column_where_it_is_known(log: Log) -> None:
    rows = (Row(name="graph", nees=22.7), Row(name="mcl"))
    assert "NEES" in as_text(ResultTable("t", rows))
    assert "NEES" not in as_text(ResultTable("t", rows[1:]))
    known = Comparison(log, (result(log, "dead-reckoning", log=log),))
    assert f"{known.nees['dead-reckoning']:.2f}" in as_text(known)
    assert "NEES: 1 means consistent" in as_text(known)


def test_remarks(log: Log) -> None:
    note = "landmark 3 was seen once"
    graph = result(log, "graph", converged=False, reason="max_iterations = 100 reached", notes=(note,))
    outcome = Comparison(
        log.replace(true_poses=None), (graph, result(log, "gtsam", notes=(note,))), (Skipped("mcl", "no map"),)
    )
    assert tables_of(outcome)[1] == [
        "Noise models: the book's.",
        "graph and gtsam differ by at most 0.0e+00 in any x, y [m] or heading [rad].",
        "The log has no true poses, so no error can be measured.",
        "mcl left out: no map.",
        "graph did not converge: max_iterations = 100 reached.",
        "simulated: a control was dropped.",
        "graph, gtsam: landmark 3 was seen once.",
    ]


def test_a_question_has_no_full_stop(log: Log) -> None:
    asked = "the ids were not checked; is it the noise of this robot?"
    _, remarks = tables_of(run(log.replace(notes=(asked, "a note")), estimators=["graph"]))
    assert f"simulated: {asked}" in remarks
    assert "simulated: a note." in remarks


def test_a_warning_that_solutions_repeat_is_shown_once(log: Log) -> None:
    doubt = "all sightings are of one landmark"
    doubted = log.replace(doubts=(("one landmark", doubt),))
    shown = tables_of(Comparison(doubted, (result(log, "graph", notes=(doubt, "the kernel rejects 3 sightings")),)))[1]
    assert [each for each in shown if doubt in each] == [f"WARNING: {doubt}."]
    assert "graph: the kernel rejects 3 sightings." in shown


def test_solvers_table_and_remarks() -> None:
    good = VariantResult("a body", 1e-9, 1e-12, 5.0, 9, 10, 0.01, 1.2, True, True)
    bad = VariantResult("b world", 1e-3, 1e-12, 5.0, 9, 10, 0.01, 1.2, True, True)
    outcome = SolverComparison((good, bad), tuple(SkippedVariant(name, "in pieces") for name in "cd"))
    lines = [line for line in as_text(outcome).splitlines() if "1.0e-" in line]
    assert [("yes" in line, "no" in line) for line in lines[:2]] == [(True, False), (False, True)]
    assert "9 / 10" in lines[0]
    assert tables_of(outcome)[1] == [
        "DIFFERENT: b world: poses differ by 1.0e-03, more than 1e-06.",
        "2 variants (c, ...) left out: in pieces.",
    ]


def test_backends_table_and_remarks() -> None:
    rows = (
        BackendRow("a.g2o", "graphslam", 10.0, 3, 0.1, True, ""),
        BackendRow("a.g2o", "g2o-gn", 10.0, 3, 0.4, True, ""),
        BackendRow("a.g2o", "gtsam-lm", 900.0, 3, 0.01, False, "the limit was reached"),
    )
    (table,), sentences = tables_of(BackendComparison(rows))
    assert list(table.columns[0].cells) == ["a.g2o", "", ""]
    assert list(table.columns[-1].cells) == ["–", "1/4.0", "–"]
    assert sentences == [
        "graphslam takes 1/4.0 of the time of g2o-gn (geometric mean).",
        "a.g2o: gtsam-lm did not reach the best chi2: the limit was reached.",
    ]


def test_study_tables() -> None:
    def method(log: str, name: str, failed: int, ate: Median) -> MethodSummary:
        figures = dict.fromkeys(METRICS) | {"ate_m": ate, "seconds": Median(0.5, None, None, 3, (0.5, 0.5))}
        return MethodSummary(log, name, 3, failed, 0, None, figures)

    wide, alone = Median(0.25, 0.125, 0.5, 3, (0.125, 0.5)), Median(-0.5, None, None, 1, (-0.5, -0.5))
    summary = Summary(
        9, 6, "graph", (method("w", "graph", 0, wide), method("w", "mcl", 2, alone), method("v", "graph", 0, wide)),
        (PairedDifference("w", "mcl", "graph", dict.fromkeys(METRICS) | {"ate_m": wide}, {"ate_m": 2}),),
        {f"error {k}": 9 - k for k in range(7)},
    )  # fmt: skip
    (table, gaps), sentences = tables_of(summary)
    cells = [[str(cell) for cell in column.cells] for column in table.columns]
    assert cells[0] == ["w", "", "v"]
    assert cells[3] == ["0", "2", "0"]
    assert cells[5] == ["500.0 ms"] * 3
    assert cells[6] == ["0.250 [0.125, 0.500]", "-0.500", "0.250 [0.125, 0.500]"]
    assert [str(next(column.cells)) for column in gaps.columns] == [  # type: ignore[call-overload]
        "w", "mcl", "3", "2/3", "+0.250 [+0.125, +0.500]", "–", "–",
    ]  # fmt: skip
    assert sentences[0] == "9 x error 0"
    assert sentences[-1].startswith("... and 2 other errors")


def test_calibration_table() -> None:
    (table,), sentences = tables_of(RESULTS["calibration"], name="a log")
    assert str(table.title) == "a log: noise models from the ground truth"
    cells = dict(zip(table.columns[0].cells, zip(table.columns[2].cells, table.columns[3].cells)))
    assert cells["nn"] == ("0.19", "0.012")
    assert cells["oo"] == ("0.2", "–")
    assert sentences[0].startswith("From 160 motions and 283 sightings.")


def test_the_survey_tells_what_is_at_hand_and_what_cannot_be_read(tmp_path: Path) -> None:
    found = {known.name: () for known in DATA_SETS} | {
        "lnpr": (Found(path=tmp_path / "a.txt", poses=4, poses_covered=2), Found(path=tmp_path / "b.txt", error="bad")),
    }
    (table,), sentences = tables_of(Survey(tmp_path, found))
    rows = list(zip(*([str(cell) for cell in column.cells] for column in table.columns)))
    assert rows[0][:4] == ("lnpr", "a.txt", "–", "4")
    assert rows[0][-2:] == ("50 %", "yes")
    assert rows[1][-1] == "no"
    assert "  at hand:   2" in sentences
    assert "  at hand:   no" in sentences


def test_html_has_all_cells_and_escapes_them() -> None:
    rows = (Row(name="<b>", converged=True, iterations=3, cost=1.5), Row(name="skipped", skipped="no map"))
    page = as_html(ResultTable("a [m] & b", rows))
    assert "<caption>a [m] &amp; b</caption>" in page
    assert '<th scope="row" style="text-align:left">&lt;b&gt;</th>' in page
    assert ">converged, iterations</th>" in page
    assert ">yes, 3</td>" in page
    assert page.count("<tr>") == 2
    assert page.count("<td") == 4
    assert page.endswith("<p>skipped has no result: no map.</p>")


def test_a_metric_is_declared_once():
    """Rows, studies, JSON, options and tables take their metrics from `graphslam.metrics.Errors`."""
    rows, columns, properties = ({f.name for f in fields(cls)} for cls in (Row, Outcome, Evaluated))
    in_json = [shown_by(kind) for kind in (Row, SessionErrors, Evaluated)]
    choices = options_of(SummaryOptions)["metric"].choices
    table = as_text(ResultTable("", (Row(name="graph", **dict.fromkeys(ERRORS, 0.125)),)), width=200)
    for name, about in ERRORS.items():
        assert all(name in names for names in (rows, columns, properties, *in_json, COLUMNS, METRICS, choices)), name
        assert (about["title"] in table) == (about["shown"] != "never"), name
    assert table.count("0.125") == sum(about["shown"] != "never" for about in ERRORS.values())


SAMPLE = load(sample_log_path())
OF_SAMPLE: dict[str, Callable[[], object]] = {
    "<VirtualMotionEdges: 3588 edges>": lambda: Graph.from_log(SAMPLE, edges="virtual").families[1],
    "<AnchorEdges: 1 edge>": lambda: Graph.from_log(SAMPLE, edges="virtual").families[0],
    "<FastSLAM1 on sample: 1000 particles, step 0 of 160>": lambda: FastSLAM1(SAMPLE),
    "<MonteCarloLocalization: 9 particles, step 0>": lambda: MonteCarloLocalization(map={1: (0, 0)}, particles=9),
    "<ParticleState: step 0, 1000 particles, ESS 1000.0>": lambda: next(iter(FastSLAM1(SAMPLE))),
    "<ParticleGibbs on sample: 4 chains of 300 sweeps, 50 particles>": lambda: ParticleGibbs(SAMPLE),
    "<Row dead-reckoning: ATE = ": lambda: run(SAMPLE, estimators="dead-reckoning").table[0],
    "<Row mcl: no map>": lambda: Row(name="mcl", skipped="no map"),
}


@pytest.mark.parametrize(("begin", "make"), OF_SAMPLE.items())
def test_a_repr_is_one_short_line(begin: str, make: Callable[[], object]) -> None:
    assert repr(make()).startswith(begin)
    assert len(repr(make())) <= 200
    assert "\n" not in repr(make())


def test_the_repr_of_a_table_is_its_text() -> None:
    table = run(SAMPLE, estimators="dead-reckoning").table
    assert repr(table) == str(table)
    assert "ATE" in repr(table)
