"""Arrows point down only: between the packages, inside each of them, and where GTSAM may be imported."""

import ast
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FORBIDDEN = {"graphslam": {"fastslam", "comparisons"}, "fastslam": {"comparisons"}, "comparisons": set()}
USES_GTSAM = ("graphslam.factors", "graphslam.solvers.gtsam_", "graphslam.online.isam2")


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for package in FORBIDDEN for path in sorted((ROOT / package).rglob("*.py"))}


def statements(node: ast.AST, in_functions: bool) -> Iterator[ast.AST]:
    """All nodes below one, without ``if TYPE_CHECKING`` blocks, and without the bodies of functions unless asked for."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            yield from (part for other in child.orelse for part in (other, *statements(other, in_functions)))
        elif in_functions or not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            yield child
            yield from statements(child, in_functions)


def imports(name: str, *, in_functions: bool = True) -> set[str]:
    """The full names of what a module imports: modules, and objects as module.object; relative imports resolved."""
    path = MODULES[name]
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    return imported_by(path.read_text(encoding="utf-8"), tuple(package), in_functions)


@cache
def imported_by(text: str, inside: tuple[str, ...], in_functions: bool) -> set[str]:
    names, package = set(), list(inside)
    for node in statements(ast.parse(text), in_functions):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            source = ".".join([*base, *([node.module] if node.module else [])])
            names |= {f"{source}.{alias.name}" for alias in node.names}
    return names


def module_of(name: str) -> str | None:
    """The module of this project that an imported name is or comes from."""
    while name and name not in MODULES:
        name = name.rpartition(".")[0]
    return name or None


@pytest.mark.slow
@pytest.mark.parametrize("package", FORBIDDEN)
def test_no_package_imports_one_above_it(package):
    names = [name for name in MODULES if name.split(".")[0] == package]
    assert names
    for name in names:
        assert not {imported.split(".")[0] for imported in imports(name)} & FORBIDDEN[package], name


@pytest.mark.parametrize("package", FORBIDDEN)
def test_no_circles_inside_a_package(package):
    """Imports inside functions count. A package's own ``__init__`` may import the modules that it exports."""
    below = {}
    for name in MODULES:
        if name.split(".")[0] == package:
            used = {module_of(imported) for imported in imports(name)} - {None, name}
            # `from . import x` of a top-level package is an import of x; the export itself is no circle
            below[name] = {other for other in used if other != package}
    try:
        TopologicalSorter(below).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def test_circles_and_relative_imports_are_recognised(tmp_path, monkeypatch):
    files = {
        "a/__init__.py": "from .b import thing",
        "a/b.py": "from __future__ import annotations\ndef f():\n    from .sub import c",
        "a/sub/__init__.py": "",
        "a/sub/c.py": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from .. import b\nelse:\n    import os.path",
        "a/sub/d.py": "from ..b import f\nfrom . import c",
    }
    for file, text in files.items():
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).write_text(text)
    monkeypatch.setattr(f"{__name__}.ROOT", tmp_path)
    monkeypatch.setattr(f"{__name__}.MODULES", {module_name(path): path for path in tmp_path.rglob("*.py")})
    assert imports("a") == {"a.b.thing"}
    assert imports("a.b") == {"__future__.annotations", "a.sub.c"}
    assert imports("a.b", in_functions=False) == {"__future__.annotations"}
    assert imports("a.sub.c") == {"typing.TYPE_CHECKING", "os.path"}
    assert imports("a.sub.d") == {"a.b.f", "a.sub.c"}
    assert module_of("a.b.f") == "a.b" and module_of("os.path") is None
    (tmp_path / "a/sub/c.py").write_text("def g():\n    from ..b import f")
    with pytest.raises(pytest.fail.Exception, match="a.b -> a.sub.c|a.sub.c -> a.b"):
        test_no_circles_inside_a_package("a")


def test_gtsam_is_imported_only_where_it_is_needed():
    """Only the factors and the solvers on GTSAM import it, and no other module but the root imports these when loaded."""
    for name in MODULES:
        of_gtsam = name.startswith(USES_GTSAM)
        if not name.startswith("comparisons") and not of_gtsam:
            assert not {imported for imported in imports(name) if imported.split(".")[0] == "gtsam"}, name
            # the root exports them
            if name != "graphslam":
                on_loading = {module_of(imported) or "" for imported in imports(name, in_functions=False)}
                assert not {other for other in on_loading if other.startswith(USES_GTSAM)}, name


def test_logs_and_graphs_import_no_reader():
    """Readers make them: `Log.from_tables` and `Graph.from_g2o` are added by the modules that read."""
    readers = (
        "graphslam.io",
        "graphslam.graph.pose_graph",
        "graphslam.graph.g2o",
        "graphslam.log.table",
        "graphslam.log.text",
    )
    for name in ("graphslam.log.log", "graphslam.graph.graph"):
        assert not {other for other in imports(name) if other.startswith(readers)}, name


def test_the_two_solvers_share_only_their_start():
    """Neither solves with the other: GTSAM's takes the starts, the choice among ends, and Anderson acceleration.

    Both repeat their solution where the noise is taken at the estimated ranges.

    Graphs with parameters have in common what goes before the joint iteration and after it, and solutions the notes on
    landmarks that may be elsewhere.
    """
    of_gtsam = [name for name in MODULES if name.startswith("graphslam.solvers.gtsam_")]
    used = {name for module in of_gtsam for name in imports(module) if name.startswith("graphslam.solvers.")}
    # both return a `Solution` with its certificate, and take the same graph at other parameters
    shared = tuple(f"graphslam.solvers.{module}." for module in ("solution", "certificate", "corrected", "joint"))
    ours = {name for name in used if not name.startswith((*USES_GTSAM, *shared))}
    assert {name.rpartition(".")[2] for name in ours} == {
        "starting_state",
        "image_notes",
        "best_end",
        "at_estimated_ranges",
        "takes_estimated_ranges",
        "DAMPED",
        "Run",
        "rounding",
        "FIRST",
        "PROMISE",
        "best_of_starts",
    }
    for name in MODULES:
        if name.startswith("graphslam.solvers.") and not name.startswith(USES_GTSAM):
            assert not {other for other in imports(name) if other.startswith(USES_GTSAM)}, name


def test_factors_and_edges_are_derived_twice():
    """The factors take robust kernels from the edges, and no residual, Jacobian or information."""
    for name in MODULES:
        if name.startswith("graphslam.factors"):
            assert all(
                module_of(other) == "graphslam.edges.robust"
                for other in imports(name)
                if other.startswith("graphslam.edges")
            ), name
        if name.startswith("graphslam.edges"):
            assert not {other for other in imports(name) if other.startswith("graphslam.factors")}, name
