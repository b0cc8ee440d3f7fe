"""Arrows point down only, and only two files know gtsam."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FORBIDDEN = {"graphslam": {"fastslam", "comparisons"}, "fastslam": {"comparisons"}, "comparisons": set()}
MAY_IMPORT_GTSAM = {"graphslam/solvers/gtsam_solver.py", "graphslam/solvers/online.py"}


def imported(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield node.module


@pytest.mark.parametrize("package", FORBIDDEN)
def test_imports(package):
    files = sorted((ROOT / package).rglob("*.py"))
    assert files
    for path in files:
        roots = {name.split(".")[0] for name in imported(path)}
        assert not roots & FORBIDDEN[package], path
        if package == "graphslam" and "gtsam" in roots:
            within = path.relative_to(ROOT).as_posix()
            assert within in MAY_IMPORT_GTSAM or within.startswith("graphslam/factors/")


def test_the_solvers_do_not_know_each_other():
    assert "gtsam_solver" not in (ROOT / "graphslam/solvers/solve.py").read_text()
    assert "solver import" not in (ROOT / "graphslam/solvers/gtsam_solver.py").read_text().replace("gtsam_solver", "")
