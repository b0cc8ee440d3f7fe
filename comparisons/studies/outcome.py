"""What came out of one run: the columns of the study's table."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass, field
from datetime import UTC, datetime

#: a run ended well, raised (or its process died), or took longer than it may
DONE, ERROR, TIMEOUT = "done", "error", "timeout"


def _here() -> str:
    return f"{platform.node()}:{os.getpid()}"


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """The outcome of a run; a figure that does not exist or cannot be known is None.

    Attributes:
        key: of the run, see `plan.Run.key`.
        status: `DONE`, `ERROR` or `TIMEOUT`.
        error: one sentence where the status is not `DONE`.
        converged, iterations, cost: as `comparisons.comparison.Row` has them.
        ate_m, rpe_m, rpe_rad, landmark_rmse_m: errors against the truth, see `graphslam.metrics`.
        seconds: the estimation alone.
        total_seconds: the whole run, with reading the log, setting up and measuring.
        poses_sha256: the first 16 digits of the digest of the estimated poses: equal where they are equal bit for bit.
        process: host and process that did it.
        ended: the time, UTC.
    """

    key: str
    status: str = DONE
    error: str | None = None
    converged: bool | None = None
    iterations: int | None = None
    cost: float | None = None
    ate_m: float | None = None
    rpe_m: float | None = None
    rpe_rad: float | None = None
    landmark_rmse_m: float | None = None
    seconds: float | None = None
    total_seconds: float | None = None
    poses_sha256: str | None = None
    process: str = field(default_factory=_here)
    ended: str = field(default_factory=_now)
