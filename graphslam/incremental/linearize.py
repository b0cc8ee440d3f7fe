# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""Single edges of an online solution: their values at the estimate, and when their part of the factor is out of date.

Increments d of poses are in their own axes, those of points in the world's. Then the information of an edge is constant
in the axes of its first end, and Omega stays as it is when poses move and turn together. The Jacobians there are

    B_i = -[I, u; 0, 1],  u the lever, and B_j = blkdiag(R(alpha), 1), alpha = theta_j - theta_i, or -theta_i for a point.

The factor holds every edge with the lever, alpha and robust weight of the last time at which its part of the tree was
factorised. The right-hand side is kept up to date: with the sum d of all increments of both ends,

    rhs_e = -B(x)' W e(x) + B' W B d,

so that Omega d = rhs is the condition for an optimum at x, whatever B is in Omega. If it is near B(x), iterating
converges fast. `evaluate` compares them.

Gauss-Newton leaves out the second derivatives of the residual. Where residuals are as large as levers, the curvature of J
can be more than twice B' W B, and Gauss-Newton then diverges from the minimum itself. So an edge with a cost above
`CURVED` has them in the factor, and all edges where the passes show that many small residuals do the same. With g = W e,
increments (a, phi) of the first end, b of the second and q = R(alpha) b,

    J/2 has the further terms  phi h' (q - a) + gamma phi^2 / 2,   h = (-g_y, g_x),  gamma = -g' (lever).

