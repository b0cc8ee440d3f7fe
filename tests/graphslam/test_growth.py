"""Initial values by growing a graph, in the engine, and the graph of the first poses in Python."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from graphslam import Graph, GraphError, load, sample_log_path, solve
from graphslam.edges import RelativePoseEdges
from graphslam.edges.base import EdgeFamily, EngineEdges
from graphslam.engine import engine
from graphslam.graph.transform import first_poses
from graphslam.se2 import compose
from graphslam.solvers.initialize import sequential_start
from graphslam.solvers.iteration import end_of, gauss_newton

LOG = load(sample_log_path())


@pytest.mark.parametrize(
    "options", [{"weight": "pairs"}, {"weight": "marginal"}, {"edges": "landmark+motion"}], ids=str
)
@pytest.mark.parametrize("dimensions", [2, 3])
def test_the_graph_of_the_first_poses_is_that_of_the_first_part_of_the_log(options, dimensions):
    log = load(sample_log_path())
    seen = log.steps <= 40
    part = log.replace(
        dt=log.dt[:40], controls=log.controls[:40], control_starts=None, initial_poses=log.initial_poses[:41],
        true_poses=None, steps=log.steps[seen], landmarks=log.landmarks[seen], sightings=log.sightings[seen],
    )  # fmt: skip
    whole = Graph.from_log(log, dimensions=dimensions, **options)
    expected = Graph.from_log(part, dimensions=dimensions, **options)
    piece, nodes = first_poses(whole, 41)
    assert piece.landmark_ids.tolist() == expected.landmark_ids.tolist()
    state = whole.initial[nodes] + np.random.default_rng(0).normal(size=(len(nodes), 3)) * 0.1
    assert piece.cost(state) == pytest.approx(expected.cost(state), rel=1e-12)


def test_growing_needs_motion_edges():
    with pytest.raises(GraphError, match="initialize='grow' needs motion edges"):
        solve(Graph.from_log(load(sample_log_path()), edges="virtual", kernel="none"), initialize="grow")


def grown_in_python(graph: Graph, poses: int) -> np.ndarray:
    """The same growth for at most 300 poses, whose odometry is that of one family."""
    motions = next(family for family in graph.families if type(family) is RelativePoseEdges)
    state, count, total, placed = graph.initial.copy(), 1, len(graph.steps), set()

    def place_landmarks(count: int) -> None:
        for family in graph.families:
            if family is not motions and hasattr(family, "second"):
                for k in np.argsort(family.first, kind="stable"):
                    pose, landmark = int(family.first[k]), int(family.second[k])
                    if pose < count and landmark not in placed | set(graph.mapped.tolist()):
                        placed.add(landmark)
                        seen = graph.sensor.h_inverse(state[pose], family.sightings[k])
                        state[landmark, : len(seen)] = seen

    place_landmarks(1)
    while count < total:
        before, count = count, min(count + poses, total)
        for pose in range(before, count):
            state[pose] = compose(state[pose - 1], motions.measured[pose - 1])
        place_landmarks(count)
        piece, nodes = first_poses(graph, count)
        state[nodes] = end_of(gauss_newton, piece, state[nodes], max_iterations=4)
    return state


def check_growth(graph: Graph) -> None:
    grown, expected = sequential_start(graph, 25), grown_in_python(graph, 25)
    # which no edge depends on
    grown[graph.without_heading, 2] = expected[graph.without_heading, 2] = 0
    np.testing.assert_allclose(grown, expected, rtol=0, atol=1e-7)


GRAPHS = [
    {"weight": "pairs"}, {"weight": "pairs", "frame": "world"}, {"weight": "marginal", "kernel": "cauchy"},
    {}, {"edges": "landmark+motion"}, {"edges": "landmark+motion", "residual": "cartesian"},
]  # fmt: skip


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("options", GRAPHS, ids=str)
def test_the_engine_grows_a_graph_as_its_parts_in_python(options, dimensions):
    check_growth(Graph.from_log(LOG, dimensions=dimensions, **options))


def test_a_graph_grows_in_a_map_with_a_joint_prior():
    graph = Graph.from_log(LOG, map=solve(Graph.from_log(LOG)).map)
    assert any(not isinstance(family, EngineEdges) for family in graph.families)
    check_growth(graph)


def test_a_family_in_numpy_grows_as_that_of_the_engine():
    class Own(RelativePoseEdges):
        accumulate = EdgeFamily.accumulate

    graph = Graph.from_log(LOG)
    motions = next(family for family in graph.families if type(family) is RelativePoseEdges)
    own = Own(motions.first, motions.second, motions.measured, motions.information)
    others = tuple(own if family is motions else family for family in graph.families)
    grown = sequential_start(graph.with_families(others), 25)
    np.testing.assert_allclose(grown, sequential_start(graph, 25), rtol=0, atol=1e-9)


def test_what_a_family_in_numpy_adds_to_stays_valid():
    """A traceback may show the system of a part long after the part is gone."""
    kept = []

    class Own(RelativePoseEdges):
        def accumulate(self, state: Any, reference: Any, system: Any) -> float:
            if system is not None:
                kept.append(system)
            return EdgeFamily.accumulate(self, state, reference, system)

    graph = Graph.from_log(LOG)
    motions = next(family for family in graph.families if type(family) is RelativePoseEdges)
    own = Own(motions.first, motions.second, motions.measured, motions.information)
    sequential_start(graph.with_families(own if family is motions else family for family in graph.families), 25)
    sizes = {system.num_nodes for system in kept}
    assert len(sizes) > 3
    for system in kept:
        assert 0 <= system.indices.min() <= system.indices.max() < system.num_nodes
        assert np.isfinite(system.values).all()


def test_a_family_that_cannot_be_divided_is_named():
    @dataclass(frozen=True, eq=False)
    class All(EdgeFamily):
        nodes: np.ndarray

        count = 1

        def cliques(self) -> tuple[np.ndarray, np.ndarray]:
            return np.array([0, len(self.nodes)]), self.nodes

        def linearize(self, state: Any, reference: Any) -> Any:
            raise NotImplementedError

        def accumulate(self, *_: Any) -> float:
            return 0.0

    graph = Graph.from_log(LOG)
    graph = graph.with_families((*graph.families, All(np.arange(2))))
    with pytest.raises(GraphError, match="All cannot be divided"):
        sequential_start(graph, 25)


def test_the_steps_of_growth_are_those_of_all_parts():
    # 11, 21 and 25 of 25 poses
    assert engine.most_steps_of_growth(25, 10) == pytest.approx(4 * (11 + 21 + 25) / 25)
    # beyond 300 poses, more are added in proportion: 301, 311 and 320 of 320 poses
    assert engine.most_steps_of_growth(320, 300) == pytest.approx(4 * (301 + 320) / 320)
    assert engine.most_steps_of_growth(1, 10) == 0
