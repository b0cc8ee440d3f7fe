"""The odometry of a drive: its motions and their covariances between any of its poses, for biases that change.

A log may have fifty controls for each pose and fifty poses for each that a problem needs, and an estimate evaluates its
motions a hundred times. So the controls are evaluated rarely, and motions are joined from those between successive poses:
with R the rotation of the heading that the robot has before motion i, and d its way after motion i until the end, both in the
axes of the first pose, errors (e_xy, e_theta) of motion i move the end by

    L_i e,    L_i = ( R   (-d_y, d_x)' )
                    ( 0        1       ).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..log import Log
from ..models import MotionModel
from ..parameters.corrections import controls_at_steps, corrected_controls, motion_slopes
from ..parameters.declared import Parameters
from ..se2 import Array, rotation
from .parts import motion_parts

#: the fields of the motion model whose variances are estimated
ESTIMATED = ("nn", "on", "oo", "slip", "sigma_omega")
#: motion without noise of its own
STILL = MotionModel(nn=0.0, no=0.0, on=0.0, oo=0.0, epsilon=1e-20)
#: parameters that differ by less than this are near: what a derivative leaves out of a motion is some 1e-5 of it
NEAR = {"wheel_scale": 0.006, "turn_scale": 0.006, "turn_rate_bias": 0.002, "curvature_bias": 0.002}


class Odometry:
    """The motions of a log with controls.

    Attributes:
        log: the log.
        times: (T+1,) of its poses [s].
    """

    def __init__(self, log: Log) -> None:
        assert log.controls is not None and log.dt is not None and log.times is not None
        self.log, self.times = log, log.times
        self._parts = motion_parts(log, ESTIMATED)
        # what the log itself says of the noise of single controls, such as across a silence of the odometry
        self._recorded, self._of_gaps = STILL.accumulate(
            log.controls, log.dt, log.control_starts, log.control_variances
        )
        self._evaluated: tuple[Array, Array, Array] | None = None

    def covers(self, log: Log) -> bool:
        """Whether all poses of a log are poses of this one."""
        assert log.times is not None
        return bool(np.isin(log.times, self.times).all())

    def steps(self, log: Log) -> np.ndarray:
        """The numbers of the poses of a log that this one covers."""
        assert log.times is not None
        return np.searchsorted(self.times, log.times)

    def parts(self, steps: np.ndarray) -> tuple[Mapping[str, Array], Array]:
        """C_p (n, 3, 3) of each field of the motion model for the motions between poses, and what is known of gaps."""
        if len(steps) == len(self.times):
            return self._parts, self._of_gaps
        inside = slice(steps[0], steps[-1])
        levers = _joined(self._recorded[inside], steps - steps[0])[1]

        def joined(C: Array) -> Array:
            return np.add.reduceat(levers @ C[inside] @ np.swapaxes(levers, 1, 2), steps[:-1] - steps[0])

        return {name: joined(C) for name, C in self._parts.items()}, joined(self._of_gaps)

    def motions(self, parameters: Parameters, steps: np.ndarray) -> tuple[Array, Array]:
        """The motions (n, 3) of the corrected controls between poses, and their derivative (n, 3, K) by the parameters."""
        motions, slopes = self._single(parameters)
        if len(steps) == len(self.times):
            return motions, slopes
        inside = slice(steps[0], steps[-1])
        motions, levers = _joined(motions[inside], steps - steps[0])
        return motions, np.add.reduceat(levers @ slopes[inside], steps[:-1] - steps[0])

    def poses(self, parameters: Parameters) -> Array:
        """The poses (T+1, 3) of the corrected controls."""
        start, motions = self.log.initial_poses[0], self._single(parameters)[0]
        heading = start[2] + np.concatenate([[0.0], np.cumsum(motions[:, 2])])
        ways = np.einsum("eij,ej->ei", rotation(heading[:-1]), motions[:, :2])
        return np.column_stack([start[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(ways, axis=0)]), heading])

    def speeds(self, parameters: Parameters) -> Array:
        """The control (T+1, 2) at each pose, `controls_at_steps`."""
        return controls_at_steps(replace(parameters, recorded=self.log))

    def _single(self, parameters: Parameters) -> tuple[Array, Array]:
        """`motions` between successive poses."""
        if self._evaluated is not None and near(parameters, self._evaluated[0]):
            at, motions, slopes = self._evaluated
            return motions + slopes @ (parameters.values - at), slopes
        everything = replace(parameters, recorded=self.log)
        self._evaluated = (parameters.values, *motion_slopes(everything, corrected_controls(everything), smooth=True))
        return self._evaluated[1:]


def near(parameters: Parameters, values: Array) -> bool:
    """Whether parameters are so near the values (K,) of an evaluation that its derivatives are enough (`NEAR`)."""
    k = [parameters.names.index(name) for name in NEAR]
    return bool(np.all(np.abs(parameters.values - values)[k] <= list(NEAR.values())))


def _joined(motions: Array, steps: np.ndarray) -> tuple[Array, Array]:
    """The motions (n, 3) between steps, from the first to the last, and L (T, 3, 3) of each motion (T, 3) that they join."""
    first, count = steps[:-1], np.diff(steps)

    def before(values: Array) -> Array:
        """The sum of the earlier values of the same joined motion."""
        total = np.cumsum(values, axis=0) - values
        return total - np.repeat(total[first], count, axis=0)

    turned = rotation(before(motions[:, 2]))
    ways = np.einsum("eij,ej->ei", turned, motions[:, :2])
    joined = np.column_stack([np.add.reduceat(ways, first), np.add.reduceat(motions[:, 2], first)])
    left = np.repeat(joined[:, :2], count, axis=0) - before(ways) - ways
    levers = np.zeros((len(motions), 3, 3))
    levers[:, :2, :2], levers[:, 2, 2] = turned, 1.0
    levers[:, 0, 2], levers[:, 1, 2] = -left[:, 1], left[:, 0]
    return joined, levers
