"""Labels of figures in Japanese, by `labels.toml`."""

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
    if not re.search(r"[A-Za-z]{2}", re.sub(r"\$[^$]*\$", "", label)):
        return label
    found = _table().get(label) or _table().get(key)
    return found.format(*_NUMBER.findall(label)) if found and "{}" in found else found


def in_japanese(text: str) -> str:
    """A text of a figure, line by line, in Japanese as far as the table has it."""
    return "\n".join(translated(line.strip()) or line for line in text.split("\n"))


def missing(figure: Path) -> set[str]:
    """The labels of a figure that the table does not have."""
    if figure.suffix == ".png":
        from PIL import Image

        found = Image.open(figure).text["Description"].split("\n")
    else:
        found = [html.unescape(label) for _, label, _ in _TEXT.findall(figure.read_text())]
    return {label.strip() for label in found if translated(label.strip()) is None}
