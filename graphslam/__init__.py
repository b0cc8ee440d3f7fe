"""Planar graph SLAM with virtual-motion edges: logs, models, graphs, the hand-written solver and the GTSAM one."""

from .errors import FormatError, GraphError, LogError, OptionError, SlamError
from .formats import load, save
from .log import Log
from .models import MotionModel, SensorModel
from .simulator import MotionFaults, SensorFaults, simulate

__all__ = [
    "FormatError",
    "GraphError",
    "Log",
    "LogError",
    "MotionFaults",
    "MotionModel",
    "OptionError",
    "SensorFaults",
    "SensorModel",
    "SlamError",
    "load",
    "save",
    "simulate",
]
