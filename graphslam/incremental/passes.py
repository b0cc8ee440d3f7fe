# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""Passes through the elimination tree: forward where right-hand sides changed, backward where the solution changes."""

import numpy as np
from numba import njit

from .arrays import COST, CURVED_FROM, EXACT_FROM, FLOATS, LIMIT, STAMP, STEP, sizes
from .cholesky.kernels import dot_columns, subtract_columns
from .cholesky.simd import clear, get, put
from .linearize import evaluate, linearize


@njit(cache=True, error_model="numpy")
def forward_one(s, nodes, tree, work):
    """y and carry of a supernode from its right-hand sides and its children; returns the squared change of y."""
    w, r = np.int64(tree.groups.w[s]), np.int64(tree.groups.r[s])
    ld, padded, _ = sizes(w, r)
    width, at, front = 3 * w, tree.groups.at[s], tree.groups.nodes_at[s]
    c = tree.groups.child[s]
    while c > 0:
        wc, rc = np.int64(tree.groups.w[c]), np.int64(tree.groups.r[c])
        carry, below = tree.groups.at[c] + sizes(wc, rc)[2] - 3 * rc, tree.groups.nodes_at[c] + wc
        for q in range(rc):
            node = tree.ints[below + q]
            for k in range(3):
                nodes.scratch[node, k] += tree.floats[carry + 3 * q + k]
        c = tree.groups.sibling[c]
    for q in range(w + r):
        node = tree.ints[front + q]
        for k in range(3):
            work[3 * q + k] = nodes.scratch[node, k] + (nodes.rhs[node, k] if q < w else 0.0)
            nodes.scratch[node, k] = 0.0
    clear(work, width + 3 * r, padded - 3 * r)
    x, y = tree.floats, at + width * ld + 3 * r * padded
    change = _solve_forward(x, at, ld, width, work, y)
    carry = y + width
    for k in range(3 * r):
        x[carry + k] = work[width + k]
    return change


@njit(cache=True, error_model="numpy")
def _solve_forward(x, at, ld, width, work, y):
    """L11 y = work and work -= L21 y, as in `linear.cholesky.triangular`; returns the squared change of y in x."""
    change = 0.0
    for j in range(0, width, 3):
        p0 = at + j * (ld + 1)
        p1 = p0 + ld
        p2 = p1 + ld
        y0 = get(work, j) * get(x, p0)
        y1 = (get(work, j + 1) - get(x, p0 + 1) * y0) * get(x, p1 + 1)
        y2 = (get(work, j + 2) - get(x, p0 + 2) * y0 - get(x, p1 + 2) * y1) * get(x, p2 + 2)
        change += (y0 - x[y + j]) ** 2 + (y1 - x[y + j + 1]) ** 2 + (y2 - x[y + j + 2]) ** 2
        put(x, y + j, y0)
        put(x, y + j + 1, y1)
        put(x, y + j + 2, y2)
        count = (ld - j) & ~3
        if count > 0:
            subtract_columns(work, ld - count, x, at + j * ld + ld - count, ld, y0, y1, y2, count)
    return change


@njit(cache=True, error_model="numpy")
def _solve_backward(x, at, ld, width, work, y):
    """L11' work_front = y - L21' work_separator; the front of ``work`` is zero at first."""
    for j in range(width - 3, -1, -3):
        p0 = at + j * (ld + 1)
        p1 = p0 + ld
        p2 = p1 + ld
        y0, y1, y2 = get(x, y + j), get(x, y + j + 1), get(x, y + j + 2)
        count = (ld - j) & ~3
        if count > 0:
            s0, s1, s2 = dot_columns(work, ld - count, x, at + j * ld + ld - count, ld, count)
            y0 -= s0
            y1 -= s1
            y2 -= s2
        y2 *= get(x, p2 + 2)
        y1 = (y1 - get(x, p1 + 2) * y2) * get(x, p1 + 1)
        y0 = (y0 - get(x, p0 + 1) * y1 - get(x, p0 + 2) * y2) * get(x, p0)
        put(work, j, y0)
        put(work, j + 1, y1)
        put(work, j + 2, y2)


@njit(cache=True, error_model="numpy")
def upwards(homes, count, tree):
    """The supernodes from ``homes`` up to the roots, children before their parents."""
    done, chains = 0, 0
    for k in range(count):
        s = homes[k]
        if tree.groups.mark[s]:
            continue
        tree.groups.stack[chains] = done
        chains += 1
        while s > 0 and not tree.groups.mark[s]:
            tree.groups.mark[s] = 1
            tree.groups.path[done] = s
            done += 1
            s = tree.groups.parent[s]
    # a chain ends below a supernode of an earlier chain, so the last one comes first
    order, end, place = np.empty(done, np.int32), done, 0
    for chain in range(chains - 1, -1, -1):
        for q in range(tree.groups.stack[chain], end):
            order[place] = tree.groups.path[q]
            place += 1
        end = tree.groups.stack[chain]
    for s in order:
        tree.groups.mark[s] = 0
    return order


