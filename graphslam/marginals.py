"""Arguments and shapes of ``covariance(poses=..., landmarks=..., joint=False)``, the same for all estimates.

A single id gives a matrix, a list of ids one matrix per id; poses and landmarks together give a pair of both. With ``joint``
it is one matrix of all: first the poses (3 rows each), then the landmarks (2 or 3 rows each).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .errors import OptionError, quoted
from .se2 import Array


def ids_of(name: str, value: Any) -> list[int]:
    """One id, or a list of ids, as a list; None gives an empty one.

    Raises:
        OptionError: the value is neither.
    """
    if value is None:
        return []
    try:
        ids = np.asarray(value)
        if ids.ndim < 2 and (ids.size == 0 or ids.dtype.kind in "iu"):
            return list(np.atleast_1d(ids).tolist())
    except ValueError:  # lists of different lengths
        pass
    raise OptionError(f"{name} must be an id, or a list of ids, not {quoted(value)}")


def shaped(poses: Any, landmarks: Any, of_poses: list[Array], of_landmarks: list[Array]) -> Any:
    """Matrices of poses and of landmarks in the shape of the arguments that named them."""
    found = []
    for ids, blocks in ((poses, of_poses), (landmarks, of_landmarks)):
        if np.ndim(ids) == 0 and ids is not None:
            found.append(blocks[0].copy())
        elif ids is not None:
            found.append(np.array(blocks) if blocks else np.zeros((0, 3, 3)))
    return found[0] if len(found) == 1 else tuple(found)


def split(matrix: Array, poses: Any, landmarks: Any) -> Any:
    """The blocks on the diagonal of a joint covariance, in the shape of the arguments that named them."""
    count, end = len(ids_of("poses", poses)), len(ids_of("landmarks", landmarks))
    d = (len(matrix) - 3 * count) // max(end, 1)
    block: Callable[[int, int], Array] = lambda at, size: matrix[at : at + size, at : at + size]  # noqa: E731
    return shaped(
        poses, landmarks, [block(3 * k, 3) for k in range(count)], [block(3 * count + d * k, d) for k in range(end)]
    )
