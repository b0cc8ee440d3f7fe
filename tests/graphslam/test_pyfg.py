"""PyFactorGraph's files: several robots, their odometry, landmarks, ranges and priors, as one log."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from graphslam import FormatError, Graph, Log, OptionError, load, simulate, solve
from graphslam.io.formats import load_robots
from graphslam.io.pyfg import controls_of
from graphslam.metrics import ate
from graphslam.models import MotionModel
from graphslam.se2 import between, compose, wrap

#: variances of odometry (x, y, theta), of x and y of landmarks, and of ranges
MOVED, SEEN, RANGED = (1e-4, 4e-4, 2.5e-5), 9e-4, 0.04
LETTERS = "AC"


def robots() -> dict[str, Log]:
    starts = ((0.0, -3.0, 0.0), (0.0, 3.0, 2.0))
    return {
        letter: simulate(seed=k, steps=60, clean=True, start=start, orientation=False)
        for k, (letter, start) in enumerate(zip(LETTERS, starts))
    }


def text_of(logs: dict[str, Log], *, noise: float = 0.0, ranges: bool = False, extra: str = "") -> str:
    """Logs as a file, their sightings as places or ranges, with noise; ``extra`` lines come last."""
    rng = np.random.default_rng(1)
    lines = ["# a comment"]
    for letter, log in logs.items():
        assert log.times is not None and log.true_poses is not None and log.true_landmarks is not None
        poses = list(zip(log.times, log.true_poses))
        lines += [f"VERTEX_SE2 {t!r} {letter}{k} {x!r} {y!r} {a!r}" for k, (t, (x, y, a)) in enumerate(poses)]
        moved = between(log.true_poses[:-1], log.true_poses[1:])
        moved += noise * rng.normal(0, np.sqrt(MOVED), moved.shape)
        a, b, c = MOVED
        lines += [
            f"EDGE_SE2 {log.times[k + 1]} {letter}{k} {letter}{k + 1} {x!r} {y!r} {th!r} {a} 0 0 {b} 0 {c}"
            for k, (x, y, th) in enumerate(moved)
        ]
        for step, j in zip(log.steps, log.landmarks):
            place = np.append(log.true_landmarks[j][:2], 0.0)
            x, y = between(log.true_poses[step], place)[:2] + noise * rng.normal(0, SEEN**0.5, 2)
            if ranges:
                far = np.hypot(x, y) + noise * rng.normal(0, RANGED**0.5)
                lines.append(f"EDGE_RANGE {log.times[step]} L{j} {letter}{step} {far!r} {RANGED}")
            else:
                lines.append(f"EDGE_SE2_XY {log.times[step]} {letter}{step} L{j} {x!r} {y!r} {SEEN} 0 {SEEN}")
    landmarks = next(iter(logs.values())).true_landmarks or {}
    lines += [f"VERTEX_XY L{j} {m[0]!r} {m[1]!r}" for j, m in landmarks.items()]
    return re.sub(r"np\.float64\(([^)]*)\)", r"\1", "\n".join([*lines, extra]) + "\n")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    extra = """EDGE_SE2 3 A3 C4 1.5 0.25 0.5 0.01 0 0 0.02 0 0.03
