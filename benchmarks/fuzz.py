"""Random graphs, broken files and random command lines: no traceback, no NaN, no false "converged", no end above the start.

python benchmarks/fuzz.py                                  # all: 2,000 graphs, 1,000 files per format, 300 command lines
python benchmarks/fuzz.py graphs --count 200 --seed 7
python benchmarks/fuzz.py files --count 1300
python benchmarks/fuzz.py commands --count 50 --only 17    # one case again

Everything follows from the random seed and the number of the case. The exit status is 1 if a case fails.
"""

from __future__ import annotations

import argparse
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import chdir
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import typer
from numpy.random import Generator, default_rng
from scipy.io import savemat
from typer.testing import CliRunner

import comparisons.options as declared
from comparisons.cli import make_app
from comparisons.config import read_config
from comparisons.noise_files import read_noise
from comparisons.option import Options, options_of
from comparisons.studies.plan import read_study
from graphslam import (
    Graph,
    Log,
    MotionModel,
    SensorModel,
    SlamError,
    Solution,
    load,
    save,
    simulate,
    solve,
    solve_gnc,
    textbook,
)
from graphslam.se2 import between, inverse, transform

#: the name of a case, and a function that returns what is wrong
Case = tuple[str, Callable[[], list[str]]]
#: J may be above its minimum by this part where a solution is called converged
PART = 1e-6


# -- graphs --------------------------------------------------------------------------------------------------------------


def graph_case(seed: int, number: int) -> Case:
    """One random graph: its name, and a function that solves it and returns what is wrong."""
    rng = default_rng([seed, number])
    kind = list(KINDS)[number % len(KINDS)]
    solver = str(rng.choice(["gauss-newton", "levenberg-marquardt", "gnc", "textbook"], p=[0.6, 0.2, 0.15, 0.05]))
    initialize = str(rng.choice(["auto", "given"], p=[0.8, 0.2]))
    if kind == "pose graph":
        text = pose_graph(rng)

        def check_file() -> list[str]:
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "graph.g2o"
                path.write_text(text)
                graph = Graph.from_g2o(path)
            method = "levenberg-marquardt" if solver == "levenberg-marquardt" else "gauss-newton"
            return wrong_with(solve(graph, method=method, initialize=initialize), initialize=initialize)

        return f"graph {number}: {kind}, {solver}, {initialize}", check_file
    log, motion, sensor = KINDS[kind](rng)
    edges = str(rng.choice(["virtual", "virtual+motion", "landmark+motion"], p=[0.2, 0.4, 0.4]))
    options: dict[str, Any] = {
        "edges": edges,
        "frame": str(rng.choice(["body", "body", "world"])),
        "weight": "pairs" if edges == "landmark+motion" else str(rng.choice(["pairs", "tempered", "marginal"])),
        "kernel": [None, "none", "huber", "cauchy", "geman-mcclure"][rng.integers(5)],
        "motion_weight": float(rng.choice([1.0, 1.0, 100.0, 1e-6])),
    }
    dimensions = log.sightings.shape[1]
    name = f"graph {number}: {kind}, {dimensions}-D, {solver}, {initialize}, " + ", ".join(map(str, options.values()))

    def check() -> list[str]:
        if solver == "textbook":
            result = textbook.solve(log, motion=motion, sensor=sensor, edges=edges.replace("landmark", "virtual"))
            return [] if np.isfinite(result.poses).all() else ["poses are not finite"]
        graph = Graph.from_log(log, motion=motion, sensor=sensor, **options)
        if solver == "gnc":
            return wrong_with(solve_gnc(graph), initialize="gnc")
        return wrong_with(solve(graph, method=solver, initialize=initialize), initialize=initialize)

    return name, check


