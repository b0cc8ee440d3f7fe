# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,call-arg"
"""Register-blocked dense kernels on column-major panels inside flat float64 arrays.

A matrix is given as (array, place of its first number, step from column to column). A right factor has two steps: from
row to row and from column to column. All row counts are multiples of 4, which the padded leading dimensions guarantee,
so there are no scalar tails. Constants go in as ``np.int64(1)``: numba compiles a function again for every literal
argument.
"""

import numpy as np
from numba import njit

from .simd import (
    axpy4,
    axpy8,
    copy_vector,
    dot4,
    dot8,
    get,
    plus3,
    plus6,
    plus12,
    product_kernel,
    put,
    row_solve4,
    row_solve8,
)

PACK_ROWS, PACK_DEPTH = 240, 192  # a block of A in a third of a 1 MB second-level cache


def _column_kernel(columns, accumulate):
    """C = [C] - A B for ``columns`` columns and any multiple of 4 rows from i on, inlined into its caller."""
    by16, by8, by4 = (product_kernel(*shape, columns, accumulate) for shape in ((8, 2), (8, 1), (4, 1)))

    @njit(inline="always", error_model="numpy")
    def kernel(c, ic, ldc, a, ia, lda, b, ib, step_k, step_j, i, rows, depth):
        while i + 16 <= rows:
            by16(c, ic + i, ldc, a, ia + i, lda, b, ib, step_k, step_j, depth)
            i += 16
        if i + 8 <= rows:
            by8(c, ic + i, ldc, a, ia + i, lda, b, ib, step_k, step_j, depth)
            i += 8
        if i < rows:
            by4(c, ic + i, ldc, a, ia + i, lda, b, ib, step_k, step_j, depth)

    return kernel


_add6, _add3, _set6, _set3 = (_column_kernel(*kind) for kind in ((6, True), (3, True), (6, False), (3, False)))


@njit(cache=True, error_model="numpy")
def subtract_product(C, A, B, rows, columns, depth):
    """C -= A B for ``rows`` (multiple of 4) x ``columns`` (multiple of 3)."""
    (c, ic, ldc), (a, ia, lda), (b, ib, step_k, step_j) = C, A, B
    j = 0
    while j < columns:
        if columns - j >= 6:
            _add6(c, ic + j * ldc, ldc, a, ia, lda, b, ib + j * step_j, step_k, step_j, 0, rows, depth)
            j += 6
        else:
            _add3(c, ic + j * ldc, ldc, a, ia, lda, b, ib + j * step_j, step_k, step_j, 0, rows, depth)
            j += 3


@njit(cache=True, error_model="numpy")
def subtract_product_blocked(C, A, B, rows, columns, depth, lower):
    """``subtract_product`` for large operands; with ``lower`` only the rows from the diagonal on of a square C.

    A is copied block by block to where it stays in the second-level cache and spans few memory pages. In the
    ``lower`` case C starts up to three rows above its diagonal: ``lower - 1`` of them.
    """
    (c, ic, ldc), (a, ia, lda), (b, ib, step_k, step_j) = C, A, B
    if rows * depth <= 2 * PACK_ROWS * PACK_DEPTH:
        for j in range(0, columns, 6):
            i = max(0, j + lower - 1) & ~3 if lower else 0
            target, right = (c, ic + j * ldc + i, ldc), (b, ib + j * step_j, step_k, step_j)
            subtract_product(target, (a, ia + i, lda), right, rows - i, min(6, columns - j), depth)
        return
    pack = np.empty(PACK_ROWS * PACK_DEPTH + 8)
    packed = np.empty(6 * PACK_DEPTH)
    base = (8 - (pack.ctypes.data >> 3)) & 7  # a whole vector per cache line
    for k in range(0, depth, PACK_DEPTH):
        deep = min(PACK_DEPTH, depth - k)
        for i in range(0, rows, PACK_ROWS):
            high = min(PACK_ROWS, rows - i)
            for q in range(deep):
                copy_vector(pack, base + q * PACK_ROWS, a, ia + i + (k + q) * lda, high)
            for j in range(0, columns, 6):
                skip = (max(0, j + lower - 1 - i) & ~7) if lower else 0
                if skip >= high:
                    break
                few = min(6, columns - j)
                origin = ib + j * step_j + k * step_k
                for q in range(deep):
                    for t in range(few):
                        put(packed, 6 * q + t, get(b, origin + q * step_k + t * step_j))
                target, left = (c, ic + i + skip + j * ldc, ldc), (pack, base + skip, np.int64(PACK_ROWS))
                subtract_product(target, left, (packed, np.int64(0), np.int64(6), np.int64(1)), high - skip, few, deep)


@njit(cache=True, error_model="numpy")
def negative_gram(c, ic, ldc, a, ia, lda, rows, columns, depth):
    """Lower triangle of C = -A A' (C is overwritten, its strict upper triangle is scratch).

    ``rows`` is ``columns`` (multiple of 3) padded to a multiple of 4.
    """
    j = 0
    while j < columns:
        if columns - j >= 6:
            _set6(c, ic + j * ldc, ldc, a, ia, lda, a, ia + j, lda, 1, j & ~3, rows, depth)
            j += 6
        else:
            _set3(c, ic + j * ldc, ldc, a, ia, lda, a, ia + j, lda, 1, j & ~3, rows, depth)
            j += 3


@njit(cache=True, error_model="numpy")
def solve_rows(x, ix, ld, i0, l10, l20, i1, l21, i2, rows):
    """X L' = B in place for ``rows`` (multiple of 4) rows of three columns; i0, i1, i2 are inverse pivots."""
    i = 0
    while i + 8 <= rows:
        row_solve8(x, ix + i, ld, i0, l10, l20, i1, l21, i2)
        i += 8
    if i < rows:
        row_solve4(x, ix + i, ld, i0, l10, l20, i1, l21, i2)


@njit(cache=True, error_model="numpy")
def subtract_columns(y, iy, x, ix, ld, a0, a1, a2, rows):
    """y -= X (a0, a1, a2)' for ``rows`` (multiple of 4) rows."""
    i = 0
    while i + 8 <= rows:
        axpy8(y, iy + i, x, ix + i, ld, a0, a1, a2)
        i += 8
    if i < rows:
        axpy4(y, iy + i, x, ix + i, ld, a0, a1, a2)


@njit(cache=True, error_model="numpy")
def dot_columns(y, iy, x, ix, ld, rows):
    """X' y for ``rows`` (positive multiple of 4) rows of three columns."""
    if rows < 8:
        return dot4(y, iy, x, ix, ld, 1)
    s0, s1, s2 = dot8(y, iy, x, ix, ld, rows >> 3)
    if rows & 4:
        i = rows - 4
        t0, t1, t2 = dot4(y, iy + i, x, ix + i, ld, 1)
        return s0 + t0, s1 + t1, s2 + t2
    return s0, s1, s2


@njit(cache=True, error_model="numpy")
def add_blocks(c, ic, ldc, a, ia, lda, blocks):
    """C += A for three columns of 3 ``blocks`` rows."""
    while blocks >= 4:
        plus12(c, ic, ldc, a, ia, lda)
        ic += 12
        ia += 12
        blocks -= 4
    if blocks >= 2:
        plus6(c, ic, ldc, a, ia, lda)
        ic += 6
        ia += 6
        blocks -= 2
    if blocks > 0:
        plus3(c, ic, ldc, a, ia, lda)
