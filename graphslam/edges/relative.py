"""Relative edges: a pose or a landmark measured from a pose. Odometry, loop closures, motion edges, g2o's points.

With a measured relative pose z = (t, theta_z) of node j in the frame of pose i the residual is, in that frame,

    e = (R(theta_i)' (p_j - p_i) - t,  theta_j - theta_i - theta_z),  the angle wrapped,

and its information does not depend on the state. g2o writes the same edge as z^-1 (x_i^-1 x_j), which is e turned by
R(theta_z)'; with the information turned in the same way the cost is the same number. A relative point has the first two
rows only (g2o's EDGE_SE2_XY).

``frame="world"`` keeps e in world axes, R(theta_i) e, and turns the information by the heading that pose i has in the
reference state: the lectures' motion edge e = x_j - f(x_i, u), whose Omega is re-evaluated at every step.

Motion edges are among them: e = x_t - f(x_{t-1}, u_t) with Omega^-1 = A M A' + S + epsilon I. Where odometry is finer than
the poses, f is the composition f(... f(x_{t-1}, u_1) ..., u_k), and A M A' the covariance propagated through it
(`MotionModel.accumulate`). S is the slip, zero by default (`MotionModel.sideways`). f rotates with the pose from which it
starts, so the whole edge is a relative-pose edge whose measurement is f(0, u) and whose covariance is that of a motion that
starts at 0. ``frame`` says whether the residual is the lectures' (world, Omega re-evaluated at every step) or expressed in
the frame of x_{t-1} (body, Omega constant).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ..engine import engine
from ..linear.precision import inverses
from ..models import MotionModel
from ..se2 import Array, perpendicular, rotation, turn_matrix, wrap
from .base import FramedEdges, Linearization, PairEdges, check_rows, linearization
from .robust import SingleEdges, code_and_width


@dataclass(frozen=True, eq=False, repr=False)
class _RelativeEdges(PairEdges, FramedEdges):
    """Nodes ``second`` measured (E, d) in the frames of the poses ``first``, with information (E, d, d) there."""

    measured: Array
    information: Array

    #: the numbers of a measurement
    rows: ClassVar[int] = 3

    def __post_init__(self) -> None:
        super().__post_init__()
        check_rows(self, measured=(self.count, self.rows), information=(self.count, self.rows, self.rows))

    @property
    def numbers(self) -> tuple[int, float]:
        return self.measured.size, self.measured.size

    @cached_property
    def weighed(self) -> Array:
        """The information (E, d, d) that the edges work with."""
        return self.information

    def linearize(self, state: Array, reference: Array) -> Linearization:
        a, b = state[self.first], state[self.second]
        offset = b[:, :2] - a[:, :2]
        reached = np.einsum("eij,ej->ei", rotation(a[:, 2]), self.measured[:, :2])
        residuals = np.zeros((self.count, 3))
        residuals[:, :2] = offset - reached
        d = self.measured.shape[1]
        if d == 3:
            residuals[:, 2] = wrap(b[:, 2] - a[:, 2] - self.measured[:, 2])
        ends, still = (self.first, self.second), np.zeros((self.count, 2))
        if self.frame == "body":
            return linearization(ends, residuals, self.weighed, (perpendicular(offset), still), a[:, 2])
        turn = turn_matrix(reference[self.first, 2])[:, :d, :d]
        information = turn @ self.weighed @ np.swapaxes(turn, 1, 2)
        return linearization(ends, residuals, information, (perpendicular(reached), still))

    def _to_engine(self) -> Any:
        edges = self.first, self.second, self.measured, self.weighed
        return engine.RelativeEdges(*edges, self.frame == "world", *code_and_width(getattr(self, "kernel", None)))


class RelativePoseEdges(_RelativeEdges):
    """Edges from nodes ``first`` (E,) to ``second`` (E,): measured (E, 3), information (E, 3, 3) in first's frame."""


class RelativePointEdges(_RelativeEdges):
    """Positions (E, 2) of landmark nodes ``second`` measured from pose nodes ``first``, with information (E, 2, 2).

    A landmark without heading uses the first two coordinates of its node; `Graph.linearize` holds the third.
    """

    rows: ClassVar[int] = 2


@dataclass(frozen=True, eq=False, repr=False)
class RelationEdges(SingleEdges, RelativePoseEdges):
    """Measured relations of two poses that may be wrong, such as loop closures: `RelativePoseEdges` with kernel and trust.

    ``kernel`` and ``trust`` are those of `DoubtedEdges`.
    """


@dataclass(frozen=True, eq=False, repr=False)
class DoubtedPointEdges(SingleEdges, RelativePointEdges):
    """`RelativePointEdges` that may be wrong, the same for points as `RelationEdges` for poses."""


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
