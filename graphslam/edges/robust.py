"""Robust kernels: functions that replace the square of a residual, so that wrong sightings have less influence.

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
        return np.vectorize(loss, otypes=[float])(self.code, self.width, squares)

    def weight(self, squares: ArrayLike) -> Array:
        """w(r) = rho'(r) / r, from r² of any shape."""
        return np.vectorize(weight, otypes=[float])(self.code, self.width, squares)


@dataclass(frozen=True)
class Huber(Kernel):
    """rho = r²/2 up to c, then c (r - c/2): the pull of an outlier does not grow with its distance.

    The default width keeps 95 % of the efficiency of least squares where the noise is Gaussian.
    """

    width: float = 1.345
    code: ClassVar[int] = HUBER
    name: ClassVar[str] = "huber"


@dataclass(frozen=True)
class Cauchy(Kernel):
    """rho = c²/2 log(1 + r²/c²): the pull of an outlier falls with its distance. Default width: 95 % efficiency."""

    width: float = 2.3849
    code: ClassVar[int] = CAUCHY
    name: ClassVar[str] = "cauchy"


@dataclass(frozen=True)
class GemanMcClure(Kernel):
    """rho = c²/2 r² / (c² + r²): a distant outlier has no influence."""

    width: float = 1.0
    code: ClassVar[int] = GEMAN_MCCLURE
    name: ClassVar[str] = "geman-mcclure"


#: the kernels by name, with their default widths
KERNELS: dict[str, Kernel] = {kernel.name: kernel for kernel in (Huber(), Cauchy(), GemanMcClure())}


def kernel_of(kernel: Kernel | str | None) -> Kernel | None:
    """A kernel given by name ("huber", "cauchy", "geman-mcclure"), itself, or None (also "none") for plain squares.

    Raises:
        OptionError: there is no such kernel.
    """
    if isinstance(kernel, str):
        check_choice("kernel", kernel, ("none", *KERNELS))
        return KERNELS.get(kernel)
    if kernel is not None and not isinstance(kernel, Kernel):
        raise OptionError(f"kernel must be Huber(), Cauchy(), GemanMcClure(), a name or None, not {kernel!r}")
    return kernel


def code_and_width(kernel: Kernel | None) -> tuple[int, float]:
    """The arguments of `loss` and `weight` for a kernel; (0, 1) for plain squares."""
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


@njit(cache=True, error_model="numpy")
def weight_slope(code, c, squares):  # type: ignore[no-untyped-def]
    """The derivative of w by r², never positive."""
    if code == HUBER and squares > c * c:
        return -0.5 * c / squares**1.5
    if code == CAUCHY:
        return -((c / (c * c + squares)) ** 2)
    if code == GEMAN_MCCLURE:
        return -2 * c**4 / (c * c + squares) ** 3
    return 0.0
