"""Parameters of vehicle and sensor: simulated logs with known biases, and the sample log.

    python benchmarks/parameters.py [--logs 100]

For each parameter the mean error and the root mean square of the error over the stated standard deviation (1: consistent).
"""

from __future__ import annotations

import argparse

import numpy as np

from graphslam import Graph, Log, MotionModel, SensorModel, load, sample_log_path, simulate, solve

#: recorded = true with these, in the words of docs/parameters.md
BIASES = {
    "wheel_scale": 1.03, "turn_scale": 0.95, "turn_rate_bias": 0.004, "bearing_bias": 0.05, "range_bias": 0.1,
}  # fmt: skip
ROUTE = ((3, -3), (3, 3), (-3, 3), (-3, -3))


def biased_log(seed: int, noise: float) -> Log:
    """A drive along way points with a factor on the book's noise, recorded with `BIASES`."""
    motion = MotionModel(nn=0.19 * noise, no=0.001 * noise, on=0.13 * noise, oo=0.2 * noise, epsilon=1e-4 * noise**2)
    sensor = SensorModel(range_rate=0.14 * noise, bearing_std=0.05 * noise, orientation_std=0.05 * noise)
    log = simulate(
        seed=seed, steps=62, clean=True, motion=motion, sensor=sensor, way_points=ROUTE, turn_rate=0.4,
    )  # fmt: skip
    assert log.controls is not None
    b, (nu, omega) = BIASES, log.controls.T
    controls = np.column_stack([b["wheel_scale"] * nu, b["turn_scale"] * omega + b["turn_rate_bias"]])
    sightings = log.sightings + [b["range_bias"], b["bearing_bias"], 0]
    kept = sightings[:, 0] > 0
    biased = log.with_sightings(kept, sightings=sightings[kept], controls=controls, motion=motion, sensor=sensor)
    return biased.replace(initial_poses=biased.dead_reckoning())


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--logs", type=int, default=100)
    logs = parser.parse_args().logs
    truth = np.array(list(BIASES.values()))
    for noise in (0.1, 0.5, 1.0):
        for dimensions in (3, 2):
            errors, deviations, squares, shift = [], [], [], []
            for seed in range(logs):
                log = biased_log(seed, noise)
                options = {"edges": "landmark+motion", "dimensions": dimensions}
                solution = solve(Graph.from_log(log, estimate=list(BIASES), **options))
                found = solution.parameters
                assert found is not None and log.true_poses is not None
                errors.append(found.values - truth)
                deviations.append(list(found.deviations.values()))
                squares.append(errors[-1] @ np.linalg.solve(found.covariance, errors[-1]) / len(truth))
                away = solution.poses - log.true_poses
                plain = solve(Graph.from_log(log, **options)).poses - log.true_poses
                shift.append([np.sqrt(np.mean(np.sum(each[:, :2] ** 2, axis=1))) for each in (plain, away)])
            print(f"{noise} of the book's noise, {dimensions} numbers: NEES {np.mean(squares):.2f}, ", end="")
            print("RMSE without and with estimates {:.3f} {:.3f} m".format(*np.mean(shift, axis=0)))
            for k, name in enumerate(BIASES):
                e, s = np.array(errors)[:, k], np.array(deviations)[:, k]
                ratio = np.sqrt(np.mean((e / s) ** 2))
                print(f"  {name:15} error {e.mean():+.5f}, deviation {s.mean():.5f}, ratio {ratio:.2f}")
    log = load(sample_log_path())
    estimate = ["range_scale", "turn_scale", "bearing_bias"]
    for edges, weight in (("landmark+motion", "pairs"), ("virtual+motion", "marginal"), ("virtual+motion", "pairs")):
        solution = solve(Graph.from_log(log, edges=edges, weight=weight, estimate=estimate, kernel="none"))
        print(edges, weight, solution.parameters)


if __name__ == "__main__":
    main()
