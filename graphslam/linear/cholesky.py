"""Sparse Cholesky factorisation of symmetric positive definite matrices of 3x3 blocks: analyse, factorise, solve.

Nodes without a heading, points, have two numbers in the factor.

The engine computes (``engine/include/vmslam/sparse``): the structure once per graph, the factor once per iteration.
"""

from __future__ import annotations

from dataclasses import dataclass
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..engine import available_threads, engine

if TYPE_CHECKING:
    import scipy.sparse as sp

COMPONENTS = ("x", "y", "heading")


class FactorizationError(ValueError):
    """A matrix has no Cholesky factor; ``node`` is where."""

    node: int


class NotFinite(FactorizationError):
    """The matrix holds NaN or infinity.

    Attributes:
        node: column of the first such block, in node order.
    """

    def __init__(self, row: int, node: int) -> None:
        self.node = node
        super().__init__(f"values hold NaN or infinity in block ({row}, {node})")


class SingularPivot(FactorizationError):
    """A pivot vanished or was negative: the matrix is not positive definite.

    Attributes:
        node: node of the pivot, in node order.
        component: scalar component 0, 1 or 2 of that node.
        null_vector: (n, 3) direction, largest entry 1 in magnitude, along which x' Omega x is the bad pivot: zero up
            to rounding for a singular matrix, so the direction in which nothing holds the graph. Where the direction
            itself cannot be computed, it is the coordinate of the pivot.
    """

    def __init__(self, node: int, component: int, null_vector: NDArray[np.float64]) -> None:
        self.node = node
        self.component = component
        self.null_vector = null_vector
        super().__init__(
            f"the matrix is not positive definite: pivot of node {node}, component {component} "
            f"({COMPONENTS[component]}), is zero or negative; null_vector holds the direction"
        )


@dataclass(frozen=True, eq=False)
class Symbolic:
    """Symbolic analysis of a symmetric pattern of 3x3 blocks; made by :func:`analyze`, valid for any values.

    Attributes:
        indptr, indices: the pattern.
        structure: that of the factor, in the engine.
    """

    indptr: NDArray[Any]
    indices: NDArray[Any]
    structure: Any

    @property
    def order(self) -> NDArray[np.int32]:
        """(n,) the node eliminated k-th."""
        return self.structure.order

    @property
    def blocks(self) -> int:
        """The structural blocks of L, without the zeros of relaxed supernodes."""
        return self.structure.blocks

    def factorize(self, values: NDArray[Any], *, damping: float = 0.0) -> Factor:
        """A new factor of values on the pattern; see :meth:`Factor.refactorize`."""
        return Factor(self).refactorize(values, damping=damping)


def symmetric(indptr: NDArray[Any], indices: NDArray[Any], values: NDArray[Any]) -> sp.csc_matrix:
    """The whole matrix, both triangles (3n, 3n), of blocks in upper block-CSC."""
    import scipy.sparse as sp

    # the transpose of the upper blocks, column by column: rows are columns
    lower = sp.tril(sp.bsr_matrix((values.transpose(0, 2, 1), indices, indptr)))
    return (lower + sp.tril(lower, k=-1).T).tocsc()


