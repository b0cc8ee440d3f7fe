"""Pages with one figure that readers move: how tests open them and move what is in them."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from chromium import Chromium, find_browser

ROOT = Path(__file__).parents[2]
SITE = ROOT / "docs" / "_site"
sys.path.insert(0, str(SITE))
BROWSER = find_browser()
#: marks of the tests of such pages
MARKS = [
    pytest.mark.slow,
    pytest.mark.browser,
    pytest.mark.skipif(BROWSER is None, reason="needs a browser: apt-get install chromium"),
    pytest.mark.skipif(
        importlib.util.find_spec("markdown") is None, reason="needs the packages of the site: make docs"
    ),
    pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="needs ziglang: make engine-wasm"),
]
FIGURE = "document.querySelector('figure.live')"
PAGE = """<!doctype html><html lang="{language}"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<link rel="stylesheet" href="_site/extra.css"><link rel="icon" href="data:,"><body>{figure}
<script src="_site/live.js"></script></body></html>"""
Open = Callable[..., Chromium]


def switch(page: Chromium, name: str) -> None:
    page.click(f"figure.live input[data-name={name}]")


def drag(page: Chromium, selector: str, dx: float, dy: float, *, touch: bool = False) -> None:
    """Drag the middle of an element by pixels, with the mouse or a finger."""
    x, y = page.evaluate(f"""(() => {{
        const element = document.querySelector({selector!r});
        element.scrollIntoView({{ block: "center" }});
        const box = element.getBoundingClientRect();
        return [box.x + box.width / 2, box.y + box.height / 2]; }})()""")
    if touch:
        page.send("Input.dispatchTouchEvent", type="touchStart", touchPoints=[{"x": x, "y": y}])
        page.send("Input.dispatchTouchEvent", type="touchMove", touchPoints=[{"x": x + dx, "y": y + dy}])
        page.send("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
        return
    page.move_mouse(x, y)
    page.send("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, button="left", buttons=1, clickCount=1)
    page.send("Input.dispatchMouseEvent", type="mouseMoved", x=x + dx, y=y + dy, button="left", buttons=1)
    page.send("Input.dispatchMouseEvent", type="mouseReleased", x=x + dx, y=y + dy, button="left", clickCount=1)
