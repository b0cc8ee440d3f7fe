"""Robust kernels: what replaces the square of a residual that a wrong sighting may have made large.

An edge with squared Mahalanobis norm r² = e' Omega e costs 2 rho(r) in place of r², and enters Omega and xi with its
information times the weight w(r) = rho'(r) / r (iteratively re-weighted least squares). GTSAM's ``noiseModel.Robust``
has the same rho and w, and its error is J/2.

Source: Zhang, *Parameter estimation techniques: a tutorial with application to conic fitting*, 1997.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from ..checks import check_choice, check_positive
from ..errors import OptionError
from ..se2 import Array

SQUARES, HUBER, CAUCHY, GEMAN_MCCLURE = 0, 1, 2, 3


@dataclass(frozen=True)
class Kernel:
    """rho and w of one kind, with a width c in standard deviations; use `Huber`, `Cauchy` or `GemanMcClure`.

    Raises:
        OptionError: the width is not positive.
    """

    width: float
    code: ClassVar[int] = SQUARES
    name: ClassVar[str] = "squares"

    def __post_init__(self) -> None:
        check_positive(width=self.width)

    def loss(self, squares: ArrayLike) -> Array:
        """2 rho(r), from r² of any shape."""
        return _losses(self.code, self.width, np.asarray(squares, dtype=float))

    def weight(self, squares: ArrayLike) -> Array:
        """w(r) = rho'(r) / r, from r² of any shape."""
        return _weights(self.code, self.width, np.asarray(squares, dtype=float))


@dataclass(frozen=True)
class Huber(Kernel):
    """rho = r²/2 up to c, then c (r - c/2): an outlier pulls, but no harder the farther it is.

    The default width keeps 95 % of the efficiency of least squares where the noise is Gaussian.
    """

    width: float = 1.345
    code: ClassVar[int] = HUBER
    name: ClassVar[str] = "huber"


@dataclass(frozen=True)
class Cauchy(Kernel):
    """rho = c²/2 log(1 + r²/c²): an outlier pulls less the farther it is. Default width: 95 % efficiency."""

    width: float = 2.3849
    code: ClassVar[int] = CAUCHY
    name: ClassVar[str] = "cauchy"


@dataclass(frozen=True)
class GemanMcClure(Kernel):
    """rho = c²/2 r² / (c² + r²): a far outlier does not pull at all."""

    width: float = 1.0
    code: ClassVar[int] = GEMAN_MCCLURE
    name: ClassVar[str] = "geman-mcclure"


#: the kernels by name, with their default widths
KERNELS: dict[str, Kernel] = {kernel.name: kernel for kernel in (Huber(), Cauchy(), GemanMcClure())}


def kernel_of(kernel: Kernel | str | None) -> Kernel | None:
    """A kernel given by name ("huber", "cauchy", "geman-mcclure"), itself, or None for plain squares.

    Raises:
        OptionError: there is no such kernel.
    """
    if isinstance(kernel, str):
        check_choice("kernel", kernel, tuple(KERNELS))
        return KERNELS[kernel]
    if kernel is not None and not isinstance(kernel, Kernel):
        raise OptionError(f"kernel must be Huber(), Cauchy(), GemanMcClure(), a name or None, not {kernel!r}")
    return kernel


def code_and_width(kernel: Kernel | None) -> tuple[int, float]:
    """What the numeric kernels of the edges are told: (0, 1) for plain squares."""
    return (SQUARES, 1.0) if kernel is None else (kernel.code, kernel.width)


@njit(cache=True, error_model="numpy")
def loss(code, c, squares):  # type: ignore[no-untyped-def]
    """2 rho(r) of one edge, from r²."""
    if code == HUBER and squares > c * c:
        return 2 * c * np.sqrt(squares) - c * c
    if code == CAUCHY:
        return c * c * np.log1p(squares / (c * c))
    if code == GEMAN_MCCLURE:
        return c * c * squares / (c * c + squares)
    return squares


@njit(cache=True, error_model="numpy")
def weight(code, c, squares):  # type: ignore[no-untyped-def]
    """w(r) of one edge, from r²."""
    if code == HUBER and squares > c * c:
        return c / np.sqrt(squares)
    if code == CAUCHY:
        return c * c / (c * c + squares)
    if code == GEMAN_MCCLURE:
        return (c * c / (c * c + squares)) ** 2
    return 1.0


@njit(cache=True)
def _losses(code, c, squares):  # type: ignore[no-untyped-def]
    out = np.empty(squares.shape)
    for k in range(squares.size):
        out.flat[k] = loss(code, c, squares.flat[k])
    return out


@njit(cache=True)
def _weights(code, c, squares):  # type: ignore[no-untyped-def]
    out = np.empty(squares.shape)
    for k in range(squares.size):
        out.flat[k] = weight(code, c, squares.flat[k])
    return out
