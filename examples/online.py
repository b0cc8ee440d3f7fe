"""Graph SLAM on standard input, line by line, without ROS: a motion or a sighting per line, a pose per motion.

    u nu omega dt            the robot drives with nu [m/s] and omega [rad/s] for dt [s]
    z id range bearing [psi]  and then sees a landmark [m, rad, rad]

    printf 'u 1 0 1\\nz 7 2 0.3\\nu 1 0.1 1\\nz 7 1.2 0.5\\n' | python examples/online.py

After each motion with its sightings, it prints x, y, theta and their standard deviations; at the end, the map. Empty lines
and those that begin with # are left out. A line that makes no sense, and a step that is refused, are reported on standard
error, and the run goes on.
"""

import sys

import numpy as np

from graphslam import OnlineSolver, SlamError


def main() -> None:
    """Read lines until the end."""
    solver, control, seen = OnlineSolver(), None, []

    def take() -> None:
        if control is None and not seen:
            return
        moved = {"pose": 0} if control is None else {"control": control[:2], "dt": control[2]}
        ids, sightings = [landmark for landmark, _ in seen], [z for _, z in seen]
        try:
            pose = solver.step(**moved, ids=ids, sightings=sightings)
        except SlamError as error:
            print(f"step before line {number}: {error}", file=sys.stderr)
            return
        std = np.sqrt(np.diag(solver.covariance()))
        print(*(f"{value:.4f}" for value in (*pose, *std)), flush=True)

    number = 0
    for number, line in enumerate(sys.stdin, start=1):
        words = line.split()
        try:
            match words:
                case ["u", nu, omega, dt]:
                    following = float(nu), float(omega), float(dt)
                    take()
                    control, seen = following, []
                case ["z", landmark, *measured] if len(measured) in (2, 3):
                    seen.append((int(landmark), [float(word) for word in measured]))
                case [word, *_] if not word.startswith("#"):
                    raise ValueError
        except ValueError:
            print(
                f"line {number} is neither 'u nu omega dt' nor 'z id range bearing [psi]': {line.strip()}",
                file=sys.stderr,
            )
    number += 1
    take()
    for landmark, mark in solver.landmarks.items():
        print("landmark", landmark, *(f"{value:.4f}" for value in mark))


if __name__ == "__main__":
    main()
