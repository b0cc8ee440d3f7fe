"""The engine as a WebAssembly module, in Node and in a browser, against Python."""

import base64
import importlib.util
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chromium import Chromium, find_browser
from engine_outside import assert_same_poses, online, solution

from fastslam import FastSLAM1, FastSLAM2
from fastslam.particles import draw_key
from graphslam import Graph, Log, MotionModel, SensorModel, simulate, solve, textbook
from graphslam.edges.priors import AnchorEdges
from graphslam.edges.relative import RelativePoseEdges
from graphslam.edges.robust import Cauchy
from graphslam.edges.virtual_motion import VirtualMotionEdges

ROOT = Path(__file__).parents[1]
PARTICLES, SEED = 50, 3
#: solves the log, drives along it online and with FastSLAM, and returns what came out
PROGRAM = """
const solved = engine.solve(log);
const online = engine.online(log), slam = engine.fastslam({ ...log, particles, version });
const poses = [], ess = [];
const seen = log.controls.concat([0]).map(() => []);
for (const [step, ...sighting] of log.sightings) seen[step].push(sighting);
seen.forEach((sightings, t) => {
  const control = t > 0 ? log.controls[t - 1] : null;
  poses.push(online.step(control, sightings));
  if (t > 0) slam.move(control, BigInt(keys[t]));
  ess.push(sightings.length ? slam.weigh(sightings) : -1);
  if (offsets[t] !== null) slam.resample(offsets[t]);
});
let message = "";
try { engine.solve({ ...log, noise: { nm: 1 } }); } catch (error) { message = error.message; }
const marks = [...new Set(log.sightings.map((row) => row[1]))].sort((a, b) => a - b);
const result = {
  solved, online: poses, ess, message, ...slam.particles(), best: slam.best,
  landmarks: marks.map((j) => online.landmark(j)), map: marks.map((j) => slam.landmark(j)), unknown: slam.landmark(-5),
};
online.free();
slam.free();
"""


