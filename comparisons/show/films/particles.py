"""The films of particles: a filter step by step as in the lectures, and particle Gibbs sweep by sweep."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from matplotlib.lines import Line2D

from fastslam import GibbsResult, ParticleFilter, Samples, VanishedWeightsWarning
from fastslam.particles import ParticleState
from graphslam import Log
from graphslam.se2 import Array

from ...estimators import gibbs_sampler
from ...estimators.filters import on_map, particle_filter
from ...options import AnimationOptions, RunOptions
from ..canvas import FLASH, PARTICLE
from .scene import Film, Frame, Scene, kept

#: warnings of a filter that become notes
SAID = (UserWarning, VanishedWeightsWarning)
#: of more particles some are drawn, evenly spread: more points would only cover each other
MOST_PARTICLES = 2000
#: opacity of the particles with up to 10 %, up to 50 %, and more of the greatest weight
OPACITIES = (0.12, 0.3, 0.8)
_NAMES = {"mcl": "Monte Carlo localisation", "fastslam1": "FastSLAM 1.0", "fastslam2": "FastSLAM 2.0"}
#: what the title says of the stages of the lectures
_STAGES = {"motion": ", not weighed", "weights": ", not resampled", "resampling": ""}


def particle_film(log: Log, options: RunOptions, animation: AnimationOptions, progress: Callable[[], None]) -> Film:
    """The film of a particle filter on a log: its particles as dots, path and map of the best particle.

    Raises:
        LogError, OptionError: the filter cannot run on this log.
    """
    name = animation.estimator
    log, left_out = on_map(log, options) if name == "mcl" else (log, ())
    wanted = set(kept(log.num_poses, animation.max_frames).tolist())
    frames: list[Frame] = []
    resamplings = 0
    with warnings.catch_warnings(record=True) as caught:
        for category in SAID:
            warnings.simplefilter("always", category)
        filter = particle_filter(name, log, options)
        for state in filter:
            resamplings += state.resampled
            if state.step in wanted:
                frames.append(_particles(log, filter, state, resamplings))
                resamplings = 0
            progress()
    result = filter.result()
    notes = list(dict.fromkeys([*left_out, *(str(each.message) for each in caught if issubclass(each.category, SAID))]))
    if options.filter.particles > MOST_PARTICLES:
        notes.append(f"{len(frames[0].dots)} of {options.filter.particles} particles are drawn")

    def parts(scene: Scene) -> None:
        scene.add_sightings()
        if name != "mcl":
            scene.add_map("best particle's map (3σ)")
        scene.add_path("best particle's path", linestyle="-")
        _add_particles(scene)
        scene.add_robot()
        steps = np.flatnonzero(result.resampled)
        scene.strip.plot(steps, np.full(len(steps), 0.95), "|", color=FLASH, markersize=4)
        scene.add_curve(np.arange(log.num_poses), result.ess / options.filter.particles, "step", "ESS / N")
        scene.strip.set_ylim(0, 1.05)
        scene.remember("resampled", Line2D([], [], color=FLASH, linestyle="none", marker="|", markersize=6))

    title = f"{log.name}: {_NAMES[name]}, {options.filter.particles} particles{_STAGES[options.filter.stage]}"
    return Film(
        title=title, name=name, frames=tuple(frames), steps=log.num_poses, notes=tuple(notes), parts=parts, log=log,
        motion=options.motion, named=result.options.uses_ids,
        # the true map is in the axes of the truth, and a map of the options in its own
        aligned=name != "mcl" or options.landmark_map is not None,
    )  # fmt: skip


def _particles(log: Log, filter: ParticleFilter, state: ParticleState, resamplings: int) -> Frame:
    """The frame after a step; its values are the weights of the dots, relative to the greatest."""
    every = slice(None, None, -(-len(state.poses) // MOST_PARTICLES))
    estimates = state.map()
    seen = log.sightings[log.steps == state.step]
    return Frame(
        number=state.step,
        caption=f"step {state.step}    effective particles {state.ess:,.0f} ({state.ess / len(state.poses):.0%})",
        flash="" if not resamplings else "resampled" if resamplings == 1 else f"resampled {resamplings} ×",
        poses=filter.trajectory(), landmarks={j: estimate.mean for j, estimate in estimates.items()},
        landmark_covariances={j: estimate.covariance for j, estimate in estimates.items()}, dots=state.poses[every].copy(),
        values=np.exp(state.log_weights - state.log_weights.max())[every],
        sightings=filter.sensor.h_inverse(state.best_pose, seen)[:, :2],
    )  # fmt: skip


def _add_particles(scene: Scene) -> None:
    """Dots in three grades of opacity, by weight."""
    dots = [scene.plane.plot([], [], "o", markersize=2.2, markeredgewidth=0, alpha=each)[0] for each in OPACITIES]
    scene.remember("particle", Line2D([], [], color=PARTICLE, linestyle="none", marker=".", markersize=5))

    def update(frame: Frame) -> None:
        places = scene.placed(frame.dots)
        grades = np.digitize(frame.values, (0.1, 0.5))
        for grade, dot in enumerate(dots):
            dot.set_data(*places[grades == grade].T)
            dot.set_color(FLASH if frame.flash else PARTICLE)

    scene.add(update, *dots)


#: the most earlier samples that a picture shows, evenly spread
MOST_SAMPLES = 100


@dataclass(frozen=True, kw_only=True, eq=False)
class SampleFrame(Frame):
    """The samples after a sweep; poses and landmarks are their means so far, dots the landmarks of the samples shown.

    Attributes:
        paths: (C, T + 1, 3) the newest sample of each chain.
        earlier: (n, T + 1, 3) samples before it, of all chains, at most `MOST_SAMPLES`.
    """

    paths: Array
    earlier: Array


def sample_film(log: Log, options: RunOptions, animation: AnimationOptions, progress: Callable[[], None]) -> Film:
    """The film of `ParticleGibbs` on a log, after its warm-up.

    Raises:
        LogError, OptionError: it cannot run on this log.
    """
    result = gibbs_sampler(log, options).run()
    chains, sweeps = result.trajectories.shape[:2]
    frames: list[SampleFrame] = []
    for number in kept(sweeps, animation.max_frames).tolist():
        frames.append(_samples(result, number))
        progress()
    numbers, coordinate = _trace(result)

    def parts(scene: Scene) -> None:
        _add_samples(scene)
        scene.add_path("mean so far", linestyle="-", linewidth=1.2)
        for chain in numbers:
            scene.strip.plot(np.arange(sweeps), chain, color="0.78", linewidth=0.8)
        label = f"sweep; {coordinate}, in standard deviations, of all chains"
        scene.add_curve(np.arange(sweeps), numbers[0], label, "σ")

    title = f"{log.name}: particle Gibbs, {chains} chain{'s' * (chains > 1)}, {options.gibbs.particles} particles"
    return Film(
        title=title, name="particle-gibbs", frames=tuple(frames), steps=sweeps, notes=(result.mixing.statement,), parts=parts,
        log=log, motion=options.motion,
    )  # fmt: skip


def _samples(result: GibbsResult, number: int) -> SampleFrame:
    chains = len(result.trajectories)
    so_far = Samples(result.trajectories[:, : number + 1], result.maps[:, : number + 1], result.ids)
    rows = kept(number, -(-MOST_SAMPLES // chains)) if number else np.empty(0, dtype=np.int64)
    return SampleFrame(
        number=number, caption=f"sweep {number + 1}    {chains * (number + 1)} samples", poses=so_far.poses,
        landmarks=so_far.landmarks, paths=result.trajectories[:, number],
        earlier=result.trajectories[:, rows].reshape(-1, *result.trajectories.shape[2:]),
        dots=result.maps[:, np.append(rows, number), :, :2].reshape(-1, 2),
    )  # fmt: skip


def _trace(result: GibbsResult) -> tuple[Array, str]:
    """Return the coordinate whose chains agree least, standardised, (C, S), and its name."""
    mixing = result.mixing
    worst = int(np.argmax(np.where(np.isfinite(mixing.rhat), mixing.rhat, -np.inf)))
    values = result.deviations[:, :, worst]
    return (values - values.mean()) / max(float(values.std()), 1e-300), mixing.names[worst]


def _add_samples(scene: Scene) -> None:
    """Earlier samples pale, the newest of each chain dark, and the landmarks of all as dots."""
    pale = scene.add_lines(colors=scene.color, linewidths=0.5, alpha=0.15)
    dark = scene.add_lines(colors=PARTICLE, linewidths=0.9, alpha=0.9)
    (dots,) = scene.plane.plot([], [], "o", color=scene.color, markersize=2.0, markeredgewidth=0, alpha=0.35)
    scene.remember("newest samples", Line2D([], [], color=PARTICLE, linewidth=0.9))
    scene.remember("earlier samples", Line2D([], [], color=scene.color, linewidth=0.5, alpha=0.5))
    scene.remember("sampled landmark", Line2D([], [], color=scene.color, linestyle="none", marker="o", markersize=3))

    def update(frame: SampleFrame) -> None:
        pale.set_segments([scene.along(path) for path in frame.earlier])
        dark.set_segments([scene.along(path) for path in frame.paths])
        dots.set_data(*scene.moved(frame.dots).T)

    scene.add(update, pale, dots, dark)
