"""How often, how tightly and how fast ends are proven to be global minima: the table of docs/beyond/certificate.md.

    python benchmarks/certificate.py [--data ../shared/data] [--logs 500] [--graphs 1000] [--only public,logs,...]

Sections: ``public`` (pose graphs of files), ``book`` (sample log and the book's logs), ``logs`` (simulated logs with half to
twice the book's noise), ``landmarks`` (landmark nodes without psi, simulated and real), ``false`` (random small graphs of
relative poses, points and anchors, against the best of many starts), ``search`` (graphs of 3 to 6 poses against a grid over
all headings) and ``auto`` (ends of `solve` against those from the truth). Times are CPU times of one thread, which other work
on the machine changes little.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from comparisons.datasets import data_folder
from graphslam import (
    Certificate,
    Graph,
    GraphError,
    Log,
    MotionModel,
    SlamError,
    load,
    sample_log_path,
    simulate,
    solve,
)
from graphslam.edges import AnchorEdges, RelativePointEdges, RelativePoseEdges
from graphslam.se2 import Array, between, wrap
from graphslam.simulation.simulator import MotionFaults, SensorFaults
from graphslam.solvers.certificate import prove

PUBLIC = (
    "input_INTEL_g2o.g2o", "input_M3500_g2o.g2o", "CSAIL.g2o", "city10000.g2o", "dlr.g2o", "simulation-pose-landmark.g2o",
    "cityTrees10000.txt", "../victoria_park/victoriaPark_isam.txt",
)  # fmt: skip


def cpu(work: Callable[[], object], repeat: int = 5) -> float:
    """The least CPU time of a few calls [ms]."""
    times = []
    for _ in range(repeat):
        begin = time.process_time()
        work()
        times.append(time.process_time() - begin)
    return 1e3 * min(times)


def show(name: str, graph: Graph) -> None:
    """Solve a graph, prove the end, and print a row."""
    solution = solve(graph)
    proof = solution.certificate

    def iteration() -> None:
        system, _ = graph.linearize(solution.state)
        system.factorize().solve(system.xi)

    check, step = cpu(lambda: prove(graph, solution.state)), cpu(iteration)
    print(
        f"{name:44s} J {solution.cost:12.6g} {proof.status:11s} gap {proof.relative_gap:.1e}  check {check:7.2f} ms, "
        f"iteration {step:6.2f} ms",
        flush=True,
    )


def public(data: Path) -> None:
    """Pose graphs of files."""
    for name in PUBLIC:
        show(Path(name).name, Graph.from_g2o(data / "posegraph" / name))


def book(data: Path) -> None:
    """The sample log and the book's logs."""
    paths = [sample_log_path(), data / "lnpr" / "log_for_book.txt", data / "lnpr" / "log2_for_book.txt"]
    for log in map(load, paths):
        for edges in ("virtual", "virtual+motion") if log.controls is not None else ("virtual",):
            for weight in ("pairs", "tempered", "marginal"):
                show(f"{log.name} {edges} {weight}", Graph.from_log(log, edges=edges, weight=weight, kernel="none"))


def noisy(seed: int) -> Log:
    """A log with half to twice the book's noise."""
    f = 2 ** np.random.default_rng(seed).uniform(-1, 1)
    sensor = {name: f * value for name, value in vars(SensorFaults()).items() if "noise" in name or "bias" in name}
    motion = MotionFaults(kick_std=f * np.pi / 60, velocity_bias_std=0.1 * f)
    return simulate(motion_faults=motion, sensor_faults=SensorFaults(**sensor), seed=seed)


def share(name: str, count: int, **options: Any) -> None:
    """The share of the solved simulated logs whose end is proven."""
    outcome: Counter[str] = Counter()
    worst = 0.0
    for seed in range(count):
        try:
            solution = solve(Graph.from_log(noisy(seed), **options))
        except GraphError:
            outcome["not determined"] += 1
            continue
        proof = solution.certificate
        outcome[proof.status if solution.converged else "not converged"] += 1
        worst = max(worst, proof.relative_gap if proof.status == "global" else 0.0)
    solved = count - outcome["not determined"]
    print(
        f"{name:44s} {outcome['global'] / solved:.1%} of {solved} proven, worst gap {worst:.1e}; {dict(outcome)}",
        flush=True,
    )


