"""Whether the odometry contradicts the other measurements on one stretch of a drive, as where wheels slip or are blocked.

Noise models say how much all motions scatter. Wheels that slip for ten seconds are off by metres in one direction there, and
the solution, which believes the models, spreads the error over poses and landmarks. With e_k the residual of motion k along
the robot's first axis, or of its heading, v_k its variance by the noise model, S and V their sums over a stretch, S' and V'
those over the rest of the drive,

    d = S - b V,   b = S' / V',   z = d / sqrt(V (1 + V / V')):

the robot drove or turned by d more than the odometry says, beside the constant error b that a bias leaves. A residual at the
solution varies less than v_k, so that z of a right model is at most a standard normal number. Where models are too narrow,
all stretches have large ones: z counts in units of their median over all stretches of the same length.

The largest abs(z) of all stretches is a scan statistic (Kulldorff, *A spatial scan statistic*, 1997).
"""

from __future__ import annotations

import numpy as np

from ..graph import Graph
from ..se2 import Array, between, wrap
from .corrected import motion_edges

#: abs(z) of a stretch that is said. On 60 drives of unknown robots with heavy tails the largest was 5.1 and the next 3.8, on
#: the real logs 4.6
SIGNIFICANT = 6.0
#: the fewest motions of a drive that are tested, and the factor between the lengths of stretches
FEWEST, GROWTH = 20, 1.4
#: the median of the absolute value of a standard normal number
MEDIAN = 0.6745


def doubt_of_odometry(graph: Graph, state: Array) -> str:
    """A sentence on the stretch where the odometry contradicts the other measurements most clearly; empty where none does."""
    edges, log = motion_edges(graph), graph.log
    if edges is None or log is None or log.times is None or edges.count < FEWEST:
        return ""
    errors = between(state[edges.first], state[edges.second]) - edges.measured
    errors[:, 2] = wrap(errors[:, 2])
    variances = np.linalg.inv(edges.information)
    z, first, last, error, unit = max(
        (*_largest(errors[:, axis], variances[:, axis, axis]), unit) for axis, unit in ((0, "m"), (2, "rad"))
    )
    if z < SIGNIFICANT:
        return ""
    begin, end = int(graph.steps[edges.first[first]]), int(graph.steps[edges.second[last]])
    times = log.times[[begin, end]] - log.times[0]
    return (
        f"between steps {begin} and {end} ({times[0]:.1f} to {times[1]:.1f} s after the start) the odometry contradicts the "
        f"other measurements by {error:.2g} {unit}, {z:.1f} times the standard deviation of the noise model: wheels slipped "
        "or were blocked, the robot was moved, or many ids are wrong. The poses there may be off by as much, those after it "
        "and landmarks, too, and covariances do not contain it. Controls that are wrong need more noise "
        "(Log.control_variances)"
    )


def _largest(errors: Array, variances: Array) -> tuple[float, int, int, float]:
    """The largest abs(z) of all stretches of errors (E,), the first and the last motion of that stretch, and its abs(d)."""
    S, V = (np.concatenate([[0.0], np.cumsum(values)]) for values in (errors, variances))
    best, length = (0.0, 0, 0, 0.0), 1
    while length <= len(errors) // 2:
        within, variance = S[length:] - S[:-length], V[length:] - V[:-length]
        rest = V[-1] - variance
        d = within - (S[-1] - within) * variance / rest
        z = np.abs(d) / np.sqrt(variance * (1 + variance / rest))
        z /= max(1.0, float(np.median(z)) / MEDIAN)
        k = int(np.argmax(z))
        best = max(best, (float(z[k]), k, k + length - 1, abs(float(d[k]))))
        length = max(length + 1, int(GROWTH * length))
    return best
