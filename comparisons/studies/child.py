"""A process that does what it is told, one call after another, and can be stopped in the middle of one.

Python cannot interrupt a compiled kernel or GTSAM, so a limit on the time of a run, and safety from a run that ends
its process, need a process of its own for the runs. It serves many runs, because importing the estimators takes
seconds. It is a plain subprocess and not one of `multiprocessing`: that one imports the caller's main script again (which
notebooks have not), and is forbidden in the workers of Dask.

``python -m comparisons.studies.child`` is the other side; only `Child` starts it.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

#: a child that has heard nothing for so long ends by itself [s]; `Child.fresh` says no well before
IDLE = 60.0
#: one thread for each process: as many processes as cores, and the same numbers however many cores there are
ONE_THREAD = dict.fromkeys(("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS",
                            "VECLIB_MAXIMUM_THREADS", "TBB_NUM_THREADS"), "1")  # fmt: skip


class TimeLimit(Exception):
    """The call took longer than it may; the child is gone."""


class ChildDied(Exception):
    """The child ended in the middle of a call; the text says how."""


class Child:
    """A running child process."""

    def __init__(self) -> None:
        path = os.pathsep.join(entry or str(Path.cwd()) for entry in sys.path)
        # Dask has its workers give freed memory back at once: arrays of thousands of particles then fault in anew at
        # every step, and runs take half as long again
        inherited = {name: value for name, value in os.environ.items() if name != "MALLOC_TRIM_THRESHOLD_"}
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115  # read when the child has died
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "comparisons.studies.child"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            env={**inherited, **ONE_THREAD, "PYTHONPATH": path},
            # Ctrl-C on the terminal is for the parent alone
            start_new_session=True,
        )
        assert self._process.stdin is not None and self._process.stdout is not None
        self._to = Connection(os.dup(self._process.stdin.fileno()), readable=False)
        self._from = Connection(os.dup(self._process.stdout.fileno()), writable=False)
        self._process.stdin.close()
        self._process.stdout.close()
        self._used = time.monotonic()
        #: the estimators whose kernels the child has compiled or loaded
        self.warmed: set[str] = set()

    @property
    def fresh(self) -> bool:
        """Whether it can take a call: it lives, and is not about to end for having been idle."""
        return self._process.poll() is None and time.monotonic() - self._used < IDLE / 2

    def call(self, function: Callable[..., Any], *arguments: Any, limit: float | None = None) -> Any:
        """What ``function(*arguments)`` returns there.

        Args:
            function: of a module, so that it can be named to the child.
            arguments: plain data.
            limit: of its time [s].

        Raises:
            TimeLimit: it took longer; the child has been killed.
            ChildDied: the child ended, or the function raised.
        """
        try:
            self._to.send((function, arguments))
            if not self._from.poll(limit):
                self.kill()
                raise TimeLimit
            done, value = self._from.recv()
        except (EOFError, OSError):
            raise ChildDied(self._last_words()) from None
        self._used = time.monotonic()
        if not done:
            raise ChildDied(value)
        return value

    def kill(self) -> None:
        """End it now. It has no files open for writing, so nothing is lost but the run."""
        with suppress(ProcessLookupError):
            self._process.kill()
        self._process.wait()
        self._errors.close()

    def close(self) -> None:
        """End it and give back its pipes."""
        self.kill()
        self._to.close()
        self._from.close()

    def _last_words(self) -> str:
        status = self._process.wait()
        how = f"signal {signal.Signals(-status).name}" if status < 0 else f"exit status {status}"
        with suppress(OSError, ValueError):
            self._errors.seek(0)
            lines = self._errors.read().decode(errors="replace").strip().splitlines()
            if lines:
                return f"the process ended with {how}: {lines[-1].strip()}"
        return f"the process ended with {how}"


def main() -> None:
    """The child: receive calls on standard input, send what they return to standard output."""
    receive, send = Connection(os.dup(0), writable=False), Connection(os.dup(1), readable=False)
    # what an estimator prints must not get between the answers
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.dup2(2, 1)
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    while receive.poll(IDLE):
        try:
            function, arguments = receive.recv()
        except EOFError:
            return
        try:
            answer = (True, function(*arguments))
        except Exception as error:
            answer = (False, f"{type(error).__name__}: {error}")
        send.send(answer)


def _end_with(parent: int) -> None:
    """End at once when the parent is gone, also in the middle of a long run."""
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)


if __name__ == "__main__":
    main()
