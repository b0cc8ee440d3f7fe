"""The estimators by name, and how one of them is run."""

from .estimators import ESTIMATORS as ESTIMATORS
from .estimators import Estimator as Estimator
from .estimators import check_estimators as check_estimators
from .estimators import default_estimators as default_estimators
from .estimators import isam2_options as isam2_options
from .estimators import make_graph as make_graph
from .estimators import online_keywords as online_keywords
from .estimators import online_steps as online_steps
from .estimators import pair_count as pair_count
from .estimators import warm_up as warm_up
