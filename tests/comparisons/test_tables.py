from __future__ import annotations

import io

import numpy as np
import pytest
from rich.console import Console

from comparisons import tables
from comparisons.comparison import Comparison, Skipped
from comparisons.estimator import EstimatorResult
from comparisons.solvers import SkippedVariant, SolverComparison, VariantResult
from graphslam import Log, simulate


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate(seed=2, steps=5).replace(notes=("a control was dropped",))


def shown(table: object) -> str:
    console = Console(file=io.StringIO(), width=160)
    console.print(table)
    return console.file.getvalue()  # type: ignore[attr-defined, no-any-return]


def result(log: Log, name: str, **rest: object) -> EstimatorResult:
    return EstimatorResult(name=name, poses=log.initial_poses, estimated=np.ones(6, bool), seconds=0.0123, **rest)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "–"), (0.0, "0.000"), (0.1234, "0.123"), (12.0, "12.000"), (1e-4, "1.00e-04"), (2.5e7, "2.50e+07")],
)
def test_numbers(value: float | None, text: str) -> None:
    assert tables.number(value) == text


@pytest.mark.parametrize(("value", "text"), [(None, "–"), (2e-5, "20 µs"), (0.0123, "12.3 ms"), (3.0, "3.00 s")])
def test_seconds(value: float | None, text: str) -> None:
    assert tables.seconds(value) == text


def test_table_keeps_its_units_and_dashes(log: Log) -> None:
    outcome = Comparison(
        log, (result(log, "graph", converged=True, iterations=7, cost=12.5),), (Skipped("mcl", "no map"),)
    )
    text = shown(tables.comparison_table(outcome.table))
    for word in ("ATE", "[m]", "[rad]", "graph", "yes", " 7 ", "12.3 ms", "12.500", "mcl"):
        assert word in text
    (row,) = [line for line in text.splitlines() if "mcl" in line]
    assert row.count("–") == 8


def test_the_table_fits_into_80_characters(log: Log) -> None:
    row = result(log, "dead-reckoning", converged=True, iterations=100, cost=12345.6789)
    console = Console(file=io.StringIO(), width=80)
    console.print(tables.comparison_table(Comparison(log, (row,)).table))
    assert "dead-reckoning     yes     100  12.3 ms  12345.679" in console.file.getvalue()  # type: ignore[attr-defined]


def test_remarks(log: Log) -> None:
    note = "landmark 3 was seen once"
    graph = result(log, "graph", converged=False, reason="max_iterations = 100 reached", notes=(note,))
    outcome = Comparison(
        log.replace(true_poses=None), (graph, result(log, "gtsam", notes=(note,))), (Skipped("mcl", "no map"),)
    )
    assert tables.comparison_remarks(outcome) == [
        "graph and gtsam differ by at most 0.0e+00 in any x, y [m] or heading [rad].",
        "The log has no true poses, so no error can be measured.",
        "mcl left out: no map.",
        "graph did not converge: max_iterations = 100 reached.",
        "simulated: a control was dropped.",
        "graph, gtsam: landmark 3 was seen once.",
    ]


def test_solvers_table_and_remarks() -> None:
    good = VariantResult("a body", 1e-9, 1e-12, 5.0, 9, 10, 0.01, 1.2, True, True)
    bad = VariantResult("b world", 1e-3, 1e-12, 5.0, 9, 10, 0.01, 1.2, True, True)
    outcome = SolverComparison((good, bad), tuple(SkippedVariant(name, "in pieces") for name in "cd"))
    text = shown(tables.solvers_table(outcome, "log"))
    assert [("yes" in line, "no" in line) for line in text.splitlines() if "1.0e-" in line] == [
        (True, False),
        (False, True),
    ]
    assert tables.solvers_remarks(outcome) == [
        "DIFFERENT: b world: poses differ by 1.0e-03, more than 1e-06.",
        "2 variants (c, ...) left out: in pieces.",
    ]
    assert tables.variant_line(good) == "a body: 10.0 ms, gtsam 1.20 s"
    assert tables.variant_line(SkippedVariant("c", "in pieces")) == "c: skipped"
