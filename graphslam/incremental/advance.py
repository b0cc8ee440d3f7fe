# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""One step of an online solution: new edges into the top of the tree, then passes until the cost falls no further."""

import numpy as np
from numba import njit

from .arrays import COST, CURVED_FROM, HOLD, LIMIT
from .linearize import CHANGED, CURVED
from .passes import backward, forward, reevaluate
from .refactor import refactor
from .top import rebuild

#: in standard deviations of the edges of a node: edges are evaluated again where a node has moved by `APART`, and the
#: tree is solved downwards where a separator has moved by `SHARE`; both are smaller, in proportion to its square root, where
#: the cost is less than `SMALL`
APART, SHARE, SMALL = 0.005, 0.001, 120.0
#: where a pass predicts more than `SLOW` times the decrease of the pass before, the limit beyond which an edge is linearised
#: again is multiplied by `STRICTER`, and by `EASIER` after every step that needs no pass
SLOW, STRICTER, EASIER = 0.2, 0.1, 1.1
#: for so many passes second derivatives stay out of Omega once they have made it indefinite
PLAIN = 4
#: passes end where one predicts that J falls by so many times itself
HOPELESS = 10.0
#: results of `advance`: the optimum was reached; the arrays must grow first; a node is not determined; no end in sight
DONE, GROW, UNDETERMINED, UNFINISHED = range(4)


@njit(cache=True, error_model="numpy")
def advance(nodes, edges, tree, touched, fresh, newest, robust, buffers, memory, number, tolerance, apart, share, most):
    """Eliminate the top above the nodes ``touched`` with ``fresh`` edges, and iterate until the predicted decrease of the
    cost is below ``tolerance`` of it.

    Returns the result, and what goes with it: the number of passes; or the supernodes, floats, ints and rows to
    make room for, and 0 if all of the ``number`` nodes are to be touched then, otherwise -1.
    """
    work, moved, homes, late = buffers
    if len(touched):
        result = _eliminate(nodes, edges, tree, touched, fresh, newest, robust, memory, work)
        if result[0]:
            return *result, np.int64(-1)
    fine = min(1.0, max(np.sqrt(memory[COST] / SMALL), 0.01))
    share, apart = share * fine, apart * fine
    before = np.inf
    for k in range(most):
        if memory[HOLD] > 0:
            memory[HOLD] -= 1
            if memory[HOLD] == 0:
                memory[CURVED_FROM] = CURVED
        count = backward(nodes, tree, work, share, apart, moved, 0)
        if count == 0:
            memory[LIMIT] = min(CHANGED, EASIER * memory[LIMIT])
            return DONE, k, 0, 0, 0, 0
        # edges are evaluated where both ends are exact
        count = backward(nodes, tree, work, -1.0, apart, moved, count)
        changed, old = reevaluate(moved, count, nodes, edges, tree, robust, memory, homes, late)
        if changed == 0:
            return DONE, k, 0, 0, 0, 0
        predicted = forward(homes, changed, nodes, tree, work)
        # J cannot fall by more than itself: far from any minimum, undamped passes lead nowhere
        if not predicted < HOPELESS * memory[COST] + 1.0:
            break
        if predicted <= tolerance * memory[COST]:
            backward(nodes, tree, work, share, np.inf, moved, 0)
            return DONE, k, 0, 0, 0, 0
        # slow passes: more of the edges have to be linearised where they are
        if predicted > SLOW * before:
            memory[LIMIT] = max(STRICTER * memory[LIMIT], 1e-9)
        before = predicted
        if old:
            before = np.inf
            if not refactor(late, old, nodes, edges, tree, robust, memory, work):
                memory[CURVED_FROM], memory[HOLD] = np.inf, PLAIN
                result = _eliminate(
                    nodes, edges, tree, np.arange(number).astype(np.int32), fresh[:0], newest, robust, memory, work
                )
                if result[0] == GROW:
                    return *result, np.int64(0)
                if result[0]:
                    break
    return UNFINISHED, most, 0, 0, 0, 0


@njit(cache=True, error_model="numpy")
def _eliminate(nodes, edges, tree, touched, fresh, newest, robust, memory, work):
    """`rebuild`, without second derivatives for some time where Omega is not positive definite with them."""
    while True:
        result = rebuild(nodes, edges, tree, touched, fresh, newest, robust, memory, work)
        if result[0] != UNDETERMINED or memory[CURVED_FROM] == np.inf:
            return result
        memory[CURVED_FROM], memory[HOLD] = np.inf, PLAIN


@njit(cache=True, error_model="numpy")
def complete(nodes, tree, buffers):
    """Solve the whole tree downwards, which `advance` leaves undone where nodes move by less than ``share``."""
    backward(nodes, tree, buffers[0], -1.0, np.inf, buffers[1], 0)
