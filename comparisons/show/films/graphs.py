"""The films of solved graphs: iteration by iteration, ISAM2 step by step, and the association of sightings without ids."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from matplotlib.colors import LinearSegmentedColormap, ListedColormap, LogNorm, Normalize
from matplotlib.lines import Line2D

import graphslam
from graphslam import Graph, GraphError, Log, OnlineSolver, OptionError, SensorModel, Solution, solve
from graphslam.edges import AnchorEdges, EdgeFamily, MarginalEdges, PositionEdges, PriorEdges, VirtualMotionEdges
from graphslam.log import UNIDENTIFIED
from graphslam.se2 import Array, wrap
from graphslam.solvers.initialize import starting_state
from graphslam.solvers.iteration import Iteration

from ...estimators import ESTIMATORS, isam2_options, make_graph, online_keywords
from ...estimators.filters import identified
from ...options import AnimationOptions, RunOptions
from ...results.results import CLUTTER, CONFIRMED, UNCONFIRMED, status_of
from ..canvas import RESIDUALS, SIGHTINGS
from .scene import Film, Frame, Scene, kept

#: of a family with more edges some are drawn, evenly spread: more lines would only fill the picture
MOST_EDGES = 4000
COLORS = LinearSegmentedColormap.from_list("residuals", RESIDUALS)


def graph_film(log: Log, options: RunOptions, animation: AnimationOptions, progress: Callable[[], None]) -> Film:
    """The film of `graphslam.solve` on the log's graph, its edges coloured by their Mahalanobis distances.

    With ``initialize="auto"`` it starts from dead reckoning. Where the solver reaches a lower minimum from another start, the
    iterations from there follow, and a note names both costs.

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
    frames: list[Frame] = []
    for number in kept(len(run.states), animation.max_frames).tolist():
        frames.append(_after_iteration(graph, residuals, run, number, float(costs[number])))
        progress()
    # one scale for the whole film, up to the largest residuals of the start but for single edges
    norm = LogNorm(1.0, max(float(np.quantile(frames[0].values, 0.98)), 10.0))

    def parts(scene: Scene) -> None:
        scene.add_coloured(norm, COLORS, linewidths=0.5)
        scene.add(lambda _: None, *scene.known)
        scene.add_path("graph", linewidth=2.0)
        scene.add_map("map (3σ, given the path)")
        scene.add_curve(np.arange(len(costs)), costs, "iteration", "J", log=True)

    return Film(
        title=f"{log.name}: graph SLAM, {graph.num_edges} edges", name="graph", frames=tuple(frames), steps=len(run.states),
        notes=(*graph.notes, *notes), parts=parts, log=log, motion=options.motion,
        scale=(norm, COLORS, "Mahalanobis distance of an edge"), named=identified(log, options)[1] is None,
    )  # fmt: skip


class _Run(NamedTuple):
    """The iterations from one start: the state after each, the norms of the corrections, and the solution."""

    start: str
    states: tuple[Array, ...]
    step_norms: tuple[float, ...]
    solution: Solution


def _run(graph: Graph, start: str, max_iterations: int = 100) -> _Run:
    """The iterations of `solve`; with "auto", which starts from states of its own, the first state is dead reckoning."""
    state = graph.initial if start == "auto" else starting_state(graph, start)
    steps: list[Iteration] = []
    rules: dict[str, Any] = {"initialize": start, "max_iterations": max_iterations, "callback": steps.append}
    solution = solve(graph, **rules)
    # a run that diverged ends at its last finite state
    finite = [step for step in steps if np.isfinite(step.state).all()]
    return _Run(start, (state, *(step.state for step in finite)), tuple(step.step_norm for step in finite), solution)


def _chosen(graph: Graph, initialize: str) -> tuple[_Run, tuple[str, ...]]:
    """The run to be shown, and what there is to say about its start."""
    run = _run(graph, initialize)
    if initialize != "auto":
        return run, ()
    best, worse = run.solution, "dead reckoning does not determine the graph"
    with suppress(GraphError):
        # a run that takes much longer than the best one ends elsewhere
        plain = _run(graph, "given", max(3 * best.iterations, 30))
        if plain.solution.cost <= best.cost * (1 + 1e-6):
            return plain, ()
        end = plain.solution
        worse = f"from dead reckoning J is {end.cost:.6g} after {end.iterations} iterations, not {best.cost:.6g}"
    return run, (f"{worse}: after the first picture the animation shows the iterations from another start",)


def _after_iteration(graph: Graph, residuals: Residuals, run: _Run, number: int, cost: float) -> Frame:
    state = run.states[number]
    poses, estimated = graph.trajectory_of(state)
    poses[:, 2] = wrap(poses[:, 2])
    of_path = graph.map_from(poses)
    nodes = state[len(graph.steps) :, : graph.landmark_dimension]
    lines, distances = residuals(state)
    caption = f"iteration {number}" if number else "start" if run.start in ("given", "auto") else f"start ({run.start})"
    norm = f"    |Δ| = {run.step_norms[number - 1]:.1e}" if number else ""
    return Frame(
        number=number, caption=f"{caption}    J = {cost:,.6g}{norm}", poses=poses, estimated=estimated,
        landmarks=dict(zip(graph.landmark_ids.tolist(), nodes)) if len(nodes) else dict(of_path),
        landmark_covariances=of_path.covariances, lines=lines, values=distances,
    )  # fmt: skip


