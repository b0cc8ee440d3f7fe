"""Outcomes as rich tables and sentences for the terminal."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np
from rich import box
from rich.table import Table
from rich.text import Text

from .comparison import Comparison, ResultTable
from .datasets import DATA_SETS, Survey
from .solvers import SkippedVariant, SolverComparison, VariantResult

if TYPE_CHECKING:
    from graphslam.calibration import Calibration

    from .consistency import ConsistencyStudy
    from .particles import ParticleStudy

NOTHING = "–"


def number(value: float | None, digits: int = 3) -> str:
    """A figure for a table: short, and a dash where it cannot be known."""
    if value is None:
        return NOTHING
    if value == 0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:.{digits}f}"
    return f"{value:.{digits - 1}e}"


def seconds(value: float | None) -> str:
    """A time with the unit that suits it."""
    if value is None:
        return NOTHING
    if value < 1e-3:
        return f"{value * 1e6:.0f} µs"
    return f"{value * 1e3:.1f} ms" if value < 1 else f"{value:.2f} s"


def yes_no(value: bool | None) -> Text:
    """Yes, no, or a dash where the question makes no sense; not by colour alone."""
    if value is None:
        return Text(NOTHING)
    return Text("yes", style="green") if value else Text("no", style="bold red")


def lean_table(title: str) -> Table:
    """An empty table, so lean that eight columns of figures fit into a terminal of 80 characters."""
    return Table(
        title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, padding=(0, 0, 0, 1),
        pad_edge=False, show_edge=False,
    )  # fmt: skip


def comparison_table(results: ResultTable) -> Table:
    """The rows of a comparison, one per estimator."""
    table = lean_table(results.title)
    table.add_column("estimator", no_wrap=True)
    headings = ("con-\nverged", "iter-\nations", "time", "cost J", "ATE\n[m]", "RPE\n[m]", "RPE\n[rad]", "map\n[m]")
    for heading in headings:
        # as Text: rich would take [m] for markup
        table.add_column(Text(heading), justify="right", no_wrap=True)
    for row in results:
        if row.skipped is not None:
            table.add_row(Text(row.name, style="dim"), *[Text(NOTHING, style="dim")] * len(headings))
            continue
        figures = (number(f) for f in (row.ate_m, row.rpe_m, row.rpe_rad, row.landmark_rmse_m))
        # a filter goes over the log once: 0 iterations would read as if it had not started
        iterations = NOTHING if row.converged is None else str(row.iterations)
        table.add_row(row.name, yes_no(row.converged), iterations, seconds(row.seconds), number(row.cost), *figures)
    return table


def comparison_remarks(comparison: Comparison) -> list[str]:
    """The sentences below the table: agreement, estimators left out, notes of the log and of the estimators."""
    remarks = []
    if (difference := comparison.difference("graph", "gtsam")) is not None:
        remarks.append(f"graph and gtsam differ by at most {difference:.1e} in any x, y [m] or heading [rad].")
    if comparison.log.true_poses is None:
        remarks.append("The log has no true poses, so no error can be measured.")
    elif (covered := int(comparison.log.covered.sum())) < comparison.log.num_poses:
        remarks.append(f"Errors are those of the {covered} of {comparison.log.num_poses} poses that the truth covers.")
    remarks += [f"{entry.name} left out: {entry.reason}." for entry in comparison.skipped]
    remarks += [f"{result.name} did not converge: {result.reason}." for result in comparison.results
                if result.converged is False]  # fmt: skip
    said: dict[str, list[str]] = {note: [comparison.log.name] for note in comparison.log.notes}
    for result in comparison.results:
        for note in result.notes:
            said.setdefault(note, []).append(result.name)
    return remarks + [f"{', '.join(names)}: {note}." for note, names in said.items()]


def solvers_table(comparison: SolverComparison, title: str) -> Table:
    """The rows of a solver comparison, one per variant."""
    table = lean_table(title)
    table.add_column("variant")
    headings = ("poses\ndiffer by", "costs\ndiffer by", "iter-\nations", "\ngtsam", "\ntime", "\ngtsam", "\nagree")
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    for variant in comparison.variants:
        table.add_row(
            variant.name,
            f"{variant.pose_difference:.1e}",
            f"{variant.cost_difference:.1e}",
            str(variant.iterations),
            str(variant.gtsam_iterations),
            seconds(variant.seconds),
            seconds(variant.gtsam_seconds),
            yes_no(variant.problem is None),
        )
    return table


def solvers_remarks(comparison: SolverComparison) -> list[str]:
    """The sentences below the table: what disagrees, and what was left out, reason by reason."""
    reasons: dict[str, list[str]] = {}
    for entry in comparison.skipped:
        reasons.setdefault(entry.reason, []).append(entry.name)
    remarks = [f"DIFFERENT: {problem}." for problem in comparison.problems]
    for reason, names in reasons.items():
        who = names[0] if len(names) == 1 else f"{len(names)} variants ({names[0]}, ...)"
        remarks.append(f"{who} left out: {reason}.")
    return remarks


def variant_line(outcome: VariantResult | SkippedVariant) -> str:
    """One line of progress."""
    if isinstance(outcome, SkippedVariant):
        return f"{outcome.name}: skipped"
    return f"{outcome.name}: {seconds(outcome.seconds)}, gtsam {seconds(outcome.gtsam_seconds)}"


def particles_table(outcome: ParticleStudy) -> Table:
    """Medians over the seeds, a row per filter and number of particles."""
    table = lean_table(f"{outcome.log}: medians over seeds")
    table.add_column("filter", no_wrap=True)
    for heading in ("parti-\ncles", "ATE\n[m]", "ATE of\nmean [m]", "map\n[m]", "ESS / N", "ances-\ntors", "time"):
        table.add_column(Text(heading), justify="right", no_wrap=True)
    for row in outcome.rows():
        table.add_row(
            row["name"],
            str(row["particles"]),
            number(row["ate_m"]),
            number(row["mean_ate_m"]),
            number(row["landmark_rmse_m"]),
            number(row["ess_share"]),
            number(row["ancestors"], 0),
            seconds(row["seconds"]),
        )
    return table


def consistency_table(outcome: ConsistencyStudy) -> Table:
    """A row per estimator: joint ANEES with its band, and how its steps fare."""
    table = lean_table(
        f"{outcome.logs} simulated logs of {outcome.steps} motions, {outcome.dimensions}-D sensor, "
        f"{outcome.noise:g} times the book's noise: ANEES / degrees of freedom, 1 is the truth"
    )
    table.add_column("estimator", no_wrap=True)
    for heading in ("logs", "joint", "95 % band", "inside", "per step\nmedian", "worst", "95 % band", "steps\ninside"):
        table.add_column(Text(heading), justify="right", no_wrap=True)
    for r in outcome.results:
        joint = [number(r.anees), _band(r.joint_band), "yes" if r.consistent else "no"]
        table.add_row(
            r.name, str(r.logs), *(joint if r.anees is not None else [NOTHING] * 3),
            number(float(np.median(r.steps))), number(float(np.max(r.steps))), _band(r.step_band), f"{r.steps_inside:.0%}",
        )  # fmt: skip
    return table


def consistency_remarks(outcome: ConsistencyStudy) -> list[str]:
    """What a reader of the table should know."""
    remarks = [
        f"{r.name} failed on {r.failed} of {outcome.logs} logs, which count in no figure"
        for r in outcome.results
        if r.failed
    ]
    if any(r.name == "pairs" for r in outcome.results):
        half = outcome.sightings_per_landmark / 2
        remarks.append(
            f"pairs counts every sighting about K/2 times: {half:.1f} on these logs, with K sightings per landmark"
        )
    return remarks


def _band(limits: tuple[float, float]) -> str:
    return f"{limits[0]:.3f} to {limits[1]:.3f}"


#: of the numbers of the noise models
_UNITS = {
    "nn": "m/√m", "no": "m/√rad", "on": "rad/√m", "oo": "rad/√rad", "epsilon": "m², rad²", "sigma_v": "m/s",
    "sigma_omega": "rad/s", "range_rate": "m/m", "range_std": "m", "bearing_std": "rad", "orientation_std": "rad",
    "range_scale": "", "range_bias": "m",
}  # fmt: skip


def calibration_table(found: Calibration, name: str) -> Table:
    """The numbers of the noise models with their standard errors, a row each."""
    table = lean_table(f"{name}: noise from {found.source}")
    for heading, justify in (("number", "left"), ("value", "right"), ("± error", "right"), ("unit", "left")):
        table.add_column(heading, justify=justify, no_wrap=True)  # type: ignore[arg-type]
    for key, value in found.numbers.items():
        error = found.errors.get(key, float("nan"))
        table.add_row(key, f"{value:.4g}", f"{error:.2g}" if np.isfinite(error) else NOTHING, Text(_UNITS[key]))
    return table


def calibration_remarks(found: Calibration) -> list[str]:
    """The sentences below the table."""
    looked = " and ".join(
        f"{count} {'motions' if what == 'motion' else 'sightings'}" for what, count in found.counts.items()
    )
    line = "measured range = range_scale * range + range_bias"
    return [f"From {looked}; {line}. A dash: zero, or not to be told.", *(f"{note}." for note in found.notes)]


def datasets_remarks(outcome: Survey) -> list[str]:
    """What the known data sets are, a few lines each."""
    lines = []
    for known in DATA_SETS:
        count = len(outcome.found[known.name])
        lines += [
            f"{known.name}: {known.title}",
            f"  published: {known.source}",
            f"  terms:     {known.terms}",
            f"  layout:    {known.layout}",
            f"  at hand:   {count if count else 'no'}",
        ]
    where = "" if outcome.folder.is_dir() else " (there is no such folder: name another with SLAM_DATA or --folder)"
    return [*lines, f"Looked below {outcome.folder}{where}.", ""]


def datasets_table(outcome: Survey) -> Table:
    """What is at hand, a row per log or pose graph."""
    table = lean_table("At hand")
    table.add_column("data set", no_wrap=True)
    table.add_column("file or folder")
    headings = (
        "robot",
        "poses",
        "sightings,\nedges",
        "land-\nmarks",
        "controls",
        "time\n[s]",
        "truth\ncovers",
        "reads",
    )
    for heading in headings:
        table.add_column(Text(heading), justify="right", no_wrap=True)
    for name, entries in outcome.found.items():
        for entry in entries:
            robot = NOTHING if entry.robot is None else str(entry.robot)
            place = os.path.relpath(entry.path, outcome.folder)
            if entry.error is not None:
                table.add_row(name, Text(place), robot, *[NOTHING] * 6, yes_no(False))
                continue
            covered = NOTHING if entry.poses_covered is None else f"{100 * entry.poses_covered / entry.poses:.0f} %"
            table.add_row(
                name, Text(place), robot, str(entry.poses), str(entry.sightings), str(entry.landmarks),
                NOTHING if entry.controls is None else str(entry.controls), number(entry.seconds, 1), covered, yes_no(True),
            )  # fmt: skip
    return table
