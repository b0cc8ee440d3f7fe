"""The streams of a drive in a bag: topics are chosen, streamed once, and brought into the axes of the robot.

Bags of ROS 1 (.bag) and ROS 2 (.mcap, .db3, or their folder); `io.bag_topics` reads them.

A recipe beside the bag, ``drive.toml`` for ``drive.mcap``, names topics, fields, units and clocks (`io.tables`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FormatError, LogError, checks, named, quoted
from ..log import Log
from ..log.drive import Timed, odometry_of, sightings_of, truth_of
from ..log.join import READERS, Drive, check_overlap, map_of
from ..log.rows import AXES, ReadOptions, TableOptions
from ..log.table import Columns
from ..log.text_table import table_of
from ..se2 import Array, wrap
from .bag_messages import Collector, Frames, Poses, clean, positions_table, relations_table, rotation_of
from .bag_topics import TF, Bag, Candidate, Topic, candidates, is_bag, open_bag, plan_of
from .base import Format
from .tables import Recipe, merged, recipe_if_any

#: the axes of the sightings of a bag whose frame says no others
_PLAIN = "forward-left"
#: names that the frame of a robot usually has
_BASES = ("base_link", "base_footprint", "base", "robot", "chassis")
#: frames of TF that landmarks have
_TAGS = ("tag*", "*tag36*", "marker*", "fiducial*", "aruco*", "landmark*")
#: twist and poses of odometry should drive the same distance, within this share
_DIFFER = 0.2
#: streams that other sensors measure, from topics that the user names, and how their tables are made of the messages
MEASURED_TOPICS: dict[str, Callable[..., tuple[Columns, list[str]]]] = {
    "relations": relations_table, "positions": positions_table,
}  # fmt: skip


@dataclass(frozen=True)
class Choice:
    """A topic that is read for a stream; of TF, with its frames."""

    kind: str
    topic: Topic
    parent: str = ""
    child: str = ""
    named: bool = False


def topics_of(path: Path, recipe: Recipe | None = None) -> list[Candidate]:
    """Every topic of a bag, what it could be, and what it would be taken for.

    Raises:
        FormatError: the bag cannot be read, or lacks a topic that the recipe names.
    """
    with open_bag(path) as bag:
        found = candidates(bag)
        chosen = {choice.topic.name: choice.kind for choice in _choices(bag, found, recipe or Recipe())}
    return [replace(each, chosen=chosen.get(each.topic.name, "")) for each in found]


def drive_of_bag(path: Path, recipe: Recipe | None = None) -> Drive:
    """The streams of a bag.

    Args:
        path: of the bag.
        recipe: topics, fields, units, clocks, and the place of the sensor; default: found in the bag.

    Raises:
        FormatError: the bag cannot be read, a topic is missing or of another type, or a frame is unknown.
    """
    recipe = recipe or Recipe()
    with open_bag(path) as bag:
        found = candidates(bag)
        choices = {choice.kind: choice for choice in _choices(bag, found, recipe)}
        for kind in ("odometry", "sightings"):
            if kind not in choices:
                there = named(f"{topic.name} ({topic.type})" for topic in bag.topics) or "no topics"
                raise FormatError(path, None, f"no topic gives {kind}: there are {there}; name one: --{kind} TOPIC")
        collectors = {kind: _collector(bag, choice, recipe.options) for kind, choice in choices.items()}
        frames = Frames(source=str(path))
        by_topic: dict[str, list[Collector]] = {}
        for kind, each in collectors.items():
            by_topic.setdefault(choices[kind].topic.name, []).append(each)
        static = [topic.name for topic in bag.topics if topic.type in TF and "static" in topic.name]
        for topic, time, message in bag.messages([*by_topic, *static]):
            for collector in by_topic.get(topic, ()):
                collector.add(time, message)
            if topic in static:
                frames.add(message.transforms, static=True)
        for kind, each in collectors.items():
            if len(each) == 0:
                raise FormatError(path, None, f"{choices[kind].topic.name} has no message that gives {kind}")
        seen = collectors["sightings"]
        base = _base(collectors["odometry"], recipe, frames)
        if seen.plan.places and frames.between(base, seen.frame) is None and not _stated(recipe.options):
            for _, _, message in bag.messages([t.name for t in bag.topics if t.type in TF and t.name not in static]):
                frames.add(message.transforms, static=False)
    drive = _drive(path, recipe, choices, collectors, frames, base)
    if "positions" in choices or recipe.place("positions", "file") is not None:
        return drive
    unused = [each.topic.name for each in found if each.could_be == "positions" and each.topic.count]
    offer = "{0} has absolute positions, which are used where they are named: positions='{0}'"
    return replace(drive, notes=(*drive.notes, *map(offer.format, unused)))


def _drive(
    path: Path, recipe: Recipe, choices: Mapping[str, Choice], collectors: Mapping[str, Collector], frames: Frames,
    base: str,
) -> Drive:  # fmt: skip
    # fields are named by path, and times are stamps; open questions are units, clocks and axes
    options = replace(recipe.options, columns=None, time="ns", axes=_PLAIN)
    moved, notes = _odometry_table(collectors["odometry"], recipe.place("odometry", "use"))
    odometry = odometry_of(moved, options)
    seen, offset = _sightings_table(collectors["sightings"], recipe.options, frames, base)
    sightings = sightings_of(seen, options)
    truth = None
    if "truth" in collectors:
        try:
            read = truth_of(_poses_table(collectors["truth"]), options)
            check_overlap(odometry, read, "truth")
            truth = read
        except LogError as error:
            if choices["truth"].named:
                raise
            notes.append(f"the truth was left out: {error}")
    for kind, each in collectors.items():
        if each.unstamped > 0:
            which = "its messages have" if each.unstamped == len(each) else "some of its messages have"
            notes.append(f"{kind} {choices[kind].topic.name}: {which} no stamp, the time of their recording was taken")
    named = recipe.place("map", "file")
    landmarks = None if named is None else map_of(table_of(path.parent / named, "map"), recipe.options, sightings.names)
    place = recipe.options.sensor_offset or offset
    measured: dict[str, Timed] = {}
    for kind, table_of_poses in MEASURED_TOPICS.items():
        # from their topic, or from a table beside the bag
        if isinstance(found := collectors.get(kind), Poses):
            table, remarks = table_of_poses(found, frames, base, **recipe.numbers.get(kind, {}))
            measured[kind] = READERS[kind](table, options)
            notes += remarks
        elif (file := recipe.place(kind, "file")) is not None:
            measured[kind] = READERS[kind](table_of(path.parent / file, kind), recipe.options)
    return Drive(odometry, sightings, truth, landmarks, place, tuple(notes), recipe.options.truth_offset, **measured)


def _choices(bag: Bag, found: Sequence[Candidate], recipe: Recipe) -> list[Choice]:
    """The topics to read: those of the recipe, else the best ones."""
    by_name = {topic.name: topic for topic in bag.topics}
    best = {each.chosen: each.topic for each in found if each.chosen}
    transforms = next((topic for topic in bag.topics if topic.type in TF and "static" not in topic.name), None)
    choices = []
    for kind in ("odometry", "sightings", "truth", *MEASURED_TOPICS):
        name = recipe.place(kind, "topic")
        if kind in MEASURED_TOPICS and (name is None or (bag.path.parent / name).is_file()):
            # only where they are named: a message does not say whether its pose is a measurement of its own
            continue
        parent, child = recipe.place(kind, "parent") or "", recipe.place(kind, "child") or ""
        if name is not None:
            name = name if name in by_name or f"/{name}" not in by_name else f"/{name}"
            if name not in by_name:
                hint = checks.suggestion(name, by_name) or f"; its topics are {named(by_name) or 'none'}"
                raise FormatError(bag.path, None, f"there is no topic {quoted(name)}{hint}")
            choices.append(Choice(kind, by_name[name], parent, child, named=True))
        elif parent or child:
            if transforms is None:
                raise FormatError(bag.path, None, f"there is no topic of TF, which should have {kind} from frames")
            choices.append(Choice(kind, transforms, parent, child, named=True))
        elif kind in best:
            choices.append(Choice(kind, best[kind]))
        elif kind != "truth" and transforms is not None and (pair := _pair(bag, transforms, kind)):
            choices.append(Choice(kind, transforms, *pair))
    for choice in choices:
        if choice.topic.type in TF and not (choice.parent or choice.child):
            advice = f"say which: [{choice.kind}] parent = .. and child = .. in the recipe"
            raise FormatError(bag.path, None, f"{choice.topic.name} has many frames; {advice}")
    return choices


def _pair(bag: Bag, topic: Topic, kind: str) -> tuple[str, str] | None:
    """The frames in TF that could be odometry, or sightings of landmarks; None where there are none."""
    for count, (_, _, message) in enumerate(bag.messages([topic.name])):
        for each in message.transforms:
            parent, child = clean(each.header.frame_id), clean(each.child_frame_id)
            if kind == "odometry" and parent == "odom" and child in _BASES:
                return parent, child
            if kind == "sightings":
                for pattern in _TAGS:
                    if child.startswith(pattern.strip("*")) and child[-1:].isdigit():
                        return parent, pattern
        if count > 10_000:
            break
    return None


def _collector(bag: Bag, choice: Choice, options: TableOptions) -> Collector:
    source = f"{bag.path}: {choice.topic.name}"
    if choice.kind in MEASURED_TOPICS:
        return Poses(source, choice.kind, choice.topic.type)
    plan = plan_of(source, choice.kind, choice.topic.type, bag.types, options.columns_of(choice.kind))
    return Collector(source, plan, parent=choice.parent, child=choice.child)


def _base(odometry: Collector, recipe: Recipe, frames: Frames) -> str:
    """The frame of the robot."""
    named = recipe.place("odometry", "child")
    if named or odometry.child:
        return clean(named or odometry.child)
    known = frames.parents.keys() | {parent for parent, _, _ in frames.parents.values()}
    return next((name for name in _BASES if name in known), "base_link")


def _stated(options: TableOptions) -> bool:
    """Whether the user states the place of the sensor."""
    return options.sensor_offset is not None or options.sensor_yaw is not None or options.axes not in (None, _PLAIN)


def _odometry_table(collector: Collector, use: str | None) -> tuple[Columns, list[str]]:
    """The odometry from the twist or from the poses: the recipe's choice, else the twist where it is not zero."""
    if use not in (None, "twist", "pose"):
        raise FormatError(collector.source, None, f'use should be "twist" or "pose", not {quoted(use)}')
    notes, plain = list[str](), [name for name in collector.plan.columns if "." not in name]
    if not collector.plan.places or (use == "twist" and plain):
        return _plain_table(collector, plain), notes
    if use == "pose" or not plain:
        return _poses_table(collector), notes
    controls = collector.columns(["nu", "omega"])
    if not np.any(controls):
        return _poses_table(collector), [f"{collector.source}: the twist is zero throughout, the poses were taken"]
    place = collector.plan.places[0]
    positions = collector.columns([f"{place}.x", f"{place}.y"])
    driven = float(np.sum(np.hypot(*np.diff(positions, axis=0).T)))
    spent = np.clip(np.diff(collector.times) / 1e9, 0.0, None)
    claimed = float(np.sum(np.abs(controls[:-1, 0]) * spent))
    if driven > 0 and abs(claimed - driven) > _DIFFER * max(claimed, driven):
        ways = f"the twist drives {claimed:.1f} m and the poses {driven:.1f} m; the twist was taken"
        notes.append(f'{collector.source}: {ways}, [odometry] use = "pose" in the recipe takes the poses')
    return _plain_table(collector, plain), notes


