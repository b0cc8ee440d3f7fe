"""Factorisation of Omega."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from .information import BlockSystem
from .se2 import Array


class Factor:
    def __init__(self, omega: sp.csc_matrix) -> None:
        self.lu = splu(omega, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})

    def solve(self, xi: Array) -> Array:
        return self.lu.solve(xi.ravel()).reshape(-1, 3)

    def inverse_diagonal(self) -> Array:
        n = self.lu.shape[0]
        inv = self.lu.solve(np.eye(n))
        return np.array([inv[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(n // 3)])


def factorize(system: BlockSystem, damping: float = 0.0) -> Factor:
    omega = system.to_sparse()
    if damping:
        omega = (omega + sp.diags(damping * omega.diagonal())).tocsc()
    return Factor(omega)
