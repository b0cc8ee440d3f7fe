"""The log of a drive: controls, sightings and other measurements, and what is made of them before a graph."""

from .log import UNIDENTIFIED, Log, check_is_log

__all__ = ["Log", "UNIDENTIFIED", "check_is_log"]