def _plain_table(collector: Collector, names: list[str], place: str = "") -> Columns:
    """The table of some columns, in whose names the place is left out."""
    named = dict(zip((name.removeprefix(place) for name in names), collector.columns(names).T))
    return Columns(collector.source, {"t": collector.times, **named}, rows="message")


def _poses_table(collector: Collector) -> Columns:
    place = f"{collector.plan.places[0]}." if collector.plan.places else ""
    names = [name for name in collector.plan.columns if name.startswith(place) and not (place and name.endswith(".z"))]
    return _plain_table(collector, names, place)


def _sightings_table(
    collector: Collector, options: TableOptions, frames: Frames, base: str
) -> tuple[Columns, tuple[float, float] | None]:
    """The sightings in the axes of the robot, and the place of the sensor where the bag has it."""
    ids, classes = collector.ids(), collector.classes()
    if ids is None and "class" not in options.columns_of("sightings"):
        # the only name that a detection has is that of its landmark, unless the user says that it is a class
        ids, classes = classes, None
    named = {"id": ids, "class": classes}
    columns: dict[str, Any] = {"t": collector.times} | {name: a for name, a in named.items() if a is not None}
    if not collector.plan.places:
        names = list(collector.plan.columns)
        values = collector.columns(names)
        if {"x", "y"} <= set(names):
            x, y = (names.index(name) for name in "xy")
            values[:, [x, y]] = values[:, [x, y]] @ AXES[options.axes or _PLAIN][:2, :2].T
        columns |= dict(zip(names, values.T))
        return Columns(collector.source, columns, rows="row"), None
    for place in collector.plan.places:
        positions = collector.columns([f"{place}.{axis}" for axis in "xyz"])
        if np.nan_to_num(positions).any():
            break
    else:
        message = "its detections have no positions, all are zero or absent"
        raise FormatError(collector.source, None, f"{message}; a range takes a position in space or a size")
    known = np.isfinite(positions).all(axis=1)
    offset, turn = None, np.eye(3)
    if _stated(options):
        plain = "optical" if "optical" in collector.frame else _PLAIN
        turn = AXES[plain if options.axes in (None, _PLAIN) else options.axes]
    elif collector.frame not in ("", base):
        mounted = frames.between(base, collector.frame)
        if mounted is None:
            lost = f"no fixed transform in TF leads from there to {quoted(base)}, the robot"
            advice = "state where the sensor is: sensor_offset=[FORWARD, LEFT], and sensor_yaw=RADIANS or axes=NAME"
            frame = f"its positions are in the frame {quoted(collector.frame)}"
            raise FormatError(collector.source, None, f"{frame}, and {lost}; {advice}")
        offset, turn = (float(mounted[0][0]), float(mounted[0][1])), mounted[1]
    positions = positions @ turn.T
    columns |= {"x": positions[:, 0], "y": positions[:, 1]}
    if (psi := _orientations(collector, place, positions, turn)) is not None:
        columns["orientation"] = psi
    if not known.all():
        columns = {name: values[known] for name, values in columns.items()}
    return Columns(collector.source, columns, rows="row"), offset if offset != (0.0, 0.0) else None


