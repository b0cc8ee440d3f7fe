"""Labels of figures in Japanese: the texts of an SVG by `labels.toml`. PNG figures keep their English labels."""

from __future__ import annotations

import html
import re
import tomllib
from functools import cache
from pathlib import Path

_TEXT = re.compile(r"(<text\b[^>]*>)([^<]*)(</text>)")
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")


@cache
def _table() -> dict[str, str]:
    labels: dict[str, str] = tomllib.loads(Path(__file__).with_name("labels.toml").read_text())["labels"]
    return labels


def translated(label: str) -> str | None:
    """A label in Japanese; None where the table does not have it. Labels without words stay as they are."""
    key = _NUMBER.sub("{}", label)
    if not re.search(r"[A-Za-z]{2}", label):
        return label
    found = _table().get(label) or _table().get(key)
    return found.format(*_NUMBER.findall(label)) if found and "{}" in found else found


def in_japanese(svg: str) -> str:
    """An SVG with Japanese labels, as far as the table has them."""

    def text(found: re.Match[str]) -> str:
        label = html.unescape(found[2])
        return found[1] + html.escape(translated(label.strip()) or label, quote=False) + found[3]

    return _TEXT.sub(text, svg)


def missing(svg: str) -> set[str]:
    """The labels of an SVG that the table does not have."""
    labels = {html.unescape(label).strip() for _, label, _ in _TEXT.findall(svg)}
    return {label for label in labels if translated(label) is None}
