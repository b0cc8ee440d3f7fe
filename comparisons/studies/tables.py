"""A summary as rich tables and sentences for the terminal."""

from __future__ import annotations

from rich.table import Table
from rich.text import Text

from ..tables import NOTHING, lean_table, number, seconds
from .bootstrap import Median
from .summary import METRICS, Summary

_SHOWN = ("ate_m", "rpe_m", "landmark_rmse_m")


def summary_table(summary: Summary) -> Table:
    """Medians with their intervals, a row per log and method."""
    table = lean_table(f"{summary.done} of {summary.planned} runs; medians with 95 % bootstrap intervals")
    table.add_column("log", overflow="fold")
    table.add_column("method", overflow="fold")
    for heading in ("runs", "fail-\ned", "con-\nverged", *(METRICS[m].replace(" [", "\n[") for m in _SHOWN), "time"):
        table.add_column(Text(heading), justify="right", no_wrap=True)
    last = None
    for line in summary.methods:
        if last not in (None, line.log):
            table.add_section()
        failed = line.failed + line.timeouts
        time = line.figures["seconds"]
        table.add_row(
            "" if line.log == last else line.log,
            line.method,
            str(line.runs),
            Text(str(failed), style="bold red") if failed else "0",
            NOTHING if line.converged is None else f"{line.converged:.0%}",
            *(_interval(line.figures[metric]) for metric in _SHOWN),
            seconds(None if time is None else time.median),
        )
        last = line.log
    return table


def differences_table(summary: Summary) -> Table:
    """Methods against the baseline on the same seeds, a row per log and method."""
    table = lean_table(f"differences from {summary.baseline} on the same logs and seeds; lower is better")
    table.add_column("log", overflow="fold")
    table.add_column("method", overflow="fold")
    for heading in ("pairs", *(METRICS[metric].replace(" [", "\n[") for metric in _SHOWN), "lower\nATE"):
        table.add_column(Text(heading), justify="right", no_wrap=True)
    last = None
    for line in summary.differences:
        if last not in (None, line.log):
            table.add_section()
        known = next((median for median in line.figures.values() if median is not None), None)
        ate = line.figures["ate_m"]
        table.add_row(
            "" if line.log == last else line.log,
            line.method,
            str(known.count if known else 0),
            *(_interval(line.figures[metric], sign=True) for metric in _SHOWN),
            NOTHING if ate is None else f"{line.lower['ate_m']}/{ate.count}",
        )
        last = line.log
    return table


def remarks(summary: Summary, most: int = 5) -> list[str]:
    """The sentences below the tables: what failed and how often."""
    lines = [f"{count} x {error}" for error, count in list(summary.errors.items())[:most]]
    if len(summary.errors) > most:
        lines.append(f"... and {len(summary.errors) - most} other errors; --csv or --json has them all")
    return lines


def _interval(found: Median | None, sign: bool = False) -> str:
    if found is None:
        return NOTHING

    def text(value: float) -> str:
        return ("+" if sign and value > 0 else "") + number(value)

    if found.low is None or found.high is None:
        return text(found.median)
    return f"{text(found.median)} ({text(found.low)}..{text(found.high)})"
