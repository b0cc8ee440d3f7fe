"""The command line from outside: exit statuses, sentences, and what is left on disk."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import psutil
import pytest
from typer.testing import CliRunner, Result

import graphslam.log
from comparisons import solvers
from comparisons.cli import app
from comparisons.cli.output import Output
from graphslam import Log, save, simulate

ROOT = Path(__file__).parents[2]
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


@pytest.fixture
def invoke(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Invoke:
    """Run a command in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: CliRunner().invoke(app, [str(a) for a in arguments])


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate(seed=2, steps=24, clean=True)


@pytest.fixture
def log_file(log: Log, tmp_path: Path) -> Path:
    path = tmp_path / "log.npz"
    save(log, path)
    return path


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


# -- bad input ---------------------------------------------------------------------------------------------------------

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


# -- run -------------------------------------------------------------------------------------------------------------


def test_run_leaves_a_figure_and_json(invoke: Invoke, log_file: Path, tmp_path: Path) -> None:
    result = invoke("run", log_file, "--particles", 50)
    assert result.exit_code == 0, result.output
    (folder,) = (p for p in (tmp_path / "results").iterdir() if not p.is_symlink())
    names = ["comparison.json", "comparison.pdf", "comparison.png", "config.toml"]
    written = sorted(p.name for p in folder.iterdir())
    assert [name for name in written if not name.endswith((".tum", ".csv"))] == [*names, "graph.g2o"]
    assert {"truth.tum", "graph.tum", "graph-map.csv", "gtsam.tum"} < set(written)
    assert (tmp_path / "results" / "latest").resolve() == folder.resolve()
    for word in (
        *names,
        folder.name,
        "slam-compare report",
        "ATE",
        "[rad]",
        "graph and gtsam differ by at most",
    ):
        assert word in result.stdout
    payload = json.loads((folder / "comparison.json").read_text())
    assert [entry["name"] for entry in payload["estimators"]][2] == "graph"
    assert (tmp_path / payload["files"]["figure"]).exists()


def test_json_on_standard_output_stands_alone(invoke: Invoke, log_file: Path) -> None:
    result = invoke("run", log_file, *QUICK, "--out", "here", "--json", "-")
    payload = json.loads(result.stdout)
    assert payload["files"]["json"] == str(Path("here/comparison.json"))
    assert "ATE" in result.stderr


def test_json_into_a_file(invoke: Invoke, log_file: Path, tmp_path: Path) -> None:
    assert invoke("run", log_file, *QUICK, "--out", "here", "--json", "mine.json").exit_code == 0
    assert json.loads(Path("mine.json").read_text()) == json.loads(Path("here/comparison.json").read_text())


def test_options_reach_the_estimators(invoke: Invoke, log_file: Path) -> None:
    options = [
        "--initialize",
        "given",
        "--frame",
        "world",
        "--weight",
        "tempered",
        "--motion-weight",
        "3",
        "--edges",
        "virtual+motion",
        "--kernel",
        "cauchy",
    ]
    command = [
        "run",
        log_file,
        "--estimators",
        "graph,fastslam1",
        "--particles",
        20,
        "--seed",
        5,
        *options,
        "--json",
        "-",
    ]
    graph, fastslam = json.loads(invoke(*command).stdout)["estimators"]
    expected = {"edges": "virtual+motion", "frame": "world", "weight": "tempered", "motion_weight": 3.0}
    assert graph["options"] == expected | {
        "initialize": "given", "kernel": "cauchy", "residual": "cartesian", "estimate": None,
    }  # fmt: skip
    expected = {"particles": 20, "seed": 5, "resampling": "systematic", "association": "known"}
    assert fastslam["options"].items() >= expected.items()
    noisy = json.loads(invoke("run", log_file, *QUICK, "--range-rate", "0.5", "--json", "-").stdout)["estimators"][1]
    assert noisy["cost"] != pytest.approx(graph["cost"])


def test_one_that_cannot_run_is_a_row(invoke: Invoke, log: Log, tmp_path: Path) -> None:
    save(log.replace(true_landmarks=None), tmp_path / "log.npz")
    result = invoke("run", "log.npz", "--particles", 20, "--out", "here")
    assert result.exit_code == 0
    assert "mcl left out" in result.stdout
    named = invoke("run", "log.npz", "--estimators", "graph,mcl", "--json", "-", "--out", "there")
    assert named.exit_code == 0
    graph, mcl = json.loads(named.stdout)["estimators"]
    assert graph["converged"]
    assert "below the tolerance" in graph["reason"]
    assert "map" in mcl["reason"]
    refused(invoke("run", "log.npz", "--estimators", "mcl"), "map")
    # without ids, too
    unnamed = np.full(len(log.steps), graphslam.log.UNIDENTIFIED)
    save(log.replace(landmarks=unnamed), tmp_path / "unnamed.npz")
    result = invoke("run", "unnamed.npz", "--estimators", "dead-reckoning,mcl")
    assert result.exit_code == 0
    assert "mcl left out" in result.stdout


