"""Lost in the Woods: a robot among seventeen tubes, odometry and laser at 10 Hz, with truth; one ``.mat`` file.

Source: Tim Barfoot, *AER1513 State Estimation for Robotics*, University of Toronto, assignment data set 2 (the robot
and course are those of *State Estimation for Robotics*, Cambridge University Press). Terms: course material, no licence
to redistribute.

Variables (K = 12,609 times, L = 17 landmarks)::

    t (K, 1) [s]; v, om (K, 1) speed [m/s] and turn rate [rad/s]
    r, b (K, L) range [m] and bearing [rad] of each landmark, range 0 where unseen
    d (1, 1) how far the laser is ahead of the robot's centre [m]
    r_var, b_var, v_var, om_var (1, 1) variances, of each sample
    x_true, y_true, th_true (K, 1), true_valid (K, 1); l (L, 2) true landmarks [m]

Ids of landmarks are their columns, from 0. Oddities: v and om of row k are those of the way from row k-1 to row k
(the course's x_k = f(x_{k-1}, v_k)); the
robot drives 0.074 rad (4.3 degrees) to the right of its true heading, to which the bearings do fit, so its motion has
a steady part to the side; the truth is not valid everywhere, and is NaN here where it is not. Every time is
a pose, seen or not: `Log.at_steps` and `Log.where_seen` thin it, joining the motions.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from ..errors import FormatError, LogError
from ..log import Log
from ..models import MotionModel, SensorModel
from ..sources.synchronize import BRIDGED_GAP, LONGEST_GAP, bridging, told_of_gaps
from .base import Format
from .mat import is_mat, numbers, read_mat, variables

_SERIES = ("t", "v", "om")
_TRUTH = ("x_true", "y_true", "th_true", "true_valid")
_NAMES = (*_SERIES, "r", "b", "d", "r_var", "b_var", "v_var", "om_var", *_TRUTH, "l")

#: [m², rad²] of each motion: the way aside, 2 mm a step, that speed and turn rate have no noise for
EPSILON = 1e-4


def _recognises(path: Path, head: bytes) -> bool:
    if path.is_dir():
        return (path / "dataset2.mat").is_file()
    return is_mat(head) and {"r", "b", "om"} <= variables(path)


def _read(path: Path) -> Log:
    if path.is_dir():
        path = path / "dataset2.mat"
        if not path.is_file():
            raise FormatError(path, None, "this file of the data set is missing; it would hold the whole log")
    content = read_mat(path, _NAMES)
    count = content["t"].shape[0]
    series = {name: numbers(path, name, content[name], (count, 1))[:, 0] for name in (*_SERIES, *_TRUTH)}
    ranges, landmarks = numbers(path, "r", content["r"], (count, None)), numbers(path, "l", content["l"], (None, 2))
    bearings = numbers(path, "b", content["b"], ranges.shape)
    single = {n: float(numbers(path, n, content[n], (1, 1))[0, 0]) for n in ("d", "r_var", "b_var", "v_var", "om_var")}
    dt = np.diff(series["t"])
    if np.any(dt <= 0):
        k = int(np.argmax(dt <= 0)) + 1
        raise FormatError(path, None, f"the times t run backwards or stand still at row {k + 1}")
    if np.any(dt > LONGEST_GAP):
        k = int(np.argmax(dt > LONGEST_GAP))
        raise FormatError(
            path, None, f"the odometry is silent for {dt[k]:.1f} s after t = {series['t'][k]:.3f} s, longer than "
            f"{LONGEST_GAP:g} s: cut the log there"
        )  # fmt: skip
    if len(landmarks) != ranges.shape[1]:
        raise FormatError(path, None, f"l has {len(landmarks)} landmarks, but r has {ranges.shape[1]} columns")
    steps, columns = np.nonzero(ranges > 0)
    if len(steps) == 0:
        raise FormatError(path, None, "no sighting of any landmark: nothing to estimate from")
    truth = np.column_stack([series["x_true"], series["y_true"], series["th_true"]])
    truth[series["true_valid"] == 0] = np.nan
    notes, covered = [], int(np.isfinite(truth[:, 0]).sum())
    if covered < count:
        notes.append(f"the truth covers {covered} of {count} poses")
    controls = np.column_stack([series["v"], series["om"]])[1:]
    gaps = dt[dt > BRIDGED_GAP].tolist()
    if gaps:
        notes.append(told_of_gaps(gaps))
        warnings.warn(f"{path}: {notes[-1]}", UserWarning, stacklevel=3)
    start = truth[0] if np.isfinite(truth[0, 0]) else np.zeros(3)
    try:
        return Log(
            dt=dt,
            controls=controls,
            control_variances=bridging(controls, dt, dt) if gaps else None,
            steps=steps,
            landmarks=columns,
            sightings=np.column_stack([ranges[steps, columns], bearings[steps, columns]]),
            initial_poses=MotionModel().dead_reckoning(start, controls, dt),
            true_poses=truth if covered else None,
            true_landmarks=dict(enumerate(landmarks)),
            start_time=float(series["t"][0]),
            motion=MotionModel.constant(
                single["v_var"] ** 0.5, single["om_var"] ** 0.5, epsilon=EPSILON
            ),
            sensor=SensorModel(
                range_rate=0.0, range_std=single["r_var"] ** 0.5, bearing_std=single["b_var"] ** 0.5,
                offset=(single["d"], 0.0),
            ),
            name="lost-in-the-woods",
            notes=tuple(notes),
        )  # fmt: skip
    except LogError as error:
        raise FormatError(path, None, str(error)) from None


FORMAT = Format("lost-in-the-woods", (), _recognises, _read)
