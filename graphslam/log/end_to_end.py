"""Two drives as one log: the second one's steps follow those of the first, and nothing is known of the way between them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields, replace

import numpy as np

from ..models import ANYWHERE, additional_variances
from ..se2 import Array
from .log import Log
from .measurements import MEASURED, Measured, Session


def end_to_end(first: Log, second: Log) -> Log:
    """The log of both, with controls; the second is in the frame of the first.

    From the last pose of the first to the first pose of the second leads a control of a second with the variances
    `ANYWHERE`. The noise models are those of the first.
    """
    a, b = first, second
    assert a.controls is not None and b.controls is not None and a.dt is not None and b.dt is not None
    poses, pieces = a.num_poses, len(a.controls) + 1
    of_first, of_second = (additional_variances(each.control_variances, len(each.controls)) for each in (a, b))  # type: ignore[arg-type]

    def both(name: str) -> Array | None:
        one, other = getattr(a, name), getattr(b, name)
        return None if one is None or other is None else np.concatenate([one, other])

    def with_unknown(name: str, sizes: Sequence[int]) -> Array | None:
        """Rows of both, NaN for the one that has none."""
        rows = [getattr(each, name) for each in (a, b)]
        if all(each is None for each in rows):
            return None
        return np.concatenate([np.full((n, 3), np.nan) if each is None else each for each, n in zip(rows, sizes)])

    recorded = [each.dt if each.recorded_dt is None else each.recorded_dt for each in (a, b)]
    truth = with_unknown("true_poses", (poses, b.num_poses))
    known = [each for each in (a, b) if each.true_poses is not None]
    path = (
        with_unknown("true_path", (pieces, len(b.controls) + 1))
        if all(e.true_path is not None for e in known)
        else None
    )
    return a.replace(
        dt=np.concatenate([a.dt, [1.0], b.dt]),
        controls=np.concatenate([a.controls, np.zeros((1, 2)), b.controls]),
        control_starts=np.concatenate([a.control_starts, pieces + b.control_starts]),
        control_variances=np.concatenate([of_first, [ANYWHERE], of_second]),
        recorded_dt=np.concatenate([recorded[0], [1.0], recorded[1]]),
        steps=np.concatenate([a.steps, poses + b.steps]),
        landmarks=both("landmarks"),
        sightings=both("sightings"),
        classes=both("classes"),
        initial_poses=both("initial_poses"),
        true_poses=truth,
        true_path=path,
        true_landmarks={**(b.true_landmarks or {}), **(a.true_landmarks or {})} or None,
        **{name: _shifted(getattr(a, name), getattr(b, name), poses) for name in MEASURED},
        notes=(*_of_each(a, a.notes), *_of_each(b, b.notes)),
        doubts=(*a.doubts, *b.doubts),
        sessions=(
            *(a.sessions or (Session(a.name, 0, a.start_time),)),
            *(
                replace(each, start=poses + each.start)
                for each in b.sessions or (Session(b.name, 0, b.start_time),)
            ),
        ),
        name=f"{a.sessions[0].name} and {len(a.sessions)} more" if a.sessions else f"{a.name} and {b.name}",
    )  # fmt: skip


def joined_rows(first: Measured | None, second: Measured | None) -> Measured | None:
    """The rows of two kinds of the same measurements; None where neither has any."""
    if first is None or second is None:
        return second if first is None else first
    rows = {f.name: np.concatenate([getattr(first, f.name), getattr(second, f.name)]) for f in fields(second)}
    return replace(second, **rows)  # type: ignore[arg-type]


def _of_each(log: Log, remarks: Iterable[str]) -> Iterator[str]:
    """Remarks about a log, with its name; those about logs that were joined have it already."""
    yield from remarks if log.sessions else (f"{log.name}: {remark}" for remark in remarks)


def _shifted(first: Measured | None, second: Measured | None, poses: int) -> Measured | None:
    """The measurements of two logs, the steps of the second counted from ``poses`` on."""
    if second is not None:
        second = second.moved({end: getattr(second, end) + poses for end in second.ENDS})
    return joined_rows(first, second)
