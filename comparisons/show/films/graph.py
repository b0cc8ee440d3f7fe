"""The film of the graph: iteration by iteration, its edges coloured by their residuals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from matplotlib.artist import Artist
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from graphslam import Graph, GraphError, Log, OptionError, Solution, solve
from graphslam.se2 import Array, wrap
from graphslam.solvers.initialize import starting_state
from graphslam.solvers.iteration import Iteration
from graphslam.solvers.minimize import METHODS

from ...estimators import make_graph
from ...options import AnimationOptions, RunOptions
from ..canvas import placement_of
from .scene import COLORS, Film, Frame, Residuals, Scene, Show, kept

#: the starts that are tried, and how a note names them
_STARTS = {
    "given": "",
    "virtual-motion": "where virtual-motion edges put the poses",
    "rotation-first": "from the headings",
    "grow": "where growing the graph puts the poses",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class GraphFrame(Frame):
    """The graph after an iteration.

    Attributes:
        cost: J at this state.
        edges: (E, 2, 2) the edges as lines, those with the largest residuals last.
        distances: (E,) their Mahalanobis distances sqrt(e' Omega e), increasing.
    """

    cost: float
    edges: Array
    distances: Array


def graph_film(log: Log, options: RunOptions, animation: AnimationOptions, progress: Callable[[], None]) -> Film:
    """The film of `graphslam.solve` on the log's graph.

    With ``initialize="auto"`` it starts from dead reckoning, unless the solver reaches a lower minimum from another start;
    then it starts there, and a note names both costs.

    Raises:
        GraphError: the log does not determine the graph.
        OptionError: graduated non-convexity is asked for, which solves many graphs.
    """
    if options.kernel == "gnc":
        raise OptionError(
            "an animation shows the iterations on one graph, and gnc solves many: choose another kernel, "
            "such as --kernel cauchy"
        )
    graph = make_graph(log, options)
    run, notes = _chosen(graph, options.initialize)
    residuals = Residuals(graph)
    if residuals.drawn < residuals.count:
        notes = (*notes, f"{residuals.drawn} of {residuals.count} edges are drawn")
    costs = np.array([graph.cost(state) for state in run.states])
    frames: list[GraphFrame] = []
    for number in kept(len(run.states), animation.max_frames).tolist():
        frames.append(_frame(graph, residuals, run, number, float(costs[number])))
        progress()
    title = f"{log.name}: graph SLAM, {graph.num_edges} edges"

    def set_up(figure: Figure) -> Show:
        # one scale for the whole film, up to the largest residuals of the start but for single edges
        scale = LogNorm(1.0, max(float(np.quantile(frames[0].distances, 0.98)), 10.0))
        scene = Scene(
            figure, log, "graph", placement_of(log, frames[-1].poses, frames[-1].estimated, frames[-1].landmarks), frames,
            title, options.motion, (scale, COLORS, "Mahalanobis distance of an edge"),
        )  # fmt: skip
        lines = scene.add_lines(cmap=COLORS, norm=scale, linewidths=0.5)

        def edges(frame: GraphFrame) -> Sequence[Artist]:
            lines.set_segments(list(scene.moved(frame.edges.reshape(-1, 2)).reshape(-1, 2, 2)))
            lines.set_array(frame.distances)
            return [lines, *scene.known]

        scene.add(edges)
        scene.add_path("graph", linewidth=2.0)
        scene.add_map("map (3σ, given the path)")
        scene.add_curve(np.arange(len(costs)), costs, "iteration", "J", log=True)
        return scene.finish()

    return Film(title, tuple(frames), len(run.states), (*graph.notes, *notes), set_up, log)


@dataclass(frozen=True, eq=False)
class _Run:
    """The iterations from one start: the state after each, the norms of the corrections, and the solution."""

    start: str
    states: tuple[Array, ...]
    step_norms: tuple[float, ...]
    solution: Solution


def _run(graph: Graph, start: str, method: str = "gauss-newton", max_iterations: int = 100) -> _Run:
    state = starting_state(graph, start)
    steps: list[Iteration] = []
    solution = solve(
        graph.with_initial(state), initialize="given", method=method, max_iterations=max_iterations,
        callback=steps.append,
    )  # fmt: skip
    # a run that diverged ends at its last finite state
    finite = [step for step in steps if np.isfinite(step.state).all()]
    return _Run(start, (state, *(step.state for step in finite)), tuple(step.step_norm for step in finite), solution)


def _chosen(graph: Graph, initialize: str) -> tuple[_Run, tuple[str, ...]]:
    """The run to be shown, and what there is to say about its start."""
    if initialize != "auto":
        return _run(graph, initialize), ()
    best = solve(graph, initialize="auto")
    # a run that takes much longer than the best one ends elsewhere
    limit = max(3 * best.iterations, 30)
    runs: list[_Run] = []
    # undamped first: damped steps from far away are many, and rarely end where the others do
    for method, start in product(METHODS, _STARTS):
        try:
            runs.append(_run(graph, start, method, limit))
        except GraphError:
            continue  # these edges do not allow that start
        if runs[-1].solution.cost <= best.cost * (1 + 1e-6):
            break
    else:
        runs = runs[:1]
    run, other = runs[-1], runs[0].solution
    if run.start == "given":
        return run, ()
    worse = f"from dead reckoning J is {other.cost:.6g} after {other.iterations} iterations, not {best.cost:.6g}"
    return run, (f"{worse}: the animation starts {_STARTS[run.start]}",)


def _frame(graph: Graph, residuals: Residuals, run: _Run, number: int, cost: float) -> GraphFrame:
    state = run.states[number]
    poses, estimated = graph.trajectory_of(state)
    poses[:, 2] = wrap(poses[:, 2])
    of_path = graph.map_from(poses)
    nodes = state[len(graph.steps) :, : graph.landmark_dimension]
    edges, distances = residuals(state)
    caption = f"iteration {number}" if number else "start" if run.start == "given" else f"start ({run.start})"
    norm = f"    |Δ| = {run.step_norms[number - 1]:.1e}" if number else ""
    return GraphFrame(
        number=number,
        caption=f"{caption}    J = {cost:,.6g}{norm}",
        poses=poses,
        estimated=estimated,
        landmarks=dict(zip(graph.landmark_ids.tolist(), nodes)) if len(nodes) else dict(of_path),
        landmark_covariances=of_path.covariances,
        cost=cost,
        edges=edges,
        distances=distances,
    )
