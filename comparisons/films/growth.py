"""The film of ISAM2: the graph grows with every step, and each step corrects what has been driven so far."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from graphslam import GraphError, Log, estimate_map, solve_online
from graphslam.se2 import Array
from graphslam.solvers.online import IncrementalSmoother

from ..estimator import RunOptions
from ..estimators import default_edges
from .film import Film
from .frame import Frame, kept
from .projector import Show
from .relaxation import COLORS
from .stage import Curve, MapArtists, Robot, Stage, placement_of

#: steps per second
FPS = 10.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Grown(Frame):
    """The estimate after a step.

    Attributes:
        corrections: (k,) how far each pose has been moved since the frame before [m]; 0 for new ones.
        sightings: (n, 2) where the robot sees something now.
    """

    corrections: Array
    sightings: Array


def growth(
    log: Log, options: RunOptions, max_frames: int, fps: float | None = None, progress: Callable[[], None] | None = None
) -> Film:
    """The film of `graphslam.solve_online` on a log.

    Raises:
        GraphError, OptionError: ISAM2 cannot do what is asked for on this log.
    """
    if options.robust == "gnc":
        raise GraphError("isam2 knows no graduated non-convexity: take a kernel instead, or --robust none")
    if options.frame != "body":
        raise GraphError("isam2 cannot re-evaluate the information of the world frame; use --frame body")
    edges = options.edges or default_edges(log)
    wanted = set(kept(log.num_poses, max_frames).tolist())
    frames: list[Grown] = []

    def look(smoother: IncrementalSmoother) -> None:
        step = smoother.num_poses - 1
        if step in wanted:
            frames.append(_frame(log, smoother, step, frames[-1] if frames else None))
        if progress is not None:
            progress()

    solution = solve_online(
        log, motion=options.motion, sensor=options.sensor, edges=edges, weight=options.weight,
        motion_weight=options.motion_weight, kernel=options.kernel, callback=look,
    )  # fmt: skip
    title = f"{log.name}: ISAM2, {edges.replace('+', ' + ')} edges"
    return Film(
        title, tuple(frames), log.num_poses, fps or FPS, solution.notes,
        lambda figure: _scene(figure, log, options, title, frames),
    )  # fmt: skip


def _frame(log: Log, smoother: IncrementalSmoother, step: int, before: Grown | None) -> Grown:
    poses = smoother.poses
    corrections = np.zeros(len(poses))
    if before is not None:
        old = before.poses
        corrections[: len(old)] = np.hypot(*(poses[: len(old), :2] - old[:, :2]).T)
    so_far = log.steps <= step
    past = log.replace(steps=log.steps[so_far], landmarks=log.landmarks[so_far], sightings=log.sightings[so_far])
    # the steps to come have no pose yet, and nothing was seen from them
    trajectory = np.concatenate([poses, np.zeros((log.num_poses - len(poses), 3))])
    placed = estimate_map(past, trajectory, sensor=smoother.sensor)
    seen = log.sightings[log.steps == step]
    return Grown(
        number=step,
        caption=f"step {step}    largest correction {_length(corrections.max())}",
        poses=poses,
        landmarks=smoother.landmarks or dict(placed),
        landmark_covariances=placed.covariances,
        corrections=corrections,
        sightings=smoother.sensor.h_inverse(poses[-1], seen)[:, :2] if len(seen) else np.empty((0, 2)),
    )


def _length(metres: float) -> str:
    return f"{metres:.2f} m" if metres >= 0.1 else f"{1000 * metres:.1f} mm"


def _scene(figure: Figure, log: Log, options: RunOptions, title: str, frames: Sequence[Grown]) -> Show:
    last = frames[-1]
    placement = placement_of(log, last.poses)
    largest = np.array([frame.corrections.max() for frame in frames])
    scale = LogNorm(1e-3, max(float(largest.max()), 1e-2))
    stage = Stage(
        figure, log, "isam2", placement, frames[0], last, log.dead_reckoning(options.motion), title,
        (scale, COLORS, "correction of a pose since the picture before [m]"),
    )  # fmt: skip
    sightings = stage.sightings()
    path = stage.path("isam2", linewidth=5.0, alpha=0.3)
    moved = LineCollection([], cmap=COLORS, norm=scale, linewidths=2.4, capstyle="round", animated=True)
    stage.plane.add_collection(moved, autolim=False)
    landmarks = MapArtists(stage, "map (3σ, given the path)")
    robot = Robot(stage)
    numbers = np.array([frame.number for frame in frames])
    # less than a micrometre is rounding
    visible = np.where(largest > 1e-6, largest, np.nan)
    curve = Curve(stage, numbers, visible, "step", "largest [m]", log_scale=True)
    stage.legend()

    def show(frame: Frame) -> Sequence[Artist]:
        assert isinstance(frame, Grown)
        poses, seen = stage.placed(frame.poses), stage.placed(frame.sightings)
        path.set_data(poses[:, 0], poses[:, 1])
        moved.set_segments(list(np.stack([poses[:-1], poses[1:]], axis=1)))
        # a line is moved with its farther end; the newest pose has not been moved yet
        moved.set_array(np.maximum(frame.corrections[:-1], frame.corrections[1:]))
        sightings.set_segments(list(np.stack([np.broadcast_to(poses[-1], seen.shape), seen], axis=1)))
        return [
            sightings, *landmarks.show(frame), path, moved, *robot.show(frame.poses[-1]), *curve.show(frame),
            *stage.words(frame),
        ]  # fmt: skip

    return show
