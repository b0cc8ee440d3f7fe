"""How outcomes look outside of a terminal: as HTML in a notebook, as text where they are printed."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from io import StringIO
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.table import Table

#: the width of tables that are not written to a terminal
WIDTH = 140


class Shown:
    """An outcome that a notebook shows as its tables with the remarks below, and ``print`` as text."""

    def shown(self) -> tuple[list[Table], list[str]]:
        """The tables, and the sentences below them."""
        raise NotImplementedError

    def __str__(self) -> str:
        tables, remarks = self.shown()
        return as_text(tables, remarks)

    def _repr_html_(self) -> str:
        tables, remarks = self.shown()
        return as_html(tables, remarks)


def as_text(tables: Sequence[Table], remarks: Sequence[str] = ()) -> str:
    """Tables and remarks in plain characters, `WIDTH` wide at most."""
    from rich.console import Console

    stream = StringIO()
    console = Console(file=stream, width=WIDTH, highlight=False, color_system=None)
    for table in tables:
        console.print(table)
    for remark in remarks:
        console.print(remark, markup=False, soft_wrap=True)
    return "\n".join(line.rstrip() for line in stream.getvalue().rstrip().splitlines())


def as_html(tables: Sequence[Table], remarks: Sequence[str] = ()) -> str:
    """Tables and remarks as HTML without scripts or styles of the page's own; all text escaped."""
    return "\n".join([*map(_table, tables), *(f"<p>{escape(remark)}</p>" for remark in remarks)])


def _table(table: Table) -> str:
    title = "" if table.title is None else f"<caption>{_plain(table.title)}</caption>"
    sides = [f' style="text-align:{column.justify}"' for column in table.columns]
    head = "".join(f"<th{side}>{_plain(column.header)}</th>" for column, side in zip(table.columns, sides))
    rows = zip(*(list(column.cells) for column in table.columns))
    body = "".join("<tr>" + "".join(f"<td{s}>{_plain(c)}</td>" for c, s in zip(row, sides)) + "</tr>" for row in rows)
    return f"<table>{title}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _plain(cell: object) -> str:
    """What a cell says, without rich's markup; broken headings in one line."""
    from rich.text import Text

    text = cell.plain if isinstance(cell, Text) else Text.from_markup(str(cell)).plain
    # headings are broken for narrow columns: con-/verged
    return escape(text.replace("-\n", "").replace("\n", " ").strip())
