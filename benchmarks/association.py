"""Association of sightings without ids: simulated logs with clutter and misses, and logs whose ids are hidden.

    python benchmarks/association.py simulated --logs 100 --apart 4
    python benchmarks/association.py real sample woods mrclam-1 mrclam-3 huang victoria
    python benchmarks/association.py real mrclam-1 mrclam-3 --front-end best --particles 100
    python benchmarks/association.py limit 1 3
    python benchmarks/association.py verdict --first 3000 --worlds 200 [--missed 1 0.5]
    python benchmarks/association.py repair --drives 4

The simulated logs are 62 steps among thirty landmarks, at least so many standard deviations of the range (at 6 m) apart. One
sighting in ten is missing, and one in ten is a false one, uniform over the field of view. "Number exact" counts the logs
whose number of landmarks is that of the landmarks seen at least twice. The error is compared with that of the same graph
with the true ids and without the false sightings. "limit" says for robots of MR.CLAM 6 how many sightings could be
told apart if trajectory and map were known. "verdict" compares `Association.verdict` with the truth in random worlds,
with --missed where the odometry misses a motion. "repair" has drives among 14 landmarks with such a motion, and drives
through two rooms that look alike, without one, both of `tests/graphslam/test_leaps.py`.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from comparisons.estimators.filters import identified
from comparisons.options import RunOptions
from fastslam import associate
from graphslam import Graph, Log, MotionModel, SensorModel, SlamError, load, sample_log_path, simulate, solve
from graphslam.association import associate_from, score
from graphslam.log import UNIDENTIFIED
from graphslam.metrics import ate, mean_nees
from graphslam.models import additional_variances
from graphslam.se2 import wrap

DATA = Path(os.environ.get("SLAM_DATA", Path(__file__).parents[1] / "../shared/data"))
#: the fifth part of the book's noise
PART = 5
MOTION = MotionModel(nn=0.19 / PART, no=0.001 / PART, on=0.13 / PART, oo=0.2 / PART, epsilon=1e-4 / PART**2)
SENSOR = SensorModel(range_rate=0.14 / PART, bearing_std=0.05 / PART, orientation_std=0.05 / PART)
#: the squared distance within which 0.999 of the sightings of a landmark are
GATE = 13.8
#: a map is good up to this ratio of its ATE to that of the graph with the true ids
GOOD = 1.5
BY_HAND = {"motion": MotionModel.constant(0.1, 0.3, epsilon=1e-8), "sensor": SensorModel.constant(0.12, 0.02)}


def scattered(seed: int, count: int, apart: float, arena: float) -> np.ndarray:
    """Landmarks drawn uniformly, none nearer than ``apart`` to another; (count, 3)."""
    rng, places = np.random.default_rng(1000 + seed), []
    while len(places) < count:
        place = rng.uniform(-arena, arena, 2)
        if all(np.hypot(*(place - other)) >= apart for other in places):
            places.append(place)
    return np.column_stack([places, rng.uniform(-np.pi, np.pi, count)])


def with_clutter(log: Log, seed: int, missed: float = 0.1, clutter: float = 0.1) -> Log:
    """The log without a share of its sightings, and with false ones, uniform over the field of view; their id is -1."""
    rng = np.random.default_rng(2000 + seed)
    kept = rng.random(len(log.steps)) >= missed
    steps, ids, z = log.steps[kept], log.landmarks[kept], log.sightings[kept]
    count = int(rng.binomial(len(steps), clutter))
    false = np.column_stack([6.0 * np.sqrt(rng.random(count)), rng.uniform(-np.pi / 3, np.pi / 3, count)])
    if z.shape[1] == 3:
        false = np.column_stack([false, rng.uniform(-np.pi, np.pi, count)])
    steps = np.concatenate([steps, rng.choice(log.num_poses, count)])
    order = np.argsort(steps, kind="stable")
    return replace(
        log, steps=steps[order], landmarks=np.concatenate([ids, np.full(count, UNIDENTIFIED)])[order],
        sightings=np.concatenate([z, np.maximum(false, [[0.5, *[-9] * (z.shape[1] - 1)]])])[order],
    )  # fmt: skip


def known(log: Log) -> Log:
    """The log with its true ids, without clutter."""
    true = log.landmarks != UNIDENTIFIED
    return replace(log, steps=log.steps[true], landmarks=log.landmarks[true], sightings=log.sightings[true])


def solved(log: Log, models: dict) -> np.ndarray:
    """The poses of the graph with the ids of a log."""
    return log.at_truth(solve(Graph.from_log(log, edges="landmark+motion", **models)).poses)


def simulated(logs: int, apart: float, psi: bool) -> None:
    """The table of the simulated logs, for joint compatibility and for the nearest neighbour alone."""
    models = {"motion": MOTION, "sensor": SENSOR}
    distance = apart * SENSOR.range_rate * 6.0
    # a square in which so many landmarks fit at random
    arena = max(4.5, 0.9 * distance * 30**0.5)
    rows: dict[str, list] = {"joint": [], "nearest": []}
    for seed in range(logs):
        world = {"landmarks": scattered(seed, 30, distance, 4.5 if apart <= 4 else arena)}
        log = with_clutter(simulate(seed=seed, clean=True, orientation=psi, **world, **models), seed)
        _, counts = np.unique(known(log).landmarks, return_counts=True)
        best = ate(log.true_poses, solved(known(log), models))
        for method, found in rows.items():
            begin = time.perf_counter()
            a = associate(log, front_end="batch", method=method, keep_ids=False, **models)
            seconds = time.perf_counter() - begin
            s = score(a.ids, log.landmarks)
            error = ate(log.true_poses, solved(a.log, models))
            found.append(
                (a.landmarks - np.sum(counts > 1), error, best, s.precision, s.recall, s.doubled, s.invented, seconds)
            )
    for method, found in rows.items():
        off, error, best, precision, recall, doubled, invented, seconds = np.array(found).T
        print(
            f"{apart:g} sigma, psi {psi!s:5}, {method:7}: number exact in {np.sum(off == 0)} of {logs} (off by one "
            f"{np.sum(np.abs(off) == 1)}); ATE / known ids median {np.median(error / best):.3f}, mean "
            f"{error.mean() / best.mean():.3f}, worst {np.max(error / best):.2f}; precision {precision.mean():.4f}, recall "
            f"{recall.mean():.4f}; doubled {doubled.sum():.0f}, invented {invented.sum():.0f}; {np.median(seconds):.2f} s",
            flush=True,
        )


def real(name: str, front_end: str, particles: int) -> None:
    """One line on a log with hidden ids, with the front end of ``run`` and so many particles."""
    log: Log
    if name.startswith("mrclam"):
        log = load(DATA / "mrclam6", robot=int(name[-1])).replace(**BY_HAND)
    elif name == "woods":
        log = load(DATA / "lost_in_the_woods/dataset2.mat").nearer_than(5.0)
        log = log.at_steps(np.arange(0, log.num_poses, 5))
    else:
        log = load(
            {"sample": sample_log_path(), "huang": DATA / "simulated_535", "victoria": DATA / "victoria_park"}[name]
        )
    begin = time.process_time()
    _, a = identified(
        log, RunOptions.of(front_end=front_end, front_particles=particles, association="maximum-likelihood")
    )
    assert a is not None
    poses = solved(a.log, {})
    seconds = time.process_time() - begin
    unaligned = np.sqrt(np.nanmean(np.sum((poses - log.true_poses)[:, :2] ** 2, axis=1)))
    line = f"{name}: {a.landmarks} landmarks, {a.clutter} of {len(a.ids)} clutter, {a.ambiguous} ambiguous, "
    line += f"{len(a.ambiguities)} ambiguous, J/dof {a.cost_per_dof:.2f}, ATE {ate(log.true_poses, poses):.3f} m (unaligned "
    line += f"{unaligned:.3f} m), {seconds:.1f} s"
    if log.identified:
        s = score(a.ids, log.landmarks)
        line += f"; with ids {ate(log.true_poses, solved(log, {})):.3f} m, precision {s.precision:.4f}, recall {s.recall:.4f}"
        line += f", found {s.found}, missed {s.missed}, doubled {s.doubled}, invented {s.invented}"
    print(line, flush=True)


def limit(robot: int) -> None:
    """How often the true landmark is the most likely one from the true pose on the true map: noise mixes up the others."""
    log = load(DATA / "mrclam6", robot=robot).replace(**BY_HAND)
    ids = np.array(sorted(log.true_landmarks))
    places = np.array([log.true_landmarks[j][:2] for j in ids.tolist()])
    kept = np.isfinite(log.true_poses[log.steps, 2])
    z, true = log.sightings[kept], np.searchsorted(ids, log.landmarks[kept])
    e = z[:, None] - log.sensor.h(log.true_poses[log.steps[kept]][:, None], places)
    e[..., 1] = wrap(e[..., 1])
    squared = np.sum(e**2 / np.diagonal(log.sensor.Q(z), axis1=1, axis2=2)[:, None], axis=-1)
    right = np.argmin(squared, axis=1) == true
    far = squared[np.arange(len(z)), true] > GATE
    print(
        f"robot {robot}: the true landmark is the most likely one of {np.mean(right):.3f} of {len(z)} sightings; "
        f"{np.mean(far):.3f} are outside of the gate of 0.999"
    )


def book(part: float) -> tuple[MotionModel, SensorModel]:
    """This part of the book's noise."""
    motion = MotionModel(
        nn=0.19 * part, no=0.001 * part, on=0.13 * part, oo=0.2 * part, epsilon=max(1e-4 * part**2, 1e-8)
    )
    return motion, SensorModel(range_rate=0.14 * part, bearing_std=0.05 * part, orientation_std=0.05 * part)