def wrong_with(solution: Solution, *, initialize: str) -> list[str]:
    """What is wrong with a solution of a graph. Only "auto" promises not to end above the start."""
    graph, cost, problems = solution.graph, solution.cost, []
    assert graph is not None
    if not (np.isfinite(solution.state).all() and np.isfinite(solution.poses).all() and np.isfinite(cost)):
        problems.append(f"not finite: J = {cost}, {solution.reason}")
        return problems
    if not all(np.isfinite(landmark).all() for landmark in solution.landmarks.values()):
        problems.append("a landmark is not finite")
    given = graph.cost(graph.initial)
    if initialize == "auto" and not cost <= given * (1 + 1e-9) + floor_of(graph, graph.initial):
        problems.append(f"above the start: J = {cost:.6g}, given {given:.6g}, {solution.reason}")
    if solution.converged and (lower := descended(graph, solution.state)) is not None:
        problems.append(f"converged at J = {cost:.9g}, but a descent leads to {lower:.9g}: {solution.reason}")
    try:
        covariances = solution.covariances()[solution.estimated]
        if not np.isfinite(covariances).all():
            problems.append("a covariance is not finite")
        elif np.any(np.diagonal(covariances, axis1=1, axis2=2) < 0):
            problems.append("a variance is negative")
    except SlamError:
        pass
    return problems


def floor_of(graph: Graph, state: np.ndarray) -> float:
    """What J is, at least, by rounding errors of the state."""
    system, _ = graph.linearize(state)
    error = 1e-15 * (1 + np.abs(state).max(axis=0))
    return float(np.sum(np.abs(system.diagonal()) * error**2))


def descended(graph: Graph, state: np.ndarray, steps: int = 30) -> float | None:
    """The cost that damped steps reach from a state where the gradient is not zero; None at a stationary point.

    State-dependent information stays as it is at the state. The quadratic model decides whether the gradient is zero: it
    must promise more than `PART` of J. The steps confirm it. Both work with dense matrices, and share no rule with the
    solvers.
    """
    start = cost = graph.cost(state)
    x, damping, enough = state.copy(), 1e-6, PART * start + 10 * floor_of(graph, state)
    for step in range(steps):
        system, _ = graph.linearize(x, state)
        omega, xi = system.to_sparse().toarray(), system.xi.ravel()
        size = np.sqrt(np.maximum(np.diagonal(omega), 1e-300))
        values, vectors = np.linalg.eigh(omega / size[:, None] / size)
        slope, held = vectors.T @ (xi / size), values > 1e-13
        if step == 0 and np.sum(slope[held] ** 2 / values[held]) <= enough:
            return None
        while damping < 1e6:
            delta = vectors @ (slope / (np.abs(values) + damping)) / size
            tried = graph.cost(x + delta.reshape(-1, 3), state)
            damping *= 10
            if np.isfinite(tried) and tried < cost:
                x, cost, damping = x + delta.reshape(-1, 3), tried, max(damping / 100, 1e-12)
                break
        else:
            break
    return cost if cost < start - enough else None


def drive(
    rng: Generator, *, poses: int = 0, landmarks: int = 0, scale: float = 1.0, noise: float = 1.0, seen: float = 0.6
) -> Log:
    """A random drive among landmarks that are seen with a probability; lengths are multiplied by ``scale`` [m]."""
    poses, landmarks = poses or int(rng.integers(2, 16)), landmarks or int(rng.integers(1, 8))
    controls = np.column_stack([rng.uniform(-0.2, 1, poses - 1), rng.normal(0, 0.4, poses - 1)])
    truth = MotionModel().dead_reckoning(np.zeros(3), controls, np.ones(poses - 1))
    places = np.column_stack([rng.uniform(-5, 5, (landmarks, 2)), rng.uniform(-np.pi, np.pi, landmarks)])
    steps, ids = np.nonzero(rng.random((poses, landmarks)) < seen)
    if len(steps) == 0:
        steps, ids = np.zeros(1, dtype=int), np.zeros(1, dtype=int)
    z = SensorModel().h(truth[steps], places[ids])
    z[:, 0] *= np.exp(noise * rng.normal(0, 0.14, len(z)))
    z[:, 1:] += noise * rng.normal(0, 0.05, (len(z), 2))
    z[:, 0] = np.maximum(z[:, 0], 1e-6) * scale
    controls = controls * (1 + noise * rng.normal(0, 0.1, controls.shape)) * [scale, 1]
    dimensions = int(rng.choice([2, 3]))
    return Log(dt=1.0, controls=controls, steps=steps, landmarks=ids, sightings=z[:, :dimensions], name="fuzz")


