"""The same study on a local Dask cluster of two workers: the same numbers."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from comparisons.studies.execute import StudyDatabase
from comparisons.studies.plan import read_study
from comparisons.studies.sweep import check_answers, sweep
from graphslam import OptionError

pytestmark = [pytest.mark.cluster, pytest.mark.slow]
pytest.importorskip("distributed", reason="needs the extra cluster: pip install -e '.[cluster]'")

ROOT = Path(__file__).parents[2]
STUDY = """\
seeds = 3
estimators = ["dead-reckoning", "graph", "fastslam1"]
[simulate]
steps = 15
[options]
particles = 30
"""
OF_THE_MOMENT = {"seconds", "total_seconds", "process", "ended"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cluster")


@pytest.fixture(scope="module")
def scheduler(folder: Path) -> Iterator[str]:
    """The address of a scheduler in a process of its own."""
    file = folder / "address.json"
    command = ["scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file)]
    process = _dask(folder, *command)
    try:
        end = time.monotonic() + 60
        while not file.exists() and time.monotonic() < end:
            time.sleep(0.1)
        time.sleep(0.2)
        address: str = json.loads(file.read_text())["address"]
        check_answers(address)
        yield address
    finally:
        process.terminate()
        process.wait()


def _dask(folder: Path, *words: str) -> subprocess.Popen[bytes]:
    # python -m finds the packages in the folder it is started in, as the workers of a cluster find the installed ones
    command = [sys.executable, "-m", "distributed.cli.dask_" + words[0], *words[1:]]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


@pytest.mark.slow
def test_the_same_numbers_from_a_cluster(scheduler: str, folder: Path) -> None:
    (folder / "there.toml").write_text(STUDY)
    there = read_study(folder / "there.toml")
    with pytest.raises(OptionError, match="no workers"):
        sweep(there, dask=scheduler)
    assert not there.database.exists()
    options = ["--nworkers", "2", "--nthreads", "1", "--no-dashboard", "--local-directory", str(folder)]
    workers = _dask(folder, "worker", scheduler, *options)
    try:
        end = time.monotonic() + 60
        while time.monotonic() < end and _workers(scheduler) < 2:
            time.sleep(0.2)
        assert sweep(there, dask=scheduler).failed == 0
    finally:
        workers.terminate()
        workers.wait()
    (folder / "here.toml").write_text(STUDY)
    here = read_study(folder / "here.toml")
    sweep(here, jobs=0)
    found = []
    for study in (here, there):
        with StudyDatabase.reading(study.database) as database:
            found.append([{k: v for k, v in row.items() if k not in OF_THE_MOMENT} for row in database.rows()])
    assert len(found[0]) == 9
    assert found[0] == found[1]


def _workers(address: str) -> int:
    from distributed import Client

    with Client(address, timeout=10, set_as_default=False) as client:
        return len(client.nthreads())
