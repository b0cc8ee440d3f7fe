"""The film of a particle filter: its particles, and the map of the best one, step by step as in the lectures."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from fastslam import ParticleFilter
from fastslam.particle_filter import VanishedWeightsWarning
from fastslam.state import ParticleState
from graphslam import Log
from graphslam.se2 import Array

from ..estimator import RunOptions
from ..particles import FILTERS
from .film import Film
from .frame import Frame, kept
from .projector import Show
from .stage import FLASH, Curve, MapArtists, Robot, Stage, placement_of

#: steps per second
FPS = 10.0
#: more particles than this are thinned out: beyond it points only cover each other
MOST_PARTICLES = 2000
#: opacity classes of the particles, from negligible to heavy
OPACITIES = (0.12, 0.3, 0.8)
_NAMES = {"mcl": "Monte Carlo localisation", "fastslam1": "FastSLAM 1.0", "fastslam2": "FastSLAM 2.0"}
_PARTICLE = "#0072B2"


@dataclass(frozen=True, kw_only=True, eq=False)
class Cloud(Frame):
    """The particles after a step; path and map are those of the best particle.

    Attributes:
        particles: (n, 3) their poses, thinned out where there are many.
        weights: (n,) relative to the heaviest.
        ess: effective sample size at the last sightings, before resampling.
        resamplings: how often the filter resampled since the frame before.
        sightings: (k, 2) where the best particle sees something now.
    """

    particles: Array
    weights: Array
    ess: float
    resamplings: int
    sightings: Array


def cloud(
    log: Log,
    name: str,
    options: RunOptions,
    max_frames: int,
    fps: float | None = None,
    progress: Callable[[], None] | None = None,
) -> Film:
    """The film of one of the particle filters `comparisons.particles.FILTERS` on a log.

    Raises:
        LogError, OptionError: the filter cannot run on this log.
    """
    told = {"motion": options.motion, "sensor": options.sensor, "resampling": options.resampling}
    if name != "mcl":
        told["association"] = options.association
    particles = FILTERS[name](log, particles=options.particles, seed=options.seed, **told)  # type: ignore[arg-type]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", VanishedWeightsWarning)
        frames, ess, resampled = _frames(log, particles, max_frames, progress)
    notes = [str(w.message) for w in caught if issubclass(w.category, VanishedWeightsWarning)]
    if options.particles > MOST_PARTICLES:
        notes.append(f"{len(frames[0].particles)} of {options.particles} particles are drawn")
    title = f"{log.name}: {_NAMES[name]}, {options.particles} particles"
    return Film(
        title, frames, log.num_poses, fps or FPS, tuple(notes),
        lambda figure: _scene(figure, log, name, options, title, frames, ess, resampled),
    )  # fmt: skip


def _frames(
    log: Log, particles: ParticleFilter, max_frames: int, progress: Callable[[], None] | None
) -> tuple[tuple[Cloud, ...], Array, np.ndarray]:
    wanted = set(kept(log.num_poses, max_frames).tolist())
    frames: list[Cloud] = []
    resamplings = 0
    for state in particles:
        resamplings += state.resampled
        if state.step in wanted:
            frames.append(_frame(log, particles, state, resamplings))
            resamplings = 0
        if progress is not None:
            progress()
    result = particles.result()
    return tuple(frames), result.ess, result.resampled


def _frame(log: Log, particles: ParticleFilter, state: ParticleState, resamplings: int) -> Cloud:
    every = slice(None, None, -(-len(state.poses) // MOST_PARTICLES))
    weights = np.exp(state.log_weights - state.log_weights.max())
    belief = state.map()
    seen = log.sightings[log.steps == state.step]
    share = state.ess / len(state.poses)
    return Cloud(
        number=state.step,
        caption=f"step {state.step}    effective particles {state.ess:,.0f} ({share:.0%})",
        flash="" if not resamplings else "resampled" if resamplings == 1 else f"resampled {resamplings} ×",
        poses=particles.trajectory(),
        landmarks={j: estimate.mean for j, estimate in belief.items()},
        landmark_covariances={j: estimate.covariance for j, estimate in belief.items()},
        particles=state.poses[every].copy(),
        weights=weights[every],
        ess=state.ess,
        resamplings=resamplings,
        sightings=particles.sensor.h_inverse(state.best_pose, seen)[:, :2] if len(seen) else np.empty((0, 2)),
    )


def _scene(
    figure: Figure, log: Log, name: str, options: RunOptions, title: str, frames: Sequence[Cloud], ess: Array,
    resampled: np.ndarray,
) -> Show:  # fmt: skip
    last = frames[-1]
    # localisation is in the axes of its map, and that is the true one
    placement = np.zeros(3) if name == "mcl" else placement_of(log, last.poses)
    stage = Stage(figure, log, name, placement, frames[0], last, log.dead_reckoning(options.motion), title)
    sightings = stage.sightings()
    path = stage.path("best particle's path", linestyle="-")
    dots = [_dots(stage, opacity) for opacity in OPACITIES]
    stage.remember("particle", Line2D([], [], color=_PARTICLE, linestyle="none", marker=".", markersize=5))
    landmarks = None if name == "mcl" else MapArtists(stage, "best particle's map (3σ)")
    robot = Robot(stage)
    steps = np.flatnonzero(resampled)
    stage.strip.plot(steps, np.full(len(steps), 0.95), "|", color=FLASH, markersize=4)
    curve = Curve(stage, np.arange(len(ess)), ess / options.particles, "step", "ESS / N")
    stage.strip.set_ylim(0, 1.05)
    stage.remember("resampling", Line2D([], [], color=FLASH, linestyle="none", marker="|", markersize=6))
    stage.legend()

    def show(frame: Frame) -> Sequence[Artist]:
        assert isinstance(frame, Cloud)
        poses, seen = stage.placed(frame.poses), stage.placed(frame.sightings)
        path.set_data(poses[:, 0], poses[:, 1])
        begin = np.broadcast_to(poses[-1], seen.shape)
        sightings.set_segments(list(np.stack([begin, seen], axis=1)))
        places = stage.placed(frame.particles)
        heavy = np.digitize(frame.weights, (0.1, 0.5))
        for grade, dot in enumerate(dots):
            dot.set_data(places[heavy == grade, 0], places[heavy == grade, 1])
            dot.set_color(FLASH if frame.resamplings else _PARTICLE)
        believed = [] if landmarks is None else landmarks.show(frame)
        return [
            sightings, *believed, path, *dots, *robot.show(frame.poses[-1]), *curve.show(frame), *stage.words(frame)
        ]  # fmt: skip

    return show


def _dots(stage: Stage, opacity: float) -> Line2D:
    (dots,) = stage.plane.plot(
        [], [], linestyle="none", marker="o", markersize=2.2, markeredgewidth=0, alpha=opacity, animated=True
    )
    return dots