def logs(count: int) -> None:
    """Simulated logs with psi."""
    for weight in ("pairs", "tempered", "marginal"):
        share(f"virtual {weight}", count, edges="virtual", weight=weight)
        share(f"virtual+motion {weight}", count, edges="virtual+motion", weight=weight)
    share("virtual+motion pairs, epsilon 1e-8", count, edges="virtual+motion", motion=MotionModel(epsilon=1e-8))


def landmarks(data: Path, count: int) -> None:
    """Landmark nodes without psi, simulated and real."""
    share("landmark nodes without psi", count, edges="landmark+motion", dimensions=2)
    for robot in (1, 3):
        for epsilon in (1e-4, 1e-8):
            log = load(data / "mrclam6", robot=robot)
            graph = Graph.from_log(log, edges="landmark+motion", motion=MotionModel(epsilon=epsilon), kernel="none")
            show(f"MR.CLAM 6 robot {robot}, epsilon {epsilon:g}", graph)
    for folder in ("simulated_535", "simulated_8240", "lost_in_the_woods"):
        show(folder, Graph.from_log(load(data / folder), edges="landmark+motion", kernel="none"))


def auto(count: int) -> None:
    """Ends of `solve` above the better one of those from the truth and from the given values."""
    outcome: Counter[str] = Counter()
    for seed in range(count):
        log = noisy(seed)
        graph = Graph.from_log(log, edges="landmark+motion", dimensions=2, kernel="none")
        assert log.true_poses is not None and log.true_landmarks is not None
        places = [np.append(log.true_landmarks[j][:2], 0.0) for j in graph.landmark_ids.tolist()]
        truth = np.concatenate([log.true_poses[graph.steps], places])
        starts = (graph.with_initial(truth), graph)
        best = min(solve(start, initialize="given").cost for start in starts)
        solution = solve(graph)
        where = "above" if solution.cost > best * (1 + 1e-6) else "not above"
        outcome[f"{where}, {solution.certificate.status}"] += 1
    print(f"auto on {count} logs without psi: {dict(outcome)}")


def random_information(rng: np.random.Generator, d: int, spread: float) -> Array:
    """Information with eigenvalues from 10^-spread to 10^spread, in turned axes or not."""
    axes = np.linalg.qr(rng.normal(size=(d, d)))[0] if rng.random() < 0.7 else np.eye(d)
    W: Array = axes @ np.diag(10 ** rng.uniform(-spread, spread, d)) @ axes.T
    return (W + W.T) / 2


