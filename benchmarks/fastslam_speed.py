"""Time per particle of a prediction and of an observation step, weights and resampling included.

    python benchmarks/fastslam_speed.py

Single thread: time that the thread was given, so that a busy machine disturbs little. Two threads: time on the clock,
which says something only where a second core is free, and the time that the caller's thread was given, its half of the
work and all that is not shared: what the clock would show at best.

The exact weight of FastSLAM 2.0 against that of the lectures: processor time, in turns.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

from fastslam import FastSLAM1, FastSLAM2, ParticleFilter
from graphslam import SensorModel


def step_times(
    kind: type[ParticleFilter], particles: int, marks: np.ndarray, *, threads: int = 1, extra: int = 0, steps: int = 150,
    clock: Callable[[], float] = time.thread_time, **options: str,
) -> np.ndarray:  # fmt: skip
    """Medians of one prediction and one observation of all marks [ns], with ``extra`` landmarks out of view."""
    rng, sensor = np.random.default_rng(0), SensorModel()
    slam = kind(particles=particles, threads=threads, **options)
    far = np.column_stack([rng.uniform(100, 200, (extra, 2)), np.zeros(extra)])[:, : marks.shape[1]]
    everything = np.vstack([marks, far])
    slam.observe(np.arange(len(everything)), sensor.h(np.zeros(3), everything))
    times = []
    for _ in range(steps):
        a = clock()
        slam.move((0.2, 0.17), 1.0)
        b = clock()
        z = sensor.h(slam.state.mean_pose, marks) * (1 + 0.02 * rng.standard_normal(marks.shape))
        c = clock()
        slam.observe(np.arange(len(marks)), z)
        times.append((b - a, clock() - c))
    return np.median(times[steps // 3 :], axis=0) * 1e9


def main() -> None:
    """Print the tables."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    rng = np.random.default_rng(1)
    print("filter     psi    N       in view  predict  observe  [ns per particle (and sighting)]")
    for kind in (FastSLAM1, FastSLAM2):
        for psi in (False, True):
            for particles in (1000, 10_000, 100_000):
                for count in (1, 5):
                    marks = np.column_stack([rng.uniform(-6, 6, (count, 2)), rng.uniform(-3, 3, count)])[:, : 2 + psi]
                    move, observe = step_times(kind, particles, marks) / particles
                    print(f"{kind.__name__}  {psi!s:5}  {particles:<7} {count}     {move:10.1f}{observe / count:9.1f}")
    marks = rng.uniform(-6, 6, (5, 2))
    for particles in (10_000, 100_000):
        for kind in (FastSLAM1, FastSLAM2):
            # in turns, so that a busy minute does not fall on one side
            gains = []
            for clock in (time.perf_counter, time.thread_time):
                rounds = [
                    [step_times(kind, particles, marks, threads=n, steps=45, clock=clock).sum() for n in (1, 2)]
                    for _ in range(5)
                ]
                gains.append(np.divide(*np.min(rounds, axis=0)))
            print(
                f"{kind.__name__}, N = {particles}, 5 in view: two threads {gains[0]:.2f} times as fast per whole step, "
                f"at best {gains[1]:.2f} times"
            )
    for particles in (1000, 10_000):
        for psi in (False, True):
            of_psi = np.column_stack([marks, rng.uniform(-3, 3, 5)])[:, : 2 + psi]
            ratios = []
            for _ in range(9):
                exact, linearised = (
                    step_times(FastSLAM2, particles, of_psi, steps=45, proposal_weight=weight).sum()
                    for weight in ("exact", "linearised")
                )
                ratios.append(exact / linearised)
            low, median, high = np.quantile(ratios, [0.25, 0.5, 0.75])
            print(f"exact weight, N = {particles}, psi {psi}: {median:.2f} times ({low:.2f} to {high:.2f})")
    few, many = (step_times(FastSLAM1, 1000, marks, extra=extra) for extra in (95, 9995))
    print(f"10,000 landmarks against 100, the same 5 in view: step takes {many.sum() / few.sum():.2f} times as long")


if __name__ == "__main__":
    main()
