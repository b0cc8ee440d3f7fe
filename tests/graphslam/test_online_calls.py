"""Calls of the online solver: what is refused and changes nothing, copies, backends and threads."""

import io
import pickle
import runpy
import threading
from copy import copy, deepcopy
from dataclasses import replace
from inspect import signature
from pathlib import Path

import numpy as np
import pytest

from fastslam import FastSLAM1
from graphslam import (
    Graph,
    GraphError,
    MotionModel,
    OnlineSolver,
    OptionError,
    SensorModel,
    simulate,
    solve,
    solve_online,
)
from graphslam.log.rows import UNIDENTIFIED
from graphslam.online import replay
from graphslam.online.own import OwnBackend
from graphslam.se2 import between, compose


def step(solver, *control, ids=(), sightings=(), **motion):
    """A motion, and what is seen after it."""
    solver.move(*control, **motion)
    solver.observe(ids, sightings)


ONE = [[1.0, 0.0]]
BAD_CALLS = [
    ("move", {}, OptionError, "move takes a control"),
    ("move", {"control": (1, 0), "dt": 1, "motion": (1, 0, 0), "covariance": np.eye(3)}, OptionError, "move takes"),
    ("observe", {"ids": [1], "sightings": ONE, "pose": 9}, GraphError, "unknown pose 9"),
    ("relate", {"first": 7, "second": 8, "motion": (1, 0, 0), "covariance": np.eye(3)}, GraphError, "poses 7 and 8"),
    ("move", {"control": (1.0, 0.0), "dt": -1.0}, OptionError, "dt must be a positive number"),
    ("move", {"control": (1.0, 0.0), "time": 0.5}, OptionError, "time runs backwards"),
    ("observe", {"ids": [1], "sightings": ONE, "time": 0.5}, OptionError, "time runs backwards"),
    ("move", {"motion": (1, 0, 0), "covariance": -np.eye(3)}, OptionError, "positive definite"),
    ("move", {"motion": (1, 0, 0)}, OptionError, "covariance must be 3 rows of 3 finite"),
    ("move", {"motion": (1, np.nan, 0), "covariance": np.eye(3)}, OptionError, "motion must be 3 finite"),
    ("move", {"control": (1.0, 0.0), "time": "noon"}, OptionError, "time must be a finite number"),
    ("move", {"control": (1.0, 0.0), "time": 10**400}, OptionError, "time must be a finite number"),
    ("observe", {"ids": [1, [2]], "sightings": ONE}, OptionError, "ids must be whole"),
    ("move", {"control": (10**400, 0.0), "dt": 1.0}, OptionError, "control must be 2 finite"),
    ("move", {"control": (1, 0), "dt": 1.0, "covariance": np.eye(3)}, OptionError, "belongs to a measured motion"),
    ("move", {"motion": (1, 0, 0), "covariance": np.eye(3), "dt": 1.0}, OptionError, "dt belongs to a control"),
    ("locate", {"position": "a", "covariance": np.eye(2)}, OptionError, "position must be 2 or 3 finite numbers"),
    ("locate", {"position": [[1], [2, 3]], "covariance": np.eye(2)}, OptionError, "position must be 2 or 3 finite"),
    ("locate", {"position": (1, 2), "covariance": np.eye(3)}, OptionError, "covariance must be 2 rows of 2 finite"),
    ("observe", {"ids": [1], "sightings": ONE, "pose": 0.5}, OptionError, "pose must be a whole number"),
    ("relate", {"first": 0.7, "second": 1, "motion": (1, 0, 0), "covariance": np.eye(3)}, OptionError, "whole number"),
    ("relate", {"first": 0, "second": 1, "motion": (1, 0), "covariance": np.eye(3)}, OptionError, "motion must be"),
    ("observe", {"ids": (), "sightings": ONE}, OptionError, "needs the id"),
    ("observe", {"ids": [UNIDENTIFIED], "sightings": ONE}, OptionError, "identified landmarks only"),
    ("observe", {"ids": [1, 2], "sightings": [[1.0, 0.0], [1.0]]}, OptionError, "range, bearing"),
    ("observe", {"ids": [3], "sightings": [[0.0, 0.0]]}, OptionError, "ranges above zero"),
    ("observe", {"ids": [3], "sightings": [[1.0, 0.0, 0.0]]}, OptionError, "2 numbers each"),
    ("observe", {"ids": [0.5], "sightings": ONE}, OptionError, "whole numbers"),
    ("observe", {"ids": [np.inf], "sightings": ONE}, OptionError, "whole numbers"),
    ("observe", {"ids": [3], "sightings": [[1.0, 7.0]]}, OptionError, "beyond 2 pi: is it in degrees"),
    ("observe", {"ids": [3], "sightings": [[np.nan, -7.0]]}, OptionError, "beyond 2 pi: is it in degrees"),
    ("relate", {"first": 0, "second": 1, "motion": (1, 0, 90.0), "covariance": np.eye(3)}, OptionError, "beyond 8 pi"),
    ("move", {"motion": (1, 0, 90.0), "covariance": np.eye(3)}, OptionError, "beyond 8 pi"),
    (
        "move",
        {"control": (1.0, 45.0), "dt": 1.0},
        OptionError,
        "the turn rate of control is 45 rad/s, beyond 12 pi: is it in degrees",
    ),
    ("relate", {"first": 1, "second": 1, "motion": (1, 0, 0), "covariance": np.eye(3)}, GraphError, "pose 1 to itself"),
]


