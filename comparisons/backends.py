"""Pose graphs through this solver, GTSAM and g2o: cost by one evaluator, time, and how each ended."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any

from graphslam import Graph, GraphError, OptionError, solve
from graphslam.checks import check_choice
from graphslam.solvers.solve import INITIALIZE

from .display import Displayed
from .peers import PEERS, PeerRun

#: the names of the backends, ours first
BACKENDS = ("graphslam", *PEERS)

#: both stop when a step changes the cost by less than this part of it
COST_TOLERANCE = 1e-9


@dataclass(frozen=True)
class BackendRow:
    """One backend on one graph.

    Attributes:
        file, backend: which.
        chi2: the cost of the state it ended in, by `Graph.cost`; NaN if it gave up.
        iterations: that it took.
        seconds: of the optimisation alone, from initial values to the stop; median of the repetitions.
        converged: whether its stop rule was met (for a local minimum, too: compare the chi2).
        reason: how it ended.
        trace: (seconds, chi2) after each iteration, for the figure; empty where a backend does not tell.
    """

    file: str
    backend: str
    chi2: float
    iterations: int
    seconds: float
    converged: bool
    reason: str
    trace: tuple[tuple[float, float], ...] = field(default=(), repr=False)


@dataclass(frozen=True)
class BackendComparison(Displayed):
    """The outcome of `compare_backends`."""

    rows: tuple[BackendRow, ...]

    def best(self, file: str) -> float:
        """The lowest chi2 that any backend reached on a file."""
        return min((r.chi2 for r in self.rows if r.file == file and not math.isnan(r.chi2)), default=math.nan)

    def reached(self, row: BackendRow, relative: float = 1e-3) -> bool:
        """Whether a row ended at the lowest chi2 of its file, to a thousandth (residuals differ a little)."""
        return row.converged and row.chi2 <= self.best(row.file) * (1 + relative) + 1e-12

    def ratio(self, row: BackendRow) -> float | None:
        """Seconds of graphslam over those of a row on the same file; None where either did not reach the best chi2."""
        ours = next((r for r in self.rows if r.file == row.file and r.backend == "graphslam"), None)
        if ours is None or not self.reached(ours) or not self.reached(row):
            return None
        return ours.seconds / row.seconds

    def geometric_mean(self, backend: str) -> float | None:
        """The geometric mean of `ratio` over all files on which both reached the best chi2."""
        ratios = [ratio for r in self.rows if r.backend == backend and (ratio := self.ratio(r)) is not None]
        return math.exp(statistics.fmean(map(math.log, ratios))) if ratios else None

    def to_json(self) -> dict[str, Any]:
        """{"rows": [{"file", "backend", "chi2", "iterations", "seconds", "converged", "reason", "ratio"}], "means"}."""
        rows = [{k: v for k, v in vars(row).items() if k != "trace"} | {"ratio": self.ratio(row)} for row in self.rows]
        names = dict.fromkeys(row.backend for row in self.rows if row.backend != "graphslam")
        return {"rows": rows, "geometric_means": {name: self.geometric_mean(name) for name in names}}


def compare_backends(
    files: Sequence[str | PathLike[str]],
    *,
    backends: Sequence[str] | None = None,
    initialize: str = "auto",
    same_start: bool = False,
    repeat: int = 5,
    max_iterations: int = 100,
    cost_tolerance: float = COST_TOLERANCE,
    format: str | None = None,
    progress: Callable[[BackendRow], None] | None = None,
) -> BackendComparison:
    """Optimise pose graphs with several backends: first pose fixed, the file's initial values, the same stop rule.

    Each backend runs once to warm up, and then ``repeat`` times; its time is the median. GTSAM and g2o prepare their
    graph outside the clock; our pattern, ordering and start count.

    Args:
        files: pose graphs, see `Graph.from_g2o`.
        backends: some of `BACKENDS`; default: all that are installed.
        initialize: where graphslam starts, see `graphslam.solve`.
        same_start: hand every backend, this solver included, the state from which "auto" starts.
        repeat: how many times the clock runs.
        max_iterations: for all.
        cost_tolerance: stop when a step changes the cost by less than this part of it.
        format: of the files.
        progress: called after each row.

    Raises:
        OptionError: an option has an impossible value, or a backend asked for is not installed.
        FormatError, GraphError: a file is not a graph that can be solved.
    """
    check_choice("initialize", initialize, INITIALIZE)
    for name in backends or ():
        check_choice("backends", name, BACKENDS)
    if repeat < 1:
        raise OptionError(f"repeat must be at least 1, not {repeat}")
    rows: list[BackendRow] = []
    for path in map(Path, files):
        graph = Graph.from_g2o(path, format=format)
        if same_start:
            from graphslam.solvers.solve import starting_state

            graph, initialize = graph.with_initial(starting_state(graph, "auto")), "given"
        for name in backends or BACKENDS:
            try:
                run = _ours(graph, initialize, cost_tolerance, max_iterations) if name == "graphslam" else None
                run = run or PEERS[name](graph, cost_tolerance, max_iterations)
            except OptionError:
                if backends is None:
                    continue  # not installed, and not asked for by name
                raise
            rows.append(_row(path, name, graph, run, repeat))
            if progress is not None:
                progress(rows[-1])
    return BackendComparison(tuple(rows))


def _ours(graph: Graph, initialize: str, cost_tolerance: float, max_iterations: int) -> Callable[[], PeerRun]:
    def run() -> PeerRun:
        # a fresh graph, so that pattern and ordering are found within the clock
        fresh = graph.with_initial(graph.initial)
        try:
            solution = solve(fresh, initialize=initialize, cost_tolerance=cost_tolerance, max_iterations=max_iterations)
        except GraphError as error:
            return PeerRun(graph.initial * math.nan, 0, math.nan, False, str(error))
        return PeerRun(
            solution.state, solution.iterations, solution.seconds, solution.converged, solution.reason,
            tuple(solution.costs.tolist()),
        )  # fmt: skip

    return run


def _row(path: Path, name: str, graph: Graph, run: Callable[[], PeerRun], repeat: int) -> BackendRow:
    run()
    runs = [run() for _ in range(repeat)]
    seconds = statistics.median(r.seconds for r in runs)
    last = runs[-1]
    chi2 = graph.cost(last.state)
    steps = max(len(last.costs) - 1, 1)
    trace = tuple((seconds * k / steps, cost) for k, cost in enumerate(last.costs))
    return BackendRow(str(path), name, chi2, last.iterations, seconds, last.converged, last.reason, trace)
