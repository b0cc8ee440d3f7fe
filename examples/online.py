"""Graph SLAM on standard input, line by line, without ROS: a motion or a sighting per line, a pose per motion.

    u nu omega dt            the robot drives with nu [m/s] and omega [rad/s] for dt [s]
    z id range bearing [psi]  and then sees a landmark [m, rad, rad]

    printf 'u 1 0 1\\nz 7 2 0.3\\nu 1 0.1 1\\nz 7 1.2 0.5\\n' | python examples/online.py

After each motion with its sightings, it prints x, y, theta and their standard deviations; at the end, the map.
"""

import sys
from copy import copy

import numpy as np

from graphslam import OnlineSolver, OptionError, SlamError


def main() -> None:
    """Read lines until the end; what is refused is reported with its line, and the run goes on."""
    solver = OnlineSolver()
    # a motion, and what is seen after it; before the first motion, landmarks are seen from the first pose
    began, control, readable, seen = 1, (), True, []

    def take() -> None:
        nonlocal solver
        if not control and not seen:
            return
        branch = copy(solver)
        try:
            if not readable:
                raise OptionError("the motion before it is unknown")
            if control:
                branch.move(*control)
            branch.observe([landmark for landmark, _ in seen], [z for _, z in seen])
        except SlamError as error:
            print(f"line {began}: the step from here on is left out: {error}", file=sys.stderr)
            return
        solver = branch
        std = np.sqrt(np.diag(solver.covariance()))
        print(*(f"{value:.4f}" for value in (*solver.pose, *std)), flush=True)

    for number, line in enumerate(sys.stdin, start=1):
        match line.split():
            case ["u", *words] if len(words) == 3 and all(map(is_number, words)):
                take()
                nu, omega, dt = map(float, words)
                began, control, readable, seen = number, ((nu, omega), dt), True, []
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
                    began, control, readable, seen = number, (), False, []
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
