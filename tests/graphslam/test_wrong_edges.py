"""Edges that a program makes by itself: wrong nodes, shapes and numbers are one sentence, and never end the process."""

from __future__ import annotations

import gc
import re
import weakref
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from certified_graphs import ring

from graphslam import Graph, GraphError, OptionError, SensorModel, load, sample_log_path, solve, solve_many
from graphslam.edges import (
    AnchorEdges,
    ConstantEdges,
    EdgeFamily,
    LandmarkSightings,
    MarginalEdges,
    RelativePoseEdges,
    VirtualMotionEdges,
)
from graphslam.edges.base import Linearization, PairEdges, Relations
from graphslam.edges.observation import CartesianObservationEdges, RangeEdges
from graphslam.edges.priors import PositionEdges
from graphslam.edges.relative import RelationEdges
from graphslam.edges.robust import Huber

FIRST, SECOND, Z, W = np.arange(5), np.arange(1, 6), np.tile([1.0, 0.0, 0.3], (5, 1)), np.tile(np.eye(3), (5, 1, 1))
NODE = np.zeros(1, int)


def changed(array: np.ndarray, at: Any, value: float) -> np.ndarray:
    other = array.copy()
    other[at] = value
    return other


@pytest.mark.parametrize(("make", "words"), [
    (lambda: RelativePoseEdges(FIRST * 1.0, SECOND, Z, W), "first must be the numbers of nodes, whole numbers"),
    (lambda: RelativePoseEdges(FIRST, SECOND[:3], Z, W), "as many nodes each, not 5 and 3"),
    (lambda: RelativePoseEdges(FIRST, SECOND, Z[:2], W), r"measured must have the shape \(5, 3\), .* not \(2, 3\)"),
    (lambda: RelativePoseEdges(FIRST, SECOND, Z[:, :2], W), r"measured must have the shape \(5, 3\)"),
    (lambda: RelativePoseEdges(FIRST, SECOND, Z, W[0]), r"information must have the shape \(5, 3, 3\)"),
    (lambda: RelativePoseEdges(FIRST, SECOND, changed(Z, (3, 1), np.nan), W), "measured of edge 3 must be finite"),
    (lambda: RelativePoseEdges(FIRST, SECOND, Z, changed(W, 2, np.inf)), "information of edge 2 must be finite"),
    (lambda: RelativePoseEdges(FIRST, SECOND, Z, W * 1j), "information must be an array of numbers"),
    (lambda: AnchorEdges(NODE, np.zeros((1, 2)), W[:1]), r"values must have the shape \(1, 3\)"),
    (lambda: PositionEdges(NODE, np.zeros((1, 4)), W[:1], np.zeros((1, 2))), r"measured must have the shape \(1, 2\)"),
    (lambda: PositionEdges(NODE, np.zeros((1, 2)), W[:1, :2, :2], np.zeros(2)), r"levers must have the shape \(1, 2\)"),
    (lambda: MarginalEdges(np.array([0, 2]), np.array([0, 1]), np.ones((3, 2)), SensorModel()), "sightings must have"),
    (lambda: CartesianObservationEdges(NODE, NODE + 1, np.ones((1, 4)), SensorModel()), "sightings must have the shape"),
    (lambda: RangeEdges(NODE, NODE + 1, np.ones(1), np.ones((1, 1, 1)), np.zeros(2)), "measured must have the shape"),
])  # fmt: skip
def test_edges_that_do_not_fit_together(make: Callable[[], Any], words: str) -> None:
    with pytest.raises(GraphError, match=words):
        make()


def test_other_kinds_of_numbers_are_taken() -> None:
    graph = ring(6)
    edges, expected = graph.families[0], solve(graph)
    lists = RelativePoseEdges(
        *(part.tolist() for part in (edges.first, edges.second, edges.measured, edges.information))
    )
    small = RelativePoseEdges(
        edges.first.astype(np.int32), edges.second.astype(np.uint64), edges.measured, edges.information
    )
    for each in (lists, small):
        assert solve(replace(graph, families=(each,))).cost == expected.cost
    named = RelationEdges(edges.first, edges.second, edges.measured, edges.information, kernel="huber")
    assert named.kernel == Huber().of_dimension(3)


