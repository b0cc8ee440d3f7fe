"""Where a certificate that fails says to descend."""

from __future__ import annotations

import numpy as np
import pytest
from certified_graphs import ring

from graphslam import Graph, certify, simulate, solve
from graphslam.solvers import auto
from graphslam.solvers.initialize import descents


@pytest.mark.parametrize("seed", [3, 6, 7])
def test_descents_lead_from_a_wrong_minimum_to_a_lower_one(seed):
    graph = Graph.from_log(simulate(seed=seed), edges="landmark+motion", dimensions=2, kernel="none")
    best, wrong = solve(graph), None
    for headings in range(4):
        start = graph.initial.copy()
        start[: len(graph.steps), 2] = np.random.default_rng(headings).uniform(-np.pi, np.pi, len(graph.steps))
        end = solve(graph.with_initial(start), initialize="given", method="levenberg-marquardt")
        if end.converged and end.cost > best.cost * (1 + 1e-6):
            wrong = end
    assert wrong.certificate.status == "not proven"
    starts = list(descents(graph, wrong.state, wrong.certificate.direction))
    assert len(starts) == 6
    ends = [solve(graph.with_initial(each), initialize="given", max_iterations=50).cost for each in starts]
    assert min(ends) < wrong.cost * (1 - 1e-6)


def test_auto_goes_on_from_a_plausible_end_that_is_not_proven(monkeypatch):
    graph = ring(120, windings=2)
    wrong = solve(graph, initialize="given")
    starts = [("given", graph.initial), ("another", ring(120).initial)]
    monkeypatch.setattr(auto, "_starts", lambda *_: iter(starts))
    best = solve(graph)
    assert wrong.cost > 1 and best.cost < 1e-9
    monkeypatch.setattr(auto, "PROVABLE", 119)
    assert solve(graph).cost == pytest.approx(wrong.cost)


def test_descents_keep_what_is_fixed():
    fixed = ring(12, windings=3)
    for each in descents(fixed, fixed.initial, certify(fixed, fixed.initial).direction):
        np.testing.assert_array_equal(each[0], fixed.initial[0])
