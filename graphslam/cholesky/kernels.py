"""Register-blocked dense kernels on column-major scalar panels.

The kernels are emitted as LLVM vector code through ``numba.extending.intrinsic``: the loop vectoriser gives up on
the plain Python loops because it cannot prove that the 3 to 6 target columns do not overlap (no ``restrict`` in
numba). Vectors of 8 doubles are legal everywhere: LLVM splits them where the registers are narrower. All row counts
are multiples of 4, which the padded leading dimensions guarantee, so there are no scalar tails.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

_F64 = ir.DoubleType()
_I64 = ir.IntType(64)
_CONTRACT = ("contract",)
PACK_ROWS, PACK_DEPTH = 240, 192  # a block of A in half of a 1 MB second-level cache


def _data(context: Any, builder: Any, array_type: Any, value: Any) -> Any:
    """Pointer to the first scalar of a one-dimensional float64 array."""
    return context.make_array(array_type)(context, builder, value).data


def _broadcast(builder: Any, scalar: Any, lanes: int) -> Any:
    vector = ir.VectorType(_F64, lanes)
    one = builder.insert_element(ir.Constant(vector, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes)
    return builder.shuffle_vector(one, ir.Constant(vector, ir.Undefined), zeros)


def _load(builder: Any, base: Any, index: Any, lanes: int) -> Any:
    pointer = builder.bitcast(builder.gep(base, [index]), ir.VectorType(_F64, lanes).as_pointer())
    return builder.load(pointer, align=8)


def _store(builder: Any, vector: Any, base: Any, index: Any) -> None:
    builder.store(vector, builder.bitcast(builder.gep(base, [index]), vector.type.as_pointer()), align=8)


def _product_kernel(lanes: int, vectors: int, columns: int, accumulate: bool) -> Callable[..., None]:
    """C (lanes*vectors, columns) = [C] - A B with A's rows contiguous and B of strides ``(step_k, step_j)``."""

    @intrinsic  # type: ignore[untyped-decorator]
    def kernel(typingctx, c, ic, ldc, a, ia, lda, b, ib, step_k, step_j, depth):  # type: ignore[no-untyped-def]
        signature = types.void(c, types.int64, types.int64, a, types.int64, types.int64, b, *[types.int64] * 4)

        def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
            vector = ir.VectorType(_F64, lanes)
            zero = ir.Constant(vector, [0.0] * lanes)
            _, ic, ldc, _, ia, lda, _, ib, step_k, step_j, depth = args
            cp, ap, bp = (_data(context, builder, sig.args[k], args[k]) for k in (0, 3, 6))
            rows = [ir.Constant(_I64, lanes * v) for v in range(vectors)]
            c_at = [builder.add(ic, builder.mul(ldc, ir.Constant(_I64, j))) for j in range(columns)]
            b_step = [builder.mul(step_j, ir.Constant(_I64, j)) for j in range(columns)]
            start = [
                _load(builder, cp, builder.add(c_at[j], rows[v]), lanes) if accumulate else zero
                for j in range(columns)
                for v in range(vectors)
            ]
            entry = builder.block
            loop = builder.append_basic_block("depth")
            leave = builder.append_basic_block("done")
            builder.cbranch(builder.icmp_signed(">", depth, ir.Constant(_I64, 0)), loop, leave)
            builder.position_at_end(loop)
            k, a_at, b_at = (builder.phi(_I64) for _ in range(3))
            sums = [builder.phi(vector) for _ in start]
            left = [_load(builder, ap, builder.add(a_at, rows[v]), lanes) for v in range(vectors)]
            ends = []
            for j in range(columns):
                right = _broadcast(builder, builder.load(builder.gep(bp, [builder.add(b_at, b_step[j])])), lanes)
                for v in range(vectors):
                    product = builder.fmul(left[v], right, flags=_CONTRACT)
                    ends.append(builder.fsub(sums[j * vectors + v], product, flags=_CONTRACT))
            k_next = builder.add(k, ir.Constant(_I64, 1))
            a_next, b_next = builder.add(a_at, lda), builder.add(b_at, step_k)
            builder.cbranch(builder.icmp_signed("<", k_next, depth), loop, leave)
            for phi, first, later in [
                (k, ir.Constant(_I64, 0), k_next),
                (a_at, ia, a_next),
                (b_at, ib, b_next),
                *zip(sums, start, ends, strict=True),
            ]:
                phi.add_incoming(first, entry)
                phi.add_incoming(later, loop)
            builder.position_at_end(leave)
            for j in range(columns):
                for v in range(vectors):
                    total = builder.phi(vector)
                    total.add_incoming(start[j * vectors + v], entry)
                    total.add_incoming(ends[j * vectors + v], loop)
                    ends[j * vectors + v] = total
            for j in range(columns):
                for v in range(vectors):
                    _store(builder, ends[j * vectors + v], cp, builder.add(c_at[j], rows[v]))
            return context.get_dummy_value()

        return signature, codegen

    return kernel  # type: ignore[no-any-return]


