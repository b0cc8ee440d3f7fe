"""Notebooks of pages: text, code with its outputs, and no markup that only the site knows."""

import json
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
sys.path.insert(0, str(DOCS / "_site"))
notebooks = pytest.importorskip("notebooks", reason="needs the packages of the site: pip install -e '.[docs]'")
import bundled  # noqa: E402
import cells  # noqa: E402
from cells import Cell, split  # noqa: E402

PAGE = r"""# Title {#top}

See [the edges](edges.md#components) and [GTSAM](https://gtsam.org): $\V{x}^\T$.

{{ cell first }}

??? question "Exercise 1"

    Compute it.

    {{ output second "a line" }}

{{ code graphslam/textbook.py solve }}
"""


def made(tmp_path):
    (tmp_path / "second-0.svg").write_text("<svg/>")
    results = {
        "first": Cell("first", "print(1)", "1\n", []),
        "second": Cell("second", "slider('n', [1], draw)  # noqa: F821", "", [["n 1", "second-0.svg"]]),
    }
    return notebooks.notebook(PAGE, results, tmp_path, lambda arguments: f"```python\n# {arguments}\n```")


def test_cells_have_text_code_and_outputs(tmp_path):
    cells = made(tmp_path)["cells"]
    assert "google.colab" in cells.pop(0)["source"]
    assert [cell["cell_type"] for cell in cells] == ["code", "markdown", "code", "markdown", "code", "markdown"]
    assert cells[0]["source"].startswith("def slider")
    assert cells[1]["source"].startswith("# Title\n")
    assert "See the edges and [GTSAM](https://gtsam.org)" in cells[1]["source"]
    assert r"\V" not in cells[1]["source"]
    assert r"\T" not in cells[1]["source"]
    assert cells[2]["outputs"] == [{"output_type": "stream", "name": "stdout", "text": "1\n"}]
    assert cells[3]["source"] == "**Exercise 1**\n\nCompute it."
    assert cells[4]["source"] == "slider('n', [1], draw)"
    assert cells[4]["outputs"][0]["data"] == {"image/svg+xml": "<svg/>", "text/plain": "n 1"}
    assert "graphslam/textbook.py solve" in cells[5]["source"]


def test_cells_follow_those_that_they_need(tmp_path):
    results = {name: Cell(name, f"{name} = 1", "", []) for name in ("first", "second")}
    page = "{{ cell second }}\n\nText\n\n{{ cell first }}\n"
    cells = notebooks.notebook(page, results, tmp_path, str)["cells"]
    assert [cell["source"] for cell in cells[1:]] == ["first = 1", "second = 1", "Text"]


def test_the_format_is_valid(tmp_path):
    nbformat = pytest.importorskip("nbformat")
    place = tmp_path / "folder" / "page.ipynb"
    notebooks.write(place, made(tmp_path))
    nbformat.validate(nbformat.reads(json.dumps(json.loads(place.read_text())), as_version=4))


@pytest.mark.parametrize(
    ("file", "source", "language"), bundled.bundled(), ids=[file.stem for file, _, _ in bundled.bundled()]
)
def test_bundled_notebooks_are_those_of_the_pages(file, source, language):
    """If this fails: python docs/_site/bundled.py."""
    results = {name: Cell(name, code, "", []) for name, code in split(source.read_text()).items()}
    stored = json.loads(file.read_text())
    assert bundled.sources(stored) == bundled.sources(bundled.make(source, language, results, file.parent))
    assert any(cell.get("outputs") for cell in stored["cells"])


def test_tutorials_repeat_the_code_of_their_cells():
    """If this fails: python docs/_site/bundled.py."""
    pages = bundled.tutorials()
    assert len(pages) >= 10
    assert [page.name for page, text in pages if page.read_text() != text] == []


def test_there_are_no_other_notebooks():
    assert sorted(bundled.EXAMPLES.glob("*.ipynb")) == sorted(file for file, _, _ in bundled.bundled())


def test_pages_that_had_no_time_show_their_code(tmp_path, monkeypatch):
    page = tmp_path / "page.py"
    page.write_text("# %% one\nprint(1)\n")
    monkeypatch.setattr(cells, "DOCS", tmp_path)
    monkeypatch.setattr(cells, "CACHE", tmp_path / "cache")
    monkeypatch.setattr(cells, "SECONDS", 0.0)
    monkeypatch.setattr(cells, "HURRIED", True)
    cells.run_all()
    assert cells.results(page) == {"one": Cell("one", "print(1)", "", [])}
    monkeypatch.setattr(cells, "HURRIED", False)
    assert cells.results(page)["one"].output == "1\n"
    # a page that has run keeps its results
    monkeypatch.setattr(cells, "HURRIED", True)
    assert cells.results(page)["one"].output == "1\n"


def test_an_error_names_page_and_cell(tmp_path, monkeypatch):
    (tmp_path / "page.py").write_text("# %% fails\n1 / 0\n")
    monkeypatch.setattr(cells, "DOCS", tmp_path)
    monkeypatch.setattr(cells, "CACHE", tmp_path / "cache")
    monkeypatch.setattr(cells, "ROOT", tmp_path)
    with pytest.raises(cells.CellError, match=r"(?s)page.py: cell 'fails'.*ZeroDivisionError"):
        cells.run_all()