def everything(solver):
    """All numbers of a solver, bit by bit."""
    kept = {
        key: value for key, value in (vars(solver) | vars(solver._backend)).items() if key not in ("system", "_backend")
    }
    return solver._backend.system.__getstate__(), repr(kept)


@pytest.mark.parametrize(("call", "arguments", "error", "message"), BAD_CALLS)
def test_a_bad_call_changes_nothing(call, arguments, error, message):
    solver = OnlineSolver((1.0, 2.0, 0.5))
    solver.move((1.0, 0.1), dt=1.0, time=1.0)
    solver.observe([1, 2], [[2.0, 0.3], [1.5, -0.4]])
    before = everything(solver)
    with pytest.raises(error, match=message):
        getattr(solver, call)(**arguments)
    assert everything(solver) == before
    solver.move((1.0, 0.0), time=2.0)
    solver.observe([2], [[1.0, -0.8]], time=2.0)
    assert solver.step == 2


def test_a_gyroscope_at_its_full_scale_ends_no_drive():
    solver = OnlineSolver()
    solver.move((0.1, np.deg2rad(2000)), dt=0.01)
    assert solver.pose[2] == pytest.approx(np.deg2rad(20))


@pytest.mark.parametrize("backend", ["own", "isam2"])
def test_ids_of_a_row_of_numbers_are_ids(backend):
    rows, found = np.array([[7.0, 2.0, 0.3], [-2.0, 1.5, -0.4]]), []
    for ids in (rows[:, 0], [7, -2]):
        solver = OnlineSolver(backend=backend)
        solver.observe(ids, rows[:, 1:])
        found.append(solver.landmarks)
    assert list(found[0]) == list(found[1])
    for id in (7, -2):
        np.testing.assert_array_equal(found[0][id], found[1][id])


def test_what_isam2_cannot_do_is_said():
    for attempt in (copy, deepcopy, pickle.dumps):
        with pytest.raises(TypeError, match="ISAM2 can neither be copied nor pickled; the backend 'own' can"):
            attempt(OnlineSolver(backend="isam2"))


@pytest.mark.parametrize("backend", ["own", "isam2"])
def test_only_logs_and_graphs_are_replayed(backend):
    with pytest.raises(OptionError, match="log must be a Log, not 'drive.npz'; graphslam.load"):
        next(iter(replay("drive.npz", backend=backend)))


