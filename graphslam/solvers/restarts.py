"""Restarts with one stretch of the trajectory turned by 2 pi: a search for a lower minimum near a local one.

Sightings hold headings up to full turns. Where they are few or noisy, mainly the motion edges say how far the robot turns
over a stretch of poses, and one full turn more or less, spread over the stretch, leads to another minimum. If the headings
of an end deviate from those of the odometry by E over a stretch whose odometry has the variance V, the motion edges
cost about E² / V there, and (2 pi - abs(E))² / V after the other turn.

`descents` has the restarts from an end that is not proven, along the negative direction of its certificate.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..errors import GraphError
from ..graph import Graph
from ..se2 import Array, rotation, wrap
from .gauss_newton import gauss_newton
from .initial_values import odometry
from .iteration import Run

#: a turn is tried where it raises the cost of the motion edges by at most this: a factor of exp(-5) in likelihood
MOST_RISE = 10.0
#: lengths of stretches [motions], from shortest to longest; stretches of one group do not overlap
LENGTHS = ((2, 8), (9, 32), (33, 100))
#: a turn is kept if it lowers J by more than this part of it
LOWER = 1e-6
#: the most turns to try, at most one for so many poses, and the most steps after each
TURNS, POSES_PER_TURN, STEPS = 40, 4, 30


def lower_by_turns(graph: Graph, state: Array, limit: float = np.inf) -> tuple[Array | None, int]:
    """The state (n, 3) that other turns lead to, one after the other, each kept if it lowers J; None if none does.

    Returns:
        The state, and the number of steps that were taken: after ``limit`` steps no further turn is tried.
    """
    most, steps = min(TURNS, len(graph.steps) // POSES_PER_TURN), 0
    best, cost, tried, again = state, graph.cost(state), set[tuple[int, int, float]](), True
    while again:
        again = False
        for stretch, start in _turns(graph, best):
            if stretch in tried or len(tried) == most or steps >= limit:
                continue
            tried.add(stretch)
            run = Run(start, tolerance=1e-6 * graph.num_nodes**0.5, max_iterations=STEPS)
            try:
                gauss_newton(graph, run)
            except GraphError:
                continue
            steps += len(run.step_norms)
            lower = graph.cost(run.state)
            if lower < cost * (1 - LOWER):
                best, cost, again = run.state, lower, True
                break
    return None if best is state else best, steps


def _turns(graph: Graph, state: Array) -> Iterator[tuple[tuple[int, int, float], Array]]:
    """Stretches (first pose, last pose, sign of E) and the states (n, 3) after their turns, in the order of the costs."""
    try:
        driven, variance = odometry(graph, "auto")
    except GraphError:
        return
    deviation = np.zeros(len(driven))
    deviation[1:] = wrap(np.diff(state[: len(driven), 2]) - driven[1:, 2])
    E, V, headings = np.cumsum(deviation), np.cumsum(variance), np.cumsum(driven[:, 2])
    for first, last in _stretches(E, V):
        sign, stretch = float(np.sign(E[last] - E[first])), slice(first, last + 1)
        share = (V[stretch] - V[first]) / (V[last] - V[first])
        turn = headings[stretch] - headings[first] + E[stretch] - E[first] - 2 * np.pi * sign * share
        heading = state[first, 2] + turn
        steps = np.einsum("kij,kj->ki", rotation(heading[:-1]), driven[first + 1 : last + 1, :2])
        place = state[first, :2] + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
        # what is missing at the last pose is shared evenly
        place += np.linspace(0, 1, len(place))[:, None] * (state[last, :2] - place[-1])
        start = state.copy()
        start[first:last] = np.column_stack([place, heading])[:-1]
        yield (first, last, sign), start


def _stretches(E: Array, V: Array) -> list[tuple[int, int]]:
    """The first and last poses of the stretches whose other turn raises the cost little, the least first."""
    found = list[tuple[float, int, int]]()
    for shortest, longest in LENGTHS:
        group = list[tuple[float, int, int]]()
        for length in range(shortest, min(longest, len(E) - 1) + 1):
            variance = np.maximum(V[length:] - V[:-length], 1e-300)
            rise = 4 * np.pi * (np.pi - np.abs(E[length:] - E[:-length])) / variance
            cheap = np.flatnonzero(rise < MOST_RISE)
            group += zip(rise[cheap].tolist(), cheap.tolist(), (cheap + length).tolist())
        taken = np.zeros(len(E), dtype=bool)
        for rise, first, last in sorted(group):
            if not taken[first:last].any():
                taken[first:last] = True
                found.append((rise, first, last))
    return [(first, last) for _, first, last in sorted(found)]


#: the lengths that are tried, as changes of the heading [rad] that turns most
CHANGES = (4.0, 2.0, 1.0)


def descents(graph: Graph, state: Array, direction: Array) -> Iterator[Array]:
    """States (n, 3) along a direction of `Certificate`, from which the cost may fall below that of the state.

    The function below J falls along the direction, and along the direction turned by any angle; it is turned so that the
    headings change most. J itself need not fall at once, so that long steps come first: on simulated logs, most lower ends
    were reached from changes of two to four radians.
    """
    poses = len(graph.steps)
    z, t = np.exp(1j * state[:poses, 2]), state[:, 0] + 1j * state[:, 1]
    turned = direction[:poses, 0] * np.conj(z)
    largest = np.abs(turned).max(initial=0.0)
    if largest == 0:
        return
    # exp(i phase) makes the squares of the turns as negative as possible: the changes are imaginary, along the circle
    phase = (np.pi - np.angle(np.sum(turned**2))) / 2
    step = direction * np.exp(1j * phase) / largest
    for length in CHANGES:
        for sign in (1.0, -1.0):
            moved = state.copy()
            place = t + sign * length * step[:, 1]
            moved[:, 0], moved[:, 1] = place.real, place.imag
            moved[:poses, 2] = np.angle(z + sign * length * step[:poses, 0])
            moved[graph.fixed] = state[graph.fixed]
            yield moved
