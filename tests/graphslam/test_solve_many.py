"""`solve_many`: the same bits as `solve`, in order, whatever fails."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from graphslam import (
    Graph,
    GraphError,
    OptionError,
    Solution,
    load,
    sample_log_path,
    solve,
    solve_many,
    solve_with_gtsam,
)
from graphslam.solvers import solve as many


@pytest.fixture(scope="module")
def graph() -> Graph:
    return Graph.from_log(load(sample_log_path()), edges="landmark+motion", kernel="none")


def noisy(graph: Graph, seed: int) -> Graph:
    """The same edges with other measurements."""
    random = np.random.default_rng(seed)
    families = []
    for family in graph.families:
        if hasattr(family, "measured"):
            measured = family.measured + 0.02 * random.standard_normal(np.shape(family.measured))
            family = replace(family, measured=measured)
        families.append(family)
    return replace(graph, families=tuple(families))


def singular(graph: Graph) -> Graph:
    """Without the anchor."""
    return replace(graph, families=graph.families[1:])


def fresh(graph: Graph) -> Graph:
    """With a system of its own."""
    return replace(graph)


def assert_same(found: Solution | GraphError, expected: Solution) -> None:
    assert isinstance(found, Solution)
    for name in ("state", "poses", "costs", "step_norms", "estimated"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)
    assert (found.cost, found.reason, found.notes) == (expected.cost, expected.reason, expected.notes)
    assert found.landmarks.keys() == expected.landmarks.keys()
    for landmark, mark in expected.landmarks.items():
        np.testing.assert_array_equal(found.landmarks[landmark], mark)
    np.testing.assert_array_equal(found.covariance(), expected.covariance())


def test_results_are_those_of_solve_and_a_failure_stays_alone(graph: Graph) -> None:
    graphs = [
        noisy(graph, 0),
        singular(graph),
        noisy(graph, 1),
        Graph.from_log(load(sample_log_path()), frame="world", edges="virtual+motion", kernel="none"),
    ]
    with pytest.raises(GraphError) as caught:
        solve(graphs[1], initialize="given")
    for jobs in (0, 1, 3):
        first, failed, second, world = solve_many(map(fresh, graphs), jobs=jobs, initialize="given", tolerance=1e-7)
        assert not np.array_equal(graphs[0].initial, first.state)
        for found, one in ((first, graphs[0]), (second, graphs[2]), (world, graphs[3])):
            assert_same(found, solve(fresh(one), initialize="given", tolerance=1e-7))
        assert first.cost != second.cost
        assert isinstance(failed, GraphError)
        assert str(failed) == str(caught.value)


def test_a_graph_without_the_sightings_of_its_log_is_solved() -> None:
    graph = Graph.from_log(load(sample_log_path()), edges="virtual+motion", kernel="none")
    anchor, _, motions = graph.families
    bare = graph.with_families([anchor, motions])
    (found,) = solve_many([bare])
    assert_same(found, solve(bare))
    assert found.cost < 1e-9
    assert len(found.landmarks) == len(bare.log.landmark_ids)
    assert bare.sighting_weights(found.state).shape == (0,)
    with pytest.raises(OptionError, match="no edges from sightings"):
        found.map.copy()


def test_few_graphs_are_read_ahead_and_an_error_of_the_iterator_comes_in_its_turn(graph: Graph) -> None:
    read = []

    def reading() -> Iterator[Graph]:
        for seed in range(7):
            read.append(seed)
            yield noisy(graph, seed)
        raise LookupError("end of the measurements")

    results = solve_many(reading(), jobs=1)
    assert read == []
    found = [next(results)]
    assert len(read) == many.AHEAD
    with pytest.raises(LookupError, match="end of the measurements"):
        found.extend(results)
    assert len(found) == 7
    for seed in (0, 6):
        assert_same(found[seed], solve(noisy(graph, seed)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"methods": "gauss-newton"}, "no option 'methods'; did you mean 'method'.* it takes jobs and method"),
        ({"callback": print}, "no option 'callback'"),
        ({"method": "newton"}, "method must be one of"),
        ({"tolerance": 0.0}, "tolerance must be a positive number"),
        ({"jobs": -1}, "jobs must not be negative"),
        ({"jobs": 1.5}, "jobs must be a whole number"),
    ],
)
def test_bad_options_are_refused_before_any_graph_is_read(options: dict, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        solve_many((pytest.fail("read") for _ in range(1)), **options)


def test_what_is_no_graph_is_refused_in_its_turn(graph: Graph) -> None:
    with pytest.raises(OptionError, match="an iterator of graphs, not a Graph; for one graph use solve"):
        solve_many(graph)
    for jobs in (0, None):
        results = solve_many([graph, load(sample_log_path())], jobs=jobs, initialize="given")
        assert isinstance(next(results), Solution)
        with pytest.raises(OptionError, match=r"graphs\[1\] must be a Graph, not a Log"):
            next(results)
    assert list(solve_many([])) == []
    for one in (solve, solve_with_gtsam):
        with pytest.raises(OptionError, match=r"graph must be a Graph, not a Log; Graph.from_log"):
            one(load(sample_log_path()))


def test_a_pickled_graph_leaves_its_system_behind(graph: Graph) -> None:
    solved = fresh(graph)
    solve(solved)
    copy = pickle.loads(pickle.dumps(solved))
    assert "_systems" in vars(solved)
    assert "_systems" not in vars(copy)
    assert_same(solve(copy), solve(fresh(graph)))
