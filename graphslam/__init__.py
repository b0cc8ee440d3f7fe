"""Planar graph SLAM with virtual-motion edges: logs, models, graphs, the hand-written solver and the GTSAM one."""

from . import textbook
from .errors import FactorError, FormatError, GraphError, LogError, OptionError, SlamError
from .formats import load, save
from .gnc import solve_gnc
from .graph import Graph
from .gtsam_solver import solve_with_gtsam
from .log import Log
from .mapping import LandmarkMap, estimate_map
from .models import MotionModel, SensorModel
from .online import IncrementalSmoother, solve_online
from .robust import Cauchy, GemanMcClure, Huber
from .simulator import MotionFaults, SensorFaults, simulate
from .solution import Solution
from .solver import Iteration, solve
from .worlds import WORLDS, sample_log_path

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
