"""Films as files: GIF through Pillow, MP4 through matplotlib's writer for ffmpeg, HTML through ``player.html``."""

from __future__ import annotations

import base64
import io
import json
import subprocess
from collections.abc import Callable, Iterator
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.animation import FFMpegWriter
from matplotlib.figure import Figure
from PIL import Image

from graphslam.errors import OptionError, printable
from graphslam.files import write_whole

from ...results.files import check_can_write
from ..language import translated

if TYPE_CHECKING:
    from .scene import Film

#: how long the last picture stays before the film begins again [s]
HOLD = 2.0
#: one less than a palette can have: the last entry stands for "as in the background"
CLEAR = 255
#: pictures that the colours are taken from, beside as many of those that light up
SAMPLES = 8


def check_can_film(path: Path) -> None:
    """Raise before the frames are drawn if no film can be written at ``path``.

    Raises:
        OptionError: the suffix is none of .gif, .mp4 and .html, or is .mp4 and there is no ffmpeg.
        FormatError: the place cannot be written.
    """
    check_can_write(path, endings=tuple(_WRITERS))
    if path.suffix.lower() == ".mp4" and not FFMpegWriter.isAvailable():
        raise OptionError(f"{path}: .mp4 needs the program ffmpeg: install it, or write a .gif or .html")


def write_film(film: Film, path: Path, progress: Callable[[], None]) -> None:
    """Write a film in the format that the suffix names, whole or not at all.

    Raises:
        OptionError: ffmpeg fails.
        FormatError: the place cannot be written.
    """
    with write_whole(path) as temporary:
        try:
            _WRITERS[path.suffix.lower()](film, temporary, progress)
        except subprocess.CalledProcessError as error:
            reason = [f"status {error.returncode}", *(error.stderr or "").strip().splitlines()][-1]
            raise OptionError(f"{path}: ffmpeg failed: {reason}") from None


def player(film: Film, progress: Callable[[], None]) -> str:
    """A page with a player, which needs no other file: the background once, and each picture as a layer above it."""
    still = film.pictures.still
    layers = []
    for picture, image in _indexed(film, progress):
        layer = Image.fromarray(np.where((picture == still).all(axis=2), CLEAR, np.asarray(image)).astype(np.uint8))
        layer.putpalette(image.getpalette() or [])
        layers.append(_data_url(layer, transparency=CLEAR))
    names = ("Play", "Pause", "speed", "picture", "space bar")
    words = {name.lower().replace(" ", "_"): translated(name, film.language) for name in names}
    template = Template(files("comparisons.show.films").joinpath("player.html").read_text(encoding="utf-8"))
    return template.substitute(
        lang=film.language, title=escape(translated(film.title, film.language)), **words,
        width=still.shape[1], height=still.shape[0], last=len(layers) - 1,
        fps=json.dumps(film.fps), still=_data_url(Image.fromarray(still)), first=layers[0], pictures=json.dumps(layers),
    )  # fmt: skip


def _write_gif(film: Film, path: Path, progress: Callable[[], None]) -> None:
    # the format counts hundredths of a second, and viewers take a single one for ten
    duration = max(20, round(100 / film.fps) * 10)
    durations = [duration] * (len(film) - 1) + [max(duration, round(1000 * HOLD))]
    images = (image for _, image in _indexed(film, progress))
    first = next(images)
    # a file of our own, which is closed when the film is interrupted
    timing = {"append_images": images, "duration": durations, "loop": 0}
    with path.open("wb") as file:
        first.save(file, format="GIF", save_all=True, disposal=1, optimize=False, **timing)


def _write_mp4(film: Film, path: Path, progress: Callable[[], None]) -> None:
    """Show the pictures one after the other in a figure of their size, and let matplotlib hand it to ffmpeg."""
    height, width = film.pictures.still.shape[:2]
    figure = Figure(figsize=(width / 100, height / 100), dpi=100)
    screen = figure.figimage(film.pictures.still)
    fps: Any = film.fps  # ffmpeg takes fractions, too
    options = ["-movflags", "+faststart", "-f", "mp4"]
    writer = FFMpegWriter(fps=fps, metadata={"title": printable(film.title)}, extra_args=options)
    with writer.saving(figure, str(path), dpi=100):
        for number, picture in enumerate(film.pictures):
            screen.set_data(picture)
            for _ in range(1 if number < len(film) - 1 else round(HOLD * film.fps)):
                writer.grab_frame()
            progress()


def _write_html(film: Film, path: Path, progress: Callable[[], None]) -> None:
    path.write_text(player(film, progress), encoding="utf-8")


_WRITERS = {".gif": _write_gif, ".mp4": _write_mp4, ".html": _write_html}


def _indexed(film: Film, progress: Callable[[], None]) -> Iterator[tuple[np.ndarray, Image.Image]]:
    """The pictures (h, w, 3) of a film, each with its copy in the palette that all of them share.

    With one palette what does not move has the same colours in every picture. Each colour that occurs counts once in it,
    so that a small dot keeps its own.
    """
    # frames that light up have colours of their own
    bright = [number for number, frame in enumerate(film.frames) if frame.flash]
    spread = np.linspace(0, len(film) - 1, SAMPLES).round().astype(int).tolist()
    samples = dict.fromkeys([*spread, *bright[:: max(1, len(bright) // SAMPLES)]])
    pictures = (Image.fromarray(film.pictures[k]) for k in samples)
    colours = {colour for picture in pictures for _, colour in picture.getcolors(maxcolors=1 << 24) or ()}
    each_once = Image.fromarray(np.array([sorted(colours)], dtype=np.uint8))
    palette = each_once.quantize(CLEAR, method=Image.Quantize.MAXCOVERAGE)
    # as long as it can be, since what is clear needs an entry, too
    palette.putpalette((palette.getpalette() or [])[: 3 * CLEAR] + [255, 255, 255])
    for picture in film.pictures:
        yield picture, Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE)
        progress()


def _data_url(image: Image.Image, **options: int) -> str:
    buffer = io.BytesIO()
    image.save(buffer, format="PNG", **options)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()
