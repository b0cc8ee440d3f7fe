"""The literature at the end of a chapter, from `literature.toml`: sections of the book, the slides, and papers."""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path
from typing import Any

HEADING = {"en": "## Literature { #literature data-search-exclude }", "ja": "## 参考文献 {#literature}"}
BOOK = {
    "en": "Ryuichi Ueda, *Shosai kakuritsu robotics* (Kodansha, 2019), {sections}, and the [slides]({slides}).",
    "ja": "上田隆一『詳解 確率ロボティクス』（講談社、2019年）{sections}と[スライド]({slides})。",
}
SECTIONS = {"en": ("section {}", "sections {}", ", ", " and "), "ja": ("{}", "{}", "、", "、")}


@cache
def _all() -> dict[str, Any]:
    return tomllib.loads(Path(__file__).with_name("literature.toml").read_text())


def chapters() -> dict[str, Any]:
    """The literature of each chapter, by the name of its page."""
    chapters: dict[str, Any] = _all()["chapters"]
    return chapters


def papers() -> dict[str, dict[str, str]]:
    """The papers by their short names."""
    papers: dict[str, dict[str, str]] = _all()["papers"]
    return papers


def section(page: str, language: str) -> str:
    """The literature of a page as Markdown; empty where the page is no chapter."""
    if page not in chapters():
        return ""
    chapter = chapters()[page]
    one, many, comma, final = SECTIONS[language]
    numbers = chapter["sections"]
    if language == "ja":
        numbers = [number + "章節項"[number.count(".")] for number in numbers]
    named = (one if len(numbers) == 1 else many).format(
        numbers[0] if len(numbers) == 1 else comma.join(numbers[:-1]) + final + numbers[-1]
    )
    slides = _all()["slides"][chapter["slides"]]
    lines = [HEADING[language], "", "- " + BOOK[language].format(sections=named, slides=slides)]
    for name in chapter["papers"]:
        paper = papers()[name]
        lines.append(f"- {paper['authors']} ({paper['year']}). {paper['title']}. {paper['in']}. {paper[language]}")
    return "\n".join(lines)
