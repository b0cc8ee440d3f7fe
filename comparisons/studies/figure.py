"""The figure of a study: medians with their intervals, and beside them the paired differences."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..plots import paper_figure, style_of
from .bootstrap import Median
from .summary import ALL, METRICS, Summary

#: with more logs than this only the group of all logs is drawn
MOST_LOGS = 6


def study_figure(summary: Summary, metric: str = "ate_m") -> Figure:
    """One row of panels per log; left the medians of ``metric``, right what each method differs from the baseline by.

    Bars are 95 % bootstrap intervals. In the right panel a bar that does not touch zero is a difference that the seeds
    do not explain.
    """
    logs = [log for log in dict.fromkeys(line.log for line in summary.methods) if log != ALL]
    if len(logs) > MOST_LOGS:
        logs = [ALL]
    names = list(dict.fromkeys(line.method for line in summary.methods))
    height = len(logs) * (0.45 + 0.2 * len(names)) + 0.4
    with paper_figure((7.16, max(2.0, height))) as figure:
        panels = figure.subplots(len(logs), 2, squeeze=False, sharey="row", sharex="col")
        for (left, right), log in zip(panels, logs, strict=True):
            medians = {line.method: line.figures[metric] for line in summary.methods if line.log == log}
            gaps = {line.method: line.figures[metric] for line in summary.differences if line.log == log}
            _draw(left, names, medians)
            _draw(right, names, gaps)
            right.axvline(0.0, color="0.4", linewidth=0.8)
            left.set_title(log)
            left.set_yticks(range(len(names)), names)
            left.set_ylim(len(names) - 0.5, -0.5)
        panels[-1, 0].set_xlabel(METRICS[metric])
        panels[-1, 1].set_xlabel(f"difference from {summary.baseline}, same seeds: {METRICS[metric]}")
    return figure


def _draw(axes: Axes, names: list[str], medians: dict[str, Median | None]) -> None:
    for height, name in enumerate(names):
        if (found := medians.get(name)) is None:
            continue
        color = style_of(name.split()[0], 1)["color"]
        if found.low is not None and found.high is not None:
            axes.plot([found.low, found.high], [height, height], color=color, linewidth=2.0, solid_capstyle="butt")
        axes.plot([found.median], [height], color=color, marker="o", markeredgecolor="black", linestyle="none")
