"""Checks of paths, files that are written completely or not at all, and TOML files whose keys know their lines."""

from __future__ import annotations

import io
import math
import os
import re
import tempfile
import tomllib
from bisect import bisect_left
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from .errors import FormatError, OptionError, quoted, shortened
from .errors.checks import from_home, suggestion

T = TypeVar("T")

#: what compressed files may unpack to: a log of 20 million sightings
MOST_BYTES = 2**30
#: first bytes of files that are compressed as a whole -> the program that unpacks them
_PACKED = {
    b"\x1f\x8b": "gunzip",
    b"\x28\xb5\x2f\xfd": "unzstd",
    b"\x04\x22\x4d\x18": "unlz4",
    b"BZh": "bunzip2",
    b"\xfd7zXZ": "unxz",
    b"PK\x03\x04": "unzip",
}


def check_unpacked(path: Path, head: bytes) -> None:
    """Raise `FormatError` for a file whose first bytes say that it is compressed as a whole."""
    if path.suffix == ".npz" and head.startswith(b"PK"):
        message = "this is an archive of NumPy, such as a log of graphslam.save; graphslam.load reads it"
        raise FormatError(path, None, message)
    for first, program in _PACKED.items():
        if head.startswith(first):
            raise FormatError(path, None, f"the file is compressed as a whole; unpack it first: {program} {path.name}")


def first_bytes(path: Path) -> bytes:
    """The first bytes of a file, by which formats are recognised; none of a folder."""
    if path.is_dir():
        return b""
    with path.open("rb") as stream:
        return stream.read(4096)


def path_of(path: object) -> Path:
    """A path given as text or as a path; "~" at its start is the home folder, as in a shell.

    Raises:
        OptionError: it is something else.
    """
    try:
        return from_home(Path(path))  # type: ignore[arg-type]
    except TypeError:
        raise OptionError(f"the path of a file is text or a Path, not {quoted(path)}") from None


def read_archive(path: Path, kind: str) -> dict[str, Any]:
    """The arrays of an .npz archive of a kind, such as "a log".

    Raises:
        FormatError: it cannot be read, or would take too much memory.
    """
    try:
        # from memory: np.load leaves a file open that turns out not to be an archive
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as archive:
            # a small file can claim to hold any number of zeros
            if (size := sum(entry.file_size for entry in archive.zip.infolist())) > MOST_BYTES:
                message = f"its arrays would take {size / 1e9:.1f} GB; those of {kind} take at most 1 GB"
                raise FormatError(path, None, message)
            return {name: archive[name] for name in archive.files}
    except FormatError:
        raise
    except Exception as error:  # what a damaged archive raises depends on the byte
        message = f"not a readable .npz archive ({shortened(str(error))}); was it cut short?"
        raise FormatError(path, None, message) from None


def check_path(path: Path) -> None:
    """Raise `FormatError` where the system refuses the path itself: it is too long, holds a zero byte or links to itself."""
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        pass
    except OSError as error:
        raise FormatError(shortened(str(path)), None, f"this path cannot be used: {error.strerror}") from None
    except ValueError:
        raise FormatError(shortened(str(path)), None, "this path cannot be used: it holds a zero byte") from None


def check_file(path: str | os.PathLike[str]) -> None:
    """Raise `FormatError` unless ``path`` is a file that can be read."""
    path = path_of(path)
    check_path(path)
    if not path.exists():
        raise FormatError(path, None, "there is no such file")
    if path.is_dir():
        raise FormatError(path, None, "this is a folder; a file is needed here")
    if not path.is_file():
        # a device may have no end, and a pipe can be read only once
        raise FormatError(path, None, "this is a pipe or device; write its content to a file and give the name of that")
    if not os.access(path, os.R_OK):
        raise FormatError(path, None, "the file cannot be read (no permission)")


