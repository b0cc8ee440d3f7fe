# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""Multifrontal supernodal Cholesky factorisation."""

import numpy as np
from numba import njit

from .kernels import add_blocks, negative_gram, solve_rows, subtract_product, subtract_product_blocked
from .simd import clear, get, put, put_block

INNER, OUTER = 48, 192  # columns of a wide panel factorised before the rest is updated at once


@njit(cache=True, error_model="numpy")
def _factor_columns(x, at, ld, rows, width, limits, pivot):
    """Left-looking Cholesky factorisation of ``width`` columns of ``rows`` rows with the diagonal block on top."""
    for j in range(0, width, 3):
        d0 = at + j * (ld + 1)
        d1 = d0 + ld
        d2 = d1 + ld
        if j > 0:
            # rows go by fours counted from the bottom, so the group on top may reach into the strict upper
            # triangle, which is scratch
            count = (rows - j + 3) & ~3
            top = rows - count
            left, right = (x, at + top, ld), (x, at + j, ld, np.int64(1))
            subtract_product((x, at + j * ld + top, ld), left, right, count, np.int64(3), j)
        # L D L' first: divisions, not square roots, on the critical path
        a00, a10, a20 = get(x, d0), get(x, d0 + 1), get(x, d0 + 2)
        a11, a21, a22 = get(x, d1 + 1), get(x, d1 + 2), get(x, d2 + 2)
        r0 = 1.0 / a00
        m10, m20 = a10 * r0, a20 * r0
        a11 -= m10 * a10
        a21 -= m20 * a10
        r1 = 1.0 / a11
        m21 = a21 * r1
        a22 -= m20 * a20 + m21 * a21
        good0 = a00 > get(limits, pivot + j)
        good1 = a11 > get(limits, pivot + j + 1)
        good2 = a22 > get(limits, pivot + j + 2)
        i0, i1, i2 = np.sqrt(r0), np.sqrt(r1), np.sqrt(1.0 / a22)
        l10, l20, l21 = a10 * i0, a20 * i0, a21 * i1
        count = (rows - j) & ~3  # rows - j - 3 rounded up
        if count > 0:
            solve_rows(x, at + j * ld + rows - count, ld, i0, l10, l20, i1, l21, i2, count)
        # written last, because the group of rows on top may have overwritten the diagonal block
        put(x, d0, i0)
        put(x, d0 + 1, l10)
        put(x, d0 + 2, l20)
        put(x, d1, 0.0)
        put(x, d1 + 1, i1)
        put(x, d1 + 2, l21)
        put(x, d2, 0.0)
        put(x, d2 + 1, 0.0)
        put(x, d2 + 2, i2)
        if not (good0 and good1 and good2):
            if not good0:
                return j
            return j + 1 if not good1 else j + 2
    return -1


@njit(cache=True, error_model="numpy")
def factor_panel(x, at, ld, width, limits, pivot):
    """Cholesky factorisation of a panel: ``width`` scalar columns of ``ld`` rows, diagonal block on top.

    The diagonal of L is stored inverted. ``limits[pivot + j]`` is the smallest acceptable pivot of column j. Returns
    the scalar column of the first bad pivot, or -1. Wide panels are taken in blocks of INNER columns, and in blocks
    of OUTER columns, for which the update of the rest is large enough to copy its operands.
    """
    for outer in range(0, width, OUTER):
        outer_stop = min(outer + OUTER, width)
        for inner in range(outer, outer_stop, INNER):
            stop = min(inner + INNER, outer_stop)
            bad = _factor_columns(x, at + inner * (ld + 1), ld, ld - inner, stop - inner, limits, pivot + inner)
            if bad >= 0:
                return inner + bad
            if stop < outer_stop:
                _update_rest(x, at, ld, inner, stop, outer_stop)
        if outer_stop < width:
            _update_rest(x, at, ld, outer, outer_stop, width)
    return -1


@njit(cache=True, error_model="numpy")
def _update_rest(x, at, ld, begin, stop, end):
    """Columns ``stop`` to ``end`` of a panel minus the product with the finished columns from ``begin`` on."""
    rows = (ld - stop + 3) & ~3
    top = ld - rows
    column = at + begin * ld
    left, right = (x, column + top, ld), (x, column + stop, ld, np.int64(1))
    target = (x, at + stop * ld + top, ld)
    subtract_product_blocked(target, left, right, rows, end - stop, stop - begin, stop - top + 1)


