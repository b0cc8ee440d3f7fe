"""`slam-compare run` on logs of ranges or bearings alone, or of positions alone."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import Result

from comparisons import animate, compare_solvers, run
from graphslam import AbsolutePositions, Graph, GraphError, Log, load, simulate, solve
from graphslam.simulation.worlds import simulate_single_numbers

Invoke = Callable[..., Result]
NOISE = ("--range-std", 0.1, "--range-rate", 0, "--bearing-std", 0.02, "--nn", 0.03, "--on", 0.01, "--oo", 0.03)


@pytest.mark.slow
@pytest.mark.parametrize("number", ["range", pytest.param("bearing", marks=pytest.mark.nightly)])
def test_empty_cells_go_through_the_command_line(invoke: Invoke, tmp_path: Path, number: str) -> None:
    log = simulate_single_numbers(number, seed=7, poses=120, landmarks=4)
    partial, times = log.partial_sightings, log.times
    assert partial is not None and times is not None and log.controls is not None and log.true_poses is not None
    folder = tmp_path / "drive"
    folder.mkdir()
    controls = np.column_stack([times, [*log.controls, [0, 0]]])
    cells = ["" if np.isnan(value) else repr(float(value)) for value in (*partial.ranges, *partial.bearings)]
    rows = zip(times[partial.steps].tolist(), partial.landmarks.tolist(), *np.split(np.array(cells), 2))
    for name, head, lines in (
        ("odometry", "t,v,w", controls.tolist()),
        ("sightings", "t,id,range,bearing", rows),
        ("truth", "t,x,y,theta", np.column_stack([times, log.true_poses]).tolist()),
    ):
        text = "".join(",".join(map(str, line)) + "\n" for line in lines)
        (folder / f"{name}.csv").write_text(f"{head}\n{text}")
    result = invoke(
        "run",
        "drive",
        *NOISE,
        "--estimators",
        "graph,gtsam,isam2",
        "--json",
        "o.json",
        "--out",
        "out",
        "--figures",
        "png",
    )
    assert result.exit_code == 0, result.output
    document = json.loads((tmp_path / "o.json").read_text())
    graph, gtsam, isam2 = document["estimators"]
    assert np.allclose(graph["poses"], gtsam["poses"], atol=1e-5) and graph["certificate"]["status"] == "not applicable"
    assert np.allclose(graph["poses"], isam2["poses"], atol=0.02)
    assert f"0 sightings and {len(partial)} with a range or a bearing alone of 4 landmarks" in " ".join(
        result.output.split()
    )
    assert f"{len(partial)} of {len(partial)} sightings have a range or a bearing alone" in result.output
    assert f"EDGE_{number.upper()}_SE2_XY" in (tmp_path / "out/graph.g2o").read_text()
    # the same in Python, from the import
    assert invoke("import", "drive", "drive.npz").exit_code == 0
    again = load(tmp_path / "drive.npz")
    assert again.partial_sightings is not None and len(again.partial_sightings) == len(partial)
    found = solve(Graph.from_log(again, motion=log.motion, sensor=log.sensor, kernel="none"))
    assert found.converged and set(found.landmarks) == {0, 1, 2, 3}


def positions_alone() -> Log:
    log = simulate(seed=1, steps=40)
    steps = np.arange(0, log.num_poses, 3)
    positions = AbsolutePositions(steps=steps, places=log.true_poses[steps, :2], covariances=0.01 * np.eye(2))
    return log.with_sightings(np.zeros(len(log.steps), dtype=bool)).replace(positions=positions)


def ranges_alone() -> Log:
    return simulate_single_numbers("range", seed=7, poses=60, landmarks=4)


def test_a_log_of_positions_alone_is_estimated_as_its_graph_is() -> None:
    log = positions_alone()
    found = run(log, estimators=["graph", "dead-reckoning"])
    assert found["graph"].cost == solve(Graph.from_log(log)).cost
    assert found.table["graph"].ate_m < found.table["dead-reckoning"].ate_m
    bare = log.replace(positions=None)
    for work in (run, animate):
        with pytest.raises(GraphError, match="no sightings at all, so there is nothing to estimate from"):
            work(bare)


@pytest.mark.parametrize("make", [positions_alone, ranges_alone])
def test_what_needs_ranges_and_bearings_says_so(make: Callable[[], Log]) -> None:
    log = make()
    assert len(animate(log, max_frames=2)) == 2
    with pytest.raises(GraphError, match="no sightings of range and bearing, so there is nothing to associate"):
        animate(log, estimator="association")
    with pytest.raises(GraphError, match="no sightings of range and bearing, on which solvers are compared"):
        compare_solvers(log, jobs=0)
