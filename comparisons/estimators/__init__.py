"""The estimators that can be compared: each takes a `Log` and `RunOptions` and returns an `EstimatorResult`.

Add one by writing its function and naming it in `ESTIMATORS`; tables, figures and the command line follow.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from functools import cache, partial
from typing import Any

import numpy as np

import fastslam
import graphslam
from fastslam.options import LOCALISATION, check_one_drive
from graphslam import Graph, GraphError, Log, MotionModel, OptionError, SensorModel, SlamError, Solution, simulate
from graphslam.errors import checks, quoted
from graphslam.graph.defaults import edges_for_map, suitable_edges, suitable_for_isam2, suitable_kernel
from graphslam.log import UNIDENTIFIED
from graphslam.log.measurements import MEASURED
from graphslam.online import replay
from graphslam.se2 import wrap
from graphslam.solvers.contradictions import BEYOND_NOISE
from graphslam.solvers.iteration import Run
from graphslam.solvers.minimize import AT_MEASURED, shortened_ranges, takes_estimated_ranges
from graphslam.solvers.solution import make_solution

from ..options import FrontEndOptions, GraphOptions, RunOptions, options_of
from ..results import EstimatorResult, noted
from .filters import FILTER, identified, mcl, of_several_seeds, timed

#: seconds per iteration above which an estimator is left out unless asked for by name
PATIENCE = 0.5
#: a sighting to which the kernel gives less weight than this counts as weighed down
WEIGHED_DOWN = 0.5


@dataclass(frozen=True)
class Estimator:
    """An entry of the registry.

    Attributes:
        run: the function; raises `graphslam.SlamError` where it cannot run on this log. The options have noise models.
        uses: the names of the options that it uses, other than those of reading and noise.
        seconds_per_iteration: a forecast for estimators that are slow on large logs, or None.
        repeats: why another estimator gives the same result with these options, or None.
        on_request: whether it runs only where it is asked for by name.
    """

    run: Callable[[Log, RunOptions], EstimatorResult]
    uses: tuple[str, ...] = ()
    seconds_per_iteration: Callable[[Log, RunOptions], float] | None = None
    repeats: Callable[[Log, RunOptions], str | None] = lambda _log, _options: None
    on_request: bool = False

    def reason_to_omit(self, log: Log, options: RunOptions) -> str | None:
        """The reason to leave the estimator out unless it is asked for by name, or None."""
        return self.too_slow(log, options) or self.repeats(log, options)

    def too_slow(self, log: Log, options: RunOptions) -> str | None:
        """The reason why the estimator would take too long on a log, or None."""
        # where no ids can be found, it fails with that reason when it runs
        with suppress(SlamError):
            seconds = 0.0 if self.seconds_per_iteration is None else self.seconds_per_iteration(log, options)
            if seconds > PATIENCE:
                return (
                    f"it would take about {seconds:.0f} s per iteration on this log; name it in --estimators to run it"
                )
        return None


def make_graph(log: Log, options: RunOptions) -> Graph:
    """The one graph that ``graph`` and ``gtsam`` solve. Where sightings have no ids, these are found first.

    Raises:
        GraphError: the log does not determine it.
    """
    known, found = identified(log, options)
    keywords = graph_keywords(options) | {"map": options.landmark_map}
    return Graph.from_log(known, **(keywords if found is None else keywords | {"motion": found.motion}))


def graph_keywords(options: RunOptions) -> dict[str, Any]:
    """The keywords of `Graph.from_log` that the options name; it chooses the others."""
    given = {name: getattr(options, name) for name in _GRAPH if name != "initialize"}
    # graduated non-convexity needs no robust kernel
    kernel = "none" if options.kernel == "gnc" else options.kernel
    return given | {"motion": options.motion, "sensor": options.sensor, "kernel": kernel}


def chosen(log: Log, options: RunOptions) -> RunOptions:
    """The options with the edges and the kernel that suit the log, where they name none.

    The choice is that of `Graph.from_log`.
    """
    if options.landmark_map is not None:
        options = replace(options, edges=edges_for_map(log, options.edges))
    edges = options.edges or suitable_edges(log, options.motion, options.sensor)
    return replace(options, edges=edges, kernel=options.kernel or suitable_kernel(log))


def dead_reckoning(log: Log, options: RunOptions) -> EstimatorResult:
    """x_t = f(x_{t-1}, u_t) without noise; the log's own initial poses where it has no controls."""
    poses, seconds = timed(lambda: log.initial_poses if log.controls is None else log.dead_reckoning(options.motion))
    notes = ["the log has no controls: these are its own initial poses"] if log.controls is None else []
    poses = np.column_stack([poses[:, :2], wrap(poses[:, 2])])
    maps: dict[str, Any] = {}
    with noted(notes, "the map is not known"):
        landmarks = graphslam.estimate_map(log, poses, sensor=options.sensor)
        maps = {"landmarks": dict(landmarks), "landmark_covariances": landmarks.covariances}
    return EstimatorResult(
        name="dead-reckoning", poses=poses, estimated=np.ones(len(poses), dtype=bool), seconds=seconds, notes=tuple(notes),
        log=log, motion=options.motion, **maps,
    )  # fmt: skip


