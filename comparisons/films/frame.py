"""What a frame is: the data that one picture of a film shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from graphslam.se2 import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """What an estimator believed at one iteration or step, in its own axes.

    Attributes:
        number: of the iteration or step.
        caption: what stands above the picture.
        poses: (k, 3) the path, of a film that goes step by step as far as it has come.
        landmarks: {id: (2,) or (3,)} the map.
        landmark_covariances: {id: (n, n)}, where they are known.
        flash: a word that lights up in the picture; empty for none.
    """

    number: int
    caption: str
    poses: Array
    landmarks: Mapping[int, Array] = field(default_factory=dict)
    landmark_covariances: Mapping[int, Array] = field(default_factory=dict)
    flash: str = ""


def kept(count: int, most: int) -> np.ndarray:
    """Which of so many iterations or steps become pictures: evenly spread, the first and the last among them.

    Returns:
        (min(count, most),) increasing numbers from 0 to count - 1.
    """
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))
