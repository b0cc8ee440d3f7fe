"""Noise models from data: by maximum likelihood with ground truth, by `estimate_robot` without."""

from .estimate import SOURCES, Calibration, calibrate

__all__ = ["SOURCES", "Calibration", "calibrate"]