def read_text(path: Path) -> str:
    """The text of a file in UTF-8, with or without a byte-order mark, or in UTF-16 with one.

    Raises:
        FormatError: the file cannot be read, or is not text.
    """
    check_file(path)
    try:
        content = path.read_bytes()
        text = content.decode("utf-16" if content.startswith((b"\xff\xfe", b"\xfe\xff")) else "utf-8-sig")
    except UnicodeDecodeError as error:
        check_unpacked(path, content)
        message = "not a text file in UTF-8; if it is in another encoding, save it as UTF-8: "
        message += "iconv -f latin1 -t utf-8 OLD > NEW"
        if error.encoding.startswith("utf-16"):
            message = "not a readable text file in UTF-16; was it cut short?"
        raise FormatError(path, None, message) from None
    except OSError as error:
        raise FormatError(path, None, f"cannot be read: {error.strerror}") from None
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


@contextmanager
def write_whole(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path in the same folder, which replaces ``path`` only if the block ends without an error.

    A link stays, and the file it points to is replaced. Pipes and devices, which would be lost, are refused.

    Raises:
        FormatError: the folder does not exist or cannot be written, or ``path`` cannot be the name of a file.
    """
    named = path_of(path)
    check_place(named)
    path = named.resolve()
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.stem[:50]}-", suffix=path.suffix, dir=path.parent)
        os.close(handle)
    except OSError as error:
        raise FormatError(path, None, f"cannot write into {path.parent}: {error.strerror}") from None
    temporary = Path(name)
    try:
        yield temporary
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        temporary.replace(path)
    except OSError as error:
        raise FormatError(path, None, f"cannot be written: {error.strerror}") from None
    finally:
        with suppress(FileNotFoundError):
            temporary.unlink()


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a text file in UTF-8 whole or not at all; see `write_whole`."""
    with write_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def check_place(path: Path) -> None:
    """Raise `FormatError` if ``path`` is a folder, a pipe or a device, which a file must not replace, or no possible path."""
    check_path(path)
    if path.is_dir():
        raise FormatError(path, None, "this is a folder; give the name of a file to write")
    if path.exists() and not path.is_file():
        message = "this is a pipe or device and no file; use - for standard output, or a file's name"
        raise FormatError(path, None, message)


def number(path: Path, line: int, what: str, word: str, *, finite: bool = True) -> float:
    """A word as a number, which has to be ``finite``.

    Raises:
        FormatError: it is none; the message begins with ``what`` it should be.
    """
    value = _of_word(path, line, what, word, float, "a number")
    if finite and not math.isfinite(value):
        raise FormatError(path, line, f"{what} is {shortened(word)}; only finite numbers are allowed")
    return value


def whole(path: Path, line: int, what: str, word: str) -> int:
    """A word as a whole number of at most 64 bits.

    Raises:
        FormatError: it is none; the message begins with ``what`` it should be.
    """
    value = _of_word(path, line, what, word, int, "a whole number")
    if not -(2**63) <= value < 2**63:
        raise FormatError(path, line, f"{what} should be a whole number of at most 64 bits, not {quoted(word)}")
    return value


def _of_word(path: Path, line: int, what: str, word: str, kind: Callable[[str], T], expected: str) -> T:
    with suppress(ValueError):
        # Python reads 1_0 as 10, other programs do not
        if "_" not in word:
            return kind(word)
    raise FormatError(path, line, f"{what} should be {expected}, not {quoted(word)}")


#: how messages name the types that a key may have
TYPE_NAMES = {str: "text in quotes", int: "a whole number", float: "a number", bool: "true or false", list: "a list [..]",
              dict: "a table"}  # fmt: skip


class TomlFile:
    """A TOML file and its content, which can name the line of a key.

    Args:
        path: of the file.

    Attributes:
        path, text, table: the file, its text, and its content.

    Raises:
        FormatError: there is no such file, or it is not valid TOML; with the line.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.text = path, read_text(path)
        try:
            self.table: dict[str, Any] = tomllib.loads(self.text)
        except RecursionError:
            raise FormatError(path, None, "lists or tables are nested more deeply than any option is") from None
        except tomllib.TOMLDecodeError as error:
            found = re.search(r"\(at line (\d+), column \d+\)$", str(error))
            message, line = shortened(re.sub(r" \(at .*\)$", "", str(error))), int(found[1]) if found else None
            statement = self.text.split("\n")[line - 1] if line else ""
            bare = re.fullmatch(r"\s*([\w.-]+)\s*=\s*([A-Za-z_/~.][^\"'#=]*?)\s*(#.*)?", statement.rstrip("\r"))
            if bare and bare[2] not in ("true", "false", "inf", "nan"):
                message = f'{message}; text stands in quotes: {bare[1]} = "{shortened(bare[2])}"'
            raise FormatError(path, line, f"not valid TOML: {message}") from None
        except ValueError:
            # Python reads whole numbers of at most 4,300 digits
            long = re.search(r"[0-9_]{4000}", self.text)
            line = self.text.count("\n", 0, long.start()) + 1 if long else None
            raise FormatError(path, line, "a whole number has thousands of digits, more than can be read") from None

    def error(self, key: str, message: str) -> FormatError:
        """The error of a key, "table.key" where it stands in a table, with its line where it can be determined."""
        return FormatError(self.path, self.line_of(key), message)

    def line_of(self, key: str) -> int | None:
        """The line on which the statement begins that sets a key, "table.key" or "tables[1].key"; None if there is none.

        The first lines that have the key are found by bisection.
        """
        path, lines = re.findall(r"[^.\[\]]+", key), self.text.split("\n")
        if not _holds(self.table, path):
            return None
        end = bisect_left(range(len(lines)), True, key=lambda end: _holds(_whole(lines, end)[0], path))
        # one statement, perhaps below comments
        begin = _whole(lines, end - 1)[1]
        return next(k for k in range(begin, end) if lines[k].strip() and lines[k].lstrip()[0] != "#") + 1

    def check_keys(self, table: Mapping[str, Any], known: Collection[str], where: str = "") -> None:
        """Raise `FormatError` for the first key that is not known; the message names the nearest one that is.

        Args:
            table: whose keys are checked.
            known: the keys that may be there.
            where: the name of the table, for the message.
        """
        for key in table:
            if key not in known:
                place = f" in [{where}]" if where else ""
                raise self.error(
                    f"{where}.{key}" if where else key,
                    f"unknown key {quoted(key)}{place}" + (suggestion(key, known) or f"; known are {', '.join(known)}"),
                )

    def value(self, table: Mapping[str, Any], key: str, *types: type, where: str = "") -> Any:
        """The value of a key, None where it is absent. A whole number may stand for a float.

        Raises:
            FormatError: it is of none of the types.
        """
        value = table.get(key)
        if value is None or (type(value) in types):
            return value
        place = f"{where}.{key}" if where else key
        if float in types and type(value) is int:
            try:
                return float(value)
            except OverflowError:
                raise self.error(place, f"{place} has {len(str(value))} digits, more than a number can have") from None
        raise self.error(place, f"{place} should be {' or '.join(TYPE_NAMES[t] for t in types)}, not {quoted(value)}")

    def attempt(self, make: Callable[[], T], where: str = "") -> T:
        """The result of a function; its `OptionError` becomes a `FormatError` with the line of the option.

        Args:
            make: its error message begins with the name of the option.
            where: the table of the option.
        """
        try:
            return make()
        except OptionError as error:
            name = str(error).split()[0].rstrip(":")
            raise self.error(f"{where}.{name}" if where else name, str(error)) from None


def _whole(lines: Sequence[str], end: int) -> tuple[dict[str, Any], int]:
    """The content of the whole statements among the first lines up to ``end``, and the number of lines that these take."""
    while True:
        with suppress(tomllib.TOMLDecodeError):
            return tomllib.loads("\n".join(lines[:end])), end
        end -= 1


def _holds(value: Any, path: Sequence[str]) -> bool:
    """Whether a table has the key of a path; digits count the tables of an array."""
    for part in path:
        if isinstance(value, list):
            if not part.isdigit() or int(part) >= len(value):
                return False
            value = value[int(part)]
        elif isinstance(value, Mapping) and part in value:
            value = value[part]
        else:
            return False
    return True