Drive = tuple[Log, MotionModel, SensorModel]


def plain(rng: Generator) -> Drive:
    """The book's noise."""
    return drive(rng, noise=float(rng.choice([1.0, 3.0]))), MotionModel(), SensorModel()


def disconnected(rng: Generator) -> Drive:
    """Two groups of poses that share no landmark."""
    log = drive(rng, poses=10, landmarks=6)
    kept = (log.steps < 5) == (log.landmarks < 3)
    if not kept.any():
        kept[:] = True
    part = log.replace(steps=log.steps[kept], landmarks=log.landmarks[kept], sightings=log.sightings[kept])
    return part, MotionModel(), SensorModel()


def nearly_singular(rng: Generator) -> Drive:
    """Poses that hardly anything holds: hardly any sightings, or an enormous noise of the motion."""
    weak = float(10 ** rng.uniform(2, 8))
    return drive(rng, seen=0.1), MotionModel(nn=weak, no=weak, on=weak, oo=weak, epsilon=weak), SensorModel()


def scaled(low: float, high: float) -> Callable[[Generator], Drive]:
    """Lengths of 10^low to 10^high m; noise by hand where the book's would not fit."""

    def make(rng: Generator) -> Case:
        scale = float(10 ** rng.uniform(low, high))
        motion = MotionModel() if rng.random() < 0.5 else MotionModel.constant(0.1 * scale, 0.1)
        sensor = SensorModel() if rng.random() < 0.5 else SensorModel.constant(0.1 * scale, 0.05)
        return drive(rng, scale=scale), motion, sensor

    return make


def on_landmark(rng: Generator) -> Drive:
    """Ranges near zero: poses come to lie on landmarks."""
    log = drive(rng)
    z = log.sightings.copy()
    near = rng.random(len(z)) < 0.4
    z[near, 0] = 10 ** rng.uniform(-12, -1, int(near.sum()))
    return (
        log.replace(sightings=z),
        MotionModel(),
        SensorModel.constant(0.1, 0.05) if rng.random() < 0.5 else SensorModel(),
    )


def contradictory(rng: Generator) -> Drive:
    """Sightings that are random: loops that contradict each other."""
    log = drive(rng)
    z = log.sightings.copy()
    wrong = rng.random(len(z)) < rng.choice([0.2, 1.0])
    z[wrong, 0] = rng.uniform(0.1, 8, int(wrong.sum()))
    z[wrong, 1:] = rng.uniform(-np.pi, np.pi, (int(wrong.sum()), z.shape[1] - 1))
    return log.replace(sightings=z), MotionModel(), SensorModel()


def noise_free(rng: Generator) -> Drive:
    """Measurements without noise: J is zero at the optimum."""
    return drive(rng, noise=0.0), MotionModel(), SensorModel()


def extreme_noise(rng: Generator) -> Drive:
    """Noise models from 1e-12 to 1e12, as a typing error would make them."""
    motion, sensor = ((10 ** rng.uniform(-12, 12, k) ** 1.0) for k in (5, 3))
    if rng.random() < 0.5:
        motion, sensor = motion ** (1 / 3), sensor ** (1 / 3)
    return (
        drive(rng, noise=float(rng.choice([0.0, 1.0, 10.0]))),
        MotionModel(nn=motion[0], no=motion[1], on=motion[2], oo=motion[3], epsilon=motion[4]),
        SensorModel(range_rate=sensor[0], bearing_std=sensor[1], orientation_std=sensor[2]),
    )


