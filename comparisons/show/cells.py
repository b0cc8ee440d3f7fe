"""The parts that all tables are made of: cells, and a table in which no number is ever cut."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from rich import box
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.table import Column, Table
from rich.text import Text

from graphslam.errors import printable

if TYPE_CHECKING:
    from graphslam import Certificate

NOTHING = "–"
#: columns of names wrap in a narrow terminal, but each keeps this width where it needs it
NAMES = 18


def number(value: float | None, digits: int = 3) -> str:
    """A number for a table: short, and a dash where it is not known."""
    if value is None or value != value:
        return NOTHING
    if value == 0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:.{digits}f}"
    return f"{value:.{digits - 1}e}"


def written(value: Any, form: str = "") -> str:
    """A value as the format says, and a dash where it is not known."""
    return NOTHING if value is None else format(value, form)


def seconds(value: float | None) -> str:
    """A time with the unit that suits it."""
    if value is None or value != value:
        return NOTHING
    if value < 1e-3:
        return f"{value * 1e6:.0f} µs"
    return f"{value * 1e3:.1f} ms" if value < 1 else f"{value:.2f} s"


def word(value: int | str | None) -> Text:
    """A name from the data, which may hold any characters; a dash where there is none."""
    return Text(NOTHING if value is None else printable(str(value)))


def yes_no(value: bool | None, more: str = "") -> Text:
    """Yes, no, or a dash where the question makes no sense; ``more`` follows in the same cell."""
    if value is None:
        return Text(NOTHING)
    answer = Text("yes", style="green") if value else Text("no", style="bold red")
    return answer.append(more, style="not bold default")


def optimum(certificate: Certificate | None) -> Text:
    """Whether a solver's end is proven to be the global minimum, with the relative gap; a dash where no proof applies.

    What the proof holds is named: the weights of a robust kernel, the parameters that were estimated.
    """
    if certificate is None or not certificate.applicable:
        return Text(NOTHING)
    if not certificate.proven:
        return Text("not proven")
    held = certificate.status.removeprefix("global")
    return Text(f"proven{held}", style="green").append(f", {certificate.relative_gap:.0e}", style="default")


class LeanTable(Table):
    """A table without frame. Names wrap, numbers never do: it becomes several tables where the terminal is too narrow.

    Args:
        title: above the table.
        names: the headings of the columns of names, which come first.
        numbers: the headings of the other columns, aligned to the right.
    """

    def __init__(self, title: str, names: Sequence[str], numbers: Sequence[str]) -> None:
        super().__init__(
            title=Text(printable(title), style="bold"), title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 0, 0, 1),
            pad_edge=False, show_edge=False,
        )  # fmt: skip
        # as Text: rich would take [m] for markup
        for heading in names:
            self.add_column(Text(heading), overflow="fold")
        for heading in numbers:
            self.add_column(Text(heading), justify="right", no_wrap=True)

    def add_row(self, *cells: RenderableType | None, **settings: Any) -> None:
        """Add a row; texts are shown as they are, without markup and without what controls a terminal."""
        super().add_row(*(_plain(cell) if isinstance(cell, str) else cell for cell in cells), **settings)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """The table, with narrow gaps where that lets it fit, else as few tables with the same rows as possible."""
        widths = [_width(column) for column in self.columns]
        names = [column for column in self.columns if not column.no_wrap]
        numbers = list(zip(self.columns, widths))[len(names) :]

        def split(gap: int, limit: int = options.max_width) -> list[list[Column]]:
            used = sum(min(NAMES, width) + gap for width in widths[: len(names)]) - gap
            return _split(numbers, limit - used, gap)

        gap = 1 if len(split(2)) > 1 == len(split(1)) else 2
        # as even as possible
        fewest, limits = len(split(gap)), range(1, options.max_width + 1)
        parts = next(even for limit in limits if len(even := split(gap, limit)) == fewest)
        for k, part in enumerate(parts):
            table = LeanTable("", (), ())
            table.title = None if k else self.title
            table.padding = (0, 0, 0, gap - 1)
            table.columns = [replace(column, _index=i) for i, column in enumerate((*names, *part))]
            table.rows = self.rows
            if k:
                yield ""
            yield from Table.__rich_console__(table, console, options)


def _plain(text: str) -> str | Text:
    """A cell that rich shows as it is: text with a bracket could be its markup."""
    return Text(printable(text)) if "[" in text else printable(text)


def _split(columns: Sequence[tuple[Column, int]], limit: int, gap: int) -> list[list[Column]]:
    """The columns, given with their widths, in runs no wider than the limit, or a single column where one is wider."""
    parts: list[list[Column]] = [[]]
    used = 0
    for column, width in columns:
        used += width + gap
        if parts[-1] and used > limit:
            parts.append([])
            used = width + gap
        parts[-1].append(column)
    return parts


def _width(column: Column) -> int:
    """The longest line of a column."""
    texts = (cell.plain if isinstance(cell, Text) else str(cell) for cell in (column.header, *column.cells))
    return max(cell_len(line) for text in texts for line in text.split("\n"))
