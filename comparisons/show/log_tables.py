"""Tables of logs: what an import found."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from .cells import NOTHING, LeanTable, number

if TYPE_CHECKING:
    from ..importing import Import
    from .tables import Tables


def import_tables(found: Import) -> Tables:
    """A row per topic and per stream that was read; below, the columns and what the reader remarked."""
    tables: list[Table] = []
    if found.topics:
        topics = LeanTable(f"topics of {found.source}", ["topic", "type"], ["messages", "could be", "chosen"])
        for topic in found.topics:
            type = topic.type.replace("/msg/", "/")
            topics.add_row(topic.name, type, str(topic.count), topic.could_be or NOTHING, "yes" if topic.chosen else "")
        tables.append(topics)
    if found.log is None:
        return tables, []
    title = "what was read" if found.source is None else f"what was read from {found.source}"
    table = LeanTable(title, ["", "source"], ["rows", "from\n[s]", "to\n[s]", "rate\n[Hz]"])
    for stream in found.streams:
        table.add_row(
            stream.kind,
            stream.source.rpartition(": ")[2] if found.topics else Path(stream.source).name,
            str(stream.rows),
            f"{stream.begin:.2f}",
            f"{stream.end:.2f}",
            NOTHING if stream.rate is None else number(stream.rate),
        )
    log = found.log
    sizes = f"The log has {log.num_poses} poses and {len(log.steps)} sightings of {len(log.landmark_ids)} landmarks"
    known = f"; the true map has {found.landmarks} landmarks" if found.landmarks is not None else ""
    columns = [f"Columns of {stream.kind}: {', '.join(stream.columns)}." for stream in found.streams]
    return [*tables, table], [*columns, f"{sizes}{known}.", *(f"{note}." for note in log.notes)]
