"""One study at a time on one database file."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from graphslam import FormatError


@contextmanager
def only_one(path: Path) -> Iterator[None]:
    """Hold the lock ``path.lock`` while the block runs.

    The operating system gives the lock back when the process ends, however it ends, so a killed study leaves no lock
    behind. SQLite's own locks would not do: held for hours, they would shut out readers too.

    Raises:
        FormatError: another process holds it, or the file cannot be made.
    """
    lock = path.with_name(path.name + ".lock")
    while True:
        try:
            handle = os.open(lock, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError as error:
            raise FormatError(path, None, f"cannot write into {path.parent}: {error.strerror}") from None
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(handle)
            raise FormatError(
                path, None, "another study is at work on this database; wait for it, or name another database"
            ) from None
        with suppress(FileNotFoundError):
            # the last holder may have removed the file between our opening and our locking it
            if os.path.samestat(os.fstat(handle), lock.stat()):
                break
        os.close(handle)
    try:
        yield
    finally:
        lock.unlink(missing_ok=True)
        os.close(handle)
