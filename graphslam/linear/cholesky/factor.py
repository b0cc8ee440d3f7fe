# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""Public classes: analyse once per graph, factorise once per iteration, solve."""

import warnings
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import scipy.sparse as sp
from numba import njit
from numpy.typing import NDArray
from scipy.sparse.linalg import MatrixRankWarning, spsolve

from .choice import fill_reducing
from .dense import DenseStore
from .errors import NotFinite, SingularPivot
from .multifrontal import MultifrontalStore
from .symbolic import Layout, layout

# Smallest ratios of a pivot to its diagonal entry. Graphs that are held: INTEL 4e-11, a path of 10^5 poses held at one
# end 1e-10, CSAIL 1e-7, the others above 1e-6. Graphs that are not held: negative, or M3500 9e-14, CSAIL (badly scaled)
# 2e-11.
PIVOT_TOLERANCE = 1e-12


@dataclass(frozen=True, eq=False)
class Symbolic:
    """Symbolic analysis of a symmetric pattern of 3x3 blocks; made by :func:`analyze`, valid for any values.

    Attributes:
        indptr, indices: the pattern.
        layout: the supernodal structure (unused by the dense method), with the blocks and flops of the factorisation
            without the zeros of relaxed supernodes.
        method: ``"supernodal"`` or ``"dense"``.
    """

    indptr: NDArray[Any]
    indices: NDArray[Any]
    layout: Layout
    method: str

    @property
    def order(self) -> NDArray[np.int32]:
        """(n,) the node eliminated k-th."""
        return self.layout.order if self.method == "supernodal" else np.arange(self.layout.order.size, dtype=np.int32)

    def factorize(self, values: NDArray[Any], *, damping: float = 0.0) -> "Factor":
        """A new factor of values on the pattern; see :meth:`Factor.refactorize`."""
        return Factor(self).refactorize(values, damping=damping)


def symmetric(indptr: NDArray[Any], indices: NDArray[Any], values: NDArray[Any]) -> sp.csc_matrix:
    """The whole matrix, both triangles (3n, 3n), of blocks in upper block-CSC."""
    # the transpose of the upper blocks, column by column: rows are columns
    lower = sp.tril(sp.bsr_matrix((values.transpose(0, 2, 1), indices, indptr)))
    return (lower + sp.tril(lower, k=-1).T).tocsc()


