"""The samplers of the engine: their random numbers, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fastslam import GibbsOptions
from fastslam.gibbs import LowRank, Target
from fastslam.motions import Problem
from fastslam.particles import draw_key
from graphslam import Log, MotionModel, SensorModel, simulate
from graphslam.engine import engine
from graphslam.se2 import Array


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate(seed=2, steps=5, clean=True)


@pytest.fixture(scope="module")
def target(log: Log) -> Target:
    return Target.of(Problem.of(log, MotionModel(), SensorModel()), GibbsOptions())


def normals_of(key: int, count: int) -> Array:
    """Pairs of Box and Muller from the bits of SplitMix64: the first numbers of eight pairs, the second ones, and so on."""
    index = np.arange(2 * count, dtype=np.uint64)
    bits = np.uint64(key) + (index + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    uniform = ((bits ^ (bits >> np.uint64(31))) >> np.uint64(11)) * 2.0**-53
    radius, angle = np.sqrt(-2 * np.log(1 - uniform[::2])), 2 * np.pi * uniform[1::2] - np.pi
    pairs = np.stack([radius * np.cos(angle), radius * np.sin(angle)])
    return pairs.reshape(2, -1, 8).swapaxes(0, 1).ravel()[:count]


def test_a_map_is_drawn_with_the_numbers_of_its_key(log: Log, target: Target) -> None:
    """Given the trajectory, a landmark seen once is its sighting plus a root of its covariance times normal numbers."""
    p, x, key = target.problem, log.initial_poses, draw_key(np.random.default_rng(7))
    drawn = target.in_engine.draw_map(x, key)
    normals = normals_of(key, 8 * len(p.ids))[: 3 * len(p.ids)].reshape(-1, 3)
    counts = np.bincount(p.marks)
    for j in np.flatnonzero(counts == 1):
        k = int(np.flatnonzero(p.marks == j)[0])
        pose = x[p.steps[k]]
        c, s = np.cos(pose[2]), np.sin(pose[2])
        G = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        C = p.C[k][[[0, 1, 3], [1, 2, 4], [3, 4, 5]]]
        expected = pose + G @ p.y[k] + np.linalg.cholesky(G @ C @ G.T) @ normals[j]
        np.testing.assert_allclose(np.sin(drawn[j] - expected)[2], 0, atol=1e-12)
        np.testing.assert_allclose(drawn[j, :2], expected[:2], atol=1e-12)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("first", lambda a: a[::-1].copy()),
        ("first", lambda a: a[:-1]),
        ("first", lambda a: a + 1),
        ("marks", lambda a: a - 1),
        ("marks", lambda a: a + 100),
        ("sightings", lambda a: a[:-1]),
        ("sightings", lambda a: a[:, :20].copy()),
        ("motions", lambda a: a[:-1]),
        ("columns", lambda a: 2 * a),
    ],
)
def test_problems_that_are_none_are_refused(target: Target, name: str, change: Any) -> None:
    p = target.problem
    given: dict[str, Any] = {"motions": np.hstack([p.motions, p.information]), "first": p.first, "marks": p.marks}
    given |= {"sightings": np.hstack([p.y, p.C, p.C, p.z, p.q]), "landmarks": len(p.ids), "columns": p.columns}
    given |= {"exact": False, "degrees": 0.0}
    engine.GibbsProblem(*given.values())
    with pytest.raises((ValueError, TypeError)):
        engine.GibbsProblem(*(given | {name: change(given[name])}).values())


def test_chains_take_what_belongs_together(log: Log, target: Target) -> None:
    key, x = 5, log.initial_poses
    marks = np.array([log.true_landmarks[j] for j in target.problem.ids.tolist()])
    low_rank = LowRank(target, x, marks)
    chain = engine.GibbsChain(key, x, target.problem.motions)
    given = target.in_engine, *low_rank.mode, low_rank.directions, low_rank.deviations
    trajectories, maps = chain.run(*given, 2, 1, 3, 2, True)
    assert trajectories.shape == (3, *x.shape) and maps.shape == (3, *marks.shape)
    for wrong in (
        (*given[:1], x[:-1], *given[2:]),
        (*given[:2], marks[:-1], *given[3:]),
        (*given[:3], np.ascontiguousarray(low_rank.directions[:, :-1]), low_rank.deviations),
    ):
        with pytest.raises(ValueError, match="wrong number of rows|another width"):
            chain.run(*wrong, 2, 1, 3, 2, True)
    for particles, block in ((1, 1), (2, 0)):
        with pytest.raises(ValueError, match="two particles"):
            chain.run(*given, particles, block, 3, 2, True)
    with pytest.raises(ValueError, match="another number of poses"):
        engine.GibbsChain(key, x[:3], target.problem.motions[:2]).run(*given, 2, 1, 3, 2, True)
    for other in (-1, 2**64, np.random.default_rng(0)):
        with pytest.raises(TypeError):
            engine.GibbsChain(other, x, target.problem.motions)
    with pytest.raises(ValueError, match="rows"):
        engine.GibbsChain(key, x, target.problem.motions[:2])


def test_trajectories_are_drawn_from_a_record_of_all_steps(target: Target) -> None:
    particles = engine.ParticleFilter(np.zeros((4, 3)), 1, True)
    with pytest.raises(ValueError, match="as many steps"):
        engine.BackwardSampler(particles, target.in_engine, 10)
    for step in range(5):
        particles.move_by_control(step, (1.0, 0.0, 0.1, 0.1, 1.0, 0.0), False)
    engine.BackwardSampler(particles, target.in_engine, 10).draw(0)
    with pytest.raises(ValueError, match="at least one"):
        engine.BackwardSampler(particles, target.in_engine, 0)
    with pytest.raises(ValueError, match="keeps a record"):
        engine.BackwardSampler(engine.ParticleFilter(np.zeros((4, 3)), 1, False), target.in_engine, 10)


def test_searches_take_what_belongs_together() -> None:
    start, marks, some = np.array([0, 1, 2]), np.array([0, 1]), np.ones(2)
    given: list[Any] = [start, marks, np.zeros((2, 2)), np.eye(4), some, some, np.ones(2, bool), np.ones(3), 10]
    assert engine.best_hypothesis(*given)[0].shape == (2,)
    for place, wrong in (
        (0, np.array([0, 3, 2])), (0, np.array([1, 2])), (1, np.array([0, 2])), (1, np.array([0, -1])),
        (2, np.zeros((2, 4))), (3, np.eye(3)), (4, np.ones(3)), (6, np.ones(1, bool)), (7, np.ones(2)),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=r"must|different|needed|coordinates|covariance"):
            engine.best_hypothesis(*given[:place], wrong, *given[place + 1 :])
    begin = np.array([[0, -1]])
    pairs: list[Any] = [begin, marks, marks, np.zeros((2, 2)), np.eye(4), some, np.ones(2, bool), 1.0, 1.0, True]
    assert engine.grow_hypotheses(*pairs)[0].shape == (1, 2)
    for place, wrong in ((0, np.array([[2]])), (0, np.array([0])), (1, np.zeros(3, np.int64)), (5, np.ones(1))):
        with pytest.raises(ValueError, match=r"begins|different"):
            engine.grow_hypotheses(*pairs[:place], wrong, *pairs[place + 1 :])
