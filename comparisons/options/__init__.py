"""The options of every verb, declared once, and the files that hold them."""

from .options import *  # noqa: F403
