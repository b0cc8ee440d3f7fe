"""Covariances from the factor of Omega at a solution: blocks of Omega^-1, which itself is never formed.

``covariance(poses=..., landmarks=..., joint=False)`` has the same arguments for all estimates. A single id gives a matrix, a
list of ids one matrix per id; poses and landmarks together give a pair of both. With ``joint`` it is one matrix of all: first
the poses (3 rows each), then the landmarks (2 or 3 rows each). Doubts about estimated parameters come from the same factor.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from ..edges import SightingEdges
from ..edges.base import Linearization
from ..errors import OptionError, quoted
from ..graph import Graph
from ..identification.corrections import control_noise_at_steps, noise_of_slopes, recorded_noise
from ..identification.declared import Parameters
from ..linear.cholesky import Factor, FactorizationError
from ..se2 import Array, perpendicular, turn_matrix
from .joint import Border, JointFactor, JointGraph, motion_edges, times, undetermined

#: draws of errors of scans
SAMPLES = 128


class Uncertainty:
    """Marginal covariances of the nodes of a graph at a state (n, 3), computed at the first use.

    Omega is the Gauss-Newton information at the state, so the covariances are those of the linearised problem. With
    robust kernels it is that of their estimate (`Graph.information`). Fixed nodes have covariance zero. The
    uncertainty of parameters, solved for or held, is part of that of the nodes: Omega^-1 + (Omega^-1 C) S^-1 (Omega^-1 C)'.

    Where all sightings of a scan have an error b in common (`Solution.scan_errors`), the solution follows it by Omega^-1 F b,
    F the columns of the poses in the information of the sightings. The covariance of this with C that of each b,

        Omega^-1 F diag(C) F' Omega^-1,

    is taken from `SAMPLES` draws. It contains how far the error of the first scan turns and shifts everything else.

    Raises:
        GraphError: (all methods) the edges do not determine the nodes.
    """

    def __init__(self, graph: Graph, state: Array, scan_errors: Array | None = None) -> None:
        self._scan_errors = np.zeros((3, 3)) if scan_errors is None else scan_errors
        self._graph, self._state = graph, state

    def __getstate__(self) -> dict[str, Any]:
        # the factors are the engine's, and are made again where they are needed
        return {name: value for name, value in vars(self).copy().items() if name not in ("_factor", "_joint")}

    @cached_property
    def _factor(self) -> Factor:
        system = self._graph.information(self._state)
        try:
            # the next solve would overwrite that of the system
            return system.own_factor()
        except FactorizationError as error:
            raise undetermined(self._graph, self._state, error) from None

    @cached_property
    def _joint(self) -> JointFactor | None:
        """The factor of the system with its parameters."""
        graph = self._graph
        if graph.parameters is None:
            if graph.held is None:
                return None
            graph = replace(graph, parameters=graph.held)
        joint = JointGraph(graph)
        return JointFactor(joint, self._factor, joint.border(graph, self._state, self._state, scaled=True))

    @cached_property
    def _spread(self) -> Array:
        """A (n, 3, K) with A A' the part of the covariance of the nodes that is due to the parameters and errors of scans."""
        parts = [np.zeros((*self._state.shape, 0))]
        if self._joint is not None:
            parts.append(self._joint.reach @ np.linalg.cholesky(self._joint.covariance))
        if self._scan_errors.any():
            graph, poses = self._graph, len(self._graph.steps)
            signs = np.random.default_rng(0).choice([-1.0, 1.0], (poses, 3, SAMPLES))
            errors = np.zeros((*self._state.shape, SAMPLES))
            errors[:poses] = turn_matrix(self._state[:poses, 2]) @ (
                np.sqrt(np.diag(self._scan_errors))[:, None] * signs
            )
            sighted = graph.with_families(f for f in graph.families if isinstance(f, SightingEdges))
            moved = times(sighted.information(self._state), errors)
            moved[graph.fixed] = 0.0
            parts.append(self._factor.solve(moved) / SAMPLES**0.5)
        return np.concatenate(parts, axis=2)

    @property
    def of_parameters(self) -> Array:
        """The covariance (K, K) of the parameters."""
        return np.zeros((0, 0)) if self._joint is None else self._joint.covariance

    def noise_of_delay(self, samples: int, rng: np.random.Generator) -> float:
        """How much of the information on ``sensor_delay`` is noise of the controls.

        A delay moves sightings by tau (u + n), n the noise of the averaged controls. With S(v) the information that sightings
        moved by v have beside the nodes, the estimate tends to tau (1 - E S(n) / S), S that on the delay beside the nodes and
        other parameters.

        Source: Fuller, *Measurement error models* (1987), section 1.1.
        """
        graph, parameters = self._graph, self._graph.estimated
        assert self._joint is not None and graph.log is not None
        k, joint, noise = parameters.names.index("sensor_delay"), JointGraph(graph), 0.0
        rows = graph.log.steps[graph.sighting_rows]
        for _ in range(samples):
            moved = control_noise_at_steps(parameters, rng)[rows]
            border = joint.border(graph, self._state, self._state, scaled=True, controls=moved)
            mixed = np.ascontiguousarray(border.mixed[:, :, k])
            noise += border.own[k, k] - parameters.weights[k] - float(np.sum(mixed * self._factor.solve(mixed)))
        return noise / samples / max(1 / self.of_parameters[k, k] - parameters.weights[k], 1e-300)

    def bias_by_controls(self, samples: int, rng: np.random.Generator) -> Array:
        """The errors (K,) of the parameters that the squares of the noise of the controls cause.

        A motion z with the noise n has the derivative by a scale J + N, N that of n. With P the information of the motions
        beside the nodes, the last Gauss-Newton step contains C E[N' P (-n)], C the covariance of the parameters.
        """
        graph, parameters = self._graph, self._graph.estimated
        edges, found = motion_edges(graph), np.zeros(len(parameters))
        if edges is None:
            return found
        for _ in range(samples):
            noise, slopes = noise_of_slopes(parameters, rng)
            border = Border.of_motions(edges, self._state, self._state, np.dstack([slopes, -noise])).beside(graph.fixed)
            followed = self._factor.solve(np.ascontiguousarray(border.mixed[:, :, -1]))
            found += border.own[:-1, -1] - np.einsum("nik,ni->k", border.mixed[:, :, :-1], followed)
        return np.asarray(self.of_parameters @ found / samples)

    @cached_property
    def diagonal(self) -> Array:
        """The covariance of every node, (n, 3, 3), by selected inversion."""
        blocks = self._factor.diagonal_covariances() + self._spread @ np.swapaxes(self._spread, 1, 2)
        blocks[self._graph.fixed] = 0.0
        return blocks

    @property
    def of_poses(self) -> Array:
        """The covariance of every pose, (P, 3, 3)."""
        return self.diagonal[: len(self._graph.steps)]

    def with_pose(self, j: int) -> Array:
        """The covariances (P, 3, 3) between every pose and pose j, by one solution: the columns of node j in Omega^-1."""
        poses, columns = len(self._graph.steps), np.zeros((self._graph.num_nodes, 3, 3))
        if j in self._graph.fixed:
            return columns[:poses]
        columns[j] = np.eye(3)
        blocks = (self.solve(columns) + self._spread @ self._spread[j].T)[:poses]
        blocks[self._graph.fixed[self._graph.fixed < poses]] = 0.0
        return blocks

    def joint(self, nodes: np.ndarray) -> Array:
        """The covariance (3k, 3k) of nodes (k,) together."""
        spread = self._spread[nodes].reshape(3 * len(nodes), -1)
        whole = self._factor.joint_covariance(nodes) + spread @ spread.T
        held = np.repeat(np.isin(nodes, self._graph.fixed), 3)
        whole[held], whole[:, held] = 0.0, 0.0
        return np.asarray(whole)

    def expected_ate(self, poses: int) -> float:
        """The root of the expected square of the ATE [m] of the first P nodes, ``poses``, if the noise models are right.

        The ATE is the remainder of errors e of the positions after the best rigid motion is removed. To the first order
        that is the part across the three directions g_k in which e shifts or turns all poses together, so its mean square
        is (tr Sigma - sum_k g_k' Sigma g_k) / P.
        """
        centred = self._state[:poses, :2] - self._state[:poses, :2].mean(axis=0)
        rigid = np.zeros((self._graph.num_nodes, 3, 3))
        rigid[:poses, 0, 0] = rigid[:poses, 1, 1] = 1.0
        rigid[:poses, :2, 2] = perpendicular(centred)
        size = np.linalg.norm(rigid, axis=(0, 1))
        rigid /= np.where(size > 0, size, 1.0)
        rigid[self._graph.fixed] = 0.0
        along = np.einsum("nik,nik->k", rigid, self.solve(rigid))
        along += np.sum(np.einsum("nik,nip->kp", rigid, self._spread) ** 2, axis=1)
        total = np.trace(self.diagonal[:poses, :2, :2], axis1=1, axis2=2).sum()
        return float(np.sqrt(max(total - along.sum(), 0.0) / poses))

    def solve(self, right: Array) -> Array:
        """Omega^-1 times right-hand sides, (n, 3) or (n, 3, k)."""
        return self._factor.solve(right)

    def of_edges(self, edges: Linearization) -> Array:
        """The covariance B Omega^-1 B' (E, d, d) of each residual due to the state, of edges of one or two nodes."""
        if self._scan_errors.any():
            # residuals do not follow these errors as they do the noise
            return Uncertainty(self._graph, self._state).of_edges(edges)
        nodes, jacobians, diagonal = edges.nodes, edges.jacobians, self.diagonal
        own = np.sum([B @ diagonal[k] @ np.swapaxes(B, 1, 2) for B, k in zip(jacobians, nodes)], axis=0)
        if len(nodes) == 1:
            return np.asarray(own)
        (first, second), (by_first, by_second) = nodes, jacobians
        crossed = self._factor.covariances_between(first, second)
        crossed = crossed + self._spread[first] @ np.swapaxes(self._spread[second], 1, 2)
        crossed[np.isin(first, self._graph.fixed) | np.isin(second, self._graph.fixed)] = 0.0
        mixed = by_first @ crossed @ np.swapaxes(by_second, 1, 2)
        return own + mixed + np.swapaxes(mixed, 1, 2)

    def joint_square(self, errors: Array) -> float:
        """e' Omega e for errors (P, 3) of all poses but the first, given the first.

        Landmark nodes and parameters are eliminated.
        """
        from scipy.sparse import bmat
        from scipy.sparse.linalg import spsolve

        border = None if self._joint is None else self._joint.border
        omega, end = self._graph.information(self._state).to_sparse().tocsc(), errors.size
        if border is not None:
            mixed = border.mixed.reshape(omega.shape[0], -1)
            omega = bmat([[omega, mixed], [mixed.T, border.own]]).tocsc()
        e = errors[1:].ravel()
        square = float(e @ (omega[3:end, 3:end] @ e))
        if omega.shape[0] > end:
            across = omega[end:, 3:end] @ e
            square -= float(across @ spsolve(omega[end:, end:], across))
        return square


