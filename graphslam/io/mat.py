"""MATLAB files: the variables that a layout needs, with their shapes checked.

`variables` reads MATLAB files of version 5 to 7: numbers, and cells of numbers. SciPy's reader trusts the lengths in a file,
and a damaged file can end the process (SciPy 1.15: signal 11). This one checks every length against the bytes that are there.

Source: MathWorks, *MAT-File Format*, chapter 1, version 5.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from ..errors import FormatError, named, quoted
from ..files import MOST_BYTES, check_file
from ..se2 import Array

HEADER = 128
MATRIX, COMPRESSED = 14, 15
#: the NumPy type of each type of data
TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
#: the NumPy type of each class of numeric arrays, which may be stored in a smaller one
CLASSES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
CELL = 1
COMPLEX = 0x0800


def variables(data: bytes, *, names_only: bool = False) -> dict[str, np.ndarray]:
    """{name: array} of all variables; those of other kinds than numbers and cells are empty object arrays.

    Args:
        data: the whole file.
        names_only: leave the arrays empty.

    Raises:
        ValueError: the file is damaged, or of another version.
    """
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None or struct.unpack_from(f"{order}H", data, 124)[0] >> 8 != 1:
        raise ValueError("the header is not that of version 5")
    try:
        return dict(_variable(body, order, names_only) for body in _matrices(data[HEADER:], order))
    except (struct.error, zlib.error, IndexError, KeyError, OverflowError, RecursionError, UnicodeDecodeError) as error:
        raise ValueError(f"the data are damaged: {quoted(error)}") from None


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """The type and the bytes of each element."""
    at = 0
    while at < len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        if kind >> 16:
            # both stand in the first four bytes, and the data in the other four
            kind, size, begin = kind & 0xFFFF, kind >> 16, at + 4
            if size > 4:
                raise ValueError("a small element is too long")
            following = at + 8
        else:
            begin = at + 8
            following = begin + size + (0 if kind == COMPRESSED else -size % 8)
        if begin + size > len(data):
            raise ValueError("an element is longer than the file")
        yield kind, data[begin : begin + size]
        at = following


def _matrices(data: bytes, order: str) -> Iterator[bytes]:
    """The bytes of each array of a file; one that is compressed holds one that is not."""
    left = MOST_BYTES
    for kind, body in _elements(data, order):
        if kind == COMPRESSED:
            unpacked = zlib.decompressobj()
            plain = unpacked.decompress(body, left)
            if unpacked.unconsumed_tail:
                raise ValueError(f"its variables would take more than {MOST_BYTES / 1e9:.1f} GB")
            left -= len(plain)
            yield from (inner for inner_kind, inner in _elements(plain, order) if inner_kind == MATRIX)
        elif kind == MATRIX:
            yield body


def _variable(body: bytes, order: str, names_only: bool = False) -> tuple[str, np.ndarray]:
    """The name and the value of an array element."""
    parts = _elements(body, order)
    flags = struct.unpack_from(f"{order}I", _next(parts))[0]
    sizes = np.frombuffer(_next(parts), f"{order}i4").tolist()
    name = _next(parts).decode("latin-1")
    kind = flags & 0xFF
    if names_only or not (kind in CLASSES or kind == CELL) or flags & COMPLEX:
        return name, np.empty(0, dtype=object)
    count = math.prod(sizes)
    if min(sizes, default=-1) < 0 or len(sizes) < 2:
        raise ValueError(f"the shape of {quoted(name)} is impossible: {quoted(sizes)}")
    if kind == CELL:
        cells = np.empty(len(values := [_variable(body, order)[1] for _, body in parts]), dtype=object)
        cells[:] = values
        if len(cells) != count:
            raise ValueError(f"{quoted(name)} has {len(cells)} cells and not {count}")
        return name, cells.reshape(sizes, order="F")
    stored, content = next(parts, (0, b""))
    array = np.frombuffer(content, order + TYPES[stored]) if count else np.zeros(0)
    if len(array) != count:
        raise ValueError(f"{quoted(name)} has {len(array)} numbers and not {count}")
    with np.errstate(invalid="ignore"):
        return name, array.astype(CLASSES[kind]).reshape(sizes, order="F")


def _next(parts: Iterator[tuple[int, bytes]]) -> bytes:
    for _, content in parts:
        return content
    raise ValueError("an array is incomplete")


#: the shape of a variable: lengths, or names of lengths that several variables share
Shape = tuple[int | str, ...]


def is_mat(head: bytes) -> bool:
    """Whether the first bytes of a file are those of a MATLAB file (version 5 to 7)."""
    return head.startswith(b"MATLAB 5.0 MAT-file")


def has_variables(path: Path, head: bytes, *names: str) -> bool:
    """Whether a file with these first bytes is a readable MATLAB file with these variables."""
    if not is_mat(head):
        return False
    try:
        return variables(path.read_bytes(), names_only=True).keys() >= set(names)
    except (ValueError, OSError):
        return False


def read_mat(path: Path, shapes: Mapping[str, Shape | None]) -> dict[str, Array]:
    """The named variables of a MATLAB file, as finite floats.

    Args:
        path: the file.
        shapes: {name: shape}. A length that is a word may be any, but the same in all variables. None leaves a variable
            as it is.

    Raises:
        FormatError: the file cannot be read, or a variable is missing, or has another shape or type.
    """
    check_file(path)
    try:
        data = path.read_bytes()
        if data.startswith(b"MATLAB 7.3") or data[124:126] == b"\0\2":
            message = "a MATLAB file of version 7.3, which is HDF5; save it with -v7 in MATLAB to have it read here"
            raise FormatError(path, None, message)
        content = variables(data)
    except (ValueError, OSError) as error:
        raise FormatError(path, None, f"not a readable MATLAB file ({error}); was it cut short?") from None
    if missing := [name for name in shapes if name not in content]:
        layout = f"expected the variables {', '.join(shapes)}, but {missing[0]!r} is missing"
        has = named(sorted(content)) or "nothing"
        raise FormatError(path, None, f"a .mat of another layout: {layout} (it has: {has})")
    lengths: dict[str, int] = {}
    return {n: content[n] if s is None else numbers(path, n, content[n], s, lengths) for n, s in shapes.items()}


def numbers(path: Path, name: str, value: np.ndarray, shape: Shape, lengths: dict[str, int] | None = None) -> Array:
    """A variable as finite floats of a shape; ``lengths`` holds the named lengths found so far, and receives new ones.

    Raises:
        FormatError: it has another type or shape, or is not finite.
    """
    lengths = {} if lengths is None else lengths
    wanted = [lengths.get(want, want) if isinstance(want, str) else want for want in shape]
    text = " x ".join("N" if isinstance(want, str) else str(want) for want in wanted)
    if value.dtype.kind not in "iufb":
        raise FormatError(path, None, f"the variable {quoted(name)} should be numbers, {text}")
    # unsigned integers, which some files have, would wrap around below zero
    array = np.asarray(value, dtype=float)
    fits = array.ndim == len(shape)
    if not fits or any(want != have for want, have in zip(wanted, array.shape) if not isinstance(want, str)):
        have = " x ".join(map(str, array.shape))
        raise FormatError(path, None, f"the variable {quoted(name)} should be {text}, but is {have}")
    if not np.all(np.isfinite(array)):
        raise FormatError(path, None, f"the variable {quoted(name)} has entries that are not finite")
    lengths |= {want: have for want, have in zip(shape, array.shape) if isinstance(want, str)}
    return array
