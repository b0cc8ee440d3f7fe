"""What a file format of logs consists of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..log import Log


@dataclass(frozen=True)
class Format:
    """A file format: its name, usual suffixes, a test of a file's first bytes, a reader and perhaps a writer."""

    name: str
    suffixes: tuple[str, ...]
    recognises: Callable[[bytes], bool]
    read: Callable[[Path], Log]
    write: Callable[[Log, Path], None] | None = None
