"""Motion edges: e = x_t - f(x_{t-1}, u_t) with Omega^-1 = A M A' + S + epsilon I.

Where odometry is finer than the poses, f is the composition f(... f(x_{t-1}, u_1) ..., u_k), and A M A' the covariance
propagated through it (`MotionModel.accumulate`). S is the slip, zero by default (`MotionModel.sideways`).

f rotates with the pose from which it starts, so the whole edge is a relative-pose edge whose measurement is f(0, u) and whose
covariance is that of a motion that starts at 0: no new equations. ``frame`` says whether the residual is the lectures'
(world, Omega re-evaluated at every step) or expressed in the frame of x_{t-1} (body, Omega constant).
"""

from __future__ import annotations

import numpy as np

from ..models import MotionModel
from ..precision import inverses
from ..se2 import Array
from .relative import RelativePoseEdges


def motion_edges(
    nodes: np.ndarray,
    controls: Array,
    dt: Array,
    motion: MotionModel,
    *,
    starts: np.ndarray | None = None,
    control_variances: Array | None = None,
    recorded_dt: Array | None = None,
    frame: str = "body",
    scale: float = 1.0,
) -> RelativePoseEdges:
    """The motion edges between consecutive ``nodes`` (T+1,), driven by ``controls`` (S, 2) for ``dt`` (S,) seconds.

    Args:
        nodes: the node of each pose, x_0 to x_T.
        controls: u = (nu, omega) [m/s, rad/s].
        dt: [s].
        motion: gives f, F, A, M, S and epsilon.
        starts: (T+1,) the first control of each motion, as `Log.control_starts`; default: one control a motion.
        control_variances: (S, 3) or (S, 2), more noise of single controls, as `Log.control_variances`.
        recorded_dt: (S,) [s] the durations of the recorded controls, as `Log.recorded_dt`.
        frame: "world" or "body".
        scale: lambda, multiplies the information of all motion edges (the book adds each edge lambda times).

    Raises:
        GraphError: a covariance is singular to double precision.
    """
    starts = np.arange(len(controls) + 1) if starts is None else starts
    with np.errstate(over="ignore", invalid="ignore"):
        # numbers that overflow make a covariance that is not finite, which is refused
        measured, covariances = motion.accumulate(controls, dt, starts, control_variances, recorded_dt)
    remedy = "the motion is too large beside epsilon, or epsilon too small: raise epsilon"
    information = scale * inverses(covariances, "motion", remedy)
    return RelativePoseEdges(nodes[:-1], nodes[1:], measured, information, frame=frame)
