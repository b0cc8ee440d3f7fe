"""Animations of an estimator at work: an animated GIF, an MP4, or an HTML page with a player."""

from .animation import animate
from .files import check_can_film
from .film import Film

__all__ = ["Film", "animate", "check_can_film"]
