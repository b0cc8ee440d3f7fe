# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""New nodes and edges in the arrays of an online solution."""

import numpy as np
from numba import njit

#: kinds of edges: to a new pose, a sighting of a landmark, another relation of poses
MOTION, SIGHTING, RELATION = range(3)


@njit(cache=True, error_model="numpy")
def append(nodes, edges, known, fresh, ends, kinds, measured, information, rows, robust):
    """Put edges at the places ``fresh`` (E,); nodes from number ``known`` on are new, and placed by their first edge.

    ``ends`` (E, 2), ``measured`` (E, 3), ``information`` (E, 6) and ``rows`` (E,) are as in `arrays.EDGE`. Returns the nodes
    of the edges, each once.
    """
    touched, count, place = np.empty(2 * len(fresh), np.int32), 0, known
    for k in range(len(fresh)):
        e, i, j = fresh[k], ends[k, 0], ends[k, 1]
        edges.ends[e, 0], edges.ends[e, 1], edges.rows[e] = i, j, rows[k]
        edges.robust[e] = robust and kinds[k] == SIGHTING
        for c in range(3):
            edges.measured[e, c] = measured[k, c]
        for c in range(6):
            edges.information[e, c] = information[k, c]
        for side in range(2):
            node = ends[k, side]
            edges.next[e, side], nodes.edges[node] = nodes.edges[node], e
            if nodes.local[node] < 0:
                nodes.local[node] = 0
                touched[count] = node
                count += 1
        if j >= place:
            _place(i, j, k, nodes, measured, rows[k] == 2)
            place = j + 1
        elif i >= place:
            _place_back(i, j, k, nodes, measured)
            place = i + 1
        far = 1 / np.sqrt(min(information[k, 0], information[k, 2]))
        turned = 1 / np.sqrt(information[k, 5]) if rows[k] == 3 else np.inf
        if kinds[k] == SIGHTING:
            turned = far / max(np.hypot(measured[k, 0], measured[k, 1]), far)
            if k == 0 or kinds[k - 1] != SIGHTING:
                # what a pose without sightings has taken from the one before it no longer counts
                nodes.scale[i, 0], nodes.scale[i, 1] = np.inf, np.inf
        if kinds[k] == MOTION:
            if nodes.scale[i, 0] == np.inf:
                nodes.scale[i, 0], nodes.scale[i, 1] = far, turned
            nodes.scale[j, 0], nodes.scale[j, 1] = nodes.scale[i, 0], nodes.scale[i, 1]
        else:
            for node in (i, j):
                nodes.scale[node, 0] = min(nodes.scale[node, 0], far)
                nodes.scale[node, 1] = min(nodes.scale[node, 1], turned)
    for k in range(count):
        nodes.local[touched[k]] = -1
    return touched[:count]


@njit(cache=True, error_model="numpy")
def _place(i, j, k, nodes, measured, point):
    """Node j where the k-th measurement from node i says; headings are not wrapped, since increments add up."""
    c, s = nodes.axes[i, 0], nodes.axes[i, 1]
    nodes.x[j, 0] = nodes.x[i, 0] + c * measured[k, 0] - s * measured[k, 1]
    nodes.x[j, 1] = nodes.x[i, 1] + s * measured[k, 0] + c * measured[k, 1]
    nodes.x[j, 2] = 0.0 if point else nodes.x[i, 2] + measured[k, 2]
    nodes.point[j] = point
    _begin(j, nodes)


@njit(cache=True, error_model="numpy")
def _place_back(i, j, k, nodes, measured):
    """Pose i so that the k-th measurement from it leads to pose j."""
    nodes.x[i, 2] = nodes.x[j, 2] - measured[k, 2]
    c, s = np.cos(nodes.x[i, 2]), np.sin(nodes.x[i, 2])
    nodes.x[i, 0] = nodes.x[j, 0] - c * measured[k, 0] + s * measured[k, 1]
    nodes.x[i, 1] = nodes.x[j, 1] - s * measured[k, 0] - c * measured[k, 1]
    nodes.point[i] = False
    _begin(i, nodes)


@njit(cache=True, error_model="numpy")
def _begin(node, nodes):
    nodes.axes[node, 0], nodes.axes[node, 1] = np.cos(nodes.x[node, 2]), np.sin(nodes.x[node, 2])
    for c in range(3):
        nodes.passed[node, c] = nodes.evaluated[node, c] = nodes.x[node, c]


@njit(cache=True, error_model="numpy")
def detach(nodes, edges, first, count):
    """Take the last edges, from number ``first`` to ``count``, out of the lists of their nodes."""
    for e in range(count - 1, first - 1, -1):
        for side in (1, 0):
            nodes.edges[edges.ends[e, side]] = edges.next[e, side]
