"""Landmarks of a map that have moved, are gone or are new: `graphslam.association.map_states.map_states` on simulated drives.

    python benchmarks/map_states.py [--first 1000] [--drives 100] [--changed 3]

A first drive makes the map of 30 landmarks. In the second, ``changed`` of its landmarks have moved by 0.3 to 2 m, as many are
gone, and as many are new. Noise is that of the book. The prior probability of a change is
the share of changed landmarks, so that the stated probabilities should be those with which they are true.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from typing import Any

import numpy as np

from graphslam import Graph, LandmarkMap, Log, simulate, solve
from graphslam.association.map_states import map_states
from graphslam.metrics import ate

COUNT = 30
WORLD: dict[str, Any] = {"arena": 8.0, "steps": 100, "clean": True}


def drives(seed: int, changed: int, orientation: bool) -> tuple[LandmarkMap, Log, dict[str, list[int]]]:
    """The map of a first drive, the log of a second one with the same ids, and what was changed."""
    rng = np.random.default_rng(seed)
    first = simulate(seed=seed, landmarks=COUNT, orientation=orientation, **WORLD)
    assert first.true_landmarks is not None
    known = solve(Graph.from_log(first, edges="landmark+motion")).map
    places = {j: np.array(place) for j, place in first.true_landmarks.items() if j in known}
    chosen = rng.permutation(list(places))[: 2 * changed].tolist()
    moved, gone = chosen[:changed], chosen[changed:]
    for j in moved:
        way, angle = rng.uniform(0.3, 2.0), rng.uniform(-np.pi, np.pi)
        places[j][:2] += way * np.array([np.cos(angle), np.sin(angle)])
    new = [max(first.true_landmarks) + 1 + k for k in range(changed)]
    for j in new:
        places[j] = np.append(rng.uniform(-5, 5, 2), np.zeros(int(orientation)))
    for j in gone:
        del places[j]
    ids = sorted(places)
    second = simulate(seed=10_000 + seed, landmarks=[places[j].tolist() for j in ids], orientation=orientation, **WORLD)
    second = second.replace(landmarks=np.array(ids)[second.landmarks], true_landmarks={j: places[j] for j in ids})
    return known, second, {"moved": moved, "vanished": gone, "new": new}


def main() -> None:
    """Print the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--drives", type=int, default=100)
    parser.add_argument("--changed", type=int, default=3)
    options = parser.parse_args()
    for orientation in (True, False):
        table: Counter[tuple[str, str]] = Counter()
        stated: dict[str, list[tuple[float, bool]]] = {"moved": [], "vanished": []}
        errors, seconds = [], []
        for seed in range(options.first, options.first + options.drives):
            known, log, changed = drives(seed, options.changed, orientation)
            begin = time.perf_counter()
            found = map_states(log, known, prior=options.changed / COUNT)
            seconds.append(time.perf_counter() - begin)
            true = {j: name for name, each in changed.items() for j in each}
            for each in found.landmarks:
                right = true.get(each.id, "agrees")
                table[right, each.state] += 1
                if each.chi_square is not None and each.moved is not None:
                    stated["moved"].append((each.moved, right == "moved"))
                elif each.vanished is not None and right != "moved":
                    stated["vanished"].append((each.vanished, right == "vanished"))
            whole = solve(Graph.from_log(log, map=known))
            assert log.true_poses is not None
            clean = known.among(set(known) - set(changed["moved"]))
            best = solve(Graph.from_log(log, map=clean))
            errors.append([ate(log.true_poses, each.poses) for each in (whole, found.solution, best)])
        print(f"{options.drives} drives {'with' if orientation else 'without'} psi, {np.median(seconds):.2f} s each")
        for (right, state), count in sorted(table.items()):
            print(f"  {right:9} said to be {state:12} {count:5}")
        for name, pairs in stated.items():
            p, hit = np.array(pairs, dtype=float).T
            for low, high in ((0, 0.01), (0.01, 0.1), (0.1, 0.5), (0.5, 0.9), (0.9, 0.99), (0.99, 1.01)):
                within = (p >= low) & (p < high)
                if within.any():
                    print(
                        f"  {name}: stated {low:.2f} to {min(high, 1):.2f}, mean {p[within].mean():.3f}; "
                        f"true {hit[within].mean():.3f} of {within.sum()}"
                    )
        means = np.mean(errors, axis=0)
        print(
            f"  ATE with the whole map {means[0]:.3f}, with what was found {means[1]:.3f}, with the truth {means[2]:.3f} m"
        )


if __name__ == "__main__":
    main()
