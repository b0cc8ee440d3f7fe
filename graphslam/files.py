"""Files are read with a clear word when they cannot be, and written whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import FormatError


def check_file(path: str | os.PathLike[str]) -> None:
    """Raise `FormatError` unless ``path`` is a file that can be read."""
    path = Path(path)
    if not path.exists():
        raise FormatError(path, None, "there is no such file")
    if path.is_dir():
        raise FormatError(path, None, "this is a folder; a file is needed here")
    if not os.access(path, os.R_OK):
        raise FormatError(path, None, "the file cannot be read (no permission)")


@contextmanager
def write_whole(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path in the same folder; it takes the place of ``path`` only if the block ends well.

    A link stays, and what it points to is replaced. Pipes and devices, which would be lost, are refused.

    Raises:
        FormatError: the folder does not exist or cannot be written, or ``path`` is no place for a file.
    """
    named = Path(path)
    check_place(named)
    path = named.resolve()
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
        os.close(handle)
    except OSError as error:
        raise FormatError(path, None, f"cannot write into {path.parent}: {error.strerror}") from None
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(path)
    except OSError as error:
        raise FormatError(path, None, f"cannot be written: {error.strerror}") from None
    finally:
        with suppress(FileNotFoundError):
            temporary.unlink()


def check_place(path: Path) -> None:
    """Raise `FormatError` if ``path`` is a folder, or a pipe or device, which no file can take the place of."""
    if path.is_dir():
        raise FormatError(path, None, "this is a folder; give the name of a file to write")
    if path.exists() and not path.is_file():
        raise FormatError(
            path, None, "this is a pipe or device and no file; use - for standard output, or a file's name"
        )


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
