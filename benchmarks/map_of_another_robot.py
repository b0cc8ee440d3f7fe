"""MR.CLAM robots in the map of another robot: the ATE in the frame of the map, and the sightings of the first fix.

    python benchmarks/map_of_another_robot.py ../shared/data/mrclam6 [--maps 1] [--robots 2 3]

The noise is estimated from each log without the ground truth. The map is that of one robot, moved rigidly so that
its landmarks are best on the true ones, so that errors in its frame are errors against the truth without an alignment. It is
compared with the true map and with the log alone, which is aligned.
"""

from __future__ import annotations

import argparse

import numpy as np

from graphslam import Graph, GraphError, LandmarkMap, Log, first_fix, load, solve
from graphslam.identification.known import known_robot
from graphslam.metrics import align, ate
from graphslam.se2 import Array, compose, rotation


def off(log: Log, poses: Array) -> float:
    """The root mean squared distance [m] from the truth, not aligned."""
    assert log.true_poses is not None
    way = np.hypot(*(log.at_truth(poses) - log.true_poses)[:, :2].T)
    return float(np.sqrt(np.nanmean(way**2)))


def sightings_of_fix(log: Log, known: LandmarkMap) -> tuple[int, float]:
    """How many sightings of the map a sure first fix takes, and its distance [m] from that of the whole log."""
    whole = first_fix(log, known)
    rows = np.flatnonzero(np.isin(log.landmarks, list(known)))
    for count in range(1, len(rows) + 1):
        kept = np.zeros(len(log.steps), dtype=bool)
        kept[rows[:count]] = True
        try:
            fix = first_fix(log.with_sightings(kept), known)
        except GraphError:
            continue
        if fix.odds > 1e3:
            return count, float(np.hypot(*(fix.pose - whole.pose)[:2]))
    return len(rows), 0.0


def main() -> None:
    """Print a line for each pair of a map and a robot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder")
    parser.add_argument("--maps", type=int, nargs="*", default=[1])
    parser.add_argument("--robots", type=int, nargs="*", default=[2, 3, 4, 5])
    options = parser.parse_args()
    logs = {r: known_robot(load(options.folder, robot=r), None)[0] for r in {*options.maps, *options.robots}}
    for made_by in options.maps:
        log = logs[made_by]
        true = log.true_landmarks
        assert true is not None
        known = solve(Graph.from_log(log, edges="landmark+motion")).map
        shared = [j for j in known if j in true]
        frame = align(np.array([true[j][:2] for j in shared]), np.array([known[j][:2] for j in shared]))
        assert known.joint is not None
        turn = np.kron(np.eye(len(known)), rotation(frame[2]))
        placed = compose(frame, np.array([np.append(place[:2], 0.0) for place in known.values()]))[:, :2]
        moved = LandmarkMap(dict(zip(known, placed)), joint=turn @ known.joint @ turn.T)
        exact = LandmarkMap({j: place[:2] for j, place in true.items()})
        for robot in options.robots:
            if robot == made_by:
                continue
            log = logs[robot]
            alone = solve(Graph.from_log(log, edges="landmark+motion")).poses
            here, best = (solve(Graph.from_log(log, map=each)).poses for each in (moved, exact))
            assert log.true_poses is not None
            count, way = sightings_of_fix(log, moved)
            mine, true_map = off(log, here), off(log, best)
            print(
                f"robot {robot} in the map of {made_by}: {mine:.3f} m, in the true map {true_map:.3f} m, ratio "
                f"{mine / true_map:.2f}; alone, aligned {ate(log.true_poses, log.at_truth(alone)):.3f} m; "
                f"first fix after {count} sightings, {way:.2f} m from that of the whole log",
                flush=True,
            )


if __name__ == "__main__":
    main()