class Factor:
    """Cholesky factor of Omega. ``refactorize`` reuses all memory for new values; not to be shared by threads."""

    def __init__(self, symbolic: Symbolic) -> None:
        self.symbolic, n = symbolic, symbolic.layout.order.size
        self._store: MultifrontalStore | DenseStore
        if symbolic.method == "dense":
            self._store = DenseStore(n, symbolic.indptr, symbolic.indices)
        else:
            self._store = MultifrontalStore(symbolic.layout)
        self._diagonal: NDArray[np.float64] | None = None
        self._valid = False

    def refactorize(self, values: NDArray[Any], *, damping: float = 0.0) -> "Factor":
        """Cholesky factorisation Omega + damping diag(Omega) = L L' of new values on the same pattern, in place.

        Args:
            values: (nnzb, 3, 3) blocks; of the diagonal blocks only the upper triangle is read.
            damping: lambda >= 0 of a Levenberg-Marquardt step.

        Raises:
            ValueError: wrong shape, negative damping.
            NotFinite: the values hold NaN or infinity.
            SingularPivot: a pivot is not greater than 1e-12 times the (damped) diagonal entry it came from.
        """
        expected = (self.symbolic.indices.size, 3, 3)
        values = np.ascontiguousarray(values, dtype=np.float64)
        if values.shape != expected:
            raise ValueError(f"values must have shape {expected}, not {values.shape}")
        if not (damping >= 0.0 and np.isfinite(damping)):
            raise ValueError(f"damping must be finite and not negative, not {damping}")
        self._diagonal = None
        self._valid = False
        bad = self._store.factorize(values.reshape(-1), PIVOT_TOLERANCE, damping)
        if bad >= 0:
            self._raise(values, damping, bad)
        self._valid = True
        return self

    def _raise(self, values: NDArray[np.float64], damping: float, bad: int) -> None:
        # NaN and inf always end in a bad pivot, so that values need no check before
        finite = np.isfinite(values).all(axis=(1, 2))
        if not finite.all():
            p = int(np.argmin(finite))
            j = int(np.searchsorted(self.symbolic.indptr, p, side="right")) - 1
            raise NotFinite(int(self.symbolic.indices[p]), j)
        # the vector with a one at the bad pivot that the rows eliminated before it map to zero
        order = (3 * self.symbolic.order[:, None] + np.arange(3)).ravel()
        omega = symmetric(self.symbolic.indptr, self.symbolic.indices, values)
        omega = (omega + damping * sp.diags(omega.diagonal())).tocsc()
        head, pivot, vector = order[:bad], order[bad], np.zeros(order.size)
        vector[pivot] = 1.0
        if bad:
            with warnings.catch_warnings():
                # the part before the pivot may be singular to rounding, too
                warnings.simplefilter("ignore", MatrixRankWarning)
                vector[head] = -spsolve(omega[head][:, head], omega[head, pivot].toarray().ravel())
            if not np.isfinite(vector).all():
                vector[head] = 0.0
        raise SingularPivot(int(pivot) // 3, int(pivot) % 3, vector.reshape(-1, 3) / np.abs(vector).max())

    def _check(self) -> None:
        if not self._valid:
            raise ValueError("no valid factorisation: the last one failed or none was made")

    def solve(self, rhs: NDArray[Any]) -> NDArray[np.float64]:
        """Solve (Omega + damping) x = rhs.

        Args:
            rhs: (n, 3) or (n, 3, k), node order.

        Returns:
            Solution of the same shape.

        Raises:
            ValueError: wrong shape, or rhs not finite.
        """
        self._check()
        n = self.symbolic.layout.order.size
        rhs = np.asarray(rhs, dtype=np.float64)
        if rhs.shape[:2] != (n, 3) or rhs.ndim not in (2, 3):
            raise ValueError(f"rhs must have shape ({n}, 3) or ({n}, 3, k), not {rhs.shape}")
        if rhs.ndim == 3:
            return np.stack([self.solve(rhs[:, :, k]) for k in range(rhs.shape[2])], axis=2)
        out = np.empty(3 * n)
        if not self._store.solve(np.ascontiguousarray(rhs).reshape(-1), out):
            raise ValueError("rhs holds NaN or infinity")
        return out.reshape(n, 3)

    @property
    def log_determinant(self) -> float:
        """log det(Omega + damping diag(Omega))."""
        self._check()
        return self._store.log_determinant()

    def diagonal_covariances(self) -> NDArray[np.float64]:
        """Diagonal blocks (n, 3, 3) of Omega^-1: the marginal covariance of every node.

        Selected inversion on the pattern of L (Takahashi, Fagan & Chen 1973; Erisman & Tinney 1975), kept until the
        next factorisation; Omega^-1 itself is never formed except by the dense method.
        """
        self._check()
        if self._diagonal is None:
            self._diagonal = self._store.invert()
        return self._diagonal.copy()

    def covariance(self, i: int, j: int) -> NDArray[np.float64]:
        """Block (i, j) (3, 3) of Omega^-1: read where the pattern of L has it, else by a solve.

        Raises:
            IndexError: no such node.
        """
        self._check()
        n = self.symbolic.layout.order.size
        if not (0 <= i < n and 0 <= j < n):
            raise IndexError(f"nodes {i} and {j}: the graph has {n}")
        if self._diagonal is not None:
            block = self._store.inverse_block(i, j)
            if block is not None:
                return block
        unit = np.zeros((n, 3, 3))
        unit[j] = np.eye(3)
        return self.solve(unit)[i].copy()

    def covariances_between(self, first: NDArray[Any], second: NDArray[Any]) -> NDArray[np.float64]:
        """The blocks (E, 3, 3) of Omega^-1 in rows ``first`` and columns ``second`` (E,), such as the nodes of edges."""
        first, second = np.asarray(first, dtype=np.int64), np.asarray(second, dtype=np.int64)
        self.diagonal_covariances()
        blocks = self._store.inverse_pairs(first, second)
        if blocks is None:
            blocks = np.array([self.covariance(i, j) for i, j in zip(first.tolist(), second.tolist())]).reshape(
                -1, 3, 3
            )
        return blocks

    def joint_covariance(self, nodes: NDArray[Any]) -> NDArray[np.float64]:
        """The covariance (3 k, 3 k) of nodes (k,) together: read where the pattern of L has it, else by solves.

        An ``ordering`` that ends with these nodes makes their blocks part of the pattern where the graph is connected.
        """
        nodes = np.asarray(nodes, dtype=np.int64)
        self.diagonal_covariances()
        blocks = self._store.inverse_blocks(nodes)
        if blocks is None:
            units = np.zeros((self.symbolic.layout.order.size, 3, nodes.size, 3))
            units[nodes, :, np.arange(nodes.size), :] = np.eye(3)
            blocks = self.solve(units.reshape(len(units), 3, -1)).reshape(units.shape)[nodes]
        return blocks.reshape(3 * nodes.size, 3 * nodes.size)


@njit(cache=True, error_model="numpy")
def _pattern_fault(indptr, indices):
    """The first column whose rows do not ascend to the diagonal, or -1."""
    for j in range(indptr.size - 1):
        previous = -1
        for p in range(indptr[j], indptr[j + 1]):
            if indices[p] <= previous:
                return j
            previous = indices[p]
        if previous != j:
            return j
    return -1


def analyze(
    indptr: NDArray[Any],
    indices: NDArray[Any],
    *,
    ordering: NDArray[Any] | None = None,
    method: Literal["auto", "supernodal", "dense"] = "auto",
) -> Symbolic:
    """Symbolic analysis of a symmetric positive definite matrix of 3x3 blocks.

    Args:
        indptr: (n+1,) column pointers of the upper triangle in block-CSC.
        indices: (nnzb,) row nodes i <= j, ascending in each column j, the diagonal last.
        ordering: an elimination order (n,); default: that of `fill_reducing`.
        method: ``"auto"`` chooses between the two others by the fill and the size of the matrix.

    Raises:
        ValueError: malformed pattern or order.
    """
    indptr = np.ascontiguousarray(indptr, dtype=np.int64)
    indices = np.ascontiguousarray(indices, dtype=np.int32)  # one type, one compilation
    n = indptr.size - 1
    # the compiled loops trust their indices: rows must ascend in each column, so that (column, row) ascends as a whole
    if n < 1 or indptr[0] != 0 or indptr[-1] != indices.size or np.any(np.diff(indptr) < 1):
        raise ValueError("the pattern needs at least one node, and at least the diagonal in every column")
    if (fault := _pattern_fault(indptr, indices)) >= 0:
        raise ValueError(f"column {fault}: rows must ascend and end with the diagonal")
    if ordering is None:
        order = fill_reducing(indptr, indices)
    else:
        order = np.ascontiguousarray(ordering, dtype=np.int32)
        if not np.array_equal(np.sort(order), np.arange(n)):
            raise ValueError(f"ordering must be a permutation of {n} nodes")
    structure = layout(n, indptr, indices, order)
    if method == "auto":
        # Times on cliques with two idle cores, LAPACK and supernodes: 200 nodes 1.9 and 1.6 ms, 350 nodes 8 ms both,
        # 700 nodes 43 and 75 ms, 2,000 nodes 0.78 and 1.7 s. On busy cores LAPACK with its two threads may take ten
        # times as long, so it is used only where it gains much. The factor 1.5 accounts for the threads.
        # An up-looking factorisation for thin graphs was tried and rejected: against the supernodes INTEL took 0.105
        # and 0.118 ms, but 77 nodes 0.025 and 0.015 ms, M3500 1.30 and 0.69 ms, city10000 14.0 and 3.9 ms.
        large = n >= 700 and 9.0 * n**3 < 1.5 * structure.flops
        method = "dense" if large else "supernodal"
    return Symbolic(indptr, indices, structure, method)
