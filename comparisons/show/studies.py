"""Studies as tables and figures: particles, consistency, solvers, and medians over logs and random seeds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from rich.table import Table
from rich.text import Text

from graphslam import OptionError
from graphslam.metrics import headings as metric_headings

from ..options import METRICS
from .canvas import WIDTH, as_text, colour_of, logarithmic_from, paper_figure, style_of
from .tables import NOTHING, LeanTable, Tables, ended, number, optimum, seconds, written, yes_no

if TYPE_CHECKING:
    from ..studies.backends import BackendComparison
    from ..studies.consistency import ConsistencyStudy
    from ..studies.solvers import SolverComparison
    from ..studies.summary import Median, Summary
    from ..studies.sweep import ParticleStudy

#: with more logs than this only the group of all logs is drawn
MOST_LOGS = 6
#: how rows are marked whose time is that of callbacks
PYTHON_FACTORS = "Python"


def solver_tables(comparison: SolverComparison) -> Tables:
    """A row per variant; below, the variants that disagree, and those left out, by reason."""
    table = LeanTable(
        "hand-written solver against GTSAM", ["variant"],
        ["poses\ndiffer", "costs\ndiffer", "J per\ndof", "steps /\ngtsam", "time", "time of\ngtsam", "optimum", "of\ngtsam",
         "agree"],
    )  # fmt: skip
    for v in comparison.variants:
        table.add_row(
            v.name, f"{v.pose_difference:.1e}", f"{v.cost_difference:.1e}", number(v.cost_per_dof, 2),
            f"{v.iterations} / {v.gtsam_iterations}", seconds(v.seconds), seconds(v.gtsam_seconds), optimum(v.certificate),
            optimum(v.gtsam_certificate), yes_no(v.agree),
        )  # fmt: skip
    reasons: dict[str, list[str]] = {}
    for entry in comparison.skipped:
        reasons.setdefault(entry.reason, []).append(entry.name)
    remarks = [f"DIFFERENT: {problem}." for problem in comparison.problems]
    for reason, names in reasons.items():
        which = names[0] if len(names) == 1 else f"{len(names)} variants ({names[0]}, ...)"
        remarks.append(ended(f"{which} left out: {reason}"))
    if any(variant.cost_per_dof is not None for variant in comparison.variants):
        remarks.append("J per dof (degree of freedom): about 1 means that the noise models fit.")
    return [table], remarks


def backend_tables(comparison: BackendComparison) -> Tables:
    """A row per file and solver; below, mean ratios of the times, runs without the best chi2, and solvers left out."""
    table = LeanTable(
        "pose graphs: chi2 by one evaluator, time from the initial values until the stop rule holds",
        ["file", "solver"], ["chi2", "chi2\n/ dof", "best", "optimum", "iterations", "time", "ours /\ntheirs"],
    )  # fmt: skip
    previous, remarks = None, []
    for row in comparison.rows:
        ratio = comparison.ratio(row)
        table.add_row(
            Path(row.file).name if row.file != previous else "",
            row.backend if row.native else f"{row.backend} ({PYTHON_FACTORS})", number(row.chi2, 6),
            number(row.chi2_per_dof, 2), yes_no(comparison.reached(row)), optimum(row.certificate), str(row.iterations),
            seconds(row.seconds), NOTHING if ratio is None or row.backend == "graphslam" else f"1/{1 / ratio:.1f}",
        )  # fmt: skip
        previous = row.file
    for name, mean in comparison.geometric_means.items():
        if mean is not None:
            remarks.append(f"graphslam takes 1/{1 / mean:.1f} of the time of {name} (geometric mean).")
    if called := dict.fromkeys(row.backend for row in comparison.rows if not row.native):
        remarks.append(
            f"{', '.join(called)} ({PYTHON_FACTORS}): GTSAM has no factor of its own for the points of a pose graph. "
            "Python evaluates them, which takes most of the time, so these rows are in no mean."
        )
    fits = "chi2 / dof: per degree of freedom; about 1 means that the information in the file fits the errors."
    remarks += [fits] * any(row.chi2_per_dof is not None for row in comparison.rows)
    for row in comparison.rows:
        if not comparison.reached(row):
            remarks.append(f"{Path(row.file).name}: {row.backend} did not reach the best chi2: {row.reason}.")
    left_out: dict[tuple[str, str], list[str]] = {}
    for entry in comparison.skipped:
        left_out.setdefault((entry.file, entry.reason), []).append(entry.backend)
    for (file, reason), names in left_out.items():
        remarks.append(ended(f"{Path(file).name}: {', '.join(names)} left out: {reason}"))
    return [table], remarks


#: the metrics of a study's tables
_METRICS = metric_headings(studies=True, separator=" ")


#: error messages that are printed below a study
_MOST_ERRORS = 5


#: the figures of a study of particle filters
_OF_FILTERS = ("ate_m", "mean_ate_m", "landmark_rmse_m", "ess_share", "ancestors", "seconds")


def particle_tables(study: ParticleStudy) -> Tables:
    """Medians over the seeds, a row per filter and number of particles."""
    headings = ("particles", "ATE\n[m]", "ATE of\nmean [m]", "map\n[m]", "ESS / N", "ancestors", "time")
    table = LeanTable(f"{study.log}: medians over random seeds", ["filter"], headings)
    for name, lines in study.methods.items():
        for particles, line in lines.items():
            *values, ancestors, time = (None if (m := line.figures[each]) is None else m.median for each in _OF_FILTERS)
            table.add_row(name, str(particles), *(number(each) for each in values), number(ancestors, 0), seconds(time))
    return [table], [
        f"{run['method']} with the random seed {run['seed']} has no result: {run['error']}."
        for run in study.runs
        if run["status"] != "done"
    ]


def consistency_tables(study: ConsistencyStudy) -> Tables:
    """A row per estimator: the joint ANEES with its band, and that of its steps."""
    table = LeanTable(
        f"{study.logs} simulated logs of {study.steps} motions, {study.dimensions}-D sensor, {study.noise:g} times the "
        "book's noise: ANEES / degrees of freedom, 1 means consistent", ["estimator"],
        ["logs", "joint", "95 % band", "inside", "median\nof steps", "worst\nstep", "95 % band\nof a step", "steps\ninside"],
    )  # fmt: skip
    for r in study.results:
        joint = (number(r.anees), NOTHING if r.anees is None else _band(r.joint_band), yes_no(r.consistent))
        steps = number(float(np.median(r.steps))), number(float(np.max(r.steps)))
        table.add_row(r.name, str(r.logs), *joint, *steps, _band(r.step_band), written(r.steps_inside, ".0%"))
    failed = [r for r in study.results if r.failed]
    how = {r.name: "did not mix" if r.name == "particle-gibbs" else "failed" for r in failed}
    remarks = [f"{r.name} {how[r.name]} on {r.failed} of {study.logs} logs, which are not counted." for r in failed]
    if any(r.name == "particle-gibbs" for r in failed):
        remarks.append("Longer chains mix on more logs: --gibbs-warm-up, --gibbs-iterations.")
    if any(r.name == "pairs" for r in study.results):
        remarks.append(
            "pairs counts every sighting about K/2 times, with K sightings per landmark: "
            f"{study.sightings_per_landmark / 2:.1f} times on these logs."
        )
    return [table], remarks


def _band(limits: tuple[float, float]) -> str:
    return NOTHING if np.isnan(limits[0]) else f"{limits[0]:.3f} to {limits[1]:.3f}"


def summary_tables(summary: Summary) -> Tables:
    """Medians with their intervals, then the differences from the baseline, and the errors with their counts."""
    proofs = any(line.proven is not None for line in summary.methods)
    table = LeanTable(
        f"{summary.done} of {summary.planned} runs: medians with 95 % bootstrap intervals", ["log", "method"],
        ["runs", "failed", "converged", "time", *_METRICS.values(), "J per\ndof", *["proven"] * proofs],
    )  # fmt: skip
    for line in summary.methods:
        failed = line.failed + line.timeouts
        time, ratio = line.figures["seconds"], line.figures["cost_per_dof"]
        _add(
            table, line.log, line.method, str(line.runs), Text(str(failed), style="bold red" if failed else ""),
            written(line.converged, ".0%"), seconds(None if time is None else time.median), *_intervals(line.figures),
            number(None if ratio is None else ratio.median, 2), *[written(line.proven, ".0%")] * proofs,
        )  # fmt: skip
    tables: list[Table] = [table]
    if summary.differences:
        tables.append(LeanTable(
            f"differences from {summary.baseline} on the same logs and random seeds: lower is better",
            ["log", "method"], ["pairs", "lower\nATE", *_METRICS.values()],
        ))  # fmt: skip
    for gap in summary.differences:
        pairs = max((median.count for median in gap.figures.values() if median is not None), default=0)
        ate = gap.figures["ate_m"]
        lower = NOTHING if ate is None else f"{gap.lower['ate_m']}/{ate.count}"
        _add(tables[-1], gap.log, gap.method, str(pairs), lower, *_intervals(gap.figures, "+"))
    errors = list(summary.errors.items())
    remarks = [f"{count} x {error}" for error, count in errors[:_MOST_ERRORS]]
    if any(line.figures["cost_per_dof"] is not None for line in summary.methods):
        remarks.append("J per dof (degree of freedom): about 1 means that the noise models fit.")
    if len(errors) > _MOST_ERRORS:
        remarks.append(f"... and {len(errors) - _MOST_ERRORS} other errors; --csv and --json list all of them.")
    return tables, remarks


def _add(table: Table, log: str, *cells: str | Text) -> None:
    """Add a row, with the name of its log only where that differs from the row above."""
    above = next((name for name in reversed(list(table.columns[0].cells)) if name), log)
    if above != log:
        table.add_section()
    table.add_row("" if above == log and table.rows else log, *cells)


def _intervals(figures: Mapping[str, Median | None], sign: str = "") -> list[str]:
    def text(value: float) -> str:
        return sign * (value > 0) + number(value)

    def interval(m: Median) -> str:
        return text(m.median) + ("" if m.low is None or m.high is None else f" [{text(m.low)}, {text(m.high)}]")

    return [NOTHING if (m := figures[metric]) is None else interval(m) for metric in _METRICS]


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
    known = [each for each in _OF_FILTERS if any(line.figures[each] is not None for line in study.summary.methods)]
    with _panels(len(known), sharex=True) as (figure, panels):
        for axes, quantity in zip(panels, known):
            for name, lines in study.methods.items():
                if medians := {n: m for n, line in lines.items() if (m := line.figures[quantity])}:
                    values, low, high = zip(*((m.median, *m.quartiles) for m in medians.values()))
                    axes.plot(list(medians), values, label=name, **style_of(name, len(medians)))
                    axes.fill_between(list(medians), low, high, color=colour_of(name), alpha=0.2, linewidth=0)
            axes.set(xscale="log", yscale="log", title=METRICS[quantity])
        for axes in panels[max(len(known) - 3, 0) : len(known)]:
            axes.set_xlabel("particles")
            axes.tick_params(labelbottom=True)
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(study.methods))
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
                # the first point, at time zero, has no place on a logarithmic axis; below 1e-10 all is rounding, also where
                # a graph without errors has a chi2 of almost 0
                excess = [np.clip((cost - best) / max(best, 1e-10), 1e-10, 1e30) for _, cost in row.trace[1:]]
                (handles[label],) = panel.plot([t for t, _ in row.trace[1:]], excess, **look)
            panel.set(xscale="log", yscale="log", title=as_text(Path(file).name), xlabel="time [s]")
        for panel in panels[::3]:
            panel.set_ylabel("relative excess of chi2 over the best")
        if handles:
            columns = min(len(handles), 1 + min(len(files), 3))
            figure.legend(handles.values(), handles, loc="outside lower center", ncols=columns)
    return figure


def study_figure(summary: Summary, metric: str = "ate_m") -> Figure:
    """A row of panels per log: left the medians of the metric, right the differences from the baseline.

    Bars are 95 % bootstrap intervals. In the right panel a bar that does not touch zero is a difference that the seeds
    do not explain.

    Raises:
        OptionError: no run has been executed.
    """
    from ..studies.summary import ALL

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
        shown = [m for line in summary.methods if line.log in logs and (m := line.figures[metric]) is not None]
        positive = all((m.median if m.low is None else m.low) > 0 for m in shown)
        if positive and logarithmic_from([m.median for m in shown]) is not None:
            # columns share their axis
            panels[-1, 0].set_xscale("log")
        panels[-1, 0].set_xlabel(METRICS[metric])
        baseline = as_text(str(summary.baseline))
        panels[-1, 1].set_xlabel(f"difference from {baseline},\nsame random seeds: {METRICS[metric]}")
    return figure


def _draw_medians(axes: Axes, names: list[str], medians: Mapping[str, Median | None]) -> None:
    for height, name in enumerate(names):
        if (m := medians.get(name)) is not None:
            color = colour_of(name.split()[0])
            if m.low is not None and m.high is not None:
                axes.plot([m.low, m.high], [height, height], color=color, linewidth=2.0, solid_capstyle="butt")
            axes.plot([m.median], [height], color=color, marker="o", markeredgecolor="black", linestyle="none")
