"""Default options of the graph of a log, the same for Python and the command line, and what absolute positions determine.

Positions determine the frame of the world, so that an anchor of the first pose would contradict them. With two places far
enough apart, or one heading, they determine all of it, and the graph has no anchor. Otherwise the direction stays free, and
the anchor holds the heading of the first pose alone. `into_world` moves a trajectory in another frame to the positions.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..edges import ANCHOR_INFORMATION, AnchorEdges, EdgeFamily, PositionEdges
from ..edges.robust import Kernel
from ..errors import GraphError
from ..linear.precision import inverses
from ..log import Log
from ..log.cells import COVERED, DOUBLED, DOUBTFUL_NOISE, MOVED_BETWEEN, REPEATED, SHARED
from ..log.geometry import SIDEWAYS
from ..log.measurements import AbsolutePositions
from ..models import EdgeOptions, MotionModel, SensorModel
from ..se2 import Array, transform


def suitable_edges(log: Log, motion: MotionModel | None = None, sensor: SensorModel | None = None) -> str:
    """The edges that suit a log and the noise models that are given, else its own: with motion edges where it has controls.

    Virtual-motion edges for logs that were made with the noise of the lectures, if they have psi. Landmarks as nodes
    otherwise: without psi the information of a virtual-motion edge depends on the poses, and on real logs, where a landmark
    is seen often, its pairs count each sighting many times.
    """
    if log.controls is None:
        return "virtual"
    if len(log.steps) == 0 or log.partial_sightings is not None:
        return "landmark+motion"
    motion, sensor = log.noise_models(motion, sensor)
    of_lectures = log.simulated or (motion == MotionModel() and sensor.of_book)
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
    log: Log,
    edges: str | None = None,
    kernel: Kernel | str | None = None,
    motion: MotionModel | None = None,
    sensor: SensorModel | None = None,
) -> tuple[str, Kernel | str]:
    """The edges and the kernel of `Graph.from_log` where they are None, as far as ISAM2 can have both.

    It takes a kernel on the sightings of landmark nodes only: a kernel decides for these, and named virtual-motion edges
    decide against a kernel.
    """
    if kernel is None:
        kernel = "none" if edges is not None and edges.startswith("virtual") else suitable_kernel(log)
    if edges is None:
        robust = kernel != "none" and log.controls is not None
        edges = "landmark+motion" if robust else suitable_edges(log, motion, sensor)
    return edges, kernel


def notes_on_options(log: Log, sensor: SensorModel, options: EdgeOptions, missing: list[str]) -> list[str]:
    """Sentences on options of `Graph.from_log` that have no effect with these edges, on what covariances do not contain, and
    on probable mistakes of the log that its reader found.

    ``missing`` are the biases taken out of the log whose uncertainty the graph leaves out.
    """
    # those doubts that change the solution without any other sign
    said = (DOUBTFUL_NOISE, DOUBLED, SIDEWAYS, SHARED, COVERED, REPEATED, MOVED_BETWEEN)
    notes = [text for check, text in log.doubts if check in said]
    if missing:
        left_out = f"what is unknown of the biases taken out of the log: {', '.join(missing)}"
        notes.append(f"covariances do not contain {left_out}")
    notes += options.without_effect
    if options.landmark_nodes and options.residual == "cartesian":
        doubt = on_an_arc(log, sensor)
    else:
        doubt = None if options.landmark_nodes or options.weight != "pairs" else pairs_overweight(log)
    return notes if doubt is None else [*notes, doubt]


#: beyond so many standard deviations of the range the arc is said: on 12 logs each, 0.2 changed neither errors nor
#: covariances, 0.36 made poses 6 % worse and NEES 1.14 in place of 0.92, and 0.86 made them 23 % worse and NEES 2.0
ON_AN_ARC = 0.3


def on_an_arc(log: Log, sensor: SensorModel) -> str | None:
    """A sentence on bearings that are much less exact than ranges; None where they are not.

    With the error d of the bearing a sighting puts its landmark at the distance l cos(d) along the true direction, whose mean
    is l (1 - sigma_phi² / 2). The Cartesian residual takes this for a Gaussian about the landmark.
    """
    ranges = log.sightings[:, 0]
    if not len(ranges):
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        shift = ranges * np.square(sensor.bearing_std) / 2
        deviation = np.maximum(np.hypot(ranges * sensor.range_rate, sensor.range_std), 1e-300)
        deviations = float(np.median(shift / deviation))
    # noise that leaves the range of double precision is said elsewhere
    if not ON_AN_ARC < deviations < np.inf:
        return None
    return (
        f"bearings are much less exact than ranges: the Cartesian residual puts landmarks {np.median(shift):.2g} m too near "
        f"in the median, {deviations:.2g} standard deviations of the range, and covariances are too small; residual polar "
        "does not"
    )


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


#: two places determine a direction where their distance is above this [standard deviations of the distance]
APART = 3.0


def position_edges(
    positions: AbsolutePositions, nodes: np.ndarray, kernel: Kernel | None = None
) -> list[PositionEdges]:
    """The edges of positions: one family of those without a heading, one of those with it.

    Args:
        positions: what was measured.
        nodes: (N,) the node of each.
        kernel: a robust kernel, or None.

    Raises:
        GraphError: a covariance is singular to double precision.
    """
    families = []
    for rows, d in ((np.flatnonzero(~positions.oriented), 2), (np.flatnonzero(positions.oriented), 3)):
        if len(rows):
            information = inverses(positions.covariances[rows, :d, :d], "position", "check its covariance")
            places, levers = positions.places[rows, :d], positions.levers[rows]
            families.append(PositionEdges(nodes[rows], places, information, levers, kernel=kernel))
    return families


def anchors(first: Array, families: Iterable[EdgeFamily]) -> list[AnchorEdges]:
    """What holds the first pose (3,) where it is, beside the other edges: all of it, its heading, or nothing."""
    found = [family for family in families if isinstance(family, PositionEdges)]
    if _directed(found):
        return []
    information = ANCHOR_INFORMATION.copy()
    if found:
        information[:2] = 0.0
    return [AnchorEdges(np.zeros(1, dtype=int), first[None].copy(), information[None])]


def _directed(families: list[PositionEdges]) -> bool:
    """Whether the positions determine the direction of the world."""
    # files may have headings without information
    if any(family.dimension == 3 and family.information[:, 2, 2].any() for family in families):
        return True
    for family in families:
        apart = np.hypot(*(family.measured - family.measured[0]).T[:2])
        values = np.linalg.eigvalsh(family.information[:, :2, :2])
        variances = np.divide(1.0, values, out=np.full_like(values, np.inf), where=values > 0).sum(axis=1)
        if np.any(apart > APART * np.sqrt(variances + variances[0])):
            return True
    return False


def into_world(state: Array, families: Iterable[EdgeFamily], poses: int | None = None) -> Array:
    """A state (n, 3) moved as a whole to where the positions put it, and turned where they determine its direction.

    The rigid motion (t, phi) that minimises the sum of w abs(t + R(phi) q - p)² + kappa abs(exp(i (phi + theta)) -
    exp(i theta_z))², q the measured points at the state, p their places, w and kappa from the information, in closed form.

    Args:
        state: in any frame.
        families: of which those of positions count; without any the state is returned.
        poses: the rows from this one on have no headings; default: all have.

    Source: Horn, *Closed-form solution of absolute orientation using unit quaternions*, JOSA A 1987, in the plane.
    """
    found = [family for family in families if isinstance(family, PositionEdges)]
    if not found:
        return state
    q = np.concatenate([family.points(state) for family in found]) @ [1, 1j]
    p = np.concatenate([family.measured[:, :2] for family in found]) @ [1, 1j]
    w = np.concatenate([np.trace(family.weighed[:, :2, :2], axis1=1, axis2=2) / 2 for family in found])
    phi, mean_q, mean_p = 0.0, w @ q / w.sum(), w @ p / w.sum()
    if _directed(found):
        aligned = np.sum(w * np.conj(q - mean_q) * (p - mean_p))
        for family in found:
            if family.dimension == 3:
                turn = family.measured[:, 2] - state[family.nodes, 2]
                aligned += np.sum(family.weighed[:, 2, 2] * np.exp(1j * turn))
        phi = float(np.angle(aligned))
    shift = mean_p - np.exp(1j * phi) * mean_q
    motion = np.array([shift.real, shift.imag, phi])
    moved = state.copy()
    moved[:, :2] = transform(motion, state[:, :2])
    # headings keep their full turns
    moved[:poses, 2] += phi
    return moved


def in_frame_of_positions(log: Log) -> Log:
    """The log with its initial poses where its positions put them."""
    if log.positions is None:
        return log
    return log.replace(initial_poses=into_world(log.initial_poses, position_edges(log.positions, log.positions.steps)))
