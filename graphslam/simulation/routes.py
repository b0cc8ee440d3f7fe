"""`follow`: the true motion of a robot along way points, with limits of speed, turn rate and acceleration, and with stops."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import atan2, cos, hypot, pi, sin, sqrt

import numpy as np

from ..models import MotionModel
from ..se2 import Array

#: the interval at which the robot is steered [s], and its greatest accelerations [m/s², rad/s²]
INTERVAL, ACCELERATION, TURN_ACCELERATION = 0.05, 0.8, 2.5
#: turn rate per heading error [1/s]; the heading error above which the robot turns in place [rad]
GAIN, SHARP = 2.0, 0.8


@dataclass(frozen=True)
class Path:
    """A true trajectory: knots every `INTERVAL` seconds from time 0, and between them arcs on which the robot slips evenly.

    Attributes:
        poses: (K+1, 3), headings not wrapped.
        controls: (K, 2) true speeds and turn rates.
        slips: (K,) how far the robot slips to its left [m].
    """

    poses: Array
    controls: Array
    slips: Array

    @property
    def duration(self) -> float:
        """The time of the last knot [s]."""
        return len(self.controls) * INTERVAL

    def at(self, times: Array) -> Array:
        """The poses (N, 3) at times (N,) [s]."""
        k = np.clip((times / INTERVAL).astype(np.int64), 0, len(self.controls) - 1)
        lapse = times - k * INTERVAL
        poses = MotionModel().f(self.poses[k], self.controls[k], lapse)
        across = self.poses[k, 2] + self.controls[k, 1] * INTERVAL / 2
        part = self.slips[k] * lapse / INTERVAL
        poses[:, 0] -= part * np.sin(across)
        poses[:, 1] += part * np.cos(across)
        return poses

    def odometry(self, times: Array) -> Array:
        """The controls (N, 2), each constant until the next time, that lead from pose to pose at ``times`` (N,).

        The arc with the turn and with the part of the displacement along its chord; slip is not seen. The last control is
        that before it.
        """
        poses = self.at(times)
        lasting, (dx, dy, turn) = np.diff(times), np.diff(poses, axis=0).T
        along = poses[:-1, 2] + turn / 2
        # np.sinc is sin(pi x) / (pi x)
        nu = (dx * np.cos(along) + dy * np.sin(along)) / (lasting * np.sinc(turn / (2 * pi)))
        controls = np.column_stack([nu, turn / lasting])
        return np.concatenate([controls, controls[-1:]])


def follow(
    route: Iterable[tuple[float, float, float]], *, speed: float, turn_rate: float, duration: float, slip: float,
    wander: float, rng: np.random.Generator,
) -> Path:  # fmt: skip
    """Drive from the first way point on along the straight lines between way points.

    Args:
        route: way points (x, y, pause): where, and for how long the robot stops there [m, m, s]; as many as the time needs.
        speed, turn_rate: the highest ones [m/s, rad/s].
        duration: of the drive [s].
        slip: noise sideways per distance driven [m/√m].
        wander: standard deviation of the robot's distance from the lines, drawn for each line [m].
        rng: of slip and wander.
    """
    steps = int(np.ceil(duration / INTERVAL))
    normals = (slip * rng.standard_normal(steps)).tolist()
    ahead, dt = 0.5 + 0.6 * speed, INTERVAL
    points = iter(route)
    ax, ay, _ = next(points)
    bx, by, pause = _other_than(ax, ay, points)
    x, y, theta, nu, omega, rest = ax, ay, atan2(by - ay, bx - ax), 0.0, 0.0, 0.0
    side = 0.0
    poses, controls, slips = [(x, y, theta)], [], []
    for k in range(steps):
        length = hypot(bx - ax, by - ay)
        ux, uy = (bx - ax) / length, (by - ay) / length
        left = length - (x - ax) * ux - (y - ay) * uy
        if left < 0.15 + 0.2 * nu and rest <= 0:
            rest = pause
            ax, ay = bx, by
            bx, by, pause = _other_than(ax, ay, points)
            side = wander * float(rng.standard_normal())
        if rest > 0:
            rest -= dt
            want, turn = 0.0, 0.0
        else:
            # towards a point ahead on the line, beside which the robot drives
            on = min(length - left + ahead, length + 0.3)
            px, py = ax + ux * on - uy * side, ay + uy * on + ux * side
            off = (atan2(py - y, px - x) - theta + pi) % (2 * pi) - pi
            turn = min(max(GAIN * off, -turn_rate), turn_rate)
            # slower towards the end of a line, and while the robot has to turn
            want = min(speed * max(0.0, 1 - abs(off) / SHARP), sqrt(2 * ACCELERATION * max(left, 0.0)) + 0.1)
        most = ACCELERATION * dt
        nu += min(max(want - nu, -most), most)
        most = TURN_ACCELERATION * dt
        omega += min(max(turn - omega, -most), most)
        half = omega * dt / 2
        chord = nu * dt * (sin(half) / half if abs(half) > 1e-9 else 1.0)
        across = normals[k] * sqrt(abs(nu) * dt)
        c, s = cos(theta + half), sin(theta + half)
        x, y, theta = x + chord * c - across * s, y + chord * s + across * c, theta + 2 * half
        poses.append((x, y, theta))
        controls.append((nu, omega))
        slips.append(across)
    return Path(np.array(poses), np.array(controls), np.array(slips))


def _other_than(x: float, y: float, points: Iterator[tuple[float, float, float]]) -> tuple[float, float, float]:
    """The next way point that is not at (x, y)."""
    return next(point for point in points if hypot(point[0] - x, point[1] - y) > 1e-6)
