"""What a file format of logs consists of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..log import Log


@dataclass(frozen=True)
class Format:
    """A format: its name, usual suffixes, a test of a path and its first bytes, a reader and perhaps a writer.

    A folder has no first bytes. ``options`` names what the reader takes besides the path, of those that `load` has.
    """

    name: str
    suffixes: tuple[str, ...]
    recognises: Callable[[Path, bytes], bool]
    read: Callable[..., Log]
    write: Callable[[Log, Path], None] | None = None
    options: tuple[str, ...] = ()
