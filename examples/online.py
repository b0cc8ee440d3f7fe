"""Graph SLAM on standard input, line by line, without ROS: a motion or a sighting per line, a pose per motion.

    u nu omega dt            the robot drives with nu [m/s] and omega [rad/s] for dt [s]
    z id range bearing [psi]  and then sees a landmark [m, rad, rad]

    printf 'u 1 0 1\\nz 7 2 0.3\\nu 1 0.1 1\\nz 7 1.2 0.5\\n' | python examples/online.py

After each motion with its sightings, it prints x, y, theta and their standard deviations; at the end, the map.
"""

import sys

import numpy as np

from graphslam import OnlineSolver, SlamError


def main() -> None:
    """Read lines until the end; a line that is refused is reported, and the run goes on."""
    solver, control, seen = OnlineSolver(), None, []

    def take() -> None:
        if control is None and not seen:
            return
        moved = {"pose": 0} if control is None else {"control": control[:2], "dt": control[2]}
        ids, sightings = [landmark for landmark, _ in seen], [z for _, z in seen]
        try:
            pose = solver.step(**moved, ids=ids, sightings=sightings)
        except SlamError as error:
            print(error, file=sys.stderr)
            return
        std = np.sqrt(np.diag(solver.covariance()))
        print(*(f"{value:.4f}" for value in (*pose, *std)), flush=True)

    for line in sys.stdin:
        kind, *words = line.split() or [""]
        if kind == "u":
            take()
            control, seen = [float(word) for word in words], []
        elif kind == "z":
            seen.append((int(words[0]), [float(word) for word in words[1:]]))
    take()
    for landmark, mark in solver.landmarks.items():
        print("landmark", landmark, *(f"{value:.4f}" for value in mark))


if __name__ == "__main__":
    main()