@njit(cache=True, error_model="numpy")
def forward(homes, count, nodes, tree, work):
    """Repeat the forward solution from supernodes up to the roots; returns the squared change of y, the predicted
    decrease of the cost."""
    change = 0.0
    for s in upwards(homes, count, tree):
        change += forward_one(s, nodes, tree, work)
        tree.groups.changed[s] = 1
    return change


@njit(cache=True, error_model="numpy")
def _solve_one(s, nodes, tree, work):
    """Increments and values of the nodes of a supernode, from y and the increments of its separator."""
    w, r = np.int64(tree.groups.w[s]), np.int64(tree.groups.r[s])
    ld, padded, _ = sizes(w, r)
    width, at, front, step = 3 * w, tree.groups.at[s], tree.groups.nodes_at[s], tree.counts[STEP]
    clear(work, 0, ld)
    for q in range(w, w + r):
        node = tree.ints[front + q]
        for k in range(3):
            work[3 * q + k] = nodes.d[node, k]
    _solve_backward(tree.floats, at, ld, width, work, at + width * ld + 3 * r * padded)
    for q in range(w):
        node = tree.ints[front + q]
        if nodes.changed[node] != step:
            nodes.changed[node] = step
            for k in range(3):
                nodes.kept[node, k] = nodes.x[node, k]
        a, b = work[3 * q] - nodes.d[node, 0], work[3 * q + 1] - nodes.d[node, 1]
        if not nodes.point[node]:
            c, t = nodes.axes[node, 0], nodes.axes[node, 1]
            a, b = c * a - t * b, t * a + c * b
            nodes.x[node, 2] += work[3 * q + 2] - nodes.d[node, 2]
            nodes.axes[node, 0], nodes.axes[node, 1] = np.cos(nodes.x[node, 2]), np.sin(nodes.x[node, 2])
        nodes.x[node, 0] += a
        nodes.x[node, 1] += b
        for k in range(3):
            nodes.d[node, k] = work[3 * q + k]


@njit(cache=True, error_model="numpy")
def backward(nodes, tree, work, share, apart, moved, count):
    """Solve from the roots down wherever y changed or a separator moved by ``share`` standard deviations.

    With a negative ``share`` the whole tree is solved. Nodes that are ``apart`` standard deviations from where their
    edges were evaluated are added to ``moved``, which has ``count``; returns how many there are then.
    """
    tree.counts[STAMP] += 1
    stamp, depth = tree.counts[STAMP], 1
    tree.groups.stack[0] = 0
    while depth > 0:
        depth -= 1
        s = tree.groups.stack[depth]
        if s > 0:
            _solve_one(s, nodes, tree, work)
            front = tree.groups.nodes_at[s]
            for q in range(tree.groups.w[s]):
                node = tree.ints[front + q]
                if _beyond(nodes.x, nodes.passed, nodes.scale, node, share):
                    nodes.mark[node] = stamp
                    for k in range(3):
                        nodes.passed[node, k] = nodes.x[node, k]
                if _beyond(nodes.x, nodes.evaluated, nodes.scale, node, apart):
                    moved[count] = node
                    count += 1
            tree.groups.changed[s] = 0
        c = tree.groups.child[s]
        while c > 0:
            if tree.groups.w[c] > 0:
                visit = share < 0 or tree.groups.changed[c] == 1
                below = tree.groups.nodes_at[c] + tree.groups.w[c]
                for q in range(tree.groups.r[c]):
                    if visit:
                        break
                    visit = nodes.mark[tree.ints[below + q]] == stamp
                if visit:
                    tree.groups.stack[depth] = c
                    depth += 1
            c = tree.groups.sibling[c]
    return count


@njit(cache=True, error_model="numpy")
def solve_paths(homes, count, nodes, tree, work, share):
    """Solve on the paths from the roots down to supernodes ``homes`` only.

    What hangs below is visited by the next `backward`, if a node has moved by ``share`` standard deviations.
    """
    path = upwards(homes, count, tree)
    for k in range(len(path) - 1, -1, -1):
        s = path[k]
        _solve_one(s, nodes, tree, work)
        for q in range(tree.groups.w[s]):
            if tree.groups.changed[s]:
                break
            tree.groups.changed[s] = _beyond(
                nodes.x, nodes.passed, nodes.scale, tree.ints[tree.groups.nodes_at[s] + q], share
            )
    for s in path:
        if tree.groups.changed[s]:
            tree.groups.changed[tree.groups.parent[s]] = 1


@njit(cache=True, error_model="numpy")
def homes_around(moved, count, nodes, edges, tree, homes):
    """The supernodes of all ends of the edges of nodes that moved; returns how many ``homes`` there are."""
    found = 0
    for k in range(count):
        node = moved[k]
        e = nodes.edges[node]
        while e >= 0:
            side = 0 if edges.ends[e, 0] == node else 1
            found = _with_home(nodes.home[edges.ends[e, 1 - side]], homes, found, tree)
            e = edges.next[e, side]
    _unmark(homes, found, tree)
    return found