They may make Omega indefinite. So an edge that is indefinite by itself has gamma only, and only if that is positive, unless
its cost is above `EXACT`: next to a minimum, passes converge faster with all of them.
"""

import numpy as np
from numba import njit

from . import kernels
from .kernels import loss, weight

#: how far the factor's part of an edge may be from the present one: weights by a third, and lever and alpha so far that an
#: increment of one standard deviation (`Nodes.scale`) changes the residual, squared and in its own standard deviations, by
#: this much. Poses tied by a stiff edge move together, so that a change of the lever relative to itself says nothing.
#: `advance` lowers the second limit where the passes converge slowly, because the changes of many edges add up.
REWEIGHTED, CHANGED = 0.33, 0.1

#: the cost from which the second derivatives of an edge enter the factor, and that from which they stay as they are, although
#: the edge may be indefinite; `advance` changes both
CURVED, EXACT = 4.0, 4.0


@njit(cache=True, error_model="numpy")
def linearize(e, nodes, edges, kernel, width):
    """Of an edge at the estimate: lever u, cos and sin of alpha, the weight, w W e, and the cost."""
    i, j = edges.ends[e, 0], edges.ends[e, 1]
    c, s = nodes.axes[i, 0], nodes.axes[i, 1]
    dx, dy = nodes.x[j, 0] - nodes.x[i, 0], nodes.x[j, 1] - nodes.x[i, 1]
    ahead, left = c * dx + s * dy, c * dy - s * dx
    turn = 0.0
    if edges.rows[e] == 3:
        turn = nodes.x[j, 2] - nodes.x[i, 2] - edges.measured[e, 2]
        if abs(turn) > np.pi:
            turn = kernels.wrap(turn)
        p, q = nodes.axes[j, 0], nodes.axes[j, 1]
        c, s = c * p + s * q, c * q - s * p
    else:
        s = -s
    residual = (ahead - edges.measured[e, 0], left - edges.measured[e, 1], turn)
    g = kernels.product(kernels.row(edges.information, e), residual)
    cost = kernels.dot(g, residual)
    factor = 1.0
    if edges.robust[e]:
        factor = weight(kernel, width, cost)
        g = (factor * g[0], factor * g[1], factor * g[2])
        cost = loss(kernel, width, cost)
    return (-left, ahead), c, s, factor, g, cost


@njit(cache=True, error_model="numpy")
def information(e, edges, gain):
    """W of an edge with its weight in the factor; with a kernel times ``gain`` (`Kernel.information_per_weight`)."""
    W = kernels.row(edges.information, e)
    # the weight is zero before the edge is in the factor
    return kernels.scaled(edges.weight[e] * (gain if edges.robust[e] else 1.0), W)


@njit(cache=True, error_model="numpy")
def _curvature(e, edges, u, g, cost, bent):
    """The second derivatives (gamma, h) of the residual times W e of an edge; ``bent`` are the costs `CURVED` and `EXACT`."""
    if cost < bent[0] or edges.robust[e]:
        return 0.0, 0.0, 0.0
    W, gamma = kernels.row(edges.information, e), u[0] * g[1] - u[1] * g[0]
    a, b, c = W[0], W[1], W[2]
    if edges.rows[e] == 3:
        a, b, c = a - W[3] * W[3] / W[5], b - W[3] * W[4] / W[5], c - W[4] * W[4] / W[5]
    # along the direction in which its residual does not change, the edge adds gamma + 2 h' u - h' P h, P its covariance
    least = (a * g[0] * g[0] + 2 * b * g[0] * g[1] + c * g[1] * g[1]) / (a * c - b * b)
    if least + gamma > 0.0 and cost < bent[1]:
        return max(gamma, 0.0), 0.0, 0.0
    return gamma, -g[1], g[0]


@njit(cache=True, error_model="numpy")
def _store(e, nodes, edges, gain, u, c, s, g, cost):
    """Put the gradients of an edge plus Omega_e d into the right-hand sides of its ends; returns the change of its cost."""
    i, j = edges.ends[e, 0], edges.ends[e, 1]
    v, w, cos, sin = edges.linear[e, 0], edges.linear[e, 1], edges.linear[e, 2], edges.linear[e, 3]
    gamma, x, y = edges.linear[e, 4], edges.linear[e, 5], edges.linear[e, 6]
    b0, b1, phi = nodes.d[j, 0], nodes.d[j, 1], nodes.d[i, 2]
    turn = nodes.d[j, 2] - phi if edges.rows[e] == 3 else 0.0
    apart = (cos * b0 - sin * b1 - nodes.d[i, 0], sin * b0 + cos * b1 - nodes.d[i, 1])
    p = kernels.product(information(e, edges, gain), (apart[0] - v * phi, apart[1] - w * phi, turn))
    q = (p[0] + x * phi, p[1] + y * phi)
    bent = gamma * phi + x * apart[0] + y * apart[1]
    new = (
        g[0] - q[0],
        g[1] - q[1],
        u[0] * g[0] + u[1] * g[1] + g[2] - v * p[0] - w * p[1] - p[2] + bent,
        cos * q[0] + sin * q[1] - c * g[0] - s * g[1],
        cos * q[1] - sin * q[0] - c * g[1] + s * g[0],
        p[2] - g[2],
    )
    for k in range(3):
        nodes.rhs[i, k] += new[k] - edges.rhs[e, k]
        nodes.rhs[j, k] += new[3 + k] - edges.rhs[e, 3 + k]
        edges.rhs[e, k], edges.rhs[e, 3 + k] = new[k], new[3 + k]
    change = cost - edges.cost[e]
    edges.cost[e] = cost
    return change


@njit(cache=True, error_model="numpy")
def diagonals(e, edges, gain):
    """The edge's part of the diagonal blocks of Omega of both ends, as it is in the factor, packed."""
    W, u, v = information(e, edges, gain), edges.linear[e, 0], edges.linear[e, 1]
    a = kernels.product(W, (u, v, 1.0))
    gamma, x, y = edges.linear[e, 4], edges.linear[e, 5], edges.linear[e, 6]
    own = (W[0], W[1], W[2], a[0] - x, a[1] - y, u * a[0] + v * a[1] + a[2] + gamma)
    return own, kernels.turned(edges.linear[e, 2], -edges.linear[e, 3], W)


@njit(cache=True, error_model="numpy")
def _add_diagonal(e, nodes, edges, gain, sign):
    own, other = diagonals(e, edges, gain)
    i, j = edges.ends[e, 0], edges.ends[e, 1]
    for c in range(6):
        nodes.diagonal[i, c] += sign * own[c]
        nodes.diagonal[j, c] += sign * other[c]


