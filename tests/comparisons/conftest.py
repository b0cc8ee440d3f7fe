"""Fixtures of the tests of the command line."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
import typer.testing
from typer.testing import CliRunner, Result

from comparisons.cli import app
from graphslam import save, simulate

# typer makes all verbs from their declarations at each call, which takes longer than most of the calls
typer.testing._get_command = cache(typer.testing._get_command)  # type: ignore[attr-defined]


@pytest.fixture
def invoke(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Result]:
    """Run a command in an empty folder; the arguments are those of a shell, whose names may be any bytes.

    A run draws a figure where its arguments ask for one: figures take seven times as long as small logs.
    """
    monkeypatch.chdir(tmp_path)

    def call(*arguments: object) -> Result:
        words = [str(a) for a in arguments]
        return CliRunner().invoke(
            app, [*words, *["--figures", ""] * (words[:1] == ["run"] and "--figures" not in words)]
        )

    return call


@pytest.fixture
def log_file(tmp_path: Path) -> Path:
    """A small simulated log with ids and psi."""
    path = tmp_path / "log.npz"
    save(simulate(seed=2, steps=24, clean=True), path)
    return path