def textbook_estimator(log: Log, options: RunOptions) -> EstimatorResult:
    """The lectures' program as it stands, with the book's threshold; J is the world-frame cost that it works on."""
    _no_map("textbook", options)
    check_one_drive("textbook", log)
    defaults = {each: getattr(GraphOptions, each) for each in _GRAPH if each != "edges"}
    defaults |= {"frame": "world", "kernel": "none"}
    options, notes = _fixed(options, "it is the lectures' program as it stands", **defaults)
    edges = options.edges
    if edges not in graphslam.textbook.THRESHOLDS:
        edges = "virtual" if log.controls is None else "virtual+motion"
    models: dict[str, Any] = {"motion": options.motion, "sensor": options.sensor}
    result, seconds = timed(lambda: graphslam.textbook.solve(log, edges=edges, **models))
    # J and the map by the graph's own code, which gets what the book's cost has
    plain = log.replace(**dict.fromkeys(MEASURED))
    graph = Graph.from_log(plain, edges=edges, frame="world", kernel="none", **models)
    run = Run(
        result.poses[graph.steps], result.threshold, costs=result.costs, step_norms=result.step_norms,
        converged=result.converged, reason=result.reason,
    )  # fmt: skip
    solution = make_solution(graph, run, "textbook", seconds)
    used = {"edges": edges, "frame": "world", "weight": "pairs", "threshold": result.threshold}
    found = _of_solution("textbook", log, options, replace(solution, notes=notes))
    return replace(found, options=used, costs=np.array(result.costs))


def _fixed(options: RunOptions, reason: str, **fixed: Any) -> tuple[RunOptions, tuple[str, ...]]:
    """The options with those that an estimator has fixed, and a note on those that were given another value."""
    given = [each.flag for each, value in options.changed() if each.name in fixed and value != fixed[each.name]]
    notes = (f"does not use {', '.join(given)}: {reason}",) * bool(given)
    if options.filter.range_noise == "estimated":
        notes += ("does not use --range-noise: it takes the noise of ranges as they were measured",)
    return replace(options, **fixed), notes


def _counted_once(log: Log, options: RunOptions) -> str | None:
    """The reason why the graph counts each sighting once in any case, or None."""
    if str(chosen(log, options).edges).startswith("landmark"):
        return "the landmarks of graph are nodes, which already counts each sighting once"
    return "graph has marginal weights already" if options.weight == "marginal" else None


