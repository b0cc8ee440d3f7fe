"""Sparse Cholesky factorisation of symmetric positive definite matrices of 3x3 blocks."""

from .choice import fill_reducing
from .errors import FactorizationError, NotFinite, SingularPivot
from .factor import Factor, Symbolic, analyze, symmetric
from .ordering import amd

__all__ = [
    "Factor",
    "FactorizationError",
    "NotFinite",
    "SingularPivot",
    "Symbolic",
    "amd",
    "analyze",
    "fill_reducing",
    "symmetric",
]
