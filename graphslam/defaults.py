"""Default options of the graph of a log, the same for Python and the command line."""

from __future__ import annotations

import numpy as np

from .edges.robust import Kernel
from .errors import GraphError
from .log import Log
from .models import MotionModel


def suitable_edges(log: Log) -> str:
    """The edges that suit a log: with motion edges wherever it has controls.

    Virtual-motion edges for logs that were made with the noise of the lectures, if they have psi. Landmarks as nodes
    otherwise: without psi the information of a virtual-motion edge depends on the poses, and on real logs pairs count
    sightings of a landmark that is seen often many times.
    """
    if log.controls is None:
        return "virtual"
    if len(log.steps) == 0 or log.partial_sightings is not None:
        return "landmark+motion"
    of_lectures = log.simulated or log.motion in (None, MotionModel())
    return "virtual+motion" if log.has_orientation and of_lectures else "landmark+motion"


def edges_for_map(log: Log, edges: str | None) -> str:
    """The edges of a graph with a map, whose landmarks are nodes.

    Raises:
        GraphError: other edges are asked for, or the log has no controls.
    """
    if edges not in (None, "landmark+motion"):
        raise GraphError(f"a map needs its landmarks as nodes: use edges='landmark+motion', not {edges!r}, or no map")
    if log.controls is None:
        raise GraphError(f"{log.name} has no controls, and a graph with a map needs motion edges between its poses")
    return "landmark+motion"


def suitable_kernel(log: Log) -> str:
    """The name of the robust kernel that suits a log, "none" where `simulate` made it.

    All other logs count as real data, which have wrong sightings. A kernel loses little accuracy there (docs/decisions.md).
    """
    return "none" if log.simulated else "cauchy"


def suitable_for_isam2(
    log: Log, edges: str | None = None, kernel: Kernel | str | None = None
) -> tuple[str, Kernel | str]:
    """The edges and the kernel of `Graph.from_log` where they are None, as far as ISAM2 can have both.

    It takes a kernel on the sightings of landmark nodes only: a kernel decides for these, and named virtual-motion edges
    decide against a kernel.
    """
    if kernel is None:
        kernel = "none" if edges is not None and edges.startswith("virtual") else suitable_kernel(log)
    if edges is None:
        robust = kernel != "none" and log.controls is not None
        edges = "landmark+motion" if robust else suitable_edges(log)
    return edges, kernel


def pairs_overweight(log: Log) -> str | None:
    """A sentence on covariances with weight="pairs"; None where no landmark is seen more than twice, which is exact."""
    ids, counts = np.unique(log.landmarks, return_counts=True)
    if len(ids) == 0:
        return None
    most = int(np.argmax(counts))
    if counts[most] <= 2:
        return None
    return (
        f"weight pairs counts the {counts[most]} sightings of landmark {ids[most]} up to {counts[most] / 2:g} times each, so "
        "that covariances are up to this factor too small; weight marginal counts each sighting once"
    )
