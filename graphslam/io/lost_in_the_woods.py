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

Ids of landmarks are their columns, from 0. Peculiarities: v and om of row k belong to the motion from row k-1 to row k
(the course's x_k = f(x_{k-1}, v_k)). The robot drives 0.074 rad (4.3 degrees) to the right of its true heading, to which
the bearings do fit, so its motion has a constant part to the side. The truth is not valid everywhere; it is NaN here
where it is not. Every time is a pose, with or without sightings: `Log.at_steps` keeps fewer poses and joins the
motions between them.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from ..errors import FormatError, checks, decimals
from ..log import Log
from ..log.rows import ReadOptions
from ..log.streams import Stream, bridge, gap_note, in_order, silent
from ..models import MotionModel, SensorModel
from .base import NO_SIGHTING, Format, errors_name, member
from .mat import Shape, has_variables, read_mat

_SHAPES: dict[str, Shape] = {
    **dict.fromkeys(("t", "v", "om"), ("times", 1)),
    **dict.fromkeys(("r", "b"), ("times", "landmarks")),
    **dict.fromkeys(("d", "r_var", "b_var", "v_var", "om_var"), (1, 1)),
    **dict.fromkeys(("x_true", "y_true", "th_true", "true_valid"), ("times", 1)),
    "l": ("landmarks", 2),
}

#: [m², rad²] of each motion, for the part to the side, 2 mm per step, which the noise of the controls does not cover
EPSILON = 1e-4


def _recognises(path: Path, head: bytes) -> bool:
    return (path / "dataset2.mat").is_file() if path.is_dir() else has_variables(path, head, "r", "b", "om")


def _read(path: Path, _: ReadOptions) -> Log:
    if path.is_dir():
        path = member(path, "dataset2.mat", "the whole log")
    content, notes = read_mat(path, _SHAPES), list[str]()
    with errors_name(path):
        ordered, order = in_order("data", Stream(content["t"][:, 0], content["v"]), notes)
    content |= {name: content[name][order] for name, shape in _SHAPES.items() if shape and shape[0] == "times"}
    times, valid = ordered.times, content["true_valid"][:, 0] != 0
    r_std, b_std, v_std, om_std = (content[name].item() ** 0.5 for name in ("r_var", "b_var", "v_var", "om_var"))
    dt = np.diff(times)
    if (k := checks.first(dt <= 0)) is not None:
        message = f"two rows have the time t = {decimals(times[k])} s; every row should have its own"
        raise FormatError(path, None, message)
    steps, columns = np.nonzero(content["r"] > 0)
    if len(steps) == 0:
        raise FormatError(path, None, NO_SIGHTING)
    truth = np.column_stack([content[name] for name in ("x_true", "y_true", "th_true")])
    truth[~valid] = np.nan
    notes += [] if valid.all() else [f"the truth covers {valid.sum()} of {len(times)} poses"]
    controls = np.column_stack([content["v"], content["om"]])[1:]
    with errors_name(path):
        gaps = silent(dt, times)
        if gaps.any():
            notes.append(gap_note(dt[gaps].tolist()))
            warnings.warn(f"{path}: {notes[-1]}", UserWarning, stacklevel=3)
        driven, variances = bridge(controls, np.zeros(len(dt)), dt, dt, gaps, controls)
        return Log(
            dt=dt,
            controls=driven,
            control_variances=variances,
            steps=steps,
            landmarks=columns,
            sightings=np.column_stack([content[name][steps, columns] for name in ("r", "b")]),
            initial_poses=MotionModel().dead_reckoning(truth[0] if valid[0] else np.zeros(3), driven, dt),
            true_poses=truth if valid.any() else None,
            true_landmarks=dict(enumerate(content["l"])),
            start_time=float(times[0]),
            motion=MotionModel.constant(v_std, om_std, epsilon=EPSILON),
            sensor=SensorModel.constant(r_std, b_std, offset=(content["d"].item(), 0.0)),
            name="lost-in-the-woods",
            notes=tuple(notes),
        )


FORMAT = Format("lost-in-the-woods", _recognises, _read)
