"""Pose graphs solved by this solver, GTSAM and g2o: cost by one evaluator, time, and whether each converged."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from functools import cache, partial
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pebble import ProcessExpired, ProcessPool

from graphslam import Certificate, Graph, GraphError, OptionError, certify, solve
from graphslam.processes import how_it_ended, processes
from graphslam.solvers.initialize import starting_state

from .display import Displayed
from .documents import certificate_document
from .options import BackendOptions
from .peers import PEERS, PeerRun
from .pool import too_long
from .results import of_expected
from .saving import jsonable

#: the names of the backends, ours first
BACKENDS = ("graphslam", *PEERS)

#: every backend stops when a step changes the cost by less than this part of it
COST_TOLERANCE = 1e-9


@dataclass(frozen=True)
class BackendRow:
    """One backend on one graph.

    Attributes:
        file, backend: which.
        chi2: the cost of the state it ended in, by `Graph.cost`; NaN if it gave up.
        iterations: their number.
        seconds: of the optimisation alone, from initial values to the stop; median of the repetitions; NaN if it was stopped.
        converged: whether its stop rule was met (for a local minimum, too: compare the chi2).
        reason: how it ended.
        trace: (seconds, chi2) after each iteration, for the figure; empty where a backend does not report them.
        chi2_per_dof: chi2 per degree of freedom, about 1 where the information in the file fits the errors.
        native: whether all factors are evaluated by the backend itself. False where GTSAM calls factors in Python, so that
            the time is mostly that of the callbacks.
        certificate: whether the state is proven to be the global minimum of chi2; None if the backend gave up.
    """

    file: str
    backend: str
    chi2: float
    iterations: int
    seconds: float
    converged: bool
    reason: str
    trace: tuple[tuple[float, float], ...] = field(default=(), repr=False)
    chi2_per_dof: float | None = None
    native: bool = True
    certificate: Certificate | None = field(default=None, repr=False)


@dataclass(frozen=True)
class BackendComparison(Displayed):
    """The outcome of `compare_backends`."""

    rows: tuple[BackendRow, ...]

    def best(self, file: str) -> float:
        """The lowest chi2 that any backend reached on a file."""
        return min((r.chi2 for r in self.rows if r.file == file and not math.isnan(r.chi2)), default=math.nan)

    def reached(self, row: BackendRow, relative: float = 1e-3) -> bool:
        """Whether a row ended at the lowest chi2 of its file, to a thousandth (the residuals of GTSAM differ a little)."""
        return row.converged and row.chi2 <= self.best(row.file) * (1 + relative) + 1e-12

    def ratio(self, row: BackendRow) -> float | None:
        """Seconds of graphslam over those of a row on the same file; None where either did not reach the best chi2."""
        ours = next((r for r in self.rows if r.file == row.file and r.backend == "graphslam"), None)
        if ours is None or not self.reached(ours) or not self.reached(row):
            return None
        return ours.seconds / row.seconds

    def geometric_mean(self, backend: str) -> float | None:
        """The geometric mean of `ratio` over the files on which both reached the best chi2; native rows only."""
        rows = (r for r in self.rows if r.backend == backend and r.native)
        ratios = [ratio for r in rows if (ratio := self.ratio(r)) is not None]
        return math.exp(statistics.fmean(map(math.log, ratios))) if ratios else None

    def to_json(self) -> dict[str, Any]:
        """The comparison as plain data: {"rows": [fields of `BackendRow` and "ratio"], "geometric_means"}."""
        rows = [
            {k: v for k, v in asdict(row).items() if k != "trace"}
            | {"ratio": self.ratio(row), "certificate": certificate_document(row.certificate)}
            for row in self.rows
        ]
        names = dict.fromkeys(row.backend for row in self.rows if row.backend != "graphslam")
        return jsonable({"rows": rows, "geometric_means": {name: self.geometric_mean(name) for name in names}})


def compare_backends(
    files: Sequence[str | PathLike[str]] | str | PathLike[str],
    *,
    progress: Callable[[BackendRow], None] | None = None,
    **options: Any,
) -> BackendComparison:
    """Optimise pose graphs with several backends: first pose fixed, the file's initial values, the same stop rule.

    Each backend runs ``repeat`` times, after a run on a tiny graph that loads or compiles its code; its time is the
    median. GTSAM and g2o prepare their graph before the time is measured; our pattern, ordering and start count.

    Args:
        files: pose graphs, see `Graph.from_g2o`; one, or several.
        progress: called after each row.
        options: the fields of `options.BackendOptions`: backends, initialize, same_start, repeat, max_iterations, format,
            time_limit [s], which holds for all runs of one backend on one file, its certificate included.

    Raises:
        OptionError: an option has an impossible value, or a backend asked for is not installed.
        FormatError, GraphError: a file is not a graph that can be solved.
    """
    given = BackendOptions.of(**options)
    rows: list[BackendRow] = []
    names = given.backends or BACKENDS
    with _measurer(names, given) as measure:
        for path in [files] if isinstance(files, (str, PathLike)) else files:
            graph, initialize = Graph.from_g2o(path, format=given.format), given.initialize
            if given.same_start:
                graph, initialize = graph.with_initial(starting_state(graph, "auto")), "given"
            for name in names:
                try:
                    rows.append(measure(str(path), name, graph, initialize))
                except OptionError:
                    if given.backends is None:
                        continue  # not installed, and not asked for by name
                    raise
                if progress is not None:
                    progress(rows[-1])
    return BackendComparison(tuple(rows))


#: makes the row of a backend, given the file, its name, the graph of the file and where graphslam starts
Measure = Callable[[str, str, Graph, str], BackendRow]


@contextmanager
def _measurer(names: Sequence[str], options: BackendOptions) -> Iterator[Measure]:
    """`_measured`, or the same in a process that is stopped at the time limit."""
    if options.time_limit is None:
        yield partial(_measured, options)
        return
    with processes(1, partial(_warm_up_all, tuple(names))) as pool:
        yield partial(_within, pool, options)


def _within(
    pool: ProcessPool, options: BackendOptions, file: str, name: str, graph: Graph, initialize: str
) -> BackendRow:
    try:
        row: BackendRow = pool.schedule(
            _measured, (options, file, name, graph, initialize), timeout=options.time_limit
        ).result()
    except TimeoutError:
        return BackendRow(file, name, math.nan, 0, math.nan, False, too_long(options.time_limit))
    except ProcessExpired as error:
        return BackendRow(file, name, math.nan, 0, math.nan, False, how_it_ended(error))
    return row


def _measured(options: BackendOptions, file: str, name: str, graph: Graph, initialize: str) -> BackendRow:
    """The row of a backend; raises `OptionError` where it is not installed."""
    run = _backend(name, graph, initialize, options.max_iterations)
    _warm_up(name)
    return _row(file, name, graph, [run() for _ in range(options.repeat)])


def _warm_up_all(names: Sequence[str]) -> None:
    for name in names:
        with suppress(Exception):  # it shows again, with its message, in the run
            _warm_up(name)


def _backend(name: str, graph: Graph, initialize: str, max_iterations: int) -> Callable[[], PeerRun]:
    """A function that optimises the graph from the start at every call."""
    if name != "graphslam":
        return PEERS[name](graph, COST_TOLERANCE, max_iterations)

    def run() -> PeerRun:
        # a fresh graph, so that pattern and ordering count in the time
        fresh = graph.with_initial(graph.initial)
        try:
            solution = solve(fresh, initialize=initialize, cost_tolerance=COST_TOLERANCE, max_iterations=max_iterations)
        except GraphError as error:
            return PeerRun(graph.initial * math.nan, 0, math.nan, False, str(error))
        return PeerRun(
            solution.state, solution.iterations, solution.seconds, solution.converged, solution.reason,
            tuple(solution.costs.tolist()),
        )  # fmt: skip

    return run


@cache
def _warm_up(name: str) -> None:
    """Solve a square with a landmark, so that a backend compiles or loads its code before the measurement."""
    lines = [f"VERTEX_SE2 {k} {k % 2} {k // 2} 0\nEDGE_SE2 {k} {(k + 1) % 4} 1 0 1.57 1 0 0 1 0 1" for k in range(4)]
    lines += ["VERTEX_XY 4 2 2", "EDGE_SE2_XY 0 4 2 2 1 0 1", "EDGE_SE2_XY 1 4 2 -1 1 0 1"]
    with TemporaryDirectory() as folder:
        path = Path(folder) / "square.g2o"
        path.write_text("\n".join(lines), encoding="utf-8")
        _backend(name, Graph.from_g2o(path), "auto", 5)()


def _row(file: str, name: str, graph: Graph, runs: Sequence[PeerRun]) -> BackendRow:
    seconds = statistics.median(run.seconds for run in runs)
    last = runs[-1]
    steps = max(len(last.costs) - 1, 1)
    trace = tuple((seconds * k / steps, cost) for k, cost in enumerate(last.costs))
    chi2 = graph.cost(last.state)
    certificate = None
    if math.isfinite(chi2):
        certificate = certify(graph, last.state).of_run(last.converged, last.reason)
    return BackendRow(
        file, name, chi2, last.iterations, seconds, last.converged, last.reason, trace, of_expected(chi2, graph),
        last.native, certificate,
    )  # fmt: skip
