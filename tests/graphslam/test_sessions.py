"""Several drives of one place as one log."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from graphslam import (
    AbsolutePositions,
    Graph,
    GraphError,
    Log,
    LogError,
    MotionModel,
    OptionError,
    PoseRelations,
    SensorModel,
    estimate_robot,
    join_logs,
    load,
    sample_log_path,
    simulate,
    solve,
    solve_with_gtsam,
)
from graphslam.association import score
from graphslam.association.map_states import session_states
from graphslam.log import UNIDENTIFIED
from graphslam.log.geometry import on_plane_of
from graphslam.log.measurements import PartialSightings
from graphslam.metrics import ate
from graphslam.se2 import between
from graphslam.sessions import with_common_noise
from graphslam.simulation.worlds import simulate_single_numbers

QUIET = MotionModel(nn=0.05, no=0.001, on=0.03, oo=0.05)
SENSOR = SensorModel(range_rate=0.02, bearing_std=0.01)


@cache
def drive() -> Log:
    return simulate(seed=11, steps=90, clean=True, motion=QUIET)


def cut(log: Log, count: int) -> list[Log]:
    """Parts without the motions between them, each in a frame of its own."""
    ends = np.linspace(0, log.num_poses, count + 1).astype(int)
    parts = [log.at_steps(np.arange(*pair)) for pair in zip(ends[:-1], ends[1:])]
    return [part.replace(initial_poses=between(part.initial_poses[0], part.initial_poses)) for part in parts]


def graph(log: Log) -> Graph:
    return Graph.from_log(log, edges="landmark+motion")


@pytest.mark.parametrize("seed", [34, 36, 40])
def test_the_noise_of_joined_drives_is_that_of_each(seed: int) -> None:
    """`estimate_robot` goes by time: with a second between the drives it had 2 to 5 times the noise of the sensor."""
    places = np.random.default_rng(seed).uniform(-6, 6, (30, 2))
    logs = [
        simulate(
            seed=seed + k, start=(0.0, 3.0 * k - 2.0, k), steps=150, dt=0.5, clean=True, orientation=False, max_range=3.5,
            motion=QUIET, sensor=SENSOR, landmarks=places,
        )
        for k in range(2)
    ]  # fmt: skip
    found = estimate_robot(join_logs(logs).log)
    assert found.inflation == 1.0
    assert found.sensor.range_rate == pytest.approx(SENSOR.range_rate, rel=0.2)


@pytest.mark.parametrize("count", [2, 3, 5])
def test_a_drive_that_was_cut_is_joined_again(count: int) -> None:
    log = drive()
    assert log.true_poses is not None
    joined = join_logs(cut(log, count))
    assert joined.log.true_poses is not None and joined.log.num_poses == log.num_poses
    found = solve(graph(joined.log))
    assert found.converged
    assert ate(joined.log.true_poses, found.poses) < 1.1 * ate(log.true_poses, solve(graph(log)).poses)
    assert solve_with_gtsam(graph(joined.log)).cost == pytest.approx(found.cost, rel=1e-8)
    assert found.certificate.status.startswith("global")
    parts = joined.split(found.poses)
    assert [len(part) for part in parts] == [len(part.initial_poses) for part in cut(log, count)]
    assert np.array_equal(np.concatenate(parts), found.poses)
    with pytest.raises(OptionError, match="split takes an array of 91 rows, such as solution.poses, not <Solution"):
        joined.split(found)


def test_where_the_motion_between_is_known_the_solution_is_the_uncut_one() -> None:
    log = drive()
    joined = join_logs(cut(log, 2))
    k = joined.starts[1] - 1
    motions, covariances = log.motions()
    tie = PoseRelations(first=[k], second=[k + 1], motions=motions[k : k + 1], covariances=covariances[k : k + 1])
    whole = solve(graph(log), tolerance=1e-10)
    found = solve(graph(joined.log.replace(relations=tie)), tolerance=1e-10)
    # both from the first pose; the motion that says nothing still has a weight of 1e-6
    assert np.abs(between(found.poses[0], found.poses) - between(whole.poses[0], whole.poses)).max() < 1e-4


def test_a_drive_whose_first_poses_are_left_out_starts_later_by_its_own_clock() -> None:
    first, second = (part.replace(start_time=start) for part, start in zip(cut(drive(), 2), (100.0, 7000.0)))
    joined = join_logs([first, second], placed=True).log
    kept = np.arange(3, joined.num_poses, 4)
    sessions = joined.at_steps(kept).sessions
    assert first.times is not None and second.times is not None
    own = first.times[3], second.times[kept[sessions[1].start] - first.num_poses]
    assert [each.start_time for each in sessions] == pytest.approx(own)
    assert own[1] > 7000.0
    # drives of which no pose is left are none
    (last,) = joined.at_steps(np.arange(first.num_poses + 2, joined.num_poses)).sessions
    assert (last.start, last.start_time) == (0, pytest.approx(second.times[2]))


def test_ranges_alone_put_no_log_where_it_belongs() -> None:
    log = simulate_single_numbers("range", seed=5, poses=60)
    parts = [log.at_steps(np.arange(30)), log.at_steps(np.arange(30, 60))]
    with pytest.raises(GraphError, match=r"no landmark that both have seen with range and bearing, .* placed=True"):
        join_logs(parts)
    joined = join_logs(parts, placed=True).log
    assert joined.partial_sightings is not None and log.partial_sightings is not None
    assert joined.partial_sightings.equals(log.partial_sightings)


@pytest.mark.parametrize(("number", "near"), [("range", 0.45), ("bearing", 0.4001)])
def test_ranges_alone_are_not_given_as_from_another_place_of_the_sensor(number: str, near: float) -> None:
    """They stayed as they were, and J was 2.7 times what it should be."""
    log = simulate_single_numbers(number, seed=5, poses=60).replace(motion=QUIET)
    sensors = (SensorModel.constant(0.1, 0.02, offset=(ahead, 0.0)) for ahead in (0.4, near, -0.4))
    first, close, far = (log.replace(sensor=sensor) for sensor in sensors)
    with pytest.raises(LogError, match=r"ranges or bearings alone, .*: its own is 0\.4 m from the mean"):
        with_common_noise([first, far])
    # places that differ by less than the noise of a range are as good as one
    assert len(with_common_noise([first, close])) == 2


def test_positions_of_joined_logs_have_one_datum() -> None:
    """The first fix of each log was the origin of its own plane, and poses were off by as much as these are apart."""
    data = np.array([[48.1234567, 11.7654321, 510.0], [48.1301, 11.7711, 512.0]])
    logs = []
    for part, datum in zip(cut(drive(), 2), data):
        assert part.true_poses is not None
        places = on_plane_of(datum, part.true_poses[::5, :2], data[0])
        assert np.allclose(on_plane_of(data[0], places, datum), part.true_poses[::5, :2], atol=1e-3)
        positions = AbsolutePositions(
            steps=np.arange(0, part.num_poses, 5), places=places, covariances=0.01 * np.eye(2), datums=datum
        )
        logs.append(part.replace(positions=positions))
    joined = join_logs(logs).log
    errors = solve(graph(joined)).poses - joined.true_poses
    assert np.hypot(errors[:, 0], errors[:, 1]).max() < 0.3
    assert joined.positions is not None and np.array_equal(np.unique(joined.positions.datums, axis=0), data[:1])
    assert sum("48.1234567" in note for note in joined.notes) == 1


def test_measurements_of_a_later_log_keep_their_poses() -> None:
    first, second = cut(drive(), 2)
    tie = PoseRelations(first=[0], second=[4], motions=[[1.0, 0.0, 0.1]], covariances=np.eye(3))
    place = AbsolutePositions(steps=[3], places=[[1.0, 2.0]], covariances=np.eye(2))
    log = join_logs([first.replace(relations=tie), second.replace(relations=tie, positions=place)]).log
    n = first.num_poses
    assert log.relations is not None and log.positions is not None
    assert log.relations.first.tolist() == [0, n]
    assert log.relations.second.tolist() == [4, n + 4]
    assert log.positions.steps.tolist() == [n + 3]


def bare(log: Log) -> Log:
    return log.replace(landmarks=np.full(len(log.steps), UNIDENTIFIED))


def scattered(seed: int) -> np.ndarray:
    """Landmarks in 16 m x 16 m, at least 0.8 m apart."""
    places = np.random.default_rng(seed).uniform(-8, 8, (40, 2))
    away = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
    return places[~np.any(np.triu(away < 0.8, 1), axis=0)]


@cache
def visits() -> list[Log]:
    """Three drives of one place from other starts, each in a frame of its own."""
    places = scattered(3)
    starts = ((0.0, 0.0, 0.0), (2.0, 1.0, 2.0), (-1.0, 2.0, -1.0))
    logs = [
        simulate(
            seed=20 + k, steps=60, clean=True, start=start, landmarks=places, orientation=False, motion=QUIET, sensor=SENSOR,
            max_range=6.0, name=f"visit {k}",
        )
        for k, start in enumerate(starts)
    ]  # fmt: skip
    models = {"motion": QUIET, "sensor": SENSOR}
    return [log.replace(initial_poses=between(log.initial_poses[0], log.initial_poses), **models) for log in logs]


@pytest.mark.nightly
def test_logs_without_ids_are_joined_by_their_maps() -> None:
    with_ids = join_logs(visits()).log
    joined = join_logs([bare(log) for log in visits()])
    assert joined.starts == join_logs(visits()).starts
    log = joined.log
    assert log.true_poses is not None and log.identified
    found, best = solve(graph(log)), solve(graph(with_ids))
    assert ate(log.true_poses, found.poses) < 1.1 * ate(log.true_poses, best.poses)
    # the ids are those of the truth, but for their numbers: sightings that were kept keep their order
    kept = np.flatnonzero([bool(np.any(np.all(z == log.sightings, axis=1))) for z in with_ids.sightings])
    agreement = score(log.landmarks, with_ids.landmarks[kept])
    assert agreement.precision is not None and agreement.precision > 0.995
    assert agreement.missed == 0 and agreement.doubled == 0
    assert len(kept) > 0.97 * len(with_ids.steps)
    states = [each.sentence for each in session_states(log)]
    assert all("agree" in sentence and "moved" not in sentence for sentence in states)


@pytest.mark.slow
def test_landmarks_that_are_found_in_all_logs_are_none_of_the_beacons() -> None:
    beacons = np.array([[9.0, 9.0], [-9.0, 9.0], [0.0, -12.0]])

    def with_beacons(log: Log) -> Log:
        steps = np.arange(0, log.num_poses, 3)
        seen = np.arange(len(steps)) % 3
        ranges = np.hypot(*(log.true_poses[steps, :2] - beacons[seen]).T)
        alone = PartialSightings(steps=steps, landmarks=seen + 7, ranges=ranges, bearings=np.full(len(steps), np.nan))
        nameless = np.full(len(log.steps), UNIDENTIFIED)
        return log.without_orientation().replace(landmarks=nameless, partial_sightings=alone)

    log = load(sample_log_path())
    halves = [log.at_steps(np.arange(80)), log.at_steps(np.arange(80, log.num_poses))]
    joined = join_logs([with_beacons(half) for half in halves]).log
    assert np.array_equal(joined.landmark_ids, np.arange(10, 23))
    solution = solve(Graph.from_log(joined, kernel="none"))
    # 1.7 where the beacons have ids of other landmarks
    assert solution.cost < solution.graph.degrees_of_freedom


@pytest.mark.slow
def test_ranges_alone_follow_their_landmarks_where_logs_are_joined_without_ids() -> None:
    """They kept their ids: those of other landmarks after joining (J 6.4 times what it should be), or of none."""
    logs = []
    for k, log in enumerate(visits()[:2]):
        # the ids of the second log are those of other landmarks in the first one
        ids = np.unique(log.landmarks)
        log = log.replace(landmarks=np.roll(ids, k)[np.searchsorted(ids, log.landmarks)])
        alone = np.random.default_rng(k).random(len(log.steps)) < 0.5
        ranges = log.sightings[alone, 0]
        single = PartialSightings(
            steps=log.steps[alone], landmarks=log.landmarks[alone], ranges=ranges, bearings=np.full(len(ranges), np.nan)
        )
        logs.append(log.with_sightings(~alone, partial_sightings=single))
    joined = join_logs([*logs, bare(visits()[0])]).log
    assert joined.partial_sightings is not None and joined.true_poses is not None
    shared = np.isin(joined.partial_sightings.landmarks, joined.landmark_ids)
    assert np.mean(shared) > 0.95 and len(np.union1d(joined.partial_sightings.landmarks, joined.landmark_ids)) < 36
    solved, whole = graph(joined), solve(graph(joined))
    assert whole.cost < 1.2 * solved.expected_cost and ate(joined.true_poses, whole.poses) < 0.05


def test_a_log_without_ids_of_another_place_is_refused() -> None:
    other = simulate(
        seed=5, steps=20, clean=True, landmarks=scattered(8), orientation=False, motion=QUIET, max_range=6.0, name="other",
        sensor=SENSOR,
    ).replace(motion=QUIET, sensor=SENSOR)  # fmt: skip
    with pytest.raises(GraphError, match="other"):
        join_logs([bare(visits()[0]), bare(other)])


def test_the_graph_of_several_logs_has_their_steps_and_the_means_of_their_noise() -> None:
    parts = cut(drive(), 2)
    parts[1] = parts[1].replace(motion=MotionModel(nn=0.07, no=0.001, on=0.03, oo=0.05))
    built = Graph.from_logs(parts, edges="landmark+motion")
    assert built.log is not None and built.log.motion is not None
    assert [each.start for each in built.log.drives] == [0, parts[0].num_poses]
    # the first log brings no model, and counts with the book's
    assert built.log.motion.nn == pytest.approx(np.sqrt((0.19**2 + 0.07**2) / 2))
    assert not any("of its own ones" in note for note in built.log.notes)


def test_a_log_whose_sensor_is_much_better_than_the_mean_is_said() -> None:
    first, second = cut(drive(), 2)
    sloppy = SensorModel(range_rate=0.16, bearing_std=0.08, orientation_std=8 * SENSOR.orientation_std)
    models = {"motion": QUIET, "sensor": SENSOR}
    built = Graph.from_logs([first.replace(**models), second.replace(**models | {"sensor": sloppy})])
    assert built.log is not None
    (note,) = (note for note in built.log.notes if "of its own ones" in note)
    assert note.startswith(first.name) and f"single sightings of {second.name} have 8.0 times the noise" in note


@pytest.mark.parametrize(
    ("own", "inflations", "said"), [(3.0, (2.0, 2.0), True), (3.0, (1.0, 9.0), False), (3.0, (), False)]
)
def test_the_noise_of_single_sightings_decides_whose_sensor_is_better(own, inflations, said) -> None:
    """Models contain a factor for correlated errors, which differs between drives of one sensor."""
    noisy = {name: own * getattr(SENSOR, name) for name in SENSOR.NOISE}
    logs = [
        each.replace(motion=QUIET, sensor=sensor)
        for each, sensor in zip(cut(drive(), 2), (SENSOR, replace(SENSOR, **noisy)))
    ]
    notes = [note for log in with_common_noise(logs, inflations) for note in log.notes if "of its own ones" in note]
    assert len(notes) == said


def test_one_log_is_itself() -> None:
    joined = join_logs([drive()])
    assert joined.log == drive()
    assert joined.starts == (0, drive().num_poses)
    with pytest.raises(OptionError, match="take its attribute log"):
        Graph.from_log(joined)  # type: ignore[arg-type]


def test_classes_of_joined_logs_are_words_where_one_has_words_and_unknown_where_one_has_none() -> None:
    first, second, third = cut(drive(), 3)
    first = first.replace(classes=np.where(first.landmarks % 2, "blue", ""))
    second = second.replace(classes=np.where(second.landmarks % 2, second.landmarks, UNIDENTIFIED))
    joined = join_logs([first, second, third]).log
    odd, of_third = joined.landmarks % 2 == 1, joined.steps >= joined.drives[2].start
    known = np.where(joined.steps < joined.drives[1].start, "blue", joined.landmarks.astype(str))
    assert joined.classes.tolist() == np.where(odd & ~of_third, known, "").tolist()
    assert np.array_equal(joined.classified, odd & ~of_third)
    assert join_logs([second, third]).log.classes.dtype.kind == "i" and join_logs([third, third]).log.classes is None


def test_logs_that_cannot_be_joined() -> None:
    first, second = cut(drive(), 2)
    with pytest.raises(GraphError, match="share no landmark"):
        join_logs([first, second.replace(landmarks=second.landmarks + 100)])
    other = second.replace(name="log", landmarks=second.landmarks + 100)
    with pytest.raises(GraphError, match=r"^log \(2\) and log \(1\) share no landmark"):
        join_logs([first.replace(name="log"), other])
    with pytest.raises(LogError, match="differ in motion"):
        join_logs([first, second.replace(motion=MotionModel(nn=0.3))])
    with pytest.raises(LogError, match="sightings of 2 numbers"):
        join_logs([first, second.without_orientation()])
    with pytest.raises(LogError, match="has no controls"):
        join_logs([first.replace(controls=None, dt=None, control_starts=None, recorded_dt=None), second])
    for wrong in (first, [first, "log"], []):
        with pytest.raises(OptionError, match="join_logs"):
            join_logs(wrong)  # type: ignore[arg-type]