def pose_graph(rng: Generator) -> str:
    """A g2o file of relative poses and points, with random loops, scales and information."""
    poses, scale = int(rng.integers(2, 20)), float(10.0 ** rng.choice([0, 0, 0, 9, -9]))
    truth = np.cumsum(
        np.column_stack([rng.normal(1, 0.5, poses), rng.normal(0, 0.5, poses), rng.normal(0, 0.5, poses)]), 0
    )
    lines = [
        f"VERTEX_SE2 {k} {x * scale!r} {y * scale!r} {t!r}"
        for k, (x, y, t) in enumerate((truth + rng.normal(0, 0.3, truth.shape)).tolist())
    ]
    places = rng.uniform(-5, 5, (int(rng.integers(0, 4)), 2))
    lines += [f"VERTEX_XY {100 + j} {x * scale!r} {y * scale!r}" for j, (x, y) in enumerate(places.tolist())]
    loops = [tuple(sorted(rng.choice(poses, 2, replace=False).tolist())) for _ in range(int(rng.integers(0, 8)))]
    for i, j in [(k, k + 1) for k in range(poses - 1)] + loops:
        z = between(truth[i], truth[j]) + rng.normal(0, 0.1, 3)
        if rng.random() < 0.1:
            z = rng.uniform(-3, 3, 3)
        spread = 10 ** rng.uniform(-4, 4, 3) if rng.random() < 0.2 else np.ones(3)
        root = np.linalg.qr(rng.normal(size=(3, 3)))[0] * np.sqrt(100 * spread) / [scale, scale, 1]
        omega = root.T @ root if rng.random() < 0.5 else np.diag([100 / scale**2, 100 / scale**2, 400])
        entries = [*(z * [scale, scale, 1]), *omega[np.triu_indices(3)]]
        lines.append(f"EDGE_SE2 {i} {j} " + " ".join(map(repr, map(float, entries))))
    for j, place in enumerate(places):
        for i in rng.choice(poses, min(poses, 3), replace=False).tolist():
            z = transform(inverse(truth[i]), place) + rng.normal(0, 0.1, 2)
            entries = [*(z * scale), 100 / scale**2, 0.0, 100 / scale**2]
            lines.append(f"EDGE_SE2_XY {i} {100 + j} " + " ".join(map(repr, map(float, entries))))
    return "\n".join(lines) + "\n"


KINDS: dict[str, Callable[[Generator], Drive]] = {
    "plain": plain,
    "disconnected": disconnected,
    "nearly singular": nearly_singular,
    "1e9 m": scaled(6, 12),
    "1e-9 m": scaled(-12, -6),
    "pose on landmark": on_landmark,
    "contradictory": contradictory,
    "noise-free": noise_free,
    "extreme noise": extreme_noise,
    "pose graph": pose_graph,  # type: ignore[dict-item]  # a file and no log
}


# -- files ---------------------------------------------------------------------------------------------------------------


