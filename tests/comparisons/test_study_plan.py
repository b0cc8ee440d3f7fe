from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import comparisons
from comparisons.options import MODELS, RunOptions
from comparisons.options.declaration import options_of
from comparisons.studies.plan import Run, read_study, simulated_log
from graphslam import FormatError, MotionModel, save, simulate

ROOT = Path(__file__).parents[2]
WHOLE = """\
database = "rows.sqlite"
time_limit = 9
seeds = [3, 5]
estimators = ["graph", "fastslam1", "dead-reckoning"]
logs = ["*.npz"]
[[simulate]]
name = "small"
steps = 10
[simulate.vary]
max_range = [3, 5.0]
[[simulate]]
world = "garden"
clean = true
motion = {nn = 0.1}
[options]
motion_weight = 2
[options.vary]
particles = [10, 20]
sensor.range_rate = [0.1, 0.2]
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("a", "b"):
        save(simulate(seed=len(name), steps=5, name=name), tmp_path / f"{name}.npz")
    return tmp_path


def study_of(folder: Path, text: str) -> tuple[Run, ...]:
    (folder / "study.toml").write_text(text)
    return read_study(folder / "study.toml").runs


def test_every_combination_is_one_run(folder: Path) -> None:
    runs = study_of(folder, WHOLE)
    study = read_study(folder / "study.toml")
    assert (study.database, study.time_limit) == (folder / "rows.sqlite", 9.0)
    assert list(dict.fromkeys(run.log for run in runs)) == [
        "a.npz", "b.npz", "small max_range=3.0", "small max_range=5.0", "garden",
    ]  # fmt: skip
    # graph and dead reckoning use no particles, so only the two range rates make a difference to them
    assert list(dict.fromkeys(run.method for run in runs)) == [
        "graph range_rate=0.1", "graph range_rate=0.2",
        "fastslam1 particles=10 range_rate=0.1", "fastslam1 particles=10 range_rate=0.2",
        "fastslam1 particles=20 range_rate=0.1", "fastslam1 particles=20 range_rate=0.2",
        "dead-reckoning range_rate=0.1", "dead-reckoning range_rate=0.2",
    ]  # fmt: skip
    assert len(runs) == 5 * 2 * 8
    assert len({run.key for run in runs}) == len(runs)
    assert {run.seed for run in runs} == {3, 5}
    first = runs[0]
    assert first.options == {"motion_weight": 2.0, "range_rate": 0.1}


def test_runs_of_one_log_and_seed_stand_together(folder: Path) -> None:
    cells = [(run.log, run.seed) for run in study_of(folder, WHOLE)]
    changes = sum(a != b for a, b in zip(cells, cells[1:], strict=False))
    assert changes == len(set(cells)) - 1


def test_the_key_follows_the_content_not_the_place(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    text = "logs = ['a.npz']\nestimators = ['graph']\n"
    (run,) = study_of(folder, text)
    elsewhere = tmp_path_factory.mktemp("moved")
    (folder / "a.npz").replace(elsewhere / "a.npz")
    (moved,) = study_of(elsewhere, text)
    assert moved.key == run.key
    save(simulate(seed=99, steps=5), elsewhere / "a.npz")
    (changed,) = study_of(elsewhere, text)
    assert changed.key != run.key


def test_a_log_that_is_not_there_is_planned_all_the_same(folder: Path) -> None:
    runs = study_of(folder, "logs = ['a.npz', 'gone.npz']\nestimators = ['graph']\n")
    assert [run.log for run in runs] == ["a.npz", "gone.npz"]
    assert runs[1].source["sha256"] is None


def test_simulated_logs_are_those_of_the_simulator() -> None:
    log = simulated_log({"clean": True, "steps": 8, "nn": 0.3}, seed=4)
    same = simulate(clean=True, steps=8, motion=MotionModel(nn=0.3), seed=4)
    np.testing.assert_array_equal(log.sightings, same.sightings)
    np.testing.assert_array_equal(log.true_poses, same.true_poses)
    faulty = simulated_log({"steps": 30, "oversight": 1.0}, seed=4)
    assert len(faulty.steps) == 0


def test_a_study_knows_every_option_of_a_run(folder: Path) -> None:
    values: dict[type, object] = {str: None, int: 2, float: 0.5, bool: True}
    estimators = ["graph", "fastslam1", "particle-gibbs", "online"]
    for name, each in options_of(RunOptions).items():
        if (
            name in ("seed", "noise", "sensor_offset", "truth_offset", "threads", "estimate", "map", "map_use", "bound")
            or each.only == "python"
        ):
            continue
        named = {"format": "npz", "smoothing": 20}
        value = each.choices[-1] if each.choices else named.get(name, values[each.each])
        line = f"{each.model}.{each.field}" if each.model in MODELS else name
        for table in ("options", "options.vary"):
            written = "true" if value is True else repr(value)
            shown = f"[{written}]" if table.endswith("vary") else written
            text = f"logs = ['a.npz']\nestimators = {estimators}\n[{table}]\n{line} = {shown}\n"
            assert {run.options.get(name) for run in study_of(folder, text)} - {None} == {value}, name


def test_studies_do_not_localise_in_maps(folder: Path) -> None:
    with pytest.raises(FormatError, match="studies do not localise in maps"):
        study_of(folder, "logs = ['a.npz']\nestimators = ['graph']\n[options]\nmap = 'map.csv'\n")


def test_a_noise_file_counts_by_its_content(folder: Path) -> None:
    text = "logs = ['a.npz']\nestimators = ['graph']\n[options]\nnoise = 'noise.toml'\n"
    (folder / "noise.toml").write_text("[sensor]\nbearing_std = 0.1\n[ranges]\nscale = 1.1\n")
    (run,) = study_of(folder, text)
    assert run.options == {"noise": {"bearing_std": 0.1, "range_scale": 1.1}}
    (folder / "other.toml").write_text("[ranges]\nscale = 1.1\n[sensor]\nbearing_std = 0.1\n")
    (same,) = study_of(folder, text.replace("noise.toml", "other.toml"))
    assert same.key == run.key
    (folder / "noise.toml").write_text("[sensor]\nbearing_std = 0.2\n")
    (changed,) = study_of(folder, text)
    assert changed.key != run.key


def test_noise_auto_is_executed(folder: Path) -> None:
    text = 'estimators = ["graph"]\n[simulate]\nsteps = 40\nclean = true\n[options]\nnoise = "auto"\n'
    (folder / "auto.toml").write_text(text)
    outcome = comparisons.sweep(folder / "auto.toml", jobs=0)
    assert (outcome.ran, outcome.failed) == (1, 0)


def test_options_of_files_do_not_count_for_simulated_worlds(folder: Path) -> None:
    runs = study_of(
        folder, "logs = ['a.npz']\nestimators = ['graph']\n[options]\nformat = 'npz'\nstride = 2\n[simulate]\n"
    )
    assert [run.options for run in runs] == [{"format": "npz", "stride": 2}, {"stride": 2}]


def test_the_example_is_a_study() -> None:
    study = read_study(ROOT / "examples" / "study.toml")
    assert len(study.runs) == 2 * 10 * 6


def test_the_study_file_of_the_documentation_is_one(folder: Path) -> None:
    text = (ROOT / "docs" / "studies.md").read_text(encoding="utf-8").split("```toml\n")[1].split("```")[0]
    for name in ("mine/a.npz", "other/log.txt"):
        (folder / name).parent.mkdir()
        (folder / name).touch()
    runs = study_of(folder, text)
    # two files and two worlds, 20 seeds; 4 combinations for the graph, 2 for the filter, which has no weight of pairs
    assert len(runs) == 4 * 20 * (4 + 2)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("seeds = 3\nseed = 4\n[simulate]\n", [":2:", "'seed'", "'seeds'"]),
        ("[simulate]\nmax_rnage = 3\n", [":2:", "max_rnage", "'max_range'"]),
        ("[simulate]\n[simulate.vary]\nstep = [3]\n", [":3:", "'steps'"]),
        ("[simulate]\n[options]\nparticle = 3\n", [":3:", "'particles'"]),
        ("[simulate]\n[options]\nseed = 3\n", ["seeds"]),
        ("[simulate]\n[options.vary]\nparticles = 3\n", [":3:", "list of values"]),
        ("[simulate]\n[options.vary]\nparticles = [3, 0]\n", [":3:", "at least 1"]),
        ("[simulate]\n[options.vary]\nparticles = [3, 'x']\n", [":3:", "whole number"]),
        ("[simulate]\nworld = 'bok'\n", [":2:", "'book'"]),
        ("[simulate]\nspeed = -1\n", [":2:", "speed"]),
        ("[simulate]\nstart = [1, 2]\n", [":2:", "start"]),
        ("[simulate]\nway_points = [[1, 2], [3]]\n", ["way_points", "points of finite numbers"]),
        ("[simulate]\nphantom = 2\n", [":2:", "phantom"]),
        ("seeds = 0\n[simulate]\n", [":1:", "seeds"]),
        ("seeds = [1, -1]\n[simulate]\n", [":1:", "seeds"]),
        ("time_limit = 0\n[simulate]\n", [":1:", "time_limit"]),
        ("estimators = ['graf']\n[simulate]\n", [":1:", "'graph'"]),
        ("estimators = []\n[simulate]\n", [":1:", "estimators must be names, at least one"]),
        ("logs = ['*.txt']\n", [":1:", "no file matches"]),
        ("logs = ['a.npz']\n[options]\ndimensions = 4\n", [":3:", "at most 3"]),
        ("logs = ['a.npz']\n[options.vary]\nstride = [1, 0]\n", [":3:", "at least 1"]),
        ("logs = ['a.npz']\n[options.sensor]\nrange_sdt = 0.1\n", [":3:", "'range_std'"]),
        ("logs = ['a.npz']\n[options]\nnoise = 'gone.toml'\n", ["gone.toml", "no such file"]),
        ("seeds = 3\n", ["logs", "[simulate]"]),
        ("simulate = 3\n", [":1:", "table"]),
    ],
)
def test_an_error_in_a_study_file_is_one_sentence(folder: Path, text: str, words: list[str]) -> None:
    with pytest.raises(FormatError) as caught:
        study_of(folder, text)
    message = str(caught.value)
    assert message.startswith(str(folder / ("gone.toml" if "gone" in text else "study.toml")))
    assert "\n" not in message
    for word in words:
        assert word in message
