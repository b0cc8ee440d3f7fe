"""Wheels that slip, or are blocked, for seconds: how far is the solution off, and does it say so?

    python benchmarks/slips.py [--first 1000] [--drives 60]

Each drive is a `Drive.random` of two minutes. In one stretch of 5 to 30 s the wheels read 1.3 to 1.6 times the speed, or the
gyroscope half of the turn rate. It is solved four times: with estimated noise (`estimate_robot`) and with that of the truth
(ids right and no clutter there), each with the stretch and without. A solution is off where its ATE is more than `FACTOR`
times the one that its covariances let expect, or NEES/3 above `FACTOR`. It says so where it has one of the notes on
contradictions; the notes on the odometry alone are counted apart. Where a solution with estimated noise names a stretch, it
is solved again with more noise there, d² / (T dt) with the error d of the note: what becomes of the ATE?
"""

from __future__ import annotations

import argparse
import re
from dataclasses import replace

import numpy as np

from graphslam import Graph, Log, SlamError, Solution, estimate_robot, solve
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


def prepared(log: Log, truth: DriveTruth, *, known: bool) -> Log:
    """The log with the noise of the truth, or with what it tells itself."""
    return with_true_noise(log, truth) if known else estimate_robot(log).log


def with_noise_there(log: Log, note: str) -> Log:
    """The log with as much more noise in the stretch that a note names as the note's error says."""
    named = re.search(r"steps (\d+) and (\d+) .* by ([\d.e+-]+) (m|rad),", note)
    assert named is not None and log.dt is not None and log.times is not None
    first, last, error, column = int(named[1]), int(named[2]), float(named[3]), int(named[4] == "rad")
    rows = slice(first, last) if log.control_starts is None else slice(*log.control_starts[[first, last]])
    variances = np.zeros((len(log.dt), 3)) if log.control_variances is None else log.control_variances.copy()
    variances[rows, column] += error**2 / ((log.times[last] - log.times[first]) * log.dt[rows])
    return log.replace(control_variances=variances)


def is_off(solution: Solution, truth: Array) -> bool:
    """Whether the errors are beyond what the covariances let expect."""
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
            count = off = told = by_odometry = warned = 0
            again: list[tuple[float, bool, bool]] = []
            for seed in range(arguments.first, arguments.first + arguments.drives):
                drive = replace(Drive.random(seed), duration=DURATION)
                if known:
                    drive = replace(drive, parameters={})
                log, truth = drive.simulate()
                log = with_slip(log, np.random.default_rng(seed)) if slips else log
                try:
                    log = prepared(log, truth, known=known)
                    solution = solve(Graph.from_log(log))
                except SlamError as error:
                    print(f"seed {seed}: {error}")
                    continue
                named = [note for note in solution.notes if ODOMETRY in note]
                odometry = bool(named)
                said = odometry or any(note.startswith(MISFIT) for note in solution.notes)
                count, warned = count + 1, warned + said
                assert log.true_poses is not None
                wrong = is_off(solution, log.true_poses)
                if wrong:
                    off, told, by_odometry = off + 1, told + said, by_odometry + odometry
                if named and not known:
                    noisier = solve(Graph.from_log(with_noise_there(log, named[0])))
                    ratio = ate(log.true_poses, noisier.poses) / ate(log.true_poses, solution.poses)
                    again.append((ratio, wrong, is_off(noisier, log.true_poses)))
            print(
                f"noise {'of the truth' if known else 'estimated'}, {'one slip' if slips else 'no slip'}: {count} drives, "
                f"{off} off, {told} of these say so ({by_odometry} by the odometry); {warned} of all have a note",
                flush=True,
            )
            if again:
                ratios = np.array([ratio for ratio, _, _ in again])
                print(
                    f"    with more noise in the stretch named, {len(again)} drives: ATE lower by a tenth on "
                    f"{np.sum(ratios < 0.9)}, higher on {np.sum(ratios > 1.1)}, median ratio {np.median(ratios):.2f}; off "
                    f"{sum(after for _, _, after in again)}, before {sum(before for _, before, _ in again)}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
