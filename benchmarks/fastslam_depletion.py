"""Why FastSLAM 1.0 misses the exact posterior where 2.0 meets it: how many families of histories are left?

    python benchmarks/fastslam_depletion.py [--particles 100000] [--seeds 5] [--resampling systematic] [--threshold 0.5]

Simulated logs of sixty steps with a fifth of the book's noise, without psi. Every tenth step is compared with the
posterior of the full problem (`tests/fastslam/exact_posterior.py`): the largest error of any coordinate of the pose and
of the map in standard deviations, goal 0.3. Particles of one family have the same ancestor at an early step; what
they say of landmarks seen until then is one opinion. With family weights w_f their effective number is 1 / sum w_f².
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from fastslam import FastSLAM1, FastSLAM2, ParticleState
from graphslam import Log, MotionModel, SensorModel, simulate
from graphslam.se2 import wrap

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "fastslam"))
from exact_posterior import exact_posterior

MODELS = {
    "motion": MotionModel(nn=0.038, no=0.0002, on=0.026, oo=0.04, epsilon=4e-6),
    "sensor": SensorModel(range_rate=0.028, bearing_std=0.01),
}
STEPS, EARLY = 60, 10


def largest_error(log: Log, state: ParticleState) -> float:
    """Of the means of pose and map, in standard deviations of the exact posterior at the state's step."""
    exact, mixture = exact_posterior(log, state.step, **MODELS), state.mixture_map()
    off = state.mean_pose - exact.poses[-1]
    off[2] = wrap(off[2])
    errors = [off / np.sqrt(np.diag(exact.pose_covariance(state.step)))]
    for j, mean in exact.landmarks.items():
        errors.append((mixture[j].mean - mean) / np.sqrt(np.diag(exact.landmark_covariance(j))))
    return float(np.abs(np.concatenate(errors)).max())


def run(slam: FastSLAM1, log: Log) -> tuple[float, float]:
    """The largest error at any tenth step, and the effective number of families of step `EARLY` at the end."""
    errors, level = [], 0
    for state in slam:
        if state.step == EARLY:
            level = slam._engine.level()
        if state.step > 0 and state.step % 10 == 0:
            errors.append(largest_error(log, state))
    weights = np.bincount(slam._engine.ancestors(level), np.exp(state.log_weights), slam.particles)
    return max(errors), float(1 / np.sum(weights**2))


def main() -> None:
    """One line per log and version."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--particles", type=int, default=100_000)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--resampling", default="systematic")
    parser.add_argument("--threshold", type=float, default=0.5)
    arguments = parser.parse_args()
    options = {
        "particles": arguments.particles,
        "resampling": arguments.resampling,
        "ess_threshold": arguments.threshold,
        **MODELS,
    }
    for kind in (FastSLAM1, FastSLAM2):
        met = 0
        for seed in range(arguments.seeds):
            log = simulate(seed=seed, steps=STEPS, clean=True, orientation=False, **MODELS)
            begin = time.perf_counter()
            error, families = run(kind(log, seed=seed, **options), log)
            met += error < 0.3
            print(
                f"{kind.__name__}, N = {arguments.particles}, log {seed}: largest error {error:.2f} standard deviations, "
                f"{families:.1f} effective families of step {EARLY}, {time.perf_counter() - begin:.0f} s",
                flush=True,
            )
        print(f"{kind.__name__}: {met} of {arguments.seeds} logs within 0.3 standard deviations", flush=True)


if __name__ == "__main__":
    main()
