"""The tables of studies, of the data sets at hand, and of a calibration."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from rich.table import Table
from rich.text import Text

from .cells import NOTHING, LeanTable, number, seconds, yes_no

if TYPE_CHECKING:
    from graphslam.calibration import Calibration

    from ..bootstrap import Median
    from ..consistency import Consistency, ConsistencyStudy
    from ..datasets import Survey
    from ..particles import ParticleStudy
    from ..studies.summary import Summary
    from .tables import Tables

#: the metrics of a study's tables
_METRICS = {"ate_m": "ATE [m]", "rpe_m": "RPE [m]", "landmark_rmse_m": "map [m]"}
#: error messages that are printed below a study
_MOST_ERRORS = 5


def particle_tables(study: ParticleStudy) -> Tables:
    """Medians over the seeds, a row per filter and number of particles."""
    metrics = {
        "ate_m": "ATE\n[m]", "mean_ate_m": "ATE of\nmean [m]", "landmark_rmse_m": "map\n[m]", "ess_share": "ESS / N",
    }  # fmt: skip
    headings = ("particles", *metrics.values(), "ancestors", "time")
    table = LeanTable(f"{study.log}: medians over random seeds", ["filter"], headings)
    for row in study.rows():
        values = (number(row[metric]) for metric in metrics)
        ancestors = number(row["ancestors"], 0)
        table.add_row(row["name"], str(row["particles"]), *values, ancestors, seconds(row["seconds"]))
    return [table], [f"{note}." for note in study.notes]


def consistency_tables(study: ConsistencyStudy) -> Tables:
    """A row per estimator: the joint ANEES with its band, and that of its steps."""
    table = LeanTable(
        f"{study.logs} simulated logs of {study.steps} motions, {study.dimensions}-D sensor, {study.noise:g} times the "
        "book's noise: ANEES / degrees of freedom, 1 means consistent",
        ["estimator"],
        ["logs", "joint", "95 % band", "inside", "median\nof steps", "worst\nstep", "95 % band\nof a step", "steps\ninside"],
    )  # fmt: skip
    for r in study.results:
        joint = (number(r.anees), NOTHING if r.anees is None else _band(r.joint_band), yes_no(r.consistent))
        steps = number(float(np.median(r.steps))), number(float(np.max(r.steps)))
        inside = NOTHING if r.steps_inside is None else f"{r.steps_inside:.0%}"
        table.add_row(r.name, str(r.logs), *joint, *steps, _band(r.step_band), inside)
    failed = [r for r in study.results if r.failed]
    remarks = [f"{r.name} {_failed(r)} on {r.failed} of {study.logs} logs, which are not counted." for r in failed]
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


def _failed(result: Consistency) -> str:
    return "did not mix" if result.name == "particle-gibbs" else "failed"


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
            _share(line.converged),
            seconds(None if time is None else time.median), *_intervals(line.figures),
            number(None if ratio is None else ratio.median, 2), *[_share(line.proven)] * proofs,
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


def _share(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.0%}"


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


def survey_tables(survey: Survey) -> Tables:
    """A row for each log or pose graph found on this computer; below, what the known data sets are."""
    from ..datasets import DATA_SETS

    headings = ["robot", "poses", "sightings,\nedges", "landmarks", "controls", "time\n[s]", "truth\ncovers", "reads"]
    table = LeanTable("Found on this computer", ["data set", "file or folder"], headings)
    for name, entries in survey.found.items():
        for entry in entries:
            counts = [entry.robot, entry.poses, entry.sightings, entry.landmarks, entry.controls]
            if entry.error is not None:
                counts[1:] = [None] * 4
            cells = (NOTHING if count is None else str(count) for count in counts)
            covered = entry.poses_covered
            share = NOTHING if covered is None else f"{100 * covered / entry.poses:.0f} %"
            place = Text(os.path.relpath(entry.path, survey.folder))
            table.add_row(name, place, *cells, number(entry.seconds, 1), share, yes_no(entry.error is None))
    remarks = []
    for known in DATA_SETS:
        remarks += [
            f"{known.name}: {known.title}",
            f"  published: {known.source}",
            f"  terms:     {known.terms}",
            f"  layout:    {known.layout}",
            f"  at hand:   {len(survey.found[known.name]) or 'no'}",
        ]
    missing = "" if survey.folder.is_dir() else " There is no such folder: name another with SLAM_DATA or --folder."
    return [table], [*remarks, f"Searched below {survey.folder}.{missing}", ""]


def calibration_tables(calibration: Calibration, name: str = "") -> Tables:
    """The numbers of the noise models with their standard errors or upper bounds, a row each."""
    from graphslam.parameters import PARAMETERS

    from ..option import options_of
    from ..options import NoiseOptions

    source = "the ground truth" if calibration.source == "truth" else calibration.source
    table = LeanTable(
        f"{name}: noise models from {source}" if name else f"noise models from {source}",
        ["number", "unit"],
        ["value", "± error, or bound"],
    )
    for number_of, value in calibration.numbers.items():
        error, bound = calibration.errors.get(number_of, np.nan), calibration.bounds.get(number_of, np.nan)
        known = f"{error:.2g}" if np.isfinite(error) else f"< {bound:.2g}" if np.isfinite(bound) else NOTHING
        if np.isposinf(bound):
            known = "not identifiable"
        unit = (PARAMETERS if number_of in PARAMETERS else options_of(NoiseOptions))[number_of].unit
        table.add_row(number_of, Text(unit), f"{value:.4g}", known)
    names = {"motion": "motions", "sensor": "sightings"}
    counts = " and ".join(f"{count} {names[part]}" for part, count in calibration.counts.items())
    return [table], [
        f"From {counts}. Measured range = range_scale * range + range_bias, recorded speed = wheel_scale * speed, recorded "
        'turn rate = turn_scale * turn rate + turn_rate_bias + curvature_bias * speed. "<": near zero, with the upper '
        f'95 % bound; "not identifiable": the log gives no bound; "{NOTHING}": not estimated.',
        *(f"{note}." for note in calibration.notes),
        *(f"Not recommended: {doubt}." for doubt in calibration.doubts),
    ]
