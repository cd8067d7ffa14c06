"""The terminal during a scan: progress on stderr, the summary on stdout, fitted to its width.

No line breaks within a number, and no digit is lost.
"""

import logging
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import TextIO, TypeVar

from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.segment import Segment
from rich.table import Table

from scanner.shown_text import NO_BREAK, harmless, on_screen, unbroken


def for_screen(text: str, stream: TextIO) -> str:
    """The text with nothing in it that a terminal would obey, and wrapped if the stream is one: what reads from a pipe
    wants its lines whole.
    """
    text = on_screen(text)
    return wrapped(text, shutil.get_terminal_size().columns) if stream.isatty() else text


class HarmlessConsole(Console):
    """A console whose tables and bars hold nothing that a terminal would obey but the console's own colours."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """The segments of anything that is printed."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(harmless(segment.text), segment.style)


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


T = TypeVar("T")

log = logging.getLogger(__name__)

LINE_EVERY_S = 30.0


class Terminal:
    """Progress bars where stderr is a terminal, else a line now and then; the log; the summary; unless `quiet`."""

    def __init__(self, *, quiet: bool = False) -> None:
        self._quiet = quiet
        self._out = HarmlessConsole(highlight=False)
        self._err = HarmlessConsole(stderr=True)

    def track(self, items: Iterable[T], total: int, what: str) -> Iterator[T]:
        """Pass `items` on, with a bar that fills up as they go by."""
        log.info("%s: %d", what, total)
        with self._progress(BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), TextColumn("left,")) as progress:
            task = progress.add_task(what, total=total)
            with self._lines(lambda: f"{what}, {progress.tasks[task].completed:.0f} of {total}"):
                for item in items:
                    yield item
                    progress.advance(task)

    @contextmanager
    def step(self, what: str) -> Iterator[None]:
        """Show an operation while the block runs."""
        log.info("%s", what)
        with self._progress(SpinnerColumn()) as progress:
            task = progress.add_task(what, total=1)
            with self._lines(lambda: what):
                yield
            progress.advance(task)

    def show(self, *parts: RenderableType) -> None:
        """Print the output of a successful command."""
        if self._quiet:
            return
        for part in parts:
            rendered = fitted(part, self._out) if isinstance(part, Table) else part
            if isinstance(rendered, str):
                self._out.print(for_screen(rendered, sys.stdout), soft_wrap=True, markup=False)
            else:
                self._out.print(rendered)

    def tell(self, *sentences: str) -> None:
        """Print sentences for the operator."""
        self.show(*sentences)

    def note(self, text: str) -> None:
        """Print a note that matters whether or not the command succeeds."""
        if not self._quiet:
            self._err.print(on_screen(text), soft_wrap=True, markup=False, highlight=False)

    @property
    def can_ask(self) -> bool:
        """Whether there is a person to answer."""
        return sys.stdin is not None and sys.stdin.isatty()

    def ask(self, question: str) -> str:
        """Return the operator's input; the end of the input, as by Ctrl-D, is a 'q'. Asks even if `quiet`."""
        self._err.print(on_screen(question), end="", markup=False)
        try:
            return input()
        except EOFError:
            return "q"

    def ready(self, what: str) -> bool:
        """Ask the operator to do something; False if the operator continues without it."""
        answer = self.ask(f"{what}; then press Enter, or q and Enter to go on with what there is: ")
        return not answer.strip().lower().startswith("q")

    @contextmanager
    def _lines(self, text: Callable[[], str]) -> Iterator[None]:
        """A line of `text` every half a minute, for who reads a pipe or a log of it while the block runs."""
        if self._quiet or self._err.is_terminal:
            yield
            return
        began_s, ended = time.monotonic(), Event()

        def tell() -> None:
            while not ended.wait(LINE_EVERY_S):
                self.note(f"{text()}: {time.monotonic() - began_s:.0f} s so far")

        teller = Thread(target=tell, daemon=True)
        teller.start()
        try:
            yield
        finally:
            ended.set()
            teller.join()

    def _progress(self, *columns: ProgressColumn) -> Progress:
        hidden = self._quiet or not self._err.is_terminal
        text = TextColumn("{task.description:<28}")
        return Progress(text, *columns, TimeElapsedColumn(), console=self._err, disable=hidden)


SILENT = Terminal(quiet=True)
