"""Several threads use one graph, its variants or its solution at once: all numbers are those of one thread, bit by bit."""

from __future__ import annotations

import gc
import pickle
import sys
import threading
import weakref
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from graphslam import Graph, Solution, load, sample_log_path, solve, solve_many
from graphslam.linear.information import SystemOfThread

#: how often each thread repeats its part, which is enough for threads that disturb each other to be noticed
REPEATS = 10


@pytest.fixture(scope="module")
def graph() -> Graph:
    return Graph.from_log(load(sample_log_path()), edges="landmark+motion", kernel="cauchy")


@pytest.fixture(autouse=True)
def _threads_change_often() -> Iterator[None]:
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    yield
    sys.setswitchinterval(before)


def at_once(*parts: Callable[[], object]) -> list[list[object]]:
    """What each part returns, `REPEATS` times in a thread of its own; all of them begin at once."""
    barrier = threading.Barrier(len(parts))

    def repeated(part: Callable[[], object]) -> list[object]:
        barrier.wait()
        return [part() for _ in range(REPEATS)]

    with ThreadPoolExecutor(len(parts)) as pool:
        return list(pool.map(repeated, parts))


def numbers(solution: object) -> tuple[np.ndarray, ...]:
    assert isinstance(solution, Solution), solution
    return solution.state, solution.costs, solution.step_norms, solution.covariance()


def assert_same(found: object, expected: Solution) -> None:
    for one, other in zip(numbers(found), numbers(expected), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.slow
@pytest.mark.parametrize("threads", [2, 4])
def test_threads_solve_one_graph(graph: Graph, threads: int) -> None:
    expected = solve(replace(graph))
    # a graph without a system: the threads make it at once, too
    shared = replace(graph)
    for found in at_once(*[lambda: solve(shared)] * threads):
        for solution in found:
            assert_same(solution, expected)


@pytest.mark.slow
def test_threads_solve_variants_of_one_graph(graph: Graph) -> None:
    moved = graph.initial + np.random.default_rng(0).normal(scale=0.01, size=graph.initial.shape)
    trust = np.linspace(0.5, 1.0, graph.measurements)
    variants = [
        graph, graph.with_wider_kernel(2.0), graph.without_kernel, graph.with_trust(trust),
        graph.with_noise_at(moved), graph.with_initial(moved),
    ]  # fmt: skip
    expected = [solve(deepcopy(variant), initialize="given") for variant in variants]
    for k in range(0, len(variants), 2):
        parts = [lambda variant=variant: solve(variant, initialize="given") for variant in variants[k : k + 2]]
        for found, one in zip(at_once(*parts), expected[k : k + 2], strict=True):
            for solution in found:
                assert_same(solution, one)


@pytest.mark.slow
def test_covariances_while_another_thread_solves_the_same_graph(graph: Graph) -> None:
    alone = solve(replace(graph))
    P, risk = alone.covariance(), alone.integrity_risk(0.1)
    solution = solve(graph)

    def covariances() -> list[tuple[np.ndarray, np.ndarray]]:
        # a copy of the solution has not computed them
        copies = [replace(solution) for _ in range(10)]
        return [(copy.covariance(), copy.integrity_risk(0.1)) for copy in copies]

    of_covariances, of_solve = at_once(covariances, lambda: solve(graph))
    for found in of_covariances:
        for covariance, probability in found:  # type: ignore[attr-defined]
            np.testing.assert_array_equal(covariance, P)
            np.testing.assert_array_equal(probability, risk)
    for each in of_solve:
        assert_same(each, alone)


def test_threads_solve_with_the_factor_of_one_solution(graph: Graph) -> None:
    solution, right = solve(graph), np.random.default_rng(0).normal(size=(4, *graph.initial.shape))
    expected = [solution._uncertainty.solve(each) for each in right]
    parts = [lambda each=each: [solution._uncertainty.solve(each) for _ in range(20)] for each in right]
    for found, one in zip(at_once(*parts), expected, strict=True):
        np.testing.assert_array_equal(np.reshape(found, (-1, *one.shape)), np.tile(one, (20 * REPEATS, 1, 1)))


def test_threads_prove_solutions_of_one_graph(graph: Graph) -> None:
    plain = graph.without_kernel
    solution = solve(plain)

    def certificate() -> object:
        return replace(replace(solution).certificate, seconds=0.0)

    for found in at_once(certificate, certificate):
        assert found == [certificate()] * REPEATS


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [None, 4])
def test_solve_many_of_the_same_graph(graph: Graph, jobs: int | None) -> None:
    expected = solve(replace(graph))
    for found in (solve_many([graph] * 12, jobs=jobs), solve_many([graph.with_wider_kernel(1.0)] * 12, jobs=jobs)):
        for solution in found:
            assert_same(solution, expected)


def test_graphs_are_pickled_and_copied_while_another_thread_solves_them(graph: Graph) -> None:
    expected, shared = solve(replace(graph)), replace(graph)
    copies, _ = at_once(lambda: (pickle.loads(pickle.dumps(shared)), deepcopy(shared)), lambda: solve(shared))
    for copy in copies[-1]:  # type: ignore[attr-defined]
        assert_same(solve(copy), expected)


def test_the_memory_of_a_thread_that_ended_is_freed(graph: Graph) -> None:
    def memory() -> tuple[weakref.ref, ...]:
        solve(graph)
        assert graph.system is graph.without_kernel.system
        return weakref.ref(graph.system), weakref.ref(graph.system._factor), weakref.ref(graph.system.values)

    own = memory()
    with ThreadPoolExecutor(1) as pool:
        others = pool.submit(memory).result()
    gc.collect()
    assert all(one() is not None for one in own)
    assert all(other() is None for other in others)
    assert isinstance(vars(graph)["_systems"], SystemOfThread)
