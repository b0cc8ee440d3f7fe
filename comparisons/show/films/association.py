"""The film of an association: step by step, a line from the robot to the landmark that each sighting was found to be of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from graphslam import Log, SensorModel
from graphslam.log import UNIDENTIFIED
from graphslam.se2 import Array

from ...estimators import ESTIMATORS
from ...options import AnimationOptions, RunOptions
from ...results.sightings import CLUTTER, CONFIRMED, UNCONFIRMED, status_of
from ..canvas import SIGHTINGS, placement_of_result
from .scene import Film, Frame, Scene, Show, kept

_LABELS = {CONFIRMED: "its landmark", UNCONFIRMED: "uncertain landmark", CLUTTER: "no landmark"}


@dataclass(frozen=True, kw_only=True, eq=False)
class AssociationFrame(Frame):
    """The path so far, the landmarks seen so far, and the sightings of the step.

    Attributes:
        ends: (n, 2) where the line of each sighting ends: at its landmark, or where it was seen.
        status: (n,) "confirmed", "unconfirmed" or "clutter".
    """

    ends: Array
    status: tuple[str, ...]


def association_film(log: Log, options: RunOptions, animation: AnimationOptions, progress: Callable[[], None]) -> Film:
    """The film of the ids that ``graph`` finds, on the trajectory and map of its end. Ids of the log are not used.

    Raises:
        SlamError: no ids are found, or the log does not determine the graph.
    """
    without_ids = log.replace(landmarks=np.full(len(log.steps), UNIDENTIFIED))
    result = ESTIMATORS["graph"].run(without_ids, options)
    assert result.association is not None and result.found is not None
    status, sensor = status_of(result), options.sensor or log.sensor or SensorModel()
    places = sensor.h_inverse(result.poses[log.steps], log.sightings)[:, :2]
    for k, j in enumerate(result.association.tolist()):
        if j in result.landmarks:
            places[k] = result.landmarks[j][:2]
    frames: list[AssociationFrame] = []
    for step in kept(log.num_poses, animation.max_frames).tolist():
        now, before = log.steps == step, log.steps <= step
        known = set(result.association[before].tolist())
        counts = {each: int(np.sum(status[before] == each)) for each in _LABELS}
        frames.append(
            AssociationFrame(
                number=step,
                caption=f"step {step}    " + ", ".join(f"{counts[each]} {each}" for each in _LABELS),
                poses=result.poses[: step + 1],
                landmarks={j: m for j, m in result.landmarks.items() if j in known},
                landmark_covariances={j: S for j, S in result.landmark_covariances.items() if j in known},
                ends=places[now],
                status=tuple(status[now].tolist()),
            )
        )
        progress()
    uncertain = np.bincount(log.steps[status != CONFIRMED], minlength=log.num_poses)
    title = f"{log.name}: association, {len(result.landmarks)} landmarks"

    def set_up(figure: Figure) -> Show:
        scene = Scene(figure, log, "graph", placement_of_result(log, result), frames, title, options.motion)
        scene.add_map("map (3σ)")
        scene.add_path("graph")
        lines = scene.add_lines(linewidths=1.3)
        for each, label in _LABELS.items():
            scene.remember(label, Line2D([], [], color=SIGHTINGS[each]))

        def sightings(frame: AssociationFrame) -> Sequence[Artist]:
            ends = scene.moved(frame.ends)
            begin = np.broadcast_to(scene.placed(frame.poses[-1:]), ends.shape)
            lines.set_segments(list(np.stack([begin, ends], axis=1)))
            lines.set_color([to_rgba(SIGHTINGS[each]) for each in frame.status])
            return [lines]

        scene.add(sightings)
        scene.add_robot()
        scene.add_curve(np.arange(log.num_poses), np.cumsum(uncertain).astype(float), "step", "not confirmed")
        return scene.finish()

    ignored = () if np.all(log.landmarks == UNIDENTIFIED) else ("the ids of the log are not used",)
    notes = (*result.found.notes, *ignored)
    return Film(title, tuple(frames), log.num_poses, notes, set_up, log)
