# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,no-any-return,call-arg,var-annotated"
"""Public classes: analyse once per graph, factorise once per iteration, solve."""

from typing import Any, Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .dense import DenseStore
from .errors import SingularPivot
from .multifrontal import MultifrontalStore
from .ordering import amd
from .symbolic import Layout, layout

Method = Literal["supernodal", "dense"]
# Smallest ratios of a pivot to its diagonal entry. Graphs that are held: INTEL 4e-11, a path of 10^5 poses held at one
# end 1e-10, CSAIL 1e-7, the others above 1e-6. Graphs that are not held: negative, or M3500 9e-14, CSAIL (badly scaled)
# 2e-11.
PIVOT_TOLERANCE = 1e-12


@njit(cache=True, error_model="numpy")
def _pattern_fault(n, indptr, indices):
    """Column in which the pattern is not an upper block-CSC with full diagonal, or -1."""
    if indptr[0] != 0 or indptr[n] != indices.size:
        return 0
    for j in range(n):
        low, high = indptr[j], indptr[j + 1]
        if high <= low or high > indices.size or indices[high - 1] != j:
            return j
        previous = -1
        for p in range(low, high):
            i = indices[p]
            if i <= previous:
                return j
            previous = i
    return -1


class Symbolic:
    """Symbolic analysis of a symmetric pattern of 3x3 blocks; made by :func:`analyze`, valid for any values.

    Attributes:
        n: number of nodes.
        method: ``"supernodal"`` or ``"dense"``.
        order: (n,) node eliminated k-th.
        blocks: 3x3 blocks of L in the lower triangle, without the zeros of relaxed supernodes.
        flops: operations of the factorisation, without those zeros.
        layout: the supernodal structure (unused by the dense method).
    """

    def __init__(self, indptr: NDArray[Any], indices: NDArray[Any], structure: Layout, method: Method) -> None:
        self.n = indptr.size - 1
        self.indptr = indptr
        self.indices = indices
        self.method: Method = method
        self.layout = structure
        self.order = structure.order if method == "supernodal" else np.arange(self.n, dtype=np.int32)
        self.blocks = int(structure.blocks)
        self.flops = float(structure.flops)

    def factorize(self, values: NDArray[Any], *, damping: float = 0.0, relative: bool = False) -> "Factor":
        """Cholesky factorisation Omega + damping = L L'.

        Args:
            values: (nnzb, 3, 3) blocks; of the diagonal blocks only the upper triangle is read.
            damping: lambda >= 0 of a Levenberg-Marquardt step.
            relative: add lambda diag(Omega) instead of lambda I.

        Raises:
            ValueError: wrong shape, values not finite, negative damping.
            SingularPivot: a pivot is not greater than 1e-12 times the diagonal entry it came from.
        """
        return Factor(self).refactorize(values, damping=damping, relative=relative)


class Factor:
    """Cholesky factor of Omega. ``refactorize`` reuses all memory for new values; not to be shared by threads."""

    def __init__(self, symbolic: Symbolic) -> None:
        self.symbolic = symbolic
        self._store: MultifrontalStore | DenseStore
        if symbolic.method == "dense":
            self._store = DenseStore(symbolic.n, symbolic.indptr, symbolic.indices)
        else:
            self._store = MultifrontalStore(symbolic.layout)
        self._diagonal: NDArray[np.float64] | None = None
        self._valid = False

    def refactorize(
        self,
        values: NDArray[Any],
        *,
        damping: float = 0.0,
        relative: bool = False,
        tolerance: float = PIVOT_TOLERANCE,
    ) -> "Factor":
        """Factorise new values on the same pattern in place; arguments and errors as :meth:`Symbolic.factorize`.

        Args:
            values: as there.
            damping: as there.
            relative: as there.
            tolerance: a pivot must be greater than this times its (damped) diagonal entry.
        """
        expected = (self.symbolic.indices.size, 3, 3)
        values = np.ascontiguousarray(values, dtype=np.float64)
        if values.shape != expected:
            raise ValueError(f"values must have shape {expected}, not {values.shape}")
        if not (damping >= 0.0 and np.isfinite(damping)):
            raise ValueError(f"damping must be finite and not negative, not {damping}")
        self._diagonal = None
        self._valid = False
        scaled, shift = (1.0 + damping, 0.0) if relative else (1.0, damping)
        bad = self._store.factorize(values.reshape(-1), tolerance, scaled, shift)
        if bad >= 0:
            self._raise(values, bad)
        self._valid = True
        return self

    def _raise(self, values: NDArray[np.float64], bad: int) -> None:
        # NaN and inf always end in a bad pivot, so that values need no check before
        finite = np.isfinite(values).all(axis=(1, 2))
        if not finite.all():
            p = int(np.argmin(finite))
            j = int(np.searchsorted(self.symbolic.indptr, p, side="right")) - 1
            raise ValueError(f"values hold NaN or infinity in block ({int(self.symbolic.indices[p])}, {j})")
        node, component = self._store.pivot_place(bad)
        vector = self._store.null_vector(bad)
        raise SingularPivot(node, component, vector / np.abs(vector).max())

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
        n = self.symbolic.n
        rhs = np.asarray(rhs, dtype=np.float64)
        if rhs.shape[:2] != (n, 3) or rhs.ndim not in (2, 3):
            raise ValueError(f"rhs must have shape ({n}, 3) or ({n}, 3, k), not {rhs.shape}")
        if not np.isfinite(rhs).all():
            raise ValueError("rhs holds NaN or infinity")
        if rhs.ndim == 3:
            return np.stack([self.solve(rhs[:, :, k]) for k in range(rhs.shape[2])], axis=2)
        out = np.empty(3 * n)
        self._store.solve(np.ascontiguousarray(rhs).reshape(-1), out)
        return out.reshape(n, 3)

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
        n = self.symbolic.n
        if not (0 <= i < n and 0 <= j < n):
            raise IndexError(f"nodes {i} and {j}: the graph has {n}")
        if self._diagonal is not None:
            block = self._store.inverse_block(i, j)
            if block is not None:
                return block
        unit = np.zeros((n, 3, 3))
        unit[j] = np.eye(3)
        return self.solve(unit)[i].copy()


