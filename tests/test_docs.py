"""The Python examples of the documentation run."""

import re
import shutil
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
    assert (pages.count("factors.md"), pages.count("extending.md")) == (7, 2)


PAGES = [*sorted(DOCS.parent.glob("*.md")), *sorted(DOCS.rglob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS.parent)))
def test_named_files_exist(page):
    """Every path of this repository that a page names in backquotes exists."""
    named = re.findall(
        r"`((?:graphslam|fastslam|comparisons|docs|tests|benchmarks|examples)/[\w./-]*)`", page.read_text()
    )
    missing = [name for name in named if not (DOCS.parent / name).exists()]
    assert not missing
