"""Offsets between the clocks of robots that see each other."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from graphslam import Graph, Log, LogError, MotionModel, SensorModel, load, save, simulate, solve
from graphslam.log import UNIDENTIFIED
from graphslam.log.measurements import Session
from graphslam.sessions import ClockOffsets, clock_offsets, join_robots

MOTION = MotionModel(nn=0.05, no=0.001, on=0.03, oo=0.05, epsilon=1e-9)
SENSOR = SensorModel(range_rate=0.03, bearing_std=0.02)


@cache
def team(seed: int) -> dict[int, Log]:
    """Three robots with one clock, which see one another every 9 s for 150 s."""
    starts = {1: (0.0, -3.0, 0.0), 2: (0.0, 3.0, 2.0), 3: (2.0, 0.0, -2.0)}
    logs = {
        n: simulate(
            seed=10 * seed + n, steps=300, dt=0.5, clean=True, orientation=False, motion=MOTION, sensor=SENSOR, start=start,
            name=f"robot {n}",
        ).replace(motion=MOTION, sensor=SENSOR)
        for n, start in starts.items()
    }  # fmt: skip
    rng = np.random.default_rng(seed)
    seeing = {}
    for a, log in logs.items():
        steps, landmarks, sightings, classes = [log.steps], [log.landmarks], [log.sightings], [""] * len(log.steps)
        for b in logs.keys() - {a}:
            at = np.arange(6 * a + 3 * b, 300, 18)
            z = SENSOR.h(log.true_poses[at], logs[b].true_poses[at][:, :2])
            z = z + rng.standard_normal(z.shape) * np.sqrt(np.diagonal(SENSOR.Q(z), axis1=1, axis2=2))
            steps.append(at)
            landmarks.append(np.full(len(at), UNIDENTIFIED))
            sightings.append(z)
            classes += [f"robot {b}"] * len(at)
        order = np.argsort(every := np.concatenate(steps), kind="stable")
        seeing[a] = log.replace(
            steps=every[order], landmarks=np.concatenate(landmarks)[order], sightings=np.concatenate(sightings)[order],
            classes=np.array(classes)[order],
        )  # fmt: skip
    return seeing


def late(robots: dict[int, Log], offsets: dict[int, float]) -> dict[int, Log]:
    """The robots with clocks that are behind by these."""
    return {n: log.replace(start_time=log.start_time - offsets.get(n, 0.0)) for n, log in robots.items()}


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [(1, 2), pytest.param((0, 1, 2, 3), marks=pytest.mark.nightly)])
def test_offsets_are_found_to_their_standard_errors(seeds: tuple[int, ...]) -> None:
    squares = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        true = {2: rng.uniform(-3, 3), 3: rng.uniform(-3, 3)}
        found = clock_offsets(late(team(seed), true))
        assert found.seconds[1] == 0.0 and found.differ
        assert max(found.deviations.values()) < 0.1
        squares += [((found.seconds[n] - d) / found.deviations[n]) ** 2 for n, d in true.items()]
    # one in a thousand is above it
    assert sum(squares) < chi2.isf(1e-3, len(squares))


@pytest.mark.nightly
def test_an_offset_more_is_found_as_so_much_more() -> None:
    before, after = clock_offsets(team(1)), clock_offsets(late(team(1), {3: 1.75}))
    assert after.seconds[2] == pytest.approx(before.seconds[2], abs=0.02)
    assert after.seconds[3] == pytest.approx(before.seconds[3] + 1.75, abs=0.02)


def test_clocks_that_agree_stay_as_they_are() -> None:
    robots = team(2)
    found = clock_offsets(robots)
    assert not found.differ and "do not surely differ" in found.sentence
    assert found.joined(robots).log.equals(join_robots(robots).log)
    alone = clock_offsets({1: robots[1]})
    assert alone == ClockOffsets({1: 0.0}, {1: 0.0}, 0)


@pytest.mark.nightly
def test_the_joined_log_says_the_offsets(tmp_path: Path) -> None:
    robots = late(team(3), {2: -2.5})
    found = clock_offsets(robots)
    log = found.joined(robots).log
    # the clock of each robot stays its own
    assert [each.start_time for each in log.sessions] == [0.0, 2.5, 0.0]
    assert [each.clock_offset for each in log.sessions] == list(found.seconds.values())
    assert "for robot 2 (standard error" in log.notes[-1]
    save(log, tmp_path / "all.npz")
    assert load(tmp_path / "all.npz").sessions == log.sessions
    assert Session("a", 0, 1.0).clock_offset is None
    # chi-square fits with the offset, and not without
    costs = [
        solve(graph := Graph.from_log(each, edges="landmark+motion", kernel="none")).cost / graph.expected_cost
        for each in (log, join_robots(robots).log)
    ]
    assert costs[0] < 1.2 and costs[1] > 1.5


@pytest.mark.nightly
def test_offsets_of_more_than_half_a_minute_are_found() -> None:
    """On the book's course, which repeats itself after 72 s, a search up to 20 s ended at 45 - 72 s and was sure of it."""
    before, after = clock_offsets(team(1)), clock_offsets(late(team(1), {2: 45.0, 3: -60.0}))
    assert after.seconds[2] == pytest.approx(before.seconds[2] + 45, abs=0.05)
    assert after.seconds[3] == pytest.approx(before.seconds[3] - 60, abs=0.05)


