"""Text and tables fitted to the width of the terminal: no line breaks within a number, and no digit is lost."""

import shutil
import textwrap
from collections.abc import Iterator
from typing import TextIO

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table

from scanner.shown_text import NO_BREAK, unbroken


def for_screen(text: str, stream: TextIO) -> str:
    """The text, wrapped if the stream is a terminal: what reads from a pipe wants its lines whole."""
    return wrapped(text, shutil.get_terminal_size().columns) if stream.isatty() else text


def wrapped(text: str, width: int) -> str:
    """The text in lines of at most `width` characters, broken at spaces that are not within a number.

    Only a word, a path or a number that is longer than that makes a longer line.
    """
    return "\n".join(_wrapped_line(line, width) for line in text.splitlines())


def _wrapped_line(line: str, width: int) -> str:
    indent = " " * (len(line) - len(line.lstrip()))
    pieces = textwrap.wrap(
        unbroken(line),
        width,
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return "\n".join(pieces).replace(NO_BREAK, " ")


def fitted(table: Table, console: Console) -> Table | str:
    """The table, or its cells below each other where the console is too narrow for their digits.

    A table with a column of text that may be wrapped fits everywhere.
    """
    if not all(column.no_wrap for column in table.columns):
        return table
    natural = console.measure(table, options=console.options.update(width=10_000)).maximum
    return table if natural <= console.width else wrapped("\n".join(_stacked(table)), console.width)


def _stacked(table: Table) -> Iterator[str]:
    """The table's title, and for each row its name and, indented, the cell under each heading."""
    headings = [str(column.header) for column in table.columns]
    if table.title:
        yield str(table.title)
    pad = max(map(cell_len, headings))
    for name, *cells in zip(*(list(column.cells) for column in table.columns), strict=True):
        yield str(name)
        for heading, cell in zip(headings[1:], cells, strict=True):
            if cell:
                yield f"{_indent(str(name))}{heading:<{pad}}  {cell}" if heading else f"{_indent(str(name))}{cell}"


def _indent(name: str) -> str:
    return " " * (len(name) - len(name.lstrip()) + 2)
