"""States to search from after an end that is not proven: along the negative direction of S."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..graph import Graph
from ..se2 import Array

#: the lengths that are tried, as changes of the heading [rad] that turns most
LENGTHS = (4.0, 2.0, 1.0)


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
    for length in LENGTHS:
        for sign in (1.0, -1.0):
            moved = state.copy()
            place = t + sign * length * step[:, 1]
            moved[:, 0], moved[:, 1] = place.real, place.imag
            moved[:poses, 2] = np.angle(z + sign * length * step[:poses, 0])
            moved[graph.fixed] = state[graph.fixed]
            yield moved