def analyze(
    indptr: NDArray[Any],
    indices: NDArray[Any],
    *,
    ordering: Literal["amd", "natural"] | NDArray[Any] = "amd",
    method: Literal["auto", "supernodal", "dense"] = "auto",
) -> Symbolic:
    """Symbolic analysis of a symmetric positive definite matrix of 3x3 blocks.

    Args:
        indptr: (n+1,) column pointers of the upper triangle in block-CSC.
        indices: (nnzb,) row nodes i <= j, ascending in each column j, the diagonal last.
        ordering: ``"amd"``, ``"natural"`` or an elimination order (n,).
        method: ``"auto"`` chooses between the two others by the fill and the size of the matrix.

    Raises:
        ValueError: malformed pattern, order or method.
    """
    indptr = np.ascontiguousarray(indptr, dtype=np.int64)
    indices = np.ascontiguousarray(indices, dtype=np.int32)  # one type, one compilation
    if indptr.ndim != 1 or indices.ndim != 1 or indptr.size < 2:
        raise ValueError("indptr (n+1,) and indices (nnzb,) must be one-dimensional, with at least one node")
    n = indptr.size - 1
    fault = _pattern_fault(n, indptr, indices)
    if fault >= 0:
        raise ValueError(f"column {fault}: rows must ascend and end with the diagonal")
    if method not in ("auto", "supernodal", "dense"):
        raise ValueError(f"unknown method {method!r}")
    if isinstance(ordering, str):
        if ordering == "amd":
            order = amd(indptr, indices)
        elif ordering == "natural":
            order = np.arange(n, dtype=np.int32)
        else:
            raise ValueError(f"unknown ordering {ordering!r}")
    else:
        order = np.ascontiguousarray(ordering, dtype=np.int32)
        if order.shape != (n,) or not np.array_equal(np.sort(order), np.arange(n)):
            raise ValueError(f"ordering must be a permutation of {n} nodes")
    structure = Layout(*layout(n, indptr, indices, order))
    chosen: Method
    if method == "auto":
        # Times on cliques with two idle cores, LAPACK and supernodes: 200 nodes 1.9 and 1.6 ms, 350 nodes 8 ms both,
        # 700 nodes 43 and 75 ms, 2,000 nodes 0.78 and 1.7 s. On busy cores LAPACK with its two threads may take ten
        # times as long, so it is used only where it gains much. The factor 1.5 accounts for the threads.
        # An up-looking factorisation for thin graphs was tried and rejected: against the supernodes INTEL took 0.105
        # and 0.118 ms, but 77 nodes 0.025 and 0.015 ms, M3500 1.30 and 0.69 ms, city10000 14.0 and 3.9 ms.
        full = 9.0 * n**3
        chosen = "dense" if n >= 700 and full < 1.5 * structure.flops else "supernodal"
    else:
        chosen = "dense" if method == "dense" else "supernodal"
    return Symbolic(indptr, indices, structure, chosen)
