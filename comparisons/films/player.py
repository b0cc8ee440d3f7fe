"""A film as one HTML page that needs nothing else: its pictures, a slider, and a play button."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Callable, Sequence
from html import escape
from string import Template

import numpy as np

from .palette import indexed


def page(
    pictures: Sequence[np.ndarray], fps: float, title: str, lit: Sequence[int], progress: Callable[[], None]
) -> str:
    """The page of pictures (height, width, 3), as text.

    Args:
        pictures: uint8.
        fps: pictures per second at the speed "1 x".
        title: of the page.
        lit: the numbers of pictures with colours of their own.
        progress: called after each picture.
    """
    height, width = pictures[0].shape[:2]
    encoded = []
    for image in indexed(pictures, lit, progress):
        buffer = io.BytesIO()
        image.save(buffer, format="PNG", optimize=False, compress_level=9)
        encoded.append("data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode())
    return _PAGE.substitute(
        title=escape(title), width=width, height=height, last=len(encoded) - 1, first=encoded[0], fps=json.dumps(fps),
        pictures=json.dumps(encoded),
    )  # fmt: skip


# the pictures that are not shown are decoded by the browser when they are needed, from data that are in the page
_PAGE = Template("""\
<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>$title</title>
<link rel="icon" href="data:,">
<style>
body { font: 14px system-ui, sans-serif; margin: 8px; color: #222; background: #fff; max-width: ${width}px; }
img { width: 100%; height: auto; aspect-ratio: $width / $height; display: block; }
form { display: flex; gap: 8px; align-items: center; }
input { flex: 1; min-width: 0; }
button, select { font: inherit; }
output { font-variant-numeric: tabular-nums; min-width: 5em; text-align: right; }
</style>
</head>
<body>
<img id="picture" alt="$title" src="$first">
<form id="controls">
<button type="button" id="play" title="space bar">Pause</button>
<input type="range" id="slider" aria-label="picture" min="0" max="$last" value="0">
<output id="place"></output>
<label>speed <select id="speed">
<option value="0.25">¼ ×</option><option value="0.5">½ ×</option><option value="1" selected>1 ×</option>
<option value="2">2 ×</option><option value="4">4 ×</option>
</select></label>
</form>
<script>
"use strict";
const pictures = $pictures, fps = $fps;
const [picture, play, slider, place, speed] =
  ["picture", "play", "slider", "place", "speed"].map(id => document.getElementById(id));
let now = 0, timer = null;
function show(k) {
  now = k;
  picture.src = pictures[k];
  slider.value = k;
  place.textContent = (k + 1) + " / " + pictures.length;
}
function stop() {
  clearTimeout(timer);
  timer = null;
  play.textContent = "Play";
}
function wait() {
  timer = setTimeout(step, 1000 / (fps * Number(speed.value)));
}
function step() {
  if (now + 1 >= pictures.length) return stop();
  show(now + 1);
  wait();
}
function start() {
  if (now + 1 >= pictures.length) show(0);
  play.textContent = "Pause";
  wait();
}
play.onclick = () => timer === null ? start() : stop();
slider.oninput = () => { stop(); show(Number(slider.value)); };
document.onkeydown = event => {
  if (event.target === speed) return;
  if (event.key === " ") { event.preventDefault(); play.onclick(); }
  const by = {ArrowLeft: -1, ArrowRight: 1}[event.key];
  if (by) { event.preventDefault(); stop(); show(Math.min(pictures.length - 1, Math.max(0, now + by))); }
};
show(0);
start();
</script>
</body>
</html>
""")
