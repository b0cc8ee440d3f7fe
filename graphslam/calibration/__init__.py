"""Noise models from data: by maximum likelihood with ground truth, from the residuals of a solved graph without."""

from .estimate import SOURCES, Calibration, calibrate

__all__ = ["SOURCES", "Calibration", "calibrate"]
