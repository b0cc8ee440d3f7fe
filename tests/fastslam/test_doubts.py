"""Notes of filters: an estimate that contradicts its log, and particles that have one history."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from comparisons import run
from comparisons.show.language import translated
from fastslam import FastSLAM1, FastSLAM2, MonteCarloLocalization
from fastslam.doubts import CONTRADICTION
from graphslam import Log, simulate

FILTERS = [FastSLAM1, FastSLAM2, MonteCarloLocalization]


def lifted(seed: int) -> Log:
    """A robot that is carried after step 19 to the farthest place of its drive, which its controls do not know."""
    log = simulate(seed=seed, steps=150, clean=True)
    assert log.controls is not None and log.dt is not None and log.true_poses is not None
    far = 21 + int(np.argmax(np.hypot(*(log.true_poses[21:120] - log.true_poses[20])[:, :2].T)))
    stays, carried = (log.steps < 20) | (log.steps >= far), slice(20, far)
    steps = log.steps[stays]
    return Log(
        dt=np.delete(log.dt, carried),
        controls=np.delete(log.controls, carried, axis=0),
        steps=np.where(steps < 20, steps, steps - (far - 20)),
        landmarks=log.landmarks[stays],
        sightings=log.sightings[stays],
        initial_poses=np.delete(log.true_poses, carried, axis=0),
        true_poses=np.delete(log.true_poses, carried, axis=0),
        true_landmarks=log.true_landmarks,
        motion=log.motion,
        sensor=log.sensor,
    )


def contradictions(notes: tuple[str, ...]) -> list[str]:
    return [note for note in notes if CONTRADICTION in note]


@pytest.mark.slow
@pytest.mark.parametrize("kind", FILTERS)
def test_a_lifted_robot_is_noted(kind: Any) -> None:
    """As the filter goes on: before it was lifted nothing is said. Measurements by hand are not kept, and not judged."""
    slam = kind(lifted(1), particles=100, seed=1)
    for _ in zip(slam, range(18)):
        pass
    assert contradictions(slam.result().notes) == []
    found = slam.run()
    (note,) = contradictions(found.notes)
    begin, end = (int(note.split()[k]) for k in (2, 4))
    # FastSLAM 1.0 moves its landmarks, until the sightings before do not fit either
    assert kind is FastSLAM1 or begin <= 20 <= end
    assert "The robot was moved" in note and "ロボットが動かされたか" in translated(note, "ja")
    by_hand = kind(slam.log, particles=100, seed=1)
    by_hand.move((1.0, 0.0), 1.0)
    assert contradictions(by_hand.result().notes) == []


@pytest.mark.parametrize("kind", FILTERS)
def test_right_models_are_not_noted(kind: Any) -> None:
    for seed in range(4):
        assert contradictions(kind(simulate(seed=seed), seed=seed).run().notes) == []


def test_the_comparison_has_the_note() -> None:
    (result,) = run(lifted(1), estimators=["fastslam1"], particles=100, seed=1).results
    assert len(contradictions(result.notes)) == 1


def test_particles_of_one_history_are_noted() -> None:
    log = simulate(seed=2, steps=80, clean=True)
    slam = FastSLAM1(log, particles=10, seed=1)
    found = slam.run()
    last = int(np.flatnonzero(found.ancestors == 1)[-1])
    (note,) = (note for note in found.notes if f"all particles have one history up to step {last} of 80" in note)
    assert translated(note, "ja").startswith(f"時刻{last}まで")
    # a history of one step, and one drawn backwards, say nothing of this kind
    assert not any("one history" in note for note in FastSLAM1(log, particles=10, seed=1, smoothing=10).run().notes)
    assert not any("one history" in note for note in MonteCarloLocalization(log, particles=10, seed=1).run().notes)
    # a comparison has no NEES to show it with where there is no ground truth
    without_truth = log.replace(true_poses=None, true_path=None, true_landmarks=None)
    for each, said in ((log, False), (without_truth, True)):
        (result,) = run(each, estimators=["fastslam1"], particles=10, seed=1).results
        assert any("one history" in note for note in result.notes) == said


@pytest.mark.parametrize("kind", FILTERS)
def test_one_particle_has_no_covariance(kind: Any) -> None:
    slam = kind(simulate(seed=2, steps=5), particles=1, seed=1)
    (note,) = (note for note in slam.run().notes if note.startswith("one particle"))
    assert not slam.covariance().any()
    assert translated(note, "ja").startswith("パーティクルが1つ")


def test_covariances_of_landmarks_are_those_over_all_particles() -> None:
    """Those of the best particle belong to its history, which has errors of its own."""
    for seed in range(4):
        slam = FastSLAM2(log := simulate(seed=seed, steps=150, clean=True, orientation=False), seed=seed)
        found = slam.run()
        ids = [j for j in found.landmarks if np.sum(log.landmarks == j) > 3]
        about = np.array([found.landmarks[j] - slam.landmarks[j] for j in ids])
        expected = slam.covariance(landmarks=ids) + about[:, :, None] * about[:, None, :]
        np.testing.assert_allclose([found.landmark_covariances[j] for j in ids], expected, rtol=1e-9, atol=1e-12)
