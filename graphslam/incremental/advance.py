# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""Passes of one step of an online solution, until the cost falls no further."""

import numpy as np
from numba import njit

from .arrays import COST, CURVED_FROM, HOLD, LIMIT
from .linearize import CHANGED, CURVED
from .passes import backward, forward, reevaluate
from .refactor import refactor

#: in standard deviations of the edges of a node: edges are evaluated again where a node has moved by `APART`, and the
#: tree is solved downwards where a separator has moved by `SHARE`; both are smaller, in proportion to its square root, where
#: the cost is less than `SMALL`
APART, SHARE, SMALL = 0.005, 0.001, 600.0
#: `APART` with a robust kernel, whose weights change faster with a node than its Jacobians do
ROBUST_APART = 0.0015
#: where a pass predicts more than `SLOW` times the decrease of the pass before, the limit beyond which an edge is linearised
#: again is multiplied by `STRICTER`, and by `EASIER` after every step that needs no pass
SLOW, STRICTER, EASIER = 0.2, 0.1, 1.1
#: passes end where one predicts that J falls by so many times itself
HOPELESS = 10.0
#: results of `advance`: the optimum was reached; no end in sight; Omega became indefinite, and all has to be built again
DONE, UNFINISHED, INDEFINITE = range(3)


@njit(cache=True, error_model="numpy")
def advance(nodes, edges, tree, robust, buffers, memory, tolerance, apart, share, done, most):
    """Iterate until the predicted decrease of the cost is below ``tolerance`` of it.

    Returns the result and the number of passes, of which ``done`` were made before; all passes together are at most ``most``.
    """
    work, moved, homes, late = buffers
    fine = min(1.0, max(np.sqrt(memory[COST] / SMALL), 0.01))
    share, apart = share * fine, apart * fine
    before, none = np.inf, np.int64(0)
    for k in range(done, most):
        if memory[HOLD] > 0:
            memory[HOLD] -= 1
            if memory[HOLD] == 0:
                memory[CURVED_FROM] = CURVED
        count = backward(nodes, tree, work, share, apart, moved, none)
        if count == 0:
            memory[LIMIT] = min(CHANGED, EASIER * memory[LIMIT])
            return DONE, k
        # edges are evaluated where both ends are exact
        count = backward(nodes, tree, work, -1.0, apart, moved, count)
        changed, old = reevaluate(moved, count, nodes, edges, tree, robust, memory, homes, late)
        if changed == 0:
            return DONE, k
        predicted = forward(homes, changed, nodes, tree, work)
        # J cannot fall by more than itself: far from any minimum, undamped passes lead nowhere
        if not predicted < HOPELESS * memory[COST] + 1.0:
            break
        if predicted <= tolerance * memory[COST]:
            backward(nodes, tree, work, share, np.inf, moved, none)
            return DONE, k
        # slow passes: more of the edges have to be linearised where they are
        if predicted > SLOW * before:
            memory[LIMIT] = max(STRICTER * memory[LIMIT], 1e-9)
        before = predicted
        if old:
            before = np.inf
            if not refactor(late, old, nodes, edges, tree, robust, memory, work):
                return INDEFINITE, k + 1
    return UNFINISHED, most