def by_hand(name: str, log: Log, options: RunOptions, **changes: Any) -> EstimatorResult:
    """The hand-written solver on the log's graph, with some options changed."""
    options = replace(options, **changes)
    method = "gnc" if options.kernel == "gnc" else "gauss-newton"
    solution = graphslam.solve(make_graph(log, options), method=method, **_solving(options))
    return _of_solution(name, log, options, solution)


def gtsam_estimator(log: Log, options: RunOptions) -> EstimatorResult:
    """GTSAM's Levenberg-Marquardt on the very same graph, made of our factor types, from the same start."""
    _no_gnc(options)
    solution = graphslam.solve_with_gtsam(make_graph(log, options), **_solving(options))
    return _of_solution("gtsam", log, options, solution)


def _solving(options: RunOptions) -> dict[str, Any]:
    """The keywords that both solvers have."""
    return {"initialize": options.initialize, "range_noise": options.filter.range_noise}


def online(log: Log, options: RunOptions) -> EstimatorResult:
    """The hand-written solver step by step; after each step it is at the optimum of the graph with landmark nodes."""
    options, notes = _online_options(options)
    risks: list[float] = []
    asked = (lambda solver: risks.append(solver.integrity_risk(*bounds_of(options)))) if options.landmark_map else None
    solution = graphslam.solve_online(_online_graph(log, options), lag=options.lag, callback=asked)
    result = _of_solution("online", log, options, solution)
    if np.isnan(solution.cost):
        result = replace(result, cost=None, costs=np.empty(0))
    risk = np.array(risks) if risks else None
    return replace(result, converged=None, integrity_risk=risk, notes=(*result.notes, *notes))


def _online_options(options: RunOptions) -> tuple[RunOptions, tuple[str, ...]]:
    """The options with those that `online` has fixed, and a note on them."""
    return _fixed(options, "it has landmark nodes with Cartesian residuals, and estimates no parameters", **_ONLINE)


def online_steps(log: Log, options: RunOptions) -> Iterator[graphslam.OnlineSolver]:
    """The solver of `online` after every step."""
    return replay(_online_graph(log, _online_options(options)[0]), lag=options.lag)


def bounds_of(options: RunOptions) -> tuple[float, float]:
    """The bounds of `graphslam.Solution.integrity_risk` [m, rad]."""
    metres, degrees = options.bound
    # no heading is off by more than half a turn
    return metres, float(np.radians(degrees)) if degrees < 180 else np.inf


def _no_map(name: str, options: RunOptions) -> None:
    if options.landmark_map is not None:
        raise OptionError(f"{name} does not use a map; graph, gtsam, online, mcl, fastslam1 and fastslam2 do")


def _online_graph(log: Log, options: RunOptions) -> Graph:
    return Graph.from_log(log, **online_keywords(options), map=options.landmark_map)


def isam2(log: Log, options: RunOptions) -> EstimatorResult:
    """ISAM2 on our factor types, step by step through the log, as a robot that drives could."""
    reason = "it goes on from its last estimate, and estimates no parameters"
    options, notes = _fixed(isam2_options(log, options), reason, initialize="auto", estimate=None)
    keywords = online_keywords(options)
    result = _of_solution("isam2", log, options, graphslam.solve_online(log, backend="isam2", **keywords))
    return replace(result, converged=None, notes=(*result.notes, *notes))


def isam2_options(log: Log, options: RunOptions) -> RunOptions:
    """The options with the edges and the kernel that `graphslam.solve_online` takes for ISAM2 where they name none.

    Raises:
        OptionError: the options have a map.
    """
    _no_map("isam2", options)
    edges, kernel = suitable_for_isam2(log, options.edges, options.kernel, options.motion, options.sensor)
    assert isinstance(kernel, str)
    return replace(options, edges=edges, kernel=kernel)


def online_keywords(options: RunOptions) -> dict[str, Any]:
    """The keywords of graphs that are solved step by step, without the frame.

    Raises:
        GraphError: the options ask for what that cannot do.
    """
    _no_gnc(options)
    keywords = graph_keywords(options)
    del keywords["estimate"]
    if keywords.pop("frame") != "body":
        raise GraphError("online and isam2 have no world frame, whose information is re-evaluated; use --frame body")
    return keywords