def random_graph(rng: np.random.Generator) -> Graph:
    """2 to 6 poses and up to 2 points in one to three pieces.

    Any noise, wrong loop closures, several edges between two poses, poses in one place or far away from the origin,
    residuals near half a turn.
    """
    n, spread, noise = int(rng.integers(2, 7)), rng.choice([0, 1, 3, 6]), rng.choice([0, 0.01, 0.3, 1, 3])
    poses = np.column_stack([rng.normal(size=(n, 2)) * rng.choice([0, 1, 100]), rng.uniform(-np.pi, np.pi, n)])
    if rng.random() < 0.25:
        poses[:, :2] += rng.normal(size=2) * 10 ** rng.uniform(3, 8)
    num_points = int(rng.integers(0, 3)) if rng.random() < 0.4 else 0
    points = rng.normal(size=(num_points, 2)) * 3
    whole = rng.random() < 0.8
    pairs = [(k, k + 1) for k in range(n - 1) if whole or k == 0 or rng.random() < 0.6]
    pairs += [tuple(rng.choice(n, 2, replace=False)) for _ in range(rng.integers(0, 2 * n))]
    first, second = np.array(pairs).T
    if rng.random() < 0.2:
        copies = rng.integers(0, len(first), 4)
        first, second = np.append(first, first[copies]), np.append(second, second[copies])
    measured = between(poses[first], poses[second]) + noise * rng.normal(size=(len(first), 3))
    wrong = rng.random(len(first)) < rng.choice([0, 0.3])
    count = int(wrong.sum())
    measured[wrong] = np.column_stack([rng.normal(size=(count, 2)) * 3, rng.uniform(-np.pi, np.pi, count)])
    if rng.random() < 0.15:
        quarter = np.round(measured[:, 2] / np.pi * 2) * np.pi / 2
        measured[:, 2] = wrap(quarter + rng.choice([0, 1e-9, 1e-6]))
    information = np.array([random_information(rng, 3, spread) * 10 ** (rng.normal() * (spread > 3)) for _ in first])
    families: list[Any] = [RelativePoseEdges(first, second, measured, information)]
    if num_points:
        first, second = np.repeat(np.arange(n), num_points), n + np.tile(np.arange(num_points), n)
        places = np.column_stack([points[second - n], np.zeros(len(second))])
        seen = between(poses[first], places)[:, :2] + noise * rng.normal(size=(len(first), 2))
        information = np.array([random_information(rng, 2, spread) for _ in first])
        families.append(RelativePointEdges(first, second, seen, information))
    fixed = np.zeros(1, dtype=int)
    if rng.random() < 0.3:
        count = int(rng.integers(1, 3))
        held = poses[rng.integers(0, n, count)] + noise * rng.normal(size=(count, 3))
        information = np.array([random_information(rng, 3, spread) for _ in range(count)])
        families.append(AnchorEdges(rng.integers(0, n, count), held, information))
        fixed = np.zeros(0, dtype=int)
    return Graph(
        np.concatenate([poses, np.pad(points, ((0, 0), (0, 1)))]), families=tuple(families), steps=np.arange(n),
        trajectory=poses, pose_ids=np.arange(n), landmark_ids=np.arange(num_points), fixed=fixed,
    )  # fmt: skip


def candidates(graph: Graph, rng: np.random.Generator, count: int) -> Iterator[Array]:
    """Ends from random headings, some after three steps only, and disturbed ends."""
    poses, free = len(graph.steps), ~np.isin(np.arange(graph.num_nodes), graph.fixed)
    for k in range(count):
        state = graph.initial.copy()
        if k:
            state[:, :2] += rng.normal(size=(len(state), 2)) * rng.choice([0, 1, 10])
            state[:poses, 2] = rng.uniform(-np.pi, np.pi, poses)
        state[graph.fixed] = graph.initial[graph.fixed]
        method, steps = str(rng.choice(["gauss-newton", "levenberg-marquardt"])), int(rng.choice([3, 100, 100]))
        try:
            end = solve(graph.with_initial(state), initialize="given", method=method, max_iterations=steps)
        except SlamError:
            continue
        disturbed = end.state + rng.choice([1e-9, 1e-6, 1e-3]) * rng.normal(size=state.shape) * free[:, None]
        for each in (end.state, disturbed) if rng.random() < 0.15 else (end.state,):
            if np.isfinite(each).all() and np.isfinite(graph.cost(each)):
                yield each


def exact_cost(graph: Graph, state: Array) -> float:
    """J in extended precision; the cost in double precision has errors of 1e-11 of it for very unequal information."""
    wide, pi = np.longdouble, np.longdouble("3.14159265358979323846264338327950288")
    total = wide(0)
    for family in graph.families:
        edges = family.constant(state)
        for k, (a, b) in enumerate(zip(edges.first, edges.second)):
            x = state[a].astype(wide) if a >= 0 else np.zeros(3, wide)
            y, start, end = state[b].astype(wide), edges.start[k].astype(wide), edges.end[k].astype(wide)
            c, s = np.cos(y[2]), np.sin(y[2])
            d = y[:2] - x[:2] + [c * end[0] - s * end[1], s * end[0] + c * end[1]]
            c, s = np.cos(x[2]), np.sin(x[2])
            e = [c * d[0] + s * d[1] - start[0], c * d[1] - s * d[0] - start[1]]
            if edges.turn is not None:
                turn = y[2] - x[2] - wide(edges.turn[k])
                e.append(turn - 2 * pi * np.floor((turn + pi) / (2 * pi)))
            v = np.array(e)
            total += v @ (edges.information[k].astype(wide) @ v)
    return float(total)


