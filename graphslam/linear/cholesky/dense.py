# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""Dense factorisation with LAPACK, for matrices whose factor is all but full."""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import lapack


@njit(cache=True, error_model="numpy")
def scatter(n, indptr, indices, values, scaled, shift, a):
    """Lower triangle of the matrix into ``a`` (3n, 3n) in Fortran order, passed transposed, and its diagonal."""
    a[:] = 0.0
    diagonal = np.empty(3 * n)
    for j in range(n):
        for p in range(indptr[j], indptr[j + 1]):
            i = indices[p]
            for c in range(3):
                for k in range(3):
                    a[3 * i + k, 3 * j + c] = values[9 * p + 3 * k + c]
        for k in range(3):
            d = a[3 * j + k, 3 * j + k] * scaled + shift
            a[3 * j + k, 3 * j + k] = d
            diagonal[3 * j + k] = d
    return diagonal


def factorize(a: NDArray[Any], diagonal: NDArray[Any], tolerance: float) -> int:
    """Cholesky factor in place in the lower triangle of Fortran-ordered ``a``; the bad scalar pivot, or -1."""
    _, info = lapack.dpotrf(a, lower=1, clean=0, overwrite_a=1)
    done = info - 1 if info > 0 else diagonal.size
    pivots = np.diagonal(a)[:done]
    bad = np.flatnonzero(~(pivots * pivots > tolerance * diagonal[:done]))
    if bad.size:
        return int(bad[0])
    return done if info > 0 else -1


def null_vector(a: NDArray[Any], bad: int) -> NDArray[np.float64]:
    """Vector (3n,) with a unit at the bad pivot that the leading rows of the matrix map to zero."""
    v = np.zeros(a.shape[0])
    v[bad] = 1.0
    if bad:
        v[:bad] = -lapack.dtrtrs(a[:bad, :bad], a[bad, :bad], lower=1, trans=1)[0]
    return v


def inverse(a: NDArray[Any]) -> NDArray[np.float64]:
    """Lower triangle of the inverse from the factor."""
    return lapack.dpotri(a, lower=1)[0]


def solve(a: NDArray[Any], rhs: NDArray[Any]) -> NDArray[np.float64]:
    """Solution (3n, k) from the factor."""
    return lapack.dpotrs(a, rhs, lower=1)[0]


class DenseStore:
    """Full matrix, factor and inverse of one dense factorisation."""

    def __init__(self, n: int, indptr: NDArray[Any], indices: NDArray[Any]) -> None:
        self.n = n
        self.indptr = indptr
        self.indices = indices
        self.a = np.empty((3 * n, 3 * n), order="F")
        self.z: NDArray[np.float64] | None = None

    def factorize(self, values: NDArray[Any], tolerance: float, scaled: float, shift: float) -> int:
        """Bad scalar pivot, or -1."""
        diagonal = scatter(self.n, self.indptr, self.indices, values, scaled, shift, self.a.T)
        return factorize(self.a, diagonal, tolerance)

    def null_vector(self, bad: int) -> NDArray[np.float64]:
        """Null vector (n, 3) after a bad pivot."""
        return null_vector(self.a, bad).reshape(-1, 3)

    def pivot_place(self, bad: int) -> tuple[int, int]:
        """Node and component of a scalar pivot."""
        return bad // 3, bad % 3

    def solve(self, rhs: NDArray[Any], out: NDArray[Any]) -> None:
        """One right-hand side, flat (3n,)."""
        out[:] = solve(self.a, rhs)

    def invert(self) -> NDArray[np.float64]:
        """Inverse; returns its diagonal blocks (n, 3, 3)."""
        self.z = inverse(self.a)
        k = np.arange(self.n)
        blocks = self._blocks(k, k)
        lower = np.tril(blocks)
        return lower + np.tril(blocks, -1).transpose(0, 2, 1)

    def _blocks(self, i: NDArray[Any], j: NDArray[Any]) -> NDArray[np.float64]:
        assert self.z is not None
        c = np.arange(3)
        return self.z[3 * i[:, None, None] + c[:, None], 3 * j[:, None, None] + c]

    def inverse_block(self, i: int, j: int) -> NDArray[np.float64]:
        """Block (i, j) of the inverse; ``invert`` has run."""
        block = self._blocks(np.array([max(i, j)]), np.array([min(i, j)]))[0]
        if i == j:
            return np.tril(block) + np.tril(block, -1).T
        return block if i > j else block.T

    def logdet(self) -> float:
        """log det Omega."""
        return float(2.0 * np.log(np.diagonal(self.a)).sum())
