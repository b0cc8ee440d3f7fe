"""Shared fixtures: the logs that many tests solve, and the real data where it is at hand."""

from __future__ import annotations

import os
import random
import subprocess
from collections.abc import Callable
from pathlib import Path

import hypothesis
import pytest

from graphslam import Log, load, simulate

# messages are English wherever the tests run
os.environ["LC_ALL"] = "C.UTF-8"

# one fixed profile: the same examples in every run, no deadline on shared machines; `make test-nightly` takes more of them
EXAMPLES = int(os.environ.get("EXAMPLES", 40))
hypothesis.settings.register_profile("repeatable", derandomize=True, deadline=None, max_examples=EXAMPLES)
hypothesis.settings.load_profile("repeatable")

DATA = Path(os.environ.get("SLAM_DATA", Path(__file__).parents[2] / "shared" / "data"))


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--one-in", type=int, default=1, metavar="N", help="only one in N tests, which the commit chooses")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Files with slow tests come first, so that no process is left with a long one at the end."""
    if (count := config.getoption("--one-in")) > 1:
        commit = subprocess.run(
            ["git", "rev-parse", "HEAD"], cwd=Path(__file__).parent, capture_output=True, check=True
        )
        chosen = random.Random(commit.stdout).randrange(count)
        config.hook.pytest_deselected(items=[item for k, item in enumerate(items) if k % count != chosen])
        items[:] = items[chosen::count]
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@pytest.fixture(scope="session")
def shared_data() -> Callable[[str], Path]:
    """The path of a real data file; the test is skipped, with the file's name, where it is absent."""

    def find(name: str) -> Path:
        path = DATA / name
        if not path.exists():
            pytest.skip(f"needs {name} below ../shared/data or the folder named by SLAM_DATA")
        return path

    return find


@pytest.fixture(scope="session")
def book_log(shared_data: Callable[[str], Path]) -> Log:
    return load(shared_data("lnpr/log2_for_book.txt"))


@pytest.fixture(scope="session")
def clean_log() -> Log:
    """A small simulated log whose noise follows the models exactly."""
    return simulate(seed=4, clean=True)
