"""Wrong sightings step by step: does a landmark whose first sighting is wrong stay there, and is J that of the batch solver?

    python benchmarks/online_outliers.py [--drives 40] [--first 0]

Drives of 80 steps among 15 landmarks; a part of the sightings is anywhere in the field of view. A landmark with at least five
right sightings counts as wrong where it ends more than a metre off.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from graphslam import Graph, Log, MotionModel, SensorModel, simulate, solve, solve_online

MODELS: dict[str, Any] = {
    "motion": MotionModel(nn=0.05, no=0.001, on=0.02, oo=0.05, epsilon=1e-6),
    "sensor": SensorModel(range_rate=0.0, range_std=0.05, bearing_std=0.02),
}
REACH = 8.0
#: kernel, part of the sightings that are wrong, whether these have psi, and options of the online solver
CASES: tuple[tuple[str, float, bool, dict[str, Any]], ...] = (
    ("cauchy", 0.02, False, {}),
    ("cauchy", 0.05, False, {}),
    ("cauchy", 0.1, False, {}),
    ("geman-mcclure", 0.1, False, {}),
    ("huber", 0.1, False, {}),
    ("cauchy", 0.05, True, {}),
    ("cauchy", 0.05, False, {"lag": 10}),
    ("cauchy", 0.05, False, {"lag": 30}),
    ("cauchy", 0.05, False, {"backend": "isam2", "edges": "landmark+motion"}),
)


def drive(seed: int, wrong: float, psi: bool) -> tuple[Log, np.ndarray]:
    """A log, and which of its sightings are wrong (M,)."""
    log = simulate(
        seed=seed, steps=80, clean=True, orientation=psi, landmarks=15, arena=10.0, max_range=REACH, **MODELS
    ).replace(**MODELS)
    rng = np.random.default_rng(seed)
    chosen = rng.random(len(log.steps)) < wrong
    sightings = log.sightings.copy()
    angles = rng.uniform(-np.pi, np.pi, (chosen.sum(), sightings.shape[1] - 1))
    sightings[chosen] = np.column_stack([rng.uniform(0.3, REACH, chosen.sum()), angles])
    return log.replace(sightings=sightings), chosen


def misplaced(log: Log, wrong: np.ndarray, landmarks: Any) -> tuple[int, int]:
    """How many landmarks are more than a metre off, of how many that have five right sightings."""
    assert log.true_landmarks is not None
    right = [j for j in landmarks if np.sum((log.landmarks == j) & ~wrong) >= 5]
    off = [np.hypot(*(landmarks[j] - log.true_landmarks[j])[:2]) > 1.0 for j in right]
    return int(np.sum(off)), len(right)


def main() -> None:
    """Solve the drives and print a line for each case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drives", type=int, default=40, help="how many drives for each case")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    arguments = parser.parse_args()
    for kernel, part, psi, options in CASES:
        counts, gaps = np.zeros((2, 2), dtype=int), []
        for seed in range(arguments.first, arguments.first + arguments.drives):
            log, wrong = drive(seed, part, psi)
            graph = Graph.from_log(log, edges="landmark+motion", kernel=kernel)
            ends = solve_online(log, kernel=kernel, **options), solve(graph)
            counts += [misplaced(log, wrong, end.landmarks) for end in ends]
            gaps.append(ends[0].cost / ends[1].cost - 1)
        which = f"{kernel}, {part:.0%} wrong{', psi' if psi else ''}{''.join(f', {k} {v}' for k, v in options.items())}"
        # with a lag J is unknown
        above = "" if np.isnan(gaps).any() else f"; J at most {max(gaps):.1e} above that of the batch"
        print(f"{which}: {counts[0, 0]} of {counts[0, 1]} misplaced, batch {counts[1, 0]}{above}", flush=True)


if __name__ == "__main__":
    main()
