"""Relations that agree in pairs: the covariance of their difference, and which relations are trusted."""

from dataclasses import replace

import numpy as np
import pytest

from graphslam import Graph, solve
from graphslam.edges import AnchorEdges, RelationEdges, RelativePoseEdges
from graphslam.se2 import between, compose
from graphslam.solvers.agreement import agreeing, differences
from graphslam.solvers.initialize import dead_reckoning

LIMIT = 11.345  # the quantile 0.99 of chi-square with three degrees of freedom


def laps(seed, noise=1.0, laps=4, poses=40, drawn=1.0):
    """A pose graph of some laps on a square, relations to the lap before, covariances ``noise``² times too large."""
    rng = np.random.default_rng(seed)
    step = np.array([[1.0, 0.0, np.pi / 2 if k % (poses // 4) == 0 else 0.0] for k in range(1, laps * poses)])
    truth = np.zeros((laps * poses, 3))
    for k, motion in enumerate(step):
        truth[k + 1] = compose(truth[k], motion)
    C = np.diag([0.05, 0.02, 0.01]) ** 2
    shown = step + drawn * rng.multivariate_normal(np.zeros(3), C, len(step))
    second = np.arange(poses, len(truth))[::2]
    first = second - poses + rng.integers(-2, 3, len(second)) * (second > poses + 4)
    # some are given the other way round
    turned = rng.random(len(first)) < 0.3
    first, second = np.where(turned, second, first), np.where(turned, first, second)
    measured = between(truth[first], truth[second]) + drawn * rng.multivariate_normal(np.zeros(3), C, len(first))
    omega = np.linalg.inv(C) * noise**-2
    nodes = np.arange(len(truth))
    families = (
        AnchorEdges(np.array([0]), np.zeros((1, 3)), 1e6 * np.eye(3)[None]),
        RelativePoseEdges(nodes[:-1], nodes[1:], shown, np.tile(omega, (len(shown), 1, 1))),
        RelationEdges(first, second, measured, np.tile(omega, (len(first), 1, 1))),
    )
    ids = {"pose_ids": nodes, "landmark_ids": nodes[:0]}
    graph = Graph(initial=np.zeros_like(truth), families=families, steps=nodes, trajectory=truth, **ids)
    return graph.with_initial(dead_reckoning(graph))


def with_wrong(graph, share, seed):
    """The graph with a share of its relations at random, and which."""
    rng, edges = np.random.default_rng(seed), graph.families[2]
    wrong = rng.random(edges.count) < share
    at_random = rng.uniform([-10, -10, -np.pi], [10, 10, np.pi], (edges.count, 3))
    changed = replace(edges, measured=np.where(wrong[:, None], at_random, edges.measured))
    return replace(graph, families=(*graph.families[:2], changed)), wrong


def test_the_covariance_of_a_difference_is_that_of_finite_differences():
    graph = laps(1, laps=2, poses=24, drawn=1e-6)
    motions, relations = graph.families[1:]
    k, _, _, T = differences(graph, relations)
    # the noise adds to the numbers that are measured, in the axes of the first pose
    numbers, C = (motions.measured, relations.measured), np.linalg.inv(motions.information[0])
    expected, h = np.zeros_like(T), 1e-6
    for which, measured in enumerate(numbers):
        for row in range(len(measured)):
            J = np.zeros((len(k), 3, 3))
            for column in range(3):
                ends = []
                for sign in (1, -1):
                    changed = measured.copy()
                    changed[row, column] += sign * h
                    families = list(graph.families)
                    families[1 + which] = replace(families[1 + which], measured=changed)
                    ends.append(differences(replace(graph, families=tuple(families)), families[2])[2])
                J[:, :, column] = (ends[0] - ends[1]) / (2 * h)
            expected += J @ C @ np.swapaxes(J, 1, 2)
    assert len(k) > 50
    np.testing.assert_allclose(T, expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("noise", [1.0, 10.0])
@pytest.mark.parametrize("share", [0.0, 0.2, 0.4])
def test_right_relations_are_trusted_and_wrong_ones_are_not(share, noise):
    """The optimum is that without the wrong ones, also where the noise model is ten times too pessimistic."""
    for seed in range(3):
        graph, wrong = with_wrong(laps(seed, noise), share, seed)
        found = solve(graph, method="gnc", probability=0.9999)
        trust = found.other_trust["relations"]
        np.testing.assert_array_equal(trust, ~wrong)
        best = solve(graph.with_trust((~wrong).astype(float)))
        np.testing.assert_allclose(found.poses, best.poses, atol=1e-6)


def test_relations_at_random_do_not_agree():
    """At most `EXPECTED` pairs by chance: five graphs have less than ten together, with probability 0.97."""
    count = 0
    for seed in range(5):
        graph, _ = with_wrong(laps(seed), 1.1, seed)
        count += agreeing(graph, graph.families[2], LIMIT).sum()
    assert count < 2 * 10


def test_few_relations_that_agree_with_no_other_are_trusted():
    graph = laps(3)
    few = np.array([0, 30, 55])
    edges = graph.families[2]
    lone = RelationEdges(edges.first[few], edges.second[few], edges.measured[few], edges.information[few])
    graph = replace(graph, families=(*graph.families[:2], lone))
    found = solve(graph, method="gnc", probability=0.9999)
    assert not agreeing(graph, lone, LIMIT).any()
    assert found.other_trust["relations"].tolist() == [1.0, 1.0, 1.0]
