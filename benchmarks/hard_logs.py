"""`initialize="auto"` on a hundred logs that are hard to start: does it reach the optimum, and in which time?

    python benchmarks/hard_logs.py [--logs 100] [--seed 20] [--edges landmark+motion] [--json FILE] [--before FILE]

A robot wanders through a square of 20 x 20 m with 13 to 36 landmarks, for 217 to 720 steps. Its sensor measures range and
bearing. Five noise levels take turns; the models that the estimators use have the noise of the level. "Truth" is the end
that is reached from the true poses and landmarks, by Gauss-Newton or by damped steps, whichever is lower. An end counts as
missed if its J is above that by more than 1e-6 of it. With ``--before``, a JSON file of an earlier run, the times
are compared.
"""

from __future__ import annotations

import argparse
import json
import statistics
from pathlib import Path
from typing import Any

import numpy as np

from graphslam import Graph, GraphError, Log, MotionModel, SensorModel, solve

#: the standard deviations of each level, as multiples of the book's
LEVELS = (0.25, 0.5, 1.0, 2.0, 3.0)
HALF_SIDE, DT = 10.0, 1.0
#: an end is missed where its J is higher than the optimum by more than this part
MISSED = 1e-6


def hard_log(number: int, seed: int = 20) -> Log:
    """The log with a number, at the noise level ``LEVELS[number % 5]``; another seed makes another hundred."""
    rng = np.random.default_rng([seed, number])
    level = LEVELS[number % len(LEVELS)]
    motion = MotionModel(nn=0.19 * level, no=0.001 * level, on=0.13 * level, oo=0.2 * level, epsilon=1e-4)
    sensor = SensorModel(range_rate=0.14 * level, bearing_std=0.05 * level)
    steps, count = int(rng.integers(217, 721)), int(rng.integers(13, 37))
    reach, half_view = rng.uniform(4, 8), rng.choice([np.pi / 3, np.pi / 2, np.pi])
    landmarks = rng.uniform(-HALF_SIDE, HALF_SIDE, (count, 2))
    controls, poses = _wander(steps, motion, rng)
    exact = sensor.h(poses[:, None], landmarks[None])
    seen = (exact[..., 0] > 0.3) & (exact[..., 0] < reach) & (np.abs(exact[..., 1]) < half_view)
    at, which = np.nonzero(seen & (rng.random(seen.shape) < 0.9))
    sightings = exact[at, which]
    sightings += rng.standard_normal(sightings.shape) * np.sqrt(np.diagonal(sensor.Q(sightings), axis1=1, axis2=2))
    positive = sightings[:, 0] > 0.05
    return Log(
        dt=DT, controls=controls, steps=at[positive], landmarks=which[positive], sightings=sightings[positive],
        initial_poses=motion.dead_reckoning(poses[0], controls, DT), true_poses=poses,
        true_landmarks=dict(enumerate(landmarks)), motion=motion, sensor=sensor, name=f"hard log {number}",
    )  # fmt: skip