def seeds_of_formats(folder: Path) -> dict[str, Path]:
    """Small valid files of every format: {format: file, or folder of files}."""
    log = simulate(seed=1, steps=12)
    plain = log.without_orientation()
    places = {name: folder / f"{name}{suffix}" for name, suffix in (("lnpr", ".txt"), ("npz", ".npz"))}
    save(log.replace(true_poses=None, true_landmarks=None), places["lnpr"])
    save(log, places["npz"])
    for name, tags in DIALECTS.items():
        places[name] = folder / f"{name}.{'g2o' if name == 'g2o' else 'graph'}"
        places[name].write_text(tags)
    times = log.times
    assert times is not None and log.controls is not None and log.true_poses is not None
    mrclam = places["mrclam"] = folder / "mrclam"
    mrclam.mkdir()
    rows = {
        "Robot1_Odometry": np.column_stack([times[:-1], log.controls]),
        "Robot1_Measurement": np.column_stack([times[log.steps] + 0.01, 10 + log.landmarks, log.sightings[:, :2]]),
        "Robot1_Groundtruth": np.column_stack([times, log.true_poses]),
        "Barcodes": np.column_stack([6 + np.arange(20), 10 + np.arange(20)]),
        "Landmark_Groundtruth": np.array([[6 + j, *m[:2], 0.01, 0.01] for j, m in (log.true_landmarks or {}).items()]),
    }
    for name, table in rows.items():
        text = "\n".join("\t".join(f"{x:g}" if x % 1 else str(int(x)) for x in row) for row in table.tolist())
        (mrclam / f"{name}.dat").write_text(f"# {name}\n{text}\n")
    huang = places["huang"] = folder / "huang"
    huang.mkdir()
    steps, marks = len(log.controls), np.array([m[:2] for m in (log.true_landmarks or {}).values()])
    beacons = np.column_stack([np.arange(1, len(marks) + 1), marks])
    sensor = np.column_stack([plain.steps + 1, 1 + plain.landmarks, plain.sightings, np.zeros((len(plain.steps), 3))])
    of_huang = {"store_speed": log.controls[:, :1].T, "store_turnrate": log.controls[:, 1:].T, "sensor_data": sensor}
    of_huang |= {"store_robotTrue": log.true_poses.T, "store_beaconsTrue": beacons}
    for name, value in of_huang.items():
        savemat(huang / f"{name}.mat", {name: value})
    seen = {key: np.zeros((steps, 20)) for key in ("r", "b")}
    for t, j, z in zip(plain.steps.tolist(), plain.landmarks.tolist(), plain.sightings):
        if t < steps:
            seen["r"][t, j], seen["b"][t, j] = z
    places["lost_in_the_woods"] = folder / "dataset2.mat"
    of_woods = {
        "t": times[:-1, None], "v": log.controls[:, :1], "om": log.controls[:, 1:], "d": 0.2, "l": np.zeros((20, 2)),
        "r_var": 0.01, "b_var": 0.01, "v_var": 0.01, "om_var": 0.01, "true_valid": np.ones((steps, 1)), **seen,
        **{f"{axis}_true": log.true_poses[:-1, k : k + 1] for k, axis in enumerate(("x", "y", "th"))},
    }  # fmt: skip
    savemat(places["lost_in_the_woods"], of_woods)
    tables = places["tables"] = folder / "tables"
    tables.mkdir()
    (tables / "odometry.csv").write_text(_csv("t,v,w", np.column_stack([times[:-1], log.controls])))
    seen_rows = np.column_stack([times[plain.steps], plain.landmarks, plain.sightings])
    (tables / "sightings.csv").write_text(_csv("t,id,range,bearing", seen_rows))
    for name, text in TOML.items():
        places[name] = folder / f"{name}.toml"
        places[name].write_text(text)
    return places


def _csv(head: str, rows: np.ndarray) -> str:
    return "\n".join([head, *(",".join(map(repr, row)) for row in rows.tolist())]) + "\n"


DIALECTS = {
    "g2o": "".join(f"VERTEX_SE2 {k} {k} 0 0.1\n" for k in range(4)) + "VERTEX_XY 9 1 2\nFIX 0\n"
    + "".join(f"EDGE_SE2 {k} {k + 1} 1 0 0 9 0 0 9 0 20\n" for k in range(3)) + "EDGE_SE2_XY 0 9 1 2 4 0 4\n",
    "toro": "".join(f"VERTEX2 {k} {k} 0 0.1\n" for k in range(4))
    + "".join(f"EDGE2 {k} {k + 1} 1 0 0 9 0 9 20 0 0\n" for k in range(3)),
    "isam": "".join(f"ODOMETRY {k} {k + 1} 1 0 0 3 0 0 3 0 4\n" for k in range(4)) + "LANDMARK 0 9 1 2 2 0 2\n",
}  # fmt: skip
TOML = {
    "config": 'estimators = ["graph"]\nedges = "virtual"\nparticles = 10\n[motion]\nnn = 0.2\n[sensor]\nrange_rate = 0.1\n',
    "noise": "[motion]\nnn = 0.19\nepsilon = 1e-4\n[sensor]\nbearing_std = 0.05\n[ranges]\nscale = 1.02\nbias = 0.03\n",
    "study": 'seeds = 2\nestimators = ["graph"]\n[simulate]\nsteps = 5\n'
    'vary.landmarks = [3, 4]\n[options]\nvary.edges = ["virtual"]\n',
}
#: what a text is damaged with
TOKENS = ["nan", "inf", "-inf", "1e400", "1e308", "-1", "0", "1e-320", "", " ", "\t", "x", "1,5", "0x10", "9" * 30,
          "\0", "\ufeff", "ü",
          "1_0", "--", "[", "=", '"', "\r\n", "#", "VERTEX_SE2", "1e20"]  # fmt: skip


