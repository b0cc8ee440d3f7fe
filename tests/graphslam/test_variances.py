"""Variances fitted to numbers by maximum likelihood: closed forms, and a grid of the profile likelihood."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from graphslam import OptionError, calibrate, simulate
from graphslam.calibration.variances import fit_variances, standard_errors


def test_one_variance_has_a_closed_form() -> None:
    e = np.random.default_rng(1).normal(0, 0.3, (400, 2))
    C = np.broadcast_to(np.eye(2), (400, 2, 2))
    fit = fit_variances(e, {"a": C}, degrees=np.inf)
    assert fit.variances["a"] == pytest.approx(np.mean(e**2), rel=1e-5)
    # the Gaussian's Fisher information of a variance, n / (2 theta²)
    assert fit.errors["a"] == pytest.approx(fit.variances["a"] * np.sqrt(2 / 800), rel=1e-9)
    assert standard_errors(np.eye(2)[None], np.eye(2)[None, None], np.zeros(1), np.inf)[0] != 0
    assert fit.log_likelihood == pytest.approx(-400 * (np.log(2 * np.pi * np.mean(e**2)) + 1), rel=1e-9)


def test_degrees_of_freedom_are_found() -> None:
    rng = np.random.default_rng(3)
    e = rng.standard_t(4, (4000, 1)) * 0.2
    fit = fit_variances(e, {"a": np.ones((4000, 1, 1))})
    # three standard errors of nu at 4 and 4000 samples are about 1
    assert 3.2 < fit.degrees < 5
    assert fit.variances["a"] == pytest.approx(0.04, rel=0.1)


def test_a_bound_is_where_the_profile_likelihood_has_dropped() -> None:
    """Variances a in one group of numbers and a + b in another: the best a for each b, by a fine grid."""
    rng = np.random.default_rng(2)
    one, other = rng.normal(size=150), rng.normal(size=50) * 1.05**0.5
    e = np.concatenate([one, other])[:, None]
    parts = {"a": np.ones((200, 1, 1)), "b": np.repeat([0.0, 1.0], [150, 50])[:, None, None]}
    fit = fit_variances(e, parts, degrees=np.inf)
    assert np.isnan(fit.errors["b"]) and fit.variances["b"] < fit.bound("b")
    a = np.linspace(0.5, 2, 3001)

    def profile(b: float) -> float:
        first = 150 * np.log(a) + np.sum(one**2) / a
        return float(np.max(-0.5 * (first + 50 * np.log(a + b) + np.sum(other**2) / (a + b))))

    best = max(map(profile, np.linspace(0, 2, 2001)))
    assert best - profile(fit.bound("b")) == pytest.approx(1.645**2 / 2, abs=0.1)


def test_the_end_does_not_depend_on_where_the_search_begins() -> None:
    """In logarithms the gradient of a variance near zero vanishes: a start there must not end there."""
    rng = np.random.default_rng(4)
    parts = {
        "a": np.ones((300, 1, 1)),
        "b": rng.uniform(0, 1, (300, 1, 1)) ** 2,
        "c": np.linspace(0, 2, 300)[:, None, None],
    }
    e = rng.normal(size=(300, 1)) * np.sqrt(0.2 + parts["b"][:, :, 0] + 0.5 * parts["c"][:, :, 0])
    fit = fit_variances(e, parts, degrees=np.inf)
    for zero in ({"a"}, {"b"}, {"c"}, {"a", "b"}, {"b", "c"}):
        start = replace(fit, variances={name: 0.0 if name in zero else 2.0 for name in parts})
        again = fit_variances(e, parts, degrees=np.inf, start=start)
        assert again.log_likelihood == pytest.approx(fit.log_likelihood, abs=0.01)


@pytest.mark.parametrize("late", [1.0, pytest.param(-1.0, marks=pytest.mark.nightly)])
def test_a_late_truth_is_said_and_by_how_much(late):
    """True poses that belong to another time have one error for all sightings of a scan."""
    log = simulate(seed=3, steps=400, clean=True, orientation=False, landmarks=20, dt=1.0, speed=0.5, turn_rate=0.3)
    assert not any("in common" in note for note in calibrate(log).notes)
    true = log.true_poses
    moved = np.vstack([true[:1], true[:-1]]) if late > 0 else np.vstack([true[1:], true[-1:]])
    (note,) = (note for note in calibrate(log.replace(true_poses=moved)).notes if "in common" in note)
    signs, when = ("-", "late") if late > 0 else ("", "early"), re.search(r"truth is ([\d.]+) s (\w+)", note)
    assert when is not None and when[2] == signs[1] and float(when[1]) == pytest.approx(1.0, abs=0.1)
    assert f"clocks='truth={signs[0]}{when[1]}'" in note


def test_inexact_true_poses_are_said():
    log = simulate(seed=3, steps=400, clean=True, orientation=False, landmarks=20)
    off = np.random.default_rng(0).normal(0.0, [0.0, 0.0, 0.15], (log.num_poses, 3))
    (note,) = (note for note in calibrate(log.replace(true_poses=log.true_poses + off)).notes if "in common" in note)
    assert "may be inexact or shifted" in note


def test_no_degrees_of_freedom_are_refused() -> None:
    with pytest.raises(OptionError, match="degrees must be above zero, not 0"):
        calibrate(simulate(seed=1), degrees=0)
