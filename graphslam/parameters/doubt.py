"""What speaks against estimated parameters although the log determines them."""

from __future__ import annotations

import numpy as np

from ..graph import Graph
from ..se2 import Array
from ..uncertainty import Uncertainty
from .corrected import motion_edges
from .declared import Parameters

#: the parameters that turns tell: a shift of the sensor moves sightings differently only where the robot turns
BY_TURNS = ("sensor_ahead", "sensor_left", "sensor_delay")
#: the parameters that change the size of the world; a log tells only their quotient
SCALES = ("wheel_scale", "range_scale")
#: a scale that is so many standard deviations from 1 is wrong, or the other one is
CLEAR = 3.0
#: doubtful where the motion edges cost less than this part of what they should
SMALL = 0.3
#: the expected cost from which the ratio is judged: its standard deviation is then sqrt(2 / 30), a quarter
ENOUGH = 30.0


def doubts(graph: Graph, state: Array, uncertainty: Uncertainty) -> str:
    """The sentences that apply; empty where nothing speaks against the parameters."""
    parameters = graph.parameters
    assert parameters is not None
    deviations = np.sqrt(np.diag(uncertainty.of_parameters))
    found = (doubt_of_scale(parameters, deviations), doubt_of_turns(graph, state, uncertainty))
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
    if abs(value - 1) < CLEAR * deviations[k]:
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
