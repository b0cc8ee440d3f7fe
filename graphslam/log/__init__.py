"""The log of a drive: controls, sightings and other measurements, and what is made of them before a graph."""

from typing import TYPE_CHECKING

from ..lazy import lazy_names

if TYPE_CHECKING:
    from .join import Log as Log
    from .log import UNIDENTIFIED as UNIDENTIFIED
    from .log import check_is_log as check_is_log

__getattr__, __dir__, __all__ = lazy_names(__name__)