EDGE_SE2_XY 5 C5 A5 2.0 1.0 0.01 0.001 0.02
EDGE_RANGE 6 A6 C6 3.0 0.01
VERTEX_SE2:PRIOR 0 A0 0.1 -3.0 0.0 0.01 0 0 0.01 0 0.001
VERTEX_SE2:PRIOR 9 C9 1.0 2.0 0.5 0.04 0 0 0.04 0 0.002"""
    (tmp_path / "two.pyfg").write_text(text_of(robots(), noise=1.0, extra=extra))
    return tmp_path / "two.pyfg"


def test_two_robots_are_one_log(file: Path) -> None:
    logs, log = robots(), load(file)
    assert [each.name for each in log.sessions] == ["robot A", "robot C"]
    truth = np.concatenate([each.true_poses for each in logs.values()])
    assert log.true_poses is not None and np.allclose(log.true_poses, truth)
    # the first prior is where the first robot starts; the other robot starts at its vertex
    second = log.sessions[1].start
    assert log.initial_poses[0].tolist() == [0.1, -3.0, 0.0]
    assert np.allclose(log.initial_poses[second], truth[second])
    rows = [line.split() for line in file.read_text().splitlines() if line.startswith("EDGE_SE2 ")]
    odometry = np.array([row[4:7] for row in rows if row[2][0] == row[3][0]], dtype=float)
    moved, covariances = log.motions()
    inside = np.delete(np.arange(log.num_poses - 1), second - 1)
    off = moved[inside] - odometry
    off[:, 2] = wrap(off[:, 2])
    assert np.abs(off).max() < 1e-9
    assert np.allclose(covariances[inside], np.diag(MOVED), atol=1e-8)
    assert log.true_landmarks is not None
    assert log.sensor is not None and log.sensor.range_std == pytest.approx(SEEN**0.5, rel=1e-6)
    assert "differ from it by up to a factor" in " ".join(log.notes)


def test_edges_between_robots_and_priors(file: Path) -> None:
    log = load(file)
    k = log.sessions[1].start
    relations, positions = log.relations, log.positions
    assert relations is not None and positions is not None
    assert relations.first.tolist() == [3, k + 5] and relations.second.tolist() == [k + 4, 5]
    assert np.allclose(relations.motions, [[1.5, 0.25, 0.5], [2.0, 1.0, 0.0]])
    assert relations.covariances[1, :2, :2].tolist() == [[0.01, 0.001], [0.001, 0.02]]
    # the heading of the robot that is seen is not measured
    assert relations.covariances[1, 2, 2] == 1e6
    assert positions.steps.tolist() == [0, k + 9] and positions.places[1].tolist() == [1.0, 2.0, 0.5]
    assert "1 range between two poses, such as of two robots: not used" in log.notes
    alone = load(file, robot=3)
    assert alone.name == "robot C" and alone.relations is None and alone.num_poses == 61
    assert load_robots(file).keys() == {1, 3}
    with pytest.raises(OptionError, match="its robots are 1, 3"):
        load(file, robot=2)


@pytest.mark.parametrize("ranges", [False, True])
def test_the_solution_of_all_robots_is_better_than_dead_reckoning(tmp_path: Path, ranges: bool) -> None:
    path = tmp_path / "noisy.pyfg"
    path.write_text(text_of(robots(), noise=1.0, ranges=ranges))
    log = load(path)
    solution = solve(Graph.from_log(log, kernel="none"))
    assert log.true_poses is not None
    before = ate(log.true_poses, log.dead_reckoning())
    assert ate(log.true_poses, solution.poses) < (0.8 if ranges else 0.5) * before
    if ranges:
        assert log.sensor is not None and log.sensor.range_std == pytest.approx(0.2) and log.sensor.range_rate == 0.0
        assert log.partial_sightings is not None and solution.graph is not None
        # chi-square, within four of its standard deviations
        dof = solution.graph.expected_cost
        assert solution.cost == pytest.approx(dof, abs=4 * (2 * dof) ** 0.5)


def test_without_noise_the_truth_is_the_optimum(tmp_path: Path) -> None:
    path = tmp_path / "exact.pyfg"
    path.write_text(text_of(robots()))
    log = load(path)
    assert "ground truth" in " ".join(log.notes) and log.true_poses is None
    # vertices that are where exact odometry leads are no truth, but the robots start there
    solution = solve(Graph.from_log(log, kernel="none"))
    truth = np.concatenate([each.true_poses for each in robots().values()])
    # the motion between two robots that says nothing still has a weight of 1e-6
    assert np.abs(solution.poses[:, :2] - truth[:, :2]).max() < 1e-3


def test_a_pause_an_arc_and_a_turn_lead_along_any_motion() -> None:
    rng = np.random.default_rng(0)
    motions = np.concatenate(
        [rng.uniform(-2, 2, (200, 3)), [[0, 0, 0], [0, 0, 2.0], [0, 1.0, 0], [-1.0, 0, 0], [1.0, 0, np.pi - 1e-9]]]
    )
    dt = rng.uniform(0.1, 2.0, len(motions))
    controls, lasting = controls_of(motions, dt)
    assert np.allclose(lasting.reshape(-1, 3).sum(axis=1), dt)
    ends = MotionModel().dead_reckoning(np.zeros(3), controls, lasting)[::3]
    expected = [np.zeros(3)]
    for motion in motions:
        expected.append(compose(expected[-1], motion))
    off = ends - np.array(expected)
    assert np.abs(off[:, :2]).max() < 1e-9 and np.abs(wrap(off[:, 2])).max() < 1e-9


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("EDGE_SE2 0 A0 A1 1 0 0 1 0 0 1 0", r"3: expected 'EDGE_SE2 t A B .*', 13 words, found 12"),
        ("EDGE_SE2 0 A0 A1 1 0 0 1 2 0 1 0 1", r"3: the covariance is not symmetric and positive definite"),
        ("EDGE_SE2 0 A0 A7 1 0 0 1 0 0 1 0 1", r"3: A7 has no vertex"),
        ("EDGE_SE2 0 A0 L1 1 0 0 1 0 0 1 0 1", r"3: L1 cannot be the name in EDGE_SE2: L is the letter of landmarks"),
        ("EDGE_RANGE 0 A0 L1 -1 1", r"3: the range is -1, but it must be above zero"),
        ("EDGE_RANGE 0 A0 L1 1 0", r"3: the variance is 0, but it must be above zero"),
        ("EDGE_SE2_XY 0 L1 A0 1 1 1 0 1", r"3: the first name must be a pose, and L1 is a landmark"),
        ("VERTEX_SE2 0 A0 1 1 1", r"3: A0 was in line 1 already"),
        ("VERTEX_SE2 0 a0 1 1 1", r"3: a name is a capital letter and a number"),
        ("VERTEX_SE2 0 A2 1 1 x", r"3: an entry should be a number, not 'x'"),
        ("VERTEX_SE2 4 A2 1 1 1", r"3: no EDGE_SE2 leads from A0 to A2"),
        ("VERTEX_SE3:QUAT 0 A1 0 0 0 0 0 0 1", r"3: unknown tag 'VERTEX_SE3:QUAT'; this program is for the plane"),
    ],
)
def test_mistakes_name_the_line(tmp_path: Path, line: str, message: str) -> None:
    path = tmp_path / "wrong.pyfg"
    vertex = "VERTEX_SE2 1 A1 1 0 0\n" if " A1 1 0 0 " in line else ""
    path.write_text(f"VERTEX_SE2 0 A0 0 0 0\nVERTEX_XY L1 1 1\n{line}\n{vertex}")
    with pytest.raises(FormatError, match=f"wrong.pyfg:{message}"):
        load(path)
