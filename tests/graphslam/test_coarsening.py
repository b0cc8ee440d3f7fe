"""Coarse graphs: joined motions, the poses between the kept ones, and the same solution."""

import numpy as np
import pytest

from graphslam import Graph, MotionModel, SensorModel, simulate, solve
from graphslam.edges import ObservationEdges, RelativePoseEdges
from graphslam.graph.transform import coarse, filled
from graphslam.se2 import between, compose, wrap
from graphslam.solvers import initialize as solver


@pytest.fixture(scope="module")
def graph():
    gentle = {
        "motion": MotionModel(nn=0.02, no=1e-4, on=0.01, oo=0.02),
        "sensor": SensorModel(range_rate=0.02, bearing_std=0.01, orientation_std=0.01),
    }
    log = simulate(seed=6, steps=61, clean=True, orientation=False, **gentle)
    return Graph.from_log(log, edges="landmark+motion", **gentle)


def family_of(graph, kind):
    return next(family for family in graph.families if isinstance(family, kind))


def test_joined_motions_are_the_composition_with_its_covariance(graph):
    smaller, nodes = coarse(graph, 4)
    kept = nodes[: len(smaller.steps)]
    assert kept.tolist() == [*range(0, 61, 4), 61]
    chain, joined = family_of(graph, RelativePoseEdges), family_of(smaller, RelativePoseEdges)
    for k in (0, 7, len(kept) - 2):
        pose, covariance = np.zeros(3), np.zeros((3, 3))
        for j in range(kept[k], kept[k + 1]):
            # P <- F P F' + G C G', by differences of compose
            step, c = chain.measured[j], np.linalg.inv(chain.information[j])
            F = np.column_stack([(compose(pose + d, step) - compose(pose - d, step)) / 2e-6 for d in 1e-6 * np.eye(3)])
            G = np.eye(3)
            G[:2, :2] = [[np.cos(pose[2]), -np.sin(pose[2])], [np.sin(pose[2]), np.cos(pose[2])]]
            pose, covariance = compose(pose, step), F @ covariance @ F.T + G @ c @ G.T
        off = joined.measured[k] - pose
        np.testing.assert_allclose([*off[:2], wrap(off[2])], 0, atol=1e-12)
        np.testing.assert_allclose(np.linalg.inv(joined.information[k]), covariance, rtol=1e-5, atol=1e-12)


def test_what_is_seen_from_kept_poses_stays(graph):
    smaller, nodes = coarse(graph, 5)
    seen, all_seen = family_of(smaller, ObservationEdges), family_of(graph, ObservationEdges)
    here = np.isin(all_seen.first, nodes[: len(smaller.steps)])
    np.testing.assert_array_equal(seen.sightings, all_seen.sightings[here])
    np.testing.assert_array_equal(nodes[seen.second], all_seen.second[here])
    np.testing.assert_array_equal(smaller.landmark_ids[seen.second - len(smaller.steps)],
                                  graph.landmark_ids[all_seen.second[here] - len(graph.steps)])  # fmt: skip


def test_between_kept_poses_the_motions_lead_on(graph):
    smaller, nodes = coarse(graph, 4)
    kept = nodes[: len(smaller.steps)]
    rng = np.random.default_rng(1)
    poses = np.column_stack([rng.normal(size=(len(kept), 2)), rng.uniform(-3, 3, len(kept))])
    whole = filled(graph, kept, poses)
    np.testing.assert_allclose(whole[kept], poses, atol=1e-12)
    chain = family_of(graph, RelativePoseEdges)
    for j in (1, 6, 59):
        inside = j not in kept + 0 and j + 1 not in kept
        if inside:
            off = between(whole[j], whole[j + 1]) - chain.measured[j]
            np.testing.assert_allclose([*off[:2], wrap(off[2])], 0, atol=1e-12)


def test_the_answer_is_the_same(graph, monkeypatch):
    near = solve(graph, initialize="auto")
    monkeypatch.setattr(solver, "LONG", 6)
    monkeypatch.setattr(solver, "EVERY", 3)
    afar = solve(graph, initialize="auto")
    assert afar.converged and afar.cost == pytest.approx(near.cost, rel=1e-9)


def test_what_is_no_chain_is_left_alone(graph, shared_data):
    assert coarse(Graph.from_log(simulate(seed=1), edges="virtual+motion", kernel="none"), 4) is None
    assert coarse(Graph.from_g2o(shared_data("posegraph/dlr.g2o")), 4) is None
