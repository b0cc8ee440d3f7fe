"""Wheels that slip, or are blocked, for seconds: how far is the solution off, and does it say so?

    python benchmarks/slips.py [--first 1000] [--drives 60]

Each drive is a `Drive.random` of two minutes. In one stretch of 5 to 30 s the wheels read 1.3 to 1.6 times the speed, or the
gyroscope half of the turn rate. It is solved four times: with estimated noise (`Graph.from_log`) and with that of the truth
(ids right and no clutter there), each with the stretch and without. A solution is off where its ATE is more than `FACTOR`
times the one that its covariances predict, or NEES/3 above `FACTOR`. It says so where it has a note that the odometry of a
stretch contradicts the rest, or one on J; the first ones are counted apart. The ATE is the median over the drives.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from graphslam import Graph, Log, SlamError, Solution, solve
from graphslam.metrics import ate, mean_nees
from graphslam.se2 import Array
from graphslam.simulation.drives import Drive, DriveTruth

#: the length of a drive and of a stretch [s], the factor on the speed, and that on the turn rate
DURATION, STRETCH, FASTER, TURNED = 120.0, (5.0, 30.0), (1.3, 1.6), 0.5
FACTOR = 2.0
#: the notes on the odometry, and on J
ODOMETRY, MISFIT = "the odometry contradicts", "J is"


def with_slip(log: Log, rng: np.random.Generator) -> Log:
    """The log with wrong controls in one stretch."""
    assert log.controls is not None and log.dt is not None
    ends = np.cumsum(np.broadcast_to(log.dt, len(log.controls)))
    length = rng.uniform(*STRETCH)
    begin = rng.uniform(0, ends[-1] - length)
    column, factor = (0, rng.uniform(*FASTER)) if rng.random() < 0.5 else (1, TURNED)
    controls = log.controls.copy()
    controls[(ends > begin) & (ends <= begin + length), column] *= factor
    changed = log.replace(controls=controls)
    return changed.replace(initial_poses=changed.dead_reckoning())


def with_true_noise(log: Log, truth: DriveTruth) -> Log:
    """The log with the noise, the biases and the ids of the truth, and without clutter."""
    right = log.replace(landmarks=truth.landmarks).with_sightings(~truth.clutter)
    return right.replace(motion=truth.motion, sensor=truth.sensor, uncertain=None)


def is_off(solution: Solution, truth: Array) -> bool:
    """Whether the errors are beyond what the covariances predict."""
    nees = mean_nees(truth, solution.poses, solution.covariance())
    return ate(truth, solution.poses) > FACTOR * solution.expected_ate or (nees or 0.0) > FACTOR


def main() -> None:
    """Solve the drives and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=1000, help="the first seed")
    parser.add_argument("--drives", type=int, default=60, help="how many drives")
    arguments = parser.parse_args()
    for known in (True, False):
        for slips in (True, False):
            off = told = by_odometry = warned = named = 0
            errors: list[float] = []
            for seed in range(arguments.first, arguments.first + arguments.drives):
                drive = replace(Drive.random(seed), duration=DURATION)
                if known:
                    drive = replace(drive, parameters={})
                log, truth = drive.simulate()
                log = with_slip(log, np.random.default_rng(seed)) if slips else log
                try:
                    solution = solve(Graph.from_log(with_true_noise(log, truth) if known else log))
                except SlamError as error:
                    print(f"seed {seed}: {error}")
                    continue
                odometry = any(ODOMETRY in note for note in solution.notes)
                said = odometry or any(note.startswith(MISFIT) for note in solution.notes)
                warned, named = warned + said, named + odometry
                assert log.true_poses is not None
                errors.append(ate(log.true_poses, solution.poses))
                if is_off(solution, log.true_poses):
                    off, told, by_odometry = off + 1, told + said, by_odometry + odometry
            print(
                f"noise {'of the truth' if known else 'estimated'}, {'one slip' if slips else 'no slip'}: {len(errors)} "
                f"drives, ATE {np.median(errors):.3f} m, {off} off, {told} of these say so ({by_odometry} by the odometry); "
                f"{warned} of all have a note ({named} on the odometry)",
                flush=True,
            )


if __name__ == "__main__":
    main()