@pytest.mark.parametrize("backend", ["own", "isam2"])
def test_a_log_that_begins_after_several_turns_is_replayed(backend: str) -> None:
    """`solve` takes it, too: an initial heading of 30 rad is no mistake in degrees."""
    log, turns = simulate(seed=0, clean=True, steps=5), [0.0, 0.0, 10 * np.pi]
    found = solve_online(log.replace(initial_poses=log.initial_poses + turns), backend=backend)
    np.testing.assert_allclose(found.poses, solve_online(log, backend=backend).poses, atol=1e-9)


def test_dt_is_the_time_since_the_newest_pose():
    solver, seen = OnlineSolver(), ([1], [[2.0, 0.3]])
    solver.observe(*seen, time=0.0)
    solver.move((1.0, 0.0), time=1.0)
    # sightings from the newest pose at its time, then from an older one
    solver.observe([1], [[1.1, 0.5]], time=1.0)
    solver.observe(*seen, pose=0, time=1.5)
    solver.move((1.0, 0.0), time=2.0)
    solver.move((1.0, 0.0), 1.0)
    solver.move((1.0, 0.0), time=4.0)
    other = OnlineSolver()
    other.observe(*seen)
    other.move((1.0, 0.0), 1.0)
    other.observe([1], [[1.1, 0.5]], pose=1)
    other.observe(*seen, pose=0)
    for _ in range(3):
        other.move((1.0, 0.0), 1.0)
    np.testing.assert_array_equal(solver.poses, other.poses)
    with pytest.raises(OptionError, match="time runs backwards"):
        solver.move((1.0, 0.0), time=4.0)
    with pytest.raises(OptionError, match="time runs backwards"):
        solver.observe(*seen, pose=2, time=3.9)
    solver.move(motion=(1.0, 0.0, 0.0), covariance=np.eye(3))
    with pytest.raises(OptionError, match="a control needs dt, or the times of this pose and of the one before"):
        solver.move((1.0, 0.0), time=6.0)


@pytest.mark.parametrize("backend", ["own", "isam2"])
def test_both_backends_take_the_same_calls(backend):
    """Motions, sightings from the newest and from an earlier pose, a relation to a new pose, and a loop closure."""
    rng, z = np.random.default_rng(0), np.diag([0.05, 0.05, 0.02]) ** 2
    sensor = SensorModel.constant(0.05, 0.02)
    truth, marks = [np.zeros(3)], {4: (2.0, 1.0), -7: (1.0, -2.0)}
    solver = OnlineSolver(sensor=sensor, backend=backend)

    def seen(pose):
        return [sensor.h(pose, np.array(m)) + rng.normal(0, (0.05, 0.02)) for m in marks.values()]

    solver.observe(list(marks), seen(truth[0]))
    for k in range(1, 9):
        move = np.array([0.5, 0.0, 0.3])
        truth.append(compose(truth[-1], move))
        if k % 3:
            solver.move(motion=move, covariance=z)
        else:
            solver.relate(k, k - 1, between(truth[k], truth[k - 1]), z)
        solver.observe(list(marks), seen(truth[k]))
    solver.move((0.5, 0.3), 1.0)
    solver.observe([4], seen(truth[2])[:1], pose=2)
    solver.relate(0, 8, between(truth[0], truth[8]), z)
    solver.relinearize()
    assert solver.converged and solver.step == 9
    assert list(solver.landmarks) == [-7, 4]
    assert repr(solver) == f"<OnlineSolver ({backend}): 10 poses, 2 landmarks>"
    found = [solver.poses, np.array(list(solver.landmarks.values())), solver.cost]
    found.append(solver.covariance(poses=[3, 9], landmarks=[4, -7], joint=True))
    blocks, points = solver.covariance(poses=[3, 9], landmarks=[4, -7])
    np.testing.assert_array_equal(blocks[1], found[3][3:6, 3:6])
    np.testing.assert_array_equal(points[1], found[3][8:, 8:])
    np.testing.assert_allclose(solver.covariance(), blocks[1], rtol=1e-9)
    np.testing.assert_allclose(solver.covariance(landmarks=4), points[0], rtol=1e-9)
    found[1:1] = [solver.pose]
    if not EARLIER:
        EARLIER.extend(found)
    for a, b in zip(found, EARLIER, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-6)


