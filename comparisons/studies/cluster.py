"""Runs on an existing Dask cluster: the extra ``cluster``. Each thread of a worker keeps a child process of its own."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from typing import Any
from urllib.parse import urlsplit

from graphslam import OptionError

from .executors import Crew, Place
from .outcome import Outcome
from .plan import Run

#: how long to wait for a connection, and again for an answer [s]; with importing Dask it stays below 10 s
PATIENCE = 4.0
SCHEMES = ("tcp", "tls", "ws", "wss")

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
        OptionError: Dask is not installed, the address is no address, nobody answers there (told within 10 s), there is
            no worker, or the workers have another version of this project.
    """
    check_answers(address)
    try:
        from distributed import Client
    except ModuleNotFoundError:
        raise OptionError("--dask needs Dask; install it with: pip install 'virtual-motion-slam[cluster]'") from None
    from distributed.comm import CommClosedError
    from distributed.scheduler import KilledWorker

    # what happens to the cluster is told in a sentence of ours, not in Dask's log on the user's terminal; importing
    # Dask has given a level to each of its loggers
    for name in [name for name in logging.root.manager.loggerDict if name.split(".")[0] == "distributed"]:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    _check_handshake(address)
    client = Client(address, timeout=PATIENCE, set_as_default=False)
    with client:
        slots = sum(client.nthreads().values())
        if slots == 0:
            raise OptionError(f"the cluster at {address} has no workers; start some with: dask worker {address}")
        _check_versions(client, address)
        executor = client.get_executor(pure=False)
        try:
            yield Place(
                executor, attempt_on_worker, slots, slots, f"the cluster at {address}",
                gave_up=(KilledWorker,), lost=(CancelledError, CommClosedError),
            )  # fmt: skip
        finally:
            # not to wait means to cancel here
            executor.shutdown(wait=False)


def check_answers(address: str) -> None:
    """Raise `OptionError` unless somebody accepts a connection at ``address``; needs no Dask."""
    parts = urlsplit(address)
    try:
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if parts.scheme not in SCHEMES or host is None or port is None:
        raise OptionError(f"{address!r} is no address of a Dask scheduler; write tcp://host:8786")
    try:
        socket.create_connection((host, port), timeout=PATIENCE).close()
    except OSError as error:
        raise _no_scheduler(address, error.strerror or str(error)) from None


def _check_handshake(address: str) -> None:
    """Raise `OptionError` unless it is a Dask scheduler that answers.

    Ahead of making a `Client`, because one that cannot connect takes 16 s to be cleared away, and any answer of
    another kind of server breaks it in a way of its own.
    """
    from distributed.comm import connect

    async def greet() -> None:
        comm = await connect(address, timeout=PATIENCE)
        await comm.close()

    try:
        # in a thread of its own: notebooks have a running loop in this one
        with ThreadPoolExecutor(1) as thread:
            thread.submit(lambda: asyncio.run(asyncio.wait_for(greet(), PATIENCE))).result()
    except Exception as error:
        raise _no_scheduler(address, type(error).__name__) from None


def _no_scheduler(address: str, why: str) -> OptionError:
    return OptionError(f"no Dask scheduler answers at {address} ({why}); start one with: dask scheduler")


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
