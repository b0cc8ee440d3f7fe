"""Tables of logs: imports, logs before they are solved, evaluations of any program's estimates, data sets, calibrations.

`bars`, `plan` and `pictures` draw in plain characters: histograms, a path with landmarks seen from above, and the path of the
online solver as it grows.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.table import Table
from rich.text import Text

from graphslam import Log, OnlineSolver
from graphslam.errors.checks import singular
from graphslam.identification.declared import PARAMETERS
from graphslam.se2 import Array

from ..estimators import bounds_of, online_steps
from ..options import NoiseOptions, RunOptions, options_of
from .canvas import between_poses, limits_of
from .tables import NOTHING, LeanTable, Tables, ended, number, written, yes_no

if TYPE_CHECKING:
    from graphslam.calibration import Calibration
    from graphslam.log_checks import Finding

    from ..datasets import Survey
    from ..evaluation import Evaluation
    from ..importing import Import, Overview

_EIGHTHS = " ▏▎▍▌▋▊▉█"


def bars(edges: Array, counts: np.ndarray, unit: str, width: int = 40) -> list[str]:
    """A line for each interval [begin, end), its bar as long as its count."""
    most = max(int(np.max(counts, initial=0)), 1)
    low, high = ([f"{edge:.2f}" for edge in ends] for ends in (edges[:-1], edges[1:]))
    wide = max(map(len, (*low, *high)))
    lines = []
    for begin, end, count in zip(low, high, counts.tolist()):
        eighths = round(8 * width * count / most)
        bar = "█" * (eighths // 8) + (_EIGHTHS[eighths % 8] if eighths % 8 else "")
        lines.append(f"[{begin:>{wide}}, {end:>{wide}}) {unit}  {bar} {count}")
    return lines


def plan(
    path: Array, points: Array, width: int = 76, height: int = 24, names: tuple[str, str] = ("dead reckoning", "sighting"),
) -> list[str]:  # fmt: skip
    """A path (n, 2) of dots and points (m, 2) of crosses from above, with its size; S is the start.

    ``names`` are those of the dots and crosses.
    """
    low, high = limits_of(path, [points], least=4.0, margin=0.0)
    # a character is about twice as high as wide
    scale = max((high[0] - low[0]) / (width - 1), (high[1] - low[1]) / (height - 1) / 2, 1e-6)
    columns, rows = int((high[0] - low[0]) / scale) + 1, int((high[1] - low[1]) / (2 * scale)) + 1
    grid = np.full((rows, columns), " ")
    for places, mark in ((points, "+"), (path, "·"), (path[:1], "S")):
        across = np.rint((places[:, 0] - low[0]) / scale).astype(int)
        down = rows - 1 - np.rint((places[:, 1] - low[1]) / (2 * scale)).astype(int)
        inside = (across >= 0) & (across < columns) & (down >= 0) & (down < rows)
        grid[down[inside], across[inside]] = mark
    size = f"{high[0] - low[0]:.1f} m wide, {high[1] - low[1]:.1f} m high; S start, · {names[0]}, + {names[1]}"
    return [*("".join(row).rstrip() for row in grid), size]


#: from one picture to the next [s]
EVERY = 0.2


def pictures(log: Log, options: RunOptions, *, width: int = 76, height: int = 24) -> Iterator[list[str]]:
    """Pictures of the estimate, each a list of lines: one every `EVERY` seconds, and the last one.

    Raises:
        GraphError: the log lacks what the graph needs.
    """
    steps, drawn, begin = online_steps(log, options), -np.inf, time.perf_counter()
    spent: list[float] = []
    for solver in steps:
        now = time.perf_counter()
        spent.append(now - begin)
        if now - drawn >= EVERY or solver.step == log.num_poses - 1:
            marks = np.array([mark[:2] for mark in solver.landmarks.values()]).reshape(-1, 2)
            lines = plan(solver.poses[:, :2], marks, width, height, ("estimated path", "landmark"))
            # the first steps of a process load compiled code
            pace = f"{1e3 * float(np.median(spent)):.2f} ms per step (median)"
            last = f"step {solver.step} of {log.num_poses - 1}, {len(marks)} landmarks, {pace}"
            yield [*lines, *_where(solver, options), last]
            drawn = now
        begin = time.perf_counter()


def _where(solver: OnlineSolver, options: RunOptions) -> list[str]:
    """In a map, the pose with its standard deviations and the probability that it is off."""
    if options.landmark_map is None:
        return []
    (x, y, theta), std, (metres, degrees) = solver.pose, np.sqrt(np.diagonal(solver.covariance())), options.bound
    return [
        f"x {x:.2f} ± {std[0]:.2f} m, y {y:.2f} ± {std[1]:.2f} m, heading {np.degrees(theta):.0f} ± "
        f"{np.degrees(std[2]):.1f} degrees; off by more than {metres:g} m or {degrees:g} degrees with probability "
        f"{solver.integrity_risk(*bounds_of(options)):.2g}"
    ]


def import_tables(found: Import) -> Tables:
    """A row per topic and per stream that was read; below, the columns and what the reader remarked."""
    tables: list[Table] = []
    if found.topics:
        topics = LeanTable(f"topics of {found.source}", ["topic", "type"], ["messages", "could be", "chosen"])
        for topic in found.topics:
            type = topic.type.replace("/msg/", "/")
            topics.add_row(topic.name, type, str(topic.count), topic.could_be or NOTHING, "yes" if topic.chosen else "")
        tables.append(topics)
    if found.log is None:
        return tables, []
    title = "what was read" if found.source is None else f"what was read from {found.source}"
    table = LeanTable(title, ["", "source"], ["rows", "from\n[s]", "to\n[s]", "rate\n[Hz]"])
    for stream in found.streams:
        table.add_row(
            stream.kind, stream.source.rpartition(": ")[2] if found.topics else Path(stream.source).name, str(stream.rows),
            f"{stream.begin:.2f}", f"{stream.end:.2f}", number(stream.rate),
        )  # fmt: skip
    log = found.log
    sizes = singular(f"The log has {log.num_poses} poses and {log.seen}")
    known = f"; the true map has {found.landmarks} landmarks" if found.landmarks is not None else ""
    columns = [f"Columns of {stream.kind}: {', '.join(stream.columns)}." for stream in found.streams]
    return [*tables, table], [*columns, f"{sizes}{known}.", *_doubts(log, found.findings)]


def _doubts(log: Log, findings: Sequence[Finding]) -> list[str]:
    """The notes of a log, and what is probably wrong with it."""
    return [*map(ended, log.notes), *(ended(f"WARNING: {finding.message}") for finding in findings)]


#: landmarks that are listed
_LISTED = 12


def overview_tables(overview: Overview) -> Tables:
    """Rates and landmarks; below, histograms, the way from above, and what is probably wrong."""
    log = overview.log
    parts = {
        "psi": log.has_orientation, "classes": log.classes is not None, "true poses": log.true_poses is not None,
        "true map": bool(log.true_landmarks),
    }  # fmt: skip
    known = ", ".join(part for part, present in parts.items() if present)
    title = f"{log.name}: {log.sizes}"
    rates = LeanTable("times", [""], ["number", "rate\n[Hz]", "longest\ngap [s]", "at\n[s]"])
    for each in overview.rates:
        rates.add_row(each.name, str(each.count), number(each.rate), number(each.longest_gap), number(each.gap_at, 1))
    seen = LeanTable("sightings of each landmark", [""], ["number", "first\n[s]", "last\n[s]", "median\nrange [m]"])
    for landmark in overview.landmarks[:_LISTED]:
        times = (f"{landmark.first:.1f}", f"{landmark.last:.1f}", number(landmark.range))
        seen.add_row(f"landmark {landmark.id}", str(landmark.count), *times)
    remarks = [""]
    if (more := len(overview.landmarks) - _LISTED) > 0:
        remarks.append(f"... and {more} more landmarks")
    remarks.append(f"{title}{', with ' if known else ''}{known}.")
    if log.relations is not None:
        remarks.append(singular(f"The log has {len(log.relations)} relations between two poses."))
    if log.positions is not None:
        remarks.append(singular(f"The log has {len(log.positions)} absolute positions."))
    if overview.seconds is not None:
        driven, turned = number(overview.distance, 1), number(overview.turned, 1)
        remarks.append(f"The odometry drives {driven} m and turns by {turned} rad in all, in {overview.seconds:.1f} s.")
    remarks += ["", "ranges", *bars(overview.ranges.edges, overview.ranges.counts, "m")]
    remarks += ["", "bearings", *bars(overview.bearings.edges, overview.bearings.counts, "rad")]
    remarks += ["", *plan(between_poses(log, None).through(overview.path)[:, :2], overview.seen_at), ""]
    remarks += _doubts(log, overview.findings)
    checked = "Nothing is suspicious: units, signs, axes, clocks and ids were checked."
    if not overview.compared:
        checked = (
            "Nothing is suspicious, but too few landmarks are seen twice over a short way to check units, signs and axes "
            "against the odometry."
        )
    remarks += [checked] * (not overview.findings)
    return [rates, seen], remarks


#: errors of the poses of an estimate, by their headings
_ERRORS = {
    "ATE\n[m]": "ate_m", "most\n[m]": "most_m", "RPE\n[m]": "rpe_m", "RPE\n[rad]": "rpe_rad", "heading\n[rad]": "heading_rad",
}  # fmt: skip


def evaluation_tables(evaluation: Evaluation) -> Tables:
    """A row for each estimate; columns without any number are left out."""
    estimates = evaluation.estimates
    columns = {
        "poses\ncompared": [f"{e.compared} of {e.poses}" for e in estimates],
        **{title: [number(getattr(e, name)) for e in estimates] for title, name in _ERRORS.items()},
        "NEES": [number(e.nees, 2) for e in estimates], "map\n[m]": [number(e.landmark_rmse_m) for e in estimates],
        "missed": [written(e.missed) for e in estimates], "false": [written(e.false) for e in estimates],
        "GOSPA\n[m]": [number(e.gospa_m) for e in estimates],
    }  # fmt: skip
    shown = {title: cells for title, cells in columns.items() if set(cells) != {NOTHING}}
    truth = evaluation.truth
    table = LeanTable(f"against {truth.name}: {len(truth.times)} true poses", ["estimate"], list(shown))
    for k, each in enumerate(estimates):
        table.add_row(each.name, *(cells[k] for cells in shown.values()))
    remarks = ["Positions and maps are aligned to the truth by the rigid motion with the least squared errors."]
    if "NEES" in shown:
        remarks.append("NEES: 1 means consistent covariances, above 1 overconfident ones.")
    if "GOSPA\n[m]" in shown:
        how = "of the same ids" if evaluation.options.match == "id" else "matched by place"
        remarks.append(
            f"map: error of landmarks {how}; missed, false: without a partner within {evaluation.options.cutoff:g} m."
        )
    return [table], [*remarks, *map(ended, evaluation.notes)]


def survey_tables(survey: Survey) -> Tables:
    """A row for each log or pose graph found on this computer; below, what the known data sets are."""
    headings = ["robot", "poses", "sightings,\nedges", "landmarks", "controls", "time\n[s]", "truth\ncovers", "reads"]
    table = LeanTable("Found on this computer", ["data set", "file or folder"], headings)
    for name, entries in survey.found.items():
        for entry in entries:
            counts = [entry.robot, entry.poses, entry.sightings, entry.landmarks, entry.controls]
            if entry.error is not None:
                counts[1:] = [None] * 4
            covered, place = entry.poses_covered, Text(os.path.relpath(entry.path, survey.folder))
            share = NOTHING if covered is None else f"{100 * covered / entry.poses:.0f} %"
            last = number(entry.seconds, 1), share, yes_no(entry.error is None)
            table.add_row(name, place, *map(written, counts), *last)
    remarks = []
    for known in survey.sets:
        remarks += [
            f"{known.name}: {known.title}", f"  published: {known.source}", f"  terms:     {known.terms}",
            f"  layout:    {known.layout}", f"  at hand:   {len(known.found) or 'no'}",
        ]  # fmt: skip
    missing = "" if survey.exists else " There is no such folder: name another with SLAM_DATA or --folder."
    return [table], [*remarks, f"Searched below {survey.folder}.{missing}", ""]


def calibration_tables(calibration: Calibration, name: str = "") -> Tables:
    """The numbers of the noise models with their standard errors or upper bounds, a row each."""
    source = "the ground truth" if calibration.source == "truth" else calibration.source
    title = f"{name}: noise models from {source}" if name else f"noise models from {source}"
    table = LeanTable(title, ["parameter", "unit"], ["value", "± error, or bound"])
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
        *map(ended, calibration.notes),
        *(ended(f"Not recommended: {doubt}") for doubt in calibration.doubts),
    ]