_add16x6 = _product_kernel(8, 2, 6, True)
_add8x6 = _product_kernel(8, 1, 6, True)
_add4x6 = _product_kernel(4, 1, 6, True)
_add16x3 = _product_kernel(8, 2, 3, True)
_add8x3 = _product_kernel(8, 1, 3, True)
_add4x3 = _product_kernel(4, 1, 3, True)
_set16x6 = _product_kernel(8, 2, 6, False)
_set8x6 = _product_kernel(8, 1, 6, False)
_set4x6 = _product_kernel(4, 1, 6, False)
_set16x3 = _product_kernel(8, 2, 3, False)
_set8x3 = _product_kernel(8, 1, 3, False)
_set4x3 = _product_kernel(4, 1, 3, False)


@njit(cache=True, error_model="numpy")
def subtract_product(c, ic, ldc, a, ia, lda, b, ib, step_k, step_j, rows, columns, depth):
    """C -= A B for ``rows`` (multiple of 4) x ``columns`` (multiple of 3), all inside flat arrays."""
    j = 0
    while j < columns:
        wide = columns - j >= 6
        cj = ic + j * ldc
        bj = ib + j * step_j
        i = 0
        if wide:
            while i + 16 <= rows:
                _add16x6(c, cj + i, ldc, a, ia + i, lda, b, bj, step_k, step_j, depth)
                i += 16
            if i + 8 <= rows:
                _add8x6(c, cj + i, ldc, a, ia + i, lda, b, bj, step_k, step_j, depth)
                i += 8
            if i < rows:
                _add4x6(c, cj + i, ldc, a, ia + i, lda, b, bj, step_k, step_j, depth)
            j += 6
        else:
            while i + 16 <= rows:
                _add16x3(c, cj + i, ldc, a, ia + i, lda, b, bj, step_k, step_j, depth)
                i += 16
            if i + 8 <= rows:
                _add8x3(c, cj + i, ldc, a, ia + i, lda, b, bj, step_k, step_j, depth)
                i += 8
            if i < rows:
                _add4x3(c, cj + i, ldc, a, ia + i, lda, b, bj, step_k, step_j, depth)
            j += 3


@njit(cache=True, error_model="numpy")
def subtract_product_blocked(c, ic, ldc, a, ia, lda, b, ib, step_k, step_j, rows, columns, depth, lower):
    """``subtract_product`` for large operands; with ``lower`` only the rows from the diagonal on of a square C.

    A is copied block by block to where it stays in the second-level cache and spans few memory pages. In the
    ``lower`` case C starts up to three rows above its diagonal: ``lower - 1`` of them.
    """
    if rows * depth <= 2 * PACK_ROWS * PACK_DEPTH:
        for j in range(0, columns, 6):
            i = max(0, j + lower - 1) & ~3 if lower else 0
            subtract_product(
                c,
                ic + j * ldc + i,
                ldc,
                a,
                ia + i,
                lda,
                b,
                ib + j * step_j,
                step_k,
                step_j,
                rows - i,
                min(6, columns - j),
                depth,
            )
        return
    pack = np.empty(PACK_ROWS * PACK_DEPTH + 8)
    right = np.empty(6 * PACK_DEPTH)
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
                        put(right, 6 * q + t, get(b, origin + q * step_k + t * step_j))
                subtract_product(
                    c,
                    ic + i + skip + j * ldc,
                    ldc,
                    pack,
                    base + skip,
                    PACK_ROWS,
                    right,
                    0,
                    6,
                    1,
                    high - skip,
                    few,
                    deep,
                )


