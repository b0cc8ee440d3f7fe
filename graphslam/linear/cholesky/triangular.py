# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""Triangular solves with a supernodal factor."""

from numba import njit

from .kernels import dot_columns, subtract_columns
from .simd import add_triple, clear, get, put, put_triple


@njit(cache=True, error_model="numpy")
def forward(first, row_start, rows, panel_start, x, b, work):
    """Solve L y = b in place, b (3n,) in elimination order; ``work`` has room for the tallest front."""
    for s in range(first.size - 1):
        width = 3 * (first[s + 1] - first[s])
        low, high = row_start[s], row_start[s + 1]
        ld = width + ((3 * (high - low) + 3) & ~3)
        at = panel_start[s]
        head = 3 * first[s]
        for i in range(0, width, 3):
            put_triple(work, i, b, head + i)
        clear(work, width, ld - width)
        for j in range(0, width, 3):
            p0 = at + j * (ld + 1)
            p1 = p0 + ld
            p2 = p1 + ld
            y0 = get(work, j) * get(x, p0)
            y1 = (get(work, j + 1) - get(x, p0 + 1) * y0) * get(x, p1 + 1)
            y2 = (get(work, j + 2) - get(x, p0 + 2) * y0 - get(x, p1 + 2) * y1) * get(x, p2 + 2)
            put(b, head + j, y0)
            put(b, head + j + 1, y1)
            put(b, head + j + 2, y2)
            count = (ld - j) & ~3  # ld - j - 3 rounded up
            if count > 0:
                subtract_columns(work, ld - count, x, at + j * ld + ld - count, ld, y0, y1, y2, count)
        i = width
        for q in range(low, high):
            t = 3 * rows[q]
            add_triple(b, t, work, i)
            i += 3


@njit(cache=True, error_model="numpy")
def backward(first, row_start, rows, panel_start, x, b, work):
    """Solve L' y = b in place; the arguments are those of `forward`."""
    for s in range(first.size - 2, -1, -1):
        width = 3 * (first[s + 1] - first[s])
        low, high = row_start[s], row_start[s + 1]
        ld = width + ((3 * (high - low) + 3) & ~3)
        at = panel_start[s]
        head = 3 * first[s]
        # rows that are not known yet are zero, so that the scratch above the diagonal does not enter the sums
        clear(work, 0, ld)
        i = width
        for q in range(low, high):
            t = 3 * rows[q]
            put_triple(work, i, b, t)
            i += 3
        for j in range(width - 3, -1, -3):
            p0 = at + j * (ld + 1)
            p1 = p0 + ld
            p2 = p1 + ld
            y0, y1, y2 = get(b, head + j), get(b, head + j + 1), get(b, head + j + 2)
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
            put_triple(b, head + j, work, j)


@njit(cache=True, error_model="numpy")
def solve(order, first, row_start, rows, panel_start, x, rhs, out, b, work):
    """Solve Omega out = rhs, (3n,) in node order; returns whether rhs is finite. ``b`` (3n,) and ``work`` are scratch."""
    zero = 0.0
    for k in range(order.size):
        i = 3 * order[k]
        put_triple(b, 3 * k, rhs, i)
        # NaN for what is not finite
        zero += 0.0 * get(rhs, i) + 0.0 * get(rhs, i + 1) + 0.0 * get(rhs, i + 2)
    if zero != 0.0:
        return False
    forward(first, row_start, rows, panel_start, x, b, work)
    backward(first, row_start, rows, panel_start, x, b, work)
    for k in range(order.size):
        i = 3 * order[k]
        put_triple(out, i, b, 3 * k)
    return True