def damaged(rng: Generator, data: bytes) -> bytes:
    """A file with one to four damages: bytes, words or lines changed, lost, moved or repeated."""
    for _ in range(int(rng.choice([1, 1, 2, 4]))):
        way, at = rng.integers(9), int(rng.integers(len(data) + 1))
        lines = data.split(b"\n")
        line = int(rng.integers(len(lines)))
        words = lines[line].split()
        if way == 0:
            data = data[:at]
        elif way == 1:
            data = data[:at] + rng.bytes(int(rng.integers(1, 9))) + data[at:]
        elif way == 2 and data:
            at = min(at, len(data) - 1)
            data = data[:at] + bytes([data[at] ^ (1 << int(rng.integers(8)))]) + data[at + 1 :]
        elif way == 3:
            data = b"\n".join(lines[:line] + lines[line + 1 :])
        elif way == 4:
            data = b"\n".join([*lines, lines[line]])
        elif way == 5:
            lines[line], lines[-1] = lines[-1], lines[line]
            data = b"\n".join(lines)
        elif way == 6 and words:
            del words[int(rng.integers(len(words)))]
            data = b"\n".join([*lines[:line], b" ".join(words), *lines[line + 1 :]])
        elif words:
            words[int(rng.integers(len(words)))] = TOKENS[rng.integers(len(TOKENS))].encode()
            data = b"\n".join([*lines[:line], (b"," if b"," in lines[line] else b" ").join(words), *lines[line + 1 :]])
    return data


def file_case(seed: int, number: int) -> Case:
    """A damaged file of one format: it is read, and used if it can be, or refused in a sentence."""
    rng = default_rng([seed, 1, number])
    originals = _originals()
    name = list(originals)[number % len(originals)]

    def check() -> list[str]:
        with tempfile.TemporaryDirectory() as folder:
            source, target = originals[name], Path(folder) / originals[name].name
            if source.is_dir():
                target.mkdir()
                victim = str(rng.choice(sorted(p.name for p in source.iterdir())))
                for path in source.iterdir():
                    content = path.read_bytes()
                    (target / path.name).write_bytes(damaged(rng, content) if path.name == victim else content)
            else:
                target.write_bytes(damaged(rng, source.read_bytes()))
            return _used(name, target)

    return f"file {number}: {name}", check


@cache
def _originals() -> dict[str, Path]:
    return seeds_of_formats(Path(tempfile.mkdtemp(prefix="fuzz-")))


def _used(name: str, path: Path) -> list[str]:
    """What is wrong after reading a file and using what it holds."""
    with warnings.catch_warnings():
        # readers warn of what they found
        warnings.simplefilter("ignore", UserWarning)
        if name == "config":
            read_config(path)
        elif name == "noise":
            read_noise(path)
        elif name == "study":
            read_study(path)
        elif name in DIALECTS:
            graph = Graph.from_g2o(path)
            return wrong_with(solve(graph, max_iterations=20), initialize="auto")
        else:
            log = load(path)
            arrays = (log.initial_poses, log.sightings, log.dt, log.controls)
            if not all(np.isfinite(a).all() for a in arrays if a is not None):
                return ["the log holds numbers that are not finite"]
            save(log, path.parent / "again.npz")
            if not load(path.parent / "again.npz").equals(log):
                return ["the log is another one after saving"]
            if log.num_poses < 200:
                edges = "landmark+motion" if log.controls is not None else "virtual"
                return wrong_with(
                    solve(Graph.from_log(log, edges=edges, kernel="none"), max_iterations=20), initialize="auto"
                )
    return []


