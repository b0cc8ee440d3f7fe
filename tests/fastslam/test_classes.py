"""Classes of sightings in FastSLAM's own association: closed forms, and landmarks too close for positions alone."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from fastslam import FastSLAM1, FastSLAM2
from fastslam.options import FilterOptions, forecast
from graphslam import Log, LogError, MotionModel, OptionError, SensorModel
from graphslam.association import score
from graphslam.association.problem import Classes
from graphslam.log import UNIDENTIFIED
from graphslam.se2 import Array

SENSOR = SensorModel.constant(0.15, 0.03)
KINDS = [(FastSLAM1, "exact"), (FastSLAM2, "exact"), (FastSLAM2, "linearised")]


def standing(shown: list[str], places: Array) -> Log:
    """A robot that hardly moves and sees one landmark in each step, or one of several."""
    controls = np.tile([0.01, 0.0], (len(shown) - 1, 1))
    return Log(
        dt=1.0, controls=controls, steps=np.arange(len(shown)), landmarks=np.full(len(shown), UNIDENTIFIED),
        sightings=SENSOR.h(np.zeros(3), places), classes=shown, sensor=SENSOR, motion=MotionModel.constant(0.05, 0.02),
    )  # fmt: skip


def weighed(log: Log, kind: type[FastSLAM1], **options: object) -> list[Array]:
    """The log likelihoods (N,) of the sightings of each step."""
    slam = kind(log, seed=3, threads=1, ess_threshold=0.0, **options)
    steps, weigh = [], slam._weigh

    def kept(*arguments: object) -> bool:
        weighed = weigh(*arguments)
        steps.append(slam._engine.log_likelihoods())
        return weighed

    slam._weigh = kept
    slam.run()
    return steps


@pytest.mark.parametrize(("kind", "weight"), KINDS)
def test_the_weight_has_the_ratio_of_the_graphs_association(kind: type[FastSLAM1], weight: str) -> None:
    log = standing(["red", "red", "", "blue", "green", "red"], np.tile([[4.0, 1.0]], (6, 1)))
    options = {"particles": 7, "proposal_weight": weight, "association": "maximum-likelihood"}
    pairs = zip(weighed(log, kind, class_confusion=0.1, **options), weighed(log.replace(classes=None), kind, **options))
    classes = Classes.of(log, 0.1)
    for k, (with_classes, without) in enumerate(pairs):
        before = classes.sums(np.zeros(k, dtype=int), np.arange(k), 1)[0]
        ratio = classes.together(classes.of_sightings(np.array([k]))[0], before) if k else 0.0
        np.testing.assert_allclose(with_classes, without + ratio, atol=1e-9)
    assert classes.together(classes.of_sightings(np.array([2]))[0], before) == pytest.approx(0.0, abs=1e-12)


@cache
def two_rows(wrong: float) -> Log:
    """A drive in circles within two rings of a dozen cones each, 0.2 m apart, 1.3 standard deviations of the range.

    The outer ones are yellow and the inner ones blue. A third of the sightings are missing, so that often one of two
    neighbours is seen alone; a share of the classes is ``wrong``.
    """
    rng = np.random.default_rng(1)
    controls = np.tile([0.5, 0.25], (80, 1))
    driven = controls + rng.normal(size=controls.shape) * [0.02, 0.01]
    poses = MotionModel().dead_reckoning(np.zeros(3), driven, 1.0)
    angles = np.arange(12) * np.pi / 6
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    cones = [0.0, 2.0] + np.vstack([5.0 * directions, 5.2 * directions])
    steps, ids = np.divmod(np.arange(len(poses) * len(cones)), len(cones))
    z = SENSOR.h(poses[steps], cones[ids])
    seen = (z[:, 0] < 6) & (np.abs(z[:, 1]) < 1.2) & (rng.random(len(z)) > 0.3)
    steps, ids, z = steps[seen], ids[seen], z[seen] + rng.normal(size=(seen.sum(), 2)) * [0.15, 0.03]
    yellow = (ids >= 12) != (rng.random(len(ids)) < wrong)
    return Log(
        dt=1.0, controls=controls, steps=steps, landmarks=ids, sightings=z, classes=np.where(yellow, "yellow", "blue"),
        motion=MotionModel.constant(0.02, 0.01, epsilon=1e-6), sensor=SENSOR, true_poses=poses,
        true_landmarks=dict(enumerate(cones)),
    )  # fmt: skip


@pytest.mark.parametrize("kind", [FastSLAM1, FastSLAM2])
def test_two_rows_too_close_for_positions_alone(kind: type[FastSLAM1]) -> None:
    for wrong, least in ((0.0, 0.99), (0.1, 0.92)):
        log = two_rows(wrong)
        hidden = log.replace(landmarks=np.full(len(log.steps), UNIDENTIFIED))
        options = {"particles": 100, "seed": 0, "association": "maximum-likelihood"}
        result = kind(hidden, class_confusion=max(wrong, 0.05), **options).run()
        found = score(result.association, log.landmarks)
        assert (len(result.landmarks), found.found, found.doubled, found.invented) == (24, 24, 0, 0)
        assert found.precision > least
        for j, true in found.matches.items():
            # one class is given to each landmark
            shown = log.classes[result.association == j]
            assert np.mean(shown == ("yellow" if true >= 12 else "blue")) > 0.5
        without = kind(hidden.replace(classes=None), **options).run()
        assert score(without.association, log.landmarks).precision < 0.85


def test_what_is_handed_in_is_of_unknown_class() -> None:
    log = standing(["red", "blue"], np.array([[4.0, 1.0], [4.0, -1.0]]))
    states = []
    for each in (log, log.replace(classes=None)):
        slam = FastSLAM2(each, particles=20, seed=0)
        slam.observe(None, [[4.0, 0.1]])
        slam.move((0.1, 0.0), 1.0)
        slam.observe(None, [[3.9, 0.1], [3.0, 1.0]])
        states.append(slam.state)
    np.testing.assert_allclose(states[0].log_weights, states[1].log_weights, atol=1e-9)


def test_impossible_classes_and_confusions() -> None:
    log = two_rows(0.0)
    with pytest.raises(OptionError, match=r"^class_confusion must lie between 0 and 1, not 1\.5"):
        FastSLAM1(log, class_confusion=1.5)
    many = replace(log, landmarks=np.full(len(log.steps), UNIDENTIFIED), classes=np.arange(len(log.steps)))
    with pytest.raises(
        LogError, match=f"{len(log.steps)} different classes, and at most 100 can be used: are they ids"
    ):
        FastSLAM1(many).run()
    # with ids they are not used
    assert FastSLAM1(replace(log, classes=many.classes), particles=10).run().association is None
    unknown = FilterOptions(association="maximum-likelihood")
    grown = forecast(log, unknown, maps=True).least / forecast(log.replace(classes=None), unknown, maps=True).least
    assert grown > 1