def test_a_robot_that_stands_says_nothing_about_the_offset_of_its_clock() -> None:
    """A robot that stands is where it is seen at every offset: these sightings hid those that tell the offset."""
    rng, (a, b) = np.random.default_rng(3), (team(1)[1], team(1)[2])
    place = np.array([0.7, 0.4, 0.5])
    still = b.replace(
        controls=np.zeros_like(b.controls), true_poses=np.tile(place, (b.num_poses, 1)), initial_poses=None
    )
    logs = {}
    for n, log, other, number, at in (
        (1, a, still, 2, np.arange(0, 300, 3)),
        (2, still, a, 1, np.arange(20, 300, 50)),
    ):
        own = log.with_sightings(log.classes == "")
        if n == 2:
            seen = np.array(list(a.true_landmarks.values()))[:, :2]
            steps = np.repeat(np.arange(0, 300, 10), len(seen))
            z = SENSOR.h(log.true_poses[steps], np.tile(seen, (30, 1)))
            ids = np.tile(np.array(list(a.true_landmarks)), 30)
        else:
            steps, z, ids = own.steps, own.sightings, own.landmarks
        met = SENSOR.h(log.true_poses[at], other.true_poses[at][:, :2])
        z = np.concatenate([z, met])
        z[len(steps) :] += rng.standard_normal(met.shape) * np.sqrt(np.diagonal(SENSOR.Q(met), axis1=1, axis2=2))
        classes = np.array([""] * len(steps) + [f"robot {number}"] * len(at))
        every = np.concatenate([steps, at])
        order = np.argsort(every, kind="stable")
        logs[n] = log.replace(
            steps=every[order], landmarks=np.concatenate([ids, np.full(len(at), UNIDENTIFIED)])[order],
            sightings=z[order], classes=classes[order],
        )  # fmt: skip
    found = clock_offsets(late(logs, {2: 1.5}))
    assert found.seconds[2] == pytest.approx(1.5, abs=5 * found.deviations[2])
    assert found.deviations[2] < 0.5


def test_sightings_that_agree_at_no_offset_are_said() -> None:
    rng = np.random.default_rng(0)
    wrong = {}
    for n, log in team(1).items():
        sightings, met = log.sightings.copy(), log.classes != ""
        sightings[met, 1] = rng.uniform(-3, 3, np.count_nonzero(met))
        wrong[n] = log.replace(sightings=sightings)
    with pytest.raises(LogError, match="no offset up to 120 s of the clock of robot 2 makes .* agree"):
        clock_offsets(wrong)


def test_too_few_meetings_are_said() -> None:
    robots = team(1)
    kept = np.flatnonzero(np.isin(robots[1].classes, ["", "robot 2"]))[:-3]
    few = {1: robots[1].with_sightings(kept), 2: robots[2].with_sightings(robots[2].classes == "")}
    few[1] = few[1].with_sightings((few[1].classes == "") | (np.cumsum(few[1].classes == "robot 2") < 4))
    with pytest.raises(
        LogError, match="robot 2 and the others saw each other 3 times with clocks that differ by at most 120 s"
    ):
        clock_offsets(few)
    apart = late(robots, {3: 1e5})
    with pytest.raises(
        LogError,
        match=r"robot 3 and the others saw each other 0 times .* its clock shows -100000.0 to .* do not overlap",
    ):
        clock_offsets(apart)
    unused = sum(
        int(np.isin(log.classes, ["robot 3"] if n != 3 else ["robot 1", "robot 2"]).sum()) for n, log in apart.items()
    )
    assert f"{unused} sightings of other robots are from times at which these did not drive" in " ".join(
        join_robots(apart).log.notes
    )