#: what the first backend found
EARLIER: list = []


@pytest.mark.parametrize(("backend", "option"), [("isam2", "lag"), ("own", "threshold"), ("own", "lags")])
def test_options_of_the_other_backend_are_refused(backend, option):
    with pytest.raises(OptionError, match=f"the backend {backend} has no option '{option}'"):
        OnlineSolver(backend=backend, **{option: 3})
    with pytest.raises(OptionError, match="backend must be one of own, isam2"):
        OnlineSolver(backend="gtsam")


@pytest.mark.parametrize(
    "call",
    [
        lambda solver: solver.move(motion=(1e9, 0.0, 0.0), covariance=1e-30 * np.eye(3)),
        lambda solver: solver.observe([3, 1], [[1e-12, 0.0], [1.0, 0.5]]),
    ],
)
def test_a_call_that_leaves_a_node_undetermined_is_taken_back(call):
    solver = OnlineSolver()
    for sighting in ([2.0, 0.3], [1.6, 0.4]):
        step(solver, (1.0, 0.1), 1.0, ids=[1, 2], sightings=[sighting, [1.5, -0.4]])
    other, before = deepcopy(solver), everything(solver)
    with pytest.raises(GraphError, match="undetermined"):
        call(solver)
    assert everything(solver) == before
    for one in (solver, other):
        step(one, (1.0, 0.0), 1.0, ids=[2, 3], sightings=[[1.0, -0.8], [2.0, 0.0]])
    np.testing.assert_array_equal(solver.poses, other.poses)
    np.testing.assert_array_equal(solver.covariance(landmarks=3), other.covariance(landmarks=3))


def test_one_sighting_needs_no_list():
    one, other = OnlineSolver(), OnlineSolver()
    one.observe(7, [3.0, 0.3])
    other.observe([7], [[3.0, 0.3]])
    np.testing.assert_array_equal(one.landmarks[7], other.landmarks[7])
    with pytest.raises(OptionError, match="there are 1 sightings"):
        one.observe([7, 8], [3.0, 0.3])


def test_refused_first_sightings_leave_no_kernel():
    solver = OnlineSolver(kernel="cauchy")
    before = everything(solver)
    with pytest.raises(GraphError, match="undetermined"):
        solver.observe([1, 2], [[1e-12, 0.5, 0.5]] * 2)
    assert everything(solver) == before


def test_a_copy_goes_its_own_way():
    solver = OnlineSolver()
    for sighting in ([2.0, 0.3], [1.6, 0.4]):
        step(solver, (1.0, 0.1), 1.0, ids=[1, 2], sightings=[sighting, [1.5, -0.4]])
    before = everything(solver)
    branch = copy(solver)
    step(branch, (1.0, 0.0), 1.0, ids=[2, 3], sightings=[[1.0, -0.8], [2.0, 0.0]])
    assert everything(solver) == before
    assert (solver.step, branch.step) == (2, 3)
    step(solver, (1.0, 0.0), 1.0, ids=[2, 3], sightings=[[1.0, -0.8], [2.0, 0.0]])
    np.testing.assert_array_equal(solver.poses, branch.poses)
    np.testing.assert_array_equal(solver.covariance(landmarks=[3]), branch.covariance(landmarks=[3]))


def test_a_pickled_solver_goes_on():
    solver = OnlineSolver(lag=3, kernel="cauchy")
    for k in range(6):
        step(solver, (1.0, 0.1), 1.0, ids=[1, 2], sightings=[[2.0, 0.3 + 0.1 * k], [1.5, -0.4]])
    other = pickle.loads(pickle.dumps(solver))
    assert everything(other) == everything(solver)
    for one in (solver, other):
        step(one, (1.0, 0.0), 1.0, ids=[2, 3], sightings=[[1.0, -0.8], [2.0, 0.0]])
    # the elimination tree is made anew: both end where J is within 1e-9 of its minimum, whose curvature is above 10 / m²
    np.testing.assert_allclose(solver.poses, other.poses, atol=1e-6)
    np.testing.assert_allclose(solver.cost, other.cost, rtol=1e-9)
    with pytest.raises(ValueError, match="no saved online solver"):
        type(solver._backend.system).__new__(type(solver._backend.system)).__setstate__(b"vmslam")


