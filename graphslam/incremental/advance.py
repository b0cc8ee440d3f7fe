# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""One step of an online solution: new edges into the top of the tree, then passes until the cost falls no further."""

import numpy as np
from numba import njit

from .linearize import CHANGED, CURVED
from .passes import backward, forward, reevaluate
from .top import rebuild

#: in standard deviations of the edges of a node: edges are evaluated again where a node has moved by `APART`, and the
#: tree is solved downwards where a separator has moved by `SHARE`; both are smaller, in proportion to its square root, where
#: the cost is less than `SMALL`
APART, SHARE, SMALL = 0.005, 0.001, 120.0
#: where a pass predicts more than `SLOW` times the decrease of the pass before, the limit beyond which an edge is linearised
#: again is multiplied by `STRICTER`, and by `EASIER` after every step that needs no pass
SLOW, STRICTER, EASIER = 0.2, 0.1, 1.1
#: for so many calls second derivatives stay out of Omega once they have made it indefinite
PLAIN = 20
#: results of `advance`: the optimum was reached; the arrays must grow first; a node is not determined; no end in sight
DONE, GROW, UNDETERMINED, UNFINISHED = range(4)


@njit(cache=True, error_model="numpy")
def advance(nodes, edges, tree, touched, fresh, newest, robust, buffers, limits, tolerance, apart, share, most):
    """Eliminate the top above the nodes ``touched`` with ``fresh`` edges, and iterate until the predicted decrease of the
    cost is below ``tolerance`` of it.

    Returns the result, and what goes with it: the number of passes; or the supernodes, floats, ints and rows to
    make room for, and the number of late edges in the buffer, whose owners are then to be touched.
    """
    kernel, width, gain = robust
    work, moved, homes, late = buffers
    if len(touched):
        result = _eliminate(nodes, edges, tree, touched, fresh, newest, robust, limits, work)
        if result[0]:
            return *result, np.int64(-1)
    if limits[2] > 0:
        limits[2] -= 1
        if limits[2] == 0:
            limits[1] = CURVED
    fine = min(1.0, max(np.sqrt(edges.total[0] / SMALL), 0.01))
    share, apart = share * fine, apart * fine
    before = np.inf
    for k in range(most):
        count = backward(nodes, tree, work, share, apart, moved, 0)
        if count == 0:
            limits[0] = min(CHANGED, EASIER * limits[0])
            return DONE, k, 0, 0, 0, 0
        # edges are evaluated where both ends are exact
        count = backward(nodes, tree, work, -1.0, apart, moved, count)
        changed, old = reevaluate(moved, count, nodes, edges, tree, kernel, width, gain, limits, homes, late)
        if changed + old == 0:
            return DONE, k, 0, 0, 0, 0
        predicted = forward(homes, changed, nodes, tree, work)
        if old:
            owners = np.empty(old, np.int32)
            for q in range(old):
                owners[q] = edges.owner[late[q]]
            result = _eliminate(nodes, edges, tree, owners, fresh[:0], newest, robust, limits, work)
            if result[0]:
                return *result, np.int64(old)
            before = np.inf
            continue
        # slow passes: more of the edges have to be linearised where they are
        if predicted > SLOW * before:
            limits[0] = max(STRICTER * limits[0], 1e-9)
        before = predicted
        if predicted <= tolerance * edges.total[0]:
            backward(nodes, tree, work, share, np.inf, moved, 0)
            return DONE, k, 0, 0, 0, 0
    return UNFINISHED, most, 0, 0, 0, 0


@njit(cache=True, error_model="numpy")
def _eliminate(nodes, edges, tree, touched, fresh, newest, robust, limits, work):
    """`rebuild`, without second derivatives for some time where Omega is not positive definite with them."""
    kernel, width, gain = robust
    while True:
        result = rebuild(nodes, edges, tree, touched, fresh, newest, kernel, width, gain, limits[1], work)
        if result[0] != UNDETERMINED or limits[1] == np.inf:
            return result
        limits[1], limits[2] = np.inf, PLAIN


@njit(cache=True, error_model="numpy")
def complete(nodes, tree, buffers):
    """Solve the whole tree downwards, which `advance` leaves undone where nodes move by less than ``share``."""
    backward(nodes, tree, buffers[0], -1.0, np.inf, buffers[1], 0)
