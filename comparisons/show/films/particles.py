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
from fastslam.filters.particle_filter import VanishedWeightsWarning
from fastslam.particles import ParticleState
from graphslam import Log
from graphslam.se2 import Array

from ...estimators.filters import particle_filter
from ...options import AnimationOptions, RunOptions
from ..canvas import FLASH, PARTICLE, placement_of
from .scene import Film, Frame, Scene, Show, kept

#: of more particles some are drawn, evenly spread: more points would only cover each other
MOST_PARTICLES = 2000
#: opacity of the particles with up to 10 %, up to 50 %, and more of the greatest weight
OPACITIES = (0.12, 0.3, 0.8)
_NAMES = {"mcl": "Monte Carlo localisation", "fastslam1": "FastSLAM 1.0", "fastslam2": "FastSLAM 2.0"}
#: what the title says of the stages of the lectures
_STAGES = {"motion": ", not weighed", "weights": ", not resampled", "resampling": ""}


@dataclass(frozen=True, kw_only=True, eq=False)
class ParticleFrame(Frame):
    """The particles after a step; path and map are those of the best particle.

    Attributes:
        particles: (n, 3) their poses, at most `MOST_PARTICLES`.
        weights: (n,) relative to the greatest.
        ess: effective sample size at the last sightings, before resampling.
        resamplings: how often the filter resampled since the previous frame.
    """

    particles: Array
    weights: Array
    ess: float
    resamplings: int


def particle_film(log: Log, options: RunOptions, animation: AnimationOptions, progress: Callable[[], None]) -> Film:
    """The film of a particle filter on a log.

    Raises:
        LogError, OptionError: the filter cannot run on this log.
    """
    name = animation.estimator
    filter = particle_filter(name, log, options)
    wanted = set(kept(log.num_poses, animation.max_frames).tolist())
    frames: list[ParticleFrame] = []
    resamplings = 0
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", VanishedWeightsWarning)
        for state in filter:
            resamplings += state.resampled
            if state.step in wanted:
                frames.append(_frame(log, filter, state, resamplings))
                resamplings = 0
            progress()
    result = filter.result()
    notes = [str(w.message) for w in caught if issubclass(w.category, VanishedWeightsWarning)]
    if options.filter.particles > MOST_PARTICLES:
        notes.append(f"{len(frames[0].particles)} of {options.filter.particles} particles are drawn")
    title = f"{log.name}: {_NAMES[name]}, {options.filter.particles} particles{_STAGES[options.filter.stage]}"

    def set_up(figure: Figure) -> Show:
        # localisation is in the axes of its map, which are the true ones
        last, named = frames[-1], result.options.uses_ids
        placement = np.zeros(3) if name == "mcl" else placement_of(log, last.poses, None, last.landmarks, named=named)
        scene = Scene(figure, log, name, placement, frames, title, options.motion)
        scene.add_sightings()
        if name != "mcl":
            scene.add_map("best particle's map (3σ)")
        scene.add_path("best particle's path", linestyle="-")
        scene.add(_particles(scene))
        scene.add_robot()
        steps = np.flatnonzero(result.resampled)
        scene.strip.plot(steps, np.full(len(steps), 0.95), "|", color=FLASH, markersize=4)
        scene.add_curve(np.arange(log.num_poses), result.ess / options.filter.particles, "step", "ESS / N")
        scene.strip.set_ylim(0, 1.05)
        scene.remember("resampled", Line2D([], [], color=FLASH, linestyle="none", marker="|", markersize=6))
        return scene.finish()

    return Film(title, tuple(frames), log.num_poses, tuple(notes), set_up, log)


def _frame(log: Log, filter: ParticleFilter, state: ParticleState, resamplings: int) -> ParticleFrame:
    every = slice(None, None, -(-len(state.poses) // MOST_PARTICLES))
    weights = np.exp(state.log_weights - state.log_weights.max())
    estimates = state.map()
    seen = log.sightings[log.steps == state.step]
    return ParticleFrame(
        number=state.step,
        caption=f"step {state.step}    effective particles {state.ess:,.0f} ({state.ess / len(state.poses):.0%})",
        flash="" if not resamplings else "resampled" if resamplings == 1 else f"resampled {resamplings} ×",
        poses=filter.trajectory(),
        landmarks={j: estimate.mean for j, estimate in estimates.items()},
        landmark_covariances={j: estimate.covariance for j, estimate in estimates.items()},
        particles=state.poses[every].copy(),
        weights=weights[every],
        ess=state.ess,
        resamplings=resamplings,
        sightings=filter.sensor.h_inverse(state.best_pose, seen)[:, :2],
    )


def _particles(scene: Scene) -> Show:
    """Dots in three grades of opacity, by weight."""
    dots = [
        scene.plane.plot([], [], "o", markersize=2.2, markeredgewidth=0, alpha=opacity, animated=True)[0]
        for opacity in OPACITIES
    ]
    scene.remember("particle", Line2D([], [], color=PARTICLE, linestyle="none", marker=".", markersize=5))

    def move(frame: ParticleFrame) -> Sequence[Artist]:
        places = scene.placed(frame.particles)
        grades = np.digitize(frame.weights, (0.1, 0.5))
        for grade, dot in enumerate(dots):
            dot.set_data(*places[grades == grade].T)
            dot.set_color(FLASH if frame.resamplings else PARTICLE)
        return dots

    return move
