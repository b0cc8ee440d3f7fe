"""MATLAB files: the variables a layout asks for, or a sentence on what is there instead."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat, whosmat
from scipy.io.matlab import MatReadError

from ..errors import FormatError
from ..files import check_file
from ..se2 import Array


def is_mat(head: bytes) -> bool:
    """Whether the first bytes of a file are those of a MATLAB file (version 5 to 7)."""
    return head.startswith(b"MATLAB 5.0 MAT-file")


def variables(path: Path) -> set[str]:
    """The names of the variables of a MATLAB file; none where it cannot be read."""
    try:
        return {name for name, _, _ in whosmat(path)}
    except (ValueError, TypeError, NotImplementedError, OSError, MatReadError):
        return set()


def read_mat(path: Path, names: Collection[str]) -> dict[str, np.ndarray]:
    """The named variables of a MATLAB file.

    Raises:
        FormatError: the file cannot be read, or has another layout: a variable is missing.
    """
    check_file(path)
    try:
        content: dict[str, Any] = loadmat(path)
    except NotImplementedError:
        raise FormatError(
            path, None, "a MATLAB file of version 7.3, which is HDF5; save it with -v7 in MATLAB to have it read here"
        ) from None
    except (ValueError, TypeError, OSError, MatReadError) as error:
        raise FormatError(path, None, f"not a readable MATLAB file ({error}); was it cut short?") from None
    missing = [name for name in names if name not in content]
    if missing:
        found = ", ".join(sorted(name for name in content if not name.startswith("__"))) or "nothing"
        raise FormatError(
            path, None, f"a .mat of another layout: expected the variables {', '.join(names)}, but {missing[0]!r} is "
            f"missing (found: {found})",
        )  # fmt: skip
    return {name: content[name] for name in names}


def numbers(path: Path, name: str, value: np.ndarray, shape: tuple[int | None, ...]) -> Array:
    """A variable as finite floats of a shape, None for any length.

    Raises:
        FormatError: it is something else.
    """
    wanted = " x ".join("N" if want is None else str(want) for want in shape)
    if value.dtype.kind not in "iufb":
        raise FormatError(path, None, f"the variable {name!r} should be numbers, {wanted}")
    # unsigned integers, as some files have them, would wrap around below zero
    array = np.asarray(value, dtype=float)
    if array.ndim != len(shape) or any(want not in (None, have) for want, have in zip(shape, array.shape)):
        have = " x ".join(map(str, array.shape))
        raise FormatError(path, None, f"the variable {name!r} should be {wanted}, but is {have}")
    if not np.all(np.isfinite(array)):
        raise FormatError(path, None, f"the variable {name!r} has entries that are not finite")
    return array
