"""The numba kernels that are left: compile or load them before times are measured."""

from __future__ import annotations

import warnings
from contextlib import suppress
from functools import cache
from pathlib import Path

import numba

import fastslam
from graphslam import MotionModel, SensorModel, simulate

from .estimators import ESTIMATORS
from .options import RunOptions


def compiled() -> bool:
    """Whether numba has compiled kernels of this installation before."""
    folder = Path(numba.config.CACHE_DIR or Path(fastslam.__file__).parent)
    return any(folder.rglob("*.nbi"))


@cache
def warm_up(estimator: str) -> None:
    """Let an estimator compile or load its kernels on a tiny log, so that compiling is no part of its time.

    What goes wrong here shows again, with its message, when the estimator runs on the user's log.
    """
    for orientation in (True, False):
        log = simulate(steps=6, orientation=orientation)
        with suppress(Exception), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            ESTIMATORS[estimator].run(log, RunOptions.of(particles=2, motion=MotionModel(), sensor=SensorModel()))