@pytest.mark.parametrize(("change", "words"), [
    ({"families": (RelativePoseEdges(FIRST, SECOND + 4, Z, W),)}, "tie node 9, but the nodes of the graph are 0 to 5"),
    ({"families": (RelativePoseEdges(FIRST - 3, SECOND, Z, W),)}, "tie node -3, but"),
    ({"families": (AnchorEdges(NODE - 1, np.zeros((1, 3)), W[:1]),)}, "AnchorEdges tie node -1"),
    ({"families": ("edges",)}, "families must be objects of EdgeFamily, not 'edges'"),
    ({"fixed": np.array([1000])}, "node 1000 cannot be fixed: the nodes of the graph are 0 to 5"),
    ({"initial": np.zeros((6, 2))}, r"initial must have the shape \(n, 3\)"),
    ({"initial": np.zeros((4, 3))}, "tie node 5, but the nodes of the graph are 0 to 3"),
])  # fmt: skip
def test_graphs_whose_edges_lead_elsewhere(change: dict[str, Any], words: str) -> None:
    with pytest.raises(GraphError, match=words):
        replace(ring(6), **change)


def test_information_that_is_negative_is_named() -> None:
    """Also where it is so small that a minimum near the start is found."""
    for size in (1.0, 1e-3):
        graph = ring(6)
        graph.families[0].measured[:] += 0.05
        graph.families[0].information[4] *= -size
        for initialize in ("auto", "given"):
            with pytest.raises(GraphError, match="edge 4 of RelativePoseEdges is not positive semi-definite"):
                solve(graph, initialize=initialize)


@dataclass(frozen=True, eq=False)
class Own(PairEdges):
    """Relative poses in NumPy, whose hooks tests replace."""

    edges: RelativePoseEdges
    hooks: dict[str, Any] = field(default_factory=dict)

    def linearize(self, state: np.ndarray, reference: np.ndarray) -> Linearization:
        return self.edges.linearize(state, reference)

    def cliques(self) -> tuple[np.ndarray, np.ndarray]:
        return self.hooks.get("cliques", super().cliques())

    def headings(self) -> Relations | None:
        return self.hooks.get("headings", self.edges.headings())

    def positions(self, state: np.ndarray) -> Relations | None:
        return self.edges.positions(state)

    def constant(self, state: np.ndarray) -> ConstantEdges:
        return replace(self.edges.constant(state), **self.hooks.get("constant", {}))


@dataclass(frozen=True, eq=False)
class FixEdges(EdgeFamily):
    """Measured places of single nodes, with groups whose starts are ``spread`` apart."""

    nodes: np.ndarray
    measured: np.ndarray
    spread: int = 1

    @property
    def count(self) -> int:
        return len(self.nodes)

    def cliques(self) -> tuple[np.ndarray, np.ndarray]:
        return np.arange(self.count + 1) * self.spread, self.nodes

    def linearize(self, state: np.ndarray, _: np.ndarray) -> Linearization:
        e, W = state[self.nodes, :2] - self.measured, np.tile(np.eye(2), (self.count, 1, 1))
        return Linearization(e, W, (self.nodes,), (np.broadcast_to(np.eye(2, 3), (self.count, 2, 3)),))


def own(**hooks: Any) -> Graph:
    graph = ring(6)
    edges = graph.families[0]
    return replace(graph, families=(Own(edges.first, edges.second, edges, hooks),))


def test_a_family_in_numpy_is_proven_and_freed() -> None:
    solution = solve(own())
    assert solution.certificate.status == "global"
    hooks: dict[str, Any] = {}
    graph = own(**hooks)
    graph.families[0].hooks["graph"] = graph
    solve(graph)
    alive = weakref.ref(graph)
    del graph, solution
    gc.collect()
    assert alive() is None


RELATIONS = ring(6).families[0].headings()


@pytest.mark.parametrize("wrong", [
    replace(RELATIONS, first=RELATIONS.first + 1000),
    replace(RELATIONS, second=RELATIONS.second - 7),
    replace(RELATIONS, first=RELATIONS.first.tolist()),
    replace(RELATIONS, value=RELATIONS.value[:2]),
    replace(RELATIONS, information=RELATIONS.information[:1]),
    replace(RELATIONS, second=(RELATIONS.second + 2) % 6),
])  # fmt: skip
def test_wrong_headings_of_a_family_in_numpy(wrong: Relations) -> None:
    """The start needs them, so that "auto" does without it."""
    graph = own(headings=wrong)
    with pytest.raises(GraphError, match="relations|headings"):
        solve(graph, initialize="rotation-first")
    assert solve(graph.with_initial(solve(ring(6)).state)).converged


