"""docs/schema.json is generated from the classes of results, which hold for what the verbs write."""

import importlib.util
import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from typer.main import get_command
from typer.testing import CliRunner

from comparisons.cli import app
from graphslam import load

DOCS = Path(__file__).parents[2] / "docs"
SCHEMA = json.loads((DOCS / "schema.json").read_text(encoding="utf-8"))


def valid(verb, payload):
    jsonschema.validate(payload, {"$ref": f"#/$defs/{verb}"} | SCHEMA)


@pytest.fixture
def write(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        result = CliRunner().invoke(app, [*map(str, arguments), "--json", "out.json"])
        assert result.exit_code == 0, result.output
        return json.loads(Path("out.json").read_text())

    return run


STUDY = """seeds = 2
estimators = ["graph", "fastslam1"]
[simulate]
steps = 15
[options]
particles = 10
"""


@pytest.mark.slow
def test_every_verb_writes_what_the_schema_says(write):
    valid("simulate", write("simulate", "log.npz", "--steps", 15, "--seed", 3))
    found = write("run", "log.npz", "--particles", 20, "--noise", "book", "--out", "out", "--figures", "png")
    valid("run", found)
    assert json.loads(Path("out/comparison.json").read_text()) == found
    valid("evaluate", write("evaluate", "log.npz", "out/graph.tum", "--map", "out/graph-map.npz"))
    valid("solvers", write("solvers", "log.npz", "--edges", "landmark+motion", "--motion-weights", 1, "--jobs", 0))
    valid("backends", write("backends", "out/graph.g2o"))
    valid("particles", write("particles", "log.npz", "--particles", "10,20", "--seeds", 2, "--jobs", 0))
    valid("consistency", write("consistency", "--logs", 2, "--steps", 15, "--jobs", 0))
    valid(
        "animate", write("animate", "log.npz", "film.gif", "--estimator", "mcl", "--particles", 20, "--max-frames", 3)
    )
    valid("calibrate", write("calibrate", "log.npz"))
    valid("datasets", write("datasets", "--folder", "."))
    Path("study.toml").write_text(STUDY)
    valid("sweep", write("sweep", "study.toml", "--jobs", 0))
    valid("study", write("study", "study.sqlite"))


@pytest.mark.slow
def test_the_json_of_an_import(write, tmp_path):
    np.savetxt("odometry.csv", [[0, 0.5, 0.1], [1, 0.5, 0.1], [2, 0.5, 0.1]], delimiter=",")
    np.savetxt("sightings.csv", [[0.5, 3, 2.0, 0.1], [1.5, 3, 1.5, 0.2]], delimiter=",")
    found = write("import", ".")
    valid("import", found)
    assert found["file"] is None and [stream["kind"] for stream in found["streams"]] == ["odometry", "sightings"]
    found = write("import", "--odometry", "odometry.csv", "--sightings", "sightings.csv", "drive.npz")
    valid("import", found)
    valid("show", write("show", "drive.npz"))
    assert found["file"] == "drive.npz" and found["source"] is None and found["streams"][1]["rows"] == 2
    assert load("drive.npz").equals(load(tmp_path))


def test_logs_that_know_less_are_valid_too(write):
    write("simulate", "log.npz", "--steps", 15, "--no-orientation")
    valid("run", write("run", "log.npz", "--particles", 20, "--out", "out", "--figures", ""))


@pytest.mark.slow
def test_the_schema_refuses_what_is_not_said(write):
    write("simulate", "log.npz", "--steps", 15)
    found = write("run", "log.npz", "--estimators", "graph", "--out", "out", "--figures", "")
    for broken in (
        found | {"surprise": 1},
        {k: v for k, v in found.items() if k != "log"},
        found | {"estimators": [found["estimators"][0] | {"seconds": "fast"}]},
        found | {"estimators": [found["estimators"][0] | {"poses": [[0.0, 0.0]]}]},
    ):
        with pytest.raises(jsonschema.ValidationError):
            valid("run", broken)


def test_schema_and_page_are_those_of_the_models():
    spec = importlib.util.spec_from_file_location("make_json", DOCS / "make_json.py")
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    repeat = "is out of date; run: python docs/make_json.py"
    assert made.schema() == SCHEMA, f"docs/schema.json {repeat}"
    assert made.DOCUMENTS.keys() == get_command(app).commands.keys()
    page = made.page()
    assert [verb for verb in made.DOCUMENTS if f"`{verb}`" not in page and f"## {verb}" not in page] == []
