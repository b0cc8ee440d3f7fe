"""``initialize="auto"``: solve from several starts, and return the best result, never one worse than the given values.

Graphs with a robust kernel have many more minima. Two further starts come first there: the optimum of the plain graph,
without its kernel, and the end of a sequence of kernels that become narrower, from the plain optimum on (graduated
non-convexity: Blake and Zisserman, *Visual reconstruction*, 1987). As rho(u) <= u, a kernel's J above that of the plain
optimum proves a wrong minimum. An end above the plain state that was tried is never returned; a lower plain minimum may exist
where that state is not proven.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from math import isfinite

import numpy as np

from ..edges import SightingEdges
from ..engine import engine
from ..errors import GraphError
from ..graph import Graph
from ..se2 import Array
from .certificate import GLOBAL, Certificate, prove
from .initialize import GROWING, descents, lower_by_halves, lower_by_turns, starting_state, starts_of_auto
from .iteration import METHODS, Run, end_of, factorized, gauss_newton, rounding

DAMPED = "levenberg-marquardt"
#: graphs of at most so many nodes are always run from a second start: that takes milliseconds
SMALL = 100
#: J per degree of freedom beyond which an end is doubtful and compared with another start's. The information in files is
#: often a rough guess, whereas wrong minima of graphs of sightings were found from 1.15 on.
DOUBTFUL, DOUBTFUL_SIGHTINGS = 3.0, 1.12
#: with a kernel, three starts must lead to an end of sightings whose J per degree of freedom is beyond this: two follow from
#: the plain optimum, and five such ends of 750 hard logs were wrong (J of 1.04 to 1.2), while three quarters are below 1.03
SURE = 1.03
#: an end that took more steps is doubtful, too: slow convergence comes from large residuals, which make several minima
SLOW = 16
#: the most times that the search continues from an unproven end to a lower one
DESCENTS = 5
#: graphs of at most so many nodes are searched on from an end that is accepted, but not proven: a thorough proof (some 50
#: factorisations), so many further starts, and descents
PROVABLE, FURTHER = 1000, 2
#: ends whose costs differ by less than this part are one minimum
SAME = 1e-6
#: the search after the first end takes at most so many steps for each step that led to that, ...
MULTIPLE = 10
#: ... or this number divided by the number of nodes, if that is more: some three seconds
SHORT = 1_000_000
#: restarts without halves of the measurements come last, and may take at least this part of all steps that are allowed
FINAL = 0.6
#: the names of the two starts of graphs with a kernel: the plain optimum, and the sequence of kernels from there on, ...
PLAIN, NARROWED = "without kernel", "kernel narrowed"
#: ... which begins with these multiples of the kernel's width, with at most so many steps for each
WIDER, STEPS = (16.0, 4.0), 15
#: the plain graph is searched, too, where its J is below so many times the kernel's: a lower plain minimum is then possible
UNDERCUT = 2.0


@dataclass(frozen=True)
class End:
    """The end of one run by a method; ``before`` counts the steps of the runs that led to its start."""

    graph: Graph
    run: Run
    method: str
    before: int = 0

    @cached_property
    def cost(self) -> float:
        """J, infinite where it is no number."""
        return _finite(self.graph.cost(self.run.state))

    @cached_property
    def steps(self) -> int:
        """All steps that led to the end."""
        return self.before + len(self.run.step_norms)

    @cached_property
    def plausible(self) -> bool:
        """Whether J per degree of freedom is as the noise models promise, and a graph of sightings took few steps."""
        sighted = _sighted(self.graph)
        limit = (DOUBTFUL_SIGHTINGS if sighted else DOUBTFUL) * self.graph.expected_cost
        # re-weighted edges and damped steps take more steps in any case
        quick = not sighted or self.method == DAMPED or self.graph.reweighted or self.graph.state_dependent_information
        return self.cost <= limit and (quick or self.steps <= SLOW)

    @cached_property
    def certificate(self) -> Certificate:
        """The certificate of the end from one attempt."""
        return prove(self.graph, self.run.state, cost=self.cost, thorough=False)

    @property
    def proven(self) -> bool:
        """Whether no state has a lower cost."""
        return self.certificate.status == GLOBAL

    @cached_property
    def thorough(self) -> Certificate:
        """The certificate of the end from all attempts."""
        # without a negative direction further attempts do not differ from the first
        if self.certificate.direction is None:
            return self.certificate
        return prove(self.graph, self.run.state, cost=self.cost)

    @property
    def known_certificate(self) -> Certificate | None:
        """The certificate from all attempts, as far as the search has computed it."""
        computed = vars(self)
        if "thorough" in computed or ("certificate" in computed and self.certificate.direction is None):
            return self.thorough
        return None

    @cached_property
    def open(self) -> bool:
        """Whether the search continues from this end, although it is accepted."""
        if self.graph.num_nodes > PROVABLE or self.certificate.proven or not self.certificate.applicable:
            return False
        return not self.thorough.proven

    @property
    def possible(self) -> bool:
        """Whether the end of a graph with a kernel may be the global minimum for its weights; see `prove`."""
        certificate = self.certificate
        small = self.graph.num_nodes <= PROVABLE
        return certificate.proven or not certificate.applicable or (small and not self.open)


@dataclass
class _Effort:
    """The steps of a search, counted in steps over the whole graph, against what the first end allows."""

    nodes: int
    spent: float = 0.0
    most: float = np.inf

    def allow(self, first: int) -> None:
        """Bound the search by the number of steps that led to the first end."""
        if self.most == np.inf:
            self.most = self.spent + max(MULTIPLE * first, SHORT / max(self.nodes, 1))

    @property
    def left(self) -> float:
        """The number of steps that may still be taken."""
        return self.most - self.spent


def best_end(graph: Graph, run_from: Callable[..., Run], method: str, *, halves: bool = True) -> End:
    """The lowest end among the starts of `AUTO`.

    The search ends when the lowest end is accepted (`enough`) and no longer `open`, or after `FURTHER` more starts. Before
    another start, other turns are tried from the end of the last one (`lower_by_turns`), with a kernel only after its
    second start. From the lowest end of a search that took these, random halves of the measurements are left out
    (`lower_by_halves`), unless the ends of a large graph agree. If it is not accepted or still open then, the search
    continues along the negative direction that its failed proof shows. The whole search after the first end is bounded by a
    multiple of the steps that led to it.

    An end with a higher cost than the given values never counts. If no run converges to a lower one, Levenberg-Marquardt
    runs from the given values and accepts only steps that lower J itself. (With state-dependent information a fixed point
    of the iteration may have a higher J.)

    Args:
        graph: what to solve.
        run_from: runs a method from a state; with ``descend=True`` so that every step lowers J itself.
        method: the method that is tried first from every start. Levenberg-Marquardt follows if it does not converge, unless
            an earlier start has converged to an acceptable cost.
        halves: whether halves of the measurements are left out at the end.

    Raises:
        GraphError: the edges do not determine the nodes.
    """
    lowest = graph.initial
    given = _finite(graph.cost(lowest))
    ends: list[End] = []
    error: GraphError | None = None
    good: list[End] = []
    # the starts from whose ends other turns are not yet tried: name, number of ends before and after
    unturned: list[tuple[str, int, int]] = []
    further, searched = FURTHER, False
    effort = _Effort(graph.num_nodes)
    for initialize, start in _starts(graph, ends, effort):
        # with state-dependent information a fixed point may lie above the state that the iteration starts from
        plain = initialize.startswith(PLAIN) and not graph.state_dependent_information
        if plain and (cost := _finite(graph.cost(start))) < given:
            lowest, given = start, cost
        tried = len(ends)
        # a start that only serves for comparison is worth one attempt
        searches = (method,) if _counted(ends, given) else (method, DAMPED)
        for search in dict.fromkeys(searches):
            try:
                ends.append(_end(graph, run_from, start, search, initialize, ends))
            except GraphError as failure:
                error = failure
                continue
            effort.spent += ends[-1].steps
            if ends[-1].run.converged:
                break
        good = _counted(ends, given)
        unturned.append((initialize, tried, len(ends)))
        finished = _finished(good, further)
        # the second start of a kernel costs less than other turns, and often ends the search
        if initialize != PLAIN and not finished:
            for started, before, after in unturned:
                ends += _with_turns(graph, run_from, ends[:after], before, started, effort)
            unturned, searched = [], True
            good = _counted(ends, given)
            finished = _finished(good, further)
        if finished:
            break
        if ends:
            effort.allow(ends[0].steps)
        further -= enough(good)
        if good and effort.left <= 0:
            break
    if halves and searched and good and not _lowest(good).proven and not _agreed(good):
        effort.most = max(effort.most, effort.spent + FINAL * effort.most)
        ends += _lower(graph, run_from, _lowest(good), lower_by_halves, "without halves", ends, effort)
        good = _counted(ends, given)
    if good and (not enough(good) or _lowest(good).open):
        ends += _descended(graph, run_from, method, _lowest(good), effort)
    if error is not None and not any(end.run.converged for end in ends):
        # if nodes are undetermined, Omega is singular at the given values as well, and this raises; if only a later state
        # was singular, it does not
        graph.linearize(graph.initial)
        factorized(graph, graph.initial)
        if not ends:
            raise error
    allowed = [end for end in ends if _allowed(end, given)]
    if not any(end.run.converged for end in allowed):
        run = run_from(lowest, DAMPED, descend=True)
        started = "given" if lowest is graph.initial else PLAIN
        run.reason += f" (started {started}; J falls at every step, because all other ends are above the values there)"
        if not graph.cost(run.state) <= given:
            run.state, run.converged = lowest.copy(), False
        allowed.append(End(graph, run, DAMPED))
    return _best(graph, allowed)


def _end(graph: Graph, run_from: Callable[..., Run], start: Array, search: str, started: str, ends: list[End]) -> End:
    """The end of a run from a start. A run that has not converged, but is below all other ends, is continued once.

    Raises:
        GraphError: the edges do not determine the nodes.
    """
    run, before = run_from(start, search), 0
    if not run.converged and graph.cost(run.state) < min((end.cost for end in ends), default=np.inf):
        before = len(run.step_norms)
        run = run_from(run.state, search)
    run.reason += f" (started {started}, {search})"
    return End(graph, run, search, before)


def _with_turns(
    graph: Graph, run_from: Callable[..., Run], ends: list[End], tried: int, started: str, effort: _Effort
) -> list[End]:
    """The lower end that other turns lead to from the last end, if it has converged and no end before it has its cost.

    Args:
        ends: those until the last one; the first ``tried`` of them are those of earlier starts.
    """
    earlier = [other.cost for other in ends[:tried] if other.run.converged]
    if len(ends) == tried or any(abs(cost - ends[-1].cost) <= SAME * ends[-1].cost for cost in earlier):
        return []
    return _lower(graph, run_from, ends[-1], lower_by_turns, f"{started}, other turns", ends, effort)


def _lower(
    graph: Graph,
    run_from: Callable[..., Run],
    end: End,
    lower_by: Callable[[Graph, Array, float], tuple[Array | None, int]],
    started: str,
    ends: list[End],
    effort: _Effort,
) -> list[End]:
    """The lower end that restarts lead to from a converged end.

    Beyond J of `DOUBTFUL` times the expected one, wrong sightings or noise models dominate, and restarts do not lower it.
    """
    if not _sighted(graph) or not end.run.converged or end.cost > DOUBTFUL * graph.expected_cost:
        return []
    effort.allow(ends[0].steps)
    state, steps = lower_by(graph, end.run.state, effort.left)
    effort.spent += steps
    if state is None:
        return []
    try:
        lower = _end(graph, run_from, state, end.method, started, ends)
    except GraphError:
        return []
    effort.spent += lower.steps
    return [replace(lower, before=lower.before + end.steps)]


def _descended(graph: Graph, run_from: Callable[..., Run], method: str, end: End, effort: _Effort) -> list[End]:
    """Lower and lower ends, each reached along the negative direction that the proof of the one before has found."""
    found: list[End] = []
    best: End | None = end
    while best is not None and best.certificate.direction is not None and len(found) < DESCENTS:
        lower = None
        for start in descents(graph, best.run.state, best.certificate.direction):
            if effort.left <= 0:
                return found
            try:
                run = run_from(start, method)
            except GraphError:
                continue
            effort.spent += len(run.step_norms)
            run.reason += f" (started from a higher end, {method})"
            end = End(graph, run, method)
            if run.converged and end.cost < best.cost * (1 - SAME):
                lower = end
                found.append(end)
                break
        best = lower
    return found


def _starts(graph: Graph, ends: list[End], effort: _Effort) -> Iterator[tuple[str, Array]]:
    """The starts that the edges allow, one after the other: their names and states (n, 3).

    Those of a kernel come first. Where sightings are noisy, the starts that look at all poses at once often lead to the same
    wrong minimum, so that growing the graph comes second. In small graphs the others are much faster and come first. Graphs
    from files have no need of growing. Growing that would take more steps than ``effort`` has left is left out.
    """
    if graph.reweighted:
        yield from _starts_of_kernel(graph, ends)
    names, growing = [*starts_of_auto(graph)], [*GROWING] if _sighted(graph) else []
    if graph.num_nodes <= SMALL:
        names, growing = names + growing, []
    while names:
        name = names.pop(0)
        forecast = engine.most_steps_of_growth(len(graph.steps), GROWING[name]) if name in GROWING else 0.0
        if ends and forecast > effort.left:
            continue
        try:
            state = starting_state(graph, name)
        except GraphError:
            continue
        effort.spent += forecast
        yield name, state
        names, growing = growing + names, []


def _starts_of_kernel(graph: Graph, ends: list[End]) -> Iterator[tuple[str, Array]]:
    """The starts of a graph with a kernel: the plain optimum, the end of narrower and narrower kernels from there on, and
    the best plain end that a whole search finds, where that could be below the kernel's."""
    plain = graph.without_kernel
    start = starting_state(plain, "auto")
    try:
        first = _end(plain, _runs(plain), start, "gauss-newton", "auto", [])
    except GraphError:
        return
    if not isfinite(first.cost):
        return
    yield PLAIN, first.run.state
    with suppress(GraphError):
        yield NARROWED, _narrowed(graph, first.run.state)
    lowest = min((end.cost for end in ends), default=np.inf)
    if first.cost < UNDERCUT * lowest and not first.proven:
        found = best_end(plain, _runs(plain), "gauss-newton", halves=False)
        if found.cost < first.cost * (1 - SAME):
            yield f"{PLAIN}, searched", found.run.state