# -- command lines -------------------------------------------------------------------------------------------------------


def command_case(seed: int, number: int) -> Case:
    """A random command line, mostly of possible words: exit status 0, 1 or 2, and never a traceback."""
    rng = default_rng([seed, 2, number])

    def one_of(values: Sequence[str]) -> str:
        return str(rng.choice(values))

    verb = one_of(sorted(typer.main.get_command(app()).commands))  # type: ignore[attr-defined]
    options = _flags(verb)
    words = [
        verb,
        *({"backends": ["graph.g2o"], "sweep": ["study.toml"], "study": ["study.toml"]}.get(verb, ["log.npz"])),
    ]
    if rng.random() < 0.2:
        words[1:] = [one_of(WORDS)] if rng.random() < 0.7 else []
    if verb in ("report", "animate", "simulate"):
        words[1 + (verb != "simulate") :] = [{"report": "out.html", "animate": "out.html"}.get(verb, "out.npz")]
    for _ in range(int(rng.integers(0, 5))):
        flag = one_of(sorted(options))
        words.append(flag)
        if (values := options[flag]) is not None:
            words.append(one_of(values if values and rng.random() < 0.75 else VALUES))
    # what keeps a case short
    small = {"run": "--estimators=dead-reckoning,graph", "report": "--estimators=dead-reckoning",
             "particles": "--particles=5", "consistency": "--logs=2", "animate": "--max-frames=2",
             "solvers": "--motion-weights=1", "simulate": "--steps=9"}  # fmt: skip
    if verb in small and not any(word.startswith(small[verb].split("=")[0]) for word in words):
        words += [small[verb]]
    if verb in ("particles", "sweep", "consistency", "solvers"):
        words += ["--jobs=1" if verb == "sweep" else "--jobs=0"]

    def check() -> list[str]:
        with tempfile.TemporaryDirectory() as folder, chdir(folder):
            for name, original in _originals().items():
                if original.is_file() and name in ("npz", "g2o", "config", "noise", "study"):
                    Path({"npz": "log"}.get(name, "graph" if name == "g2o" else name) + original.suffix).write_bytes(
                        original.read_bytes()
                    )
            Path("empty.txt").touch()
            warnings.simplefilter("ignore")
            result = CliRunner().invoke(app(), words)
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        if result.exit_code not in (0, 1, 2):
            return [f"exit status {result.exit_code}"]
        return ["a traceback"] if "Traceback" in result.output else []

    return f"command {number}: {' '.join(words)}", check


#: arguments
WORDS = ["log.npz", "graph.g2o", "config.toml", "study.toml", "nowhere", "empty.txt", "."]
#: values of options, most of them impossible for most options
VALUES = [
    "0",
    "-1",
    "1e-9",
    "1e9",
    "nan",
    "inf",
    "1e400",
    "",
    "x",
    "1,2",
    "a,b",
    "-",
    "/nowhere/x",
    "99999999999999999999",
    "true",
    "$$",
    "ü",
    "log.npz",
]
#: possible values by the type of the option
POSSIBLE = {int: ["1", "2", "3", "7"], float: ["0.5", "1", "2.5", "0.01"]}
#: and by the name of those that are texts or lists
TEXTS = {
    "--estimators": ["graph", "dead-reckoning,fastslam1", "mcl", "isam2", "textbook,gtsam"],
    "--filters": ["fastslam1", "mcl,fastslam2"], "--particles": ["1", "10,20"], "--figures": ["png", "pdf,svg"],
    "--motion-weights": ["1", "1,10"], "--json": ["out.json", "-"], "--baseline": ["graph"], "--noise": ["noise.toml"],
    "--way-points": ["4,-3 4,3"], "--start": ["1,1,0"], "--offset": ["0.1", "0.1,0.2"], "--config": ["config.toml"],
    "--figure": ["out.png", "out.pdf"], "--html": ["page.html"], "--out": ["folder"],
}  # fmt: skip