@njit(cache=True, error_model="numpy")
def negative_gram(c, ic, ldc, a, ia, lda, rows, columns, depth):
    """Lower triangle of C = -A A' (what stood in C is overwritten, its strict upper triangle is scratch).

    ``rows`` is ``columns`` (multiple of 3) padded to a multiple of 4.
    """
    j = 0
    while j < columns:
        cj = ic + j * ldc
        i = j & ~3
        if columns - j >= 6:
            while i + 16 <= rows:
                _set16x6(c, cj + i, ldc, a, ia + i, lda, a, ia + j, lda, 1, depth)
                i += 16
            if i + 8 <= rows:
                _set8x6(c, cj + i, ldc, a, ia + i, lda, a, ia + j, lda, 1, depth)
                i += 8
            if i < rows:
                _set4x6(c, cj + i, ldc, a, ia + i, lda, a, ia + j, lda, 1, depth)
            j += 6
        else:
            while i + 16 <= rows:
                _set16x3(c, cj + i, ldc, a, ia + i, lda, a, ia + j, lda, 1, depth)
                i += 16
            if i + 8 <= rows:
                _set8x3(c, cj + i, ldc, a, ia + i, lda, a, ia + j, lda, 1, depth)
                i += 8
            if i < rows:
                _set4x3(c, cj + i, ldc, a, ia + i, lda, a, ia + j, lda, 1, depth)
            j += 3


def _row_solve_kernel(lanes: int) -> Callable[..., None]:
    """X L' = B for ``lanes`` rows of three columns and a 3x3 lower factor given as six scalars (reciprocal pivots)."""

    @intrinsic  # type: ignore[untyped-decorator]
    def kernel(typingctx, x, ix, ld, i0, l10, l20, i1, l21, i2):  # type: ignore[no-untyped-def]
        signature = types.void(x, types.int64, types.int64, *[types.float64] * 6)

        def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
            base = _data(context, builder, sig.args[0], args[0])
            at = [args[1]]
            at.append(builder.add(at[0], args[2]))
            at.append(builder.add(at[1], args[2]))
            x0, x1, x2 = (_load(builder, base, k, lanes) for k in at)
            i0, l10, l20, i1, l21, i2 = (_broadcast(builder, a, lanes) for a in args[3:])
            x0 = builder.fmul(x0, i0)
            x1 = builder.fsub(x1, builder.fmul(x0, l10, flags=_CONTRACT), flags=_CONTRACT)
            x1 = builder.fmul(x1, i1)
            x2 = builder.fsub(x2, builder.fmul(x0, l20, flags=_CONTRACT), flags=_CONTRACT)
            x2 = builder.fsub(x2, builder.fmul(x1, l21, flags=_CONTRACT), flags=_CONTRACT)
            x2 = builder.fmul(x2, i2)
            for vector, k in zip((x0, x1, x2), at, strict=True):
                _store(builder, vector, base, k)
            return context.get_dummy_value()

        return signature, codegen

    return kernel  # type: ignore[no-any-return]


_row_solve8 = _row_solve_kernel(8)
_row_solve4 = _row_solve_kernel(4)


@njit(cache=True, error_model="numpy")
def solve_rows(x, ix, ld, i0, l10, l20, i1, l21, i2, rows):
    """X L' = B in place for ``rows`` (multiple of 4) rows of three columns; i0, i1, i2 are inverse pivots."""
    i = 0
    while i + 8 <= rows:
        _row_solve8(x, ix + i, ld, i0, l10, l20, i1, l21, i2)
        i += 8
    if i < rows:
        _row_solve4(x, ix + i, ld, i0, l10, l20, i1, l21, i2)


def _axpy_kernel(lanes: int) -> Callable[..., None]:
    """y -= X a for ``lanes`` rows of three columns."""

    @intrinsic  # type: ignore[untyped-decorator]
    def kernel(typingctx, y, iy, x, ix, ld, a0, a1, a2):  # type: ignore[no-untyped-def]
        signature = types.void(y, types.int64, x, types.int64, types.int64, *[types.float64] * 3)

        def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
            y_base, x_base = (
                _data(context, builder, sig.args[0], args[0]),
                _data(context, builder, sig.args[2], args[2]),
            )
            total = _load(builder, y_base, args[1], lanes)
            at = args[3]
            for a in args[5:]:
                column = _load(builder, x_base, at, lanes)
                product = builder.fmul(column, _broadcast(builder, a, lanes), flags=_CONTRACT)
                total = builder.fsub(total, product, flags=_CONTRACT)
                at = builder.add(at, args[4])
            _store(builder, total, y_base, args[1])
            return context.get_dummy_value()

        return signature, codegen

    return kernel  # type: ignore[no-any-return]


