"""The film of ISAM2: the estimate of the path after every step, coloured by the correction since the last frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from graphslam import Log, OnlineSolver, estimate_map, solve_online
from graphslam.se2 import Array

from ...estimators import isam2_options, online_keywords
from ...options import AnimationOptions, RunOptions
from ..canvas import placement_of
from .scene import COLORS, Film, Frame, Scene, Show, kept


@dataclass(frozen=True, kw_only=True, eq=False)
class OnlineFrame(Frame):
    """The estimate after a step.

    Attributes:
        corrections: (k,) how far each pose has moved since the previous frame [m]; 0 for new ones.
    """

    corrections: Array


def isam2_film(log: Log, options: RunOptions, animation: AnimationOptions, progress: Callable[[], None]) -> Film:
    """The film of `graphslam.solve_online` with ISAM2 on a log.

    Raises:
        GraphError, OptionError: ISAM2 cannot do what is asked for on this log.
    """
    options = isam2_options(log, options)
    keywords = online_keywords(options)
    wanted = set(kept(log.num_poses, animation.max_frames).tolist())
    frames: list[OnlineFrame] = []

    def after_step(solver: OnlineSolver) -> None:
        if solver.step in wanted:
            frames.append(_frame(log, solver, frames[-1].poses if frames else np.empty((0, 3))))
        progress()

    solution = solve_online(log, backend="isam2", callback=after_step, **keywords)
    title = f"{log.name}: ISAM2, {keywords['edges'].replace('+', ' + ')} edges"
    largest = np.array([frame.corrections.max() for frame in frames])
    scale = LogNorm(1e-3, max(float(largest.max()), 1e-2))

    def set_up(figure: Figure) -> Show:
        scene = Scene(
            figure, log, "isam2", placement_of(log, frames[-1].poses, landmarks=frames[-1].landmarks), frames, title,
            options.motion, (scale, COLORS, "correction of a pose since the previous frame [m]"),
        )  # fmt: skip
        scene.add_sightings()
        scene.add_map("map (3σ, given the path)")
        scene.add_path("isam2", linewidth=5.0, alpha=0.3)
        lines = scene.add_lines(cmap=COLORS, norm=scale, linewidths=2.4, capstyle="round")

        def corrections(frame: OnlineFrame) -> Sequence[Artist]:
            places = scene.along(frame.poses)
            motion = scene.between.motions[: len(places) - 1]
            lines.set_segments(list(np.stack([places[:-1], places[1:]], axis=1)))
            # a segment has moved as far as the end that moved farther; the newest pose has not moved yet
            lines.set_array(np.maximum(frame.corrections[motion], frame.corrections[motion + 1]))
            return [lines]

        scene.add(corrections)
        scene.add_robot()
        numbers = np.array([frame.number for frame in frames])
        # less than a micrometre is rounding
        visible = np.where(largest > 1e-6, largest, np.nan)
        scene.add_curve(numbers, visible, "step", "largest [m]", log=True)
        return scene.finish()

    return Film(title, tuple(frames), log.num_poses, solution.notes, set_up, log)


def _frame(log: Log, solver: OnlineSolver, before: Array) -> OnlineFrame:
    step, poses = solver.step, solver.poses
    corrections = np.zeros(len(poses))
    corrections[: len(before)] = np.hypot(*(poses[: len(before), :2] - before[:, :2]).T)
    so_far = log.steps <= step
    past = log.replace(steps=log.steps[so_far], landmarks=log.landmarks[so_far], sightings=log.sightings[so_far])
    # the steps to come have no pose yet, and nothing was seen from them
    trajectory = np.concatenate([poses, np.zeros((log.num_poses - len(poses), 3))])
    estimated = estimate_map(past, trajectory, sensor=solver.sensor, kernel=solver.kernel)
    seen = log.sightings[log.steps == step]
    metres = corrections.max()
    length = f"{metres:.2f} m" if metres >= 0.1 else f"{1000 * metres:.1f} mm"
    return OnlineFrame(
        number=step,
        caption=f"step {step}    largest correction {length}",
        poses=poses,
        landmarks=solver.landmarks or dict(estimated),
        landmark_covariances=estimated.covariances,
        corrections=corrections,
        sightings=solver.sensor.h_inverse(poses[-1], seen)[:, :2],
    )
