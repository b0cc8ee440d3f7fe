"""Random graphs: no traceback, no NaN, no false "converged", no end above the start."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator, default_rng

from graphslam import Graph, Log, MotionModel, SensorModel, SlamError, Solution, solve, textbook
from graphslam.se2 import between, inverse, transform

from .attempt import Case

#: J may be above its minimum by this part where a solution is called converged
PART = 1e-6


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
        "kernel": [None, None, "huber", "cauchy", "geman-mcclure"][rng.integers(5)],
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
            return wrong_with(solve(graph, method="gnc"), initialize="gnc")
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
        covariances = solution.covariance()[solution.estimated]
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
