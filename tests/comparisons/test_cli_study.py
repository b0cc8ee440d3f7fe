"""The verbs ``sweep`` and ``study`` from outside: exit statuses, sentences, what the next step is, what is left on disk."""

from __future__ import annotations

import csv
import json
import socket
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from comparisons.cli import app
from comparisons.studies.execute import StudyDatabase
from comparisons.studies.sweep import check_answers
from graphslam import OptionError

STUDY = """\
seeds = 3
estimators = ["dead-reckoning", "graph"]
[simulate]
steps = 12
"""

Invoke = Callable[..., Result]


@pytest.fixture
def invoke(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Invoke:
    monkeypatch.chdir(tmp_path)
    Path("study.toml").write_text(STUDY)
    return lambda *arguments: CliRunner().invoke(app, [str(a) for a in arguments])


def refused(result: Result, *words: str) -> None:
    assert result.exit_code == 2, result.output
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    assert result.stdout == ""
    for word in words:
        assert word in result.stderr


@pytest.mark.slow
def test_from_the_study_file_to_the_figure(invoke: Invoke) -> None:
    result = invoke("sweep", "study.toml", "--jobs", "0")
    assert result.exit_code == 0, result.output
    assert result.stderr == ""  # no bar: this is no terminal
    assert "study.sqlite: 6 of 6 runs, 6 done now." in result.stdout
    assert "Next: slam-compare study study.sqlite" in result.stdout

    for words in (["study.sqlite"], ["study.toml"]):
        result = invoke("study", *words)
        assert result.exit_code == 0, result.output
        for word in (
            "6 of 6 runs",
            "graph",
            "dead-reckoning",
            "ATE",
            "differences from graph",
            "3",
            "--figure study.png",
        ):
            assert word in result.stdout

    result = invoke("study", "study.sqlite", "--figure", "f.pdf", "--csv", "r.csv", "--jsonl", "r.jsonl", "--json", "-")
    assert result.exit_code == 0, result.output
    payload = json.loads(result.stdout)
    assert (payload["planned"], payload["done"], payload["baseline"]) == (6, 6, "graph")
    assert {line["method"] for line in payload["methods"]} == {"graph", "dead-reckoning"}
    assert payload["differences"][0]["figures"]["ate_m"]["count"] == 3
    assert Path("f.pdf").read_bytes().startswith(b"%PDF")
    with Path("r.csv").open(newline="") as stream:
        assert len(list(csv.DictReader(stream))) == 6
    assert len([json.loads(line) for line in Path("r.jsonl").read_text().splitlines()]) == 6


def test_a_study_with_failed_runs_ends_with_1_and_says_how_to_go_on(invoke: Invoke) -> None:
    Path("study.toml").write_text('logs = ["gone.npz"]\nestimators = ["graph"]\n')
    result = invoke("sweep", "study.toml", "--jobs", "0", "--json", "-")
    assert result.exit_code == 1
    assert json.loads(result.stdout)["failed"] == 1
    assert "slam-compare sweep study.toml --jobs 0 --retry" in result.stderr
    result = invoke("study", "study.sqlite")
    assert result.exit_code == 0
    assert "1 x" in result.stdout
    assert "no such file" in result.stdout


def test_a_study_that_is_not_finished_says_so(invoke: Invoke) -> None:
    invoke("sweep", "study.toml", "--jobs", "0")
    Path("study.toml").write_text(STUDY.replace("3", "5"))
    from comparisons.studies.plan import read_study

    with StudyDatabase.writing(Path("study.sqlite")) as database:
        database.plan(read_study(Path("study.toml")))
    result = invoke("study", "study.sqlite")
    assert "6 of 10 runs" in result.stdout
    assert "execute the other 4" in result.stdout
    Path("study.toml").write_text(STUDY.replace("3", "1"))
    invoke("sweep", "study.toml", "--jobs", "0")
    assert "4 rows of runs that are no longer part of the study file are kept" in invoke("study", "study.sqlite").stdout


def test_a_study_without_runs_has_no_figure_and_says_so(invoke: Invoke) -> None:
    from comparisons.studies.plan import read_study

    with StudyDatabase.writing(Path("study.sqlite")) as database:
        database.plan(read_study(Path("study.toml")))
    result = invoke("study", "study.sqlite", "--figure", "f.png")
    assert result.exit_code == 0, result.output
    assert "There is no figure: the study has no executed run." in result.stdout
    assert not Path("f.png").exists()


def test_wrong_use(invoke: Invoke) -> None:
    Path("study.toml").write_text("seed = 3\n" + STUDY)
    refused(invoke("sweep", "study.toml"), "study.toml:1:", "'seed'", "'seeds'")
    refused(invoke("sweep", "nowhere.toml"), "no such file")
    Path("study.toml").write_text(STUDY)
    refused(invoke("study", "nowhere.sqlite"), "no such file")
    refused(invoke("study", "study.toml"), "study.sqlite", "no such file")
    assert invoke("study", "a", "b").exit_code == 2
    refused(invoke("sweep", "study.toml", "--jobs", "2", "--dask", "tcp://127.0.0.1:1"), "not both")
    with StudyDatabase.writing(Path("study.sqlite")):
        refused(invoke("sweep", "study.toml", "--jobs", "0"), "study.sqlite", "another study")
    invoke("sweep", "study.toml", "--jobs", "0")
    refused(invoke("study", "study.sqlite", "--baseline", "grap"), "'graph'")
    refused(invoke("study", "study.sqlite", "--metric", "speed"), "ate_m")
    refused(invoke("study", "study.sqlite", "--csv", "no/where.csv"), "no such folder")


@pytest.mark.parametrize("address", ["nonsense", "http://127.0.0.1:1", "tcp://127.0.0.1", "tcp://127.0.0.1:x"])
def test_what_is_no_address(invoke: Invoke, address: str) -> None:
    refused(invoke("sweep", "study.toml", "--dask", address), "tcp://host:8786")
    assert not Path("study.sqlite").exists()


def test_a_cluster_that_does_not_answer(invoke: Invoke) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        check_answers(f"tcp://127.0.0.1:{port}")
    # the port was free a moment ago
    with pytest.raises(OptionError, match="no Dask scheduler answers"):
        check_answers(f"tcp://127.0.0.1:{port}")
    refused(invoke("sweep", "study.toml", "--dask", f"tcp://127.0.0.1:{port}"), "Connection refused", "dask scheduler")
    assert not Path("study.sqlite").exists()


def test_somebody_else_who_answers(invoke: Invoke) -> None:
    pytest.importorskip("distributed", reason="needs the extra cluster")
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            connection, _ = server.accept()
            connection.close()
            connection, _ = server.accept()
            with connection:
                connection.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")

        thread = threading.Thread(target=answer, daemon=True)
        thread.start()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        refused(invoke("sweep", "study.toml", "--dask", address), "no Dask scheduler answers", address)
        thread.join()