def test_the_first_pose_may_see_landmarks():
    solver = OnlineSolver()
    assert repr(solver) == "<OnlineSolver (own): 1 pose, 0 landmarks>"
    assert repr(OnlineSolver(map={3: (1.0, 2.0)})) == "<OnlineSolver (own): 1 pose, 0 landmarks>"
    solver.observe([4], [[2.0, 0.5]])
    np.testing.assert_allclose(solver.landmarks[4], [2 * np.cos(0.5), 2 * np.sin(0.5)], atol=1e-9)
    assert solver.covariance().shape == (3, 3)
    assert replace(SensorModel(), bearing_std=0.1) != solver.sensor


def test_a_robot_that_sees_nothing_at_first():
    log = simulate(seed=2, steps=20, orientation=False)
    later = log.steps > 5
    log = replace(log, steps=log.steps[later], landmarks=log.landmarks[later], sightings=log.sightings[later])
    *_, last = replay(log)
    assert last.step == log.num_poses - 1
    batch = solve(Graph.from_log(log, edges="landmark+motion", kernel="none"), initialize="auto")
    assert last.cost <= batch.cost * (1 + 1e-6) + 1e-9
    # nothing seen from a known pose
    before = last.poses
    last.observe([], [], pose=3)
    np.testing.assert_array_equal(last.poses, before)


def test_final_poses_are_refused():
    solver = OnlineSolver(lag=2)
    for _ in range(5):
        step(solver, (1.0, 0.1), 1.0, ids=[1], sightings=[[2.0, 0.3]])
    before = everything(solver)
    for call in (
        lambda: solver.observe([1], [[1.0, 0.0]], pose=1),
        lambda: solver.relate(2, 4, (1, 0, 0), np.eye(3)),
        lambda: solver.relate(2, 6, (1, 0, 0), np.eye(3)),
        lambda: solver.covariance(0),
    ):
        with pytest.raises(GraphError, match="final: with lag=2, the poses from 3 on can be used. Choose a longer lag"):
            call()
    assert everything(solver) == before
    for lag in (0, -1, 1.5, True):
        with pytest.raises(OptionError, match="lag must"):
            OnlineSolver(lag=lag)


@pytest.mark.parametrize("landmarks", [[[1]], 3.0])
def test_a_covariance_of_what_is_no_id(landmarks):
    with pytest.raises(OptionError, match="landmarks must be an id, or a list of ids"):
        OnlineSolver().covariance(landmarks=landmarks)


@pytest.mark.parametrize("backend", ["own", "isam2"])
def test_the_covariances_of_nothing_are_none(backend):
    solver = OnlineSolver(backend=backend)
    assert solver.covariance(landmarks=[]).shape[0] == solver.covariance(poses=[]).shape[0] == 0
    assert solver.covariance(poses=[], landmarks=[], joint=True).shape == (0, 0)
    blocks, none = solver.covariance(poses=[0], landmarks=[])
    assert blocks.shape == (1, 3, 3) and none.shape == (0, 2, 2)


@pytest.mark.parametrize("name", ["motion", "sensor"])
def test_models_are_checked(name):
    with pytest.raises(OptionError, match=f"{name} must be a .*Model, not 3"):
        OnlineSolver(**{name: 3})


