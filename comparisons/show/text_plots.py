"""Plots in plain characters: histograms, a path with landmarks seen from above, and that of the online solver."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from graphslam import Log
from graphslam.se2 import Array

from ..estimators import online_steps
from ..options import RunOptions

_EIGHTHS = " ▏▎▍▌▋▊▉█"


def bars(edges: Array, counts: np.ndarray, unit: str, width: int = 40) -> list[str]:
    """A line for each interval, its bar as long as its count."""
    most = max(int(np.max(counts, initial=0)), 1)
    low, high = ([f"{edge:.2f}" for edge in ends] for ends in (edges[:-1], edges[1:]))
    wide = max(map(len, (*low, *high)))
    lines = []
    for begin, end, count in zip(low, high, counts.tolist()):
        eighths = round(8 * width * count / most)
        bar = "█" * (eighths // 8) + (_EIGHTHS[eighths % 8] if eighths % 8 else "")
        lines.append(f"{begin:>{wide}} to {end:>{wide}} {unit}  {bar} {count}")
    return lines


def plan(
    path: Array,
    points: Array,
    width: int = 76,
    height: int = 24,
    names: tuple[str, str] = ("dead reckoning", "sighting"),
) -> list[str]:
    """A path (n, 2) of dots and points (m, 2) of crosses from above, with its size; S is the start.

    ``names`` are those of the dots and crosses.
    """
    everything = np.concatenate([path, points]) if len(points) else path
    low, high = path.min(axis=0), path.max(axis=0)
    # points far away must not make the path small
    room = max(float(np.max(high - low)), 4.0) / 2
    low, high = np.maximum(everything.min(axis=0), low - room), np.minimum(everything.max(axis=0), high + room)
    # a character is about twice as high as wide
    scale = max((high[0] - low[0]) / (width - 1), (high[1] - low[1]) / (height - 1) / 2, 1e-6)
    columns, rows = int((high[0] - low[0]) / scale) + 1, int((high[1] - low[1]) / (2 * scale)) + 1
    grid = [[" "] * columns for _ in range(rows)]
    for places, mark in ((points, "+"), (path, "·"), (path[:1], "S")):
        across = np.rint((places[:, 0] - low[0]) / scale).astype(int)
        down = rows - 1 - np.rint((places[:, 1] - low[1]) / (2 * scale)).astype(int)
        inside = (across >= 0) & (across < columns) & (down >= 0) & (down < rows)
        for x, y in zip(across[inside].tolist(), down[inside].tolist()):
            grid[y][x] = mark
    size = f"{high[0] - low[0]:.1f} m wide, {high[1] - low[1]:.1f} m high; S start, · {names[0]}, + {names[1]}"
    return [*("".join(row).rstrip() for row in grid), size]


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
