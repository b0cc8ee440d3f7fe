"""The engine as a CMake package: the examples of `examples/cpp`, built against it, agree with Python."""

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from engine_outside import assert_same_poses, online, solution

from graphslam import load, save, simulate

ROOT = Path(__file__).parents[1]
COMPILERS = ("c++", "g++", "clang++")

# the engine is built once more, as a library of its own
pytestmark = pytest.mark.nightly


def run(*command: object) -> str:
    """The output of a program, which must succeed."""
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the programs of `examples/cpp`, built against an installed engine."""
    if shutil.which("cmake") is None:
        pytest.skip("this machine has no cmake")
    if not any(map(shutil.which, COMPILERS)):
        pytest.skip("this machine has no C++ compiler")
    # objects are kept, so that a second run compiles only what has changed
    built, installed, examples = (
        ROOT / "build" / "cpp",
        tmp_path_factory.mktemp("installed"),
        tmp_path_factory.mktemp("cpp"),
    )
    run("cmake", "-S", ROOT / "engine", "-B", built)
    run("cmake", "--build", built, "--parallel", 2)
    run("cmake", "--install", built, "--prefix", installed)
    run("cmake", "-S", ROOT / "examples" / "cpp", "-B", examples, f"-DCMAKE_PREFIX_PATH={installed}")
    run("cmake", "--build", examples)
    return examples


@pytest.fixture(params=[True, False], ids=["psi", "no psi"])
def log_file(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    log = simulate(seed=3, steps=120, orientation=request.param)
    path = tmp_path / "log.txt"
    save(replace(log, true_poses=None, true_landmarks=None), path)
    return path


def rows(output: str) -> list[list[str]]:
    """The words of each line."""
    return [line.split() for line in output.splitlines()]


def test_a_log_is_solved_as_in_python(programs: Path, log_file: Path) -> None:
    assert_same_poses(rows(run(programs / "solve", log_file)), solution(load(log_file)).poses)


def test_the_minimum_is_proven_as_in_python(programs: Path, log_file: Path) -> None:
    """Without psi dead reckoning leads to a wrong minimum here, which both say."""
    said = subprocess.run([programs / "solve", log_file], capture_output=True, text=True).stderr
    expected = solution(load(log_file)).certificate
    assert expected.proven == (load(log_file).sightings.shape[1] == 3)
    assert re.search(r"^J = \S+ after \d+ steps: the (last|steps)", said), said
    bound = re.search(r"no state has a J below (\S+): (.*)", said)
    assert bound is not None, said
    # the program prints six digits
    assert float(bound[1]) == pytest.approx(expected.lower_bound, rel=1e-5)
    assert bound[2] == ("this is the global minimum" if expected.proven else "there may be a lower minimum")


def test_the_online_loop_gives_the_poses_of_python(programs: Path, log_file: Path) -> None:
    assert_same_poses(rows(run(programs / "online", log_file)), online(load(log_file))[0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("delta 1\nx 0 0 0 0\nw 1\n", "line 3: expected delta, u, x or z"),
        ("delta 1\nu 0 1 fast\nx 0 0 0 0\n", "line 2: expected delta, u, x or z"),
        ("x 0 0 0 0\n", "no line delta"),
        ("delta 1\nx 0 0 0 0\nx 1 0 0 0\n", "fewer controls than motions"),
    ],
)
def test_a_file_that_is_no_log_is_one_sentence(programs: Path, tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "log.txt"
    path.write_text(text)
    for name in ("solve", "online"):
        done = subprocess.run([programs / name, path], capture_output=True, text=True)
        assert done.returncode == 1 and message in done.stderr and done.stderr.count("\n") == 1


def test_other_vectors_than_those_of_the_library_are_an_error(programs: Path) -> None:
    cache = (programs / "CMakeCache.txt").read_text()
    package = Path(re.search(r"vmslam_DIR:PATH=(.*)", cache)[1])
    include = package.parents[2] / "include"
    program = '#include "vmslam/numbers/lanes.hpp"\n'
    flags = "-std=c++20", "-fsyntax-only", "-DVMSLAM_BUILT_REGISTER=3", f"-I{include}", "-x", "c++", "-"
    command = next(filter(shutil.which, COMPILERS)), *flags
    done = subprocess.run(command, input=program, capture_output=True, text=True)
    assert done.returncode != 0 and "vmslam was compiled for other vectors" in done.stderr


def test_the_package_has_the_version_of_the_project() -> None:
    versions = [
        re.search(pattern, (ROOT / name).read_text(), re.MULTILINE)
        for name, pattern in (
            ("pyproject.toml", r'^version = "(.*)"'),
            ("engine/CMakeLists.txt", r"vmslam VERSION ([\d.]*)"),
        )
    ]
    assert len({version[1] for version in versions if version}) == 1 and all(versions)