@pytest.fixture(scope="session")
def module(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder with vmslam.wasm and vmslam.js."""
    if importlib.util.find_spec("ziglang") is None:
        pytest.skip("the package ziglang is missing, which builds WebAssembly; make engine-wasm installs it")
    if shutil.which("make") is None:
        pytest.skip("this machine has no make")
    folder = ROOT / "build" / "wasm"
    command = ["make", "-C", ROOT / "engine" / "wasm", "-j2", f"PYTHON={sys.executable}", f"BUILD={folder}"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def in_node(program: str, folder: Path) -> Any:
    if shutil.which("node") is None:
        pytest.skip("this machine has no node")
    script = folder / "program.mjs"
    script.write_text(f"{program}\nconsole.log(JSON.stringify(result));")
    return json.loads(subprocess.run(["node", script], check=True, capture_output=True, text=True).stdout)


def in_browser(program: str, folder: Path) -> Any:
    browser = find_browser()
    if browser is None:
        pytest.skip("this machine has no Chromium")
    with Chromium(browser, folder / "profile") as page:
        return page.evaluate(f"(async () => {{ {program}\nreturn result; }})()")


def program(module: Path, body: str, **given: Any) -> str:
    """A program that has loaded the engine, with constants."""
    given["wasm"] = base64.b64encode((module / "vmslam.wasm").read_bytes()).decode()
    constants = "\n".join(f"const {name} = {json.dumps(value)};" for name, value in given.items())
    library = (module / "vmslam.js").read_text().replace("export ", "")
    loading = "const engine = await load(Uint8Array.from(atob(wasm), (c) => c.charCodeAt(0)));"
    return f"{library}\n{constants}\n{loading}\n{body}"


@pytest.mark.slow
@pytest.mark.parametrize("oriented", [True, False], ids=["psi", "no psi"])
@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("run", [in_node, pytest.param(in_browser, marks=pytest.mark.browser)])
def test_the_module_gives_the_numbers_of_python(module: Path, tmp_path: Path, run: Any, version: int, oriented: bool):
    log = simulate(seed=3, steps=60, orientation=oriented)
    filter_ = (FastSLAM1, FastSLAM2)[version - 1](
        log, particles=PARTICLES, seed=SEED, motion=MotionModel(), sensor=SensorModel(), ess_threshold=0.9
    )
    result = filter_.run()
    keys, offsets = random_numbers(result.resampled)
    assert any(result.resampled)
    given = {
        "log": as_rows(log, oriented),
        "particles": PARTICLES,
        "version": version,
        "keys": keys,
        "offsets": offsets,
    }
    found = run(program(module, PROGRAM, **given), tmp_path)

    assert_same_poses(found["solved"]["poses"], solution(log).poses)
    assert found["solved"]["converged"] and found["solved"]["steps"] > 1

    poses, landmarks = online(log)
    assert_same_poses(found["online"], poses)
    d = 3 if oriented else 2
    np.testing.assert_allclose(
        np.array(found["landmarks"])[:, :2], [landmarks[j][:2] for j in sorted(landmarks)], atol=1e-9
    )
    assert {len(place) for place in landmarks.values()} == {d}

    state = filter_.state
    assert_same_poses(found["poses"], state.poses)
    np.testing.assert_allclose(found["logWeights"], state.log_weights, atol=1e-9)
    assert found["best"] == state.best
    best = state.map()
    upper = np.triu_indices(2)
    expected = [[*best[j].mean[:2], *best[j].covariance[:2, :2][upper]] for j in sorted(best)]
    np.testing.assert_allclose(found["map"], expected, atol=1e-9)
    assert found["unknown"] is None
    assert found["message"].startswith('there is no noise "nm"; its names are nn, no, on, oo')


#: a graph of virtual-motion edges: J and distances at dead reckoning, one step, and the minimum with covariances and map
GRAPH_PROGRAM = """
const graph = engine.graph({ ...log, pairs, kernel, width }), start = graph.deadReckoning();
const step = graph.solve(start, 1), end = graph.solve(start);
const result = {
  start, costs: graph.costs(start), step, end, J: graph.costs(end.poses).J, covariances: graph.covariances(end.poses),
  map: graph.map(end.poses), marks: graph.landmarks,
};
graph.free();
"""


@pytest.mark.slow
@pytest.mark.parametrize("kernel", ["none", "cauchy"])
@pytest.mark.parametrize("oriented", [True, False], ids=["psi", "no psi"])
def test_the_edges_of_a_graph(module: Path, tmp_path: Path, oriented: bool, kernel: str) -> None:
    log = simulate(seed=3, steps=30, orientation=oriented)
    graph = Graph.from_log(log, edges="virtual+motion", weight="pairs", frame="body", kernel=kernel)
    virtual = next(family for family in graph.families if isinstance(family, VirtualMotionEdges))
    # the graph has its sightings by landmark, as the log has them in another order
    order = np.lexsort([log.steps, log.landmarks])
    pairs = np.column_stack([order[rows] for rows in virtual.pairs()[:2]]).tolist()
    width = Cauchy().of_dimension(log.sightings.shape[1]).width
    given = {"log": as_rows(log, oriented), "pairs": pairs, "kernel": kernel, "width": width}
    found = in_node(program(module, GRAPH_PROGRAM, **given), tmp_path)

    start = solve(graph, initialize="dead-reckoning", max_iterations=1)
    assert_same_poses(found["start"], log.initial_poses)
    assert found["costs"]["J"] == pytest.approx(start.costs[0], rel=1e-9)
    plain = Graph.from_log(log, edges="virtual+motion", weight="pairs", frame="body", kernel="none")
    expected = [
        family.linearize(log.initial_poses, log.initial_poses).mahalanobis
        for kind in (AnchorEdges, RelativePoseEdges, VirtualMotionEdges)
        for family in plain.families
        if isinstance(family, kind)
    ]
    np.testing.assert_allclose(found["costs"]["squares"], np.concatenate(expected), rtol=1e-9, atol=1e-12)
    assert_same_poses(found["step"]["poses"], start.poses)
    assert found["step"]["norm"] == pytest.approx(start.step_norms[0], rel=1e-9)

    end = solve(graph, initialize="dead-reckoning")
    assert found["end"]["converged"] and found["end"]["determined"] and found["end"]["steps"] == end.iterations
    assert_same_poses(found["end"]["poses"], end.poses)
    assert found["J"] == pytest.approx(end.cost, rel=1e-9)
    if kernel == "none":  # Python's covariances of a robust estimate take the kernel's efficiency into account
        np.testing.assert_allclose(
            np.reshape(found["covariances"], (-1, 3, 3)), end.covariance(), rtol=1e-7, atol=1e-12
        )
    assert found["marks"] == sorted(end.landmarks)
    d = 3 if oriented else 2
    np.testing.assert_allclose(np.array(found["map"])[:, :d], [end.landmarks[j] for j in found["marks"]], atol=1e-8)


PLACES_PROGRAM = """
const place = engine.place(pose, sighting), far = engine.place(pose, sighting, { noiseRange: 5 });
const free = engine.graph({ start: [0, 0, 0], controls: [[1, 0, 1]], sightings: [[0, 1, 2, 0], [1, 1, 1, 0]],
                            oriented: false, pairs: [[0, 1]], motions: false });
const result = { place, far, sight: engine.sight(pose, place.landmark),
                 free: free.solve(free.deadReckoning()), none: free.covariances(free.deadReckoning()) };
"""


def test_places_and_a_graph_that_is_not_determined(module: Path, tmp_path: Path) -> None:
    pose, sighting, sensor = np.array([1.0, -2.0, 0.7]), np.array([3.0, 0.4, -0.9]), SensorModel()
    given = {"pose": pose.tolist(), "sighting": sighting.tolist()}
    found = in_node(program(module, PLACES_PROGRAM, **given), tmp_path)
    upper = np.triu_indices(3)
    rows = [0, 1, 3, 2, 4, 5]  # np.triu_indices has xx, xy, xt, yy, yt, tt
    R = textbook.sighting_derivative(pose, sighting)
    for name, at in (("place", sighting), ("far", np.array([5.0, 0.4, -0.9]))):
        C = R @ textbook.sighting_covariance(at, sensor) @ R.T
        np.testing.assert_allclose(np.array(found[name]["covariance"])[rows], C[upper], atol=1e-12)
        np.testing.assert_allclose(found[name]["landmark"], sensor.h_inverse(pose, sighting), atol=1e-12)
    np.testing.assert_allclose(found["sight"], sighting, atol=1e-12)
    assert not found["free"]["determined"] and found["none"] is None


def test_the_module_is_small(module: Path) -> None:
    assert (module / "vmslam.wasm").stat().st_size <= 500_000


def as_rows(log: Log, oriented: bool) -> dict[str, Any]:
    """The log as `vmslam.js` takes it."""
    assert log.controls is not None and log.dt is not None
    return {
        "start": log.initial_poses[0].tolist(),
        "controls": np.column_stack([log.controls, log.dt]).tolist(),
        "sightings": np.column_stack([log.steps, log.landmarks, log.sightings]).tolist(),
        "oriented": oriented,
    }


def random_numbers(resampled: np.ndarray) -> tuple[list[str], list[float | None]]:
    """The keys of the motions and the offsets of the resamplings that the filter has drawn."""
    rng = np.random.default_rng(SEED)
    keys, offsets = [], []
    for t, due in enumerate(resampled):
        keys.append(str(draw_key(rng)) if t > 0 else "0")
        offsets.append(rng.random() if due else None)
    return keys, offsets
