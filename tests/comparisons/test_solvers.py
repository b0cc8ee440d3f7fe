from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from comparisons.studies import solvers
from comparisons.studies.solvers import SkippedVariant, compare_solutions, compare_solvers, variants
from graphslam import Graph, GraphError, Log, OptionError, Solution, sample_log_path, simulate, solve

PROMISED = {"name", "pose_difference", "cost_difference", "iterations", "gtsam_iterations", "seconds", "gtsam_seconds"}


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate(seed=2, steps=12, dt=6.0, clean=True)


def solution(poses: Any, cost: float = 1.0, **changes: Any) -> Solution:
    poses = np.array(poses, dtype=float)
    values = {"poses": poses, "estimated": np.ones(len(poses), bool), "cost": cost, "iterations": 3, "seconds": 0.5}
    return cast(Solution, SimpleNamespace(**(values | {"converged": True} | changes)))


def test_every_variant_has_a_name_of_its_own(log: Log) -> None:
    names = [v.name for v in variants(log)]
    assert len(names) == len(set(names))
    assert "virtual+motion body pairs 3-D lambda=10" in names
    assert "virtual world tempered 2-D" in names
    assert all("2-D" in v.name for v in variants(log.without_orientation()))


@pytest.mark.nightly
def test_solvers_agree_on_a_real_log(log: Log) -> None:
    names: list[str] = []
    outcome = compare_solvers(log, motion_weights=(1.0, 10.0), jobs=0, progress=lambda entry: names.append(entry.name))
    assert outcome.problems == ()
    assert names == [v.name for v in variants(log)]
    assert {v.name for v in outcome.variants} | {s.name for s in outcome.skipped} == set(names)
    # a circle on which poses share single landmarks: two dimensions need motion edges
    assert all("virtual " in s.name for s in outcome.skipped)
    assert outcome.skipped
    payload = json.loads(json.dumps(outcome.to_json(), allow_nan=False))
    assert all(entry.keys() >= PROMISED for entry in payload["variants"])
    assert all(entry["agree"] for entry in payload["variants"])
    assert set(payload["skipped"][0]) == {"name", "reason"}


@pytest.mark.nightly
def test_jobs_change_nothing_but_the_time(log: Log) -> None:
    alone, together = (compare_solvers(log, motion_weights=(1.0,), jobs=jobs) for jobs in (0, 2))
    assert [v.name for v in together.variants] == [v.name for v in alone.variants]
    assert [v.pose_difference for v in together.variants] == pytest.approx(
        [v.pose_difference for v in alone.variants], abs=1e-9
    )
    assert together.skipped == alone.skipped
    with pytest.raises(OptionError, match="jobs"):
        compare_solvers(log, jobs=-1)


def test_landmark_nodes_agree_although_dead_reckoning_misleads() -> None:
    outcome = compare_solvers(
        sample_log_path(), dimensions=2, motion_weights=(1.0,), edges=("landmark+motion",), jobs=0
    )
    assert [v.name for v in outcome.variants] == [f"landmark+motion {f} 2-D lambda=1" for f in ("world", "body")]
    assert outcome.problems == ()


def test_headings_are_compared_around_the_circle() -> None:
    a, b = [[0, 0, 0], [1, 2, np.pi - 1e-8]], [[0, 0, 0], [1, 2, -np.pi + 1e-8]]
    assert compare_solutions("v", solution(a), solution(b)).pose_difference == pytest.approx(2e-8, rel=1e-6)


def test_poses_outside_the_graph_are_not_compared() -> None:
    a = solution([[0, 0, 0], [5, 5, 5]], estimated=np.array([True, False]))
    assert compare_solutions("v", a, solution([[0, 0, 0], [1, 1, 1]])).pose_difference == 0


@pytest.mark.parametrize(
    ("ours", "theirs", "problem"),
    [
        (solution([[0, 0, 0]]), solution([[5e-7, 0, 0]]), None),
        (solution([[0, 0, 0]]), solution([[0, 2e-6, 0]]), "poses differ by 2.0e-06"),
        (solution([[0, 0, 0]]), solution([[0, 0, 2e-6]]), "poses differ"),
        (solution([[0, 0, 0]]), solution([[0, np.nan, 0]]), "poses differ by nan"),
        (solution([[0, 0, 0]], 100.0), solution([[0, 0, 0]], 100.0 + 9e-8), None),
        (solution([[0, 0, 0]], 100.0), solution([[0, 0, 0]], 100.0 + 2e-7), "costs differ by 2.0e-09"),
        (solution([[0, 0, 0]], 1e-22), solution([[0, 0, 0]], 3e-20), None),
        (solution([[0, 0, 0]], converged=False), solution([[0, 0, 0]]), "graphslam did not converge"),
        (solution([[0, 0, 0]], converged=False), solution([[0, 0, 0]], converged=False), "graphslam and gtsam"),
    ],
)
def test_what_counts_as_agreement(ours: Solution, theirs: Solution, problem: str | None) -> None:
    found = compare_solutions("v", ours, theirs).problem
    assert found is None if problem is None else problem in str(found)


def test_one_solver_giving_up_is_a_difference(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    def gives_up(*_: object, **__: object) -> Solution:
        raise GraphError("gtsam gave up: indeterminate")

    monkeypatch.setattr(solvers, "solve_with_gtsam", gives_up)
    outcome = compare_solvers(log, jobs=0)
    assert outcome.variants
    assert all("gave up" in problem for problem in outcome.problems)
    assert len(outcome.problems) == len(outcome.variants)
    assert outcome.to_json()["variants"][0]["pose_difference"] is None

    monkeypatch.setattr(solvers, "solve", gives_up)
    with pytest.raises(GraphError, match="no variant can be solved"):
        compare_solvers(log, jobs=0)


@pytest.mark.slow
def test_a_wrong_solver_is_found_out(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    def sloppy(graph: Graph, **_: object) -> Solution:
        return solve(graph, tolerance=1e-3)

    monkeypatch.setattr(solvers, "solve", sloppy)
    assert compare_solvers(log, motion_weights=(1.0,), jobs=0).problems


def test_nothing_to_solve(log: Log) -> None:
    with pytest.raises(GraphError, match="no sightings"):
        compare_solvers(log.replace(steps=[], landmarks=[], sightings=np.empty((0, 3))), jobs=0)


@pytest.mark.slow
def test_a_log_without_controls_has_virtual_edges_only() -> None:
    wide = simulate(seed=2, steps=12, dt=6.0, clean=True, field_of_view=6.2, max_range=9.0)
    outcome = compare_solvers(wide.replace(dt=None, controls=None), jobs=0)
    assert outcome.problems == ()
    assert all(v.name.startswith("virtual ") for v in outcome.variants)
    assert SkippedVariant in {type(entry) for entry in outcome.skipped}


@pytest.mark.nightly
def test_the_time_limit_ends_a_variant(log: Log) -> None:
    # this takes both solvers some seconds
    long = simulate(seed=2, steps=600, clean=True).without_orientation()
    with pytest.raises(GraphError, match="stopped at the time limit of 0.005 s"):
        compare_solvers(long, edges=["landmark+motion"], motion_weights=[1.0], jobs=1, time_limit=5e-3)
    with pytest.raises(OptionError, match="time_limit needs local processes"):
        compare_solvers(log, jobs=0, time_limit=1.0)