@pytest.mark.parametrize(("wrong", "words"), [
    ({"first": FIRST}, "two nodes for each edge|must have the shape"),
    ({"second": np.full(6, 10**6)}, "names a node above the last one, 5"),
    ({"second": np.full(6, -2)}, "two nodes for each edge"),
    ({"information": np.full((6, 3, 3), np.nan)}, "information of edge 0 must be finite"),
    ({"start": None}, "start must"),
])  # fmt: skip
def test_a_wrong_constant_form_of_a_family_in_numpy(wrong: dict[str, Any], words: str) -> None:
    certificate = solve(own(constant=wrong)).certificate
    assert certificate.status == "not applicable"
    assert re.search(words, certificate.reason)


def test_wrong_groups_of_a_family_in_numpy() -> None:
    graph = ring(6)
    ends = np.sort(np.column_stack([graph.families[0].first, graph.families[0].second]), axis=1)
    with pytest.raises(GraphError, match=r"edge between the nodes \d and \d, but no group of its cliques\(\) has both"):
        solve(own(cliques=(np.arange(0, 11, 2), ends[:-1].ravel())), initialize="given")
    for spread in (0, 2, -1):
        with pytest.raises(
            GraphError, match=r"starts of cliques\(\) must not decrease from 0 to the number of its nodes, 4"
        ):
            replace(graph, families=(*graph.families, FixEdges(np.arange(4), np.zeros((4, 2)), spread)))


def test_a_family_in_numpy_with_a_kernel_is_proven_for_its_weights() -> None:
    class Robust(FixEdges):
        kernel = Huber(0.1)

        def constant(self, state: np.ndarray) -> ConstantEdges:
            here, nothing = self.linearize(state, state), np.zeros((self.count, 2))
            weights = self.kernel.weight(here.mahalanobis)[:, None, None]
            from_world = np.full(self.count, -1)
            return ConstantEdges(from_world, self.nodes, self.measured, nothing, None, here.information * weights)

    graph = ring(6)
    solution = solve(replace(graph, families=(*graph.families, Robust(np.arange(4), np.zeros((4, 2))))))
    assert solution.certificate.status == "global for its weights"


@pytest.mark.parametrize("kind", [MarginalEdges, VirtualMotionEdges])
def test_sightings_of_a_landmark_in_another_order_are_refused(kind: type[LandmarkSightings]) -> None:
    """Their J was right, and Omega was not."""
    graph, z = ring(6), np.array([[1.4, 0.8, 0.0], [1.0, 1.5, 0.3], [1.4, 2.3, -0.2], [1.0, 0.2, 0.1]])
    starts = np.array([0, 3, 4])
    replace(graph, families=(*graph.families, kind(starts, np.array([1, 1, 2, 0]), z, SensorModel())))
    with pytest.raises(GraphError, match=r"must not decrease, but node 0 follows node 2: sort them"):
        replace(graph, families=(*graph.families, kind(starts, np.array([1, 2, 0, 0]), z, SensorModel())))


def test_a_family_in_numpy_that_returns_other_things() -> None:
    graph, fixes = ring(6), (np.arange(4), np.zeros((4, 2)))

    class Listed(FixEdges):
        def cliques(self) -> Any:
            return [[node] for node in self.nodes]

    class Pair(FixEdges):
        def linearize(self, state: np.ndarray, _: np.ndarray) -> Any:
            return state[self.nodes, :2] - self.measured, np.eye(2)

    with pytest.raises(GraphError, match=r"Listed: cliques\(\) must return two arrays, starts and nodes, not \["):
        replace(graph, families=(*graph.families, Listed(*fixes)))
    with pytest.raises(GraphError, match=r"Pair: linearize\(\) must return a Linearization, not \(array"):
        solve(replace(graph, families=(*graph.families, Pair(*fixes))))


def test_a_graph_of_lists_is_one_of_arrays() -> None:
    graph = ring(6)
    names = ("steps", "trajectory", "pose_ids", "landmark_ids", "fixed")
    listed = replace(graph, families=list(graph.families), **{name: getattr(graph, name).tolist() for name in names})
    np.testing.assert_array_equal(solve(listed).poses, solve(graph).poses)


