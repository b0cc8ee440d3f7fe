"""Robust kernels: functions that replace the square of a residual, so that wrong sightings have less influence.

An edge with squared Mahalanobis norm r² = e' Omega e costs 2 rho(r) in place of r², and enters Omega and xi with its
information times the weight w(r) = rho'(r) / r (iteratively re-weighted least squares). GTSAM's ``noiseModel.Robust``
has the same rho and w, and its error is J/2.

A kernel has a price where the noise is Gaussian. With residuals e ~ N(0, Omega^-1) of dimension d, r² is chi-square
distributed with d degrees of freedom. The expected slope of the pull w e is b Omega and its covariance a Omega,

    b = E[w r²] / d,   a = E[w² r²] / d,

so the estimate has the covariance (b Omega)^-1 a Omega (b Omega)^-1 (the sandwich): that of least squares, divided by
the efficiency b²/a. The default width of every kernel is the one with `EFFICIENCY` for the dimension of its residuals:

    d              1      2      3
    Huber          1.345  1.501  1.628
    Cauchy         2.385  2.549  2.666
    Geman-McClure  3.785  4.096  4.337

Sources: Zhang, *Parameter estimation techniques: a tutorial with application to conic fitting*, 1997; Huber, *Robust
statistics*, 1981, chapters 3 and 7 (efficiency, covariance).

`DoubtedEdges`, the base of all edges that may come from a wrong measurement: a robust kernel, and a trust in each.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from ..engine import engine
from ..errors import OptionError, checks, quoted
from ..se2 import Array
from .base import EdgeFamily, check_rows

SQUARES, HUBER, CAUCHY, GEMAN_MCCLURE = 0, 1, 2, 3


#: the efficiency of the default widths where the noise is Gaussian, as a part of that of least squares
EFFICIENCY = 0.95


@dataclass(frozen=True)
class Kernel:
    """rho and w of one kind; use `Huber`, `Cauchy` or `GemanMcClure`.

    Args:
        width: c in standard deviations; default: the one with `EFFICIENCY` for the dimension of the residuals.

    Raises:
        OptionError: the width is not positive.
    """

    width: float | None = None
    code: ClassVar[int] = SQUARES
    name: ClassVar[str] = "squares"

    def __post_init__(self) -> None:
        if self.width is not None:
            checks.check_positive(width=self.width)

    def of_dimension(self, dimension: int) -> Self:
        """This kernel with a width, for residuals of a dimension."""
        return self if self.width is not None else replace(self, width=efficient_width(self, dimension))

    def scaled(self, factor: float) -> Self:
        """The kernel whose rho of ``factor`` r² is ``factor`` times this kernel's rho of r²."""
        return replace(self, width=self._checked_width * factor**0.5)

    def efficiency(self, dimension: int) -> float:
        """b²/a: the variance of least squares over that of the kernel's estimate, for Gaussian noise."""
        r2, parts = _gaussian_squares(dimension)
        w = self.of_dimension(dimension).weight(r2)
        return float((parts @ (w * r2)) ** 2 / (dimension * (parts @ (w * w * r2))))

    def information_per_weight(self, dimension: int) -> float:
        """b²/a / E[w]: what turns w Omega of an edge into the information that its residual contributes to an estimate.

        On average over edges with Gaussian noise this is b²/a Omega. An edge without weight contributes nothing.
        """
        r2, parts = _gaussian_squares(dimension)
        return self.efficiency(dimension) / float(parts @ self.of_dimension(dimension).weight(r2))

    def mean_loss(self, dimension: int) -> float:
        """E[2 rho(r)] for Gaussian noise; d for plain squares."""
        r2, parts = _gaussian_squares(dimension)
        return float(parts @ self.of_dimension(dimension).loss(r2))

    def share_below(self, least: float, dimension: int) -> float:
        """The share of residuals with a weight below ``least`` where the noise is Gaussian."""
        r2, parts = _gaussian_squares(dimension)
        return float(parts @ (self.of_dimension(dimension).weight(r2) < least))

    def loss(self, squares: ArrayLike) -> Array:
        """2 rho(r), from r² of any shape.

        Raises:
            OptionError: the kernel has no width.
        """
        r2 = np.asarray(squares, dtype=float)
        return engine.robust_loss(self.code, self._checked_width, r2).reshape(r2.shape)

    def weight(self, squares: ArrayLike) -> Array:
        """w(r) = rho'(r) / r, from r² of any shape.

        Raises:
            OptionError: the kernel has no width.
        """
        r2 = np.asarray(squares, dtype=float)
        return engine.robust_weight(self.code, self._checked_width, r2).reshape(r2.shape)

    @property
    def _checked_width(self) -> float:
        if self.width is None:
            raise OptionError(f"{type(self).__name__}() has no width without the dimension: use of_dimension(2 or 3)")
        return self.width


@dataclass(frozen=True)
class Huber(Kernel):
    """rho = r²/2 up to c, then c (r - c/2): the gradient of an outlier does not grow with its distance."""

    code: ClassVar[int] = HUBER
    name: ClassVar[str] = "huber"


@dataclass(frozen=True)
class Cauchy(Kernel):
    """rho = c²/2 log(1 + r²/c²): the pull of an outlier falls with its distance."""

    code: ClassVar[int] = CAUCHY
    name: ClassVar[str] = "cauchy"