def isam2_film(log: Log, options: RunOptions, animation: AnimationOptions, progress: Callable[[], None]) -> Film:
    """The film of `graphslam.solve_online` with ISAM2, the path coloured by the correction since the last frame.

    Raises:
        GraphError, OptionError: ISAM2 cannot do what is asked for on this log.
    """
    keywords = online_keywords(isam2_options(log, options))
    wanted = set(kept(log.num_poses, animation.max_frames).tolist())
    frames: list[Frame] = []

    def after_step(solver: OnlineSolver) -> None:
        if solver.step in wanted:
            frames.append(_after_step(log, solver, frames[-1].poses if frames else np.empty((0, 3))))
        progress()

    solution = graphslam.solve_online(log, backend="isam2", callback=after_step, **keywords)
    largest = np.array([frame.values.max() for frame in frames])
    norm = LogNorm(1e-3, max(float(largest.max()), 1e-2))

    def parts(scene: Scene) -> None:
        def corrections(frame: Frame) -> tuple[Array, Array]:
            places = scene.along(frame.poses)
            motion = scene.between.motions[: len(places) - 1]
            # a segment has moved as far as the end that moved farther; the newest pose has not moved yet
            moved = np.maximum(frame.values[motion], frame.values[motion + 1])
            return np.stack([places[:-1], places[1:]], axis=1), moved

        scene.add_sightings()
        scene.add_map("map (3σ, given the path)")
        scene.add_path("isam2", linewidth=5.0, alpha=0.3)
        scene.add_coloured(norm, COLORS, corrections, linewidths=2.4, capstyle="round")
        scene.add_robot()
        # less than a micrometre is rounding
        visible = np.where(largest > 1e-6, largest, np.nan)
        scene.add_curve(np.array([frame.number for frame in frames]), visible, "step", "largest [m]", log=True)

    return Film(
        title=f"{log.name}: ISAM2, {keywords['edges'].replace('+', ' + ')} edges", name="isam2", frames=tuple(frames),
        steps=log.num_poses, notes=solution.notes, parts=parts, log=log, motion=options.motion,
        scale=(norm, COLORS, "correction of a pose since the previous frame [m]"),
    )  # fmt: skip


def _after_step(log: Log, solver: OnlineSolver, before: Array) -> Frame:
    """The frame after a step; its values are how far each pose (k,) has moved since the one before [m], 0 for new ones."""
    step, poses = solver.step, solver.poses
    corrections = np.zeros(len(poses))
    corrections[: len(before)] = np.hypot(*(poses[: len(before), :2] - before[:, :2]).T)
    past = log.with_sightings(log.steps <= step)
    # the steps to come have no pose yet, and nothing was seen from them
    trajectory = np.concatenate([poses, np.zeros((log.num_poses - len(poses), 3))])
    estimated = graphslam.estimate_map(past, trajectory, sensor=solver.sensor, kernel=solver.kernel)
    seen = log.sightings[log.steps == step]
    metres = np.max(corrections)
    length = f"{metres:.2f} m" if metres >= 0.1 else f"{1000 * metres:.1f} mm"
    return Frame(
        number=step, caption=f"step {step}    largest correction {length}", poses=poses,
        landmarks=solver.landmarks or dict(estimated), landmark_covariances=estimated.covariances, values=corrections,
        sightings=solver.sensor.h_inverse(poses[-1], seen)[:, :2],
    )  # fmt: skip


_LABELS = {CONFIRMED: "certain", UNCONFIRMED: "uncertain", CLUTTER: "of no landmark"}