def rounding(graph: Graph, state: Array, rng: np.random.Generator) -> float:
    """The highest cost of ten states that differ from a state in the last four bits of their coordinates."""
    size = 2.0**-48 * np.maximum(np.abs(state), [0.0, 0.0, np.pi])
    return max(exact_cost(graph, state + size * rng.uniform(-1, 1, state.shape)) for _ in range(10))


def faults(graph: Graph, states: list[Array], proofs: list[Certificate], rng: np.random.Generator) -> Iterator[str]:
    """What the proofs for some states of a graph claim wrongly, judged by the costs of these states in extended precision."""
    costs = [exact_cost(graph, state) for state in states]
    lowest = min(costs, default=0.0)
    for state, cost, proof in zip(states, costs, proofs):
        if proof.lower_bound > lowest * (1 + 1e-15):
            yield f"bound {proof.lower_bound!r} above the cost {lowest!r}"
        if proof.status == "global" and cost > lowest * (1 + 1.1e-6) and cost > lowest + rounding(graph, state, rng):
            yield f"proof of the cost {cost!r} in spite of {lowest!r}"


def false_proofs(graphs: int) -> None:
    """No lower bound may lie above the lowest cost of any candidate, and no higher candidate may be proven."""
    outcome: Counter[str] = Counter()
    for seed in range(graphs):
        rng = np.random.default_rng(seed)
        graph = random_graph(rng)
        states = list(candidates(graph, rng, 14))
        proofs = [prove(graph, state) for state in states]
        costs = [graph.cost(state) for state in states]
        outcome.update(proof.status for proof in proofs)
        outcome["above the lowest"] += sum(cost > min(costs) * (1 + 1e-6) for cost in costs)
        for fault in faults(graph, states, proofs, rng):
            outcome["faults"] += 1
            print(f"graph {seed}: {fault}")
    print(f"{graphs} random graphs, {outcome['global'] + outcome['not proven']} states: {dict(outcome)}")


def small_graph(rng: np.random.Generator) -> Graph:
    """3 to 6 poses with odometry and loop closures, one of five of them wrong, and anisotropic information."""
    n, noise = int(rng.integers(3, 7)), rng.choice([0.1, 0.5, 1.5])
    poses = np.column_stack([rng.normal(size=(n, 2)) * 2, rng.uniform(-np.pi, np.pi, n)])
    first, second = np.array([(i, j) for i in range(n) for j in range(i + 1, n) if j == i + 1 or rng.random() < 0.5]).T
    measured = between(poses[first], poses[second]) + noise * rng.normal(size=(len(first), 3)) * [1, 1, 0.5]
    wrong = rng.random(len(first)) < 0.2 * (second > first + 1)
    measured[wrong, 2] += rng.uniform(-np.pi, np.pi, int(wrong.sum()))
    measured[:, 2] = wrap(measured[:, 2])
    information = np.array([random_information(rng, 3, 0.7) for _ in first])
    return Graph(
        poses, families=(RelativePoseEdges(first, second, measured, information),), steps=np.arange(n), trajectory=poses,
        pose_ids=np.arange(n), fixed=np.zeros(1, dtype=int),
    )  # fmt: skip