def _orientations(collector: Collector, place: str, positions: Array, turn: Array) -> Array | None:
    """psi of each landmark (N,), from its x axis in the plane, or its z axis where x is upright; None without turns."""
    names = [f"{place}.q{axis}" for axis in "xyzw"]
    if names[0] not in collector.plan.columns:
        return None
    quaternions = collector.columns(names)
    if not np.isfinite(quaternions).all() or np.any(np.linalg.norm(quaternions, axis=1) < 0.5):
        return None
    if np.ptp(quaternions, axis=0).max() == 0:
        return None  # an orientation that never changes was not measured
    rotations = turn @ rotation_of(quaternions)
    # the first column is where the x axis of the landmark points
    axis = 0 if np.mean(np.hypot(rotations[:, 0, 0], rotations[:, 1, 0])) > 0.7 else 2
    heading = np.arctan2(rotations[:, 1, axis], rotations[:, 0, axis])
    return wrap(np.arctan2(positions[:, 1], positions[:, 0]) - heading)


def _read(path: Path, options: ReadOptions) -> Log:
    recipe = merged(recipe_if_any(path.with_suffix(".toml")), {"strict": options.strict or None})
    return drive_of_bag(path, recipe).log(options, path.resolve().stem)


FORMAT = Format("bag", is_bag, _read, separate_times=True)
