"""Results as a recording of Rerun (.rrd).

Entities of each estimate NAME, and of the ground truth, truth; the timeline "time" counts seconds since the first pose::

    NAME/pose        the robot as a point and an arrow; x, y, heading and their covariance as numbers in full precision
    NAME/path        the whole drive
    NAME/landmarks   the map with ellipses of three standard deviations; ids, x, y and covariances as numbers
    error/NAME       position error [m], where the truth is known
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from graphslam import OptionError
from graphslam.files import write_whole
from graphslam.metrics import position_errors
from graphslam.se2 import Array

from ..comparison import Comparison
from ..exchange import elapsed_of
from ..show.ellipses import ellipses
from ..show.style import colour_of
from .tracks import Track, tracks

INSTALL = "Rerun recordings are written by the package rerun-sdk: pip install -e '.[rerun]' in the clone"
TIMELINE = "time"


def check_rerun() -> None:
    """Raise `OptionError` with what to install where the optional package is missing."""
    try:
        import rerun  # noqa: F401
    except ImportError:
        raise OptionError(INSTALL) from None


def write_rerun(comparison: Comparison, path: Path) -> None:
    """Write the results of a comparison as a Rerun recording, whole or not at all.

    Raises:
        OptionError: the package is missing.
        FormatError: the file cannot be written.
    """
    check_rerun()
    import rerun as rr

    with write_whole(path) as temporary:
        recording = rr.RecordingStream("virtual-motion-slam", recording_id=comparison.log.name)
        recording.save(temporary)
        for track in tracks(comparison):
            if len(track.poses):
                _write_track(rr, recording, track)
        for name, seconds, errors in _errors(comparison):
            times = rr.TimeColumn(TIMELINE, duration=seconds)
            rr.send_columns(f"error/{name}", [times], rr.Scalars.columns(scalars=errors), recording=recording)
        recording.flush()
        recording.disconnect()


def _write_track(rr: Any, recording: Any, track: Track) -> None:
    color = _rgb("#000000" if track.name == "truth" else colour_of(track.name))
    x, y, heading = track.poses.T
    times = rr.TimeColumn(TIMELINE, duration=track.seconds)
    numbers = {"x": x, "y": y, "heading": heading}
    if track.covariances is not None:
        numbers |= _named(track.covariances)
    arrows = np.column_stack([np.cos(heading), np.sin(heading)]) * 0.3
    rr.send_columns(
        f"{track.name}/pose",
        [times],
        [
            *rr.Arrows2D.columns(origins=track.poses[:, :2], vectors=arrows, colors=[color] * len(x)),
            *rr.AnyValues.columns(**numbers),
        ],
        recording=recording,
    )
    recording.log(f"{track.name}/path", rr.LineStrips2D([track.path[:, :2]], colors=[color]), static=True)
    if not track.landmarks:
        return
    ids = sorted(track.landmarks)
    places = np.array([np.append(track.landmarks[id], np.nan)[:3] for id in ids])
    known = {id: C for id in ids if (C := track.landmark_covariances.get(id)) is not None and np.isfinite(C).all()}
    values = {"id": np.array(ids), "x": places[:, 0], "y": places[:, 1], "heading": places[:, 2]}
    values |= _named(np.array([_padded(known.get(id)) for id in ids]))
    recording.log(
        f"{track.name}/landmarks",
        rr.Points2D(places[:, :2], colors=[color], labels=[str(id) for id in ids], radii=0.04),
        rr.AnyValues(**values),
        static=True,
    )
    if known:
        curves = ellipses(track.landmarks, known)
        recording.log(f"{track.name}/landmarks/ellipses", rr.LineStrips2D(list(curves), colors=[color]), static=True)


def _named(covariances: Array) -> dict[str, Array]:
    """The numbers of covariances (n, 3, 3), by the names of `graphslam.map_files.COVARIANCE`."""
    places = {"var_x": (0, 0), "cov_xy": (0, 1), "var_y": (1, 1), "cov_x_heading": (0, 2), "cov_y_heading": (1, 2)}
    return {name: covariances[:, i, j] for name, (i, j) in (*places.items(), ("var_heading", (2, 2)))}


def _padded(covariance: Array | None) -> Array:
    """A covariance as (3, 3), NaN where it is not known."""
    whole = np.full((3, 3), np.nan)
    if covariance is not None:
        whole[: len(covariance), : len(covariance)] = covariance
    return whole


def _errors(comparison: Comparison) -> Any:
    log = comparison.log
    if log.true_poses is None:
        return
    seconds = elapsed_of(log)
    for result in comparison.results:
        if np.count_nonzero(result.estimated & log.covered) >= 2:
            errors = position_errors(log.true_poses, log.at_truth(result.poses), mask=result.estimated)
            known = np.isfinite(errors)
            yield result.name, seconds[known], errors[known]


def _rgb(color: str) -> tuple[int, int, int]:
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)
