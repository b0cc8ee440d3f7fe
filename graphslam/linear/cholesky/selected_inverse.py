# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""Selected inversion: the blocks of Omega^-1 on the pattern of L."""

import numpy as np
from numba import njit

from .kernels import solve_rows, subtract_product, subtract_product_blocked
from .simd import clear, copy_vector, get, put
from .supernodal import copy_out

NARROW = 12  # scalar columns up to which three at a time are faster than a block
BLOCK = 48


@njit(cache=True, error_model="numpy")
def _invert_block(x, at, ld, begin, stop, end, size, f, y):
    """Inverse over the rows ``begin`` to ``end`` into the front f, given the inverse over ``stop`` to ``end``.

    From the last three columns to the first, with Y = L21 L11^-1 for three columns 1 and the rows 2 below them up to
    ``end``: Z21 = -Z22 Y and Z11 = (L11 L11')^-1 - Y' Z21.
    """
    for j in range(stop - 3, begin - 1, -3):
        d0 = at + j * (ld + 1)
        d1 = d0 + ld
        i0, l10, l20 = get(x, d0), get(x, d0 + 1), get(x, d0 + 2)
        i1, l21, i2 = get(x, d1 + 1), get(x, d1 + 2), get(x, d1 + ld + 2)
        below = j + 3
        c0 = j * size
        c1 = c0 + size
        c2 = c1 + size
        rows = (end - below + 3) & ~3
        if rows > 0:
            # the group of rows on top may reach into the diagonal block, which is written last
            top = end - rows
            for c in range(3):
                copy_vector(y, c * size + below, x, at + (j + c) * ld + below, end - below)
            # X L11 = L21 is the row solve with its columns and coefficients in reverse order
            solve_rows(y, 2 * size + top, -size, i2, l21, l20, i1, l10, i0, rows)
            for c in range(3):
                clear(f, c0 + c * size + top, rows)
            left, right = (f, below * size + top, size), (y, below, np.int64(1), size)
            subtract_product((f, c0 + top, size), left, right, rows, np.int64(3), end - below)
        n10 = -l10 * i0 * i1
        n21 = -l21 * i1 * i2
        n20 = -(l20 * i0 + l21 * n10) * i2
        z00 = i0 * i0 + n10 * n10 + n20 * n20
        z10 = i1 * n10 + n21 * n20
        z20 = i2 * n20
        z11 = i1 * i1 + n21 * n21
        z21 = i2 * n21
        z22 = i2 * i2
        for i in range(below, end):
            f0, f1, f2 = get(f, c0 + i), get(f, c1 + i), get(f, c2 + i)
            y0, y1, y2 = get(y, i), get(y, size + i), get(y, 2 * size + i)
            z00 -= y0 * f0
            z10 -= y1 * f0
            z20 -= y2 * f0
            z11 -= y1 * f1
            z21 -= y2 * f1
            z22 -= y2 * f2
            put(f, i * size + j, f0)
            put(f, i * size + j + 1, f1)
            put(f, i * size + j + 2, f2)
        put(f, c0 + j, z00)
        put(f, c0 + j + 1, z10)
        put(f, c0 + j + 2, z20)
        put(f, c1 + j, z10)
        put(f, c1 + j + 1, z11)
        put(f, c1 + j + 2, z21)
        put(f, c2 + j, z20)
        put(f, c2 + j + 1, z21)
        put(f, c2 + j + 2, z22)


@njit(cache=True, error_model="numpy")
def _extend_block(x, at, ld, begin, end, size, f, y, transposed, gram):
    """Rows below ``end`` of columns ``begin`` to ``end``, and their share in the diagonal block."""
    rows = (size - end + 3) & ~3
    top = size - rows
    deep = size - end
    k = end - begin
    for j in range(k - 3, -1, -3):
        d0 = at + (begin + j) * (ld + 1)
        d1 = d0 + ld
        for c in range(3):
            copy_vector(y, (j + c) * size + end, x, at + (begin + j + c) * ld + end, deep)
        if j + 3 < k:
            left, right = (y, (j + 3) * size + top, size), (x, d0 + 3, np.int64(1), ld)
            subtract_product((y, j * size + top, size), left, right, rows, np.int64(3), k - j - 3)
        i0, l10, l20 = get(x, d0), get(x, d0 + 1), get(x, d0 + 2)
        i1, l21, i2 = get(x, d1 + 1), get(x, d1 + 2), get(x, d1 + ld + 2)
        solve_rows(y, (j + 2) * size + top, -size, i2, l21, l20, i1, l10, i0, rows)
    # the rows above ``end`` that a group of four reaches into belong to the diagonal block: save them
    spill = end - top
    for j in range(k):
        copy_vector(gram, j * 4, f, (begin + j) * size + top, spill)
        clear(f, (begin + j) * size + top, rows)
    left, right = (f, end * size + top, size), (y, end, np.int64(1), size)
    subtract_product_blocked((f, begin * size + top, size), left, right, rows, k, deep, np.int64(0))
    for j in range(k):
        copy_vector(f, (begin + j) * size + top, gram, j * 4, spill)
    padded = (k + 3) & ~3
    for j in range(k):
        for i in range(end, size):
            put(transposed, (i - end) * padded + j, get(y, j * size + i))
            put(f, i * size + begin + j, get(f, (begin + j) * size + i))
    clear(gram, 0, k * padded)
    left, right = (transposed, np.int64(0), padded), (f, begin * size + end, np.int64(1), size)
    subtract_product((gram, np.int64(0), padded), left, right, padded, k, deep)
    for j in range(k):
        for i in range(k):
            p = (begin + j) * size + begin + i
            put(f, p, get(f, p) + get(gram, j * padded + i))


