"""Pictures of 255 colours: one palette for a whole film, so that what stands still stays the same in every picture."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from PIL import Image
from scipy.spatial import cKDTree

from .projector import Projector

#: one less than a file can have: the last is left for "as in the picture before"
COLORS = 255
CLEAR = 255
#: how many of the most frequent colours are kept as they are
EXACT = 64
#: colours are alike when no channel differs by more
ALIKE = 32
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
    palette = _palette(np.concatenate([_codes(pictures[k]).ravel() for k in taken]))
    nearest, flat = cKDTree(_channels(palette)), _channels(palette).astype(np.uint8).ravel().tolist()
    # the entry of each of the 2^24 colours, looked for when it first occurs
    entries = np.full(1 << 24, -1, dtype=np.int16)
    for picture in pictures:
        codes = _codes(picture)
        new = np.unique(codes[entries[codes] < 0])
        if len(new):
            entries[new] = nearest.query(_channels(new))[1]
        image = Image.fromarray(entries[codes].astype(np.uint8))
        image.putpalette(flat)
        yield picture, image
        progress()


def _palette(codes: np.ndarray) -> np.ndarray:
    """The colours of a film, as codes, from those of some of its pictures.

    What covers most is kept exactly, so that white stays white, and so is one of each kind of colour, so that a small dot
    keeps its own. The rest is divided among the colours that occur, each counted once.
    """
    found, counts = np.unique(codes, return_counts=True)
    found = found[np.argsort(-counts, kind="stable")]
    exact, left = found[:EXACT], found
    while len(left) and len(exact) < 2 * EXACT:
        # the most frequent of those that are like none so far
        exact = np.append(exact, left[0])
        left = left[np.abs(_channels(left) - _channels(left[:1])).max(axis=1) > ALIKE]
    exact = np.unique(exact)
    others = Image.fromarray(_channels(found).astype(np.uint8)[None])
    mixed = np.array(others.quantize(COLORS - len(exact), method=Image.Quantize.MEDIANCUT).getpalette(), dtype=np.int64)
    return np.concatenate([exact, mixed.reshape(-1, 3) @ _WEIGHTS])[:COLORS]


_WEIGHTS = np.array([65536, 256, 1])


def _codes(picture: np.ndarray) -> np.ndarray:
    return picture.astype(np.int64) @ _WEIGHTS


def _channels(codes: np.ndarray) -> np.ndarray:
    return np.stack([codes >> 16, codes >> 8 & 255, codes & 255], axis=-1)
