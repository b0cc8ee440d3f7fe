"""The build of the engine, and what is said where it is missing."""

import importlib.util
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def backend():
    pytest.importorskip("scikit_build_core")
    spec = importlib.util.spec_from_file_location("build_backend", ROOT / "engine" / "build_backend.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_missing_compiled_module_is_one_sentence():
    program = (
        "import sys; sys.modules['graphslam._engine'] = None\n"
        "from graphslam import SlamError\n"
        "try:\n    from graphslam import Graph\n"
        "except SlamError as error:\n    print(error)"
    )
    said = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True, cwd=ROOT).stdout
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