@njit(cache=True, error_model="numpy")
def _front(x, at, ld, width, r, f, y, transposed, gram):
    """Inverse of a front: columns of the supernode, given the inverse over the rows below in f[width:, width:].

    Takahashi, Fagan & Chen (1973) by blocks of columns J with all rows R below them, from the last block to the
    first: with Y = L_RJ L_JJ^-1, Z_RJ = -Z_RR Y and Z_JJ = (L_JJ L_JJ')^-1 - Y' Z_RJ.
    """
    size = width + r
    if width <= NARROW:
        _invert_block(x, at, ld, np.int64(0), width, size, size, f, y)
        return
    for begin in range((width - 1) // BLOCK * BLOCK, -1, -BLOCK):
        end = min(begin + BLOCK, width)
        _invert_block(x, at, ld, begin, end, end, size, f, y)
        if end < size:
            _extend_block(x, at, ld, begin, end, size, f, y, transposed, gram)


@njit(cache=True, error_model="numpy")
def selected_inverse(layout, x, z, u, run, f, y, transposed, gram, diagonal):
    """Panels ``z`` of Omega^-1 (diagonal blocks full), and its diagonal blocks (n, 3, 3) in node order.

    The factorisation run backwards: a supernode takes the inverse over its rows from the stack, extends it by its
    own columns and writes the part of each child to the place where the update matrix of that child was.
    """
    order, first, row_start, relative = layout.order, layout.first, layout.row_start, layout.relative
    child_start, children, stack_start = layout.child_start, layout.children, layout.stack_start
    panel_start = layout.panel_start
    for s in range(first.size - 2, -1, -1):
        w = first[s + 1] - first[s]
        width = 3 * w
        r = 3 * (row_start[s + 1] - row_start[s])
        padded = (r + 3) & ~3
        ld = width + padded
        size = width + r
        at = panel_start[s]
        for j in range(r):
            source = stack_start[s] + j * padded
            target = (width + j) * size + width
            for i in range(r):
                put(f, target + i, get(u, source + i))
        _front(x, at, ld, width, r, f, y, transposed, gram)
        for j in range(width):
            for i in range(size):
                put(z, at + j * ld + i, get(f, j * size + i))
        for k in range(w):
            node = order[first[s] + k]
            for c in range(3):
                for i in range(3):
                    diagonal[node, i, c] = get(f, (3 * k + c) * size + 3 * k + i)
        for q in range(child_start[s], child_start[s + 1]):
            c = children[q]
            copy_out(f, size, u, stack_start[c], relative, row_start[c], row_start[c + 1], run)


@njit(cache=True, error_model="numpy")
def stored_block(i, j, layout, z, block):
    """Block (i, j) of the selected inverse into ``block`` (3, 3), i eliminated after j; False outside the pattern of L."""
    first, row_start, rows = layout.first, layout.row_start, layout.rows
    column, row = layout.position[j], layout.position[i]
    s = np.searchsorted(first, column, side="right") - 1
    w = first[s + 1] - first[s]
    low, high = row_start[s], row_start[s + 1]
    if row < first[s + 1]:
        local = row - first[s]
    else:
        local = np.searchsorted(rows[low:high], row)
        if local == high - low or rows[low + local] != row:
            return False
        local += w
    ld = 3 * w + ((3 * (high - low) + 3) & ~3)
    at = layout.panel_start[s] + 3 * (column - first[s]) * ld + 3 * local
    for c in range(3):
        for k in range(3):
            block[k, c] = z[at + c * ld + k]
    return True


@njit(cache=True, error_model="numpy")
def stored_pairs(first, second, layout, z, out):
    """The blocks of pairs of nodes (E,) into ``out`` (E, 3, 3); False where one is outside the pattern of L."""
    block = np.empty((3, 3))
    for e in range(first.size):
        turned = layout.position[first[e]] < layout.position[second[e]]
        i, j = (second[e], first[e]) if turned else (first[e], second[e])
        if not stored_block(i, j, layout, z, block):
            return False
        out[e] = block.T if turned else block
    return True


@njit(cache=True, error_model="numpy")
def stored_blocks(nodes, layout, z, out):
    """The blocks between all pairs of nodes (k,) into ``out`` (k, 3, k, 3); False where one is outside the pattern of L."""
    block = np.empty((3, 3))
    for a in range(nodes.size):
        for b in range(nodes.size):
            if layout.position[nodes[a]] < layout.position[nodes[b]]:
                continue
            if not stored_block(nodes[a], nodes[b], layout, z, block):
                return False
            for r in range(3):
                for c in range(3):
                    out[a, r, b, c] = block[r, c]
                    out[b, c, a, r] = block[r, c]
    return True