#: the parameters that are identifiable from turns only: where the robot does not turn, a shift of the sensor moves all
#: sightings alike
BY_TURNS = ("sensor_ahead", "sensor_left", "sensor_delay")
#: the parameters that change the size of the world; only their quotient is identifiable
SCALES = ("wheel_scale", "range_scale")
#: scales of what is recorded with noise, if most of its changes look like it
OF_CONTROLS, RECORDED = ("wheel_scale", "turn_scale"), 0.5
#: a scale that is so many standard deviations from 1 is wrong, or the other one is
SIGNIFICANT = 3.0
#: a delay is too close to zero where noise is at least this part of the information on it, and explains at least so many
#: standard deviations; it is not identifiable where noise is more than the next part; the samples of this noise
NOISY, SHORT, DROWNED, CONTROLS = 0.1, 1.0, 0.8, 4
#: doubtful where the motion edges cost less than this part of what they should
SMALL = 0.3
#: the expected cost from which the ratio is judged: its standard deviation is then sqrt(2 / 30), a quarter
ENOUGH = 30.0


def doubts(graph: Graph, state: Array, uncertainty: Uncertainty) -> str:
    """The sentences that apply; empty where nothing speaks against the parameters."""
    parameters = graph.estimated
    deviations = np.sqrt(np.diag(uncertainty.of_parameters))
    found = (
        doubt_of_scale(parameters, deviations),
        doubt_of_turns(graph, state, uncertainty),
        doubt_of_delay(parameters, deviations, uncertainty),
        doubt_of_squares(parameters, deviations, uncertainty),
    )
    return ". ".join(each for each in found if each)


