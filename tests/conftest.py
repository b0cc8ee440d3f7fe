"""Shared fixtures: the logs that many tests solve, and the real data where it is at hand."""

from __future__ import annotations

import os

# before NumPy is imported: where two processes share two cores, threads of BLAS wait for each other, and tests with dense
# matrices of 400 rows take 2 to 6 times the processor time
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import gc
import random
import subprocess
from collections.abc import Callable, Generator
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
    parser.addoption("--one-in", type=int, default=1, metavar="N", help="of the tests of the night only one in N")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collecting garbage visits no module and no test: the 340,000 objects of theirs took a tenth of the processor time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """The commit chooses some tests of the night; files with slow tests come first, so that none is left to the end."""
    night = [item for item in items if any(map(item.get_closest_marker, ("nightly", "browser", "cluster")))]
    if (count := config.getoption("--one-in")) > 1:
        commit = subprocess.run(
            ["git", "rev-parse", "HEAD"], cwd=Path(__file__).parent, capture_output=True, check=True
        )
        chosen = random.Random(commit.stdout).randrange(count)
        left_out = {item for k, item in enumerate(night) if k % count != chosen}
        config.hook.pytest_deselected(items=list(left_out))
        items[:] = [item for item in items if item not in left_out]
    slow = {item.path for item in items if item.get_closest_marker("slow")} | {item.path for item in night}
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
