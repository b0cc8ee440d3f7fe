"""Tables of logs: what an import found."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from .cells import NOTHING, LeanTable, number

if TYPE_CHECKING:
    from ..importing import Import
    from .tables import Tables


def import_tables(found: Import) -> Tables:
    """A row per table or topic; below, what the reader remarked."""
    title = "what was found" if found.source is None else f"what was found in {found.source}"
    table = LeanTable(title, ["", "source"], ["rows", "from\n[s]", "to\n[s]", "rate\n[Hz]"])
    for stream in found.streams:
        table.add_row(
            stream.kind,
            Path(stream.source).name,
            str(stream.rows),
            f"{stream.begin:.2f}",
            f"{stream.end:.2f}",
            NOTHING if stream.rate is None else number(stream.rate),
        )
    log = found.log
    sizes = f"The log has {log.num_poses} poses and {len(log.steps)} sightings of {len(log.landmark_ids)} landmarks"
    known = f"; the true map has {found.landmarks} landmarks" if found.landmarks is not None else ""
    columns = [f"Columns of {stream.kind}: {', '.join(stream.columns)}." for stream in found.streams]
    return [table], [*columns, f"{sizes}{known}.", *(f"{note}." for note in log.notes)]
