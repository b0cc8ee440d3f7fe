"""Unknown robots that see ranges or bearings alone: how good is the estimate, beside the noise of the book?

    python benchmarks/unknown_single_numbers.py [--first 6000] [--drives 40] [--kinds ranges bearings both] [--calibrated]

Each drive is a `Drive.random` of two minutes with right ids, of whose sightings only the range or the bearing is kept (with
"both" one after the other). It is solved with the noise that the log shows (`estimate_robot`, the default) and with that of
the book, and, for `--calibrated` robots, which have no biases, with the true noise. ATE after alignment; NEES / 3 is 1 for
honest covariances. Drives with fewer than 60 sightings are left out.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

from graphslam import Drive, Graph, Log, PartialSightings, SlamError, Solution, estimate_robot, solve
from graphslam.metrics import ate, mean_nees

#: which sightings keep their range
RANGED = {"ranges": lambda k: k >= 0, "bearings": lambda k: k < 0, "both": lambda k: k % 2 == 0}
DURATION, FEWEST = 120.0, 60


def with_single_numbers(log: Log, kind: str) -> Log:
    """The log with one number of each sighting."""
    ranged = RANGED[kind](np.arange(len(log.steps)))
    numbers = PartialSightings(
        steps=log.steps, landmarks=log.landmarks, ranges=np.where(ranged, log.sightings[:, 0], np.nan),
        bearings=np.where(ranged, np.nan, log.sightings[:, 1]),
    )  # fmt: skip
    return log.with_sightings(np.zeros(len(log.steps), dtype=bool)).replace(partial_sightings=numbers)


def errors_of(solution: Solution, log: Log) -> tuple[float, float]:
    """ATE and NEES / 3."""
    assert log.true_poses is not None
    covariances = solution.covariance()
    return ate(solution.poses, log.true_poses), mean_nees(solution.poses, log.true_poses, covariances)


def errors_of_all(seed: int, kind: str, calibrated: bool) -> tuple[dict[str, tuple[float, float]], float]:
    """{noise: ATE and NEES / 3} for one drive, and the time of the estimate."""
    settings = replace(Drive.random(seed), duration=DURATION, misread=0.0, clutter=0.0)
    if calibrated:
        settings = replace(settings, parameters={})
    log, truth = settings.simulate()
    if len(log.steps) < FEWEST:
        return {}, 0.0
    log = with_single_numbers(log.replace(landmarks=truth.landmarks), kind)
    begin = time.process_time()
    found = estimate_robot(log).log
    seconds = time.process_time() - begin
    graphs = {"estimate": Graph.from_log(found), "book": Graph.from_log(log, noise="book")}
    if calibrated:
        graphs["truth"] = Graph.from_log(log, motion=truth.motion, sensor=truth.sensor)
    return {name: errors_of(solve(graph), log) for name, graph in graphs.items()}, seconds


def main() -> None:
    """Run the drives, print a line for each kind and noise."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=6000)
    parser.add_argument("--drives", type=int, default=40)
    parser.add_argument("--kinds", nargs="+", choices=list(RANGED), default=list(RANGED))
    parser.add_argument("--calibrated", action="store_true", help="robots without biases")
    arguments = parser.parse_args()
    for kind in arguments.kinds:
        every, times = [], []
        for seed in range(arguments.first, arguments.first + arguments.drives):
            try:
                errors, seconds = errors_of_all(seed, kind, arguments.calibrated)
            except SlamError as error:
                print(f"{kind}, seed {seed}: {error}", flush=True)
                continue
            if errors:
                every.append(errors)
                times.append(seconds)
        if not every:
            print(f"{kind}: no drive is left", flush=True)
            continue
        against = np.array([each["estimate"][0] / each["book"][0] for each in every])
        print(f"{kind}, {len(every)} drives: ATE over that with the book's noise: median {np.median(against):.2f}, "
              f"above 1.2 on {np.sum(against > 1.2)}; estimate {np.median(times):.1f} s", flush=True)  # fmt: skip
        for name in every[0]:
            ates, nees = np.array([each[name] for each in every]).T
            print(f"    {name:9} ATE {np.median(ates):.3f} m; NEES / 3 {np.median(nees):.2f} in the median, "
                  f"between 1/3 and 3 on {np.mean((nees > 1 / 3) & (nees < 3)):.0%}, "
                  f"above 9 on {np.sum(nees > 9)}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
