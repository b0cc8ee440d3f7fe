"""Integrity: of the poses for which the probability p of being off was said, is that share off?

    python benchmarks/integrity.py [--first 1000] [--drives 40] [--landmarks 100] [--figure reliability.png]

The world is that of `fix_without_ids.py`, with one landmark on 16 m², and drives often leave the map. The robot does not
know where it begins, and its solver (`OnlineSolver(map=...)`) is asked at every pose. Afterwards the solution of the whole
drive is asked. Places of the map are off by 2 cm, with "map" and "wrong map" by 10 cm, which the map says but for the latter.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from fix_without_ids import MOTION as WITH_EPSILON
from fix_without_ids import SENSOR, drive, one_after_the_other

from graphslam import Graph, GraphError, LandmarkMap, Log, OnlineSolver, solve
from graphslam.se2 import wrap

#: without the centimetre that the model adds at each step, which these drives do not have
MOTION = replace(WITH_EPSILON, epsilon=1e-7)
#: [m] and [degrees]
BOUNDS = ((0.05, 1.0), (0.1, 2.0), (0.3, 5.0), (1.0, 20.0))
BINS = (0.0, 1e-4, 1e-3, 1e-2, 0.1, 0.3, 0.7, 1.0)
WORLDS = ("ids", "no ids", "noise", "lifted", "map", "wrong map")


def world(name: str, seed: int, landmarks: int) -> tuple[Log, LandmarkMap, np.ndarray]:
    """A drive, its map, and the true poses; a tenth of the sightings is clutter."""
    rng = np.random.default_rng(seed)
    size = float(np.sqrt(16 * landmarks))
    places = rng.uniform(0, size, (landmarks, 2))
    parts = [drive(rng, places, size, 0.1, with_ids=name != "no ids") for _ in range(1 + (name == "lifted"))]
    log = one_after_the_other([part[0] for part in parts]) if name == "lifted" else parts[0][0]
    std = 0.02 if name not in ("map", "wrong map") else 0.1
    places = places + std * rng.normal(size=places.shape)
    said = None if name == "wrong map" else {k: std**2 * np.eye(2) for k in range(landmarks)}
    known = LandmarkMap(dict(enumerate(places)), said)
    return log, known, np.concatenate([part[2] for part in parts])


def asked(name: str, seed: int, landmarks: int) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Who was asked, the probabilities (T+1, B) for the bounds, and whether poses were off."""
    log, known, true = world(name, seed, landmarks)
    sensor = SENSOR
    if name == "noise":
        # the robot has one and a half times the noise that its model says
        sensor = replace(SENSOR, range_rate=SENSOR.range_rate / 1.5, bearing_std=SENSOR.bearing_std / 1.5)

    def off(poses: np.ndarray) -> np.ndarray:
        way = np.hypot(*(poses - true[: len(poses)])[:, :2].T)
        turn = np.abs(wrap(poses[:, 2] - true[: len(poses), 2]))
        return np.column_stack([(way > m) | (turn > np.radians(d)) for m, d in BOUNDS])

    solver = OnlineSolver(map=known, motion=MOTION, sensor=sensor, kernel="cauchy")
    risks, poses = [], []
    for step in range(log.num_poses):
        if step:
            assert log.controls is not None and log.dt is not None
            solver.move(log.controls[step - 1], log.dt[step - 1])
        now = log.steps == step
        if now.any():
            solver.observe(log.landmarks[now] if log.identified else None, log.sightings[now])
        risks.append([solver.integrity_risk(m, np.radians(d)) for m, d in BOUNDS])
        poses.append(solver.pose)
    yield "while driving", np.array(risks), off(np.array(poses))
    try:
        solution = solve(Graph.from_log(log, map=known, motion=MOTION, sensor=sensor, kernel="cauchy"))
    except GraphError:
        return
    risk = np.column_stack([solution.integrity_risk(m, np.radians(d)) for m, d in BOUNDS])
    yield "after the drive", risk, off(solution.poses)


def main() -> None:
    """Print the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--drives", type=int, default=40)
    parser.add_argument("--landmarks", type=int, default=100)
    parser.add_argument("--worlds", nargs="*", default=list(WORLDS), choices=WORLDS)
    parser.add_argument("--figure")
    options = parser.parse_args()
    every: dict[str, list[tuple[float, float]]] = {}
    for name in options.worlds:
        found: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
        for seed in range(options.first, options.first + options.drives):
            for who, p, off in asked(name, seed, options.landmarks):
                found.setdefault(who, []).append((p.ravel(), off.ravel()))
        for who, parts in found.items():
            p, off = (np.concatenate(each) for each in zip(*parts))
            print(
                f"{name}, {who}: said {p.mean():.4f}, off {off.mean():.4f}, Brier score {np.mean((p - off) ** 2):.4f}"
            )
            for low, high in zip(BINS, BINS[1:]):
                within = (p >= low) & ((p < high) | (high == 1))
                if within.any():
                    drives = sum(bool(np.any((q >= low) & ((q < high) | (high == 1)))) for q, _ in parts)
                    print(
                        f"  said {low:g} to {high:g}: mean {p[within].mean():.5f}, off {off[within].mean():.5f} of "
                        f"{within.sum()} in {drives} drives"
                    )
                    every.setdefault(f"{name}, {who}", []).append((p[within].mean(), off[within].mean()))
    if options.figure:
        import matplotlib.pyplot as plt

        figure, axes = plt.subplots(figsize=(5, 5), layout="constrained")
        for label, points in every.items():
            axes.plot(*np.maximum(np.array(points), 1e-5).T, "o-", label=label, markersize=4)
        axes.plot([1e-5, 1], [1e-5, 1], "k:", label="as said")
        axes.set(xscale="log", yscale="log", xlabel="probability that was said", ylabel="share of poses that are off")
        axes.legend(fontsize=7)
        figure.savefig(options.figure)


if __name__ == "__main__":
    main()
