"""Ranges or bearings alone: is the optimum reached from odometry?

    python benchmarks/single_numbers.py [--number range] [--count 100] [--lanes 6]

Worlds of `graphslam.simulation.worlds`: 300 poses along the lanes of a field of 40 m, 8 landmarks, one sighting at
every second pose. The optimum is the lower end of the search from odometry and of Levenberg-Marquardt from the ground truth.
A landmark is misplaced in silence where no note says that it may be elsewhere. With --filters the same worlds go through
Monte Carlo localisation, which knows the landmarks, and FastSLAM, with 1000 particles; with --online through
the online solver.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from graphslam import Graph, Solution, solve, solve_online
from graphslam.metrics import ate, evaluate
from graphslam.simulation.worlds import NUMBERS, simulate_single_numbers

#: costs that differ by less than this part are the same
SAME = 1e-6
#: a landmark is misplaced where it is farther from its true place, after alignment, than so many [m] and standard deviations
MISPLACED = 2.0, 5.0


def optimum(graph: Graph, found: Solution) -> float:
    """The lowest known cost."""
    log = graph.log
    assert log is not None and log.true_poses is not None and log.true_landmarks is not None
    places = [[*log.true_landmarks[j][:2], 0.0] for j in graph.landmark_ids.tolist()]
    true = graph.with_initial(np.concatenate([log.true_poses, places]))
    near = solve(true, initialize="given", method="levenberg-marquardt")
    return min(near.cost, found.cost)


def through_filters(number: str, lanes: int, seeds: range) -> None:
    """Print the ATE of the particle filters."""
    from fastslam import FastSLAM1, FastSLAM2, MonteCarloLocalization

    for kind in (MonteCarloLocalization, FastSLAM1, FastSLAM2):
        errors, seconds, placed = list[float](), list[float](), list[int]()
        for seed in seeds:
            log = simulate_single_numbers(number, seed=seed, lanes=lanes)
            assert log.true_poses is not None
            begin = time.process_time()
            found = kind(log, particles=1000, seed=seed).run()
            seconds.append(time.process_time() - begin)
            errors.append(ate(log.true_poses, found.poses))
            placed.append(len(found.landmarks))
        print(
            f"{number}, {kind.__name__}: ATE {np.median(errors):.3f} m (median), {max(errors):.2f} m at most; "
            f"{np.mean(placed):.1f} landmarks; {np.median(seconds):.2f} s"
        )


def step_by_step(number: str, lanes: int, seeds: range) -> None:
    """Print by how much J of the online solver is above that of the batch solution, with and without a kernel."""
    for kernel in ("none", "cauchy"):
        above, seconds = list[float](), list[float]()
        for seed in seeds:
            log = simulate_single_numbers(number, seed=seed, lanes=lanes)
            batch, online = solve(Graph.from_log(log, kernel=kernel)), solve_online(log, kernel=kernel)
            above.append(online.cost / batch.cost - 1)
            seconds.append(online.seconds)
        print(
            f"{number}, kernel {kernel}, step by step: J at most {max(above):.1e} above the batch solution; "
            f"{np.median(seconds):.2f} s"
        )


def main() -> None:
    """Print how many worlds end at the optimum, and how well."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--number", choices=NUMBERS, action="append", help="default: both")
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--lanes", type=int, default=6, help="1: a straight way, with mirror images")
    parser.add_argument("--first", type=int, default=1000, help="the first seed")
    parser.add_argument("--filters", action="store_true", help="the particle filters instead of the graph")
    parser.add_argument("--online", action="store_true", help="the online solver beside the graph")
    options = parser.parse_args()
    for number in options.number or NUMBERS:
        if options.online:
            step_by_step(number, options.lanes, range(options.first, options.first + options.count))
            continue
        if options.filters:
            through_filters(number, options.lanes, range(options.first, options.first + options.count))
            continue
        reached, doubted, misplaced, silent, seconds, errors, before = 0, 0, 0, 0, [], [], []
        for seed in range(options.first, options.first + options.count):
            log = simulate_single_numbers(number, seed=seed, lanes=options.lanes)
            assert log.true_poses is not None and log.true_landmarks is not None
            begin = time.process_time()
            graph = Graph.from_log(log)
            found = solve(graph)
            seconds.append(time.process_time() - begin)
            here = found.cost <= optimum(graph, found) * (1 + SAME)
            reached += here
            said = {int(note.split()[1]) for note in found.notes if "may be elsewhere" in note}
            doubted += bool(said)
            of_landmarks = evaluate(log.true_poses, log.true_landmarks, found.poses, found.landmarks).landmark_errors_m
            far = {
                j
                for j, error in (of_landmarks or {}).items()
                if error
                > max(MISPLACED[0], MISPLACED[1] * np.trace(np.squeeze(found.covariance(landmarks=[j]))) ** 0.5)
            }
            misplaced += len(far)
            silent += len(far - said)
            if not here:
                print(f"{number}, seed {seed}: not the optimum")
            errors.append(ate(log.true_poses, found.poses))
            before.append(ate(log.true_poses, log.initial_poses))
        print(
            f"{number}: optimum in {reached} of {options.count}; a landmark said to be possibly elsewhere in {doubted}; "
            f"{misplaced} landmarks misplaced, {silent} of them in silence; ATE {np.median(errors):.3f} m (median), dead "
            f"reckoning {np.median(before):.2f} m; {np.median(seconds):.2f} s"
        )


if __name__ == "__main__":
    main()
