"""The tables of other sensors: relations between two poses, and absolute positions, each with its noise."""

from __future__ import annotations

import numpy as np

from ..checks import first
from ..measurements import NOT_POSITIVE, not_positive
from ..se2 import Array
from .columns import COVARIANCES
from .drive import Reader, Timed, ordered
from .options import TableOptions
from .table import Table

#: relations by which the robot turns more are refused unless the unit is stated [rad]
MOST_TURN = 2 * np.pi + 1e-6
#: the coordinates of the noise
_AXES = ("x", "y", "theta")


def relations_of(table: Table, options: TableOptions) -> Timed:
    """The relations: rows (N, 12), the motions (dx, dy, dtheta) and their covariances, with the times of both poses.

    Raises:
        LogError: a column is missing, a number is none, or a covariance is not positive definite.
    """
    reader = Reader("relations", table, options)
    steps = [name for name in table.names if name.lower() in ("step", "steps", "first", "second", "step1", "step2")]
    reader.need("t1", instead=_no_steps(steps))
    reader.need("t2", "dx", "dy", "dtheta")
    table = reader.leave_out("t1", "t2", "dx", "dy", "dtheta")
    ns, ends = reader.times("t1"), reader.times("t2")
    if (k := first(ns == ends)) is not None:
        raise table.error(k, f"the relation goes from {ns[k] / 1e9:.3f} s to the same time; it ties two poses")
    motions = reader.numbers("dx", "dy", "dtheta")
    reader.refuse(
        "dtheta", motions[:, 2], np.abs(motions[:, 2]) > MOST_TURN,
        "the turn is {:g} rad, beyond 2 pi: is it in degrees?", "degrees/radians",
    )  # fmt: skip
    rows = np.column_stack([motions, _noise(reader, np.ones(len(ns), dtype=bool)).reshape(-1, 9)])
    order = np.argsort(ns, kind="stable")
    return Timed(table, ns[order], rows[order], reader.described(), ends=ends[order])


def _no_steps(steps: list[str]) -> str:
    if not steps:
        return ""
    return (
        f", and {steps[0]!r} counts steps, which tables do not have: poses are at the times of what was measured, so give "
        "the time of both poses"
    )


def positions_of(table: Table, options: TableOptions) -> Timed:
    """The absolute positions: rows (N, 14), (x, y, theta or NaN), covariances with NaN likewise, and levers.

    Raises:
        LogError: a column is missing, a number is none, or a covariance is not positive definite.
    """
    reader = Reader("positions", table, options)
    reader.need("t", "x", "y")
    table = reader.leave_out("x", "y")
    ns = reader.times()
    places = np.column_stack([reader.numbers("x", "y"), np.full(len(ns), np.nan)])
    if reader.has("theta"):
        # an empty cell: the heading is not known there
        places[:, 2:] = reader.numbers("theta", finite=False)
        turned = np.nan_to_num(places[:, 2])
        reader.refuse(
            "theta", turned, np.abs(turned) > 8 * np.pi, "the heading is {:g} rad: is it in degrees?", "degrees/radians"
        )
    covariances = _noise(reader, np.isfinite(places[:, 2]))
    levers = np.zeros((len(ns), 2))
    for column, role in enumerate(("lever_x", "lever_y")):
        if reader.has(role):
            levers[:, column] = reader.numbers(role)[:, 0]
    ns, order, notes = ordered(reader, ns)
    rows = np.column_stack([places, covariances.reshape(-1, 9), levers])[order]
    return Timed(table, ns, rows, reader.described(), notes=notes)


def _noise(reader: Reader, oriented: np.ndarray) -> Array:
    """The covariances (N, 3, 3) of rows; those of headings are NaN where these are not measured, (N,) bool ``oriented``."""
    d, covariances = 3 if oriented.any() else 2, np.zeros((len(oriented), 3, 3))
    if reader.has("cov_xx"):
        reader.need("cov_xx", "cov_yy", *(("cov_thetatheta",) if d == 3 else ()))
        entries = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
        for role, (i, j) in zip(COVARIANCES, entries):
            if reader.has(role) and j < d:
                covariances[:, i, j] = covariances[:, j, i] = reader.numbers(role, finite=j < 2)[:, 0]
    else:
        if reader.has("sigma") and not reader.has("sigma_x"):
            both = reader.numbers("sigma")
            deviations = np.column_stack([both, both])
        else:
            reader.need("sigma_x", "sigma_y", instead=", and none for cov_xx, cov_yy instead of standard deviations")
            deviations = reader.numbers("sigma_x", "sigma_y")
        if d == 3:
            deviations = np.column_stack([deviations, reader.numbers("sigma_theta", finite=False)])
        for axis, column in enumerate(deviations.T):
            used = np.ones(len(column), dtype=bool) if axis < 2 else oriented
            if (k := first(used & ~(column > 0))) is not None:
                raise reader.table.error(
                    k, f"the standard deviation of {_AXES[axis]} is {column[k]:g}, but it must be above zero: how far off "
                    "the sensor usually is",
                )  # fmt: skip
            covariances[:, axis, axis] = column**2
    for size, rows in ((2, np.flatnonzero(~oriented)), (3, np.flatnonzero(oriented))):
        wrong = not_positive(np.nan_to_num(covariances[rows, :size, :size]))
        if (k := first(wrong)) is not None:
            raise reader.table.error(int(rows[k]), f"the covariance {NOT_POSITIVE}")
    covariances[~oriented, 2] = covariances[~oriented, :, 2] = np.nan
    return covariances