def _wander(steps: int, motion: MotionModel, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Controls (T, 2) with a turn rate that changes slowly and leads back from the walls, and the true poses (T+1, 3)."""
    controls, poses = np.empty((steps, 2)), np.empty((steps + 1, 3))
    poses[0] = [*rng.uniform(-5, 5, 2), rng.uniform(-np.pi, np.pi)]
    speed, turn = rng.uniform(0.3, 0.7), 0.0
    for t in range(steps):
        turn = 0.9 * turn + 0.08 * rng.standard_normal()
        home = np.arctan2(-poses[t, 1], -poses[t, 0]) - poses[t, 2]
        outside = np.abs(poses[t, :2]).max() > HALF_SIDE - 2
        controls[t] = speed, np.clip(np.sin(home) * 0.5 if outside else turn, -0.5, 0.5)
        deviation = np.sqrt(np.diag(motion.M(controls[t], DT)))
        poses[t + 1] = motion.f(poses[t], controls[t] + deviation * rng.standard_normal(2), DT)
        poses[t + 1] += 0.01 * rng.standard_normal(3)
    return controls, poses


def true_state(graph: Graph) -> np.ndarray:
    """The state (n, 3) of the true poses and landmarks."""
    log = graph.log
    assert log is not None and log.true_poses is not None and log.true_landmarks is not None
    state = graph.initial.copy()
    state[: len(graph.steps)] = log.true_poses[graph.steps]
    for k, landmark in enumerate(graph.landmark_ids.tolist()):
        state[len(graph.steps) + k, :2] = log.true_landmarks[landmark]
    return state


def optimum(graph: Graph) -> float:
    """The lowest J at which runs from the truth converge; infinite where none does."""
    start, ends = graph.with_initial(true_state(graph)), [np.inf]
    for method in ("gauss-newton", "levenberg-marquardt"):
        try:
            run = solve(start, method=method, initialize="given", max_iterations=500)
        except GraphError:
            continue
        ends.append(run.cost if run.converged else np.inf)
    return min(ends)


def row(number: int, seed: int, options: dict[str, Any], repeat: int) -> dict[str, Any]:
    """What `auto` reaches on a log, and the median time."""
    graph = Graph.from_log(hard_log(number, seed), **options)
    runs = [solve(graph) for _ in range(repeat)]
    return {
        "number": number, "level": LEVELS[number % len(LEVELS)], "poses": len(graph.steps), "cost": runs[0].cost,
        "optimum": optimum(graph), "converged": runs[0].converged, "reason": runs[0].reason,
        "seconds": statistics.median(run.seconds for run in runs),
    }  # fmt: skip


def main() -> None:
    """Run the logs and print what was missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=int, default=100, help="how many logs")
    parser.add_argument("--seed", type=int, default=20, help="another hundred logs")
    parser.add_argument("--edges", default="landmark+motion")
    parser.add_argument("--repeat", type=int, default=1, help="the time of a log is the median of this many runs")
    parser.add_argument("--json", type=Path, help="write the rows there")
    parser.add_argument("--before", type=Path, help="rows of an earlier run, to compare times and ends with")
    arguments = parser.parse_args()
    solve(Graph.from_log(hard_log(0), edges=arguments.edges, kernel="none"))  # loads modules
    rows = []
    for number in range(arguments.logs):
        rows.append(row(number, arguments.seed, {"edges": arguments.edges}, arguments.repeat))
        r = rows[-1]
        if not r["converged"] or r["cost"] > r["optimum"] * (1 + MISSED):
            costs = f"J {r['cost']:12.6g} truth {r['optimum']:12.6g}"
            print(f"log {number:3} x{r['level']:<4g} {costs}  {r['reason']}", flush=True)
    for level in LEVELS:
        each = [r for r in rows if r["level"] == level]
        missed = sum(r["cost"] > r["optimum"] * (1 + MISSED) for r in each)
        below = sum(r["cost"] < r["optimum"] * (1 - MISSED) for r in each)
        unconverged = sum(not r["converged"] for r in each)
        time = statistics.median(r["seconds"] for r in each)
        print(
            f"noise x{level:<4g} {len(each)} logs: {missed} missed, {unconverged} not converged, {below} below the end "
            f"from the truth, median {time * 1e3:.1f} ms"
        )
    seconds = [r["seconds"] for r in rows]
    print(f"all logs: median {statistics.median(seconds) * 1e3:.1f} ms, in all {sum(seconds):.1f} s")
    if arguments.before is not None:
        before = {r["number"]: r for r in json.loads(arguments.before.read_text(encoding="utf-8"))}
        ratios = [r["seconds"] / before[r["number"]]["seconds"] for r in rows if r["number"] in before]
        print(f"median ratio of the times to {arguments.before}: {statistics.median(ratios):.2f}")
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(rows, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
