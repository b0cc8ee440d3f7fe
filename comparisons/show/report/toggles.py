"""The check boxes that show and hide: one per estimator with a sample of its line, one per layer."""

from __future__ import annotations

from html import escape

from .style import colour_of, line_of
from .view import View

#: name of the layer, its words, whether it is shown at first
LAYERS = (
    ("path", "paths", True),
    ("landmarks", "landmarks", True),
    ("landmark-ellipses", "landmark ellipses", True),
    ("pose-ellipses", "pose ellipses", False),
    ("truth", "truth", True),
    ("now", "robot at the step", True),
)


def estimator_toggles(view: View) -> str:
    """Labels with check boxes, all checked."""
    return "\n".join(
        f'<label><input type="checkbox" checked data-estimator="{escape(e.name)}">{_sample(e.name)}{escape(e.name)}</label>'
        for e in view.estimates
    )


def layer_toggles(view: View) -> str:
    """Labels with check boxes of the layers that the map has."""
    known_poses = any(e.covariances is not None for e in view.estimates)
    shown = [layer for layer in LAYERS if known_poses or layer[0] != "pose-ellipses"]
    return "\n".join(
        f'<label><input type="checkbox"{" checked" if on else ""} data-layer="{name}">{words}</label>'
        for name, words, on in shown
    )


def _sample(name: str) -> str:
    """A short piece of an estimator's line, as a picture for the eye only: the name stands beside it."""
    look, colour = line_of(name, 0), colour_of(name)
    line = look["line"]
    dash = "" if line.get("dash", "solid") == "solid" else f' stroke-dasharray="{line["dash"].replace("px", "")}"'
    mark = ""
    if "marker" in look:
        cross = look["marker"]["symbol"].startswith("x")
        shape = '<path d="M13 4l8 8m0-8l-8 8"' if cross else '<circle cx="17" cy="8" r="4"'
        mark = f'{shape} fill="none" stroke="{colour}" stroke-width="1.6"/>'
    return (
        f'<svg width="34" height="16" aria-hidden="true"><line x1="0" y1="8" x2="34" y2="8" stroke="{colour}" '
        f'stroke-width="{line["width"]:.1f}"{dash}/>{mark}</svg>'
    )
