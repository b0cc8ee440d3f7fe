"""Runs on an existing Dask cluster: the extra ``cluster``. Each thread of a worker keeps a child process of its own."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from graphslam import OptionError

from .executors import Crew, Place
from .outcome import Outcome
from .plan import Run

#: a scheduler that has not answered by then will not [s]; with importing Dask it stays below 10
PATIENCE = 8.0

# one for each worker process, made at its first task; shared by all studies on the cluster
_crew: Crew | None = None


def attempt_on_worker(batch: Sequence[Run], limit: float) -> list[Outcome]:
    """`Crew.attempt` with the crew of this worker.

    Its children end by themselves when there has been nothing to do for a while, or when the worker ends.
    """
    global _crew
    if _crew is None:
        _crew = Crew(patience=1.0)
    return _crew.attempt(batch, limit)


@contextmanager
def dask_cluster(address: str) -> Iterator[Place]:
    """The cluster of a Dask scheduler, tcp://host:8786 or the like.

    Raises:
        OptionError: Dask is not installed, the address is no address, nobody answers there, there is no worker, or
            the workers have another version of this project.
    """
    try:
        from distributed import Client
    except ImportError:
        raise OptionError("--dask needs Dask; install it with: pip install 'virtual-motion-slam[cluster]'") from None
    begin = time.monotonic()
    try:
        client = Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, TimeoutError):
        seconds = time.monotonic() - begin
        raise OptionError(
            f"no Dask scheduler answers at {address} (waited {seconds:.0f} s); start one with: dask scheduler"
        ) from None
    except ValueError as error:
        raise OptionError(f"{address!r} is no address of a Dask scheduler ({error}); write tcp://host:8786") from None
    with client:
        slots = sum(worker["nthreads"] for worker in client.scheduler_info(n_workers=-1)["workers"].values())
        if slots == 0:
            raise OptionError(f"the cluster at {address} has no workers; start some with: dask worker {address}")
        _check_versions(client, address)
        with client.get_executor(pure=False) as executor:
            try:
                yield Place(executor, attempt_on_worker, slots, slots, f"{slots} slots of the cluster at {address}")
            finally:
                executor.shutdown(wait=False, cancel_futures=True)


def our_version() -> str:
    """The version of this project that is installed here."""
    try:
        return version("virtual-motion-slam")
    except PackageNotFoundError:
        return "not installed"


def _check_versions(client: Any, address: str) -> None:
    try:
        found = set(client.run(our_version).values())
    except Exception as error:
        raise OptionError(
            f"the workers at {address} cannot import this project; install the same version there ({error})"
        ) from None
    if found - {our_version()}:
        raise OptionError(
            f"the workers at {address} have version {', '.join(sorted(found))} of this project, but this is "
            f"{our_version()}; install the same version there"
        )