def doubt_of_scale(parameters: Parameters, deviations: Array) -> str:
    """A sentence where one scale is clearly not 1 and the other is held; empty otherwise.

    Wheels that measure s times the way, and a sensor that measures 1 / s times the ranges, give the same log up to the size
    of the world and to the noise, so that J does not tell them apart.
    """
    names = [name for name in parameters.names if name in SCALES]
    if len(names) != 1:
        return ""
    k = parameters.names.index(names[0])
    value, other = parameters.values[k], SCALES[1 - SCALES.index(names[0])]
    if abs(value - 1) < SIGNIFICANT * deviations[k]:
        return ""
    return (
        f"{names[0]} is {value:.3f} if {other} is 1, and a log explains itself as well with {other} {1 / value:.3f} instead. "
        "Only a length that is known, such as the distance of two landmarks, tells which of the two is wrong"
    )


def doubt_of_turns(graph: Graph, state: Array, uncertainty: Uncertainty) -> str:
    """A sentence where the motion model allows much more noise than the motions have; empty otherwise.

    At the optimum, the residual of a motion edge has the covariance C - P, P = B Omega^-1 B', if the models are right. So the
    expected cost of all motion edges is the sum of tr(I - C^-1 P). Where they cost much less, the noise of the sightings
    appears as turns of the robot, and a parameter in `BY_TURNS` fits these.
    """
    names = [name for name in graph.estimated.names if name in BY_TURNS]
    motions = motion_edges(graph)
    if not names or motions is None:
        return ""
    edges = motions.linearize(state, state)
    fitted = np.einsum("eij,eji->", edges.information, uncertainty.of_edges(edges))
    expected, cost = edges.residuals.size - fitted, float(edges.mahalanobis.sum())
    if expected < ENOUGH or cost > SMALL * expected:
        return ""
    return (
        "the motions vary much less than the motion model allows: J of their edges is "
        f"{cost / expected:.2f} of its expected value. Noise of the sightings may then appear as turns of the robot, "
        f"so do not rely on {', '.join(names)}. Give the motion model the noise of the robot, "
        "for example with slam-compare calibrate, which needs to know the place of the sensor (--sensor-offset)"
    )