@dataclass(frozen=True)
class GemanMcClure(Kernel):
    """rho = c²/2 r² / (c² + r²): a distant outlier has no influence."""

    code: ClassVar[int] = GEMAN_MCCLURE
    name: ClassVar[str] = "geman-mcclure"


#: the kernels by name, without widths: these follow from the dimension of the residuals
KERNELS: dict[str, Kernel] = {kernel.name: kernel for kernel in (Huber(), Cauchy(), GemanMcClure())}


def kernel_of(kernel: Kernel | str | None) -> Kernel | None:
    """A kernel given by name ("huber", "cauchy", "geman-mcclure"), itself, or None (also "none") for plain squares.

    Raises:
        OptionError: there is no such kernel.
    """
    if isinstance(kernel, str):
        checks.check_choice("kernel", kernel, ("none", *KERNELS))
        return KERNELS.get(kernel)
    if kernel is not None and (not isinstance(kernel, Kernel) or kernel.code == SQUARES):
        raise OptionError(f"kernel must be Huber(), Cauchy(), GemanMcClure(), a name or None, not {quoted(kernel)}")
    return kernel


def code_and_width(kernel: Kernel | None) -> tuple[int, float]:
    """The code and the width of a kernel, as the engine takes them; (0, 1) for plain squares."""
    return (SQUARES, 1.0) if kernel is None else (kernel.code, kernel._checked_width)


@cache
def _gaussian_squares(dimension: int) -> tuple[Array, Array]:
    """r² of 4,000 residuals, and the part of all residuals with Gaussian noise that each stands for (midpoint rule)."""
    r = (np.arange(4000) + 0.5) * (dimension**0.5 + 9) / 4000
    log_density = (dimension - 1) * np.log(r) - r**2 / 2
    density = np.exp(log_density - log_density.max())
    return r**2, density / density.sum()


@cache
def efficient_width(kernel: Kernel, dimension: int) -> float:
    """The width with `EFFICIENCY`, by bisection.

    Up to 9 dimensions the efficiency is below `EFFICIENCY` for small widths and above it for large ones. From some dimension
    on, 10 for Huber's kernel, it is above it at every width, so that none follows.

    Raises:
        OptionError: the dimension does not determine a width.
    """
    low, high = 0.01, 100.0 * dimension
    if replace(kernel, width=low).efficiency(dimension) >= EFFICIENCY:
        raise OptionError(f"the kernel has no default width for residuals of {dimension} numbers: give it a width")
    while high - low > 1e-12 * high:
        middle = (low + high) / 2
        small = replace(kernel, width=middle).efficiency(dimension) < EFFICIENCY
        low, high = (middle, high) if small else (low, middle)
    return (low + high) / 2


#: the least trust: a landmark all of whose sightings are wrong must still be somewhere
NO_TRUST: float = engine.LEAST_TRUST


@dataclass(frozen=True, eq=False, repr=False)
class DoubtedEdges(EdgeFamily):
    """Edges of measurements that may be wrong.

    ``kernel`` is the robust kernel of every edge, or None for plain squares; its default width is that for the dimension of
    a measurement. ``trust`` (M,) is a factor from 0 to 1 on the information of each measurement, or None for 1; graduated
    non-convexity sets it. 0 counts as `NO_TRUST`.
    """

    kernel: Kernel | None = field(default=None, kw_only=True)
    trust: Array | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        kernel = kernel_of(self.kernel)
        object.__setattr__(self, "kernel", None if kernel is None else kernel.of_dimension(self.dimension))
        if self.trust is not None:
            # the engine reads as many numbers as there are measurements
            check_rows(self, trust=(self.measurements,))

    @property
    @abstractmethod
    def dimension(self) -> int:
        """How many numbers a measurement has."""

    @property
    @abstractmethod
    def measurements(self) -> int:
        """The number M of measurements, each of which has its trust."""

    @property
    def numbers(self) -> tuple[int, float]:
        return self.dimension * self.measurements, self.dimension * float(np.sum(self.trusted))

    def with_trust(self, trust: Array | None) -> Self:
        """The same edges with another factor (M,) on the information of each measurement."""
        return replace(self, trust=trust)

    @cached_property
    def trusted(self) -> Array:
        """The trust (M,) that the edges work with."""
        return np.ones(self.measurements) if self.trust is None else np.maximum(self.trust, NO_TRUST)

    @property
    def information_per_weight(self) -> float:
        return 1.0 if self.kernel is None else self.kernel.information_per_weight(self.dimension)


class SingleEdges(DoubtedEdges):
    """Doubted edges with one measurement each, whose information (E, d, d) the trust multiplies."""

    information: Array

    @property
    def dimension(self) -> int:
        return self.information.shape[1]

    @property
    def measurements(self) -> int:
        return self.count

    @cached_property
    def weighed(self) -> Array:
        """The information (E, d, d) times the trust."""
        return self.information if self.trust is None else self.information * self.trusted[:, None, None]

    def squares(self, state: Array) -> Array:
        """r² (E,) of every edge at a state, as if it were fully trusted."""
        return self.linearize(state, state).mahalanobis / self.trusted


def expected_cost(family: EdgeFamily) -> float:
    """The mean cost of the edges at the true state; a robust kernel lowers it even where the noise is Gaussian."""
    mean, kernel = family.numbers[1], getattr(family, "kernel", None)
    if kernel is None or not isinstance(family, DoubtedEdges):
        return mean
    return mean * float(kernel.mean_loss(family.dimension)) / family.dimension
