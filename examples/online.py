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
    """Read lines until the end; what is refused is reported with its line, and the run goes on."""
    solver, began, seen = OnlineSolver(), 1, []
    # what is seen before the first motion is seen from the first pose
    moved: dict = {"pose": 0}

    def take() -> None:
        if "control" not in moved and not seen:
            return
        ids, sightings = [landmark for landmark, _ in seen], [z for _, z in seen]
        try:
            pose = solver.step(**moved, ids=ids, sightings=sightings)
        except SlamError as error:
            print(f"line {began}: the step from here on is left out: {error}", file=sys.stderr)
            return
        std = np.sqrt(np.diag(solver.covariance()))
        print(*(f"{value:.4f}" for value in (*pose, *std)), flush=True)

    for number, line in enumerate(sys.stdin, start=1):
        match line.split():
            case ["u", *words] if len(words) == 3 and all(map(is_number, words)):
                take()
                nu, omega, dt = map(float, words)
                began, moved, seen = number, {"control": (nu, omega), "dt": dt}, []
            case ["z", landmark, *words] if (
                landmark.removeprefix("-").isdecimal() and len(words) in (2, 3) and all(map(is_number, words))
            ):
                seen.append((int(landmark), [float(word) for word in words]))
            case []:
                pass
            case [kind, *_]:
                wanted = "u nu omega dt, or z id range bearing [psi]"
                print(f"line {number}: expected {wanted}, not {line.strip()!r}; left out", file=sys.stderr)
                if kind == "u":
                    # what is seen after an unknown motion is not seen from the pose before it, and is refused, too
                    take()
                    began, moved, seen = number, {}, []
    take()
    for landmark, mark in solver.landmarks.items():
        print("landmark", landmark, *(f"{value:.4f}" for value in mark))


def is_number(word: str) -> bool:
    """Whether a word is a number; the solver itself refuses those that are not finite."""
    try:
        float(word)
    except ValueError:
        return False
    return True


if __name__ == "__main__":
    main()
