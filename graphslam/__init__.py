"""Planar graph SLAM with virtual-motion edges: logs, models, graphs, the hand-written solver and GTSAM's.

Public names are imported when they are first used, so that ``import graphslam`` takes no time and, for example, GTSAM
is loaded only by those who solve with it.
"""
# ruff: noqa: F401

from typing import TYPE_CHECKING

from .lazy import lazy_names

if TYPE_CHECKING:
    from . import edges, factors, io, metrics, se2, textbook
    from .calibration import calibrate
    from .edges.robust import Cauchy, GemanMcClure, Huber
    from .errors import FactorError, FormatError, GraphError, LogError, OptionError, SlamError
    from .graph.build import estimate_map
    from .io.formats import load, save
    from .log import Log
    from .log.continuous_time import control_path
    from .log.measurements import AbsolutePositions, PartialSightings, PoseRelations
    from .log.streams import Stream, synchronize
    from .maps.landmark_map import LandmarkMap
    from .maps.localization import first_fix
    from .models import MotionModel, SensorModel
    from .online import OnlineSolver, solve_online
    from .sessions import Graph, join_logs
    from .simulation.drives import Drive
    from .simulation.simulator import simulate
    from .simulation.worlds import World, sample_log_path
    from .solvers.certificate import Certificate
    from .solvers.gtsam_certificate import certify
    from .solvers.gtsam_solver import solve_with_gtsam
    from .solvers.solution import Solution
    from .solvers.solve import solve, solve_many
    from .solvers.unknown_robot import estimate_robot

__getattr__, __dir__, __all__ = lazy_names(__name__)
