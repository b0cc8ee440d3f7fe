"""What the estimators found, in one form that tables, figures, reports, JSON and files read."""

from .results import EstimatorResult, dead_reckoning_covariances, noted, of_expected, sentence, typical_costs

__all__ = ["EstimatorResult", "dead_reckoning_covariances", "noted", "of_expected", "sentence", "typical_costs"]
