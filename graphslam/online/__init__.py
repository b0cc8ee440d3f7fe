"""Graph SLAM while the robot drives: one interface for the project's own solver and for GTSAM's ISAM2."""

from .replay import replay, solve_online
from .solver import OnlineSolver

__all__ = ["OnlineSolver", "replay", "solve_online"]