def test_the_sample_log_is_the_default(invoke: Invoke) -> None:
    result = invoke("run", *QUICK)
    assert result.exit_code == 0
    assert "sample: " in result.stdout
    assert "slam-compare report report.html" in result.stdout


def test_a_figure_and_a_page_that_fail_are_notes(
    invoke: Invoke, log_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("plotly", reason="needs the extra 'report'")

    def breaks(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("comparisons.comparison.Comparison.figure", breaks)
    monkeypatch.setattr("comparisons.show.report.page.page_of", breaks)
    result = invoke("run", log_file, *QUICK, "--out", "here", "--html", "page.html", "--json", "out.json")
    assert result.exit_code == 0
    assert "There is no figure: ZeroDivisionError." in result.stdout
    expected = ["there is no figure: ZeroDivisionError", "there is no interactive report: ZeroDivisionError"]
    assert json.loads((tmp_path / "out.json").read_text())["notes"] == expected
    assert not (tmp_path / "page.html").exists()


def test_nothing_is_left_behind_when_a_run_breaks(
    invoke: Invoke, log_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def breaks(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("comparisons.comparison.write_json", breaks)
    result = invoke("run", log_file, *QUICK, "--out", "here")
    assert isinstance(result.exception, ZeroDivisionError)
    assert [p.name for p in tmp_path.iterdir()] == ["log.npz"]


def test_an_interrupted_run_says_so(invoke: Invoke, log_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("comparisons.comparison.compare", interrupted)
    result = invoke("run", log_file)
    assert result.exit_code == 130
    assert result.stderr == "interrupted\n"


def test_an_interrupt_within_an_import_is_an_interrupt(
    invoke: Invoke, log_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def half_imported(*_: object, **__: object) -> None:
        # so does a module of pybind11, such as gtsam, that is interrupted while it loads
        raise ImportError("initialization failed") from KeyboardInterrupt()

    monkeypatch.setattr("comparisons.comparison.compare", half_imported)
    result = invoke("run", log_file)
    assert result.exit_code == 130
    assert result.stderr == "interrupted\n"


def test_ctrl_c_while_the_command_line_is_imported(tmp_path: Path) -> None:
    code = """
        import sys
        def stop(name, *_):
            if name == "typer":
                raise KeyboardInterrupt
        sys.meta_path.insert(0, type("Finder", (), {"find_spec": staticmethod(stop)}))
        from comparisons.__main__ import main
        main()
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True, cwd=ROOT)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "interrupted\n")


# -- solvers -----------------------------------------------------------------------------------------------------------


def test_solvers_agree(invoke: Invoke, log_file: Path) -> None:
    result = invoke("solvers", log_file, "--motion-weights", "1", "--jobs", 2, "--json", "a.json")
    assert result.exit_code == 0, result.output
    assert "agree in all" in result.stdout
    assert {"variants", "skipped"} == set(json.loads(Path("a.json").read_text()))


def test_only_the_graphs_that_are_named(invoke: Invoke, log_file: Path) -> None:
    command = ["solvers", log_file, "--motion-weights", "2", "--jobs", 1]
    result = invoke(*command, "--edges", "virtual+motion", "--json", "-")
    assert {entry["name"].split()[0] for entry in json.loads(result.stdout)["variants"]} == {"virtual+motion"}
    refused(invoke(*command, "--edges", "virtual,some"), "some", "virtual+motion")


@pytest.mark.slow
def test_solvers_that_differ_exit_with_one(invoke: Invoke, log_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sloppy = solvers.solve
    monkeypatch.setattr(solvers, "solve", lambda graph, **_: sloppy(graph, tolerance=1e-3))
    result = invoke("solvers", log_file, "--motion-weights", "1", "--jobs", 0, "--json", "-")
    assert result.exit_code == 1
    assert "DIFFERENT" in result.stderr
    assert not all(entry["agree"] for entry in json.loads(result.stdout)["variants"])


# -- the program -------------------------------------------------------------------------------------------------------


def test_help_shows_examples_and_units(invoke: Invoke) -> None:
    assert all(verb in invoke("--help").stdout for verb in ("run", "solvers", "simulate"))
    for verb in ("run", "solvers", "simulate"):
        text = invoke(verb, "--help").stdout
        assert f"slam-compare {verb}" in text
        assert "Examples" in text
        assert "[rad]" in text


def test_version(invoke: Invoke) -> None:
    result = invoke("--version")
    assert result.exit_code == 0
    assert result.stdout.startswith("slam-compare")


def test_the_command_line_imports_nothing_heavy() -> None:
    code = """if True:
        import sys, comparisons.cli, comparisons.__main__
        heavy = {"scipy", "matplotlib", "numba", "gtsam", "rich.table", "comparisons.show"} & set(sys.modules)
        sys.exit(str(heavy) if heavy else 0)
    """
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


def program(*arguments: str, cwd: Path) -> subprocess.Popen[str]:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.Popen(
        [sys.executable, "-m", "comparisons", *arguments],
        cwd=cwd, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        # a suite that runs in the background ignores Ctrl-C, and its children would, too
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip


@pytest.mark.slow
def test_the_program_as_a_process(log_file: Path, tmp_path: Path) -> None:
    process = program("run", "log.npz", *QUICK, "--out", "here", "--json", "-", cwd=tmp_path)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    assert json.loads(out)["estimators"][1]["converged"] is True

    process = program("run", "nowhere.txt", cwd=tmp_path)
    out, err = process.communicate(timeout=120)
    assert (process.returncode, out) == (2, "")
    assert err == "error: nowhere.txt: there is no such file\n"


def wait_for_work(process: subprocess.Popen[str]) -> None:
    """Wait until a local process has computed for four seconds, which is well after it has started."""
    deadline = time.monotonic() + 60
    while max((child.cpu_times().user for child in psutil.Process(process.pid).children()), default=0) < 4:
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.2)


def test_ctrl_c(tmp_path: Path) -> None:
    # far more variants than a test can wait for
    weights = ",".join(str(k) for k in range(1, 2000))
    process = program("solvers", "--motion-weights", weights, "--json", "a.json", cwd=tmp_path)
    try:
        wait_for_work(process)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    # where the signal hits an extension module that is just being imported, Python ends by the signal: 130 to a shell
    assert process.returncode in (130, -signal.SIGINT)
    assert (out, err) == ("", "interrupted\n")
    assert list(tmp_path.iterdir()) == []


# -- what all verbs understand ---------------------------------------------------------------------------------------


def test_quiet_leaves_the_result_alone(invoke: Invoke, log_file: Path) -> None:
    said = invoke("run", log_file, *QUICK, "--out", "here")
    quiet = invoke("run", log_file, *QUICK, "--out", "here", "--quiet")
    assert "ATE" in quiet.stdout
    for hint in ("Repeat this run:", "Wrote", "Animation:"):
        assert hint in said.stdout
        assert hint not in quiet.stdout
    # nothing is left of it in the next run
    assert "Repeat this run:" in invoke("run", log_file, *QUICK, "--out", "here").stdout


def test_verbose_tells_each_step_and_where_errors_arise(invoke: Invoke, log_file: Path) -> None:
    assert "step norm" in invoke("run", log_file, "-v", "--estimators", "graph", "--out", "here").stderr
    assert "Traceback" in invoke("run", "nowhere", "-v").stderr
    assert "Traceback" not in invoke("run", "nowhere").stderr


def test_every_verb_is_quiet_and_verbose_on_demand(invoke: Invoke) -> None:
    from comparisons.cli import app

    for command in app.registered_commands:
        assert command.callback is not None
        text = invoke(command.name or command.callback.__name__, "--help").stdout
        assert "--quiet" in text
        assert "--verbose" in text


def test_completion_knows_verbs() -> None:
    env = os.environ | {"_SLAM_COMPARE_COMPLETE": "complete_bash", "COMP_WORDS": "slam-compare sol", "COMP_CWORD": "1"}
    done = subprocess.run([sys.executable, "-m", "comparisons"], env=env, capture_output=True, text=True, timeout=60)
    assert done.stdout.split() == ["solvers"]


def test_no_color_is_honoured() -> None:
    coloured = re.compile(r"\x1b\[[0-9;]*3[0-7]")
    command = [sys.executable, "-m", "comparisons", "run", "--help"]
    plain = {name: value for name, value in os.environ.items() if name != "NO_COLOR"}
    plain |= {"FORCE_COLOR": "1", "TERM": "xterm"}
    for env, expected in ((plain, True), (plain | {"NO_COLOR": "1"}, False)):
        done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=60)
        assert bool(coloured.search(done.stdout)) is expected


def test_the_program_is_named_so_that_it_is_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from comparisons.cli.output import program

    called = tmp_path / "my venv" / "bin" / "slam-compare"
    called.parent.mkdir(parents=True)
    called.write_text("#!/bin/sh\n")
    called.chmod(0o755)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(called)])
    monkeypatch.setenv("PATH", str(tmp_path))
    assert program() == "'my venv/bin/slam-compare'"
    monkeypatch.setenv("PATH", str(called.parent))
    assert program() == "slam-compare"


@pytest.mark.parametrize("terminal", [True, False])
def test_sentences_are_broken_between_words_on_terminals_only(
    terminal: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TTY_COMPATIBLE", str(int(terminal)))
    text = "a sentence that goes on " * 10
    output = Output(None)
    output.say(text)
    output.hint(f"slam-compare run {text}")
    *sentence, command = capsys.readouterr().out.splitlines()
    assert len(command) > 200
    if terminal:
        assert max(map(len, sentence)) <= 80
        assert " ".join(line.strip() for line in sentence) == text.strip()
    else:
        assert sentence == [text]
