"""The Python example of the README runs, and both languages say the same."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
READMES = ("README.md", "README.ja.md")


def blocks(name):
    """The Python examples of a README."""
    return re.findall(r"```python\n(.*?)```", (ROOT / name).read_text(), re.DOTALL)


def test_example(capsys):
    (example,) = blocks("README.md")
    exec(compile(example, "README example", "exec"), {})
    reason, covariance, difference = re.fullmatch(
        r"(.*)\n(\[\[.*\]\])\n(.*)\n", capsys.readouterr().out, re.DOTALL
    ).groups()
    assert reason.endswith("global")
    assert covariance.count("]") == 4
    assert float(difference) < 1e-6


def test_both_languages_have_the_same_example():
    english, japanese = ([re.sub(r"  #.*", "", block) for block in blocks(name)] for name in READMES)
    assert english == japanese
    headings = [len(re.findall(r"^## ", (ROOT / name).read_text(), re.MULTILINE)) for name in READMES]
    assert headings[0] == headings[1]


@pytest.mark.parametrize("name", READMES)
def test_links_lead_to_files(name):
    links = re.findall(r"\]\((?!https?:)([^)#]+)", (ROOT / name).read_text())
    assert links
    assert [link for link in links if not (ROOT / link).exists()] == []


def test_the_film_is_small():
    assert (ROOT / "docs" / "img" / "film-graph.gif").stat().st_size < 2_000_000
