"""Compile the numba kernels ahead of their first use: ``python -m comparisons.kernels [--all]``.

numba compiles a function when it is first called and keeps the result beside the source. Without ``--all`` only those
that a comparison on a small log needs are compiled, because the others take longer. This is optional.
"""

from __future__ import annotations

import sys
import warnings
from contextlib import suppress
from functools import cache
from pathlib import Path

import numba

import fastslam
from graphslam import MotionModel, SensorModel, simulate

from .estimators import ESTIMATORS
from .options import RunOptions


def filters() -> None:
    """The particle filters."""
    from fastslam import FastSLAM1, FastSLAM2, MonteCarloLocalization
    from graphslam import load, sample_log_path

    log = load(sample_log_path())
    for kind in (MonteCarloLocalization, FastSLAM1, FastSLAM2):
        kind(log, particles=10).run()


def sampled_association() -> None:
    """FastSLAM that draws the landmarks of sightings without ids."""
    from fastslam import FastSLAM2
    from graphslam import load, sample_log_path

    FastSLAM2(load(sample_log_path()), particles=10, association="sampled", merge_interval=1).run()


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


def main() -> None:
    """Compile what a comparison needs, and with ``--all`` the rest, too."""
    filters()
    if "--all" in sys.argv[1:]:
        sampled_association()


if __name__ == "__main__":
    main()
