"""Verified sparse Cholesky factorisation of Hermitian matrices of 2 x 2 complex blocks.

The pattern and the order of elimination are those of an information matrix (`information`, `cholesky`): column j has the
row nodes ``indices[indptr[j]:indptr[j+1]]`` <= j, the diagonal last, and block k is ``values[k]``. The engine factorises;
here are the bounds on rounding errors.

Source: Rump, *Verification of positive definiteness*, 2006.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..engine import engine
from ..threads import available_threads

#: the unit roundoff of double precision
ROUNDOFF = 2.0**-53


@dataclass(frozen=True, eq=False)
class HermitianSymbolic:
    """The structure of the factor of a matrix whose diagonal blocks are ``diagonal`` (n,)."""

    structure: Any
    diagonal: NDArray[Any]
    #: memory of an unused factor, to be used again: new memory takes a sixth of the time of a proof
    spare: list[Any] = field(default_factory=list)

    @cached_property
    def order(self) -> NDArray[Any]:
        """The node eliminated k-th, (n,)."""
        return self.structure.order

    @cached_property
    def rounding(self) -> NDArray[Any]:
        """c (n,) of each row in the order of elimination, see `factorize`."""
        return 2 * ROUNDOFF * (16.0 + 4 * self.structure.row_length)


@dataclass(frozen=True, eq=False)
class HermitianFactor:
    """L with L L^H = A, or the row at which a pivot was not positive.

    Attributes:
        negative: None, or a vector (n, 2) in node order with v^H A v <= 0 up to rounding; L is then incomplete.
        error: (n, 2) in node order, a bound on the rounding errors, see `factorize`.
    """

    symbolic: HermitianSymbolic
    factor: Any
    negative: NDArray[Any] | None
    error: NDArray[Any]

    def __del__(self) -> None:
        self.symbolic.spare[:] = [self.factor]

    def solve(self, rhs: NDArray[Any]) -> NDArray[Any]:
        """A^-1 rhs (n, 2), in node order."""
        out = np.empty(rhs.shape, dtype=np.complex128)
        self.factor.solve(np.ascontiguousarray(rhs, dtype=np.complex128), out)
        return out

    def square(self, rhs: NDArray[Any]) -> float:
        """A bound on rhs^H (A + diag(e))^-1 rhs for any e of at least `error`, rounding errors included.

        The computed x = L^-1 rhs solves L x = rhs - f exactly, with |f_i| <= c_i (|L| |x|)_i <= c_i sqrt(d_i) |x|, d the
        diagonal of L L^H. As `error` is at least c d, f adds at most |x| times the root of the sum of c.
        """
        lost = np.sqrt(2 * self.symbolic.rounding.sum())
        return float(self.factor.forward_square(np.ascontiguousarray(rhs, dtype=np.complex128)) * (1.001 + lost) ** 2)


def analyze_hermitian(indptr: NDArray[Any], indices: NDArray[Any], order: NDArray[Any]) -> HermitianSymbolic:
    """The structure of the factor for a pattern and an order of elimination (n,), which is changed to an equivalent one."""
    pattern = np.ascontiguousarray(indptr, dtype=np.int64), np.ascontiguousarray(indices, dtype=np.int32)
    order = np.ascontiguousarray(order, dtype=np.int32)
    structure = engine.analyze(*pattern, order, hermitian=True, threads=available_threads())
    return HermitianSymbolic(structure, pattern[0][1:] - 1)


def factorize(symbolic: HermitianSymbolic, values: NDArray[Any]) -> HermitianFactor:
    """The factor of blocks (nnzb, 2, 2), of which the diagonal ones are Hermitian.

    A row i of b blocks has c_i = 2 u (16 + 4 b): the real and the imaginary part of an entry of L L^H are sums of at most
    4 min(b_i, b_j) products, which are rounded together with as many additions and those of at most min(b_i, b_j) update
    matrices, in any order, so that its error is at most min(c_i, c_j) (|L| |L|^H)_ij. For every positive w these errors
    are, as a matrix, at most the diagonal matrix of the quotients (C |L| |L|^H C w)_i / w_i with C = diag(c)^1/2, because
    2 x y <= r x² + y² / r. ``error`` holds these quotients for w = diag(A)^-1/2.
    """
    values = np.ascontiguousarray(values, dtype=np.complex128)
    try:
        factor = symbolic.spare.pop()
    except IndexError:
        factor = engine.HermitianFactor(symbolic.structure)
    order, bad = symbolic.order, factor.factorize(values, 0.0)
    if bad >= 0:
        return HermitianFactor(symbolic, factor, factor.null_vector(bad), np.full((len(order), 2), np.inf))
    diagonal = values[symbolic.diagonal[order]][:, [0, 1], [0, 1]].real
    root = np.sqrt(symbolic.rounding)[:, None]
    weight = root / np.sqrt(diagonal)
    error = np.empty((len(order), 2))
    error[order] = 1.001 * root**2 * factor.magnitude_square(weight).reshape(-1, 2) / weight
    return HermitianFactor(symbolic, factor, None, error)
