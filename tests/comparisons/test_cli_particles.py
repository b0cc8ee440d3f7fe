import json

import pytest
from typer.testing import CliRunner

from comparisons.cli import app


@pytest.mark.nightly
def test_a_small_study(tmp_path):
    picture = tmp_path / "study.png"
    words = ["particles", "--particles", "5,10", "--seeds", "2", "--filters", "fastslam1", "--jobs", "0"]
    result = CliRunner().invoke(app, [*words, "--figure", str(picture), "--json", "-"])
    assert result.exit_code == 0, result.output
    payload = json.loads(result.stdout)
    assert len(payload["runs"]) == 4
    assert [run["options"]["particles"] for run in payload["runs"]] == [5, 5, 10, 10]
    methods = payload["summary"]["methods"]
    assert [line["method"] for line in methods] == ["fastslam1 particles=5", "fastslam1 particles=10"]
    assert all(
        low <= line["figures"]["ate_m"]["median"] <= high
        for line in methods
        for low, high in [line["figures"]["ate_m"]["quartiles"]]
    )
    assert picture.stat().st_size > 10_000


@pytest.mark.slow
def test_the_numbers_are_saved_before_the_figure(tmp_path, monkeypatch):
    def fail(*_, **__):
        raise OSError("no space left")

    monkeypatch.setattr("comparisons.results.Displayed.save_figure", fail)
    words = ["particles", "--particles", "5", "--seeds", "1", "--filters", "fastslam1", "--jobs", "0"]
    files = ["--figure", str(tmp_path / "study.png"), "--json", str(tmp_path / "study.json")]
    result = CliRunner().invoke(app, [*words, *files])
    assert result.exit_code == 2 and "no space left" in result.output
    assert len(json.loads((tmp_path / "study.json").read_text())["runs"]) == 1


def test_wrong_use_is_one_sentence(tmp_path):
    for words, message in (
        (["--particles", "1.5"], "whole numbers"),
        (["--particles", "0"], "at least 1"),
        (["--filters", "kalman"], "filters must be one of"),
        (["--association", "guess"], "association must be one of"),
        (["--figure", str(tmp_path / "study.xyz")], "must end in .png or .pdf or .svg"),
        ([str(tmp_path / "absent.npz")], "no such file"),
    ):
        result = CliRunner().invoke(app, ["particles", "--seeds", "1", *words])
        assert result.exit_code == 2
        assert message in result.stderr
        assert "Traceback" not in result.output
