"""A bundled notebook runs in Jupyter from its first cell to its last, and shows what it shows in the repository."""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOK = Path(__file__).parents[1] / "examples" / "first-picture.en.ipynb"


def kinds(notebook):
    """What each code cell shows: kinds of data, or the name of a stream."""
    return [
        {kind for output in cell.outputs for kind in (output.get("data") or [output.get("name", "?")])}
        for cell in notebook.cells
        if cell.cell_type == "code"
    ]


# pyzmq and jupyter warn about their own event loops; nothing of ours is behind it
@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore")
def test_notebook_runs(tmp_path):
    stored = nbformat.read(NOTEBOOK, as_version=4)
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(tmp_path)}}).execute()
    for before, after in zip(kinds(stored), kinds(notebook), strict=True):
        # the site draws SVG, Jupyter PNG
        assert ("image/svg+xml" in before or "image/png" in before) <= ("image/png" in after)
        assert ("stdout" in before) == ("stdout" in after)
        assert "stderr" not in after
