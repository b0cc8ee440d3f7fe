"""Maps with the right ids that are not of this place: does `graphslam.first_fix` refuse them, and only them?

    python benchmarks/map_of_another_place.py [--first 1000] [--maps 200] [--cases right noise errors moved random permuted]

Worlds are small: 4 to 12 landmarks in 8 m x 8 m and drives of 8 to 60 poses, half of them with the noise of the book and half
with a tenth to a third of it, half of them with psi. The map is

    right       the true one,
    noise       the true one, while robot and sensor have one and a half times the noise that the models say,
    errors      the true one with errors of 0.1 m (and 0.05 rad) and covariances that say so,
    moved       the true one, of whose landmarks 30 % have moved by 0.5 to 3 m,
    random      landmarks of the same ids at random places,
    permuted    the true places, each with the id of another.

Worlds in which one landmark is seen that has no heading are left out. A fix is accepted, accepted with a word where its odds
are not above 1000, or refused. Of those accepted, a fix is
wrong if its error has a squared Mahalanobis distance beyond 30.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from dataclasses import replace

import numpy as np

from graphslam import GraphError, LandmarkMap, Log, MotionModel, SensorModel, first_fix, simulate
from graphslam.maps.localization import SURE
from graphslam.se2 import wrap

BOOK = MotionModel(), SensorModel()
GOOD = (
    MotionModel(nn=0.05, no=0.001, on=0.03, oo=0.05, epsilon=1e-6),
    SensorModel(range_rate=0.03, bearing_std=0.02, orientation_std=0.02),
)
CASES = ("right", "noise", "errors", "moved", "random", "permuted")
ARENA, MOVED, ERROR, HEADING_ERROR = 8.0, 0.3, 0.1, 0.05


def world(case: str, seed: int) -> tuple[Log, LandmarkMap, MotionModel, SensorModel]:
    """A drive, a map, and what the models say."""
    rng = np.random.default_rng(seed)
    motion, sensor = (BOOK, GOOD)[seed % 2]
    log = simulate(
        seed=seed, clean=True, arena=ARENA, landmarks=int(rng.integers(4, 13)), steps=int(rng.integers(8, 61)),
        orientation=bool(seed // 2 % 2), motion=motion, sensor=sensor, max_range=float(rng.uniform(4, 10)),
    )  # fmt: skip
    assert log.true_landmarks is not None
    ids = list(log.true_landmarks)
    places, covariances = np.array([np.resize(m, 3) for m in log.true_landmarks.values()]), {}
    if not log.has_orientation:
        places = places[:, :2]
    if case == "noise":
        motion = replace(motion, **{name: getattr(motion, name) / 1.5 for name in ("nn", "no", "on", "oo")})
        stds = "range_rate", "bearing_std", "orientation_std"
        sensor = replace(sensor, **{name: getattr(sensor, name) / 1.5 for name in stds})
    if case == "errors":
        std = np.array([ERROR, ERROR, HEADING_ERROR])[: places.shape[1]]
        places = places + std * rng.normal(size=places.shape)
        covariances = dict.fromkeys(ids, np.diag(std**2))
    if case == "moved":
        chosen = rng.permutation(len(ids))[: int(MOVED * len(ids))]
        way, angle = rng.uniform(0.5, 3.0, len(chosen)), rng.uniform(-np.pi, np.pi, len(chosen))
        places[chosen, :2] += way[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    if case == "random":
        half = np.array([ARENA / 2, ARENA / 2, np.pi])[: places.shape[1]]
        places = rng.uniform(-half, half, places.shape)
    if case == "permuted":
        places = places[np.roll(order := rng.permutation(len(ids)), 1)[np.argsort(order)]]
    return log, LandmarkMap(dict(zip(ids, places)), covariances), motion, sensor


def main() -> None:
    """Print a line for each case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--maps", type=int, default=200)
    parser.add_argument("--cases", nargs="*", default=list(CASES), choices=CASES)
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args()
    for case in options.cases:
        found: Counter[str] = Counter()
        seconds = []
        for seed in range(options.first, options.first + options.maps):
            log, known, motion, sensor = world(case, seed)
            if len(set(log.landmarks.tolist())) < 2 - log.has_orientation:
                continue
            begin = time.process_time()
            try:
                fix = first_fix(log, known, motion=motion, sensor=sensor)
            except GraphError as error:
                found["refused"] += 1
                if options.verbose and case not in ("random", "permuted"):
                    print(f"{case} {seed}: {error}")
                continue
            finally:
                seconds.append(time.process_time() - begin)
            name = "accepted" if fix.odds > SURE else "accepted with a word"
            if options.verbose and case in ("random", "permuted"):
                print(f"{case} {seed}: {name}, {fix!r} odds {fix.odds:.3g} of {len(known)}")
            found[name] += 1
            if case in ("random", "permuted"):
                continue
            assert log.true_poses is not None
            off = fix.pose - log.true_poses[0]
            off[2] = wrap(off[2])
            wrong = off @ np.linalg.solve(fix.covariance, off) > 30
            found["wrong" if fix.odds > SURE else "wrong with a word"] += int(wrong)
            if wrong and options.verbose:
                print(f"{case} {seed}: wrong, {fix!r} odds {fix.odds:.3g}, error {off}")
        print(
            f"{case:9} of {len(seconds)}: "
            + ", ".join(f"{name} {count}" for name, count in sorted(found.items()))
            + f"; {1e3 * np.median(seconds):.0f} ms, at most {1e3 * max(seconds):.0f} ms",
            flush=True,
        )


if __name__ == "__main__":
    main()
