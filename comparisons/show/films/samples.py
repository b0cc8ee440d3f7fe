"""The film of particle Gibbs: sampled trajectories and maps, sweep by sweep, and whether the chains agree."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from fastslam import GibbsResult, ParticleGibbs, Samples
from graphslam import Log
from graphslam.se2 import Array

from ...options import AnimationOptions, RunOptions
from ..canvas import PARTICLE, placement_of
from .scene import Film, Frame, Scene, Show, kept

#: the most earlier samples that a picture shows, evenly spread
MOST_SAMPLES = 100


@dataclass(frozen=True, kw_only=True, eq=False)
class SampleFrame(Frame):
    """The samples after a sweep; poses and landmarks are their means so far.

    Attributes:
        paths: (C, T + 1, 3) the newest sample of each chain.
        earlier: (n, T + 1, 3) samples before it, of all chains, at most `MOST_SAMPLES`.
        places: (m, 2) the landmarks of all these samples.
    """

    paths: Array
    earlier: Array
    places: Array


def sample_film(log: Log, options: RunOptions, animation: AnimationOptions, progress: Callable[[], None]) -> Film:
    """The film of `ParticleGibbs` on a log, after its warm-up.

    Raises:
        LogError, OptionError: it cannot run on this log.
    """
    sampler = ParticleGibbs(
        log, seed=options.filter.seed, threads=options.filter.threads, options=options.gibbs, motion=options.motion,
        sensor=options.sensor,
    )  # fmt: skip
    result = sampler.run()
    chains, sweeps = result.trajectories.shape[:2]
    frames: list[SampleFrame] = []
    for number in kept(sweeps, animation.max_frames).tolist():
        frames.append(_frame(result, number))
        progress()
    numbers, name = _trace(result)
    title = f"{log.name}: particle Gibbs, {chains} chain{'s' * (chains > 1)}, {options.gibbs.particles} particles"

    def set_up(figure: Figure) -> Show:
        placement = placement_of(log, result.poses, None, result.landmarks)
        scene = Scene(figure, log, "particle-gibbs", placement, frames, title, options.motion)
        scene.add(_samples(scene))
        scene.add_path("mean so far", linestyle="-", linewidth=1.2)
        for chain in numbers:
            scene.strip.plot(np.arange(sweeps), chain, color="0.78", linewidth=0.8)
        scene.add_curve(np.arange(sweeps), numbers[0], f"sweep; {name}, in standard deviations, of all chains", "σ")
        return scene.finish()

    return Film(title, tuple(frames), sweeps, (result.mixing.statement,), set_up, log)


def _frame(result: GibbsResult, number: int) -> SampleFrame:
    chains = len(result.trajectories)
    so_far = Samples(result.trajectories[:, : number + 1], result.maps[:, : number + 1], result.ids)
    rows = kept(number, -(-MOST_SAMPLES // chains)) if number else np.empty(0, dtype=np.int64)
    shown = np.append(rows, number)
    return SampleFrame(
        number=number,
        caption=f"sweep {number + 1}    {chains * (number + 1)} samples",
        poses=so_far.poses,
        landmarks=so_far.landmarks,
        paths=result.trajectories[:, number],
        earlier=result.trajectories[:, rows].reshape(-1, *result.trajectories.shape[2:]),
        places=result.maps[:, shown, :, :2].reshape(-1, 2),
    )


def _trace(result: GibbsResult) -> tuple[Array, str]:
    """Return the coordinate whose chains agree least, standardised, (C, S), and its name."""
    mixing = result.mixing
    worst = int(np.argmax(np.where(np.isfinite(mixing.rhat), mixing.rhat, -np.inf)))
    values = result.deviations[:, :, worst]
    return (values - values.mean()) / max(float(values.std()), 1e-300), mixing.names[worst]


def _samples(scene: Scene) -> Show:
    """Earlier samples pale, the newest of each chain dark, and the landmarks of all as dots."""
    pale = scene.add_lines(colors=scene.color, linewidths=0.5, alpha=0.15)
    dark = scene.add_lines(colors=PARTICLE, linewidths=0.9, alpha=0.9)
    (dots,) = scene.plane.plot(
        [], [], "o", color=scene.color, markersize=2.0, markeredgewidth=0, alpha=0.35, animated=True
    )
    scene.remember("newest samples", Line2D([], [], color=PARTICLE, linewidth=0.9))
    scene.remember("earlier samples", Line2D([], [], color=scene.color, linewidth=0.5, alpha=0.5))
    scene.remember("sampled landmark", Line2D([], [], color=scene.color, linestyle="none", marker="o", markersize=3))

    def move(frame: SampleFrame) -> Sequence[Artist]:
        pale.set_segments([scene.along(path) for path in frame.earlier])
        dark.set_segments([scene.along(path) for path in frame.paths])
        dots.set_data(*scene.moved(frame.places).T)
        return [pale, dots, dark]

    return move