@njit(cache=True, error_model="numpy")
def _with_home(s, homes, count, tree):
    """Add a supernode to the ``count`` ones in ``homes`` unless it is there; returns how many there are then."""
    if tree.groups.mark[s]:
        return count
    tree.groups.mark[s] = 1
    homes[count] = s
    return count + 1


@njit(cache=True, error_model="numpy")
def _unmark(homes, count, tree):
    for k in range(count):
        tree.groups.mark[homes[k]] = 0


@njit(cache=True, error_model="numpy")
def _beyond(x, y, scale, node, share):
    far, turned = share * scale[node, 0], share * scale[node, 1]
    if abs(x[node, 0] - y[node, 0]) > far or abs(x[node, 1] - y[node, 1]) > far:
        return True
    return abs(x[node, 2] - y[node, 2]) > turned


@njit(cache=True, error_model="numpy")
def reevaluate(moved, count, nodes, edges, tree, robust, memory, homes, late):
    """Evaluate the edges of nodes that moved; returns how many supernodes (``homes``) and late edges there are."""
    kernel, width, gain = robust
    tree.counts[STAMP] += 1
    stamp, changed, old, bent = tree.counts[STAMP], 0, 0, (memory[CURVED_FROM], memory[EXACT_FROM])
    for k in range(count):
        for c in range(3):
            nodes.evaluated[moved[k], c] = nodes.x[moved[k], c]
    for k in range(count):
        node = moved[k]
        e = nodes.edges[node]
        while e >= 0:
            side = 0 if edges.ends[e, 0] == node else 1
            if edges.mark[e] != stamp:
                edges.mark[e] = stamp
                change, stale = evaluate(e, nodes, edges, kernel, width, gain, memory[LIMIT], bent)
                memory[COST] += change
                if stale:
                    late[old] = e
                    old += 1
                for end in range(2):
                    changed = _with_home(nodes.home[edges.ends[e, end]], homes, changed, tree)
            e = edges.next[e, side]
    _unmark(homes, changed, tree)
    return changed, old


@njit(cache=True, error_model="numpy")
def marginals(wanted, nodes, tree, work):
    """The joint covariance (3k, 3k) of k nodes in world axes, or of points in those that they have.

    With the unit vectors E of the nodes, it is Y' Y, L Y = E. The columns of Y are zero beside the paths from their nodes
    to the roots, so that they are solved forward on these only.
    """
    size = 3 * len(wanted)
    homes = np.empty(len(wanted), np.int32)
    for k in range(len(wanted)):
        homes[k] = nodes.home[wanted[k]]
    path, x, rows = upwards(homes, len(wanted), tree), tree.floats, 0
    for s in path:
        rows += 3 * tree.groups.w[s]
    Y, spare = np.zeros((size, rows)), tree.counts[FLOATS]
    for column in range(size):
        node, axis = wanted[column // 3], column % 3
        # a unit vector of the world in the axes of the node
        c, t = (1.0, 0.0) if nodes.point[node] else (nodes.axes[node, 0], nodes.axes[node, 1])
        if axis == 2:
            nodes.scratch[node, 2] = 1.0
        else:
            nodes.scratch[node, 0], nodes.scratch[node, 1] = (c, -t) if axis == 0 else (t, c)
        at, begun = 0, False
        for s in path:
            w, r = np.int64(tree.groups.w[s]), np.int64(tree.groups.r[s])
            front, begun = tree.groups.nodes_at[s], begun or s == nodes.home[node]
            some = False
            for q in range(w + r if begun else 0):
                inner = tree.ints[front + q]
                for k in range(3):
                    work[3 * q + k] = nodes.scratch[inner, k]
                    some = some or (q < w and nodes.scratch[inner, k] != 0.0)
            if some:
                ld, padded, _ = sizes(w, r)
                clear(work, 3 * (w + r), padded - 3 * r)
                _solve_forward(x, tree.groups.at[s], ld, 3 * w, work, spare)
                for q in range(3 * w):
                    Y[column, at + q] = x[spare + q]
                for q in range(w + r):
                    inner = tree.ints[front + q]
                    for k in range(3):
                        nodes.scratch[inner, k] = 0.0 if q < w else work[3 * q + k]
            at += 3 * w
    result = np.empty((size, size))
    for i in range(size):
        for j in range(i + 1):
            total = 0.0
            for q in range(rows):
                total += Y[i, q] * Y[j, q]
            result[i, j], result[j, i] = total, total
    return result


@njit(cache=True, error_model="numpy")
def total_cost(nodes, edges, count, kernel, width):
    """The cost at the estimate of those among the first ``count`` edges that were not taken out."""
    total = 0.0
    for e in range(count):
        if edges.ends[e, 0] >= 0:
            total += linearize(np.int32(e), nodes, edges, kernel, width)[5]
    return total
