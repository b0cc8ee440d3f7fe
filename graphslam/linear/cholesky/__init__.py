"""Sparse Cholesky factorisation of symmetric positive definite matrices of 3x3 blocks."""

from .errors import SingularPivot
from .factor import Factor, Symbolic, analyze, symmetric
from .ordering import amd

__all__ = ["Factor", "SingularPivot", "Symbolic", "amd", "analyze", "symmetric"]
