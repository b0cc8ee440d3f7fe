"""The names of `comparisons`: found when used, and what they return looks like something in a notebook."""

import subprocess
import sys

import pytest

import comparisons
from graphslam import OptionError, load, sample_log_path, simulate


@pytest.fixture(scope="module")
def comparison():
    return comparisons.run(simulate(steps=20, seed=2), ["dead-reckoning", "graph", "fastslam1"], particles=20)


def test_every_name_is_there_and_listed():
    for name in comparisons.__all__:
        assert getattr(comparisons, name).__doc__
        assert name in dir(comparisons)
    with pytest.raises(AttributeError, match="nothing_like_it"):
        _ = comparisons.nothing_like_it


def test_nothing_heavy_is_imported_until_it_is_used():
    code = "import comparisons, sys; print([m for m in ('numpy', 'numba', 'gtsam', 'matplotlib') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_run_takes_a_log_a_file_or_nothing(comparison):
    assert [result.name for result in comparison.results] == ["dead-reckoning", "graph", "fastslam1"]
    of_file = comparisons.run(str(sample_log_path()), ["graph"])
    assert of_file.source == sample_log_path()
    assert of_file["graph"].cost == comparisons.run(None, ["graph"])["graph"].cost
    assert of_file["graph"].cost == comparisons.run(load(sample_log_path()), ["graph"])["graph"].cost
    with pytest.raises(OptionError, match="did you mean 'particles'"):
        comparisons.run(None, ["graph"], particle=3)


def test_the_table_is_a_sequence_of_rows_that_also_knows_names(comparison):
    table = comparison.table
    assert len(table) == 3
    assert table["graph"] is table[1]
    assert [row.name for row in table[1:]] == ["graph", "fastslam1"]
    assert table["graph"].ate_m == comparison.metrics["graph"].ate_m
    with pytest.raises(KeyError):
        table["nobody"]


def test_outcomes_show_themselves(comparison):
    text = str(comparison)
    assert "ATE" in text
    assert "fastslam1" in text
    page = comparison._repr_html_()
    assert page.startswith("<table>")
    assert page.count("<tr>") == 4
    assert "data:image/png;base64," in page
    assert "converged" in page  # its heading is broken into two lines on a terminal only
    assert "data:image" not in comparison.table._repr_html_()
    named = comparisons.run(simulate(steps=20, seed=2).replace(name="<b>&"), ["graph"])
    assert "&lt;b&gt;&amp;" in named._repr_html_()


def test_other_verbs_show_themselves_too(tmp_path):
    log = simulate(steps=15, seed=1)
    for outcome in (
        comparisons.compare_solvers(log, edges=("virtual+motion",), motion_weights=(1.0,)),
        comparisons.study_particles(log, filters=("fastslam1",), particles=(10,), seeds=2),
        comparisons.study_consistency(logs=2, steps=10),
        comparisons.survey(tmp_path),
    ):
        assert "<table>" in outcome._repr_html_()
        assert str(outcome)
    figure = comparisons.study_particles(log, filters=("fastslam1",), particles=(10,), seeds=2).figure()
    assert figure.axes
