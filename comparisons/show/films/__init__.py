"""Animations of an estimator at work: an animated GIF, an MP4, or an HTML page with a player."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from os import PathLike
from typing import Any

from graphslam import GraphError, Log

from ...options import AnimationOptions, RunOptions
from ...options.reading import prepare
from .files import check_can_film
from .graphs import association_film, graph_film, isam2_film
from .particles import particle_film, sample_film
from .scene import Film

__all__ = ["Film", "animate", "check_can_film"]

Progress = Callable[[], None]


def animate(log: Log | str | PathLike[str] | None = None, *, progress: Progress | None = None, **options: Any) -> Film:
    """Run an estimator on a log and keep what it estimates on the way.

    The film of ``graph`` has one frame per iteration, its edges coloured by their Mahalanobis distances; that of
    ``particle-gibbs`` one per sweep, with the sampled trajectories and maps. The others have one frame per step: the
    particles, maps and resamplings of a filter, the corrections that ``isam2`` makes to the path, and for ``association``
    the landmark that each sighting without an id was found to be of, certain, uncertain or none.

    Args:
        log: a log, the file or folder of one, or None for the sample log of the package.
        progress: called after each step; for ``graph``, ``association`` and ``particle-gibbs`` after each frame.
        options: the fields of `options.AnimationOptions` (estimator, max_frames, fps) and of `options.RunOptions`.

    Returns:
        The film: ``film.save("out.gif")``, ``film.frames[-1].poses``; a notebook shows it.

    Raises:
        OptionError: an option is unknown or has an impossible value.
        SlamError: the estimator cannot run on this log.
    """
    own = {f.name: options.pop(f.name) for f in fields(AnimationOptions) if f.name in options}
    animation = AnimationOptions.of(**own)
    data, source, run = prepare(log, RunOptions.of(**options))
    if len(data.steps) == 0 and not data.measured:
        raise GraphError(f"{data.name} has no sightings at all, so there is nothing to estimate from")
    makers = {"graph": graph_film, "association": association_film, "isam2": isam2_film, "particle-gibbs": sample_film}
    film = makers.get(animation.estimator, particle_film)(data, run, animation, progress or (lambda: None))
    # iterations are few and worth a look each
    fps = animation.fps or (2.0 if animation.estimator == "graph" else 10.0)
    return replace(film, fps=fps, source=None if isinstance(source, tuple) else source)
