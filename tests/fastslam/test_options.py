"""Options are declared once, and results keep them."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields

import numpy as np
import pytest

import fastslam
from fastslam import FastSLAM1, FastSLAM2, FilterOptions, MonteCarloLocalization
from graphslam import OptionError, simulate


def test_every_option_has_help() -> None:
    assert all(option.metadata["help"].endswith(".") for option in fields(FilterOptions))


def test_an_options_object_is_the_same_as_keywords() -> None:
    log, options = simulate(seed=1, steps=10), FilterOptions(particles=30, seed=4, ess_threshold=1.0)
    by_object = FastSLAM1(log, options=options).run()
    by_keywords = FastSLAM1(log, particles=30, seed=4, ess_threshold=1.0).run()
    np.testing.assert_array_equal(by_object.poses, by_keywords.poses)
    assert by_object.options == by_keywords.options == options.for_ids(True)
    # a keyword replaces the option of the object
    assert FastSLAM1(log, options=options, seed=5).options.seed == 5
    with pytest.raises(OptionError, match="FastSLAM1 has no option 'particle'; did you mean 'particles'"):
        FastSLAM1(log, particle=30)


@pytest.mark.parametrize("kind", [MonteCarloLocalization, FastSLAM1, FastSLAM2])
def test_a_map_has_one_name(kind: type) -> None:
    """`map`, as in `OnlineSolver` and `Graph.from_log`."""
    log = simulate(seed=1, steps=10)
    assert list(kind(log, map=log.true_landmarks, particles=3).run().landmarks)
    for name in ("landmarks", "landmark_map"):
        with pytest.raises(OptionError, match=f"{kind.__name__} has no option '{name}'; a map .* is given as map"):
            kind(log, **{name: log.true_landmarks})


def test_a_result_keeps_its_origin_and_is_printed_in_one_line() -> None:
    log = simulate(seed=1, steps=10)
    slam = FastSLAM2(log, particles=30, seed=4)
    result = slam.run()
    assert (result.estimator, result.log, result.options.seed) == ("FastSLAM2", log.name, 4)
    assert (result.motion, result.sensor) == (slam.motion, slam.sensor)
    assert repr(result) == (
        f"FilterResult(FastSLAM2 on simulated: 30 particles, 11 poses, {len(result.landmarks)} landmarks, "
        f"smallest ESS {result.ess.min():.1f}, {result.resampled.sum()} resamplings, "
        f"histories left from step 0: {result.ancestors[0]})"
    )


def test_a_result_has_the_map_of_the_particle_whose_history_it_has_and_the_filter_that_of_all() -> None:
    slam = FastSLAM2(simulate(seed=1, steps=10), particles=30, seed=4, ess_threshold=0.0)
    result, state = slam.run(), slam.state
    mixture, best = state.mixture_map(), state.map()
    np.testing.assert_array_equal(result.poses[-1], state.best_pose)
    np.testing.assert_array_equal(slam.pose, state.mean_pose)
    assert slam.landmarks.keys() == result.landmarks.keys() == best.keys()
    for j, place in result.landmarks.items():
        np.testing.assert_array_equal(place, best[j].mean)
        np.testing.assert_array_equal(slam.landmarks[j], mixture[j].mean)
        assert not np.array_equal(place, slam.landmarks[j])


def test_seed_none_is_refused() -> None:
    """It would give another result at every run."""
    with pytest.raises(OptionError, match="seed must be a whole number"):
        FastSLAM1(seed=None)


def test_public_names_are_imported_at_first_use() -> None:
    assert all(getattr(fastslam, name) is not None for name in fastslam.__all__)
    assert set(fastslam.__all__) <= set(dir(fastslam))
    with pytest.raises(AttributeError, match="no attribute 'FastSLAM3'"):
        fastslam.FastSLAM3  # noqa: B018
    code = "import sys, fastslam; sys.exit('fastslam.filters.particle_filter' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
