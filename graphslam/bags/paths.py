"""Fields of messages by their path: ``pose.pose.position.x``, or ``detections[].id`` in each element of a list."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from operator import attrgetter
from typing import Any

#: nodes of definitions in rosbags: a base type, a named type, an array and a sequence
_BASE, _NAME, _ARRAY, _SEQUENCE = 1, 2, 3, 4
_DEEPEST = 8


def leaves(types: Any, type: str) -> dict[str, str]:
    """The fields of a message type that hold numbers or text: {path: base type}.

    A list of messages adds [] to the path. Lists of numbers are left out, except those that could be an id.
    """
    return dict(_leaves(types, type, "", 0))


def _leaves(types: Any, type: str, prefix: str, depth: int) -> Iterator[tuple[str, str]]:
    if depth > _DEEPEST or type not in types:
        return
    for name, (node, value) in types[type][1]:
        path = f"{prefix}{name}"
        if node == _BASE:
            yield path, value[0]
        elif node == _NAME:
            yield from _leaves(types, value, f"{path}.", depth + 1)
        else:
            inner, content = value[0]
            if inner == _NAME:
                yield from _leaves(types, content, f"{path}[].", depth + 1)
            elif name.endswith("id"):
                yield f"{path}[]", content[0]


def lists(path: str) -> str:
    """The path of the list whose elements are rows, "detections" of "detections[].id"; empty where there is none."""
    return path.partition("[].")[0] if "[]." in path else ""


def getter(path: str) -> Callable[[Any], Any]:
    """The value of a path in a message or element; of a list within it the first entry, None where it is empty."""
    parts = path.split("[]")
    if len(parts) == 1:
        return attrgetter(path)
    first, rest = attrgetter(parts[0]), "[]".join(parts[1:]).lstrip(".")
    inner = getter(rest) if rest else None

    def value(message: Any) -> Any:
        entries = first(message)
        if len(entries) == 0:
            return None
        return inner(entries[0]) if inner else entries[0]

    return value