@njit(cache=True, error_model="numpy")
def relinearize(e, nodes, edges, kernel, width, gain, bent):
    """Take lever, alpha, weight and second derivatives from the estimate; returns the change of the cost."""
    u, c, s, factor, g, cost = linearize(e, nodes, edges, kernel, width)
    _add_diagonal(e, nodes, edges, gain, -1.0)
    edges.weight[e] = factor
    edges.linear[e, 0], edges.linear[e, 1] = u
    edges.linear[e, 2], edges.linear[e, 3] = c, s
    edges.linear[e, 4], edges.linear[e, 5], edges.linear[e, 6] = _curvature(e, edges, u, g, cost, bent)
    _add_diagonal(e, nodes, edges, gain, 1.0)
    return _store(e, nodes, edges, gain, u, c, s, g, cost)


@njit(cache=True, error_model="numpy")
def between(e, edges, gain):
    """The block of Omega between the ends of an edge, B_i' W B_j, row by row."""
    W, u, v = information(e, edges, gain), edges.linear[e, 0], edges.linear[e, 1]
    c, s = edges.linear[e, 2], edges.linear[e, 3]
    a = kernels.product(W, (u, v, 1.0))
    x, y = a[0] - edges.linear[e, 5], a[1] - edges.linear[e, 6]
    return (
        (-(W[0] * c + W[1] * s), W[0] * s - W[1] * c, -W[3]),
        (-(W[1] * c + W[2] * s), W[1] * s - W[2] * c, -W[4]),
        (-(x * c + y * s), x * s - y * c, -a[2]),
    )


@njit(cache=True, error_model="numpy")
def outdated(e, nodes, edges, u, c, s, factor, limit):
    """Whether weight, lever or alpha of an edge are farther from those in the factor than ``limit``; see `CHANGED`."""
    if edges.robust[e] and abs(factor - edges.weight[e]) > min(REWEIGHTED, 3 * limit) * edges.weight[e] + 0.01:
        return True
    W, size = kernels.row(edges.information, e), nodes.scale[edges.ends[e, 0], 1]
    turned = nodes.scale[edges.ends[e, 1], 0] * (s * edges.linear[e, 2] - c * edges.linear[e, 3])
    a, b = size * (u[0] - edges.linear[e, 0]), size * (u[1] - edges.linear[e, 1])
    return W[0] * a * a + 2 * W[1] * a * b + W[2] * b * b + (W[0] + W[2]) * turned * turned > limit


@njit(cache=True, error_model="numpy")
def not_gauss_newton(nodes, edges, count, kernel, width, limit):
    """Those of the first ``count`` edges that have second derivatives in the factor, or are `outdated`."""
    found, size = np.empty(count, np.int32), 0
    for k in range(count):
        e = np.int32(k)
        if edges.ends[e, 0] < 0:
            continue
        late = edges.linear[e, 4] != 0.0 or edges.linear[e, 5] != 0.0 or edges.linear[e, 6] != 0.0
        if not late:
            u, c, s, factor, _, _ = linearize(e, nodes, edges, kernel, width)
            late = outdated(e, nodes, edges, u, c, s, factor, limit)
        if late:
            found[size] = e
            size += 1
    return found[:size].copy()


@njit(cache=True, error_model="numpy")
def evaluate(e, nodes, edges, kernel, width, gain, limit, bent):
    """Bring the right-hand side of an edge up to date.

    Returns the change of its cost, and whether its part of the factor is too old.
    """
    u, c, s, factor, g, cost = linearize(e, nodes, edges, kernel, width)
    change = _store(e, nodes, edges, gain, u, c, s, g, cost)
    if outdated(e, nodes, edges, u, c, s, factor, limit):
        return change, True
    W, size = kernels.row(edges.information, e), nodes.scale[edges.ends[e, 0], 1]
    gamma, x, y = _curvature(e, edges, u, g, cost, bent)
    away = abs(x - edges.linear[e, 5]) + abs(y - edges.linear[e, 6])
    bent = abs(gamma - edges.linear[e, 4]) * size + 2 * away / np.sqrt(W[0] + W[2])
    return change, (size * bent) ** 2 > limit