_axpy8 = _axpy_kernel(8)
_axpy4 = _axpy_kernel(4)


@njit(cache=True, error_model="numpy")
def subtract_columns(y, iy, x, ix, ld, a0, a1, a2, rows):
    """y -= X (a0, a1, a2)' for ``rows`` (multiple of 4) rows."""
    i = 0
    while i + 8 <= rows:
        _axpy8(y, iy + i, x, ix + i, ld, a0, a1, a2)
        i += 8
    if i < rows:
        _axpy4(y, iy + i, x, ix + i, ld, a0, a1, a2)


def _dot_kernel(lanes: int) -> Callable[..., Any]:
    """X' y (three scalars) for three columns and ``groups`` >= 1 groups of ``lanes`` rows."""

    @intrinsic  # type: ignore[untyped-decorator]
    def kernel(typingctx, y, iy, x, ix, ld, groups):  # type: ignore[no-untyped-def]
        signature = types.UniTuple(types.float64, 3)(y, types.int64, x, types.int64, types.int64, types.int64)

        def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
            vector = ir.VectorType(_F64, lanes)
            _, y_at, _, x_at, ld, groups = args
            yp, xp = _data(context, builder, sig.args[0], args[0]), _data(context, builder, sig.args[2], args[2])
            columns = [builder.add(x_at, builder.mul(ld, ir.Constant(_I64, c))) for c in range(3)]
            entry = builder.block
            loop = builder.append_basic_block("rows")
            leave = builder.append_basic_block("done")
            builder.branch(loop)
            builder.position_at_end(loop)
            group = builder.phi(_I64)
            sums = [builder.phi(vector) for _ in columns]
            shift = builder.mul(group, ir.Constant(_I64, lanes))
            left = _load(builder, yp, builder.add(y_at, shift), lanes)
            ends = []
            for total, column in zip(sums, columns, strict=True):
                right = _load(builder, xp, builder.add(column, shift), lanes)
                ends.append(builder.fadd(total, builder.fmul(left, right, flags=_CONTRACT), flags=_CONTRACT))
                total.add_incoming(ir.Constant(vector, [0.0] * lanes), entry)
                total.add_incoming(ends[-1], loop)
            after = builder.add(group, ir.Constant(_I64, 1))
            group.add_incoming(ir.Constant(_I64, 0), entry)
            group.add_incoming(after, loop)
            builder.cbranch(builder.icmp_signed("<", after, groups), loop, leave)
            builder.position_at_end(leave)
            name = f"llvm.vector.reduce.fadd.v{lanes}f64"
            reduce = cgutils.get_or_insert_function(builder.module, ir.FunctionType(_F64, [_F64, vector]), name)
            zero = ir.Constant(_F64, -0.0)
            totals = [builder.call(reduce, [zero, total], fastmath=("reassoc",)) for total in ends]
            return context.make_tuple(builder, sig.return_type, totals)

        return signature, codegen

    return kernel  # type: ignore[no-any-return]


_dot8 = _dot_kernel(8)
_dot4 = _dot_kernel(4)


@njit(cache=True, error_model="numpy")
def dot_columns(y, iy, x, ix, ld, rows):
    """X' y for ``rows`` (positive multiple of 4) rows of three columns."""
    if rows < 8:
        return _dot4(y, iy, x, ix, ld, 1)
    s0, s1, s2 = _dot8(y, iy, x, ix, ld, rows >> 3)
    if rows & 4:
        i = rows - 4
        t0, t1, t2 = _dot4(y, iy + i, x, ix + i, ld, 1)
        return s0 + t0, s1 + t1, s2 + t2
    return s0, s1, s2


