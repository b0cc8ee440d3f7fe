"""The map and the path in a terminal, while the online solver goes through a log step by step."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from graphslam import Log

from ..estimators import online_steps
from ..options import RunOptions
from .text_plots import plan

#: from one picture to the next [s]
EVERY = 0.2


def pictures(
    log: Log, options: RunOptions, *, width: int = 76, height: int = 24, every: float = EVERY
) -> Iterator[list[str]]:
    """Pictures of the estimate, each a list of lines: one every ``every`` seconds, and the last one.

    Raises:
        GraphError: the log lacks what the graph needs.
    """
    steps, drawn, begin = online_steps(log, options), -np.inf, time.perf_counter()
    spent: list[float] = []
    for solver in steps:
        now = time.perf_counter()
        spent.append(now - begin)
        if now - drawn >= every or solver.step == log.num_poses - 1:
            marks = np.array([mark[:2] for mark in solver.landmarks.values()]).reshape(-1, 2)
            lines = plan(solver.poses[:, :2], marks, width, height, ("estimated path", "landmark"))
            # the first steps of a process load compiled code
            pace = 1e3 * float(np.median(spent))
            yield [
                *lines,
                f"step {solver.step} of {log.num_poses - 1}, {len(marks)} landmarks, {pace:.2f} ms per step (median)",
            ]
            drawn = now
        begin = time.perf_counter()