def _runs(graph: Graph) -> Callable[..., Run]:
    """Runs of the hand-written solver on a graph, to a tolerance that is enough for a start and a proof."""

    def run_from(start: Array, method: str, descend: bool = False) -> Run:
        run = Run(start.copy(), tolerance=1e-6 * graph.num_nodes**0.5, descend=descend)
        METHODS[method](graph, run)
        return run

    return run_from


def _narrowed(graph: Graph, state: Array) -> Array:
    """The state (n, 3) after some steps with each of `WIDER` times the width of the kernel, one after the other.

    Raises:
        GraphError: the edges do not determine the nodes.
    """
    for factor in WIDER:
        state = end_of(gauss_newton, graph.with_wider_kernel(factor), state, 1e-3 * graph.num_nodes**0.5, STEPS)
    return state


def _counted(ends: list[End], given: float) -> list[End]:
    """The ends that have converged and are allowed."""
    return [end for end in ends if end.run.converged and _allowed(end, given)]


def _allowed(end: End, given: float) -> bool:
    """Whether an end is not above the cost of the given values, but for rounding."""
    if end.cost <= given * (1 + 1e-9):
        return True
    # where the given values meet all measurements, both costs are what rounding of the coordinates leaves
    return end.cost - given <= rounding(end.run.state, end.graph.system)