def association_film(log: Log, options: RunOptions, animation: AnimationOptions, progress: Callable[[], None]) -> Film:
    """The film of the ids that ``graph`` finds, on the trajectory and map of its end. Ids of the log are not used.

    A line leads from the robot to the landmark of each sighting, or to where it was seen. Its value is the number of its
    status in `_LABELS`.

    Raises:
        SlamError: no ids are found, or the log does not determine the graph.
    """
    if len(log.steps) == 0:
        raise GraphError(f"{log.name} has no sightings of range and bearing, so there is nothing to associate")
    result = ESTIMATORS["graph"].run(log.replace(landmarks=np.full(len(log.steps), UNIDENTIFIED)), options)
    assert result.association is not None and result.found is not None
    status, sensor = status_of(result), options.sensor or log.sensor or SensorModel()
    numbers = np.array([list(_LABELS).index(each) for each in status.tolist()])
    ends = sensor.h_inverse(result.poses[log.steps], log.sightings)[:, :2]
    for k, j in enumerate(result.association.tolist()):
        if j in result.landmarks:
            ends[k] = result.landmarks[j][:2]
    lines = np.stack([log.at_truth(result.poses)[log.steps, :2], ends], axis=1)
    frames: list[Frame] = []
    for step in kept(log.num_poses, animation.max_frames).tolist():
        now, before = log.steps == step, log.steps <= step
        known = set(result.association[before].tolist())
        counts = np.bincount(numbers[before], minlength=len(_LABELS)).tolist()
        frames.append(Frame(
            number=step,
            caption=f"step {step}    sightings: " + ", ".join(f"{n} {each}" for each, n in zip(_LABELS.values(), counts)),
            poses=result.poses[: step + 1], estimated=result.estimated[: step + 1],
            landmarks={j: m for j, m in result.landmarks.items() if j in known},
            landmark_covariances={j: S for j, S in result.landmark_covariances.items() if j in known},
            lines=lines[now], values=numbers[now],
        ))  # fmt: skip
        progress()
    uncertain = np.bincount(log.steps[status != CONFIRMED], minlength=log.num_poses)

    def parts(scene: Scene) -> None:
        scene.add_map("map (3σ)")
        scene.add_path("graph")
        for each, label in _LABELS.items():
            scene.remember(f"sighting: {label}", Line2D([], [], color=SIGHTINGS[each]))
        colours = ListedColormap([SIGHTINGS[each] for each in _LABELS])
        scene.add_coloured(Normalize(0, len(_LABELS) - 1), colours, linewidths=1.3)
        scene.add_robot()
        scene.add_curve(np.arange(log.num_poses), np.cumsum(uncertain).astype(float), "step", "not confirmed")

    ignored = () if np.all(log.landmarks == UNIDENTIFIED) else ("the ids of the log are not used",)
    return Film(
        title=f"{log.name}: association, {len(result.landmarks)} landmarks", name="graph", frames=tuple(frames),
        steps=log.num_poses, notes=(*result.found.notes, *ignored), parts=parts, log=log, motion=options.motion,
        named=False,
    )  # fmt: skip


class Residuals:
    """The edges of a graph as lines, those with the largest residuals last.

    The number of virtual-motion edges is quadratic in the sightings, so each landmark's sightings are thinned before the
    edges are listed. Of the other families every N-th edge is drawn.

    Attributes:
        drawn, count: how many edges are drawn, and how many there are. The priors of a map are no lines.
    """

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._families = [_thinned(f) for f in graph.families if not isinstance(f, (AnchorEdges, PriorEdges))]
        self.count = graph.num_edges - sum(f.count for f in graph.families if isinstance(f, PriorEdges))
        self.drawn = len(self(graph.initial)[1])

    def __call__(self, state: Array) -> tuple[Array, Array]:
        """At a state (n, 3): the lines (E, 2, 2) [m] and their Mahalanobis distances (E,), increasing.

        A line ends at the point of the robot to which the log's ground truth belongs, as paths do. Of a measured
        position it leads from the point of the robot to where that was measured.
        """
        places, poses = state.copy(), len(self._graph.steps)
        if self._graph.log is not None:
            places[:poses] = self._graph.log.at_truth(state[:poses])
        lines, distances = [np.empty((0, 2, 2))], [np.empty(0)]
        for family, factor, every in self._families:
            edges = family.linearize(state, state)
            begin = places[edges.nodes[0], :2]
            if isinstance(family, MarginalEdges):
                end = family.landmarks(state, state)[family.group, :2]
            elif isinstance(family, PositionEdges):
                begin, end = family.points(state), family.measured[:, :2]
            else:
                end = places[edges.nodes[1], :2]
            lines.append(np.stack([begin, end], axis=1)[::every])
            distances.append(np.sqrt(np.maximum(factor * edges.mahalanobis, 0))[::every])
        line, distance = np.concatenate(lines), np.concatenate(distances)
        order = np.argsort(distance, kind="stable")
        return line[order], distance[order]


def _thinned(family: EdgeFamily) -> tuple[EdgeFamily, Array, int]:
    """A family that is quick to list, the factor (E,) or (1,) on its e' Omega e, and N where every N-th edge is drawn."""
    if family.count <= MOST_EDGES or not isinstance(family, VirtualMotionEdges):
        return family, np.ones(1), max(1, math.ceil(family.count / MOST_EDGES))
    apart = math.ceil(math.sqrt(family.count / MOST_EDGES))
    left = (np.arange(len(family.nodes)) - family.starts[family.group]) % apart == 0
    starts = np.concatenate([[0], np.cumsum(np.bincount(family.group[left], minlength=len(family.starts) - 1))])
    fewer = replace(family.among(left), starts=starts)
    # the weight of a tempered pair is 2/K, with K of all sightings
    return fewer, (family.group_weights / fewer.group_weights)[fewer.pairs()[2]], 1
