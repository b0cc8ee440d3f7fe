"""The Python examples of the documentation run."""

import re
import shutil
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"
BLOCKS = [
    (page.name, number, block)
    for page in sorted(DOCS.glob("*.md"))
    for number, block in enumerate(re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL))
]


@pytest.mark.parametrize(("page", "number", "block"), BLOCKS, ids=[f"{page}-{number}" for page, number, _ in BLOCKS])
def test_examples(page, number, block, capsys, tmp_path, monkeypatch):
    # what examples read is beside them, what they write is nobody else's
    for folder in ("docs", "examples"):
        shutil.copytree(DOCS.parent / folder, tmp_path / folder)
    monkeypatch.chdir(tmp_path)
    exec(compile(block, f"{page}, example {number}", "exec"), {})
    assert capsys.readouterr().out


def test_there_are_examples():
    assert sum(page == "factors.md" for page, _, _ in BLOCKS) == 6