def _best(graph: Graph, ends: list[End]) -> End:
    """The lowest end. One that has not converged must be lower than a converged one by more than `SAME`.

    With state-dependent information only a fixed point is a solution, and J on the way to it may be lower.
    """
    converged = min((end for end in ends if end.run.converged), key=lambda end: end.cost, default=None)
    lowest = _lowest(ends)
    if converged is not None and (graph.state_dependent_information or converged.cost <= lowest.cost * (1 + SAME)):
        return converged
    return lowest


def enough(ends: list[End]) -> bool:
    """Whether converged ends of a graph leave no reason to try another start.

    The lowest end is confirmed if another start has led to it, or two others where ends differ or it is `_unsure`. It is
    enough that it is plausible or confirmed, in small graphs both, or that it is proven to be a global minimum. With a kernel
    it must be confirmed, because a kernel hides misfits, and its weights must not show that there is a lower minimum; in
    large graphs it is also enough that all of three starts have led to it, and that it is plausible.
    """
    if not ends:
        return False
    lowest = _lowest(ends)
    same = sum(end.cost <= lowest.cost * (1 + SAME) for end in ends)
    confirmed = same > (1 if same == len(ends) and not _unsure(lowest) else 2)
    if lowest.graph.reweighted:
        return lowest.proven or (confirmed and lowest.possible) or _agreed(ends)
    small = lowest.graph.num_nodes <= SMALL
    return (confirmed and lowest.plausible if small else confirmed or lowest.plausible) or lowest.proven


def _unsure(end: End) -> bool:
    """Whether two starts are not enough to confirm an end of a graph with a kernel; see `SURE`."""
    graph = end.graph
    provable = graph.reweighted and graph.num_nodes <= PROVABLE and _sighted(graph)
    return provable and end.cost > SURE * graph.expected_cost


def _agreed(ends: list[End]) -> bool:
    """Whether all converged ends of a graph that is too large to be proven, three or more, are one plausible minimum."""
    lowest = _lowest(ends)
    same = all(end.cost <= lowest.cost * (1 + SAME) for end in ends)
    return lowest.graph.num_nodes > PROVABLE and len(ends) > 2 and same and lowest.plausible


def _finished(ends: list[End], further: int) -> bool:
    """Whether the lowest end is accepted, and the search has no reason to continue or no start left."""
    return enough(ends) and (further == 0 or not _lowest(ends).open)


def _lowest(ends: list[End]) -> End:
    return min(ends, key=lambda end: end.cost)


def _sighted(graph: Graph) -> bool:
    return any(isinstance(family, SightingEdges) for family in graph.families)


def _finite(cost: float) -> float:
    return cost if isfinite(cost) else np.inf
