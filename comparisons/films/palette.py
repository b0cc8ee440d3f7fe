"""Pictures of 255 colours: one palette for a whole film, so that what stands still stays the same in every picture."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from PIL import Image

from .projector import Projector

#: one less than a file can have: the last is left for "as in the picture before"
COLORS = 255
CLEAR = 255
#: how many pictures the colours are taken from, and how many more of those that light up
SAMPLES, LIT_SAMPLES = 10, 3


def indexed(
    pictures: Projector, lit: Sequence[int], progress: Callable[[], None]
) -> Iterator[tuple[np.ndarray, Image.Image]]:
    """The pictures (h, w, 3) of a film, one after the other, each with its copy in the film's one palette.

    Args:
        pictures: of the film.
        lit: the numbers of pictures with colours of their own.
        progress: called after each picture.
    """
    spread = np.linspace(0, len(pictures) - 1, SAMPLES).round().astype(int)
    taken = dict.fromkeys([*spread.tolist(), *lit[:: max(1, len(lit) // LIT_SAMPLES)]])
    # every other row loses no colour that anybody sees
    sheet = Image.fromarray(np.concatenate([pictures[k][::2] for k in taken]))
    palette = sheet.quantize(COLORS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    for picture in pictures:
        yield picture, Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE)
        progress()
