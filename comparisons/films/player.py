"""A film as one HTML page that needs nothing else: its pictures, a slider, and a play button."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Callable, Sequence
from html import escape
from string import Template

import numpy as np
from PIL import Image

from .palette import CLEAR, indexed
from .projector import Projector


def page(pictures: Projector, fps: float, title: str, lit: Sequence[int], progress: Callable[[], None]) -> str:
    """The page of a film, as text: what stands still is in it once, and each picture is laid over that.

    Args:
        pictures: of the film.
        fps: pictures per second at the speed "1 x".
        title: of the page.
        lit: the numbers of pictures with colours of their own.
        progress: called after each picture.
    """
    still = pictures.still
    height, width = still.shape[:2]
    over = []
    for picture, image in indexed(pictures, lit, progress):
        layer = Image.fromarray(np.where((picture == still).all(axis=2), CLEAR, np.asarray(image)).astype(np.uint8))
        palette = image.getpalette() or []
        # as long as it can be: what is clear needs an entry, too
        layer.putpalette(palette + [0] * (3 * (CLEAR + 1) - len(palette)))
        over.append(_data_url(layer, transparency=CLEAR))
    return _PAGE.substitute(
        title=escape(title), width=width, height=height, last=len(over) - 1, fps=json.dumps(fps),
        still=_data_url(Image.fromarray(still)), first=over[0], pictures=json.dumps(over),
    )  # fmt: skip


def _data_url(image: Image.Image, **options: int) -> str:
    buffer = io.BytesIO()
    image.save(buffer, format="PNG", **options)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()


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
#screen { position: relative; aspect-ratio: $width / $height; }
img { position: absolute; width: 100%; height: 100%; }
form { display: flex; gap: 8px; align-items: center; }
input { flex: 1; min-width: 0; }
button, select { font: inherit; }
output { font-variant-numeric: tabular-nums; min-width: 5em; text-align: right; }
</style>
</head>
<body>
<div id="screen"><img alt="" src="$still"><img id="picture" alt="$title" src="$first"></div>
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
