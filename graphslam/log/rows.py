"""The options of `graphslam.load` that depend on the kind of data set."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import LogError
from ..errors.checks import option
from ..errors.options import check_options

#: the id of a landmark that the sensor could not identify
UNIDENTIFIED = -(2**63)
#: what many programs write where a landmark was not identified; logs and tables take it for `UNIDENTIFIED`
NO_ID = -1
#: the class of a sighting whose class is not known, where classes are words; `UNIDENTIFIED` where they are numbers
NO_CLASS = ""
#: the most classes that sightings may have: more are no kinds of landmarks
MOST_CLASSES = 100
#: rows that cannot be are left out up to this share of all; a table with more of them is refused
MOST_LEFT_OUT = 0.05
#: the most poses that ``keep_every`` may make: a tenth of a second of a whole day
MOST_POSES = 1_000_000


def robot_class(number: int) -> str:
    """The class of a sighting of a robot."""
    return f"robot {number}"


@dataclass(frozen=True, kw_only=True)
class ReadOptions:
    """Options of `load`. The metadata "needs" names the property of a `io.base.Format` that an option requires.

    Raises:
        OptionError: an option has an impossible value.
    """

    robot: int | None = option(None, "The robot of a data set that has several.", minimum=0, needs="several_robots")
    keep_every: float | None = option(
        None, "Also keep a pose at least once in this time, even where nothing was seen.", "s", positive=True,
        default_text="poses only where something was seen",
    )  # fmt: skip
    strict: bool = option(
        False,
        "Refuse a log at the first row that cannot be, such as a negative range, instead of leaving such rows out.",
    )

    def __post_init__(self) -> None:
        check_options(self)


@dataclass(frozen=True)
class Fault:
    """Rows of a table that cannot be.

    Attributes:
        rows: (N,) bool.
        what: what they have, for the note: "a negative range".
        message: the sentence about one row, for the error.
    """

    rows: np.ndarray
    what: str
    message: Callable[[int], str]


def sound_rows(
    total: int,
    noun: str,
    faults: Sequence[Fault],
    error: Callable[[int, str], LogError],
    *,
    strict: bool = False,
    source: str = "",
) -> tuple[np.ndarray, tuple[str, ...]]:
    """The rows (N,) bool of a table that can be, and notes on those that are left out.

    Args:
        total: N.
        noun: what the rows are, "sightings".
        faults: what is wrong; a row with several counts for the first.
        error: the error of a row.
        strict: refuse the first such row.
        source: what notes call the table.

    Raises:
        LogError: a row is wrong and ``strict`` is set, or more than `MOST_LEFT_OUT` of all are.
    """
    kept = np.ones(total, dtype=bool)
    notes = []
    for fault in faults:
        new = fault.rows & kept
        if not (count := int(np.count_nonzero(new))):
            continue
        first = int(np.argmax(new))
        message, share = (
            fault.message(first),
            f"{count:,} of {total:,} {noun} {'has' if count == 1 else 'have'} {fault.what}",
        )
        if strict or total - np.count_nonzero(kept & ~new) > MOST_LEFT_OUT * total:
            also = f"; {share}" if count > 1 else ""
            raise error(first, message + also)
        kept &= ~new
        failed = error(first, "")
        line = getattr(failed, "line", None)
        place = f"row {first + 1}" if line is None else f"line {line}"
        place = place if count == 1 else f"the first in {place}"
        notes.append(f"{source}: {share}: left out ({place})" if source else f"{share}: left out ({place})")
    return kept, tuple(notes)


def finite_fault(values: np.ndarray, title: str, advice: str = "; remove the row, or repair it") -> Fault:
    """The rows in which a column (N,) is no finite number."""
    return Fault(
        ~np.isfinite(values),
        f"{title} empty, NaN or infinite",
        lambda k: f"{title} is {'empty or NaN' if np.isnan(values[k]) else values[k]}{advice}",
    )


def range_faults(ranges: np.ndarray) -> list[Fault]:
    """The rows whose range (N,) [m] is negative, or zero."""
    return [
        Fault(
            ranges < 0, "a negative range",
            lambda k: f"the range is {ranges[k]:g} m, but a range is above zero: are range and bearing swapped?",
        ),
        Fault(
            ranges == 0, "a range of 0",
            lambda k: f"the range is {ranges[k]:g} m, but a range is above zero: remove rows in which nothing was seen",
        ),
    ]  # fmt: skip
