"""Noise models from data: by maximum likelihood where the truth is known, from a solved graph's residuals where not."""

from .calibrate import SOURCES, Calibration, calibrate

__all__ = ["SOURCES", "Calibration", "calibrate"]
