"""Whether the turns that tell the place and the delay of the sensor may be noise of the sightings."""

from __future__ import annotations

import numpy as np

from ..graph import Graph
from ..se2 import Array
from ..uncertainty import Uncertainty
from .corrected import motion_edges

#: the parameters that turns tell: a shift of the sensor moves sightings differently only where the robot turns
BY_TURNS = ("sensor_ahead", "sensor_left", "sensor_delay")
#: doubtful where the motion edges cost less than this part of what they should
SMALL = 0.3
#: the expected cost from which the ratio is judged: its standard deviation is then sqrt(2 / 30), a quarter
ENOUGH = 30.0


def doubt_of_turns(graph: Graph, state: Array, uncertainty: Uncertainty) -> str:
    """A sentence where the motion model allows much more noise than the motions have; empty otherwise.

    At the optimum, the residual of a motion edge has the covariance C - P, P = B Omega^-1 B', if the models are right. So the
    expected cost of all motion edges is the sum of tr(I - C^-1 P). Where they cost much less, the noise of the sightings
    appears as turns of the robot, and a parameter in `BY_TURNS` fits these.
    """
    assert graph.parameters is not None
    names = [name for name in graph.parameters.names if name in BY_TURNS]
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
