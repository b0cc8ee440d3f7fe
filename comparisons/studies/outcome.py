"""The outcome of one run: the columns of a study's table."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass, field
from datetime import UTC, datetime

#: a run ended well, raised (or its process died), or took longer than the limit
DONE, ERROR, TIMEOUT = "done", "error", "timeout"


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """The outcome of a run; a figure that does not exist or cannot be known is None.

    Attributes:
        key: of the run, see `plan.Run.key`.
        status: `DONE`, `ERROR` or `TIMEOUT`.
        error: one sentence where the status is not `DONE`.
        converged, iterations, cost, cost_per_dof: as in `comparisons.comparison.Row`.
        proven: whether the end is proven to be the global minimum of J; None where no proof applies.
        ate_m, rpe_m, rpe_rad, landmark_rmse_m: errors against the ground truth, see `graphslam.metrics`.
        seconds: the estimation alone.
        total_seconds: the whole run, with reading the log, setting up and computing the errors.
        poses_sha256: the first 16 digits of the digest of the estimated poses, equal where the poses are exactly equal.
        process: host and process that did it.
        ended: the time, UTC.
    """

    key: str
    status: str = DONE
    error: str | None = None
    converged: bool | None = None
    iterations: int | None = None
    cost: float | None = None
    cost_per_dof: float | None = None
    proven: bool | None = None
    ate_m: float | None = None
    rpe_m: float | None = None
    rpe_rad: float | None = None
    landmark_rmse_m: float | None = None
    seconds: float | None = None
    total_seconds: float | None = None
    poses_sha256: str | None = None
    process: str = field(default_factory=lambda: f"{platform.node()}:{os.getpid()}")
    ended: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="milliseconds"))
