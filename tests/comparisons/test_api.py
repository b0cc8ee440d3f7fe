"""The names of `comparisons`: found when used, and what they return looks like something in a notebook."""

import pytest

import comparisons
from graphslam import MotionModel, OptionError, load, sample_log_path, save, simulate


@pytest.fixture(scope="module")
def comparison():
    return comparisons.run(
        simulate(steps=20, seed=2), estimators=["dead-reckoning", "graph", "fastslam1"], particles=20
    )


def test_every_name_is_there_and_listed():
    for name in comparisons.__all__:
        assert getattr(comparisons, name).__doc__
        assert name in dir(comparisons)
    with pytest.raises(AttributeError, match="nothing_like_it"):
        _ = comparisons.nothing_like_it


def test_run_takes_a_log_a_file_or_nothing(comparison):
    assert [result.name for result in comparison.results] == ["dead-reckoning", "graph", "fastslam1"]
    of_file = comparisons.run(str(sample_log_path()), estimators=["graph"])
    assert of_file.source == sample_log_path()
    assert of_file["graph"].cost == comparisons.run(None, estimators=["graph"])["graph"].cost
    assert of_file["graph"].cost == comparisons.run(load(sample_log_path()), estimators=["graph"])["graph"].cost
    with pytest.raises(OptionError, match="did you mean 'particles'"):
        comparisons.run(None, estimators=["graph"], particle=3)


def test_the_table_is_a_sequence_of_rows_that_also_knows_names(comparison):
    table = comparison.table
    assert len(table) == 3
    assert table["graph"] is table[1]
    assert [row.name for row in table[1:]] == ["graph", "fastslam1"]
    assert table["graph"].ate_m == comparison.metrics["graph"].ate_m
    with pytest.raises(KeyError):
        table["nobody"]


@pytest.mark.slow
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
    named = comparisons.run(simulate(steps=20, seed=2).replace(name="<b>&"), estimators=["graph"])
    assert "&lt;b&gt;&amp;" in named._repr_html_()


@pytest.mark.slow
def test_other_verbs_show_themselves_too(tmp_path):
    log = simulate(steps=15, seed=1, orientation=False)
    particles = comparisons.study_particles(log, filters=("fastslam1",), particles=(10,), seeds=2, jobs=0)
    for outcome in (
        comparisons.compare_solvers(log, edges=("landmark+motion",), motion_weights=(1.0,), jobs=0),
        particles,
        comparisons.study_consistency(logs=2, steps=10, jobs=0),
        comparisons.survey(tmp_path),
    ):
        assert "<table>" in outcome._repr_html_()
        assert str(outcome)
    assert particles.figure().axes


def test_the_page_of_a_comparison_says_what_it_was_told(tmp_path):
    comparison = comparisons.run(
        simulate(steps=15, seed=1), estimators=["graph"], motion=MotionModel(nn=0.5), kernel="huber", particles=77
    )
    comparisons.write_report(comparison, str(tmp_path / "page.html"))
    page = (tmp_path / "page.html").read_text()
    for line in ("nn = 0.5", "kernel = &quot;huber&quot;", "particles = 77"):
        assert line in page


def test_a_page_of_a_log_runs_it(tmp_path):
    log = simulate(steps=10, seed=1)
    comparisons.write_report(log, tmp_path / "page.html", estimators=["graph"], kernel="huber")
    assert "kernel = &quot;huber&quot;" in (tmp_path / "page.html").read_text()
    with pytest.raises(OptionError, match="takes no options"):
        comparisons.write_report(comparisons.run(log, estimators=["graph"]), tmp_path / "page.html", kernel="huber")


@pytest.mark.parametrize(
    "call", [comparisons.run, comparisons.calibrate, comparisons.compare_solvers, comparisons.animate]
)
def test_something_else_in_place_of_a_log(call):
    with pytest.raises(OptionError, match="path of its file or folder, not int: 3"):
        call(3)


def test_paths_may_be_text(tmp_path):
    save(simulate(steps=10, seed=1), tmp_path / "log.npz")
    assert len(comparisons.animate(str(tmp_path / "log.npz"), estimator="mcl", particles=10)) == 11
    (tmp_path / "study.toml").write_text('seeds = 1\nestimators = ["graph"]\n[simulate]\nsteps = 10\n')
    assert len(comparisons.read_study(str(tmp_path / "study.toml")).runs) == 1


def test_options_of_a_wrong_type_are_told():
    for options, message in (
        ({"particles": "10"}, "particles"),
        ({"seed": 1.5}, "seed"),
        ({"particles": 0}, "at least 1"),
    ):
        with pytest.raises(OptionError, match=message):
            comparisons.run(None, estimators=["mcl"], **options)
    assert [row.name for row in comparisons.run(None, estimators="graph").table] == ["graph"]
