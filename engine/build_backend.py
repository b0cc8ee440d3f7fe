"""The build backend: scikit-build-core, and a compiler from PyPI (ziglang) where the machine has none.

``python engine/build_backend.py`` prints the requirements of a build, which the Makefile installs beforehand so that later
builds compile only what changed; with the name of an extra, or an empty one, those of the package, which it installs while
the engine is built.
"""

from __future__ import annotations

import base64
import hashlib
import os
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from zipfile import ZipFile

from scikit_build_core import build as scikit
from scikit_build_core.build import build_sdist, get_requires_for_build_sdist  # noqa: F401

ROOT = Path(__file__).resolve().parent.parent
COMPILERS = ("clang++",) if os.name == "nt" else ("c++", "g++", "clang++")
#: a program that the compiler must be able to translate
PROBE = "#include <concepts>\n#include <span>\nint main() { return static_cast<int>(std::span<int>{}.size()); }\n"


def _has_cxx20(command: list[str]) -> bool:
    """Whether a compiler exists and knows C++20 with its library."""
    if shutil.which(command[0]) is None:
        return False
    arguments = [*command, "-std=c++20", "-x", "c++", "-fsyntax-only", "-"]
    return subprocess.run(arguments, input=PROBE, text=True, capture_output=True).returncode == 0


def compiler() -> str | None:
    """The machine's C++20 compiler: that of CXX, or the first that is found; None if it has none."""
    given = os.environ.get("CXX")
    if given:
        if not _has_cxx20(shlex.split(given)):
            sys.exit(
                f"The compiler CXX={given} does not know C++20; name a newer one (GCC 11, Clang 14), or unset CXX."
            )
        return given
    found = next((name for name in COMPILERS if _has_cxx20([name])), None)
    if found is None and os.name == "nt":
        sys.exit("On Windows the engine needs Clang, because Visual Studio's compiler has no vectors: install LLVM.")
    return found


def check_headers(folder: str) -> None:
    """Leave with a sentence where the headers of Python are missing, which Linux distributions have in another package."""
    if not (Path(folder) / "Python.h").exists():
        sys.exit(
            f"The engine is built with the headers of Python, and {folder} has no Python.h. Install them (Debian, Ubuntu: "
            "apt install python3-dev; Fedora: dnf install python3-devel), or take another one: make PYTHON=/path/to/python."
        )


def _extra() -> list[str]:
    """What a build needs beside scikit-build-core and nanobind."""
    check_headers(sysconfig.get_path("include"))
    tools = ["cmake>=3.20"] if shutil.which("cmake") is None else []
    tools += ["ninja>=1.11"] if shutil.which("ninja") is None else []
    return tools + (["ziglang>=0.13"] if compiler() is None else [])


@contextmanager
def _tools() -> Iterator[None]:
    """The tools of ziglang ahead of those on PATH, where the machine has no compiler; Clang and Ninja on Windows."""
    if os.name == "nt":
        # CMake would take Visual Studio, and its compiler
        with _environment(CXX=compiler() or "", CC=os.environ.get("CC", "clang"), CMAKE_GENERATOR="Ninja"):
            yield
        return
    if compiler() is not None:
        yield
        return
    folder = ROOT / "build" / "zig"
    folder.mkdir(parents=True, exist_ok=True)
    for name, verb in (("c++", "c++"), ("cc", "cc"), ("ar", "ar"), ("ranlib", "ranlib")):
        script = folder / name
        script.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m ziglang {verb} "$@"\n')
        script.chmod(0o755)
    path = f"{folder}{os.pathsep}{os.environ.get('PATH')}"
    with _environment(PATH=path, CXX=str(folder / "c++"), CC=str(folder / "cc")):
        yield


@contextmanager
def _environment(**values: str) -> Iterator[None]:
    """Variables of the environment that have other values for a while."""
    before = {name: os.environ.get(name) for name in values}
    os.environ |= values
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def get_requires_for_build_wheel(config_settings: Any = None) -> list[str]:
    """The requirements of a wheel."""
    return [*scikit.get_requires_for_build_wheel(config_settings), *_extra()]


def get_requires_for_build_editable(config_settings: Any = None) -> list[str]:
    """The requirements of an editable installation."""
    return [*scikit.get_requires_for_build_editable(config_settings), *_extra()]


def build_wheel(wheel_directory: str, config_settings: Any = None, metadata_directory: str | None = None) -> str:
    """A wheel."""
    with _tools():
        return scikit.build_wheel(wheel_directory, config_settings, metadata_directory)


def build_editable(wheel_directory: str, config_settings: Any = None, metadata_directory: str | None = None) -> str:
    """A wheel that only names the source tree, into which the compiled module goes."""
    with _tools():
        name: str = scikit.build_editable(wheel_directory, config_settings, metadata_directory)
    _leave_in_source_tree(Path(wheel_directory) / name)
    return name


def _leave_in_source_tree(wheel: Path) -> None:
    """Replace the import hook of scikit-build-core, which has to be told of every new module and runs at every start."""
    with ZipFile(wheel) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    for name in list(files):
        if name.startswith("graphslam/"):
            target = ROOT / name
            fresh = target.with_name(f".{target.name}")
            fresh.write_bytes(files.pop(name))
            fresh.replace(target)  # running processes keep the old file
        elif name.startswith("_editable"):
            del files[name]
    files["virtual_motion_slam.pth"] = f"{ROOT}\n".encode()
    record = next(name for name in files if name.endswith(".dist-info/RECORD"))
    del files[record]
    lines = [f"{name},sha256={_digest(content)},{len(content)}" for name, content in files.items()]
    files[record] = "\n".join([*lines, f"{record},,", ""]).encode()
    with ZipFile(wheel, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)


def _digest(content: bytes) -> str:
    return base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()


def _packages(extra: str) -> list[str]:
    """What the package needs, with one of its extras or with none ("")."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return [*project["dependencies"], *(project["optional-dependencies"][extra] if extra else [])]


if __name__ == "__main__":
    print(*(_packages(sys.argv[1]) if len(sys.argv) > 1 else _extra()), sep="\n")
