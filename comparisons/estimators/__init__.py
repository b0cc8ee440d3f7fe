"""The estimators by name, and how one of them is run."""

from .estimators import (
    ESTIMATORS,
    Estimator,
    check_estimators,
    default_estimators,
    isam2_options,
    make_graph,
    online_keywords,
    online_steps,
    pair_count,
    warm_up,
)

__all__ = [
    "ESTIMATORS",
    "Estimator",
    "check_estimators",
    "default_estimators",
    "isam2_options",
    "make_graph",
    "online_keywords",
    "online_steps",
    "pair_count",
    "warm_up",
]