class Factor:
    """Cholesky factor of Omega. ``refactorize`` reuses all memory for new values, while no other thread uses the factor."""

    def __init__(self, symbolic: Symbolic) -> None:
        self.symbolic = symbolic
        self._num_nodes = len(symbolic.indptr) - 1
        self._factor = engine.RealFactor(symbolic.structure)
        self._inverse: Any = None
        self._valid = False
        self._solving = Lock()

    def refactorize(self, values: NDArray[Any], *, damping: float = 0.0) -> Factor:
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
        self._inverse = None
        self._valid = False
        if (bad := self._factor.factorize(values, damping)) >= 0:
            self._raise(values, bad)
        self._valid = True
        return self

    def _raise(self, values: NDArray[np.float64], bad: int) -> None:
        # NaN and inf always end in a bad pivot, so that values need no check before
        finite = np.isfinite(values).all(axis=(1, 2))
        if not finite.all():
            p = int(np.argmin(finite))
            j = int(np.searchsorted(self.symbolic.indptr, p, side="right")) - 1
            raise NotFinite(int(self.symbolic.indices[p]), j)
        node, component = int(self.symbolic.order[bad // 3]), bad % 3
        vector = self._factor.null_vector(bad)
        if not np.isfinite(vector).all():
            vector = np.zeros_like(vector)
            vector[node, component] = 1.0
        raise SingularPivot(node, component, vector / np.abs(vector).max())

    @property
    def in_engine(self) -> Any:
        """The factor in the engine, to be overwritten there; this object is invalid until `refactorize`."""
        self._inverse, self._valid = None, False
        return self._factor

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
        n = self._num_nodes
        rhs = np.asarray(rhs, dtype=np.float64)
        if rhs.shape[:2] != (n, 3) or rhs.ndim not in (2, 3):
            raise ValueError(f"rhs must have shape ({n}, 3) or ({n}, 3, k), not {rhs.shape}")
        out = np.empty(rhs.shape)
        several = rhs.ndim == 3 and rhs.shape[2] != 1
        # the engine solves in memory of the factor, which a solution keeps for all threads
        with self._solving:
            finite = (self._factor.solve_columns if several else self._factor.solve)(np.ascontiguousarray(rhs), out)
        if not finite:
            raise ValueError("rhs holds NaN or infinity")
        return out

    @property
    def log_determinant(self) -> float:
        """log det(Omega + damping diag(Omega))."""
        self._check()
        return self._factor.log_determinant()

    def diagonal_covariances(self) -> NDArray[np.float64]:
        """Diagonal blocks (n, 3, 3) of Omega^-1: the marginal covariance of every node.

        Selected inversion on the pattern of L (Takahashi, Fagan & Chen 1973; Erisman & Tinney 1975), kept until the
        next factorisation; Omega^-1 itself is never formed.
        """
        self._check()
        if self._inverse is None:
            self._inverse = engine.SelectedInverse(self._factor)
        return self._inverse.diagonal()

    def covariance(self, i: int, j: int) -> NDArray[np.float64]:
        """Block (i, j) (3, 3) of Omega^-1: read where the pattern of L has it, else by a solve.

        Raises:
            IndexError: no such node.
        """
        self._check()
        return self._blocks(np.array([i]), np.array([j]))[0]

    def _blocks(self, rows: NDArray[Any], columns: NDArray[Any]) -> NDArray[np.float64]:
        """Blocks (E, 3, 3) of Omega^-1 in rows and columns (E,): read where the pattern of L has them, else by solves."""
        wrong = np.concatenate([rows, columns])
        wrong = wrong[(wrong < 0) | (wrong >= self._num_nodes)]
        if len(wrong):
            raise IndexError(f"there is no node {wrong[0]}: the graph has {self._num_nodes} nodes, numbered from 0")
        blocks = np.full((len(rows), 3, 3), np.nan) if self._inverse is None else self._inverse.pairs(rows, columns)
        missing = np.flatnonzero(np.isnan(blocks[:, 0, 0]))
        if len(missing):
            nodes, place = np.unique(columns[missing], return_inverse=True)
            units = np.zeros((self._num_nodes, 3, nodes.size, 3))
            units[nodes, :, np.arange(nodes.size), :] = np.eye(3)
            solved = self.solve(units.reshape(len(units), 3, -1)).reshape(units.shape)
            blocks[missing] = solved[rows[missing], :, place]
        return blocks

    def covariances_between(self, first: NDArray[Any], second: NDArray[Any]) -> NDArray[np.float64]:
        """The blocks (E, 3, 3) of Omega^-1 in rows ``first`` and columns ``second`` (E,), such as the nodes of edges."""
        self.diagonal_covariances()
        return self._blocks(np.asarray(first, dtype=np.int64), np.asarray(second, dtype=np.int64))

    def joint_covariance(self, nodes: NDArray[Any]) -> NDArray[np.float64]:
        """The covariance (3 k, 3 k) of nodes (k,) together: read where the pattern of L has it, else by solves.

        An ``ordering`` of `analyze` that ends with these nodes makes their blocks part of the pattern where the graph is
        connected.
        """
        nodes, k = np.asarray(nodes, dtype=np.int64), len(nodes)
        self.diagonal_covariances()
        blocks = self._blocks(np.repeat(nodes, k), np.tile(nodes, k)).reshape(k, k, 3, 3)
        return blocks.transpose(0, 2, 1, 3).reshape(3 * k, 3 * k)


def analyze(
    indptr: NDArray[Any],
    indices: NDArray[Any],
    *,
    ordering: NDArray[Any] | None = None,
    points: NDArray[Any] | None = None,
    check: bool = True,
) -> Symbolic:
    """Symbolic analysis of a symmetric positive definite matrix of 3x3 blocks.

    Args:
        indptr: (n+1,) column pointers of the upper triangle in block-CSC.
        indices: (nnzb,) row nodes i <= j, ascending in each column j, the diagonal last.
        ordering: an elimination order (n,); default: approximate minimum degree (Amestoy, Davis & Duff 1996), or nested
            dissection if it is better (``engine/include/vmslam/sparse``).
        points: the nodes whose third row and column are those of the identity, such as landmarks without heading. The
            factor leaves them out: solutions are zero there.
        check: whether the pattern is checked, which the engine trusts; not needed for one that the engine has made.

    Raises:
        ValueError: malformed pattern or order.
    """
    indptr, indices = np.ascontiguousarray(indptr, dtype=np.int64), np.ascontiguousarray(indices, dtype=np.int64)
    n = indptr.size - 1
    if check:
        # rows must ascend in each column, so that (column, row) ascends as a whole
        if n < 1 or indptr[0] != 0 or indptr[-1] != indices.size or np.any(np.diff(indptr) < 1):
            raise ValueError("the pattern needs at least one node, and at least the diagonal in every column")
        if (fault := engine.pattern_fault(indptr, indices)) >= 0:
            raise ValueError(f"column {fault}: rows must ascend and end with the diagonal")
    order = None
    if ordering is not None:
        order = np.ascontiguousarray(ordering, dtype=np.int32)
        if not np.array_equal(np.sort(order), np.arange(n)):
            raise ValueError(f"ordering must be a permutation of {n} nodes")
    return Symbolic(indptr, indices, engine.analyze(indptr, indices, order, available_threads(), points))


class Bordered:
    """A system with K further unknowns y, which may touch all nodes; Omega keeps its sparse factor.

        [ Omega  C ] [x]   [a]        S = D - C' Omega^-1 C,   y = S^-1 (b - C' Omega^-1 a),   x = Omega^-1 (a - C y).
        [ C'     D ] [y] = [b],

    Args:
        factor: of Omega.
        mixed: C (n, 3, K).
        own: D (K, K).

    Attributes:
        reach: Omega^-1 C (n, 3, K).
        schur: S (K, K), whose inverse is the covariance of the further unknowns.
    """

    def __init__(self, factor: Factor, mixed: NDArray[Any], own: NDArray[Any]) -> None:
        self.factor, self.mixed, self.reach = factor, mixed, factor.solve(mixed)
        schur = own - np.einsum("nik,nil->kl", mixed, self.reach)
        self.schur = (schur + schur.T) / 2

    @property
    def covariance(self) -> NDArray[np.float64]:
        """S^-1 (K, K)."""
        return np.linalg.inv(self.schur)

    def solve(self, nodes: NDArray[Any], values: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """x and y for right-hand sides a (n, 3) and b (K,), or (n, 3, k) and (K, k)."""
        alone = self.factor.solve(nodes)
        y = np.linalg.solve(self.schur, values - np.einsum("nik,ni...->k...", self.mixed, alone))
        return alone - self.reach @ y, y
