"""Animations of an estimator at work: an animated GIF, an MP4, or an HTML page with a player."""

from .animation import animate
from .film import Film
from .files import check_can_film

__all__ = ["Film", "animate", "check_can_film"]
