"""`synchronize`: odometry, sightings and ground truth with separate times, brought together in one `Log`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..log import Log
from ..reading import ReadOptions
from ..sources.streams import Stream, parts_of_streams


def synchronize(
    odometry: Stream,
    sightings: Stream,
    landmarks: np.ndarray,
    *,
    options: ReadOptions | None = None,
    truth: Stream | None = None,
    truth_offset: tuple[float, float] = (0.0, 0.0),
    true_landmarks: Mapping[int, ArrayLike] | None = None,
    classes: ArrayLike | None = None,
    start: ArrayLike | None = None,
    origin: float = 0.0,
    name: str = "log",
    notes: tuple[str, ...] = (),
    **models: Any,
) -> Log:
    """The log of a robot whose odometry, sightings and ground truth have separate times.

    Args:
        odometry: controls (nu, omega) (N, 2), each held until the time of the next one. Rows of every stream that are out
            of order by at most `MOST_DISORDER` are sorted, with a note.
        sightings: (K, 2 or 3); those before the first or after the last odometry are left out, with a note.
        landmarks: (K,) ids.
        options: ``keep_every``, the greatest time between poses; default: poses only where something was seen.
        truth: poses (G, 3), interpolated in SE(2), or positions (G, 2), interpolated along lines.
        truth_offset: the point of the robot to which the truth belongs, see `Log`.
        true_landmarks: {id: position}.
        classes: (K,) what each sighting looks like, see `Log`.
        start: the first pose (3,); default: the true one, or (0, 0, 0) where it is unknown.
        origin: the time from which the times of the streams count [s]; it is added to ``start_time`` of the log only.
        name, notes, models: of the `Log`.

    Odometry that is silent for longer than `BRIDGED_GAP` is bridged by `bridge`, with noise and a warning. The truth is
    unknown between samples farther apart than `TRUTH_GAP`.

    Raises:
        LogError: nothing is seen while there is odometry, or times run backwards by more than `MOST_DISORDER`.
    """
    parts = parts_of_streams(
        odometry, sightings, landmarks, options=options, truth=truth, truth_offset=truth_offset,
        true_landmarks=true_landmarks, classes=classes, start=start, origin=origin, name=name, notes=notes, **models,
    )  # fmt: skip
    return Log(**parts)
