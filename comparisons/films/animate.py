"""`animate`: the film of an estimator on a log."""

from __future__ import annotations

from collections.abc import Callable
from os import PathLike

from graphslam import GraphError, Log, OptionError, load
from graphslam.checks import check_choice, check_positive

from ..comparison import with_models
from ..estimator import RunOptions
from .cloud import cloud
from .film import Film
from .growth import growth
from .relaxation import relaxation

#: the estimators that there is a film of
FILMED = ("graph", "fastslam1", "fastslam2", "mcl", "isam2")
#: the most pictures of a film unless told otherwise
MAX_FRAMES = 200


def animate(
    log: Log | str | PathLike[str],
    estimator: str = "graph",
    options: RunOptions | None = None,
    *,
    max_frames: int = MAX_FRAMES,
    fps: float | None = None,
    progress: Callable[[], None] | None = None,
) -> Film:
    """Run an estimator on a log and keep what it believed on the way.

    Args:
        log: what the robot did and saw, or the file or folder of it.
        estimator: one of `FILMED`. The film of ``graph`` has one picture per iteration, its edges coloured by their
            Mahalanobis distances; the others have one per step: particles, ellipses and resamplings of a filter, the
            corrections that ``isam2`` makes to the path so far.
        options: what the estimator is told; default: the log's models, else the book's, and the graph that fits.
        max_frames: the most pictures; of longer runs evenly spread ones are kept, the first and the last among them.
        fps: pictures per second; default: 2 for iterations, 10 for steps.
        progress: called after each step of the estimators that go step by step.

    Returns:
        The film: ``film.save("out.gif")``, ``film.frames[-1].poses``; in a notebook it shows itself.

    Raises:
        OptionError: an option has an impossible value.
        SlamError: the estimator cannot run on this log.
    """
    check_choice("estimator", estimator, FILMED)
    if max_frames < 2:
        raise OptionError(f"max_frames must be at least 2, not {max_frames}")
    if fps is not None:
        check_positive(fps=fps)
    if not isinstance(log, Log):
        log = load(log)
    if len(log.steps) == 0:
        raise GraphError(f"{log.name} has no sightings at all, so there is nothing to estimate from")
    options = with_models(options or RunOptions(), log)
    if estimator == "graph":
        return relaxation(log, options, max_frames, fps)
    if estimator == "isam2":
        return growth(log, options, max_frames, fps, progress)
    return cloud(log, estimator, options, max_frames, fps, progress)
