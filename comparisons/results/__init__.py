"""What the estimators found, in one form that tables, figures, reports, JSON and files read."""

# ruff: noqa: F401

from typing import TYPE_CHECKING

from graphslam.lazy import lazy_names

if TYPE_CHECKING:
    from .results import (
        EstimatorResult,
        Figures,
        dead_reckoning_covariances,
        noted,
        of_expected,
        sentence,
        typical_costs,
    )

__getattr__, __dir__, __all__ = lazy_names(__name__)
