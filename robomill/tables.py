"""What commands print: tables that become lists where the screen is too narrow for them, sentences, and notes in short."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

if TYPE_CHECKING:  # rich takes a tenth of a second to load, and a run begins without it
    from rich.console import Console
    from rich.text import Text

Content: TypeAlias = "str | Text"
"""A text as it is, or one with colours."""
PIPED_WIDTH = 120
"""Columns of a table where standard output is no terminal and COLUMNS does not say how many there are."""
MOST_NOTES = 3
"""Notes that are printed; files hold all of them."""


class Heading(NamedTuple):
    """The head of a column."""

    text: str
    """Lines are separated by a newline: the last one is the unit."""
    justify: Literal["left", "right"] = "right"
    folds: bool = False
    """Whether long cells may go on in the next line."""


def console() -> Console:
    """Standard output: as wide as the terminal or COLUMNS, else PIPED_WIDTH."""
    from rich.console import Console

    return Console() if _has_width() else Console(width=PIPED_WIDTH)


def _has_width() -> bool:
    return sys.stdout.isatty() or "COLUMNS" in os.environ


def show(title: str, headings: Sequence[Heading], rows: Iterable[Sequence[Content]], screen: Console | None = None) -> None:
    """Print a table; where that is wider than the screen, each row as a list of its cells below its first one."""
    from rich.box import SIMPLE
    from rich.measure import Measurement
    from rich.table import Table
    from rich.text import Text

    screen = screen or console()
    listed = [[_text(cell) for cell in row] for row in rows]
    table = Table(title=Text(title), title_justify="left", title_style="", box=SIMPLE)
    for i, h in enumerate(headings):
        cells = [Text(h.text), *(row[i] for row in listed)]
        whole = 0 if h.folds else max(line.cell_len for cell in cells for line in cell.split())
        table.add_column(cells[0], justify=h.justify, min_width=whole, no_wrap=not h.folds, overflow="fold")
    for row in listed:
        table.add_row(*row)
    if Measurement.get(screen, screen.options.update(max_width=10_000), table).minimum <= screen.width:
        screen.print(table)
        return
    screen.print(Text(title))
    for row in listed:
        screen.print()
        screen.print(row[0])
        entries = Table.grid(padding=(0, 2, 0, 0))
        entries.add_column(no_wrap=True)
        entries.add_column(overflow="fold")
        for h, cell in zip(headings[1:], row[1:], strict=True):
            if cell.plain:
                entries.add_row(f"  {h.text.replace(chr(10), ', ')}", cell)
        screen.print(entries)
    screen.print()


def say(*sentences: str) -> None:
    """Print sentences, one a line: broken between words on a screen, whole where a program reads them."""
    from rich.text import Text

    screen = console()
    for sentence in sentences:
        screen.print(Text(sentence), soft_wrap=not _has_width())


def notes(texts: Sequence[str], kept_in: str) -> None:
    """Print the first MOST_NOTES notes, and how many more there are; `kept_in` says where all of them are."""
    for text in texts[:MOST_NOTES]:
        say(f"note: {text}")
    if len(texts) > MOST_NOTES:
        say(f"{len(texts) - MOST_NOTES} more notes are in {kept_in}")


def _text(cell: Content) -> Text:
    from rich.text import Text

    return Text(cell) if isinstance(cell, str) else cell