def random_world(seed: int) -> Log:
    """A short drive in a world of random size, density, noise and view; its log has true ids, and -1 for clutter.

    In 35 % of the worlds two or three places look alike, a quarter has psi, and in 60 % the noise models are off by a factor
    of 0.6 to 2, of motion and sensor each.
    """
    rng = np.random.default_rng([77, seed])
    size = float(np.exp(rng.uniform(np.log(3.5), np.log(12))))
    count = int(np.clip((2 * size) ** 2 * np.exp(rng.uniform(np.log(0.03), np.log(0.4))), 4, 70))
    alike = rng.random() < 0.35
    marks = rng.uniform(-size, size, (count, 2))
    if alike:
        k, side = int(rng.integers(3, 7)), rng.uniform(1.0, 2.0)
        patch, copies = rng.uniform(-side, side, (k, 2)), int(rng.integers(2, 4))
        for _ in range(copies):
            a = rng.choice([0, np.pi / 2, np.pi])
            turn = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
            marks = np.concatenate([marks, patch @ turn.T + rng.uniform(-size * 0.8, size * 0.8, 2)])
        if rng.random() < 0.3:
            marks = marks[rng.permutation(len(marks))[: max(len(marks) - count // 2, 4)]]
    psi = bool(rng.random() < 0.25)
    of_motion, of_sensor = (float(np.exp(rng.uniform(np.log(a), np.log(b)))) for a, b in ((0.1, 1.5), (0.05, 0.7)))
    told = np.exp(rng.uniform(np.log(0.6), np.log(2), 2)) if rng.random() < 0.6 else np.ones(2)
    route = rng.uniform(-size * 0.8, size * 0.8, (int(rng.integers(3, 7)), 2))
    view, far = float(rng.choice([np.pi / 3 * 2, np.pi, 2 * np.pi])), float(rng.uniform(2.5, 6))
    steps, speed = int(rng.integers(50, 121)), float(rng.uniform(0.3, 0.7))
    log = simulate(
        seed=seed + 5000, clean=True, orientation=psi, motion=book(of_motion)[0], sensor=book(of_sensor)[1], steps=steps,
        dt=1.0, speed=speed, turn_rate=0.6, way_points=route, start=(*route[0], 0.0), max_range=far, field_of_view=view,
        landmarks=np.column_stack([marks, rng.uniform(-np.pi, np.pi, len(marks))]), arena=size,
    )  # fmt: skip
    missed, clutter = float(rng.uniform(0, 0.3)), float(rng.choice([0, rng.uniform(0, 0.2)]))
    kept = rng.random(len(log.steps)) >= missed
    n = int(rng.binomial(kept.sum(), clutter))
    false = np.column_stack([np.maximum(0.5, far * np.sqrt(rng.random(n))), rng.uniform(-view / 2, view / 2, n)])
    if psi:
        false = np.column_stack([false, rng.uniform(-np.pi, np.pi, n)])
    at = np.concatenate([log.steps[kept], rng.integers(0, log.num_poses, n)])
    order = np.argsort(at, kind="stable")
    return replace(
        log, steps=at[order], landmarks=np.concatenate([log.landmarks[kept], np.full(n, UNIDENTIFIED)])[order],
        sightings=np.concatenate([log.sightings[kept], false])[order],
        motion=book(of_motion * told[0])[0], sensor=book(of_sensor * told[1])[1],
    )  # fmt: skip


def without_motion(log: Log, metres: float, turn: float) -> Log:
    """The log whose odometry missed a motion in the middle of the drive, forward and by a turn."""
    controls, middle = log.controls.copy(), len(log.controls) // 2
    controls[middle] -= np.array([metres, turn]) / log.dt[middle]
    changed = log.replace(controls=controls)
    return changed.replace(initial_poses=changed.dead_reckoning())


def with_unknown_middle(log: Log) -> Log:
    """The log in which the motion in the middle of the drive counts for nothing."""
    variances = additional_variances(log.control_variances, len(log.controls))
    variances[len(log.controls) // 2] += 1e4
    return log.replace(control_variances=variances)


def verdicts(first: int, worlds: int, missed: list[float]) -> None:
    """How often a map that is called reliable is bad, and a good one reliable; worlds with 20 to 320 sightings count.

    In the middle of each drive the odometry has ``missed`` a motion forward [m] and a turn [rad]. With the true ids this
    motion is then known to be unknown.
    """
    rows: list[tuple[bool, bool, int, float]] = []
    seed, doubled, mended = first, [0, 0], 0
    while len(rows) < worlds:
        log, seed = random_world(seed), seed + 1
        if not 20 <= len(log.steps) <= 320:
            continue
        hidden = log.replace(landmarks=np.full(len(log.steps), UNIDENTIFIED))
        if any(missed):
            hidden, log = without_motion(hidden, *missed), with_unknown_middle(log)
        begin = time.process_time()
        try:
            _, a = identified(hidden, RunOptions.of(seed=(seed - 1) % 97))
        except SlamError as error:
            print(f"{seed - 1}: {error}")
            continue
        assert a is not None
        best = ate(log.true_poses, solved(known(log), {}))
        ratio = ate(log.true_poses, a.poses) / best
        v = a.verdict
        said = [each for each in v.reasons if "the map is there twice" in each]
        doubled[0] += bool(said)
        mended += bool(a.repaired)
        doubled[1] += bool(said) and len(said) == len(v.reasons)
        rows.append((v.reliable, ratio <= GOOD, v.starts, time.process_time() - begin))
        print(
            f"{seed - 1}: ATE / with ids {ratio:.2f}, lead {v.lead:.1f}, {v.agreeing} of {v.starts}, {v.reliable}",
            flush=True,
        )
    reliable, good, starts, seconds = np.array(rows, dtype=float).T
    both = np.sum(reliable * good)
    print(
        f"{worlds} worlds from seed {first} on: {good.sum():.0f} good; called reliable {reliable.sum():.0f}, of which "
        f"{reliable.sum() - both:.0f} are bad; {both / good.sum():.2f} of the good ones are called reliable; starts "
        f"{np.mean(starts):.2f}, {np.mean(seconds):.2f} s of processor time (mean); repaired {mended}; the map may be "
        f"there twice: {doubled[0]}, for {doubled[1]} of which that is the only reason"
    )


def repairs(drives: int) -> None:
    """Maps after a motion that odometry missed, and of two rooms that look alike."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "graphslam"))
    from test_leaps import circling, two_rooms

    for push in ((1.0, 0.0, 0.5), (-1.5, 1.0, -1.0), (4.0, 3.0, 2.5), (0.7, -0.3, 0.4)):
        for seed in range(20, 20 + drives):
            log = circling(seed, push)
            found = associate_from(log, start=[None, None])
            solution = solve(Graph.from_log(found.log))
            nees = mean_nees(solution.poses, log.true_poses, solution.covariance())
            print(f"missed {push}, seed {seed}: repaired {len(found.repaired)}, {found.landmarks} landmarks, "
                  f"ATE {ate(log.true_poses, solution.poses):.3f} m, NEES / 3 {nees:.2f}", flush=True)  # fmt: skip
    for apart in (11.0, 12.0, 14.0, 20.0):
        every = [associate_from(two_rooms(seed, apart), start=[None, None]) for seed in range(20, 20 + drives)]
        joined = sum(found.repaired != () or found.landmarks != 28 for found in every)
        doubted = sum(not found.verdict.reliable for found in every)
        print(f"rooms {apart:g} m apart: {joined} of {drives} joined, {doubted} doubted", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(dest="verb", required=True)
    sub = verbs.add_parser("simulated")
    sub.add_argument("--logs", type=int, default=100)
    sub.add_argument("--apart", type=float, default=4.0)
    sub.add_argument("--psi", action="store_true")
    sub = verbs.add_parser("real")
    sub.add_argument("names", nargs="+")
    sub.add_argument("--front-end", default="batch")
    sub.add_argument("--particles", type=int, default=30)
    sub = verbs.add_parser("limit")
    sub.add_argument("robots", nargs="+", type=int)
    sub = verbs.add_parser("verdict")
    sub.add_argument("--first", type=int, default=3000)
    sub.add_argument("--worlds", type=int, default=200)
    sub.add_argument("--missed", type=float, nargs=2, default=[0.0, 0.0], metavar=("METRES", "RADIANS"))
    sub = verbs.add_parser("repair")
    sub.add_argument("--drives", type=int, default=4)
    given = parser.parse_args()
    if given.verb == "simulated":
        simulated(given.logs, given.apart, given.psi)
    elif given.verb == "repair":
        repairs(given.drives)
    elif given.verb == "verdict":
        verdicts(given.first, given.worlds, given.missed)
    elif given.verb == "limit":
        for robot in given.robots:
            limit(robot)
    else:
        for name in given.names:
            real(name, given.front_end, given.particles)
