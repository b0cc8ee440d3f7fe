"""Tables of logs: what an import found, a log before it is solved, and estimates of any program against the truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from .cells import NOTHING, LeanTable, number
from .placement import between_poses
from .text_plots import bars, plan

if TYPE_CHECKING:
    from ..evaluation import Evaluation
    from ..importing import Import
    from ..overview import Overview
    from .tables import Tables


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
            stream.kind,
            stream.source.rpartition(": ")[2] if found.topics else Path(stream.source).name,
            str(stream.rows),
            f"{stream.begin:.2f}",
            f"{stream.end:.2f}",
            NOTHING if stream.rate is None else number(stream.rate),
        )
    log = found.log
    sizes = f"The log has {log.num_poses} poses and {log.seen}"
    known = f"; the true map has {found.landmarks} landmarks" if found.landmarks is not None else ""
    columns = [f"Columns of {stream.kind}: {', '.join(stream.columns)}." for stream in found.streams]
    warnings = [f"WARNING: {finding.message}." for finding in found.findings]
    return [*tables, table], [*columns, f"{sizes}{known}.", *(f"{note}." for note in log.notes), *warnings]


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
    title = f"{log.name}: {log.num_poses} poses, {log.seen}"
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
    if overview.seconds is not None:
        driven, turned = number(overview.distance, 1), number(overview.turned, 1)
        remarks.append(f"The odometry drives {driven} m and turns by {turned} rad in all, in {overview.seconds:.1f} s.")
    remarks += ["", "ranges", *bars(overview.ranges.edges, overview.ranges.counts, "m")]
    remarks += ["", "bearings", *bars(overview.bearings.edges, overview.bearings.counts, "rad")]
    remarks += ["", *plan(between_poses(log, None).through(overview.path)[:, :2], overview.seen_at), ""]
    remarks += [f"{note}." for note in log.notes]
    remarks += [f"WARNING: {finding.message}." for finding in overview.findings]
    if not overview.findings:
        remarks.append(
            "Nothing is suspicious: units, signs, axes, clocks and ids were checked."
            if overview.compared
            else "Nothing is suspicious, but too few landmarks are seen twice over a short way to check units, signs and "
            "axes against the odometry."
        )
    return [rates, seen], remarks


def evaluation_tables(evaluation: Evaluation) -> Tables:
    """A row for each estimate; columns without any number are left out."""
    estimates = evaluation.estimates
    columns = {
        "poses\ncompared": [f"{e.compared} of {e.poses}" for e in estimates],
        "ATE\n[m]": [number(e.ate_m) for e in estimates],
        "most\n[m]": [number(e.most_m) for e in estimates],
        "RPE\n[m]": [number(e.rpe_m) for e in estimates],
        "RPE\n[rad]": [number(e.rpe_rad) for e in estimates],
        "heading\n[rad]": [number(e.heading_rad) for e in estimates],
        "NEES": [number(e.nees, 2) for e in estimates],
        "map\n[m]": [number(e.landmark_rmse_m) for e in estimates],
        "missed": [NOTHING if e.missed is None else str(e.missed) for e in estimates],
        "false": [NOTHING if e.false is None else str(e.false) for e in estimates],
        "GOSPA\n[m]": [number(e.gospa_m) for e in estimates],
    }
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
    return [table], [*remarks, *(f"{note}." for note in evaluation.notes)]
