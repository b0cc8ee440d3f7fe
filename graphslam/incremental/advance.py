# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""Passes of one step of an online solution, until the cost falls no further.

Coarse passes look only at what has moved far. The work that the forces of new edges have done on the older ones bounds how
far these are from where they were evaluated, whatever moves as one piece. Where that work is above what was harmless so
far, fine passes look at all nodes. The decrease of J that the first one predicts is the price of the coarse passes since
the last fine one, and sets the work that is allowed from then on.
"""

import numpy as np
from numba import njit

from .arrays import ALLOWED, COST, CURVED_FROM, EXACT_FROM, HOLD, LIMIT, RATE, SHRINKS, WORK
from .linearize import CHANGED, EXACT, linearize
from .passes import backward, forward, homes_around, reevaluate, solve_paths
from .refactor import refactor

#: in standard deviations of the edges of a node: edges are evaluated again where a node has moved by `APART`, where J
#: is `SMALL`. It grows with the square root of J, in fine passes up to there, in coarse passes by no more than `COARSE`;
#: these also solve the tree downwards only where a separator has moved as far
APART, SMALL, COARSE = 0.005, 600.0, 10.0
#: `APART` with a robust kernel, whose weights change faster with a node than its Jacobians do
ROBUST_APART = 0.0015
#: where a pass predicts more than `SLOW` times the decrease of the pass before, the limit beyond which an edge is linearised
#: again is multiplied by `STRICTER`, and by `EASIER` after every step that needs no pass
SLOW, STRICTER, EASIER = 0.2, 0.1, 1.1
#: the same where edges were linearised again, more than `DIVERGING` times. Where the predicted decrease grows `GROWS` times
#: then, although it is below `NEAR` times J and the limit below `STRICT`, all edges get their second derivatives. These make
#: passes slow along directions that are hardly determined, so that they are not in the factor otherwise
DIVERGING, GROWS, NEAR, STRICT = 0.5, 1.5, 1e-6, 1e-4
#: for so many passes second derivatives are convex once exact ones have made Omega indefinite
HELD = 3
#: the part of the tolerance that coarse passes may cost, and the most work that is allowed, as a part of J
PRICE, MOST = 0.1, 1e-3
#: by so much the largest ratio of what coarse passes cost to the square of their work falls with each fine pass, and that of
#: the predictions of two passes with each step
FORGET = 0.9
#: passes end where one predicts that J falls by so many times itself
HOPELESS = 10.0
#: results of `advance`: the optimum was reached; no end in sight; Omega became indefinite, and all has to be built again
DONE, UNFINISHED, INDEFINITE = range(3)


@njit(cache=True, error_model="numpy")
def advance(nodes, edges, tree, robust, buffers, memory, tolerance, apart, done, most, fresh, touched, before):
    """Iterate until the predicted decrease of the cost is below ``tolerance`` of it.

    ``before`` (n, 3) are the increments that the nodes ``touched`` of the edges ``fresh`` had before these were added.
    Returns the result and the number of passes, of which ``done`` were made before; all passes together are at most ``most``.
    """
    work, moved, homes, late = buffers
    size = min(max(np.sqrt(memory[COST] / SMALL), 0.01), COARSE)
    far, apart = apart * size, apart * min(size, 1.0)
    last, none, fine = np.inf, np.int64(0), memory[WORK] > memory[ALLOWED]
    first, renewed = fine, False
    memory[SHRINKS] *= FORGET
    for k in range(done, most):
        if memory[HOLD] > 0:
            memory[HOLD] -= 1
            if memory[HOLD] == 0:
                memory[EXACT_FROM] = EXACT
        count = backward(nodes, tree, work, -1.0 if fine else far, apart if fine else far, moved, none)
        if not fine and count > 0:
            # edges are evaluated where both ends are exact
            around = homes_around(moved, count, nodes, edges, tree, homes)
            solve_paths(homes, around, nodes, tree, work, far)
        changed, old = reevaluate(moved, count, nodes, edges, tree, robust, memory, homes, late)
        predicted = forward(homes, changed, nodes, tree, work)
        # J cannot fall by more than itself: far from any minimum, undamped passes lead nowhere
        if not predicted < HOPELESS * memory[COST] + 1.0:
            break
        if first:
            _allow(memory, predicted, PRICE * tolerance * memory[COST], MOST * memory[COST])
            first = False
        # what is left after this pass, if the predictions of further ones shrink as slowly as lately
        memory[SHRINKS] = max(memory[SHRINKS], min(predicted / last, 0.9), 0.75 if memory[CURVED_FROM] == 0.0 else 0.0)
        if predicted * max(1.0, memory[SHRINKS] / (1 - memory[SHRINKS])) <= tolerance * memory[COST]:
            if count > 0:
                backward(nodes, tree, work, far, np.inf, moved, none)
            else:
                memory[LIMIT] = min(CHANGED, EASIER * memory[LIMIT])
            if not fine:
                memory[WORK] += _work(nodes, edges, robust, fresh, touched, before)
                first = fine = memory[WORK] > memory[ALLOWED]
                last, renewed = np.inf, False
                if fine:
                    continue
            return DONE, k
        if predicted > (DIVERGING if renewed else SLOW) * last:
            near = GROWS * last < predicted < NEAR * memory[COST]
            if near and renewed and memory[HOLD] == 0 and memory[LIMIT] < STRICT and memory[CURVED_FROM] > 0.0:
                memory[CURVED_FROM] = 0.0
            else:
                # slow passes: more of the edges have to be linearised where they are
                memory[LIMIT] = max(STRICTER * memory[LIMIT], 1e-9)
        last, renewed = predicted, old > 0
        while old and not refactor(late, old, nodes, edges, tree, robust, memory, work):
            if memory[HOLD] > 0:
                return INDEFINITE, k + 1
            memory[EXACT_FROM], memory[HOLD] = np.inf, HELD
    return UNFINISHED, most


@njit(cache=True, error_model="numpy")
def _allow(memory, predicted, price, most):
    """Set the work that is allowed until the next fine pass, from what the coarse passes until this one have cost."""
    if memory[WORK] < np.inf:
        # what linear increments leave out grows with the square of the work
        memory[RATE] = max(predicted / max(memory[WORK], 1e-9) ** 2, FORGET * memory[RATE])
        memory[ALLOWED] = min(np.sqrt(price / max(memory[RATE], 1e-30)), 2 * max(memory[ALLOWED], 1e-3), most)
    memory[WORK] = 0.0


@njit(cache=True, error_model="numpy")
def _work(nodes, edges, robust, fresh, touched, before):
    """The work of the forces of edges on their nodes since these had the increments ``before``: twice the energy that all
    other edges have taken up."""
    for k in range(len(touched)):
        nodes.local[touched[k]] = k
    kernel, width, _ = robust
    total = 0.0
    for e in fresh:
        u, c, s, _, g, _ = linearize(e, nodes, edges, kernel, width)
        a, b = nodes.local[edges.ends[e, 0]], nodes.local[edges.ends[e, 1]]
        i, j = edges.ends[e, 0], edges.ends[e, 1]
        x, y, phi = nodes.d[i, 0] - before[a, 0], nodes.d[i, 1] - before[a, 1], nodes.d[i, 2] - before[a, 2]
        p, q, t = nodes.d[j, 0] - before[b, 0], nodes.d[j, 1] - before[b, 1], nodes.d[j, 2] - before[b, 2]
        total += g[0] * x + g[1] * y + (u[0] * g[0] + u[1] * g[1] + g[2]) * phi
        total -= g[0] * (c * p - s * q) + g[1] * (s * p + c * q) + g[2] * t
    for k in range(len(touched)):
        nodes.local[touched[k]] = -1
    return abs(total)
