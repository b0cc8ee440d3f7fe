"""Many relative poses and points in one factor: one callback for all of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ..edges.robust import code_and_width, kernel_of
from ..engine import engine
from ..errors import OptionError
from ..se2 import Array
from .arguments import check_heading, in_world_frame, numbers, positive_definite
from .base import POINT, POSE, Coordinates, Factor, KernelLike, Linearized, listed_keys


class RelativeEdgesFactor(Factor):
    """Nodes measured in the frames of poses: the sum of a `RelativePoseFactor` or `RelativePointFactor` for each edge.

    A graph of many such edges is evaluated faster with some of them in one factor, above all because GTSAM's optimisers
    copy all values of the graph for every call of a Python factor. Put edges together that share nodes: the factor connects
    all its keys. e is whitened already, L' (R(theta_i)' (p_j - p_i) - t, theta_j - theta_i - theta_z) with
    Omega = L L', and a kernel acts on each edge: the cost, its gradient and the Gauss-Newton matrix are those of the single
    factors.

    Args:
        keys: the nodes, each a `gtsam.Pose2` or a `gtsam.Point2`.
        first, second: (E,) the places of each edge's ends among the keys; the first is a pose.
        measured: (E, 3) z = (x, y, theta); theta is not used where the second end is a point.
        information: (E, 3, 3) in the axes of the first end; for a point only the leading 2 x 2 part counts.
        points: the number of points; they are the last keys.
        frame: "body" or "world", as in `RelativePoseFactor`.
        at: (E,) the heading of each first end at which the world frame freezes the information.
        edge_kernel: a robust kernel on each edge of which ``robust`` is true; see `graphslam.edges.robust`.
        robust: (E,) bool; default: all edges.
        kernel: a robust kernel around all edges as a whole.

    Raises:
        OptionError: an argument has an impossible value.
    """

    keys_in_list = True

    def __init__(
        self,
        keys: Sequence[int],
        first: ArrayLike,
        second: ArrayLike,
        measured: ArrayLike,
        information: ArrayLike,
        *,
        points: int = 0,
        frame: str = "body",
        at: ArrayLike | None = None,
        edge_kernel: KernelLike = None,
        robust: ArrayLike | None = None,
        kernel: KernelLike = None,
    ) -> None:
        keys = listed_keys("RelativeEdgesFactor", keys)
        poses, world = len(keys) - points, in_world_frame(frame)
        i, j = (np.array(ends, dtype=np.int64) for ends in (first, second))
        if len(i) == 0 or i.shape != j.shape or min(i.min(), j.min()) < 0 or i.max() >= poses or j.max() >= len(keys):
            raise OptionError("first and second must be places of keys, one of a pose and one of any node per edge")
        z = numbers("measured", measured, (3,), rows=len(i))
        check_heading("measured", float(np.abs(z[j < poses, 2]).max(initial=0.0)))
        omega = np.array(information, dtype=float)
        rows = np.where(j < poses, 3, 2)
        if omega.shape != (len(i), 3, 3):
            raise OptionError(f"information must be {len(i)} matrices of 3 x 3, not {omega.shape}")
        root = np.zeros_like(omega)
        for edge, d in enumerate(rows.tolist()):
            root[edge, :d, :d] = np.linalg.cholesky(positive_definite(omega[edge, :d, :d], d)).T
        frozen = numbers("at", at, (len(i),)) if world else np.zeros(len(i))
        edge_kernel = kernel_of(edge_kernel)
        # a kernel without a width takes that of the dimension
        of_rows = {d: code_and_width(edge_kernel and edge_kernel.of_dimension(d)) for d in (2, 3)}
        code, widths = of_rows[3][0], np.array([of_rows[d][1] for d in rows.tolist()])
        robust = np.ones(len(i), dtype=bool) if robust is None else np.array(robust, dtype=bool)
        codes = np.where(robust, code, 0)
        edges = engine.WhitenedEdges(i, j, rows, z, root, frozen, codes, widths, poses, world)

        def stacked(nodes: tuple[Coordinates, ...]) -> Array:
            at = np.zeros((len(nodes), 3))
            at[:poses] = nodes[:poses]
            if points:
                at[poses:, :2] = nodes[poses:]
            return at

        def error(*nodes: Coordinates) -> Array:
            return edges.residuals(stacked(nodes))

        def residual(*nodes: Coordinates) -> Linearized:
            e, jacobians = edges.linearized(stacked(nodes))
            return e, [jacobian[: 3 if k < poses else 2].T for k, jacobian in enumerate(jacobians)]

        options = {"points": points, "frame": frame, "at": frozen if world else None, "kernel": kernel}
        arguments = {"first": i, "second": j, "measured": z, "information": omega} | options
        super().__init__(
            keys, [POSE] * poses + [POINT] * points, residual,
            arguments | {"edge_kernel": edge_kernel, "robust": robust},
            covariance=np.eye(int(rows.sum())), in_own_axes=True, error=error,
        )  # fmt: skip