def best_positions(graph: Graph, headings: Array) -> tuple[Array, Array]:
    """The lowest cost (K,) for given headings (K, n), and the positions (K, n, 2): a linear problem for each row."""
    (edges,) = graph.families
    assert isinstance(edges, RelativePoseEdges)
    a, b, n = edges.first, edges.second, graph.num_nodes
    c, s = np.cos(headings[:, a]), np.sin(headings[:, a])
    # e = (R(theta_a)' (p_b - p_a) - t, e_theta) = B p + r with B (K, E, 3, 2n)
    turn = np.stack([np.stack([c, s], -1), np.stack([-s, c], -1), np.zeros((*c.shape, 2))], axis=-2)
    B = np.zeros((len(headings), len(a), 3, 2 * n))
    for e in range(len(a)):
        B[:, e, :, 2 * b[e] : 2 * b[e] + 2] = turn[:, e]
        B[:, e, :, 2 * a[e] : 2 * a[e] + 2] = -turn[:, e]
    held, B = B[..., :2] @ graph.initial[0, :2], B[..., 2:]
    r = np.broadcast_to(-edges.measured, held.shape).copy()
    r[..., 2] = wrap(headings[:, b] - headings[:, a] - edges.measured[:, 2])
    r += held
    weighted = np.einsum("eij,kejp->keip", edges.information, B)
    H, g = np.einsum("keip,keiq->kpq", B, weighted), np.einsum("keip,kei->kp", weighted, r)
    p = -np.linalg.solve(H, g[..., None])[..., 0]
    cost = np.einsum("kei,eij,kej->k", r, edges.information, r) + np.einsum("kp,kp->k", g, p)
    start = np.broadcast_to(graph.initial[0, :2], (len(p), 1, 2))
    return cost, np.concatenate([start, p.reshape(len(p), n - 1, 2)], axis=1)


def searched(graph: Graph, rng: np.random.Generator) -> Array:
    """The lowest state among the ends from the best 12 of about 4,000 headings on a grid."""
    n = graph.num_nodes
    count = int(np.floor(4100 ** (1 / (n - 1))))
    axis = np.arange(count) * 2 * np.pi / count
    grid = np.stack(np.meshgrid(*[axis + rng.uniform(-np.pi, np.pi) for _ in range(n - 1)]), axis=-1).reshape(-1, n - 1)
    headings = np.column_stack([np.full(len(grid), graph.initial[0, 2]), wrap(grid)])
    cost, places = best_positions(graph, headings)
    best, lowest = graph.initial, np.inf
    for k in np.argsort(cost)[:12]:
        start = np.column_stack([places[k], headings[k]])
        try:
            end = solve(graph.with_initial(start), initialize="given", method="levenberg-marquardt")
        except SlamError:
            continue
        if end.cost < lowest:
            best, lowest = end.state, end.cost
    return best


def global_search(graphs: int) -> None:
    """Small graphs against a grid over all headings with refinement: no proof may be contradicted."""
    outcome: Counter[str] = Counter()
    for seed in range(graphs):
        rng = np.random.default_rng([7, seed])
        graph = small_graph(rng)
        state, solution = searched(graph, rng), solve(graph)
        lowest = graph.cost(state)
        for name, proof, cost in (
            ("solve", solution.certificate, solution.cost),
            ("search", prove(graph, state), graph.cost(state)),
            ("given", prove(graph, graph.initial), graph.cost(graph.initial)),
        ):
            outcome[f"{name} {proof.status}"] += 1
            # graphs without loops have J = 0 up to rounding
            wrong = proof.status == "global" and cost > lowest * (1 + 1.1e-6) + 1e-12
            outcome["contradicted"] += wrong or proof.lower_bound > lowest * (1 + 1e-12) + 1e-12
        outcome["solve above the search"] += solution.cost > lowest * (1 + 1e-6) + 1e-12
        outcome["solve below the search"] += solution.cost < lowest * (1 - 1e-6) - 1e-12
    print(f"{graphs} small graphs: {dict(outcome)}")


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=None, help="folder of the data sets (default: ../shared/data)")
    parser.add_argument("--logs", type=int, default=500, help="number of simulated logs (default: 500)")
    parser.add_argument("--graphs", type=int, default=1000, help="number of random graphs (default: 1000)")
    everything = "public,book,logs,landmarks,false,search,auto"
    parser.add_argument("--only", default=everything, help="sections, with commas between")
    given = parser.parse_args()
    data = given.data or data_folder()
    sections: dict[str, Callable[[], None]] = {
        "public": lambda: public(data), "book": lambda: book(data), "logs": lambda: logs(given.logs),
        "landmarks": lambda: landmarks(data, 2 * given.logs // 5), "false": lambda: false_proofs(given.graphs),
        "search": lambda: global_search(given.graphs),
        "auto": lambda: auto(2 * given.logs // 5),
    }  # fmt: skip
    for name in given.only.split(","):
        print(f"--- {name}")
        sections[name]()


if __name__ == "__main__":
    main()
