"""Names of logs and files are data: nothing in them is mathematics, markup, a formula, or a command to a terminal."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import Result

import comparisons
from comparisons.estimators.config import read_config
from comparisons.options.toml_files import to_toml
from comparisons.results.documents import json_text
from comparisons.show.canvas import as_text, paper_figure
from comparisons.show.tables import as_html
from comparisons.show.tables import as_text as table_text
from comparisons.studies.summary import write_csv, write_json_lines
from graphslam import Graph, Log, LogError, OptionError, SlamError, load, save, simulate
from graphslam.errors import printable
from graphslam.graph.transform import relative_graph

NAMES = ["$$", "a$x^{$b", r"\$", "$\\frac{", "=1+1", "@SUM(1)", "[red]x[/blue]", "<script>alert(1)</script>", "a\x1b[31mb",
         "x\ny", "\udcff\udcfe", "%s{0}", "_hidden", "\u202eleft", "ü日本"]  # fmt: skip
QUICK = ["--estimators", "dead-reckoning,graph"]

Invoke = Callable[..., Result]


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate(seed=2, steps=12, clean=True)


#: the same in few files, for what takes long
FILES = ["a$x^{$b", "\udcff\udcfe$$", "=[red]x[/blue]\x1b[31m\n<script>alert(1)</script>"]


@pytest.fixture(params=FILES, ids=ascii)
def named(request: pytest.FixtureRequest, log: Log, tmp_path: Path) -> Path:
    """The file of a log whose name is data."""
    path = tmp_path / f"{request.param}.npz".replace("/", "∕")
    try:
        path.touch()
    except OSError as error:  # file systems of other systems
        pytest.skip(str(error))
    save(log, tmp_path / "log.npz")
    shutil.move(tmp_path / "log.npz", path)
    return path


def test_printable() -> None:
    assert printable("plain ü日本 $") == "plain ü日本 $"
    assert printable("a\x1b[31mb\nc\td") == "a\\x1b[31mb c d"
    assert printable("\udcff") == "\\udcff"
    assert str(LogError("two\n  lines \x07")) == "two lines \\x07"


@pytest.mark.parametrize("name", NAMES, ids=ascii)
def test_figures_show_names_as_they_are(name: str) -> None:
    with paper_figure() as figure:
        text = figure.suptitle(as_text(name))
    # what matplotlib draws where it takes a text for no mathematics
    shown, mathematics = text._preprocess_math(text.get_text())
    assert (shown, mathematics) == (printable(name), False)


@pytest.mark.slow
def test_a_run_on_any_name(named: Path, invoke: Invoke, tmp_path: Path) -> None:
    result = invoke(
        "run", named, *QUICK, "--out", "out", "--figures", "png", "--html", "page.html", "--json", "result.json"
    )
    assert result.exit_code == 0, result.output
    assert "\x1b" not in result.output
    assert "failed" not in result.output
    data = json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))
    assert named.samefile(data["log"]["file"])
    assert (tmp_path / "out" / "comparison.png").stat().st_size > 10_000
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "<script>alert" not in page
    # and again from its configuration
    assert named.samefile(read_config(tmp_path / "out" / "config.toml")["log"])
    again = invoke("run", "--config", tmp_path / "out" / "config.toml", "--out", "again")
    assert again.exit_code == 0, again.output


@pytest.mark.nightly
# one name with all that is strange in the three, because each verb takes seconds
@pytest.mark.parametrize("named", [FILES[2] + FILES[0] + FILES[1]], indirect=True, ids=ascii)
def test_filters_calibration_and_films_on_any_name(named: Path, invoke: Invoke, tmp_path: Path) -> None:
    small = ("--particles", "10", "--seeds", "1", "--jobs", "0", "--filters", "fastslam1")
    assert invoke("particles", named, *small, "--figure", "p.png", "--json", "p.json").exit_code == 0
    result = invoke("calibrate", named, "--out", "noise.toml", "--json", "c.json")
    assert result.exit_code == 0, result.output
    assert invoke("run", named, *QUICK, "--noise", "noise.toml", "--out", "out").exit_code == 0
    result = invoke("show", named, "--figure", "show.png")
    assert result.exit_code == 0, result.output
    result = invoke("animate", named, "film.html", "--max-frames", "2")
    assert result.exit_code == 0, result.output
    assert "<script>alert" not in (tmp_path / "film.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_study_of_any_name(named: Path, invoke: Invoke, tmp_path: Path) -> None:
    study = tmp_path / "study.toml"
    study.write_text('logs = ["*.npz"]\nestimators = ["dead-reckoning"]\n', encoding="utf-8")
    result = invoke("sweep", study, "--jobs", "0")
    assert result.exit_code == 0, result.output
    result = invoke("study", study, "--csv", "r.csv", "--jsonl", "r.jsonl", "--figure", "s.png", "--json", "s.json")
    assert result.exit_code == 0, result.output
    assert "\x1b" not in result.output
    (row,) = csv.DictReader((tmp_path / "r.csv").read_text(encoding="utf-8").splitlines())
    assert row["log"].lstrip("'") == printable(named.name)
    assert row["log"][0] not in "=+-@"


@pytest.mark.parametrize("name", NAMES, ids=ascii)
def test_tables_and_json_in_memory(log: Log, name: str, tmp_path: Path) -> None:
    comparison = comparisons.run(log.replace(name=name), estimators="dead-reckoning")
    assert printable(name) in table_text(comparison, width=400)
    # without the figure, which is the same for all names but for a title; `test_figures_show_names_as_they_are` has these
    html = as_html(comparison.table)
    assert "<script>" not in html and ("&lt;script&gt;" in html) == ("<script>" in name)
    assert json.loads(json_text({"name": name, name: [name, {"x": name}]}).encode()) == {
        "name": name, name: [name, {"x": name}],
    }  # fmt: skip
    rows = [dict.fromkeys(comparisons.studies.execute.COLUMNS, name)]
    write_json_lines(rows, tmp_path / "rows.jsonl")
    assert json.loads((tmp_path / "rows.jsonl").read_text(encoding="utf-8"))["log"] == name


def test_cells_that_spreadsheets_would_execute(tmp_path: Path) -> None:
    columns = comparisons.studies.execute.COLUMNS
    texts = ["=1+1", "+1", "-x", "@a", "plain", "a=b"]
    write_csv([dict.fromkeys(columns, text) for text in texts] + [dict.fromkeys(columns, -0.5)], tmp_path / "rows.csv")
    written = [row["log"] for row in csv.DictReader((tmp_path / "rows.csv").read_text().splitlines())]
    assert written == ["'=1+1", "'+1", "'-x", "'@a", "plain", "a=b", "-0.5"]


def test_a_missing_file_of_any_name_is_a_sentence() -> None:
    for name in NAMES:
        with pytest.raises(SlamError) as caught:
            load(f"nowhere/{name}.npz")
        assert str(caught.value).isprintable()


@pytest.mark.slow
def test_paths_that_the_system_refuses(invoke: Invoke) -> None:
    long, deep = "x" * 300, "/".join(["y" * 200] * 30)
    for name in (long, deep, "zero\0byte"):
        paths = ("run {}", "run --out {}", "run --json {}", "run --noise {}", "run --html {}.html", "run --config {}",
                 "study {}", "report {}.html", "simulate {}", "backends {}", "particles --figure {}.png", "calibrate {}",
                 "sweep {}",
                 "calibrate --out {}", "datasets --folder {}", "animate {}.gif", "consistency --figure {}.png", "import {}",
                 "show {}")  # fmt: skip
        for command in paths:
            result = invoke(*(word.format(name) for word in command.split()))
            assert result.exit_code == 2, (command, result.exception, result.output[:200])
            assert len(result.output.splitlines()) == 1 or "Usage" in result.output


def test_comments_of_toml_are_lines() -> None:
    assert to_toml({}, printable("a\nb = 1")) == "# a b = 1\n"
    with pytest.raises(OptionError, match="must be one of"):
        comparisons.run(kernel="a\nb")


@pytest.mark.parametrize("name", NAMES, ids=ascii)
def test_a_name_cannot_break_a_graph_file(log: Log, tmp_path: Path, name: str) -> None:
    """A g2o file holds no text but its tags, so the graph of a log with any name is the same file."""
    graphs = [
        relative_graph(Graph.from_log(each, edges="virtual+motion", kernel="none"))
        for each in (log, log.replace(name=name))
    ]
    for number, graph in enumerate(graphs):
        graph.save_g2o(tmp_path / f"{number}.g2o")
    text = (tmp_path / "1.g2o").read_text()
    assert text == (tmp_path / "0.g2o").read_text()
    # and names in the comments of a file are no lines of it
    safe = name.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
    comments = "".join(f"# {line}\n" for line in safe.split("\n"))
    (tmp_path / "2.g2o").write_text(comments + text, encoding="utf-8")
    read = [Graph.from_g2o(tmp_path / f"{number}.g2o") for number in (1, 2)]
    assert read[0].cost(read[0].initial) == read[1].cost(read[1].initial)
