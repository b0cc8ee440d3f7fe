"""Planar graph SLAM with virtual-motion edges: logs, models, graphs, the hand-written solver and the GTSAM one."""

from . import textbook
from .edges.robust import Cauchy, GemanMcClure, Huber
from .errors import FactorError, FormatError, GraphError, LogError, OptionError, SlamError
from .formats import load, save
from .graph import Graph
from .log import Log
from .mapping import LandmarkMap, estimate_map
from .models import MotionModel, SensorModel
from .solution import Solution
from .solvers.gnc import solve_gnc
from .solvers.gtsam_solver import solve_with_gtsam
from .solvers.online import IncrementalSmoother, solve_online
from .solvers.solve import Iteration, solve
from .sources.simulator import MotionFaults, SensorFaults, simulate
from .sources.worlds import WORLDS, sample_log_path

__all__ = [
    "WORLDS",
    "Cauchy",
    "FactorError",
    "FormatError",
    "GemanMcClure",
    "Graph",
    "GraphError",
    "Huber",
    "IncrementalSmoother",
    "Iteration",
    "LandmarkMap",
    "Log",
    "LogError",
    "MotionFaults",
    "MotionModel",
    "OptionError",
    "SensorFaults",
    "SensorModel",
    "SlamError",
    "Solution",
    "estimate_map",
    "load",
    "sample_log_path",
    "save",
    "simulate",
    "solve",
    "solve_gnc",
    "solve_online",
    "solve_with_gtsam",
    "textbook",
]
