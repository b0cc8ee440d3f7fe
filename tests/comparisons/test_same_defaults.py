"""A log solved through Python's defaults and through the command line's: the same problem, and the same numbers."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import comparisons
from comparisons.cli import app
from comparisons.options import GraphOptions
from comparisons.options.declaration import options_of
from fastslam import associate
from graphslam import Graph, load, sample_log_path, save, simulate, solve, solve_online
from graphslam.edges.robust import KERNELS
from graphslam.factors import arguments, landmark
from graphslam.graph.defaults import suitable_edges, suitable_kernel
from graphslam.identification.known import known_robot
from graphslam.models import EDGES
from graphslam.solvers import solve as solve_module


def tables(folder, log):
    """The log as CSV tables, which count as real data."""
    folder.mkdir()
    t = np.concatenate([[0.0], np.cumsum(log.dt)])
    u = np.concatenate([log.controls, log.controls[-1:]])
    np.savetxt(folder / "odometry.csv", np.column_stack([t, u]), delimiter=",", header="t,nu,omega", comments="")
    rows = np.column_stack([log.times[log.steps], log.landmarks, log.sightings])
    names = "t,id,range,bearing,psi"[: 18 + 4 * (rows.shape[1] == 5)]
    np.savetxt(folder / "sightings.csv", rows, delimiter=",", header=names, comments="")
    return folder


def written(folder, log):
    save(log, folder / "log.npz")
    return folder / "log.npz"


SHORT = simulate(seed=2, steps=24)
REAL = SHORT.replace(simulated=False)
STILL = load(sample_log_path()).replace(controls=None, dt=None, simulated=False)

KINDS = {
    "the sample": (lambda _: sample_log_path(), "virtual+motion", "none"),
    "simulated, psi": (lambda folder: written(folder, SHORT), "virtual+motion", "none"),
    "simulated, no psi": (lambda folder: written(folder, SHORT.without_orientation()), "landmark+motion", "none"),
    "real, psi": (lambda folder: written(folder, REAL), "virtual+motion", "cauchy"),
    "real, no psi": (lambda folder: written(folder, REAL.without_orientation()), "landmark+motion", "cauchy"),
    "no controls": (lambda folder: written(folder, STILL), "virtual", "cauchy"),
    "several controls a pose": (
        lambda folder: written(folder, REAL.without_orientation().at_steps(np.arange(0, 25, 2))),
        "landmark+motion", "cauchy",
    ),
    "tables, psi": (lambda folder: tables(folder / "drive", load(sample_log_path())), "landmark+motion", "cauchy"),
    "tables, no psi": (
        lambda folder: tables(folder / "drive", load(sample_log_path()).without_orientation()), "landmark+motion", "cauchy",
    ),
}  # fmt: skip


def of_the_command_line(path, folder, estimator, *options):
    file = folder / "run.json"
    call = ["run", path, "--estimators", estimator, "--out", folder / "out", "--figures", "", "--json", file, *options]
    result = CliRunner().invoke(app, list(map(str, call)))
    assert result.exit_code == 0, result.output
    (row,) = json.loads(file.read_text())["estimators"]
    return row


def check_same(solution, row):
    assert row["cost"] == solution.cost
    assert np.array_equal(row["poses"], solution.poses)
    assert set(row["landmarks"]) == {str(j) for j in solution.landmarks}
    for j, place in solution.landmarks.items():
        assert np.array_equal(row["landmarks"][str(j)], place)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_python_and_the_command_line_solve_the_same_problem(kind, tmp_path):
    make, edges, kernel = KINDS[kind]
    path = make(tmp_path)
    log = load(path)
    # nothing is known of the noise of tables, which is estimated
    known, _ = known_robot(log)
    assert (suitable_edges(known), suitable_kernel(known)) == (edges, kernel)
    solution = solve(Graph.from_log(log))
    check_same(solution, of_the_command_line(path, tmp_path, "graph"))
    # and what is chosen is what the names say
    named = solve(Graph.from_log(known, edges=edges, kernel=kernel, weight="pairs", frame="body"))
    assert np.array_equal(named.poses, solution.poses)


@pytest.mark.parametrize(
    ("folder", "robot"),
    [("lnpr/log2_for_book.txt", None), pytest.param("mrclam6", 1, marks=pytest.mark.nightly), ("simulated_535", None)],
)
def test_logs_of_others(folder, robot, shared_data, tmp_path):
    path = shared_data(folder)
    solution = solve(Graph.from_log(load(path, robot=robot)))
    options = [] if robot is None else ["--robot", robot]
    check_same(solution, of_the_command_line(path, tmp_path, "graph", *options))


@pytest.mark.parametrize("dimensions", [2, 3])
def test_isam2_chooses_alike(dimensions, tmp_path):
    log = REAL if dimensions == 3 else REAL.without_orientation()
    path = written(tmp_path, log)
    solution = solve_online(log, backend="isam2")
    # it takes a kernel with landmark nodes only
    assert len(solution.graph.landmark_ids) and solution.graph.verdict[0].name == "cauchy"
    check_same(solution, of_the_command_line(path, tmp_path, "isam2"))


def test_sightings_without_ids(tmp_path):
    """The ids are found first, by the same front ends."""
    log = SHORT.replace(landmarks=np.full(len(SHORT.steps), -1))
    found = associate(log)
    result = comparisons.run(log, estimators=["graph"])["graph"]
    solution = solve(Graph.from_log(found.log, motion=found.motion))
    assert np.array_equal(result.poses, solution.poses) and result.cost == solution.cost


def test_no_kernel_can_be_named():
    assert Graph.from_log(REAL, kernel="none").verdict[0] is None
    assert Graph.from_log(REAL).verdict[0].name == "cauchy"
    assert Graph.from_log(REAL, dimensions=2).landmark_dimension == 2
    assert len(Graph.from_log(REAL, dimensions=2).landmark_ids)


def test_pairs_say_that_covariances_are_too_small():
    """Landmark j seen K times, each time at the same place: pairs weigh its sightings K/2 times too much."""
    ids, counts = np.unique(SHORT.landmarks, return_counts=True)
    (note,) = (note for note in solve(Graph.from_log(SHORT)).notes if "too small" in note)
    assert f"the {counts.max()} sightings of landmark {ids[np.argmax(counts)]} up to {counts.max() / 2:g} times" in note
    for options in ({"weight": "marginal"}, {"weight": "tempered"}, {"edges": "landmark+motion"}):
        assert not any("too small" in note for note in Graph.from_log(SHORT, **options).notes)


def test_choices_are_those_of_the_library():
    """Declared once: the tuples of the options are the objects that `Graph.from_log`, the factors and `solve` check."""
    choices = {name: each.choices for name, each in options_of(GraphOptions).items()}
    assert choices["edges"] is EDGES
    assert choices["frame"] is arguments.FRAMES
    assert choices["weight"] is landmark.WEIGHTS
    assert choices["initialize"] is solve_module.INITIALIZE
    assert choices["kernel"] == ("none", *KERNELS, "gnc")