@cache
def app() -> Any:
    """The whole command line."""
    return make_app()


@cache
def _flags(verb: str) -> dict[str, list[str] | None]:
    """The options of a verb with possible values, as far as they are known; None for those that take none."""
    groups = [g for g in vars(declared).values() if isinstance(g, type) and issubclass(g, Options)]
    known = {o.flag: [*o.choices] or POSSIBLE.get(o.each, []) for group in groups for o in options_of(group).values()}
    flags: dict[str, list[str] | None] = {}
    for option in typer.main.get_command(app()).commands[verb].params:  # type: ignore[attr-defined]
        for flag in (*option.opts, *option.secondary_opts):
            # with --verbose a traceback is wanted, and a help ends the case
            if flag.startswith("--") and flag not in ("--verbose", "--help"):
                flags[flag] = None if option.is_flag else TEXTS.get(flag) or known.get(flag, [])
    return flags


# -- all cases -----------------------------------------------------------------------------------------------------------


class TooLong(BaseException):
    """A case has reached its limit of time."""


def _too_long(*_: object) -> None:
    raise TooLong


def attempt(check: Callable[[], list[str]], limit: int = 20) -> tuple[str, list[str]]:
    """ "solved" or the sentence of the refusal, and what is wrong: problems that the check returned, or an exception."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        before = signal.signal(signal.SIGALRM, _too_long)
        signal.alarm(limit)
        try:
            return "solved", check()
        except TooLong:
            # what is asked for may take for ever, such as 10^9 seeds
            return f"longer than {limit} s", []
        except SlamError as error:
            text = str(error)
            return "refused", ["an error of several lines: " + text] if "\n" in text.strip() or not text else []
        except Exception as error:
            frames = [f for f in traceback.extract_tb(error.__traceback__) if "site-packages" not in f.filename]
            where = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}"
            return "failed", [f"{type(error).__name__} in {where}: {error}"]
        finally:
            signal.alarm(0)
            signal.signal(signal.SIGALRM, before)


SUITES: dict[str, Callable[[int, int], Case]] = {"graphs": graph_case, "files": file_case, "commands": command_case}
#: as many files of each of the 13 formats as are asked for
COUNTS = {"graphs": 2000, "files": 13_000, "commands": 300}


def main() -> int:
    """Run the cases and print what fails."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("suites", nargs="*", help=f"of {', '.join(SUITES)}; default: all")
    parser.add_argument("--count", type=int, help="cases of each")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, help="run this case alone")
    arguments = parser.parse_args()
    failed = 0
    for suite in arguments.suites or SUITES:
        begin, outcomes, slowest = time.perf_counter(), Counter(), (0.0, "")
        numbers = range(arguments.count or COUNTS[suite]) if arguments.only is None else [arguments.only]
        for number in numbers:
            name, check = SUITES[suite](arguments.seed, number)
            start = time.perf_counter()
            outcome, problems = attempt(check)
            slowest = max(slowest, (time.perf_counter() - start, name))
            outcomes[outcome] += 1
            failed += bool(problems)
            for problem in problems:
                print(f"{name}\n    {problem[:300]}", flush=True)
        counts = ", ".join(f"{count} {outcome}" for outcome, count in outcomes.items())
        print(f"{suite}: {counts}; {time.perf_counter() - begin:.0f} s, slowest {slowest[0]:.1f} s ({slowest[1]})")
    print(f"{failed} cases failed")
    return failed > 0


if __name__ == "__main__":
    sys.exit(main())
