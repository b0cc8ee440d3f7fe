"""What the estimators found, in one form that tables, figures, reports, JSON and files read."""

from typing import TYPE_CHECKING

from graphslam.lazy import lazy_names

if TYPE_CHECKING:
    from .results import EstimatorResult as EstimatorResult
    from .results import Figures as Figures
    from .results import dead_reckoning_covariances as dead_reckoning_covariances
    from .results import noted as noted
    from .results import of_expected as of_expected
    from .results import sentence as sentence
    from .results import typical_costs as typical_costs

__getattr__, __dir__, __all__ = lazy_names(__name__)
