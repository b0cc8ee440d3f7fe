"""All-pairs virtual edges at their largest: 2,000 poses, 40 landmarks, each seen by all, 80 million pairs.

    python benchmarks/clique.py

Omega is assembled and solved once; the pairs are visited, not listed. The factorisation is held against SciPy's dense
Cholesky of the same size, in the same run.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import time

import numpy as np
import scipy.linalg

from graphslam import Graph, Log, SensorModel


def clique_log(poses: int, landmarks: int) -> Log:
    """Poses on a circle that all see all landmarks, with a little noise."""
    rng = np.random.default_rng(0)
    angle = np.linspace(0, 2 * np.pi, poses, endpoint=False)
    truth = np.column_stack([10 * np.cos(angle), 10 * np.sin(angle), angle + np.pi])
    places = np.column_stack([rng.uniform(-4, 4, (landmarks, 2)), rng.uniform(-np.pi, np.pi, landmarks)])
    sensor = SensorModel()
    steps, ids = np.repeat(np.arange(poses), landmarks), np.tile(np.arange(landmarks), poses)
    z = sensor.h(truth[steps], places[ids])
    z += rng.normal(size=z.shape) * [0.01, 0.005, 0.005]
    return Log(initial_poses=truth, steps=steps, landmarks=ids, sightings=z)


def median_of(function, repeat: int = 3) -> float:
    """The median time of a few calls [s]."""
    times = []
    for _ in range(repeat):
        begin = time.perf_counter()
        function()
        times.append(time.perf_counter() - begin)
    return statistics.median(times)


def main() -> None:
    """Print what the goals name."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    warm = Graph.from_log(clique_log(50, 5), edges="virtual", kernel="none")
    system, _ = warm.linearize(warm.initial)
    system.factorize().solve(system.xi)
    graph = Graph.from_log(clique_log(2000, 40), edges="virtual", kernel="none")
    print(f"{graph.num_nodes} poses, {graph.num_edges / 1e6:.1f} million pairs")
    begin = time.perf_counter()
    graph.system.symbolic  # noqa: B018
    pattern = time.perf_counter()
    system, _ = graph.linearize(graph.initial)
    assembled = time.perf_counter()
    delta = system.factorize().solve(system.xi)
    solved = time.perf_counter()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"pattern and ordering {pattern - begin:.2f} s, assembly {assembled - pattern:.2f} s", end="")
    print(
        f", factorisation and solution {solved - assembled:.2f} s: {solved - begin:.2f} s in all, peak {peak:.2f} GiB"
    )
    dense = system.to_sparse().toarray()
    residual = np.linalg.norm(dense @ delta.ravel() - system.xi.ravel()) / np.linalg.norm(system.xi)
    print(f"residual of the linear solve {residual:.1e}")
    ours = median_of(lambda: system.factorize())
    scipys = median_of(lambda: scipy.linalg.cholesky(dense, lower=True))
    print(
        f"factorisation {ours:.2f} s, scipy.linalg.cholesky of the same size {scipys:.2f} s: ratio {ours / scipys:.2f}"
    )


if __name__ == "__main__":
    main()
