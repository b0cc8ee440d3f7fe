"""MATLAB files: the variables that a layout needs, with their shapes checked."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..errors import FormatError, named, quoted
from ..files import check_file
from ..se2 import Array
from .mat_file import variables

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
            raise FormatError(
                path,
                None,
                "a MATLAB file of version 7.3, which is HDF5; save it with -v7 in MATLAB to have it read here",
            )
        content = variables(data)
    except (ValueError, OSError) as error:
        raise FormatError(path, None, f"not a readable MATLAB file ({error}); was it cut short?") from None
    missing = [name for name in shapes if name not in content]
    if missing:
        others = named(sorted(content)) or "nothing"
        raise FormatError(
            path,
            None,
            f"a .mat of another layout: expected the variables {', '.join(shapes)}, but {missing[0]!r} is missing "
            f"(it has: {others})",
        )
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
