"""Runs on an existing Dask cluster: the extra ``cluster``. Each worker of the cluster has a pool of local processes.

A worker of Dask cannot stop a run or survive its crash, so its pool does, as on a single machine.
"""

from __future__ import annotations

import asyncio
import logging
import multiprocessing
import socket
from collections.abc import Iterator
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from threading import Lock
from typing import Any
from urllib.parse import urlsplit

from pebble import ProcessPool

from graphslam import OptionError, SlamError
from graphslam.errors import quoted

from ..estimators import ESTIMATORS
from ..failures import sentence
from ..pool import added_estimators, process_pool
from .outcome import ERROR, Outcome
from .places import Place, in_pool, pool_outcome
from .plan import Run

#: how long to wait for a connection, and again for an answer [s]; with importing Dask it stays below 10 s
PATIENCE = 4.0
SCHEMES = ("tcp", "tls", "ws", "wss")

_lock = Lock()
_pools: list[ProcessPool] = []


def _pool_of_worker() -> ProcessPool:
    """The pool of this worker, which serves all studies on the cluster and ends with the worker."""
    from distributed import get_worker

    with _lock:
        if not _pools:
            # Dask runs its workers as daemons, which may otherwise not have processes of their own
            multiprocessing.current_process().daemon = False
            _pools.append(process_pool(get_worker().state.nthreads, tuple(ESTIMATORS)))
        return _pools[0]


def execute_on_worker(run: Run, limit: float, added: bytes = b"") -> Outcome:
    """The task of the cluster: a run in the pool of its worker; ``added`` are the user's own estimators."""
    return pool_outcome(in_pool(_pool_of_worker(), run, limit, added), run, limit)


@contextmanager
def dask_cluster(address: str) -> Iterator[Place]:
    """The cluster of a Dask scheduler, tcp://host:8786 or the like.

    Raises:
        OptionError: Dask is not installed, the address is no address, it does not answer within 10 s, there is no
            worker, or the workers have another version of this project.
    """
    check_answers(address)
    try:
        from distributed import Client
    except ModuleNotFoundError:
        raise OptionError("--dask needs Dask; install it with: pip install -e '.[cluster]' in the clone") from None
    from distributed.comm import CommClosedError
    from distributed.scheduler import KilledWorker

    # a lost cluster is reported in one sentence of ours; Dask's loggers, whose levels are set when it is imported, would
    # add theirs on the terminal
    for name in [name for name in logging.root.manager.loggerDict if name.split(".")[0] == "distributed"]:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    _check_handshake(address)

    def outcome(future: Future[Outcome], run: Run, limit: float) -> Outcome:
        try:
            return pool_outcome(future, run, limit)
        except KilledWorker as error:
            return Outcome(key=run.key, status=ERROR, error=f"given up by the cluster: {sentence(error)}")
        except (CancelledError, CommClosedError) as error:
            raise SlamError(
                f"the cluster at {address} is gone ({type(error).__name__}); finished runs are kept, and the same command "
                "continues"
            ) from None

    with Client(address, timeout=PATIENCE, set_as_default=False) as client:
        threads = sum(client.nthreads().values())
        if threads == 0:
            raise OptionError(f"the cluster at {address} has no workers; start some with: dask worker {address}")
        _check_versions(client, address)
        executor = client.get_executor(pure=False)
        try:
            # several runs wait on each worker, so that short ones do not wait for the network
            added = added_estimators()
            yield Place(8 * threads, lambda run, limit: executor.submit(execute_on_worker, run, limit, added), outcome)
        finally:
            # without waiting, which cancels the runs that have not begun
            executor.shutdown(wait=False)


def check_answers(address: str) -> None:
    """Raise `OptionError` unless a server accepts a connection at ``address``; needs no Dask."""
    parts = urlsplit(address)
    try:
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if parts.scheme not in SCHEMES or host is None or port is None:
        raise OptionError(f"{quoted(address)} is no address of a Dask scheduler; write tcp://host:8786")
    try:
        socket.create_connection((host, port), timeout=PATIENCE).close()
    except OSError as error:
        raise _no_scheduler(address, error.strerror or str(error)) from None


def _check_handshake(address: str) -> None:
    """Raise `OptionError` unless it is a Dask scheduler that answers.

    This comes before a `Client` is made, because closing one that cannot connect takes 16 s, and an answer of another
    kind of server breaks it in various ways.
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


def _no_scheduler(address: str, reason: str) -> OptionError:
    return OptionError(f"no Dask scheduler answers at {address} ({reason}); start one with: dask scheduler")


def our_version() -> str:
    """The version of this project that is installed here."""
    try:
        return version("virtual-motion-slam")
    except PackageNotFoundError:
        return "not installed"


def _check_versions(client: Any, address: str) -> None:
    try:
        versions = set(client.run(our_version).values())
    except Exception as error:
        raise OptionError(
            f"the workers at {address} cannot import this project; install the same version there ({error})"
        ) from None
    if versions - {our_version()}:
        raise OptionError(
            f"the workers at {address} have version {', '.join(sorted(versions))} of this project, but this is "
            f"{our_version()}; install the same version there"
        )
