"""Loading of estimators before their time is measured."""

from __future__ import annotations

import warnings
from contextlib import suppress
from functools import cache

from graphslam import MotionModel, SensorModel, simulate

from .estimators import ESTIMATORS
from .options import RunOptions


@cache
def warm_up(estimator: str) -> None:
    """Let an estimator import its modules on a tiny log, so that loading them is no part of its time.

    What goes wrong here shows again, with its message, when the estimator runs on the user's log.
    """
    for orientation in (True, False):
        log = simulate(steps=6, orientation=orientation)
        with suppress(Exception), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            ESTIMATORS[estimator].run(log, RunOptions.of(particles=2, motion=MotionModel(), sensor=SensorModel()))
