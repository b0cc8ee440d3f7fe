"""ISAM2, step by step: near the batch answer with default relinearisation, and at it after full relinearisation."""

import gtsam
import numpy as np
import pytest

from graphslam import Drive, Graph, GraphError, OnlineSolver, OptionError, load, sample_log_path, solve, solve_online
from graphslam.log.rows import UNIDENTIFIED
from graphslam.se2 import wrap

VARIANTS = [
    {},
    pytest.param({"weight": "tempered"}, marks=pytest.mark.nightly),
    {"weight": "marginal"},
    {"weight": "marginal", "dimensions": 2},
    {"edges": "landmark+motion"},
    {"edges": "landmark+motion", "dimensions": 2, "kernel": "huber"},
    pytest.param({"edges": "landmark+motion", "dimensions": 2, "motion_weight": 5.0}, marks=pytest.mark.nightly),
]


def largest_difference(a, b):
    off = a.poses - b.poses
    off[:, 2] = wrap(off[:, 2])
    return np.abs(off).max()


@pytest.mark.slow
@pytest.mark.parametrize("options", VARIANTS, ids=str)
@pytest.mark.parametrize("name", ["book", pytest.param("sample", marks=pytest.mark.nightly)])
def test_it_ends_at_the_batch_answer(name, options, book_log):
    log = book_log if name == "book" else load(sample_log_path())
    options = {"edges": "virtual+motion", "kernel": "none"} | options
    batch = solve(Graph.from_log(log, **options), initialize="auto")
    online = solve_online(log, backend="isam2", **options)
    # a kernel's weights change with every step, which relinearisation by a threshold does not follow
    assert largest_difference(online, batch) < (1e-2 if options["kernel"] == "none" else 5e-2)
    settled = solve_online(log, backend="isam2", **options, relinearize=True)
    assert settled.converged
    assert largest_difference(settled, batch) < 1e-6
    assert settled.cost == pytest.approx(batch.cost, rel=1e-9)
    for landmark, mark in batch.landmarks.items():
        off = settled.landmarks[landmark] - mark
        off[2:] = wrap(off[2:])
        assert np.abs(off).max() < 1e-5


def test_fed_step_by_step_it_knows_the_poses_so_far(clean_log):
    """After every step the estimate is that of the batch graph of the log so far."""
    log = clean_log
    smoother = OnlineSolver(log.initial_poses[0], backend="isam2", edges="virtual+motion", weight="marginal")
    for step in range(31):
        if step:
            smoother.move(log.controls[step - 1], log.dt[step - 1])
        now = log.steps == step
        smoother.observe(log.landmarks[now], log.sightings[now])
        assert len(smoother.poses) == step + 1
    past = log.steps <= 30
    so_far = log.replace(
        dt=log.dt[:30], controls=log.controls[:30], initial_poses=log.initial_poses[:31], true_poses=None,
        steps=log.steps[past], landmarks=log.landmarks[past], sightings=log.sightings[past],
    )  # fmt: skip
    batch = solve(Graph.from_log(so_far, weight="marginal", edges="virtual+motion", kernel="none"), initialize="given")
    off = smoother.poses - batch.poses
    off[:, 2] = wrap(off[:, 2])
    assert np.abs(off).max() < 1e-2
    assert smoother.landmarks == {}
    # it continues after everything was relinearised
    smoother.relinearize()
    for step in (31, 32, 33):
        smoother.move(log.controls[step - 1], log.dt[step - 1])
        now = log.steps == step
        assert now.any()
        smoother.observe(log.landmarks[now], log.sightings[now])
    past = log.steps <= 33
    so_far = log.replace(
        dt=log.dt[:33], controls=log.controls[:33], initial_poses=log.initial_poses[:34], true_poses=None,
        steps=log.steps[past], landmarks=log.landmarks[past], sightings=log.sightings[past],
    )  # fmt: skip
    batch = solve(Graph.from_log(so_far, weight="marginal", edges="virtual+motion", kernel="none"), initialize="given")
    smoother.relinearize()
    np.testing.assert_allclose(wrap(smoother.poses - batch.poses), 0, atol=1e-6)


def test_given_parameters(book_log):
    params = gtsam.ISAM2Params()
    params.setOptimizationParams(gtsam.ISAM2DoglegParams())
    params.relinearizeSkip = 7
    smoother = OnlineSolver(book_log.initial_poses[0], backend="isam2", params=params)
    smoother.observe([1], [[2.0, 0.1, 0.2]])
    smoother.relinearize()
    kept = smoother._backend._isam.params()
    assert kept.relinearizeSkip == 7 and "Dogleg" in str(kept)
    assert set(smoother.landmarks) == {1}


