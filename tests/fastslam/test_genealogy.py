from __future__ import annotations

import numpy as np
import pytest

from fastslam.genealogy import Genealogy


@pytest.mark.parametrize("particles", [1, 5, 64])
def test_against_copied_histories(particles: int) -> None:
    """The same as carrying every history along, with pruning at work."""
    rng = np.random.default_rng(particles)
    tree = Genealogy(particles)
    histories: list[list[np.ndarray]] = [[] for _ in range(particles)]
    numbers: list[list[int]] = [[] for _ in range(particles)]  # the particle's number in each generation so far
    for _ in range(400):
        poses = rng.standard_normal((particles, 3))
        tree.record(poses)
        histories = [history + [pose] for history, pose in zip(histories, poses, strict=True)]
        if rng.random() < 0.6:
            ancestors = np.sort(rng.integers(particles, size=particles))
            tree.branch(ancestors)
            histories = [histories[a] for a in ancestors]
            numbers = [numbers[a] + [int(a)] for a in ancestors]
    for i in range(particles):
        np.testing.assert_array_equal(tree.trajectory(i), histories[i])
    for g in range(tree.generation):
        np.testing.assert_array_equal(tree.ancestors(g), [line[g] for line in numbers])
    np.testing.assert_array_equal(tree.ancestors(tree.generation), np.arange(particles))

    weights = rng.dirichlet(np.ones(particles))
    backwards = list(tree.walk_back(weights))[::-1]
    assert len(backwards) == 400
    for t, (poses, mass) in enumerate(backwards):
        at_t = np.array([history[t] for history in histories])
        np.testing.assert_allclose(mass @ poses, weights @ at_t, atol=1e-12)
        assert len(mass) == len(np.unique(at_t, axis=0))


def test_memory_does_not_grow_with_time() -> None:
    """Resampled at every step, the tree of survivors has about T + N log N rows, far below N T."""
    rng, particles, steps = np.random.default_rng(0), 100, 5000
    tree = Genealogy(particles)
    for _ in range(steps):
        tree.record(np.zeros((particles, 3)))
        tree.branch(np.sort(rng.integers(particles, size=particles)))
    assert tree.stored_rows < 0.1 * particles * steps
    tree.prune()
    assert tree.stored_rows < 2 * (steps + 10 * particles * np.log(particles))
