"""Named worlds for the simulator, and the sample log that was made in one of them."""

from __future__ import annotations

from importlib.resources import files
from math import pi
from pathlib import Path
from typing import Any

from .simulator import BOOK_LANDMARKS

#: keyword arguments of `simulate`, by name
WORLDS: dict[str, dict[str, Any]] = {
    # six landmarks around a circle, as in the logs of the book
    "book": {
        "steps": 62, "dt": 3.0, "speed": 0.2, "turn_rate": pi / 36, "start": (0.0, -3.0, 0.0),
        "landmarks": BOOK_LANDMARKS,
    },
    # two rounds through thirteen landmarks; the robot sees about two of them at a time
    "garden": {
        "steps": 160, "dt": 1.0, "speed": 0.4, "turn_rate": 0.5, "start": (0.0, -2.5, 0.0),
        "max_range": 5.0, "field_of_view": pi,
        "way_points": ((4, -3.5), (6, 0), (4, 3.5), (0, 2), (-4, 3.5), (-6, 0), (-4, -3.5), (0, -2)),
        "landmarks": (
            (-7.5, -3.5), (-7.5, 3), (-4, 0), (-2, 5), (2, 4.6), (0, 0), (4, 0), (7.5, 3.2), (7.6, -3), (2.2, -4.8),
            (-2, -4.8), (-4.9, 5.6), (5.2, 6),
        ),
    },
}  # fmt: skip


def sample_log_path() -> Path:
    """The log shipped with the package, made by ``slam-compare simulate sample.npz --world garden --seed 1``."""
    return Path(str(files("graphslam") / "data" / "sample.npz"))
