"""Tables of a drive, as a user would write them, and how to change one of them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

T = np.arange(0, 20.01, 0.1)
NU, OMEGA = 0.5 + 0.1 * np.sin(T), 0.3 * np.cos(T / 3)
SEEN = [(0.2, 3, 2.0, 0.1), (0.2, 4, 3.0, -0.5), (1.0, 3, 1.7, 0.2), (5.0, 4, 2.5, 0.7), (9.0, 5, 1.0, -1.0)]
SEEN += [(9.5, 3, 4.0, 1.2), (12.0, 5, 2.2, 0.3)]
#: rows of the table of odometry
ODOMETRY = list(zip(T.tolist(), NU.tolist(), OMEGA.tolist()))


def text(header: str, rows: Iterable, separator: str = ",") -> str:
    return "\n".join([header, *(separator.join(map(str, row)) for row in rows)]) + "\n"


def as_deg(rows: list) -> list:
    return [(t, j, r, float(np.rad2deg(b))) for t, j, r, b in rows]


def write_tables(
    folder: Path, odometry: str | None = None, sightings: str | None = None, **others: str | bytes
) -> Path:
    """The folder with the tables, of which those that are given are different."""
    folder.mkdir(exist_ok=True)
    odometry = odometry or text("t,nu,omega", ODOMETRY)
    sightings = sightings or text("t,id,range,bearing", SEEN)
    for name, content in {"odometry": odometry, "sightings": sightings, **others}.items():
        path = folder / (f"{name}.csv" if name != "recipe" else "import.toml")
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder
