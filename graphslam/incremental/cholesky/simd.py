# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return"
"""LLVM vector code behind the dense kernels: products, row solves and copies on flat column-major float64 arrays.

Written with ``numba.extending.intrinsic``: the loop vectoriser does not vectorise the plain loops, because it cannot
prove that the 3 to 6 target columns do not overlap (numba has no ``restrict``). Plain loops reach 8 Gflop/s, these 60.
Vectors of 8 doubles are legal everywhere: LLVM splits them where the registers are narrower. The subtractions carry
the ``contract`` flag so that they become fused multiply-adds where the processor has them. Indices are trusted.
"""

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

_F64 = ir.DoubleType()
_I64 = ir.IntType(64)
_CONTRACT = ("contract",)


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


def product_kernel(lanes: int, vectors: int, columns: int, accumulate: bool) -> Callable[..., None]:
    """C (lanes*vectors, columns) = [C] - A B with A's rows contiguous and B of strides ``(step_k, step_j)``."""

    @intrinsic
    def kernel(typingctx, c, ic, ldc, a, ia, lda, b, ib, step_k, step_j, depth):
        signature = types.void(c, types.int64, types.int64, a, types.int64, types.int64, b, *[types.int64] * 4)

        def codegen(context, builder, sig, args):
            vector = ir.VectorType(_F64, lanes)
            zero = ir.Constant(vector, [0.0] * lanes)
            _, ic, ldc, _, ia, lda, _, ib, step_k, step_j, depth = args
            cp, ap, bp = (_data(context, builder, sig.args[k], args[k]) for k in (0, 3, 6))
            rows = [ir.Constant(_I64, lanes * v) for v in range(vectors)]
            c_at = [builder.add(ic, builder.mul(ldc, ir.Constant(_I64, j))) for j in range(columns)]
            b_step = [builder.mul(step_j, ir.Constant(_I64, j)) for j in range(columns)]
            cells = [builder.add(at, row) for at in c_at for row in rows]
            start = [_load(builder, cp, cell, lanes) if accumulate else zero for cell in cells]
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
            totals = [builder.phi(vector) for _ in cells]
            for total, first, later in zip(totals, start, ends, strict=True):
                total.add_incoming(first, entry)
                total.add_incoming(later, loop)
            for total, cell in zip(totals, cells, strict=True):
                _store(builder, total, cp, cell)
            return context.get_dummy_value()

        return signature, codegen

    return kernel


def _row_solve_kernel(lanes: int) -> Callable[..., None]:
    """X L' = B for ``lanes`` rows of three columns and a 3x3 lower factor given as six scalars (reciprocal pivots)."""

    @intrinsic
    def kernel(typingctx, x, ix, ld, i0, l10, l20, i1, l21, i2):
        signature = types.void(x, types.int64, types.int64, *[types.float64] * 6)

        def codegen(context, builder, sig, args):
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

    return kernel


row_solve8 = _row_solve_kernel(8)
row_solve4 = _row_solve_kernel(4)


def _axpy_kernel(lanes: int) -> Callable[..., None]:
    """y -= X a for ``lanes`` rows of three columns."""

    @intrinsic
    def kernel(typingctx, y, iy, x, ix, ld, a0, a1, a2):
        signature = types.void(y, types.int64, x, types.int64, types.int64, *[types.float64] * 3)

        def codegen(context, builder, sig, args):
            yp, xp = _data(context, builder, sig.args[0], args[0]), _data(context, builder, sig.args[2], args[2])
            total = _load(builder, yp, args[1], lanes)
            at = args[3]
            for a in args[5:]:
                column = _load(builder, xp, at, lanes)
                product = builder.fmul(column, _broadcast(builder, a, lanes), flags=_CONTRACT)
                total = builder.fsub(total, product, flags=_CONTRACT)
                at = builder.add(at, args[4])
            _store(builder, total, yp, args[1])
            return context.get_dummy_value()

        return signature, codegen

    return kernel


axpy8 = _axpy_kernel(8)
axpy4 = _axpy_kernel(4)


def _dot_kernel(lanes: int) -> Callable[..., Any]:
    """X' y (three scalars) for three columns and ``groups`` >= 1 groups of ``lanes`` rows."""

    @intrinsic
    def kernel(typingctx, y, iy, x, ix, ld, groups):
        signature = types.UniTuple(types.float64, 3)(y, types.int64, x, types.int64, types.int64, types.int64)

        def codegen(context, builder, sig, args):
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

    return kernel


dot8 = _dot_kernel(8)
dot4 = _dot_kernel(4)


@intrinsic
def get(typingctx, x, i):
    """x[i] without numba's wraparound test for negative indices, which costs 10 % of a sparse factorisation."""

    def codegen(context, builder, sig, args):
        return builder.load(builder.gep(_data(context, builder, sig.args[0], args[0]), [args[1]]))

    return types.float64(x, types.int64), codegen


@intrinsic
def put(typingctx, x, i, value):
    """x[i] = value without numba's wraparound test."""

    def codegen(context, builder, sig, args):
        builder.store(args[2], builder.gep(_data(context, builder, sig.args[0], args[0]), [args[1]]))
        return context.get_dummy_value()

    return types.void(x, types.int64, types.float64), codegen


@njit(inline="always", error_model="numpy")
def put_triple(y, iy, x, ix):
    """y[iy : iy + 3] = x[ix : ix + 3]."""
    for c in range(3):
        put(y, iy + c, get(x, ix + c))


@njit(inline="always", error_model="numpy")
def add_triple(y, iy, x, ix):
    """y[iy : iy + 3] += x[ix : ix + 3]."""
    for c in range(3):
        put(y, iy + c, get(y, iy + c) + get(x, ix + c))


@intrinsic
def copy_vector(typingctx, y, iy, x, ix, count):
    """y[iy : iy + count] = x[ix : ix + count]."""

    def codegen(context, builder, sig, args):
        target = builder.gep(_data(context, builder, sig.args[0], args[0]), [args[1]])
        source = builder.gep(_data(context, builder, sig.args[2], args[2]), [args[3]])
        cgutils.raw_memcpy(builder, target, source, args[4], 8)
        return context.get_dummy_value()

    return types.void(y, types.int64, x, types.int64, types.int64), codegen


@intrinsic
def clear(typingctx, x, i, count):
    """x[i : i + count] = 0."""

    def codegen(context, builder, sig, args):
        start = builder.gep(_data(context, builder, sig.args[0], args[0]), [args[1]])
        cgutils.memset(builder, start, builder.mul(args[2], ir.Constant(_I64, 8)), 0)
        return context.get_dummy_value()

    return types.void(x, types.int64, types.int64), codegen


def _block_kernel(lanes: int, accumulate: bool) -> Callable[..., None]:
    """C = [C] + A for ``lanes`` rows of three columns."""

    @intrinsic
    def kernel(typingctx, c, ic, ldc, a, ia, lda):
        signature = types.void(c, types.int64, types.int64, a, types.int64, types.int64)

        def codegen(context, builder, sig, args):
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

    return kernel


put_block = _block_kernel(3, False)
plus3 = _block_kernel(3, True)
plus6 = _block_kernel(6, True)
plus12 = _block_kernel(12, True)
