"""Motion edges: e = x_t - f(x_{t-1}, u_t) with Omega^-1 = A M A' + epsilon I.

f turns with the pose it starts from, so the whole edge is a relative-pose edge whose measurement is f(0, u) and whose
covariance is that of a motion that starts at 0: no new equations. ``frame`` says whether the residual is the lectures'
(world, Omega re-evaluated at every step) or turned into the frame of x_{t-1} (body, Omega constant).
"""

from __future__ import annotations

import numpy as np

from ..models import MotionModel
from ..se2 import Array
from .relative_pose import RelativePoseEdges


def motion_edges(
    nodes: np.ndarray, controls: Array, dt: Array, motion: MotionModel, *, frame: str = "body", weight: float = 1.0
) -> RelativePoseEdges:
    """The motion edges between consecutive ``nodes`` (T+1,), driven by ``controls`` (T, 2) for ``dt`` (T,) seconds.

    Args:
        nodes: the node of each pose, x_0 to x_T.
        controls: u_t = (nu, omega) [m/s, rad/s].
        dt: [s].
        motion: gives f, A, M and epsilon.
        frame: "world" or "body".
        weight: lambda, multiplies the information of all motion edges (the book adds each edge lambda times).
    """
    origin = np.zeros((len(controls), 3))
    information = weight * np.linalg.inv(motion.covariance(origin, controls, dt))
    # A M A' is symmetric; its computed inverse should not be less so
    information = (information + np.swapaxes(information, 1, 2)) / 2
    return RelativePoseEdges(nodes[:-1], nodes[1:], motion.f(origin, controls, dt), information, frame)
