from __future__ import annotations

import numpy as np
import pytest

from fastslam.genealogy import Genealogy


@pytest.mark.parametrize("particles", [1, 5, 64])
@pytest.mark.parametrize("branching", [0.1, 0.6, 1.0])
def test_against_copied_histories(particles: int, branching: float) -> None:
    """The same as carrying every history along, with pruning at work."""
    rng = np.random.default_rng(particles)
    tree = Genealogy(particles)
    histories: list[list[np.ndarray]] = [[] for _ in range(particles)]
    numbers: list[dict[int, int]] = [{} for _ in range(particles)]  # the particle's index at each level so far
    for step in range(300):
        poses = rng.standard_normal((particles, 3))
        tree.record(np.zeros((3, particles)) if step % 3 == 0 else poses.T)
        if step % 3 == 0:
            tree.amend(poses.T)
        histories = [history + [pose] for history, pose in zip(histories, poses, strict=True)]
        # up to twice in one step; the second time the new indices have a level of their own
        for _ in range(int(rng.random() < branching) + int(rng.random() < branching / 4)):
            level = tree.level()
            assert tree.is_living(level)
            numbers = [line | {level: i} for i, line in enumerate(numbers)]
            ancestors = np.sort(rng.integers(particles, size=particles))
            tree.branch(ancestors)
            assert not tree.is_living(level)
            histories = [histories[a] for a in ancestors]
            numbers = [numbers[a] for a in ancestors]
        if step % 50 == 0:
            for level in list(numbers[0]):
                np.testing.assert_array_equal(tree.ancestors(level), [line[level] for line in numbers])
    for i in range(particles):
        np.testing.assert_array_equal(tree.trajectory(i), histories[i])

    weights = rng.dirichlet(np.ones(particles))
    means, counts = tree.summary(weights)
    assert means.shape == (300, 3)
    for t in range(300):
        at_t = np.array([history[t] for history in histories])
        np.testing.assert_allclose(means[t, :2], weights @ at_t[:, :2], atol=1e-12)
        heading = np.arctan2(weights @ np.sin(at_t[:, 2]), weights @ np.cos(at_t[:, 2]))
        assert means[t, 2] == pytest.approx(heading, abs=1e-12)
        assert counts[t] == len(np.unique(at_t, axis=0))
    for i in range(particles):
        np.testing.assert_array_equal(tree.trajectory(i), histories[i])
    for level in numbers[0]:
        np.testing.assert_array_equal(tree.ancestors(level), [line[level] for line in numbers])


def test_memory_does_not_grow_with_time() -> None:
    """Resampled at every step, the tree of survivors has about T + N log N rows, far below N T."""
    rng, particles, steps = np.random.default_rng(0), 100, 5000
    tree = Genealogy(particles)
    for _ in range(steps):
        tree.record(np.zeros((3, particles)))
        tree.branch(np.sort(rng.integers(particles, size=particles)))
    assert tree.stored_rows < 0.1 * particles * steps
    tree.prune()
    assert tree.stored_rows < 2 * (steps + 10 * particles * np.log(particles))