def doubt_of_delay(parameters: Parameters, deviations: Array, uncertainty: Uncertainty) -> str:
    """A sentence where noise of the recorded controls makes the delay clearly too small; empty otherwise."""
    if "sensor_delay" not in parameters.names:
        return ""
    k = parameters.names.index("sensor_delay")
    value, deviation = float(parameters.values[k]), float(deviations[k])
    noise = uncertainty.noise_of_delay(CONTROLS, np.random.default_rng(0))
    if noise > DROWNED:
        return (
            "nearly all of the information on sensor_delay is noise of the recorded controls, if the motion model is right: "
            "this log does not tell its value"
        )
    # the smallest difference that counts, before it is divided by what is left
    if noise < NOISY or abs(value) < deviation or abs(value) * noise < SHORT * deviation * (1 - noise):
        return ""
    rest = f"{value / (1 - noise):.2g} +- {deviation / (1 - noise):.1g} s"
    return (
        f"{noise:.0%} of the information on sensor_delay is noise of the recorded controls, so that it is too close to zero "
        f"by this part: if the motion model is right, it is about {rest}"
    )


def doubt_of_squares(parameters: Parameters, deviations: Array, uncertainty: Uncertainty) -> str:
    """A sentence where squares of the noise of the recorded controls make scales clearly too large; empty otherwise."""
    shown = dict(zip(OF_CONTROLS, recorded_noise(parameters) > RECORDED))
    # the noise of commands, as in the book, is in the motions alone
    scales = [k for k, name in enumerate(parameters.names) if shown.get(name)]
    if not scales:
        return ""
    bias = uncertainty.bias_by_controls(CONTROLS, np.random.default_rng(0))
    if not (wrong := [k for k in scales if abs(bias[k]) > SHORT * deviations[k]]):
        return ""
    rest = ", ".join(
        f"{parameters.names[k]} {parameters.values[k] - bias[k]:.3f} +- {deviations[k]:.1g}" for k in wrong
    )
    return (
        f"noise of the recorded controls makes {', '.join(parameters.names[k] for k in wrong)} too large, because its square "
        f"counts as well where speeds hardly change. If the motion model is right, the values without it are about {rest}. "
        "noise='auto' averages the controls and has no such error"
    )


def ids_of(name: str, value: Any) -> list[int]:
    """One id, or a list of ids, as a list; None gives an empty one.

    Raises:
        OptionError: the value is neither.
    """
    if value is None:
        return []
    try:
        ids = np.asarray(value)
        if ids.ndim < 2 and (ids.size == 0 or ids.dtype.kind in "iu"):
            return list(np.atleast_1d(ids).tolist())
    except ValueError:  # lists of different lengths
        pass
    raise OptionError(f"{name} must be an id, or a list of ids, not {quoted(value)}")


def shaped(poses: Any, landmarks: Any, of_poses: list[Array], of_landmarks: list[Array], d: int) -> Any:
    """Matrices of poses and of landmarks, d x d, in the shape of the arguments that named them."""
    found = []
    for ids, blocks, size in ((poses, of_poses, 3), (landmarks, of_landmarks, d)):
        if np.ndim(ids) == 0 and ids is not None:
            found.append(blocks[0].copy())
        elif ids is not None:
            found.append(np.array(blocks) if blocks else np.zeros((0, size, size)))
    return found[0] if len(found) == 1 else tuple(found)


def split(matrix: Array, poses: Any, landmarks: Any, d: int) -> Any:
    """The blocks on the diagonal of a joint covariance, those of landmarks d x d, in the shape of the arguments."""
    first, others = len(ids_of("poses", poses)), len(ids_of("landmarks", landmarks))
    ends = np.cumsum([0, *[3] * first, *[d] * others]).tolist()
    blocks = [matrix[a:b, a:b] for a, b in pairwise(ends)]
    return shaped(poses, landmarks, blocks[:first], blocks[first:], d)