@njit(cache=True, error_model="numpy", nogil=True)
def factorize(values, layout, members, x, u, limits, run, tolerance, damping):
    """Numeric factorisation of the supernodes ``members`` into the panels ``x``; the scalar column of a bad pivot, or -1.

    Multifrontal (Duff & Reid 1983; Liu 1990): the columns of a front are assembled from the matrix and from the
    update matrices of the children, factorised, and the update matrix -L21 L21' plus the children's is passed on.
    Only the columns are needed before the factorisation, hence the update matrix is written first by the product
    and never zeroed. The diagonal of the matrix is multiplied by 1 + ``damping``. Members ascend, and the children of each
    are among the members before it, or done. Several threads may factorise subtrees at once, with a ``run`` each.
    """
    first, row_start, relative, stack_start = layout.first, layout.row_start, layout.relative, layout.stack_start
    child_start, children, panel_start = layout.child_start, layout.children, layout.panel_start
    entry_start, entry_source, entry_target = layout.entry_start, layout.entry_source, layout.entry_target
    for s in members:
        w = first[s + 1] - first[s]
        width = 3 * w
        r = 3 * (row_start[s + 1] - row_start[s])
        padded = (r + 3) & ~3
        ld = width + padded
        at = panel_start[s]
        clear(x, at, width * ld)
        for q in range(entry_start[s], entry_start[s + 1]):
            source = entry_source[q]
            t = at + entry_target[q]
            v = source >> 1
            if source & 1:
                for c in range(3):
                    for i in range(3):
                        put(x, t + c * ld + i, get(values, v + 3 * i + c))
            else:
                put_block(x, t, ld, values, v, 3)
        pivot = 3 * first[s]
        for j in range(width):
            t = at + j * (ld + 1)
            d = x[t] * (1.0 + damping)
            x[t] = d
            limits[pivot + j] = tolerance * d if d > 0.0 else 0.0
        for q in range(child_start[s], child_start[s + 1]):
            c = children[q]
            low, high = row_start[c], row_start[c + 1]
            split = low
            while split < high and relative[split] < w:
                split += 1
            _runs(relative, low, high, run)
            _extend(x, at, ld, np.int64(0), u, stack_start[c], relative, low, high, low, split, run)
        bad = factor_panel(x, at, ld, width, limits, pivot)
        if bad >= 0:
            return pivot + bad
        if r > 0:
            stack = stack_start[s]
            negative_gram(u, stack, padded, x, at + width, ld, padded, r, width)
            for q in range(child_start[s], child_start[s + 1]):
                c = children[q]
                low, high = row_start[c], row_start[c + 1]
                split = low
                while split < high and relative[split] < w:
                    split += 1
                if split < high:
                    _runs(relative, low, high, run)
                    _extend(u, stack, padded, w, u, stack_start[c], relative, low, high, split, high, run)
    return -1


@njit(cache=True, error_model="numpy")
def _runs(relative, low, high, run):
    """Ends of the runs of consecutive target rows: ``run[i]`` is one past the run that row low + i belongs to."""
    end = high
    for p in range(high - 1, low - 1, -1):
        if p + 1 < high and relative[p + 1] != relative[p] + 1:
            end = p + 1
        run[p - low] = end


@njit(cache=True, error_model="numpy")
def copy_out(f, size, u, child, relative, low, high, run):
    """The full symmetric part of a front f (size, size) over a child's rows, to the child's place on the stack."""
    _runs(relative, low, high, run)
    ldc = (3 * (high - low) + 3) & ~3
    for jb in range(low, high):
        source = 3 * relative[jb] * size
        target = child + 3 * (jb - low) * ldc
        for ib in range(low, high):
            put_block(u, target, ldc, f, source + 3 * relative[ib], size)
            target += 3


@njit(cache=True, error_model="numpy")
def _extend(target, start, ld, skip, u, child, relative, low, high, from_row, to_row, run):
    """Add columns ``from_row`` to ``to_row`` of a child's update matrix to a panel or update matrix.

    ``skip`` is the number of nodes in front of the target's first column and, in an update matrix, first row.
    """
    ldc = (3 * (high - low) + 3) & ~3
    for jb in range(from_row, to_row):
        source = child + 3 * (jb - low) * (ldc + 1) - 3 * jb
        column = start + 3 * (relative[jb] - skip) * ld - 3 * skip
        ib = jb
        while ib < high:
            end = run[ib - low]
            add_blocks(target, column + 3 * relative[ib], ld, u, source + 3 * ib, ldc, end - ib)
            ib = end
