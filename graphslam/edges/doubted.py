"""`DoubtedEdges`, the base of all edges that may come from a wrong measurement: a robust kernel, and a trust in each."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from ..se2 import Array
from .base import EdgeFamily
from .robust import Kernel

Self = TypeVar("Self", bound="DoubtedEdges")

#: the least trust: a landmark all of whose sightings are wrong must still be somewhere
NO_TRUST = 1e-9


class DoubtedEdges(EdgeFamily):
    """Edges of measurements that may be wrong.

    ``kernel`` is the robust kernel of every edge, or None for plain squares; its default width is that for the dimension of
    a measurement. ``trust`` (M,) is a factor from 0 to 1 on the information of each measurement, or None for 1; graduated
    non-convexity sets it. 0 counts as `NO_TRUST`.
    """

    kernel: Kernel | None
    trust: Array | None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.kernel is not None:
            object.__setattr__(self, "kernel", self.kernel.of_dimension(self.dimension))

    @property
    @abstractmethod
    def dimension(self) -> int:
        """How many numbers a measurement has."""

    @property
    @abstractmethod
    def measurements(self) -> int:
        """The number M of measurements, each of which has its trust."""

    def with_trust(self: Self, trust: Array | None) -> Self:
        """The same edges with another factor (M,) on the information of each measurement."""
        changes: dict[str, Any] = {"trust": trust}
        return replace(self, **changes)  # type: ignore[type-var]

    @cached_property
    def trusted(self) -> Array:
        """The trust (M,) that the edges work with."""
        return np.ones(self.measurements) if self.trust is None else np.maximum(self.trust, NO_TRUST)

    def kernel_weights(self, state: Array) -> Array:
        """The weight (E,) that the kernel gives each edge at a state, 1 without a kernel."""
        squares = self.linearize(state, state).mahalanobis
        return np.ones(len(squares)) if self.kernel is None else self.kernel.weight(squares)

    def weighted_cost(self, state: Array) -> float:
        if self.kernel is None:
            return self.cost(state, state)
        return float(self.linearize(state, state).mahalanobis @ self.kernel_weights(state))

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

    @property
    def numbers(self) -> tuple[int, float]:
        return self.dimension * self.count, self.dimension * float(np.sum(self.trusted))

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
