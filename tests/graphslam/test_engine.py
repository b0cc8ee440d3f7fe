"""The build of the engine, and what is said where it is missing."""

import importlib.util
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pytest

from graphslam.engine import engine
from graphslam.linear.information import BlockSystem

ROOT = Path(__file__).parents[2]


@pytest.fixture
def backend():
    pytest.importorskip("scikit_build_core")
    spec = importlib.util.spec_from_file_location("build_backend", ROOT / "engine" / "build_backend.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_missing_compiled_module_is_one_sentence():
    missing = "import sys; sys.modules['graphslam._engine'] = None\n"
    imported = "try:\n    from graphslam import Graph\nexcept ImportError as error:\n    print(error)"
    command = "sys.argv = ['slam-compare', 'run']\nfrom comparisons.__main__ import main\nmain()"
    for program, status in ((imported, 0), (command, 2)):
        run = subprocess.run([sys.executable, "-c", missing + program], capture_output=True, text=True, cwd=ROOT)
        said = run.stdout + run.stderr
        assert run.returncode == status and "Traceback" not in said
        assert "graphslam._engine cannot be loaded" in said and said.endswith("pip install --editable .\n")


def test_a_machine_without_compiler_gets_one_from_pypi(backend, monkeypatch, tmp_path):
    monkeypatch.delenv("CXX", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert backend.compiler() is None
    assert [name.split(">")[0] for name in backend._extra()] == ["cmake", "ninja", "ziglang"]


def test_missing_headers_of_python_are_named(backend, monkeypatch, tmp_path):
    monkeypatch.setattr(backend.sysconfig, "get_path", lambda _: str(tmp_path))
    with pytest.raises(SystemExit, match=r"has no Python.h. Install them \(Debian, Ubuntu: apt install python3-dev"):
        backend._extra()


def test_a_compiler_that_is_too_old_is_named(backend, monkeypatch, tmp_path):
    old = tmp_path / "old-c++"
    old.write_text("#!/bin/sh\nexit 1\n")
    old.chmod(0o755)
    monkeypatch.setenv("CXX", str(old))
    with pytest.raises(SystemExit, match=r"old-c\+\+ does not know C\+\+20"):
        backend.compiler()


def test_an_editable_wheel_names_the_source_tree(backend, monkeypatch, tmp_path):
    monkeypatch.setattr(backend, "ROOT", tmp_path)
    (tmp_path / "graphslam").mkdir()
    wheel = tmp_path / "some.whl"
    with ZipFile(wheel, "w") as archive:
        archive.writestr("graphslam/_engine.so", b"compiled")
        archive.writestr("_editable_hook.py", b"hook")
        archive.writestr("some.dist-info/METADATA", b"Name: some\n")
        archive.writestr("some.dist-info/RECORD", b"")
    backend._leave_in_source_tree(wheel)
    assert (tmp_path / "graphslam" / "_engine.so").read_bytes() == b"compiled"
    with ZipFile(wheel) as archive:
        names = archive.namelist()
        record = archive.read("some.dist-info/RECORD").decode().splitlines()
        assert archive.read("virtual_motion_slam.pth").decode().strip() == str(tmp_path)
    assert sorted(names) == ["some.dist-info/METADATA", "some.dist-info/RECORD", "virtual_motion_slam.pth"]
    assert sorted(line.split(",")[0] for line in record) == sorted(names)


def _edges(number=2, nodes=3, rows=2, parameters=4):
    """Edges along a chain, as the engine's `add_linearized` takes them, and the system that they are added to."""
    first = np.arange(number)
    chain = np.arange(0, 2 * number + 1, 2), np.column_stack([first, first + 1]).ravel()
    system = BlockSystem.from_cliques(nodes, [chain])
    sizes = [(rows,), (rows, 3), (rows, 3), (rows, parameters), (rows, rows)]
    border = [(nodes, 3, parameters), (parameters, parameters), (parameters,)]
    pairs = system.slots_of(first, first + 1)
    given = [first, first + 1, pairs, *(np.ones((number, *size)) for size in sizes)]
    return [*given, *system.arrays, *(np.zeros(shape) for shape in border)]


def test_edges_given_by_their_jacobians_are_added():
    given = _edges()
    engine.add_linearized(*given)
    # each edge adds P' W P, in which all numbers are one, and -P' W e
    assert np.array_equal(given[-2], np.full((4, 4), 8.0)) and np.array_equal(given[-1], np.full(4, -8.0))


@pytest.mark.parametrize("k", [1, 2, 3, 4, 5, 6, 7, -5, -4, -3, -2, -1])
def test_arrays_of_other_shapes_are_refused(k):
    given = _edges()
    given[k] = given[k][:-1]
    with pytest.raises(ValueError, match="do not fit together"):
        engine.add_linearized(*given)


@pytest.mark.parametrize(("k", "value"), [(0, -1), (1, 3), (1, 0), (2, -1), (2, 99)])
def test_edges_to_no_node_are_refused(k, value):
    given = _edges()
    given[k] = np.array([value, 1])
    with pytest.raises(ValueError, match="between two different nodes"):
        engine.add_linearized(*given)


@pytest.mark.parametrize("shape", [(2, 3, 4), (3, 2, 4), (3, 3, 5), (3, 3), (36,)])
def test_right_hand_sides_of_other_shapes_are_refused(shape):
    start, rows, values = _edges()[8:11]
    values[start[1:] - 1] = np.eye(3)
    factor = engine.RealFactor(engine.analyze(start, rows, None, threads=1))
    assert factor.factorize(values, 0.0) < 0
    right, other = np.ones((3, 3, 4)), np.ones(shape)
    assert factor.solve_columns(right, np.empty_like(right))
    for b, x in ((right, other), (other, right)):
        with pytest.raises(ValueError, match="right-hand sides and solutions"):
            factor.solve_columns(b, x)


@pytest.mark.parametrize("shape", [(2, 3), (4, 3), (3, 3, 2)])
def test_a_right_hand_side_of_another_size_is_refused(shape):
    start, rows, values = _edges()[8:11]
    values[start[1:] - 1] = np.eye(3)
    factor = engine.RealFactor(engine.analyze(start, rows, None, threads=1))
    assert factor.factorize(values, 0.0) < 0
    right, other = np.ones((3, 3)), np.ones(shape)
    assert factor.solve(right, np.empty_like(right))
    for b, x in ((right, other), (other, right)):
        with pytest.raises(ValueError, match="right-hand side and solution"):
            factor.solve(b, x)


#: of other numbers, with gaps, read-only
NOT_WRITTEN = np.ones((3, 3), dtype=np.float32), np.ones((3, 6))[:, ::2], np.frombuffer(bytes(72)).reshape(3, 3)


@pytest.mark.parametrize("xi", NOT_WRITTEN)
def test_an_array_that_would_be_written_into_as_a_copy_is_refused(xi):
    given = _edges()
    given[11] = xi
    with pytest.raises(TypeError):
        engine.add_linearized(*given)


#: the same numbers in other arrays: of another type, with gaps, read-only
OTHER_ARRAYS = [
    lambda a: a.astype(np.int32),
    lambda a: a.astype(np.uint64),
    lambda a: np.repeat(a, 2)[::2],
    lambda a: np.frombuffer(a.tobytes(), a.dtype),
]


@pytest.mark.parametrize("other", OTHER_ARRAYS)
def test_arrays_of_whole_numbers_may_be_of_any_kind(other):
    # the upper triangle of a path of four nodes: those of the middle two are all blocks but the first and the last
    start, rows, nodes = np.array([0, 1, 3, 5, 7]), np.array([0, 0, 1, 1, 2, 2, 3]), np.array([1, 2])
    assert engine.blocks_of_nodes(*map(other, (start, rows, nodes))).tolist() == [1, 2, 3, 4, 5]


def test_whole_numbers_are_not_made_of_floating_point_ones():
    with pytest.raises(TypeError):
        engine.blocks_of_nodes(np.array([0, 1]), np.array([0]), np.array([0.0]))


@pytest.mark.parametrize("other", [*OTHER_ARRAYS, lambda a: a.astype(float), lambda a: a.astype(np.float32)])
def test_arrays_of_floating_point_numbers_may_be_of_any_kind(other):
    state, diagonal = np.array([[1, 2, 3]]), np.array([[4, 5, 6]])
    expected = sum(d * (1e-15 * (1 + x)) ** 2 for x, d in zip((1, 2, 3), (4, 5, 6)))
    assert engine.rounding(other(state), other(diagonal)) == pytest.approx(expected, rel=1e-14)


def test_a_call_keeps_no_reference_to_its_arrays():
    start, rows = np.array([0, 1]), np.array([0])
    before = sys.getrefcount(start), sys.getrefcount(rows)
    for _ in range(3):
        assert engine.pattern_fault(start, rows) == -1
    assert (sys.getrefcount(start), sys.getrefcount(rows)) == before