def _no_gnc(options: RunOptions) -> None:
    if options.kernel == "gnc":
        raise GraphError(
            "only graph and graph-marginal have graduated non-convexity: choose a robust kernel, such as --kernel cauchy"
        )


def gibbs_sampler(log: Log, options: RunOptions) -> fastslam.ParticleGibbs:
    """Particle Gibbs as the options ask for it.

    Raises:
        LogError, OptionError: it cannot run on this log.
    """
    _no_map("particle-gibbs", options)
    check_one_drive("particle-gibbs", log)
    return fastslam.ParticleGibbs(
        log, seed=options.filter.seed, threads=options.filter.threads, options=options.gibbs, motion=options.motion,
        sensor=options.sensor,
    )  # fmt: skip


def particle_gibbs(log: Log, options: RunOptions) -> EstimatorResult:
    """Particle Gibbs: the means of sampled trajectories and maps, with the covariances of the samples."""
    result, seconds = timed(gibbs_sampler(log, options).run)
    mixing = result.mixing
    # where they have not mixed, the reason says it
    notes = (mixing.statement,) if mixing.mixed else ()
    used = {"seed": options.filter.seed} | {f"gibbs_{k}": v for k, v in asdict(options.gibbs).items()}
    return EstimatorResult(
        name="particle-gibbs", poses=result.poses, estimated=np.ones(log.num_poses, dtype=bool), seconds=seconds,
        landmarks=result.landmarks, landmark_covariances=result.landmark_covariances, converged=mixing.mixed,
        iterations=options.gibbs.iterations, notes=notes, options=used, reason=mixing.statement, origin=result,
    )  # fmt: skip


