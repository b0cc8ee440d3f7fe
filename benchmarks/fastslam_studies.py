"""Two studies over 50 seeds: FastSLAM 2.0 against 1.0 with a sharp sensor, unknown against known association.

python benchmarks/fastslam_studies.py [--only versions | association] [--record docs/measured]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

import numpy as np
from association import scattered
from recording import add_option, record

from fastslam import FastSLAM1, FastSLAM2
from graphslam import Log, MotionModel, SensorModel, simulate
from graphslam.metrics import align, ate, landmark_rmse

SEEDS = range(50)


def compare_versions() -> Iterator[dict[str, Any]]:
    """Rows: a tenth of the book's sensor noise, N = 100: error of the map, and ESS before resampling."""
    sensor = SensorModel(range_rate=0.014, bearing_std=0.005, orientation_std=0.005)
    for psi in (True, False):
        rmse, ess = {FastSLAM1: [], FastSLAM2: []}, {FastSLAM1: [], FastSLAM2: []}
        for seed in SEEDS:
            log = simulate(seed=seed, clean=True, orientation=psi, sensor=sensor)
            for kind in rmse:
                result = kind(log, particles=100, seed=seed, sensor=sensor).run()
                rmse[kind].append(
                    landmark_rmse(log.true_landmarks, result.landmarks, align(log.true_poses, result.poses))
                )
                ess[kind].append(np.mean(result.ess[1:]))
        errors, sizes = ([np.median(values[kind]) for kind in (FastSLAM1, FastSLAM2)] for values in (rmse, ess))
        ratio = sizes[1] / sizes[0]
        print(
            f"sharp sensor, psi {psi!s:5}: median landmark RMSE 1.0 {errors[0]:.3f} m, 2.0 {errors[1]:.3f} m; "
            f"mean ESS 1.0 {sizes[0]:.1f}, 2.0 {sizes[1]:.1f} ({ratio:.1f} times)"
        )
        figures = {"rmse1_m": errors[0], "rmse2_m": errors[1], "ess1": sizes[0], "ess2": sizes[1], "ess_ratio": ratio}
        yield {"name": "with psi" if psi else "without psi"} | figures


def compare_association() -> None:
    """Landmarks at least 4 standard deviations of the sensor at its limit apart, N = 1000."""
    for name, part, count in (("book's six", 2, 0), ("30 scattered", 5, 30)):
        motion = MotionModel(nn=0.19 / part, no=0.001 / part, on=0.13 / part, oo=0.2 / part, epsilon=1e-4 / part**2)
        sensor = SensorModel(range_rate=0.14 / part, bearing_std=0.05 / part, orientation_std=0.05 / part)
        models = {"motion": motion, "sensor": sensor}
        for psi in (True, False):
            for kind in (FastSLAM1, FastSLAM2):
                right, confirmed, known, unknown = 0, 0, [], []
                for seed in SEEDS:
                    world = {"landmarks": scattered(seed, count, 4 * sensor.range_rate * 6.0, 4.5)} if count else {}
                    log: Log = simulate(seed=seed, clean=True, orientation=psi, **world, **models)
                    a = kind(log, particles=1000, seed=seed, **models).run()
                    slam = kind(log, particles=1000, seed=seed, association="maximum-likelihood", **models)
                    b = slam.run()
                    # whoever was seen once is on the map only on request
                    right += len(slam.state.map(provisional=True)) == len(a.landmarks)
                    confirmed += len(b.landmarks) == np.sum(np.unique(log.landmarks, return_counts=True)[1] > 1)
                    known.append(ate(log.true_poses, a.poses))
                    unknown.append(ate(log.true_poses, b.poses))
                print(
                    f"{name}, 1/{part} of the book's noise, psi {psi!s:5}, {kind.__name__}: right number {right} of "
                    f"{len(SEEDS)}, of those seen twice or more {confirmed}; "
                    f"median ATE {np.median(known):.3f} m known, {np.median(unknown):.3f} m unknown "
                    f"({np.median(unknown) / np.median(known):.2f} times; mean {np.mean(unknown) / np.mean(known):.2f})",
                    flush=True,
                )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=("versions", "association"))
    add_option(parser)
    arguments = parser.parse_args()
    if arguments.only != "association":
        record(arguments.record, "fastslam_studies", list(compare_versions()))
    if arguments.only != "versions":
        compare_association()
