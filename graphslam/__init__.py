"""Planar graph SLAM with virtual-motion edges: logs, models, graphs, the hand-written solver and GTSAM's.

Public names are imported when they are first used, so that ``import graphslam`` takes no time and, for example, GTSAM
is loaded only by those who solve with it.
"""
# ruff: noqa: F401

from typing import TYPE_CHECKING

from .lazy import lazy_names

if TYPE_CHECKING:
    from . import edges, factors, formats, metrics, se2, textbook
    from .association import Ambiguity, Association, AssociationOptions, AssociationScore, associate
    from .calibration import Calibration, calibrate
    from .certificate import Certificate
    from .certify import certify
    from .continuous_time import ControlPath, control_path
    from .edges.robust import Cauchy, GemanMcClure, Huber
    from .errors import FactorError, FormatError, GraphError, LogError, OptionError, SlamError
    from .formats import load, save
    from .graph import Graph
    from .identification.robot import RobotEstimate, estimate_robot
    from .keyframes import with_poses_every
    from .landmark_map import LandmarkMap
    from .localization import Fix, first_fix
    from .log import Log
    from .mapping import estimate_map
    from .models import MotionModel, SensorModel
    from .online import OnlineSolver, solve_online
    from .parameters import PARAMETERS, Parameter, ParameterEstimate
    from .parameters.corrections import without_biases
    from .solution import Solution
    from .solvers.gnc import solve_gnc
    from .solvers.gtsam_solver import solve_with_gtsam
    from .solvers.many import solve_many
    from .solvers.solve import Iteration, solve
    from .sources.drives import Drive, DriveTruth
    from .sources.simulator import MotionFaults, SensorFaults, simulate
    from .sources.streams import Stream
    from .sources.synchronize import synchronize
    from .sources.worlds import WORLDS, World, sample_log_path
    from .tables import TableOptions

#: the public names, by the module that defines them; "" lists modules
_PUBLIC = {
    "": "edges factors formats metrics se2 textbook",
    "association": "Association AssociationOptions AssociationScore Ambiguity associate",
    "calibration": "Calibration calibrate",
    "certificate": "Certificate",
    "certify": "certify",
    "continuous_time": "ControlPath control_path",
    "edges.robust": "Cauchy GemanMcClure Huber",
    "errors": "FactorError FormatError GraphError LogError OptionError SlamError",
    "formats": "load save",
    "graph": "Graph",
    "identification.robot": "RobotEstimate estimate_robot",
    "keyframes": "with_poses_every",
    "localization": "Fix first_fix",
    "log": "Log",
    "landmark_map": "LandmarkMap",
    "mapping": "estimate_map",
    "models": "MotionModel SensorModel",
    "online": "OnlineSolver solve_online",
    "parameters": "PARAMETERS Parameter ParameterEstimate",
    "parameters.corrections": "without_biases",
    "solution": "Solution",
    "solvers.gnc": "solve_gnc",
    "solvers.gtsam_solver": "solve_with_gtsam",
    "solvers.many": "solve_many",
    "solvers.solve": "Iteration solve",
    "sources.drives": "Drive DriveTruth",
    "sources.simulator": "MotionFaults SensorFaults simulate",
    "sources.streams": "Stream",
    "sources.synchronize": "synchronize",
    "sources.worlds": "WORLDS World sample_log_path",
    "tables": "TableOptions",
}
__getattr__, __dir__, __all__ = lazy_names(__name__, _PUBLIC)
