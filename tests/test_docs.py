"""The Python examples of the documentation run."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from unittest import mock

import pytest

from comparisons.estimators import ESTIMATORS
from graphslam.io.formats import FORMATS

DOCS = Path(__file__).parents[1] / "docs"
# a translated page has the examples of the English one: each is run once
BLOCKS = [
    (page.name, number, block)
    for page in sorted(
        [*DOCS.glob("*.md"), *DOCS.glob("beyond/*.md")], key=lambda page: (page.name.endswith(".ja.md"), page)
    )
    for number, block in enumerate(re.findall(r"(?<! -->\n)```python\n(.*?)```", page.read_text(), re.DOTALL))
]
BLOCKS = list({block: (page, number, block) for page, number, block in reversed(BLOCKS)}.values())[::-1]


#: examples that take more than five seconds
LONG = (("studies.md", 0), ("smoothing.md", 1))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("page", "number", "block"),
    [pytest.param(*block, marks=[pytest.mark.nightly] * (block[:2] in LONG)) for block in BLOCKS],
    ids=[f"{page}-{number}" for page, number, _ in BLOCKS],
)
def test_examples(page, number, block, capsys, tmp_path, monkeypatch):
    # examples read files of these folders, and what they write must not remain
    for folder in ("docs", "examples"):
        shutil.copytree(DOCS.parent / folder, tmp_path / folder)
    monkeypatch.chdir(tmp_path)
    # what examples register, other tests must not see
    with mock.patch.dict(ESTIMATORS), mock.patch.dict(FORMATS):
        exec(compile(block, f"{page}, example {number}", "exec"), {})
    assert capsys.readouterr().out


def test_there_are_examples():
    pages = [page for page, _, _ in BLOCKS]
    assert (pages.count("factors.md"), pages.count("extending.md")) == (8, 2)


def blocks_of(section):
    """{file: [(lines that are there, lines added after them)]} of the diff of a section of docs/extending.md."""
    found = []
    for page in ("extending.md", "extending.ja.md"):
        text = (DOCS / page).read_text(encoding="utf-8")
        block = re.search(rf"{{#{section}}}.*?```diff\n(.*?)```", text, re.DOTALL)
        changes = {}
        for file, lines in re.findall(r"^--- (\S+)\n((?:[ +].*\n)+)", block[1], re.MULTILINE):
            hunks = re.findall(r"((?: .*\n)+)((?:\+.*\n)+)", lines)
            changes[file] = [tuple(re.sub("^[ +]", "", part, flags=re.MULTILINE) for part in hunk) for hunk in hunks]
        found.append(changes)
    english, japanese = found
    assert english == japanese
    return english


@pytest.fixture
def extended(tmp_path):
    """Apply the diff of a section to a copy of the project, and run Python there; the files that it changes."""

    def apply(section, *programs):
        for package in ("graphslam", "fastslam", "comparisons"):
            shutil.copytree(DOCS.parent / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
        (tmp_path / "docs").mkdir()
        shutil.copy(DOCS / "make_json.py", tmp_path / "docs")
        changes = blocks_of(section)
        for file, hunks in changes.items():
            text = (tmp_path / file).read_text(encoding="utf-8")
            for there, added in hunks:
                assert text.count(there) == 1, f"{file} has not once {there!r}"
                text = text.replace(there, there + added)
            (tmp_path / file).write_text(text, encoding="utf-8")
        environment = os.environ | {"PYTHONPATH": str(tmp_path), "PYTHONIOENCODING": "utf-8", "COLUMNS": "200"}
        for program in programs:
            command = [sys.executable, *program]
            run = subprocess.run(
                command, cwd=tmp_path, env=environment, capture_output=True, text=True, encoding="utf-8"
            )
            assert run.returncode == 0, run.stderr
            print(run.stdout)
        return list(changes)

    return apply


OPTION = """
from comparisons.options import LogOptions
from comparisons.options.reading import prepare

near, far = (prepare(None, LogOptions(min_range=least))[0].sightings[:, 0] for least in (None, 2.0))
assert near.min() < 2 <= far.min() and len(far) == (near >= 2).sum(), (near, far)
"""


@pytest.mark.slow
def test_the_option_of_the_page_works(extended, capsys):
    """Two files and one translation: the smallest range of the log, the command line, and its help in Japanese."""
    help_of = ("-m", "comparisons", "show", "--help", "--lang")
    files = extended("option", ("-c", OPTION), (*help_of, "en"), (*help_of, "ja"))
    assert len(files) == 3 and files[-1].endswith("japanese/help.toml")
    shown = capsys.readouterr().out
    assert shown.count("--min-range") == 2 and shown.count("Leave out sightings at a shorter range") == 1
    assert "これより近くからのセンサ値を除きます" in shown


METRIC = """
import json
import numpy as np
import comparisons
from graphslam.metrics import position_errors

comparison = comparisons.run(estimators=["dead-reckoning"])
(row,) = comparison.table
errors = position_errors(comparison.log.true_poses, comparison["dead-reckoning"].poses)
assert row.median_m == np.median(errors) > 0, row
assert "median_m" in json.dumps(json.load(open("docs/schema.json")))
"""


@pytest.mark.slow
def test_the_metric_of_the_page_works(extended):
    """One file: the rows of runs have the median, and the schema that is written anew names it."""
    assert extended("metric", ("docs/make_json.py",), ("-c", METRIC)) == ["graphslam/metrics.py"]


@pytest.mark.slow
def test_the_verb_of_the_page_works(extended, tmp_path):
    extended("metric")  # a copy of the project
    english, japanese = (
        re.search(r"{#verb}.*?```py\n(.*?)```", (DOCS / page).read_text(encoding="utf-8"), re.DOTALL)[1]
        for page in ("extending.md", "extending.ja.md")
    )
    assert english == japanese
    verbs, listed = (tmp_path / "comparisons/cli" / name for name in ("logs.py", "__init__.py"))
    verbs.write_text(f"{verbs.read_text(encoding='utf-8')}\n\n{english}", encoding="utf-8")
    text = listed.read_text(encoding="utf-8")
    changes = {"import_, show,": "import_, landmarks, show,", "VERBS = (": "VERBS = (landmarks,"}
    for there, instead in changes.items():
        text = text.replace(there, instead, 1)
    listed.write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", "comparisons", "landmarks", "--json", "-", "-q", "--max-range", "3"]
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    run = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert json.loads(run.stdout)["landmarks"]["6"] == 20, run.stderr


PAGES = [*sorted(DOCS.parent.glob("*.md")), *sorted(DOCS.rglob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS.parent)))
def test_named_files_exist(page):
    """Every path of this repository that a page names in backquotes exists."""
    named = re.findall(
        r"`((?:graphslam|fastslam|comparisons|docs|tests|benchmarks|examples)/[\w./-]*)`", page.read_text()
    )
    missing = [name for name in named if not (DOCS.parent / name).exists()]
    assert not missing
