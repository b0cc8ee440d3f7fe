"""Random drives of the online solver with bad calls and bad questions in between: each is refused with a sentence, and leaves
the solver as one that never saw it.

python benchmarks/fuzz_online.py                      # 1,000 drives
python benchmarks/fuzz_online.py --count 50 --only 17  # one drive again

Everything follows from the random seed and the number of the drive. The exit status is 1 if a drive fails.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Callable
from copy import copy
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator, default_rng

sys.path.insert(0, str(Path(__file__).parent))
from fuzzing.attempt import attempt

from graphslam import GraphError, MotionModel, OnlineSolver, SensorModel, SlamError

#: the name of a method and its arguments
Call = tuple[str, dict[str, Any]]


def online_case(seed: int, number: int) -> tuple[str, Callable[[], list[str]]]:
    """One drive: its name, and a function that takes it and returns what is wrong."""
    rng = default_rng([seed, number])
    columns, lag = int(rng.integers(2, 4)), [None, None, 2, 10][rng.integers(4)]
    kernel = [None, "huber", "cauchy"][rng.integers(3)]
    steps = int(rng.integers(5, 40))
    name = f"drive {number}: {columns} numbers, lag {lag}, kernel {kernel}, {steps} steps"
    return name, lambda: wrong_with(rng, columns, lag, kernel, steps)


def wrong_with(rng: Generator, columns: int, lag: int | None, kernel: str | None, steps: int) -> list[str]:
    """What is wrong after a drive: two solvers take its steps, and only one of them the bad ones in between."""
    scale, pose, marks = float(10 ** rng.uniform(-3, 0)), rng.normal(0, 5, 3), rng.uniform(-8, 8, (6, 3))
    motion = MotionModel(nn=0.2 * scale, no=0.01 * scale, on=0.1 * scale, oo=0.2 * scale, epsilon=1e-4 * scale**2)
    sensor = SensorModel(range_rate=0.1 * scale, bearing_std=0.05 * scale, orientation_std=0.05 * scale)
    tried, clean = (OnlineSolver(pose, lag=lag, kernel=kernel, motion=motion, sensor=sensor) for _ in range(2))
    problems: list[str] = []
    for number in range(steps):
        for _ in range(rng.integers(0, 3)):
            bad, before = bad_call(rng, columns, tried), state_of(tried)
            if not refused(tried, bad):
                # it was possible after all
                call(clean, bad)
            elif state_of(tried) != before:
                problems.append(f"step {number}: changed by the refused {bad}")
        for question in QUESTIONS:
            try:
                tried.covariance(**question)
                problems.append(f"step {number}: an answer to covariance({question})")
            except SlamError:
                pass
            except Exception as error:
                problems.append(f"{type(error).__name__} after covariance({question}): {error}")
        calls, pose = good_step(rng, columns, pose, marks, motion, sensor)
        branch, before = copy(tried), state_of(tried)
        for good in calls:
            outcomes = [refused(solver, good) for solver in (tried, clean)]
            if outcomes[0] != outcomes[1]:
                return [*problems, f"step {number}: refused {outcomes[0]}, without the bad calls {outcomes[1]}: {good}"]
        if state_of(branch) != before:
            problems.append(f"step {number}: a copy changed with its original")
    for what, values in zip(PARTS, zip(*map(parts_of, (tried, clean)), strict=True), strict=True):
        if not np.isfinite(values[0]).all():
            problems.append(f"{what} not finite")
        if not np.array_equal(*values):
            problems.append(f"{what} differ from those of a solver that never saw the bad calls")
    return problems


#: what is compared after a drive
PARTS = ("ids", "landmarks", "poses", "cost", "covariance of the newest pose")
#: what no solver can answer
QUESTIONS: tuple[dict[str, Any], ...] = (
    {"poses": -1}, {"poses": 10**9}, {"poses": 2**70}, {"poses": 0.5}, {"poses": "0"}, {"poses": float("nan")},
    {"poses": True},
    {"landmarks": [10**6]}, {"landmarks": [[1]]}, {"landmarks": ["1"]}, {"landmarks": [None]}, {"landmarks": {3}},
)  # fmt: skip


def state_of(solver: OnlineSolver) -> tuple[Any, ...]:
    """What a refused call must not change, without a solution of the tree."""
    return (
        solver._backend.system.__getstate__(),
        solver.step,
        solver.num_final,
        solver.converged,
        solver._time,
        solver._backend.columns,
    )


def parts_of(solver: OnlineSolver) -> list[np.ndarray]:
    """Arrays of what `PARTS` names."""
    landmarks = solver.landmarks
    places = np.array(list(landmarks.values()))
    try:
        covariance = solver.covariance()
    except GraphError:  # singular to double precision
        covariance = np.empty(0)
    return [np.array(list(landmarks)), places, solver.poses, np.array(solver.cost), covariance]


def call(solver: OnlineSolver, made: Call) -> None:
    """Make a call."""
    name, arguments = made
    getattr(solver, name)(**arguments)


def refused(solver: OnlineSolver, made: Call) -> bool:
    """Whether a solver refuses a call; anything but a refusal with one sentence is raised."""
    try:
        call(solver, made)
    except SlamError as error:
        if "\n" in str(error) or not str(error):
            raise AssertionError(f"an error of several lines: {error}") from error
        return True
    except Exception as error:
        error.add_note(f"the call was {made!r:.200}")
        raise
    return False


def good_step(
    rng: Generator, columns: int, pose: np.ndarray, marks: np.ndarray, motion: MotionModel, sensor: SensorModel
) -> tuple[list[Call], np.ndarray]:
    """The calls of a step with noise, and the true pose after it."""
    control = np.array([rng.uniform(-0.5, 1.0), rng.uniform(-1, 1)])
    pose = motion.f(pose, control, 1.0)
    move: dict[str, Any] = {"control": control + 0.01 * rng.standard_normal(2), "dt": 1.0}
    if rng.random() < 0.2:
        measured = np.array([control[0], 0.0, control[1]])
        move = {"motion": measured, "covariance": np.diag([0.3, 0.3, 0.3]) ** 2}
    ids = np.flatnonzero(rng.random(len(marks)) < 0.5)
    z = np.array([sensor.h(pose, marks[j, :columns]) for j in ids]).reshape(-1, columns)
    z += 0.3 * sensor.bearing_std * rng.standard_normal(z.shape)
    z[:, 0] = np.maximum(z[:, 0], 0.05)
    return [("move", move), ("observe", {"ids": ids, "sightings": z})], pose


def bad_call(rng: Generator, columns: int, solver: OnlineSolver) -> Call:
    """A call with one thing that cannot be, or hardly."""
    last, edge, eye = solver.step, np.array([0.1, 0.0, 0.1]), 1e-2 * np.eye(3)
    good: dict[str, dict[str, Any]] = {
        "move": {"control": (0.5, 0.1), "dt": 1.0},
        "observe": {"ids": [1, 2], "sightings": np.full((2, columns), 0.5)},
        "relate": {"first": 0, "second": last + 1, "motion": edge, "covariance": eye},
    }
    other = [
        np.full((3, 3), np.nan),
        -eye,
        np.zeros((3, 3)),
        np.triu(np.ones((3, 3))),
        1e300 * eye,
        1e-300 * eye,
        "eye",
    ]
    changes: list[Call] = [
        (method, {name: value})
        for method, names in (
            ("move", ("control", "dt", "motion", "time")), ("observe", ("ids", "sightings", "pose", "time")),
            ("relate", ("first", "second", "motion", "covariance")),
        )
        for name in names for value in ODD
    ]  # fmt: skip
    changes += [("move", {"control": None, "dt": None, "motion": edge, "covariance": P}) for P in other]
    changes += [
        ("move", {"control": None, "dt": None, "motion": 10**k * edge, "covariance": 10.0**-k * eye})
        for k in (9, 100, 200)
    ]
    changes += [("relate", {"covariance": P}) for P in other]
    changes += [
        ("relate", {"first": a, "second": b})
        for a, b in ((last, last), (-1, last), (last + 2, 0), (0.5, last), (0, 2**70), ("a", "b"), (0, None))
    ]
    changes += [("relate", {"second": last, "motion": np.full(3, np.inf)})]
    changes += [
        ("observe", {"sightings": np.full((2, columns), value)})
        for value in (np.nan, -1.0, 0.0, 1e300, 1e-300, np.inf, -np.inf)
    ]
    changes += [
        ("observe", more)
        for more in (
            {"sightings": np.ones((2, 5 - columns))}, {"sightings": np.ones((3, columns))}, {"ids": [1, 2, 3]},
            {"ids": [-1, 2]},
            *({"pose": p} for p in (-1, last + 1, last + 5, 0 if solver.num_final else -2)),
        )
    ]  # fmt: skip
    changes += [
        ("move", more)
        for more in (
            {"control": None}, {"dt": None}, {"covariance": eye}, {"dt": 1e300}, {"dt": 1e-300}, {"control": (1e200, 0.1)},
            {"control": (0.1, 1e300)}, {"time": -1e300},
        )
    ]  # fmt: skip
    method, change = changes[rng.integers(len(changes))]
    return method, good[method] | change


class Odd:
    """An object that no argument can be."""


#: values of wrong types, shapes and sizes
ODD: tuple[Any, ...] = (
    "noon", b"x", float("nan"), float("inf"), -1.0, 0.0, 2**63, -(2**63) - 1, 10**400, 1j, True, [], [[]], {}, {1: 2},
    Odd(), Odd, np.zeros((0, 2)), np.zeros((2, 2, 2)), np.array(["a", "b"]), np.array([None, 1]), [1, [2]], [1.5, 2.5],
    [2**63, 1], [2**70, 1], np.datetime64("2026-11-22"), range(10**6), "9" * 5000,
)  # fmt: skip


def main() -> int:
    """Take the drives and print what fails."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, help="take this drive alone")
    arguments = parser.parse_args()
    outcomes: Counter[str] = Counter()
    failed, begin = 0, time.perf_counter()
    for number in range(arguments.count) if arguments.only is None else [arguments.only]:
        name, check = online_case(arguments.seed, number)
        outcome, problems = attempt(check)
        outcomes[outcome] += 1
        failed += bool(problems) or outcome != "solved"
        for problem in problems:
            print(f"{name}\n    {problem[:300]}", flush=True)
    counts = ", ".join(f"{count} {outcome}" for outcome, count in outcomes.items())
    print(f"drives: {counts}; {time.perf_counter() - begin:.0f} s; {failed} failed")
    return failed > 0


if __name__ == "__main__":
    sys.exit(main())