def _triple_kernel(accumulate: bool) -> Callable[..., None]:
    """y[iy : iy + 3] = [y[...] +] x[ix : ix + 3]."""

    @intrinsic  # type: ignore[untyped-decorator]
    def kernel(typingctx, y, iy, x, ix):  # type: ignore[no-untyped-def]
        def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
            yp, xp = _data(context, builder, sig.args[0], args[0]), _data(context, builder, sig.args[2], args[2])
            for c in range(3):
                step = ir.Constant(_I64, c)
                target = builder.gep(yp, [builder.add(args[1], step)])
                value = builder.load(builder.gep(xp, [builder.add(args[3], step)]))
                builder.store(builder.fadd(builder.load(target), value) if accumulate else value, target)
            return context.get_dummy_value()

        return types.void(y, types.int64, x, types.int64), codegen

    return kernel  # type: ignore[no-any-return]


put_triple = _triple_kernel(False)
add_triple = _triple_kernel(True)


@intrinsic  # type: ignore[untyped-decorator]
def get(typingctx, x, i):  # type: ignore[no-untyped-def]
    """x[i] without numba's wraparound test for negative indices, which costs 10 % of a sparse factorisation."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        return builder.load(builder.gep(_data(context, builder, sig.args[0], args[0]), [args[1]]))

    return types.float64(x, types.int64), codegen


@intrinsic  # type: ignore[untyped-decorator]
def put(typingctx, x, i, value):  # type: ignore[no-untyped-def]
    """x[i] = value without numba's wraparound test."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        builder.store(args[2], builder.gep(_data(context, builder, sig.args[0], args[0]), [args[1]]))
        return context.get_dummy_value()

    return types.void(x, types.int64, types.float64), codegen


@intrinsic  # type: ignore[untyped-decorator]
def copy_vector(typingctx, y, iy, x, ix, count):  # type: ignore[no-untyped-def]
    """y[iy : iy + count] = x[ix : ix + count]."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        target = builder.gep(_data(context, builder, sig.args[0], args[0]), [args[1]])
        source = builder.gep(_data(context, builder, sig.args[2], args[2]), [args[3]])
        cgutils.raw_memcpy(builder, target, source, args[4], 8)
        return context.get_dummy_value()

    return types.void(y, types.int64, x, types.int64, types.int64), codegen


@intrinsic  # type: ignore[untyped-decorator]
def clear(typingctx, x, i, count):  # type: ignore[no-untyped-def]
    """x[i : i + count] = 0."""

    def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
        start = builder.gep(_data(context, builder, sig.args[0], args[0]), [args[1]])
        cgutils.memset(builder, start, builder.mul(args[2], ir.Constant(_I64, 8)), 0)
        return context.get_dummy_value()

    return types.void(x, types.int64, types.int64), codegen


def _block_kernel(lanes: int, accumulate: bool) -> Callable[..., None]:
    """C = [C] + A for ``lanes`` rows of three columns."""

    @intrinsic  # type: ignore[untyped-decorator]
    def kernel(typingctx, c, ic, ldc, a, ia, lda):  # type: ignore[no-untyped-def]
        signature = types.void(c, types.int64, types.int64, a, types.int64, types.int64)

        def codegen(context, builder, sig, args):  # type: ignore[no-untyped-def]
            _, c_at, ldc, _, a_at, lda = args
            cp, ap = _data(context, builder, sig.args[0], args[0]), _data(context, builder, sig.args[3], args[3])
            for _ in range(3):
                value = _load(builder, ap, a_at, lanes)
                if accumulate:
                    value = builder.fadd(_load(builder, cp, c_at, lanes), value)
                _store(builder, value, cp, c_at)
                c_at, a_at = builder.add(c_at, ldc), builder.add(a_at, lda)
            return context.get_dummy_value()

        return signature, codegen

    return kernel  # type: ignore[no-any-return]


put_block = _block_kernel(3, False)
_plus3 = _block_kernel(3, True)
_plus6 = _block_kernel(6, True)
_plus12 = _block_kernel(12, True)


@njit(cache=True, error_model="numpy")
def add_blocks(c, ic, ldc, a, ia, lda, blocks):
    """C += A for three columns of 3 ``blocks`` rows."""
    while blocks >= 4:
        _plus12(c, ic, ldc, a, ia, lda)
        ic += 12
        ia += 12
        blocks -= 4
    if blocks >= 2:
        _plus6(c, ic, ldc, a, ia, lda)
        ic += 6
        ia += 6
        blocks -= 2
    if blocks > 0:
        _plus3(c, ic, ldc, a, ia, lda)