def test_the_example_goes_on_after_lines_that_are_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = [
        "u 1 0 1",
        "z 7 2 0.3",
        "u 1 0.1 1",
        "z 7 1.2 0.5",
        "u 1 0.1 -1",
        "q 3",
        "z a b",
        "",
        "u 1 0.1 1",
        "z 7 1 0.9",
        "u 1 0.1",
        "z 8 1 0.9",
    ]
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join(lines)))
    runpy.run_path(str(Path(__file__).parents[2] / "examples" / "online.py"), run_name="__main__")
    printed = capsys.readouterr()
    poses = [list(map(float, line.split())) for line in printed.out.splitlines()[:-1]]
    assert np.shape(poses) == (3, 6)
    assert poses[2][0] > poses[1][0] > poses[0][0] > 0
    assert printed.out.splitlines()[-1].startswith("landmark 7 ")
    refused = printed.err.splitlines()
    assert [line.split(":")[0] for line in refused] == ["line 6", "line 7", "line 5", "line 11", "line 11"]
    assert "dt must be a positive number, not -1.0" in refused[2]
    # what is seen after a motion that cannot be read has no pose
    assert "the motion before it" in refused[4]


@pytest.mark.slow
def test_another_thread_reads_while_the_solver_steps() -> None:
    """A display reads poses while sightings arrive: the interpreter crashed where steps let other threads run."""
    solver, done, reads = OnlineSolver(), threading.Event(), []

    def read() -> None:
        while not done.is_set():
            reads.append(len(solver.poses))

    reader = threading.Thread(target=read)
    reader.start()
    rng = np.random.default_rng(0)
    try:
        for _ in range(100):
            ids = rng.choice(60, 4, replace=False)
            seen = np.column_stack([rng.uniform(1, 8, 4), rng.uniform(-3, 3, 4)])
            step(solver, (0.5, 0.1), 1.0, ids=ids, sightings=seen)
    finally:
        done.set()
        reader.join()
    assert solver.step == 100 and reads


def test_the_engine_refuses_nodes_that_do_not_exist() -> None:
    system = OnlineSolver()._backend.system
    with pytest.raises(IndexError, match="no node 10000000"):
        system.values([10**7])


@pytest.mark.parametrize("method", ["move", "observe", "locate", "covariance"])
def test_particle_filters_have_the_same_arguments_but_for_past_poses_and_time(method):
    """As `docs/online.md` says."""
    own, theirs = (list(signature(getattr(kind, method)).parameters) for kind in (OnlineSolver, FastSLAM1))
    assert theirs == [name for name in own if name not in ("pose", "time")]


def test_a_log_that_cannot_be_replayed_names_the_step(monkeypatch: pytest.MonkeyPatch) -> None:
    update = OwnBackend.update

    def fails(self, relations, *arguments, **keywords):
        if relations and relations[0][1] == 3:
            raise GraphError("the call leaves a pose or landmark undetermined, so that nothing was added")
        update(self, relations, *arguments, **keywords)

    monkeypatch.setattr(OwnBackend, "update", fails)
    with pytest.raises(GraphError, match="step 3 of 10: the call leaves a pose or landmark undetermined"):
        list(replay(simulate(seed=1, steps=10)))


def test_an_empty_map_is_refused() -> None:
    """As `first_fix` does: the robot would never be found."""
    with pytest.raises(GraphError, match="the map has no landmarks, so that the robot cannot be found in the map"):
        OnlineSolver(map={})


def test_a_refused_call_names_contradictions_before_it() -> None:
    """A position 1 km off bends exact odometry so far that squares have no solution; the kernel takes it."""
    for kernel in ("none", "cauchy"):
        solver = OnlineSolver(motion=MotionModel(epsilon=1e-10), kernel=kernel)

        def drive(solver: OnlineSolver = solver) -> None:
            for k in range(200):
                if k:
                    solver.move((1.0, 0.1 * np.sin(k / 10)), 0.1)
                if k % 5 == 0:
                    wrong = 1000.0 if k == 100 else 0.0
                    solver.locate([0.1 * k + wrong, wrong], np.eye(2))

        if kernel == "cauchy":
            drive()
        else:
            with pytest.raises(GraphError, match=r"had not converged before: is a measurement wrong\?"):
                drive()
