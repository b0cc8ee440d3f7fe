# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""Dense factorisation with LAPACK, for matrices whose factor is almost full."""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import lapack


@njit(cache=True, error_model="numpy")
def scatter(n, indptr, indices, values, damping, a):
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
            d = a[3 * j + k, 3 * j + k] * (1.0 + damping)
            a[3 * j + k, 3 * j + k] = d
            diagonal[3 * j + k] = d
    return diagonal


class DenseStore:
    """Full matrix, factor and inverse of one dense factorisation."""

    def __init__(self, n: int, indptr: NDArray[Any], indices: NDArray[Any]) -> None:
        self.n = n
        self.indptr = indptr
        self.indices = indices
        self.a = np.empty((3 * n, 3 * n), order="F")
        self.z: NDArray[np.float64] | None = None

    def factorize(self, values: NDArray[Any], tolerance: float, damping: float) -> int:
        """Cholesky factor in place in the lower triangle of ``a``; the bad scalar pivot, or -1."""
        diagonal = scatter(self.n, self.indptr, self.indices, values, damping, self.a.T)
        _, info = lapack.dpotrf(self.a, lower=1, clean=0, overwrite_a=1)
        done = info - 1 if info > 0 else diagonal.size
        pivots = np.diagonal(self.a)[:done]
        bad = np.flatnonzero(~(pivots * pivots > tolerance * diagonal[:done]))
        if bad.size:
            return int(bad[0])
        return done if info > 0 else -1

    def log_determinant(self) -> float:
        """log det Omega, from the diagonal of L."""
        return 2.0 * float(np.log(np.diagonal(self.a)).sum())

    def solve(self, rhs: NDArray[Any], out: NDArray[Any]) -> bool:
        """One right-hand side, flat (3n,); returns whether it is finite."""
        out[:] = lapack.dpotrs(self.a, rhs, lower=1)[0]
        return bool(np.isfinite(rhs).all())

    def invert(self) -> NDArray[np.float64]:
        """Inverse; returns its diagonal blocks (n, 3, 3)."""
        inverse, _ = lapack.dpotri(self.a, lower=1)
        # the transpose of the lower triangle holds the blocks (i, j) with i <= j
        self.z = inverse.T.reshape(self.n, 3, self.n, 3)
        k = np.arange(self.n)
        return _symmetric(self.z[k, :, k, :])

    def inverse_block(self, i: int, j: int) -> NDArray[np.float64]:
        """Block (i, j) of the inverse; ``invert`` has run."""
        assert self.z is not None
        block = self.z[min(i, j), :, max(i, j), :]
        if i == j:
            return _symmetric(block)
        return block.copy() if i < j else block.T.copy()

    def inverse_pairs(self, first: NDArray[np.int64], second: NDArray[np.int64]) -> NDArray[np.float64]:
        """The blocks (E, 3, 3) between pairs of nodes; ``invert`` has run."""
        return np.array([self.inverse_block(i, j) for i, j in zip(first, second)]).reshape(-1, 3, 3)

    def inverse_blocks(self, nodes: NDArray[np.int64]) -> NDArray[np.float64]:
        """The blocks (k, 3, k, 3) between all pairs of nodes; ``invert`` has run."""
        return np.array([[self.inverse_block(i, j) for j in nodes] for i in nodes]).transpose(0, 2, 1, 3)


def _symmetric(upper: NDArray[np.float64]) -> NDArray[np.float64]:
    """Blocks (..., 3, 3) of which the upper triangle is given."""
    return np.triu(upper) + np.triu(upper, 1).swapaxes(-1, -2)
