# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator"
"""Verified sparse Cholesky factorisation of Hermitian matrices of 2 x 2 complex blocks.

The pattern and the order of elimination are those of an information matrix (`information`, `cholesky`): column j has the
row nodes ``indices[indptr[j]:indptr[j+1]]`` <= j, the diagonal last, and block k is ``values[k]``. The factorisation goes
row by row along the elimination tree (up-looking), because every block of the factor is read again to bound rounding errors.

Source: Liu, *The role of elimination trees in sparse factorization*, 1990; Davis, *Direct methods for sparse linear
systems*, 2006, section 4.7; for the bound on rounding errors Rump, *Verification of positive definiteness*, 2006.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .cholesky.elimination import elimination_tree

#: the unit roundoff of double precision
ROUNDOFF = 2.0**-53


@dataclass(frozen=True, eq=False)
class HermitianSymbolic:
    """The structure of the factor: order (n,), where each row's blocks come from, the tree, and the columns of L.

    ``rows`` (n+1,), ``columns``, ``sources``, ``turned``: the entries left of the diagonal of each row in elimination order.
    ``starts`` (n+1,): where the columns of L begin. ``rounding`` (n,): c of each row, see `factorize`.
    """

    order: NDArray[Any]
    diagonal: NDArray[Any]
    rows: NDArray[Any]
    columns: NDArray[Any]
    sources: NDArray[Any]
    turned: NDArray[Any]
    parent: NDArray[Any]
    starts: NDArray[Any]
    rounding: NDArray[Any]


@dataclass(frozen=True, eq=False)
class HermitianFactor:
    """L with L L^H = A, or the row at which a pivot was not positive.

    Attributes:
        negative: None, or a vector (n, 2) in node order with v^H A v <= 0 up to rounding; L is then incomplete.
        error: (n, 2) in node order, a bound on the rounding errors, see `factorize`.
    """

    symbolic: HermitianSymbolic
    blocks: NDArray[Any]
    targets: NDArray[Any]
    pivots: NDArray[Any]
    negative: NDArray[Any] | None
    error: NDArray[Any]

    def solve(self, rhs: NDArray[Any]) -> NDArray[Any]:
        """A^-1 rhs (n, 2), in node order."""
        s = self.symbolic
        x = rhs[s.order].astype(np.complex128)
        _forward(s.starts, self.targets, self.blocks, self.pivots, x)
        _backward(s.starts, self.targets, self.blocks, self.pivots, x)
        out = np.empty_like(x)
        out[s.order] = x
        return out

    def square(self, rhs: NDArray[Any]) -> float:
        """A bound on rhs^H (A + diag(e))^-1 rhs for any e of at least `error`, rounding errors included.

        The computed x = L^-1 rhs solves L x = rhs - f exactly, with |f_i| <= c_i (|L| |x|)_i <= c_i sqrt(d_i) |x|, d the
        diagonal of L L^H. As `error` is at least c d, f adds at most |x| times the root of the sum of c.
        """
        x = rhs[self.symbolic.order].astype(np.complex128)
        _forward(self.symbolic.starts, self.targets, self.blocks, self.pivots, x)
        lost = np.sqrt(2 * self.symbolic.rounding.sum())
        return float(np.sum(x.real**2 + x.imag**2)) * (1.001 + lost) ** 2


def analyze_hermitian(indptr: NDArray[Any], indices: NDArray[Any], order: NDArray[Any]) -> HermitianSymbolic:
    """The structure of the factor for a pattern and an order of elimination (n,)."""
    return HermitianSymbolic(*_structure(indptr, indices, np.ascontiguousarray(order, dtype=np.int64)))


def factorize(symbolic: HermitianSymbolic, values: NDArray[Any]) -> HermitianFactor:
    """The factor of blocks (nnzb, 2, 2), of which the diagonal ones are Hermitian.

    A row i of b blocks has c_i = 2 u (16 + 2 b): an entry of L L^H is a sum of at most 2 min(b_i, b_j) complex products, so
    that its error is at most min(c_i, c_j) (|L| |L|^H)_ij. For every positive vector w these errors are, as a matrix, at most
    the diagonal matrix of the quotients (C |L| |L|^H C w)_i / w_i with C = diag(c)^1/2, because 2 x y <= r x² + y² / r.
    ``error`` holds these quotients for w = diag(L L^H)^-1/2.
    """
    s = symbolic
    arguments = (s.order, s.diagonal, s.rows, s.columns, s.sources, s.turned, s.parent, s.starts)
    blocks, targets, pivots, bad, negative = _factorize(*arguments, np.ascontiguousarray(values))
    if bad >= 0:
        return HermitianFactor(s, blocks, targets, pivots, negative, np.full((len(s.order), 2), np.inf))
    error = np.empty((len(s.order), 2))
    error[s.order] = _error(s.starts, targets, blocks, pivots, np.sqrt(s.rounding))
    return HermitianFactor(s, blocks, targets, pivots, None, error)


@njit(cache=True, error_model="numpy")
def _structure(indptr, indices, order):
    """The fields of `HermitianSymbolic`."""
    n = len(order)
    position = np.empty(n, np.int64)
    for k in range(n):
        position[order[k]] = k
    rows, columns, sources, turned = _entries(n, indptr, indices, position)
    parent, count = elimination_tree(n, rows, columns.astype(np.int32))
    starts = np.zeros(n + 1, np.int64)
    starts[1:] = np.cumsum(count - 1)
    rounding = 2 * ROUNDOFF * (16.0 + 2 * _row_lengths(n, rows, columns, parent))
    return order, indptr[1:][order] - 1, rows, columns, sources, turned, parent, starts, rounding


@njit(cache=True, error_model="numpy")
def _entries(n, indptr, indices, position):
    """For each row in elimination order its columns left of the diagonal, their blocks, and whether to transpose them."""
    start = np.zeros(n + 1, np.int64)
    for j in range(n):
        for p in range(indptr[j], indptr[j + 1] - 1):
            start[max(position[indices[p]], position[j]) + 1] += 1
    start = np.cumsum(start)
    fill = start[:n].copy()
    columns, sources = np.empty(start[n], np.int64), np.empty(start[n], np.int64)
    turned = np.empty(start[n], np.bool_)
    for j in range(n):
        b = position[j]
        for p in range(indptr[j], indptr[j + 1] - 1):
            a = position[indices[p]]
            row, column = max(a, b), min(a, b)
            q = fill[row]
            fill[row] += 1
            # the block is that of row node i and column node j; L needs the one whose row is eliminated later
            columns[q], sources[q], turned[q] = column, p, a < b
    return start, columns, sources, turned


@njit(cache=True, error_model="numpy")
def _row_lengths(n, rows, columns, parent):
    """The number of blocks left of the diagonal in each row of L."""
    lengths = np.zeros(n, np.int64)
    mark = np.full(n, -1, np.int64)
    for k in range(n):
        mark[k] = k
        for p in range(rows[k], rows[k + 1]):
            i = columns[p]
            while mark[i] != k:
                mark[i] = k
                lengths[k] += 1
                i = parent[i]
    return lengths


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _factorize(order, diagonal, rows, columns, sources, turned, parent, starts, values):
    n = len(order)
    blocks = np.empty((starts[n], 4), np.complex128)
    targets = np.empty(starts[n], np.int64)
    # of each diagonal block: 1 / l00, l10, 1 / l11
    pivots = np.empty((n, 3), np.complex128)
    fill = starts[:n].copy()
    x = np.zeros((n, 4), np.complex128)
    mark = np.full(n, -1, np.int64)
    stack, path = np.empty(n, np.int64), np.empty(n, np.int64)
    for k in range(n):
        mark[k] = k
        top = n
        for p in range(rows[k], rows[k + 1]):
            i = columns[p]
            V = values[sources[p]]
            if turned[p]:
                x[i, 0], x[i, 1] = np.conj(V[0, 0]), np.conj(V[1, 0])
                x[i, 2], x[i, 3] = np.conj(V[0, 1]), np.conj(V[1, 1])
            else:
                x[i, 0], x[i, 1], x[i, 2], x[i, 3] = V[0, 0], V[0, 1], V[1, 0], V[1, 1]
            length = 0
            while mark[i] != k:
                path[length] = i
                length += 1
                mark[i] = k
                i = parent[i]
            while length > 0:
                length -= 1
                top -= 1
                stack[top] = path[length]
        D = values[diagonal[k]]
        d0, d1, d10 = D[0, 0].real, D[1, 1].real, D[1, 0]
        for q in range(top, n):
            i = stack[q]
            # X = A_ki - sum of L_kj L_ij^H; L_ki = X L_ii^-H
            i0, l10, i1 = pivots[i, 0].real, pivots[i, 1], pivots[i, 2].real
            a0 = x[i, 0] * i0
            a2 = x[i, 2] * i0
            a1 = (x[i, 1] - a0 * np.conj(l10)) * i1
            a3 = (x[i, 3] - a2 * np.conj(l10)) * i1
            x[i, 0], x[i, 1], x[i, 2], x[i, 3] = 0, 0, 0, 0
            for p in range(starts[i], fill[i]):
                j = targets[p]
                b0, b1 = np.conj(blocks[p, 0]), np.conj(blocks[p, 1])
                b2, b3 = np.conj(blocks[p, 2]), np.conj(blocks[p, 3])
                x[j, 0] = x[j, 0] - a0 * b0 - a1 * b1
                x[j, 1] = x[j, 1] - a0 * b2 - a1 * b3
                x[j, 2] = x[j, 2] - a2 * b0 - a3 * b1
                x[j, 3] = x[j, 3] - a2 * b2 - a3 * b3
            d0 -= a0.real**2 + a0.imag**2 + a1.real**2 + a1.imag**2
            d1 -= a2.real**2 + a2.imag**2 + a3.real**2 + a3.imag**2
            d10 -= a2 * np.conj(a0) + a3 * np.conj(a1)
            p = fill[i]
            fill[i] += 1
            targets[p] = k
            blocks[p, 0], blocks[p, 1], blocks[p, 2], blocks[p, 3] = a0, a1, a2, a3
        bad = -1
        if d0 > 0:
            root = np.sqrt(d0)
            l10 = d10 / root
            rest = d1 - (l10.real**2 + l10.imag**2)
            if rest > 0:
                pivots[k, 0], pivots[k, 1], pivots[k, 2] = 1 / root, l10, 1 / np.sqrt(rest)
            else:
                bad = 1
        else:
            bad = 0
        if bad >= 0:
            # the vector that is 1 at the pivot and maps the rows eliminated before to zero
            v = np.zeros((n, 2), np.complex128)
            v[k, bad] = 1
            if bad == 1:
                v[k, 0] = -np.conj(d10) / d0
            for i in range(k - 1, -1, -1):
                s0, s1 = 0j, 0j
                for p in range(starts[i], fill[i]):
                    j = targets[p]
                    s0 += np.conj(blocks[p, 0]) * v[j, 0] + np.conj(blocks[p, 2]) * v[j, 1]
                    s1 += np.conj(blocks[p, 1]) * v[j, 0] + np.conj(blocks[p, 3]) * v[j, 1]
                v[i, 1] = -s1 * pivots[i, 2].real
                v[i, 0] = (-s0 - np.conj(pivots[i, 1]) * v[i, 1]) * pivots[i, 0].real
            out = np.empty_like(v)
            for i in range(n):
                out[order[i]] = v[i]
            return blocks, targets, pivots, k, out
    return blocks, targets, pivots, -1, np.zeros((0, 2), np.complex128)


@njit(cache=True, error_model="numpy")
def _size(z):
    return np.sqrt(z.real * z.real + z.imag * z.imag)


@njit(cache=True, error_model="numpy")
def _error(starts, targets, blocks, pivots, root):
    """The quotients of `factorize`, in the order of elimination, for the square roots of c."""
    n = len(starts) - 1
    # diag(A) from L: the squares of its rows
    square = np.empty((n, 2))
    for k in range(n):
        square[k, 0] = 1 / pivots[k, 0].real ** 2
        square[k, 1] = _size(pivots[k, 1]) ** 2 + 1 / pivots[k, 2].real ** 2
    size = np.empty((len(blocks), 4))
    for i in range(n):
        for p in range(starts[i], starts[i + 1]):
            for c in range(4):
                size[p, c] = _size(blocks[p, c])
            square[targets[p], 0] += size[p, 0] ** 2 + size[p, 1] ** 2
            square[targets[p], 1] += size[p, 2] ** 2 + size[p, 3] ** 2
    v, after = np.empty((n, 2)), np.zeros((n, 2))
    for i in range(n):
        v[i, 0], v[i, 1] = root[i] / np.sqrt(square[i, 0]), root[i] / np.sqrt(square[i, 1])
    for i in range(n):
        cross = _size(pivots[i, 1])
        w0 = v[i, 0] / pivots[i, 0].real + cross * v[i, 1]
        w1 = v[i, 1] / pivots[i, 2].real
        for p in range(starts[i], starts[i + 1]):
            t = targets[p]
            w0 += size[p, 0] * v[t, 0] + size[p, 2] * v[t, 1]
            w1 += size[p, 1] * v[t, 0] + size[p, 3] * v[t, 1]
        after[i, 0] += w0 / pivots[i, 0].real
        after[i, 1] += cross * w0 + w1 / pivots[i, 2].real
        for p in range(starts[i], starts[i + 1]):
            t = targets[p]
            after[t, 0] += size[p, 0] * w0 + size[p, 1] * w1
            after[t, 1] += size[p, 2] * w0 + size[p, 3] * w1
    for i in range(n):
        for c in range(2):
            after[i, c] *= 1.001 * root[i] ** 2 / v[i, c]
    return after


@njit(cache=True, error_model="numpy")
def _forward(starts, targets, blocks, pivots, x):
    for i in range(len(starts) - 1):
        a = x[i, 0] * pivots[i, 0].real
        b = (x[i, 1] - pivots[i, 1] * a) * pivots[i, 2].real
        x[i, 0], x[i, 1] = a, b
        for p in range(starts[i], starts[i + 1]):
            t = targets[p]
            x[t, 0] -= blocks[p, 0] * a + blocks[p, 1] * b
            x[t, 1] -= blocks[p, 2] * a + blocks[p, 3] * b


@njit(cache=True, error_model="numpy")
def _backward(starts, targets, blocks, pivots, x):
    for i in range(len(starts) - 2, -1, -1):
        a, b = x[i, 0], x[i, 1]
        for p in range(starts[i], starts[i + 1]):
            t = targets[p]
            a -= np.conj(blocks[p, 0]) * x[t, 0] + np.conj(blocks[p, 2]) * x[t, 1]
            b -= np.conj(blocks[p, 1]) * x[t, 0] + np.conj(blocks[p, 3]) * x[t, 1]
        b *= pivots[i, 2].real
        x[i, 0], x[i, 1] = (a - np.conj(pivots[i, 1]) * b) * pivots[i, 0].real, b
