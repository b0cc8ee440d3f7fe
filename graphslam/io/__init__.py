"""Logs and pose graphs in files, tables and bags: `read` chooses the reader by the content of a file."""

from typing import TYPE_CHECKING

from ..lazy import lazy_names

if TYPE_CHECKING:
    from .formats import load as load
    from .formats import load_robots as load_robots
    from .formats import read as read
    from .formats import robots_in as robots_in
    from .formats import save as save

__getattr__, __dir__, __all__ = lazy_names(__name__)
