"""A graph of a log at given values of its parameters p (`corrected`), and the system with p as further unknowns.

They touch every motion or every sighting:

    [ Omega  C ] [Delta]   [xi]        C = sum B' Omega_e J,   D = sum J' Omega_e J + P,
    [ C'     D ] [delta] = [g ],       g = - sum J' Omega_e e - P (p - mean),        J = de/dp, P the priors.

Omega keeps its sparse factorisation (`linear.cholesky.Bordered`), at the price of K further right-hand sides.

J of a sighting is its Jacobian by its pose times the move of this pose (`identification.corrections`). So every sighting
gets a copy of its pose, the family writes the Omega of these copies as it does for any graph, and C, D and g are sums of it.

`check_observable` computes the information that the log would have about the parameters without any noise. With all
measurements replaced by what the state predicts, a change of the parameters that the nodes can follow exactly, such as one
scale for wheels and ranges, has no information at all. (With the measured values such a change still has some: a smaller
world has smaller residuals.)

`undetermined` says why an Omega is singular: which nodes are not determined, in which direction, and which edges touch them.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from ..edges import (
    EdgeFamily,
    LandmarkSightings,
    ObservationEdges,
    RelationEdges,
    RelativePoseEdges,
    SightingEdges,
    VirtualMotionEdges,
)
from ..edges import motion_edges as make_motion_edges
from ..engine import engine
from ..errors import GraphError, checks
from ..graph import Graph
from ..identification import corrections
from ..identification.declared import PARAMETERS, Parameters
from ..linear.cholesky import Bordered, Factor, FactorizationError, SingularPivot
from ..linear.information import BlockSystem
from ..se2 import Array, between, turn_matrix, wrap


def sighted_edges(graph: Graph) -> SightingEdges:
    """The edges from sightings."""
    return next(family for family in graph.families if isinstance(family, SightingEdges))


def motion_edges(graph: Graph) -> RelativePoseEdges | None:
    """The motion edges, or None."""
    driven = (f for f in graph.families if isinstance(f, RelativePoseEdges) and not isinstance(f, RelationEdges))
    return next(driven, None)


def corrected(graph: Graph, values: Array, state: Array, at: Array | None = None) -> Graph:
    """The graph at values (K,) of its parameters, sharing `Graph.system`.

    Args:
        state: (n, 3) that predicts the sightings at which the noise of the sensor is evaluated.
        at: (K,) the values of the parameters there; default: ``values``.
    """
    here, there = graph.estimated.at(values), graph.estimated.at(values if at is None else at)
    seen = _sightings(graph, here)
    noisy = seen.with_noise_at(_sightings(graph, there).predicted(state))
    changed: dict[EdgeFamily, EdgeFamily] = {sighted_edges(graph): noisy}
    driven = motion_edges(graph)
    if driven is not None and any(PARAMETERS[name].of_motion for name in here.names):
        changed[driven] = _motions(driven, here, there)
    return graph.with_families((changed.get(family, family) for family in graph.families), parameters=here)


def finished(graph: Graph, values: Array, state: Array) -> Graph:
    """The graph at the estimated values (K,) and state (n, 3), with the corrected log.

    Raises:
        LogError: a corrected range would not be above zero.
    """
    found = corrected(graph, values, state)
    log, sensor = corrections.corrected_log(found.estimated), corrections.corrected_sensor(found.estimated)
    if graph.log is not None and not graph.log.has_orientation:
        log = log.without_orientation()
    return found.with_families(found.families, log=log, sensor=sensor)


def controls_of(graph: Graph) -> Array:
    """The corrected control (M, 2) at the pose of each sighting; zero where no parameter depends on it."""
    assert graph.log is not None
    if "sensor_delay" not in graph.estimated.names:
        return np.zeros((len(graph.sighting_rows), 2))
    return corrections.controls_at_steps(graph.estimated)[graph.log.steps[graph.sighting_rows]]


def _sightings(graph: Graph, parameters: Parameters) -> SightingEdges:
    """The edges from sightings, with corrected sightings."""
    edges = sighted_edges(graph)
    z = corrections.corrected_sightings(parameters, graph.sighting_rows, edges.sightings.shape[1])
    z[:, 1:] = wrap(z[:, 1:])
    return replace(edges, sightings=z, sensor=corrections.corrected_sensor(parameters), noise_at=None)  # type: ignore[call-arg]


def _motions(edges: RelativePoseEdges, here: Parameters, there: Parameters) -> RelativePoseEdges:
    """The motion edges of corrected controls, with the noise at other values of the parameters."""
    log, motion = here.recorded, here.motion
    assert log.dt is not None
    nodes = np.append(edges.first, edges.second[-1:])
    noisy = make_motion_edges(
        nodes, corrections.corrected_controls(there), log.dt, motion, starts=log.control_starts,
        control_variances=log.control_variances, recorded_dt=log.recorded_dt, frame=edges.frame,
        scale=here.options.motion_weight,
    )  # fmt: skip
    if here.values is there.values or np.array_equal(here.values, there.values):
        return noisy
    measured, _ = engine.accumulated_slopes(corrections.corrected_controls(here), log.dt, log.control_starts)
    return replace(noisy, measured=measured)


#: the most edges that a message lists
MOST = 4


def undetermined(graph: Graph, state: Array, error: FactorizationError) -> GraphError:
    """The error for an Omega at a state (n, 3) that is singular, or not finite.

    The null vector v of Omega (Omega v = 0) is a motion that does not change the cost; its large entries are the nodes
    that move.
    """
    if not isinstance(error, SingularPivot):
        return GraphError(
            f"the information matrix of the graph is not finite at {graph.names(np.array([error.node]))}: the numbers there "
            "leave the range of double precision; look for extreme noise, or for a pose that lies on a landmark"
        )
    if (text := negative_information(graph)) is not None:
        return GraphError(text)
    v = error.null_vector
    moving = np.flatnonzero(np.abs(v).max(axis=1) > 1e-6 * np.abs(v).max())
    what = _direction(v[moving], state[moving])
    touching = _edges_at(graph, moving)
    edges = "; ".join(touching[:MOST]) + (f"; and {len(touching) - MOST} more" if len(touching) > MOST else "")
    held = f"the edges there are {edges}" if touching else "no edge is there"
    names = graph.names(moving)
    return GraphError(f"the edges do not determine {names}: nothing holds {what}; {held}. {_remedy(graph)}")


def negative_information(graph: Graph) -> str | None:
    """A sentence about the first edge whose information has a negative eigenvalue, beyond rounding; None for none."""
    for family in graph.families:
        W = getattr(family, "information", None)
        if not isinstance(W, np.ndarray) or W.ndim != 3 or W.shape[1] != W.shape[2] or not np.isfinite(W).all():
            continue
        smallest = np.linalg.eigvalsh((W + np.swapaxes(W, 1, 2)) / 2)[:, 0]
        if (k := checks.first(smallest < -1e-9 * np.abs(W).max(axis=(1, 2)))) is not None:
            return (
                f"the information of edge {k} of {type(family).__name__} is not positive semi-definite (eigenvalue "
                f"{smallest[k]:.3g}), so that J has no lower bound; information is the inverse of a covariance"
            )
    return None


def _remedy(graph: Graph) -> str:
    """Advice for the user: for the graph of a log it names rows and options, else edges."""
    if graph.log is None:
        return "Add edges (a relative pose, a sighting, a loop closure) or an anchor there"
    if graph.log.controls is None:
        return "The log has no odometry to hold them: add it, or remove the sightings from there"
    if motion_edges(graph) is None:
        return "Use motion edges, which hold every pose: edges='landmark+motion'"
    return (
        "The odometry and the sightings there count for nothing beside the others: look for extreme noise models, units, or "
        "motions (slam-compare show)"
    )


def _direction(v: Array, state: Array) -> str:
    """The motion v (k, 3) of k nodes in words: a coordinate, a shift or a turn of all of them, or something else."""
    size = np.abs(v).max()
    if len(v) == 1:
        free = [name for name, part in zip(("x", "y", "heading"), v[0]) if abs(part) > 1e-6 * size]
        return f"its {free[0]}" if len(free) == 1 else f"a combination of its {', '.join(free[:-1])} and {free[-1]}"
    # a rigid motion moves every node by d + omega (-y, x) and turns it by omega
    omega = v[:, 2].mean()
    shift = v[:, :2] - omega * np.column_stack([-state[:, 1], state[:, 0]])
    if np.ptp(v[:, 2]) < 1e-4 * size and np.all(np.ptp(shift, axis=0) < 1e-4 * max(size, np.abs(shift).max())):
        return "the whole piece, which can shift" if abs(omega) < 1e-6 * size else "the whole piece, which can turn"
    return "a motion of these against the rest"


def _edges_at(graph: Graph, nodes: np.ndarray) -> list[str]:
    """The groups of edges that touch the nodes, named by the nodes they connect; edges to other nodes come first."""
    inside = np.zeros(graph.num_nodes, dtype=bool)
    inside[nodes] = True
    leading_out: list[str] = []
    within: list[str] = []
    for family in graph.families:
        starts, tied = family.cliques()
        group = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
        for g in np.unique(group[inside[tied]]).tolist():
            ends = np.unique(tied[starts[g] : starts[g + 1]])
            names = f"{'between' if len(ends) > 1 else 'at'} {graph.names(ends)}"
            (within if np.all(inside[ends]) else leading_out).append(names)
    return leading_out + within


class JointGraph:
    """A graph and its parameters as an objective of the engine's iterations, see the module.

    The states (n + r, 3) of the iterations have the parameters in their last r rows, three in each.
    """

    #: the noise of the sensor is evaluated at the predicted sightings
    state_dependent_information = True

    def __init__(self, graph: Graph) -> None:
        _check_pairs(sighted_edges(graph))
        self.graph, self.parameters = graph, graph.estimated
        self.reweighted, self.rows = graph.reweighted, -(-len(self.parameters) // 3)

    def joined(self, nodes: Array, values: Array) -> Array:
        """The state (n + r, 3) of nodes (n, 3) and parameters (K,)."""
        last = np.zeros(3 * self.rows)
        last[: len(values)] = values
        return np.concatenate([nodes, last.reshape(-1, 3)])

    def parted(self, state: Array) -> tuple[Array, Array]:
        """The nodes (n, 3) and the parameters (K,) of a state."""
        count = self.graph.num_nodes
        return state[:count], state[count:].ravel()[: len(self.parameters)]

    def at(self, state: Array, reference: Array | None = None) -> tuple[Graph, Array, Array]:
        """The graph at the parameters of a state, its noise at those of a reference state, and the nodes of both."""
        nodes, values = self.parted(state)
        held, at = self.parted(state if reference is None else reference)
        return corrected(self.graph, values, held, at), nodes, held

    def cost(self, state: Array, reference: Array | None = None) -> float:
        """J and the cost of the priors."""
        graph, nodes, held = self.at(state, reference)
        return graph.cost(nodes, held)

    def linearize(self, state: Array, reference: Array | None = None) -> float:
        """Evaluate the system at a state, and return the cost there."""
        self._here, self._nodes, held = self.at(state, reference)
        _, cost = self._here.linearize(self._nodes, held)
        self._border = self.border(self._here, self._nodes, held)
        return cost

    @property
    def xi(self) -> Array:
        """The right-hand side (n + r, 3)."""
        return self.joined(self._here.system.xi, self._border.gradient)

    def diagonal(self) -> Array:
        """The scalar diagonal, (n + r, 3), 1 where there is no parameter."""
        last = np.ones(3 * self.rows)
        last[: len(self.parameters)] = np.diag(self._border.own)
        return np.concatenate([self._here.system.diagonal(), last.reshape(-1, 3)])

    def factorize(self, damping: float = 0.0) -> None:
        """Factorise Omega, and S, both with damping times the diagonal.

        Raises:
            GraphError: the edges leave a direction of the nodes free, or S is not positive definite.
        """
        try:
            factor = self._here.system.factorize(damping)
        except FactorizationError as error:
            raise undetermined(self._here, self._nodes, error) from None
        self._factor = JointFactor(self, factor, self._border, damping)

    def solve(self) -> Array:
        """The step (n + r, 3)."""
        return self.joined(*self._factor.solve(self._here.system.xi, self._border.gradient))

    @property
    def parameter_covariance(self) -> Array:
        """The covariance (K, K) of the parameters at the factorised state."""
        return self._factor.covariance

    def border(
        self, graph: Graph, nodes: Array, held: Array, scaled: bool = False, controls: Array | None = None
    ) -> Border:
        """C, D and g of `at` a state; ``scaled`` as `Graph.information` scales Omega.

        Args:
            controls: (M, 2) with which the delay of the sensor moves sightings; default: `controls_of`.
        """
        parameters, seen, driven = graph.estimated, sighted_edges(graph), motion_edges(graph)
        factor = seen.information_per_weight if scaled else 1.0
        predicted = seen.predicted(held)
        border = Border.of_sightings(self._copies, graph, seen, nodes, held, predicted, controls).scaled(factor)
        if driven is not None:
            _, slopes = corrections.motion_slopes(parameters, corrections.corrected_controls(parameters))
            border += Border.of_motions(driven, nodes, held, slopes)
        priors, pulled = parameters.weights, parameters.values - parameters.means
        border += Border(np.zeros_like(border.mixed), np.diag(priors), -priors * pulled)
        return border.beside(graph.fixed)

    @cached_property
    def _copies(self) -> BlockSystem:
        edges, _ = copied(sighted_edges(self.graph), np.zeros((self.graph.num_nodes, 3)), len(self.graph.steps))
        return BlockSystem.from_cliques(len(edges.sightings) + len(self.graph.landmark_ids), [edges.cliques()])


class Border:
    """C (n, 3, K), D (K, K) and g (K,) of some edges."""

    def __init__(self, mixed: Array, own: Array, gradient: Array) -> None:
        self.mixed, self.own, self.gradient = mixed, own, gradient

    def __add__(self, other: Border) -> Border:
        return Border(self.mixed + other.mixed, self.own + other.own, self.gradient + other.gradient)

    def scaled(self, factor: float) -> Border:
        """The same with another factor on the information."""
        return self if factor == 1 else Border(self.mixed * factor, self.own * factor, self.gradient * factor)

    def beside(self, fixed: np.ndarray) -> Border:
        """The same beside nodes that are held, such as exact landmarks of a map: they do not follow the parameters."""
        mixed = self.mixed.copy()
        mixed[fixed] = 0.0
        return Border(mixed, self.own, self.gradient)

    @classmethod
    def of_sightings(
        cls, copies: BlockSystem, graph: Graph, edges: SightingEdges, nodes: Array, held: Array, predicted: Array,
        controls: Array | None = None,
    ) -> Border:  # fmt: skip
        """That of edges from sightings, with the predicted sightings (M, d); ``copies`` has room for Omega and xi."""
        parameters, poses, count = graph.estimated, len(graph.steps), len(edges.sightings)
        free, at = copied(edges, nodes, poses)
        copies.clear()
        free.accumulate(at, copied(edges, held, poses)[1], copies)
        moved = np.zeros((len(at), 3, len(parameters)))
        controls = controls_of(graph) if controls is None else controls
        moved[:count] = turn_matrix(at[:count, 2]) @ corrections.moves(parameters, predicted, controls)
        weighed = times(copies, moved)
        mixed = np.zeros((len(nodes), 3, len(parameters)))
        np.add.at(mixed, edges.first if isinstance(edges, ObservationEdges) else edges.nodes, weighed[:count])  # type: ignore[attr-defined]
        mixed[poses:] += weighed[count:]
        own = np.einsum("nik,nil->kl", moved, weighed)
        return cls(mixed, (own + own.T) / 2, np.einsum("nik,ni->k", moved, copies.xi))

    @classmethod
    def of_motions(cls, edges: RelativePoseEdges, nodes: Array, held: Array, slopes: Array) -> Border:
        """That of motion edges whose measured motions have the derivative slopes (T, 3, K) by the parameters."""
        ends = edges.linearize(nodes, held)
        # a longer measured motion has the effect of a second pose that stays behind
        behind = turn_matrix(nodes[edges.first, 2]) @ -slopes
        J = ends.jacobians[1] @ behind
        weighed = ends.information @ J
        mixed = np.zeros((len(nodes), 3, slopes.shape[2]))
        for node, B in zip(ends.nodes, ends.jacobians):
            np.add.at(mixed, node, np.swapaxes(B, 1, 2) @ weighed)
        own = np.einsum("eik,eil->kl", J, weighed)
        return cls(mixed, (own + own.T) / 2, -np.einsum("eik,ei->k", weighed, ends.residuals))


class JointFactor(Bordered):
    """The bordered system of a graph and its parameters.

    Raises:
        GraphError: S is not positive definite.
    """

    def __init__(self, joint: JointGraph, factor: Factor, border: Border, damping: float = 0.0) -> None:
        super().__init__(factor, border.mixed, border.own + damping * np.diag(np.diag(border.own)))
        self.border = border
        try:
            np.linalg.cholesky(self.schur)
        except np.linalg.LinAlgError:
            names = ", ".join(joint.parameters.names)
            raise GraphError(f"the log does not determine the parameters {names} together: estimate fewer") from None


def copied(edges: SightingEdges, state: Array, poses: int) -> tuple[SightingEdges, Array]:
    """The same edges with a copy of the pose for each sighting as nodes, landmarks after them, and a state of these."""
    count = len(edges.sightings)
    own = np.arange(count)
    if isinstance(edges, ObservationEdges):
        moved = replace(edges, first=own, second=edges.second - poses + count)
        return moved, np.concatenate([state[edges.first], state[poses:]])
    assert isinstance(edges, LandmarkSightings)
    return replace(edges, nodes=own), state[edges.nodes]


def times(system: BlockSystem, right: Array) -> Array:
    """Omega times (n, 3, K)."""
    from scipy.sparse import bsr_matrix

    n, _, K = right.shape
    flat = right.reshape(3 * n, K)
    # the blocks of the upper triangle by columns are, transposed, those of the lower one by rows
    blocks = np.ascontiguousarray(np.swapaxes(system.values, 1, 2))
    lower = bsr_matrix((blocks, system.indices, system.indptr), shape=(3 * n, 3 * n))
    product = (lower @ flat + lower.T @ flat).reshape(n, 3, K)
    return np.asarray(product - system.values[system.diagonal_slots] @ right)


def _check_pairs(edges: SightingEdges) -> None:
    """Raise `GraphError` where a landmark was seen twice in one step and sightings enter in pairs."""
    if isinstance(edges, VirtualMotionEdges):
        seen = np.column_stack([edges.group, edges.nodes])
        if len(np.unique(seen, axis=0)) < len(seen):
            raise GraphError(
                "a landmark was seen twice from one pose, and pairs of such sightings tell nothing of the pose but of the "
                "parameters; use weight='marginal' or edges='landmark+motion'"
            )


#: the least information of a combination of parameters, over that with all nodes known
LEAST = 1e-7
#: parameters with at least this part of the largest one in such a combination are named
NAMED = 0.1


def check_observable(joint: JointGraph, nodes: Array, values: Array) -> None:
    """Raise `GraphError` where the parameters are not observable, at nodes (n, 3) and values (K,), with names and reason.

    Priors are left out: without information in the log the estimate would be the prior.
    """
    parameters, K = joint.parameters.at(values), len(values)
    graph, slopes = _without_noise(corrected(joint.graph, values, nodes), nodes)
    graph.linearize(nodes)
    try:
        factor = graph.system.factorize()
    except FactorizationError:
        # the nodes alone are not determined: the solver reports it
        return
    seen = sighted_edges(graph)
    border = Border.of_sightings(joint._copies, graph, seen, nodes, nodes, seen.sightings)
    if (driven := motion_edges(graph)) is not None:
        border += Border.of_motions(driven, nodes, nodes, slopes)
    border = border.beside(graph.fixed)
    known = np.diag(border.own)
    if still := [name for name, information in zip(parameters.names, known) if not information > 0]:
        raise GraphError(f"the log does not tell {' and '.join(still)}: nothing that was recorded depends on it")
    schur = Bordered(factor, border.mixed, border.own).schur
    scale = 1 / np.sqrt(known)
    information, directions = np.linalg.eigh(scale[:, None] * schur * scale)
    if information[0] < LEAST:
        direction = np.abs(directions[:, 0])
        names = [parameters.names[k] for k in range(K) if direction[k] >= NAMED * direction.max()]
        what = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]} together"
        why = "poses and landmarks can follow a change of it exactly"
        if len(names) > 1:
            why = "they can change so that poses and landmarks follow exactly; estimate all but one of them"
        if {"wheel_scale", "range_scale"} <= set(names):
            why = "both only change the size of the world; estimate one of the two, relative to the other"
        raise GraphError(f"the log does not tell {what}: {why}")
    deviations = np.sqrt(np.diag(np.linalg.inv(schur + np.diag(parameters.weights))))
    for name, deviation in zip(parameters.names, deviations.tolist()):
        if deviation > PARAMETERS[name].limit:
            raise GraphError(
                f"the log does not tell {name}: its standard deviation would be {deviation:.2g} "
                f"{PARAMETERS[name].unit}".rstrip()
                + "; estimate fewer parameters, or give it a prior"
            )


def _without_noise(graph: Graph, nodes: Array) -> tuple[Graph, Array]:
    """The graph whose measurements are what the nodes predict, and the derivative (T, 3, K) of its motions."""
    parameters, seen, driven = graph.estimated, sighted_edges(graph), motion_edges(graph)
    trust = seen.trusted * graph.sighting_weights(nodes)
    exact = replace(seen, sightings=seen.predicted(nodes), kernel=None, trust=trust)  # type: ignore[call-arg]
    changed = {seen: exact}
    slopes = np.zeros((0, 3, len(parameters)))
    if driven is not None:
        measured = between(nodes[driven.first], nodes[driven.second])
        changed[driven] = replace(driven, measured=measured)  # type: ignore[index, assignment]
        _, slopes = corrections.motion_slopes(parameters, corrections.corrected_controls(parameters), measured[:, :2])
    return graph.with_families(changed.get(family, family) for family in graph.families), slopes  # type: ignore[call-overload]
