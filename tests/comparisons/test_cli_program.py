"""The command line as a program of its own: its processes, its interruption, and how it writes to terminals."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import textwrap
import time
from functools import partial
from pathlib import Path

import psutil
import pytest

from comparisons.cli.output import Output

ROOT = Path(__file__).parents[2]
QUICK = ["--estimators", "dead-reckoning,graph"]


def test_the_command_line_imports_nothing_heavy() -> None:
    code = """if True:
        import sys, comparisons.cli, comparisons.__main__
        heavy = {"numpy", "scipy", "matplotlib", "gtsam", "rich.table", "comparisons.show"} & set(sys.modules)
        sys.exit(str(heavy) if heavy else 0)
    """
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


@pytest.mark.slow
def test_a_run_of_the_graph_imports_no_special_functions_and_figures_no_pyplot(tmp_path: Path) -> None:
    code = """if True:
        import sys
        from comparisons import run
        run(estimators="graph").save(".")
        assert "scipy.special" not in sys.modules
        import comparisons.show.figures, comparisons.show.studies, comparisons.show.films, comparisons.show.report
        assert "matplotlib.pyplot" not in sys.modules
    """
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)})


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
    process = program("run", "log.npz", *QUICK, "--out", "here", "--figures", "", "--json", "-", cwd=tmp_path)
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


@pytest.mark.nightly
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
    *progress, last = err.splitlines()
    assert (out, last) == ("", "interrupted") and all(": graphslam " in line for line in progress)
    assert list(tmp_path.iterdir()) == []


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


@pytest.mark.slow
def test_completion_knows_verbs() -> None:
    env = os.environ | {"_SLAM_COMPARE_COMPLETE": "complete_bash", "COMP_WORDS": "slam-compare sol", "COMP_CWORD": "1"}
    done = subprocess.run([sys.executable, "-m", "comparisons"], env=env, capture_output=True, text=True, timeout=60)
    assert done.stdout.split() == ["solvers"]


@pytest.mark.slow
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