@pytest.mark.parametrize("ids", [[], [UNIDENTIFIED]])
def test_sightings_without_ids_are_refused(ids):
    smoother = OnlineSolver(backend="isam2")
    with pytest.raises(OptionError, match="needs the id|identified landmarks only"):
        smoother.observe(ids, [[2.0, 0.1]])
    assert not smoother.landmarks


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"edges": "virtual"}, GraphError, "needs motion edges"),
        ({"dimensions": 2, "edges": "virtual+motion"}, GraphError, "use weight='marginal'"),
        ({"kernel": "huber", "edges": "virtual+motion"}, OptionError, "landmark\\+motion"),
        ({"weight": "all"}, OptionError, "weight must be one of"),
        ({"frame": "world"}, GraphError, "use frame='body'"),
        ({"factorization": "lu"}, OptionError, "factorization must be one of"),
        ({"threshold": -1.0}, OptionError, "threshold must not be negative"),
        ({"skip": 0}, OptionError, "skip must be a positive number"),
        ({"params": 1}, OptionError, "params must be an ISAM2Params, not 1"),
    ],
)
def test_options_that_isam2_does_not_have(options, error, message, book_log):
    with pytest.raises(error, match=message):
        solve_online(book_log, backend="isam2", **options)


@pytest.mark.parametrize(
    ("call", "arguments", "message"),
    [
        ("observe", ([1.5], [[1, 0, 0]]), "ids must be whole numbers"),
        ("observe", ([1, 2], [[1, 0, 0]]), "each sighting needs the id"),
        ("observe", ([1], [[float("nan"), 0, 0]]), "sightings must be"),
        ("observe", ([1], [[0, 0, 0]]), "with ranges above zero"),
        ("move", (None, None, [1, 0], np.eye(3)), "motion must be 3 finite numbers"),
        ("move", (None, None, [1, 0, 0], -np.eye(3)), "covariance must be a symmetric positive definite 3 x 3 matrix"),
        ("move", (None, None, [1, 0, 0], "large"), "covariance must be 3 rows of 3 finite"),
        ("move", ([1, 0], 0.0), "dt must be a positive number"),
    ],
)
def test_an_impossible_input_changes_nothing(call, arguments, message):
    smoother = OnlineSolver((1, 2, 3), backend="isam2")
    names = ("control", "dt", "motion", "covariance") if call == "move" else ("ids", "sightings")
    with pytest.raises(OptionError, match=message):
        getattr(smoother, call)(**dict(zip(names, arguments)))
    assert smoother.step == 0
    np.testing.assert_allclose(smoother.poses, [[1, 2, 3]])
    assert smoother.landmarks == {}


@pytest.mark.parametrize(
    ("edges", "call", "message"),
    [
        ("landmark+motion", lambda solver: solver.observe([4, 5], [[2.0, 0.5], [1e-300, 0.5]]), "the range of z"),
        (
            "landmark+motion",
            lambda solver: solver._backend.relate(*((0, 2, np.array([1, 0, turn]), np.eye(3)) for turn in (0, 90.0))),
            "the heading of measured",
        ),
        ("virtual+motion", lambda solver: solver.observe([4], [[2.0, 0.5]]), "without psi"),
        ("virtual+motion", lambda solver: solver.observe([1, 1], [[2.0, 0.5, 0.5], [1e-300, 0.5, 0.5]]), "range"),
    ],
)
def test_a_refused_call_adds_nothing(edges, call, message):
    """What a refused call had prepared would enter with the next update."""
    solver = OnlineSolver(backend="isam2", edges=edges)
    if message == "range":
        solver.observe([1], [[2.0, 0.3, 0.1]])
    solver.move((1.0, 0.0), 1.0)
    before = solver._backend.columns, solver.poses.tolist()
    with pytest.raises((GraphError, OptionError), match=message):
        call(solver)
    solver.observe([], [])
    assert not solver.landmarks and (solver._backend.columns, solver.poses.tolist()) == before
    solver.move((1.0, 0.0), 1.0)
    solver.observe([1], [[1.1, 0.5, 0.5]])
    assert solver.step == 2


def test_parameters_of_isam2(book_log):
    options = {"edges": "landmark+motion"}
    usual = solve_online(book_log, backend="isam2", **options)
    cholesky = solve_online(book_log, backend="isam2", factorization="cholesky", **options)
    np.testing.assert_allclose(cholesky.poses, usual.poses, atol=1e-6)
    seldom = solve_online(book_log, backend="isam2", threshold=0.1, skip=10, **options)
    optimum = solve(Graph.from_log(book_log, **options))
    errors = [np.abs(found.poses - optimum.poses).max() for found in (usual, seldom)]
    assert errors[0] < 0.3 * errors[1]
    smoother = OnlineSolver(book_log.initial_poses[0], backend="isam2", factorization="cholesky")
    with pytest.raises(GraphError, match="factorization='qr'"):
        smoother.move(motion=[1, 0, 0], covariance=np.diag([1e-20, 1.0, 1e20]))


@pytest.mark.slow
def test_an_ordinary_drive_needs_no_option():
    log, _ = Drive(seed=22, duration=40).simulate()
    with pytest.raises(GraphError, match="Indeterminate"):
        solve_online(log, backend="isam2", factorization="cholesky")
    assert solve_online(log, backend="isam2").cost == pytest.approx(solve(Graph.from_log(log)).cost, rel=1e-2)
