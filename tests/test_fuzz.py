"""A small part of benchmarks/fuzz.py and fuzz_online.py: graphs, files, command lines and drives of a fixed random seed."""

from __future__ import annotations

import runpy
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

#: the number of the first case, and that after the last one
CASES = {"graphs": (0, 60), "files": (0, 25), "commands": (0, 12)}
MORE = {"graphs": (0, 160), "files": (0, 100), "commands": (0, 30)}


@pytest.fixture(scope="module")
def fuzz() -> Iterator[dict[str, Any]]:
    folder = Path(__file__).parents[1] / "benchmarks"
    with pytest.MonkeyPatch.context() as patch:
        # as `python benchmarks/fuzz.py` does
        patch.syspath_prepend(str(folder))
        yield runpy.run_path(str(folder / "fuzz.py"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("suite", "numbers"), [*CASES.items(), *(pytest.param(*each, marks=pytest.mark.nightly) for each in MORE.items())]
)
def test_no_traceback_no_nan_no_false_convergence_and_no_end_above_the_start(
    fuzz: dict[str, Any], suite: str, numbers: tuple[int, int]
) -> None:
    failed, outcomes = [], []
    for number in range(*numbers):
        name, check = fuzz["SUITES"][suite](2026, number)
        outcome, problems = fuzz["attempt"](check, limit=200)
        outcomes.append(outcome)
        failed += [f"{name}: {problem}" for problem in problems]
    assert failed == []
    # not everything is refused
    assert outcomes.count("solved") > 0.1 * len(outcomes)


@pytest.mark.slow
@pytest.mark.parametrize("count", [10, pytest.param(25, marks=pytest.mark.nightly)])
def test_drives_with_bad_steps_in_between(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    """Each bad step is refused, and the solver equals one that never saw it."""
    folder = Path(__file__).parents[1] / "benchmarks"
    monkeypatch.syspath_prepend(folder)
    online = runpy.run_path(str(folder / "fuzz_online.py"))
    for number in range(count):
        name, check = online["online_case"](2026, number)
        assert online["attempt"](check, limit=120) == ("solved", []), name
