"""Configuration files of ``run``: what beats what, and that a saved one repeats its run bit for bit."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import Result

from comparisons import run
from comparisons.estimators.config import config_text, read_config
from comparisons.options import RunOptions
from graphslam import FormatError, MotionModel, SensorModel, save, simulate

Invoke = Callable[..., Result]


def without_times(path: Path) -> dict[str, Any]:
    """The JSON of a run but its times, among them the folder, which is named by the time."""
    payload = json.loads(path.read_text())
    del payload["files"]
    for entry in payload["estimators"]:
        assert entry.pop("seconds") >= 0
        if entry["certificate"] is not None:
            del entry["certificate"]["seconds"]
    return payload


def test_a_configuration_survives_being_written(tmp_path: Path) -> None:
    options = RunOptions.of(
        edges="virtual", frame="world", weight="tempered", motion_weight=0.1 + 0.2, particles=7, seed=3, dimensions=2,
        motion=MotionModel(nn=0.3, epsilon=1e-5), sensor=SensorModel(range_rate=1 / 3),
    )  # fmt: skip
    save(simulate(seed=1, steps=3), tmp_path / "x.npz")
    (tmp_path / "c.toml").write_text(config_text(tmp_path / "x.npz", ("graph",), options, copies={}))
    values = read_config(tmp_path / "c.toml")
    assert values.pop("log") == tmp_path / "x.npz"
    assert len(values.pop("log_sha256")) == 64
    assert values.pop("estimators") == ["graph"]
    assert "format" not in values
    read = RunOptions.of(**values)
    assert (read.edges, read.frame, read.weight, read.motion_weight) == ("virtual", "world", "tempered", 0.1 + 0.2)
    assert (read.filter.particles, read.filter.seed, read.dimensions) == (7, 3, 2)
    assert read.models() == (options.motion, options.sensor)


def test_a_relative_log_starts_from_the_folder_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_text('log = "data/x.npz"')
    assert read_config(tmp_path / "c.toml")["log"] == tmp_path / "data" / "x.npz"


@pytest.mark.slow
def test_a_saved_configuration_repeats_its_run(invoke: Invoke, log_file: Path, tmp_path: Path) -> None:
    options = ["--particles", 60, "--seed", 5, "--nn", 0.21, "--weight", "tempered", "--initialize", "given"]
    first = invoke("run", "log.npz", *options)
    assert first.exit_code == 0, first.output
    (folder,) = (p for p in (tmp_path / "results").iterdir() if not p.is_symlink())
    assert f"slam-compare run --config {Path('results') / folder.name / 'config.toml'}" in first.stdout
    assert invoke("run", "--config", folder / "config.toml", "--out", "again").exit_code == 0
    assert without_times(folder / "comparison.json") == without_times(Path("again/comparison.json"))
    assert (folder / "config.toml").read_text() == Path("again/config.toml").read_text()


@pytest.mark.slow
def test_noise_file_and_map_may_change_after_the_run(invoke: Invoke, log_file: Path) -> None:
    """``--map results/latest/graph-map.npz`` is another map after the run; a noise file does more than its numbers."""
    assert invoke("run", "log.npz", "--estimators", "graph").exit_code == 0
    Path("noise.toml").write_text("[motion]\nnn = 0.3\n[ranges]\nscale = 1.1\n")
    options = ["--map", "results/latest/graph-map.npz", "--noise", "noise.toml", "--no-check-ids", "--oo", 0.3]
    assert invoke("run", "log.npz", "--estimators", "graph", *options).exit_code == 0
    first = without_times(Path("results/latest/comparison.json"))
    Path("noise.toml").unlink()
    result = invoke("run", "--config", "results/latest/config.toml", "--out", "again")
    assert result.exit_code == 0, result.output
    assert without_times(Path("again/comparison.json")) == first
    assert first["noise"]["motion"]["source"] == "file"


def test_a_configuration_of_a_log_in_memory_needs_a_log(invoke: Invoke, log_file: Path) -> None:
    run(simulate(seed=2, steps=10), estimators=["dead-reckoning"]).save("made", figures=())
    result = invoke("run", "--config", "made/config.toml", "--out", "o")
    assert result.exit_code == 2
    assert "not read from a file" in result.stderr
    assert invoke("run", "log.npz", "--config", "made/config.toml", "--out", "o").exit_code == 0


@pytest.mark.slow
def test_options_beat_the_file_which_beats_the_defaults(invoke: Invoke, log_file: Path) -> None:
    Path("c.toml").write_text(
        'log = "log.npz"\nestimators = ["fastslam1", "graph"]\nparticles = 40\nseed = 9\nframe = "world"\n'
        "[motion]\nepsilon = 1e-3\n"
    )
    result = invoke("run", "--config", "c.toml", "--seed", 4, "--out", "o", "--json", "-")
    assert result.exit_code == 0, result.output
    graph, filter_ = json.loads(result.stdout)["estimators"]
    assert filter_["options"]["particles"] == 40
    assert filter_["options"]["seed"] == 4
    assert filter_["options"]["resampling"] == "systematic"
    assert graph["options"]["frame"] == "world"
    assert read_config(Path("o/config.toml"))["epsilon"] == 1e-3
    result = invoke("run", "--config", "c.toml", "--estimators", "dead-reckoning", "--out", "o", "--json", "-")
    assert [entry["name"] for entry in json.loads(result.stdout)["estimators"]] == ["dead-reckoning"]


@pytest.mark.slow
def test_a_log_that_has_changed_is_not_taken_for_the_same(invoke: Invoke, log_file: Path) -> None:
    assert invoke("run", "log.npz", "--estimators", "graph", "--out", "o").exit_code == 0
    save(simulate(seed=3, steps=24, clean=True), log_file)
    result = invoke("run", "--config", "o/config.toml", "--out", "o2")
    assert result.exit_code == 2
    assert "has changed" in result.stderr
    assert "log_sha256" in result.stderr
    assert not Path("o2").exists()
    # another log, named by an option, is another run
    save(simulate(seed=4, steps=24, clean=True), Path("other.npz"))
    assert invoke("run", "other.npz", "--config", "o/config.toml", "--out", "o3").exit_code == 0


@pytest.mark.parametrize("verb", [("report", "page.html"), ("animate", "film.gif"), ("show",)])
def test_logs_of_a_configuration_are_all_taken_or_none(invoke: Invoke, log_file: Path, verb: tuple[str, ...]) -> None:
    digest = "0" * 64
    Path("two.toml").write_text("log = 'log.npz'\nothers = ['second.npz']\n")
    result = invoke(*verb, "--config", "two.toml")
    assert result.exit_code == 2
    assert f"the configuration is of 2 logs, and {verb[0]} takes one: name it" in result.stderr
    Path("changed.toml").write_text(f"log = 'log.npz'\nlog_sha256 = '{digest}'\n")
    result = invoke(*verb, "--config", "changed.toml")
    assert result.exit_code == 2
    assert "log.npz has changed" in result.stderr


def test_a_log_that_is_named_does_not_join_those_of_a_configuration(invoke: Invoke, log_file: Path) -> None:
    Path("two.toml").write_text("log = 'first.npz'\nothers = ['second.npz']\nestimators = ['dead-reckoning']\n")
    result = invoke("run", "log.npz", "--config", "two.toml", "--json", "-", "--out", "o")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["sessions"] is None


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("\nestimatorz = ['graph']\n", [":2:", "'estimatorz'", "'estimators'"]),
        ("estimators = ['grap']\n", [":1:", "'graph'"]),
        ("particles = 'many'\n", [":1:", "whole number"]),
        ("\nparticles = 0\n", [":2:", "at least 1"]),
        ("[sensor]\nbearing = 1\n", [":2:", "[sensor]", "'bearing_std'"]),
        ("weight = 'triples'\n", [":1:", "pairs"]),
        ("out = 'x'\n", ["unknown key 'out'"]),
        ("a\n", [":1:", "TOML"]),
    ],
)
def test_wrong_files_are_told_in_a_sentence(invoke: Invoke, content: str, words: list[str]) -> None:
    Path("c.toml").write_text(content)
    result = invoke("run", "--config", "c.toml")
    assert result.exit_code == 2
    assert result.stderr.startswith("error: c.toml")
    assert result.stderr.count("\n") == 1
    for word in words:
        assert word in result.stderr
    assert not Path("results").exists()


def test_no_file(invoke: Invoke) -> None:
    assert "no such file" in invoke("run", "--config", "nowhere.toml").stderr
    with pytest.raises(FormatError):
        read_config(Path("nowhere.toml"))
