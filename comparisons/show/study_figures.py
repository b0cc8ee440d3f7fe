"""The figures of studies: particles, consistency, pose-graph solvers, and medians over logs and random seeds."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from graphslam import OptionError

from .canvas import WIDTH, as_text, colour_of, paper_figure, style_of
from .tables import PYTHON_FACTORS

if TYPE_CHECKING:
    from ..studies.backends import BackendComparison, BackendRow
    from ..studies.consistency import ConsistencyStudy
    from ..studies.particles import ParticleStudy
    from ..studies.summary import Median, Summary

#: with more logs than this only the group of all logs is drawn
MOST_LOGS = 6


@contextmanager
def _panels(count: int, **options: Any) -> Iterator[tuple[Figure, np.ndarray]]:
    """A figure with the given number of panels, three in a row."""
    columns, rows = min(count, 3), -(-count // 3)
    with paper_figure((WIDTH * columns / 3, 2.4 * rows)) as figure:
        panels = figure.subplots(rows, columns, squeeze=False, **options).ravel()
        for unused in panels[count:]:
            unused.set_visible(False)
        yield figure, panels


def particles_figure(study: ParticleStudy) -> Figure:
    """One panel per quantity over the number of particles: medians over the seeds, with bands between the quartiles."""
    from ..studies.particles import FIGURES

    names = study.names()
    known = [quantity for quantity in FIGURES if any(len(study.bands(name, quantity)[0]) for name in names)]
    with _panels(len(known), sharex=True) as (figure, panels):
        for axes, quantity in zip(panels, known):
            for name in names:
                numbers, quartiles = study.bands(name, quantity)
                if len(numbers):
                    axes.plot(numbers, quartiles[1], label=name, **style_of(name, len(numbers)))
                    axes.fill_between(numbers, *quartiles[::2], color=colour_of(name), alpha=0.2, linewidth=0)
            axes.set(xscale="log", yscale="log", title=FIGURES[quantity])
        for axes in panels[max(len(known) - 3, 0) : len(known)]:
            axes.set_xlabel("particles")
            axes.tick_params(labelbottom=True)
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(names))
    return figure


def consistency_figure(study: ConsistencyStudy) -> Figure:
    """ANEES / 3 over the steps, one line per estimator, on a logarithmic axis; 1 means consistent."""
    with paper_figure((WIDTH, 3.2)) as figure:
        axes = figure.subplots()
        axes.axhspan(*study.results[0].step_band, color="0.85", linewidth=0, label="95 % band")
        axes.axhline(1.0, color="0.4", linewidth=0.8)
        for result in study.results:
            label = result.name if result.anees is None else f"{result.name} (joint {result.anees:.2f})"
            axes.plot(np.arange(1, len(result.steps) + 1), result.steps, label=label, **style_of(result.name))
        axes.set(yscale="log", xlim=(1, study.steps), xlabel="step", ylabel="ANEES / 3")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_title(
            f"{study.logs} logs, {study.dimensions}-D sensor, {study.noise:g} times the book's noise: 1 means consistent"
        )
        figure.legend(loc="outside lower center", ncols=3)
    return figure


def backends_figure(comparison: BackendComparison) -> Figure:
    """chi2 above the best of its file over time, both on logarithmic axes, one panel per file.

    Raises:
        OptionError: no file was solved.
    """
    files = list(dict.fromkeys(row.file for row in comparison.rows))
    if not files:
        raise OptionError("there is nothing to draw: no file was solved")
    with _panels(len(files)) as (figure, panels):
        handles: dict[str, Any] = {}
        for panel, file in zip(panels, files):
            best = comparison.best(file)
            for row in (row for row in comparison.rows if row.file == file and len(row.trace) > 1):
                label = row.backend if row.native else f"{row.backend} ({PYTHON_FACTORS})"
                look = style_of(row.backend) | ({} if row.native else {"alpha": 0.5, "markerfacecolor": "none"})
                (handles[label],) = panel.plot(*_curve(row, best), **look)
            panel.set(xscale="log", yscale="log", title=as_text(Path(file).name), xlabel="time [s]")
        for panel in panels[::3]:
            panel.set_ylabel("relative excess of chi2 over the best")
        if handles:
            columns = min(len(handles), 1 + min(len(files), 3))
            figure.legend(handles.values(), handles, loc="outside lower center", ncols=columns)
    return figure


def _curve(row: BackendRow, best: float) -> tuple[list[float], list[float]]:
    # the first point, at time zero, has no place on a logarithmic axis; below 1e-10 all is rounding
    return [t for t, _ in row.trace[1:]], [max((cost - best) / max(best, 1e-300), 1e-10) for _, cost in row.trace[1:]]


def study_figure(summary: Summary, metric: str = "ate_m") -> Figure:
    """A row of panels per log: left the medians of the metric, right the differences from the baseline.

    Bars are 95 % bootstrap intervals. In the right panel a bar that does not touch zero is a difference that the seeds
    do not explain.

    Raises:
        OptionError: no run has been executed.
    """
    from ..studies.summary import ALL, METRICS

    logs = [log for log in dict.fromkeys(line.log for line in summary.methods) if log != ALL]
    if not logs:
        raise OptionError("there is nothing to draw: the study has no executed run")
    if len(logs) > MOST_LOGS:
        logs = [ALL]
    names = list(dict.fromkeys(line.method for line in summary.methods))
    with paper_figure((WIDTH, max(2.0, len(logs) * (0.45 + 0.2 * len(names)) + 0.4))) as figure:
        panels = figure.subplots(len(logs), 2, squeeze=False, sharey="row", sharex="col")
        for (left, right), log in zip(panels, logs):
            for axes, lines in ((left, summary.methods), (right, summary.differences)):
                _draw_medians(axes, names, {line.method: line.figures[metric] for line in lines if line.log == log})
            right.axvline(0.0, color="0.4", linewidth=0.8)
            left.set_title(as_text(log))
            left.set_yticks(range(len(names)), [as_text(name) for name in names])
            left.set_ylim(len(names) - 0.5, -0.5)
        everything = [line.figures[metric] for line in summary.methods if line.log in logs]
        if _decades(everything) > 1:
            # columns share their axis
            panels[-1, 0].set_xscale("log")
        panels[-1, 0].set_xlabel(METRICS[metric])
        panels[-1, 1].set_xlabel(
            f"difference from {as_text(str(summary.baseline))},\nsame random seeds: {METRICS[metric]}"
        )
    return figure


def _decades(medians: Collection[Median | None]) -> float:
    """The number of decades between the smallest and the largest median; 0 where a logarithmic axis cannot show one."""
    values = [median.median for median in medians if median is not None]
    ends = [end for m in medians if m is not None for end in (m.low, m.high) if end is not None]
    if not values or min([*values, *ends]) <= 0:
        return 0.0
    return float(np.log10(max(values) / min(values)))


def _draw_medians(axes: Axes, names: list[str], medians: Mapping[str, Median | None]) -> None:
    for height, name in enumerate(names):
        if (median := medians.get(name)) is None:
            continue
        color = colour_of(name.split()[0])
        if median.low is not None and median.high is not None:
            axes.plot([median.low, median.high], [height, height], color=color, linewidth=2.0, solid_capstyle="butt")
        axes.plot([median.median], [height], color=color, marker="o", markeredgecolor="black", linestyle="none")
