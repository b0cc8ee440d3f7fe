"""The measured results of pages: each marker finds its value, and a wrong one says what there is."""

import argparse
import json
import re
import sys
from collections import Counter
from datetime import date
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
sys.path.insert(0, str(DOCS / "_site"))

measured = import_module("measured")

MARKER = re.compile(r"\{\{ ((?:measured|when|table) .+?) \}\}")
PAGES = [page for page in sorted(DOCS.rglob("*.md")) if page.parent.name != "_site" and MARKER.search(page.read_text())]
FILES = sorted(measured.FOLDER.glob("*.json"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))
def test_the_markers_of_a_page_find_their_values(page):
    text = page.read_text()
    made = measured.filled(text, page.name, "ja" if page.name.endswith(".ja.md") else "en")
    assert not MARKER.search(made)
    assert "<!-- " not in re.sub(r"<!-- (?:cell|output|figure|end)", "", text)
    if page.name.endswith(".ja.md"):
        english = page.with_name(page.name.replace(".ja.md", ".md")).read_text()
        assert Counter(MARKER.findall(text)) == Counter(MARKER.findall(english))


def test_each_file_and_each_column_is_on_a_page():
    markers = [found for page in PAGES for found in MARKER.findall(page.read_text())]
    named = {word for marker in markers for word in marker.split()[1:]}
    assert {file.stem for file in FILES} <= named
    assert set(measured.COLUMNS) <= named


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_the_command_of_a_file_exists_with_its_options(file):
    run = json.loads(file.read_text())
    assert len({row["name"] for row in run["rows"]}) == len(run["rows"])
    for row in (run, *(run | row for row in run["rows"])):
        date.fromisoformat(row["date"])
        assert row["machine"]
        program, script, *words = row["command"].split()
        assert program == "python"
        source = (ROOT / script).read_text()
        assert "add_option(parser)" in source
        assert all(f'"{word}"' in source for word in words if word.startswith("--"))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with a file of three rows."""
    rows = [
        {"name": "A ours", "graph": "A", "backend": "ours", "seconds": 0.0021, "chi2": 2.5, "converged": True},
        {"name": "A theirs", "graph": "A", "backend": "theirs", "seconds": 0.0164, "chi2": None, "converged": False},
        {"name": "B ours", "graph": "B", "backend": "ours", "seconds": 12.3, "chi2": 1e6, "converged": True},
    ]  # fmt: skip
    rows[2]["date"] = "2026-09-30"
    run = {"command": "python benchmarks/backends.py", "date": "2026-11-02", "machine": "two cores", "rows": rows}
    (tmp_path / "peers.json").write_text(json.dumps(run))
    monkeypatch.setattr(measured, "FOLDER", tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("marker", "text"),
    [
        ('{{ measured peers "A ours" seconds .4f }} s', "0.0021 s"),
        ('{{ measured peers "A ours" seconds time }}', "2.1 ms"),
        ('{{ measured peers "B ours" seconds time }}', "12 s"),
        ('{{ measured peers "B ours" chi2 2r }}', "1,000,000"),
        ('{{ measured peers "A theirs" chi2 }}', "–"),
        ('takes {{ measured peers "A ours" seconds 1/.1f "A theirs" }} of', "takes 1/7.8 of"),
        ('takes {{ measured peers "A theirs" seconds 1r "A ours" }} times', "takes 8 times"),
        ("{{ when peers }}", "30 September to 2 November 2026 (two cores)"),
        (
            "  {{ table peers graph=B|A backend=ours graph time converged }}",
            "  | graph | time | converged |\n  | --- | --- | --- |\n  | B | 12 s | yes |\n  | A | 2.1 ms | yes |",
        ),
    ],
)
def test_values_are_shown(folder, marker, text):
    assert measured.filled(marker, "page.md") == text


def test_japanese_tables_have_japanese_heads(folder):
    made = measured.filled('{{ table peers name="A ours" converged seconds }}', "page.ja.md", "ja")
    assert made.splitlines()[0] == "| 収束 | 時間 [s] |"
    assert measured.filled("{{ when peers }}", "page.ja.md", "ja").startswith("2026年9月30日から11月2日")
    assert measured.filled('{{ measured peers "A ours" converged }}', "page.ja.md", "ja") == "はい"


@pytest.mark.parametrize(
    ("first", "last", "english", "japanese"),
    [
        ("2026-11-29", "2026-11-29", "29 November 2026", "2026年11月29日"),
        ("2026-11-28", "2026-11-29", "28 to 29 November 2026", "2026年11月28日から11月29日"),
        ("2026-11-29", "2027-11-29", "29 November 2026 to 29 November 2027", "2026年11月29日から2027年11月29日"),
        ("2026-12-30", "2027-01-02", "30 December 2026 to 2 January 2027", "2026年12月30日から2027年1月2日"),
    ],
)
def test_days_of_measurements(tmp_path, monkeypatch, first, last, english, japanese):
    monkeypatch.setattr(measured, "FOLDER", tmp_path)
    run = {"date": first, "machine": "two cores", "rows": [{"name": "A"}, {"name": "B", "date": last}]}
    (tmp_path / "days.json").write_text(json.dumps(run))
    assert measured.filled("{{ when days }}", "page.md") == f"{english} (two cores)"
    assert measured.filled("{{ when days }}", "page.ja.md", "ja") == f"{japanese} (two cores)"


@pytest.mark.parametrize(
    ("marker", "message"),
    [
        ("{{ measured pears A seconds }}", "no file 'pears'; there are 'peers'"),
        ("{{ measured peers A seconds }}", "peers.json has no row 'A'; there are 'A ours', 'A theirs', 'B ours'"),
        ('{{ measured peers "A ours" time_s }}', "the row 'A ours' has no field 'time_s'; there are 'command', 'date'"),
        ('{{ measured peers "A ours" seconds .2f A }}', "peers.json has no row 'A'; there are"),
        ("{{ measured peers }}", "missing 2 required positional arguments"),
        ("{{ when pears }}", "no file 'pears'; there are 'peers'"),
        ("{{ table peers graph=C seconds }}", "no row has graph 'C'; there are 'A', 'B'"),
        ("{{ table peers secondes }}", "columns.toml has no column 'secondes'; there are"),
        ("{{ table peers nees }}", "the row 'A ours' has no field 'nees'; there are"),
        ('{{ measured peers "A ours seconds }}', "No closing quotation"),
        ('{{ measured peers "A ours" converged .1f "A theirs" }}', "division by zero"),
    ],
)
def test_a_wrong_marker_is_an_error_of_the_page(folder, marker, message):
    with pytest.raises(measured.MeasuredError, match=re.escape(message)) as caught:
        measured.filled(marker, "results.md")
    assert str(caught.value).startswith(f"results.md: {marker}: ")


def test_rows_of_another_run_stay_with_their_date(folder, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import recording

    monkeypatch.setattr(sys, "argv", ["benchmarks/backends.py", "--repeat", "1", "--record", str(folder)])
    recording.record(folder, "peers", [{"name": "A ours", "seconds": float("nan")}, {"name": "C ours", "seconds": 2.0}])
    run = json.loads((folder / "peers.json").read_text())
    assert run["command"] == "python benchmarks/backends.py --repeat 1"
    assert run["date"] == date.today().isoformat()
    assert run["rows"][0] == {"name": "A ours", "seconds": None}
    kept = run["rows"][1]
    assert (kept["date"], kept["machine"], kept["seconds"]) == ("2026-11-02", "two cores", 0.0164)
    assert [row["name"] for row in run["rows"]] == ["A ours", "A theirs", "B ours", "C ours"]
    # a second run changes nothing
    text = (folder / "peers.json").read_text()
    recording.record(folder, "peers", [{"name": "C ours", "seconds": 2.0}])
    assert (folder / "peers.json").read_text() == text
    recording.record(None, "peers", [])


def test_what_records_is_checked_before_the_run(tmp_path, monkeypatch, capsys):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import recording

    parser = argparse.ArgumentParser()
    recording.add_option(parser)
    for words, message in (
        (["--record", str(tmp_path / "none")], "there is no folder"),
        (["--rec", str(tmp_path)], "unrecognized arguments"),
    ):
        with pytest.raises(SystemExit):
            parser.parse_args(words)
        assert message in capsys.readouterr().err
    (spaced := tmp_path / "a folder").mkdir()
    for words in (["--record", str(spaced)], [f"--record={spaced}"]):
        assert parser.parse_args(words).record == spaced
        monkeypatch.setattr(sys, "argv", ["benchmarks/online.py", "--first", *words, "second half"])
        assert recording.command() == "python benchmarks/online.py --first 'second half'"
    # as on other systems than Linux
    monkeypatch.setattr(recording.Path, "exists", lambda _: False)
    assert "cores; Python" in recording.machine()
