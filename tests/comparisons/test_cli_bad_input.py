"""Logs and options that the command line refuses: exit status 2, one sentence, and no files."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import Result

from graphslam import Log, save, simulate

QUICK = ["--estimators", "dead-reckoning,graph"]
GOOD = """\
delta 1
u 0 1 0.1
x 0 0 0 0
z 0 1 2 0.1 3
u 1 1 0.1
x 1 1 0 0.1
z 1 1 1 0.2 3
"""

Invoke = Callable[..., Result]


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate(seed=2, steps=24, clean=True)


def refused(result: Result, *words: str) -> None:
    """Exit status 2, one sentence on standard error, nothing on standard output, no files."""
    assert result.exit_code == 2, result.output
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    assert "Traceback" not in result.output
    assert result.stdout == ""
    for word in words:
        assert word in result.stderr
    assert [p for p in Path().rglob("*") if "results" in p.parts or p.name.startswith(".")] == []


DAMAGED = {
    "empty": ("", "empty"),
    "only blanks": ("\n \n", "empty"),
    "unknown tag": (GOOD + "q 1 2\n", ":8:"),
    "missing column": (GOOD.replace("x 1 1 0 0.1", "x 1 1 0"), ":6:"),
    "extra column": (GOOD.replace("u 0 1 0.1", "u 0 1 0.1 7"), ":2:"),
    "not a number": (GOOD.replace("z 0 1 2", "z 0 1 two"), ":4:"),
    "nan": (GOOD.replace("z 0 1 2", "z 0 1 nan"), ":4:"),
    "inf": (GOOD.replace("x 1 1 0", "x 1 inf 0"), ":6:"),
    "steps jump": (GOOD.replace("x 1 ", "x 3 "), "jumps"),
    "steps repeat": (GOOD.replace("x 1 ", "x 0 "), "repeats"),
    "steps run backwards": (GOOD + "z 0 1 1 0.2 3\n", "backwards"),
    "negative range": (GOOD.replace("z 0 1 2", "z 0 1 -2"), ":4:"),
    "range zero": (GOOD.replace("z 0 1 2", "z 0 1 0"), ":4:"),
    "landmark twice in a step": (GOOD.replace("z 1 1 1 0.2 3", "z 1 1 1 0.2 3\nz 1 1 1 0.2 3"), "twice"),
    "no sightings": ("\n".join(line for line in GOOD.splitlines() if line[0] != "z"), "no sightings"),
    "not text": (GOOD + "\udcff", "text"),
}


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["run", "solvers"])
@pytest.mark.parametrize("damage", DAMAGED)
def test_damaged_logs(invoke: Invoke, tmp_path: Path, damage: str, verb: str) -> None:
    content, word = DAMAGED[damage]
    (tmp_path / "log.txt").write_text(content, errors="surrogateescape")
    refused(invoke(verb, "log.txt"), word, "log")


@pytest.mark.slow
def test_the_good_log_is_good(invoke: Invoke, tmp_path: Path) -> None:
    (tmp_path / "log.txt").write_text(GOOD)
    assert invoke("run", "log.txt", *QUICK).exit_code == 0


@pytest.mark.parametrize("verb", ["run", "solvers"])
def test_paths_that_are_no_logs(invoke: Invoke, tmp_path: Path, verb: str) -> None:
    refused(invoke(verb, "nowhere.txt"), "nowhere.txt", "no such file")
    refused(invoke(verb, tmp_path), "folder")
    (tmp_path / "cut.npz").write_bytes(b"PK\x03\x04")
    refused(invoke(verb, "cut.npz"), "cut.npz")
    refused(invoke(verb, "--format", "xml"), "xml", "npz")


def test_bearings_out_of_the_circle_are_wrapped(invoke: Invoke, tmp_path: Path) -> None:
    (tmp_path / "log.txt").write_text(GOOD)
    (tmp_path / "turned.txt").write_text(GOOD.replace("z 0 1 2 0.1", f"z 0 1 2 {0.1 + 4 * np.pi!r}"))
    plain, turned = (json.loads(invoke("run", n, *QUICK, "--json", "-").stdout) for n in ("log.txt", "turned.txt"))
    np.testing.assert_allclose(turned["estimators"][1]["poses"], plain["estimators"][1]["poses"], atol=1e-9)


def test_a_landmark_seen_once_is_named_in_a_note(invoke: Invoke, tmp_path: Path) -> None:
    (tmp_path / "log.txt").write_text(GOOD.replace("z 1 1", "z 1 8 1 0 0\nz 1 1"))
    result = invoke("run", "log.txt", *QUICK)
    assert result.exit_code == 0
    assert "landmark 8" in result.stdout


def test_sightings_without_psi(invoke: Invoke, log: Log, tmp_path: Path) -> None:
    save(log.without_orientation(), tmp_path / "flat.npz")
    refused(invoke("run", "flat.npz", "--dimensions", 3), "psi", "dimensions 2")
    # two dimensions, virtual edges alone: some poses share a single landmark
    refused(invoke("run", "flat.npz", "--edges", "virtual", "--estimators", "graph"), "pose", "virtual+motion")
    assert invoke("run", "flat.npz", *QUICK).exit_code == 0


def test_two_dimensions_of_a_log_that_has_three(invoke: Invoke, log_file: Path) -> None:
    result = invoke("run", log_file, *QUICK, "--dimensions", 2, "--json", "-")
    assert json.loads(result.stdout)["log"]["dimensions"] == 2


@pytest.mark.slow
def test_a_graph_in_pieces(invoke: Invoke, tmp_path: Path) -> None:
    lines = []
    for t in range(4):
        lines += [f"x {t} {t} 0 0", f"z {t} {t // 2} 2 0.1 3"]
    (tmp_path / "log.txt").write_text("\n".join(lines))
    refused(invoke("run", "log.txt", "--estimators", "graph"), "poses 2 and 3")
    refused(invoke("solvers", "log.txt"), "poses 2 and 3")


@pytest.mark.parametrize("verb", ["run", "solvers"])
@pytest.mark.parametrize(
    ("option", "value"),
    [("--range-rate", "0"), ("--bearing-std", "-1"), ("--orientation-std", "nan"), ("--nn", "-0.1"), ("--oo", "inf")],
)
def test_noise_that_is_not_positive(invoke: Invoke, verb: str, option: str, value: str) -> None:
    refused(invoke(verb, option, value), option.strip("-").replace("-", "_"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--estimators", "graph,magic"], "magic"),
        (["--estimators", ","], "at least one"),
        (["--edges", "some"], "edges"),
        (["--frame", "some"], "frame"),
        (["--weight", "some"], "weight"),
        (["--initialize", "some"], "initialize"),
        (["--motion-weight", "0"], "motion_weight"),
        (["--out", "log.npz"], "is a file"),
        (["--out", "log.npz/deeper"], "is a file"),
        (["--json", "nowhere/a.json"], "nowhere"),
        (["--json", "."], "folder"),
    ],
)
def test_options_that_cannot_be(invoke: Invoke, log_file: Path, arguments: list[str], word: str) -> None:
    refused(invoke("run", log_file, *arguments), word)


@pytest.mark.parametrize(
    "arguments",
    [["run", "--particles", "0"], ["run", "--seed", "-1"], ["run", "--dimensions", "4"], ["run", "--nonsense"],
     ["run", "--motion-weight", "heavy"], ["fly"], ["simulate"]],
)  # fmt: skip
def test_options_that_do_not_exist(invoke: Invoke, tmp_path: Path, arguments: list[str]) -> None:
    result = invoke(*arguments)
    assert result.exit_code == 2
    assert "Traceback" not in result.output
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("weights", ["0", "1,-2", "a", "1,,2", "", "nan"])
def test_motion_weights_that_cannot_be(invoke: Invoke, log_file: Path, weights: str) -> None:
    refused(invoke("solvers", log_file, "--motion-weights", weights))


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_directory_that_cannot_be_written(invoke: Invoke, log_file: Path, tmp_path: Path) -> None:
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o500)
    refused(invoke("run", log_file, "--out", locked), "locked")
    refused(invoke("run", log_file, "--json", locked / "a.json"), "locked")


def test_a_directory_that_nobody_can_make(invoke: Invoke, log_file: Path) -> None:
    refused(invoke("run", log_file, *QUICK, "--out", "/proc/nowhere/out"), "/proc")
