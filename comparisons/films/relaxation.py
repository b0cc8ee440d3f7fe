"""The film of the graph: it relaxes iteration by iteration, its edges coloured by how far each is stretched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from matplotlib.artist import Artist
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure

from graphslam import Graph, GraphError, Log, OptionError, Solution, estimate_map, solve
from graphslam.se2 import Array, wrap
from graphslam.solvers.solve import METHODS, Iteration, starting_state

from ..estimator import RunOptions
from ..estimators import make_graph
from .film import Film
from .frame import Frame, kept
from .projector import Show
from .stage import Curve, MapArtists, Stage, placement_of
from .strain import Strain

#: pictures per second: an iteration wants to be looked at
FPS = 2.0
#: from relaxed to overstretched: pale to dark, one hue after the other in lightness, so that a grey print shows it too
COLORS = LinearSegmentedColormap.from_list("strain", ["#E6E1D8", "#F0B860", "#D55E00", "#7A1B4B", "#1B0B2E"])


@dataclass(frozen=True, kw_only=True, eq=False)
class Relaxed(Frame):
    """The graph after an iteration.

    Attributes:
        estimated: (T+1,) bool; False for poses that no edge touches.
        cost: J at this state.
        step_norm: the norm of the correction that led here; None at the start.
        edges: (E, 2, 2) the edges as lines, the most stretched ones last.
        distances: (E,) their Mahalanobis distances sqrt(e' Omega e), increasing.
    """

    estimated: np.ndarray
    cost: float
    step_norm: float | None
    edges: Array
    distances: Array


def relaxation(log: Log, options: RunOptions, max_frames: int, fps: float | None = None) -> Film:
    """The film of `graphslam.solve` on the log's graph.

    With ``initialize="auto"`` it starts from dead reckoning, unless the solver ends in a worse minimum from there than
    it does from a better start; then it starts from that one, and a note says so.

    Raises:
        GraphError: the log does not determine the graph.
        OptionError: graduated non-convexity is asked for, which solves many graphs.
    """
    if options.robust == "gnc":
        raise OptionError("a film shows one graph relax, and gnc solves many: take a kernel instead, or --robust none")
    graph = make_graph(log, options)
    run, notes = _chosen(graph, options.initialize)
    strain = Strain(graph)
    if strain.shown < strain.count:
        notes = (*notes, f"{strain.shown} of {strain.count} edges are drawn")
    costs = np.array([graph.cost(state) for state in run.states])
    numbers = kept(len(run.states), max_frames)
    frames = tuple(_frame(graph, log, strain, run, n, float(costs[n])) for n in numbers.tolist())
    title = f"{log.name}: graph SLAM, {graph.num_edges} edges relaxing"
    return Film(
        title, frames, len(run.states), fps or FPS, (*graph.notes, *notes),
        lambda figure: _scene(figure, log, options, title, frames, costs),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Run:
    """One way of the solver: where it began and its state after every iteration, and the norms of the corrections."""

    begun: str
    states: tuple[Array, ...]
    step_norms: tuple[float | None, ...]
    solution: Solution


def _run(graph: Graph, initialize: str, method: str = "gauss-newton", max_iterations: int = 100) -> _Run:
    start = starting_state(graph, initialize)
    seen: list[Iteration] = []
    solution = solve(
        graph.with_initial(start),
        method=method,
        max_iterations=max_iterations,
        initialize="given",
        callback=seen.append,
    )
    # a run that left the numbers ends where it still had some
    finite = [step for step in seen if np.isfinite(step.state).all()]
    return _Run(
        initialize,
        (start, *(step.state for step in finite)),
        (None, *(step.step_norm for step in finite)),
        solution,
    )


def _chosen(graph: Graph, initialize: str) -> tuple[_Run, tuple[str, ...]]:
    """The run to be shown, and what there is to say about its start."""
    if initialize != "auto":
        return _run(graph, initialize), ()
    best = solve(graph, initialize="auto")
    # a way that is much longer than the best one leads astray
    patience = max(3 * best.iterations, 30)
    from_given: _Run | None = None
    # undamped first: damped steps from far away are many, and rarely end where the others do
    for method, begun in product(METHODS, ("given", "virtual-motion", "rotation-first")):
        try:
            run = _run(graph, begun, method, patience)
        except GraphError:
            continue  # these edges do not allow that start
        from_given = from_given or run
        if run.solution.cost <= best.cost * (1 + 1e-6):
            if begun == "given":
                return run, ()
            other = from_given.solution
            worse = (
                f"from dead reckoning J is {other.cost:.6g} after {other.iterations} iterations, not {best.cost:.6g}"
            )
            return run, (f"{worse}: the film starts {_STARTS[begun]}",)
    assert from_given is not None  # solve has just done it
    return from_given, ()


_STARTS = {"virtual-motion": "where virtual-motion edges put the poses", "rotation-first": "from the headings"}


def _frame(graph: Graph, log: Log, strain: Strain, run: _Run, number: int, cost: float) -> Relaxed:
    state, norm = run.states[number], run.step_norms[number]
    poses, estimated = graph.trajectory_of(state)
    poses[:, 2] = wrap(poses[:, 2])
    placed = estimate_map(log, poses, sensor=graph.sensor)
    nodes = state[len(graph.steps) :, : graph.landmark_dimension]
    edges, distances = strain(state)
    begun = "start" if run.begun == "given" else f"start ({run.begun})"
    return Relaxed(
        number=number,
        caption=f"{begun}    J = {cost:,.6g}" if norm is None else _caption(number, cost, norm),
        poses=poses,
        estimated=estimated,
        landmarks=dict(zip(graph.landmark_ids.tolist(), nodes)) if len(nodes) else dict(placed),
        landmark_covariances=placed.covariances,
        cost=cost,
        step_norm=norm,
        edges=edges,
        distances=distances,
    )


def _caption(number: int, cost: float, norm: float) -> str:
    return f"iteration {number}    J = {cost:,.6g}    |Δ| = {norm:.1e}"


def _scene(figure: Figure, log: Log, options: RunOptions, title: str, frames: Sequence[Relaxed], costs: Array) -> Show:
    last = frames[-1]
    dead = log.initial_poses if log.controls is None else log.dead_reckoning(options.motion)
    # one scale for the whole film: from what is relaxed to what is stretched most at the start, single edges aside
    highest = max(float(np.quantile(frames[0].distances, 0.98)), 10.0)
    scale = LogNorm(1.0, highest)
    stage = Stage(
        figure, log, "graph", placement_of(log, last.poses, last.estimated), frames[0], last, dead, title,
        (scale, COLORS, "Mahalanobis distance of an edge"),
    )  # fmt: skip
    lines = LineCollection([], cmap=COLORS, norm=scale, linewidths=0.5, animated=True)
    stage.plane.add_collection(lines, autolim=False)
    path = stage.path("graph", linewidth=2.0)
    landmarks = MapArtists(stage, "map (3σ, given the path)")
    curve = Curve(stage, np.arange(len(costs)), costs, "iteration", "J", log_scale=True)
    stage.legend()

    def show(frame: Frame) -> Sequence[Artist]:
        assert isinstance(frame, Relaxed)
        ends = stage.placed(frame.edges.reshape(-1, 2))
        lines.set_segments(list(ends.reshape(-1, 2, 2)))
        lines.set_array(frame.distances)
        poses = np.where(frame.estimated[:, None], stage.placed(frame.poses), np.nan)
        path.set_data(poses[:, 0], poses[:, 1])
        return [lines, *stage.known, path, *landmarks.show(frame), *curve.show(frame), *stage.words(frame)]

    return show
