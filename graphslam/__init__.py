"""Planar graph SLAM with virtual-motion edges: logs, models, graphs, the hand-written solver and GTSAM's.

Public names are imported when they are first used, so that ``import graphslam`` takes no time and, for example, GTSAM
is loaded only by those who solve with it.
"""
# ruff: noqa: F401

from typing import TYPE_CHECKING

from .lazy import lazy_names

if TYPE_CHECKING:
    from . import edges, factors, formats, metrics, se2, textbook
    from .association import associate
    from .calibration import calibrate
    from .certificate import Certificate
    from .certify import certify
    from .continuous_time import control_path
    from .edges.robust import Cauchy, GemanMcClure, Huber
    from .errors import FactorError, FormatError, GraphError, LogError, OptionError, SlamError
    from .formats import load, save
    from .formats.synchronize import synchronize
    from .graph import Graph
    from .identification.robot import estimate_robot
    from .landmark_map import LandmarkMap
    from .localization import first_fix
    from .log import Log
    from .mapping import estimate_map
    from .measurements import AbsolutePositions, PoseRelations
    from .models import MotionModel, SensorModel
    from .online import OnlineSolver, solve_online
    from .sessions import join_logs
    from .simulation.drives import Drive
    from .simulation.simulator import simulate
    from .simulation.worlds import World, sample_log_path
    from .solution import Solution
    from .solvers.gtsam_solver import solve_with_gtsam
    from .solvers.many import solve_many
    from .solvers.solve import solve
    from .sources.streams import Stream

#: the public names, by the module that defines them; "" lists modules
_PUBLIC = {
    "": "edges factors formats metrics se2 textbook",
    "association": "associate",
    "calibration": "calibrate",
    "certificate": "Certificate",
    "certify": "certify",
    "continuous_time": "control_path",
    "edges.robust": "Cauchy GemanMcClure Huber",
    "errors": "FactorError FormatError GraphError LogError OptionError SlamError",
    "formats": "load save",
    "graph": "Graph",
    "identification.robot": "estimate_robot",
    "localization": "first_fix",
    "log": "Log",
    "landmark_map": "LandmarkMap",
    "mapping": "estimate_map",
    "measurements": "AbsolutePositions PoseRelations",
    "models": "MotionModel SensorModel",
    "online": "OnlineSolver solve_online",
    "solution": "Solution",
    "solvers.gtsam_solver": "solve_with_gtsam",
    "solvers.many": "solve_many",
    "solvers.solve": "solve",
    "simulation.drives": "Drive",
    "simulation.simulator": "simulate",
    "sources.streams": "Stream",
    "formats.synchronize": "synchronize",
    "sessions": "join_logs",
    "simulation.worlds": "World sample_log_path",
}
__getattr__, __dir__, __all__ = lazy_names(__name__, _PUBLIC)