def pair_count(log: Log) -> int:
    """The number of virtual-motion edges of a log: the sum of K (K-1) / 2 over its landmarks; none without ids."""
    sightings = _sighting_counts(log)
    return int(np.sum(sightings * (sightings - 1) // 2))


def _sighting_counts(log: Log) -> np.ndarray:
    """The number of sightings of each landmark."""
    return np.unique(log.landmarks[log.landmarks != UNIDENTIFIED], return_counts=True)[1]


def _textbook_seconds(log: Log, options: RunOptions) -> float:
    if not log.identified or options.landmark_map is not None:  # the lectures' program refuses them at once
        return 0.0
    # 50 us of plain Python per edge; the dense solve at some 10 GFLOP/s
    return 5e-5 * (pair_count(log) + log.num_poses) + 2 / 3 * (3.0 * log.num_poses) ** 3 / 1e10


def _factor_seconds(log: Log, options: RunOptions, *, of_log: bool = False) -> float:
    """The time [s] of one pass over all factors in GTSAM; ``of_log``: they use the ids of the log in any case."""
    # 30 us a pose; GTSAM copies all values for every call of a Python factor, of which there is one for 16 poses
    seconds = 3e-5 * log.num_poses + 4e-8 * log.num_poses**2
    given, options = options, chosen(log, options)
    on_landmarks = str(options.edges).startswith("landmark")
    if not on_landmarks and not of_log and not (options.estimate and options.weight == "marginal"):
        # how often each landmark is seen decides, so sightings without ids need them now; they are found once for all
        log, _ = identified(log, given)
    if options.estimate:
        # a factor for each edge, which every step makes again
        paired = options.weight != "marginal" and not on_landmarks
        count = log.num_poses + (pair_count(log) if paired else len(log.steps))
        return count * (5e-4 + 8e-8 * log.num_poses)
    if on_landmarks:
        return seconds
    if options.kernel not in ("none", "gnc") and options.weight != "marginal":
        # a factor for each pair, because each has its own robust weight
        return seconds + 1e-4 * pair_count(log)
    # a pair in a landmark's factor takes 0.3 us, a clique of K poses grows with K³
    return seconds + 3e-7 * pair_count(log) + 3e-9 * float(np.sum((3.0 * _sighting_counts(log)) ** 3))


def _isam2_seconds(log: Log, options: RunOptions) -> float:
    if not log.identified:  # it refuses them at once
        return 0.0
    # some ten milliseconds a step, and the landmarks' factors are made again as they grow; "per iteration" is per step here.
    # It estimates no parameters, and uses the ids of the log
    options = replace(isam2_options(log, options), estimate=None)
    return 1e-3 * log.num_poses + _factor_seconds(log, options, of_log=True)


_GRAPH = tuple(options_of(GraphOptions))
#: those that `online` has fixed; it refuses the other frame
_ONLINE: dict[str, Any] = {
    "edges": "landmark+motion", "weight": "pairs", "residual": "cartesian", "initialize": "auto", "estimate": None,
}  # fmt: skip
#: and what finds the ids for it
_SOLVED = (*_GRAPH, *options_of(FrontEndOptions), "class_confusion", "range_noise")


def _solved_without(*names: str) -> tuple[str, ...]:
    return tuple(name for name in _SOLVED if name not in names)


_GIBBS = tuple(name for name, each in options_of(RunOptions).items() if each.model == "gibbs")
#: the estimators by name, in the order in which they run and are shown
ESTIMATORS: dict[str, Estimator] = {
    "dead-reckoning": Estimator(dead_reckoning),
    "textbook": Estimator(textbook_estimator, ("edges",), _textbook_seconds),
    "graph": Estimator(partial(by_hand, "graph"), _SOLVED),
    # each sighting counted once, where pairs count it up to K/2 times: landmarks are eliminated exactly
    "graph-marginal": Estimator(
        partial(by_hand, "graph-marginal", weight="marginal"), _solved_without("weight"), repeats=_counted_once
    ),
    # every sighting counts fully, wrong ones too
    "graph-no-kernel": Estimator(
        partial(by_hand, "graph-no-kernel", kernel="none"), _solved_without("kernel"), on_request=True
    ),
    "gtsam": Estimator(gtsam_estimator, _SOLVED, _factor_seconds),
    "online": Estimator(online, (*(n for n in _GRAPH if n not in _ONLINE and n != "frame"), "lag"), on_request=True),
    "isam2": Estimator(isam2, _solved_without("initialize", "estimate", "range_noise"), _isam2_seconds),
    "mcl": Estimator(mcl, LOCALISATION),
    "fastslam1": Estimator(partial(of_several_seeds, "fastslam1"), FILTER),
    "fastslam2": Estimator(partial(of_several_seeds, "fastslam2"), FILTER),
    "particle-gibbs": Estimator(particle_gibbs, _GIBBS, on_request=True),
}


#: the same without those that a script adds: every process has these
BUILT_IN = dict(ESTIMATORS)


def default_estimators() -> tuple[str, ...]:
    """The estimators that run unless others are named."""
    return tuple(name for name, estimator in ESTIMATORS.items() if not estimator.on_request)


def check_estimators(names: Any) -> tuple[str, ...]:
    """The names of estimators, each once.

    Raises:
        OptionError: a name is unknown, or there is none.
    """
    names = (names,) if isinstance(names, str) else tuple(dict.fromkeys(names))
    known = ", ".join(ESTIMATORS)
    for name in names:
        if name not in ESTIMATORS:
            unknown = f"estimators: there is no estimator {quoted(name)}{checks.suggestion(name, ESTIMATORS)}"
            raise OptionError(f"{unknown}; the estimators are {known}")
    if not names:
        raise OptionError(f"estimators: name at least one of {known}")
    return names


def _of_solution(name: str, log: Log, options: RunOptions, solution: Solution) -> EstimatorResult:
    options, graph = chosen(log, options), solution.graph
    # the lectures' program and the solvers that go step by step use the ids of the log
    by_log = name in ("textbook", "isam2", "online")
    found = None if by_log else identified(log, options)[1]
    # the fields that both have under the same names
    shared = {f.name for f in fields(EstimatorResult)} & {f.name for f in fields(Solution)}
    values = {field: getattr(solution, field) for field in shared}
    # the notes and doubts of a log are shown once, and J per degree of freedom has a line of its own
    said = {*log.notes, *(text for _, text in log.doubts)}
    notes = [note for note in solution.notes if note not in said and BEYOND_NOISE not in note]
    with noted(notes, "the covariances of the map are not known"):
        values["landmark_covariances"] = solution.landmark_covariances
    values["options"] = {name: getattr(options, name) for name in _GRAPH}
    if not by_log:
        families = () if graph is None else graph.families
        at_estimate = any(getattr(family, "noise_at", None) is not None for family in families)
        estimated = at_estimate or options.filter.range_noise == "estimated"
        values["options"]["range_noise"] = "estimated" if estimated else "measured"
    elif graph is not None:
        # by the option of this run, and not by the default of `solve`
        notes = [note for note in notes if note != AT_MEASURED]
        notes += [AT_MEASURED] * takes_estimated_ranges(graph, options.filter.range_noise)
    parameters = solution.parameters
    if parameters is not None:
        notes.append(f"estimated with the poses: {parameters.sentence}")
        if parameters.doubt:
            notes.append(parameters.doubt)
        if options.weight == "pairs" and not str(options.edges).startswith("landmark"):
            note = "pairs weigh sightings too much, so these standard deviations are too small; see --weight marginal"
            notes.append(note)
    if graph is not None and values["options"].get("range_noise") == "measured":
        notes += [note for note in shortened_ranges(graph) if note not in notes]
    if graph is not None and (kernel := graph.verdict[0]) is not None and len(log.steps):
        weights = graph.sighting_weights(solution.state)
        values["weighed_down"] = weighed_down = int(np.count_nonzero(weights < WEIGHED_DOWN))
        usual = kernel.share_below(WEIGHED_DOWN, log.sightings.shape[1])
        notes.append(
            f"the kernel {kernel.name} gives {weighed_down} of {len(weights)} sightings less than half of their weight "
            f"({weighed_down / len(weights):.1%}; {usual:.1%} would be usual if none were wrong)"
        )
    values |= {"name": name, "origin": solution, "parameters": parameters}
    if options.landmark_map is not None:
        values["options"]["bound"] = options.bound
        with noted(notes, "the probability of being off is not known"):
            values["integrity_risk"] = solution.integrity_risk(*bounds_of(options))
    if found is not None:
        # the notes of the association came with its log; that its map is not reliable is a finding of the comparison
        notes = [*(each for each in found.notes if found.verdict.reliable or each != str(found.verdict)), *notes]
        seconds = solution.seconds + found.seconds
        values |= {"named": False, "association": found.ids, "found": found, "seconds": seconds}
        values["options"] |= {name: getattr(options, name) for name in options_of(FrontEndOptions)}
        values["options"]["class_confusion"] = options.filter.class_confusion
    return EstimatorResult(**values | {"notes": tuple(notes)})


@cache
def warm_up(estimator: str, *, simulated: bool = True) -> None:
    """Run an estimator on a tiny log, so that loading its modules is no part of its time.

    Logs that are not simulated have a robust kernel, which needs further modules. What goes wrong here shows again, with its
    message, when the estimator runs on the user's log.
    """
    for orientation in (True, False):
        log = simulate(steps=6, orientation=orientation).replace(simulated=simulated)
        with suppress(Exception), warnings.catch_warnings(action="ignore"):
            ESTIMATORS[estimator].run(log, RunOptions.of(particles=2, motion=MotionModel(), sensor=SensorModel()))