def test_initial_values_of_ones_own() -> None:
    graph = ring(6)
    values = graph.initial + 0.01
    with pytest.raises(OptionError, match=r"with_initial\(values\), initialize='given'"):
        solve(graph, initialize=values)
    assert solve(graph.with_initial(values), initialize="given").converged
    with pytest.raises(OptionError, match=r"initial must have shape \(6, 3\), poses first, not \(5, 3\)"):
        graph.with_initial(values[:5])


def test_a_linearisation_of_another_shape() -> None:
    edges = FixEdges(np.arange(4), np.zeros((4, 2))).linearize(np.zeros((6, 3)), np.zeros((6, 3)))
    with pytest.raises(GraphError, match=r"needs information \(4, 2, 2\), and for each end .* not the shapes \(2, 2\)"):
        replace(edges, information=np.eye(2))
    with pytest.raises(GraphError, match=r"a Jacobian \(4, 2, 3\), not the shapes"):
        replace(edges, jacobians=(np.zeros((4, 3, 2)),))


def test_residuals_of_a_family_in_numpy_in_one_row() -> None:
    with pytest.raises(GraphError, match=r"residuals must have the shape \(E, d\), a row for each edge, not \(4,\)"):
        Linearization(np.zeros(4), np.ones((4, 1, 1)), (np.arange(4),), (np.zeros((4, 1, 3)),))


def test_a_cost_that_is_no_number_names_its_edge() -> None:
    places = np.zeros((4, 2))
    places[2, 1] = np.nan
    solution = solve(replace(ring(6), families=(*ring(6).families, FixEdges(np.arange(4), places))), initialize="given")
    assert not solution.converged
    assert "edge 2 of the FixEdges has a residual or an information that is not finite" in solution.reason


def test_residuals_of_a_family_in_numpy_count_as_numbers() -> None:
    """So a misfit of such edges is said, and is not taken for an error that the sightings of a scan have in common."""
    graph = Graph.from_log(load(sample_log_path()), edges="landmark+motion")
    log = graph.log
    assert log is not None and log.true_poses is not None
    nodes = np.arange(len(log.true_poses))
    for spread, misfit in ((1.0, False), (7.0, True)):
        places = log.true_poses[:, :2] + np.random.default_rng(0).normal(0, spread, (len(nodes), 2))
        more = replace(graph, families=(*graph.families, FixEdges(nodes, places)))
        assert more.degrees_of_freedom == graph.degrees_of_freedom + 2 * len(nodes)
        notes = solve(more).notes
        assert any("times what the noise models predict" in note for note in notes) == misfit
        assert not any("in common" in note for note in notes)


class PickyEdges(FixEdges):
    """Edges of a user that refuse nodes at one place, and nodes that are ``most`` apart."""

    most = np.inf

    def linearize(self, state: np.ndarray, reference: np.ndarray) -> Linearization:
        if not 0 < np.ptp(state[self.nodes, 0]) < self.most:
            raise np.linalg.LinAlgError("Singular matrix")
        return super().linearize(state, reference)


@pytest.mark.parametrize(("most", "count"), [(np.inf, 8), (5.0, 0)])
def test_edges_of_a_user_are_counted_where_that_is_possible(
    monkeypatch: pytest.MonkeyPatch, most: float, count: int
) -> None:
    monkeypatch.setattr(PickyEdges, "most", most)
    graph = replace(ring(6), families=(*ring(6).families, PickyEdges(np.arange(4), ring(6).initial[:4, :2])))
    assert solve(graph, initialize="given").converged
    assert graph.families[-1].numbers == (count, count)


def test_states_of_another_shape() -> None:
    graph = ring(6)
    for call in (graph.cost, graph.linearize):
        with pytest.raises(
            OptionError, match=r"the state must have shape \(6, 3\), one row for each node, not \(3, 3\)"
        ):
            call(np.zeros((3, 3)))


def test_edges_of_single_nodes_in_numpy_where_the_search_goes_on() -> None:
    """Growing the graph cannot divide them, so that it is left out."""
    graph = Graph.from_log(load(sample_log_path()), edges="landmark+motion")
    places = graph.initial[:160:10, :2] + [7.0, 0.0]
    graph = replace(graph, families=(*graph.families, FixEdges(np.arange(0, 160, 10), places)))
    solved = [each.converged for each in solve_many([graph, graph], jobs=0)]
    assert solved == [True, True]
    with pytest.raises(GraphError, match="FixEdges cannot be divided"):
        solve(graph, initialize="grow")
