"""Trajectories for evo, maps as tables, graphs as g2o: written, read by others, and the same numbers."""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

import comparisons
from comparisons.results.files import tum_text
from graphslam import Graph, OptionError, simulate, solve
from graphslam.maps.map_files import map_text


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    comparison = comparisons.run(
        simulate(steps=40, seed=4), estimators=["dead-reckoning", "graph", "gtsam", "fastslam1"], particles=50
    )
    folder = tmp_path_factory.mktemp("saved")
    return comparison, folder, comparison.save(folder, figures=())


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["graph", *(pytest.param(each, marks=pytest.mark.nightly) for each in ("dead-reckoning", "fastslam1"))]
)
def test_evo_ape_finds_our_ate(saved, tmp_path, name):
    comparison, folder, _ = saved
    evo_ape = Path(sys.executable).with_name("evo_ape")
    if not evo_ape.exists():
        pytest.skip("needs the program evo_ape beside Python")
    arguments = ["tum", folder / "truth.tum", folder / f"{name}.tum", "--align", "--save_results", tmp_path / "ape.zip"]
    # evo keeps settings in the home folder, and asks before it overwrites
    env = os.environ | {"HOME": str(tmp_path), "MPLBACKEND": "agg"}
    done = subprocess.run([evo_ape, *arguments], env=env, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    with zipfile.ZipFile(tmp_path / "ape.zip") as results:
        rmse = json.loads(results.read("stats.json"))["rmse"]
    assert rmse == pytest.approx(comparison.metrics[name].ate_m, abs=1e-6)


def test_trajectories_keep_every_bit(saved):
    comparison, folder, _ = saved
    rows = np.loadtxt(folder / "graph.tum")
    result = comparison["graph"]
    np.testing.assert_array_equal(rows[:, 0], comparison.log.times[result.estimated])
    np.testing.assert_array_equal(rows[:, 1:3], result.poses[result.estimated, :2])
    heading = 2 * np.arctan2(rows[:, 6], rows[:, 7])
    np.testing.assert_allclose(np.cos(heading - result.poses[result.estimated, 2]), 1, atol=1e-12)
    assert not rows[:, 3:6].any()


def test_maps_are_tables(saved):
    comparison, folder, _ = saved
    lines = (folder / "graph-map.csv").read_text().splitlines()
    names = "id,x,y,heading,var_x,cov_xy,var_y,cov_x_heading,cov_y_heading,var_heading,correlated"
    assert lines[0] == names and all(line.endswith(",1") for line in lines[1:])
    result = comparison["graph"]
    for line in lines[1:]:
        j, x, y, heading, var_x, cov_xy, var_y, *_ = line.split(",")
        assert [float(x), float(y), float(heading)] == result.landmarks[int(j)].tolist()
        C = result.landmark_covariances[int(j)]
        assert [float(var_x), float(cov_xy), float(var_y)] == [C[0, 0], C[0, 1], C[1, 1]]
    assert len(lines) == 1 + len(result.landmarks)


def test_what_is_unknown_stays_empty():
    plain = map_text({7: np.array([1.0, 2.0])}, {7: np.diag([0.1, 0.2])})
    assert plain.splitlines()[1] == "7,1.0,2.0,,0.1,0.0,0.2,,,"
    assert map_text({-3: np.array([1.0, 2.0, 0.5])}, {}).splitlines()[1] == "-3,1.0,2.0,0.5,,,,,,"
    text = tum_text(np.array([0.0, 0.5]), np.array([[1.0, 2.0, np.nan], [1.0, 2.0, np.pi / 2]]))
    assert "headings are unknown" in text
    assert text.splitlines()[2] == "0.0 1.0 2.0 0.0 0.0 0.0 0.0 1.0"


def test_the_graph_as_g2o_starts_at_the_solution(saved):
    comparison, _, files = saved
    graph = Graph.from_g2o(files["graph.g2o"])
    np.testing.assert_array_equal(graph.initial[:, :2], comparison["graph"].poses[:, :2])
    assert solve(graph, initialize="given").converged


def test_a_graph_that_g2o_cannot_hold_is_left_out(tmp_path):
    log = simulate(steps=15, seed=1)
    files = comparisons.run(log, estimators=["graph"], weight="marginal", edges="virtual+motion").save(
        tmp_path, figures=["svg"]
    )
    assert "graph.g2o" not in files
    assert [note.partition(": ")[0] for note in files.notes] == ["there is no graph.g2o"]
    assert not (tmp_path / "graph.g2o").exists()
    assert files["figure"].name == "comparison.svg"
    with pytest.raises(OptionError, match="png, pdf, svg"):
        comparisons.run(log, estimators=["graph"]).save(tmp_path, figures=["bmp"])


@pytest.mark.slow
def test_the_same_data_makes_the_same_figures(tmp_path):
    log = simulate(steps=15, seed=1)
    comparison = comparisons.run(log, estimators=["dead-reckoning", "graph"])
    for folder in ("one", "two"):
        comparison.save(tmp_path / folder, figures=("png", "pdf", "svg"))
    for kind in ("png", "pdf", "svg"):
        one, two = ((tmp_path / folder / f"comparison.{kind}").read_bytes() for folder in ("one", "two"))
        assert one == two, kind


@pytest.mark.slow
def test_a_second_run_into_the_folder_leaves_nothing_of_the_first(tmp_path):
    log = simulate(steps=15, seed=1)
    mine = tmp_path / "notes.txt"
    mine.write_text("mine")
    comparisons.run(log, estimators=["graph", "fastslam1"], particles=10).save(tmp_path, figures=("svg",))
    assert (tmp_path / "fastslam1.tum").exists()
    files = comparisons.run(log, estimators=["graph"]).save(tmp_path, figures=())
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in files.values()} | {"notes.txt"}
