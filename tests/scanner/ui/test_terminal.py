"""Progress where stderr is no terminal.

What a terminal would obey, in names of files and in what files say, does not reach it.

Narrow terminals: lines break between words, and tables keep every digit.
"""

import contextlib
import io
import re
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from rich.table import Table
from rich.text import Text

from scanner.commands import main
from scanner.ui import terminal
from scanner.ui.terminal import HarmlessConsole, Terminal, fitted, wrapped

SOON_S = 0.01
_OBEYED = "\n\t\r\x1b\x07\x08\x9b\x85\u202e\u2028\ufeff"
_QUANTITIES = ["± 0.030 %", "1 to 3 %", "0.4 mm", "90.1 ± 0.2 °", "× 4", "−0.04 %", "1.5 px", "12 ± 3 µm"]
_WORDS = ["length", "the", "known", "is", "corner.squareness_deg", "sigmas"]
_numbers = st.floats(-1e4, 1e4).map(lambda value: f"{value:.4f}")


class _Watched(Terminal):
    """Sets `told` with the first line."""

    def __init__(self, *, quiet: bool = False) -> None:
        super().__init__(quiet=quiet)
        self.told = Event()

    def note(self, text: str) -> None:
        super().note(text)
        self.told.set()


@pytest.fixture(autouse=True)
def _often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(terminal, "LINE_EVERY_S", SOON_S)


def test_a_long_step_is_told_in_lines(capsys: pytest.CaptureFixture[str]) -> None:
    watched = _Watched()
    with watched.step("Calibrating"):
        assert watched.told.wait(60)
    assert "Calibrating: 0 s so far" in capsys.readouterr().err


def test_lines_count_what_went_by(capsys: pytest.CaptureFixture[str]) -> None:
    watched = _Watched()
    for item in watched.track("abc", 3, "Reading"):
        if item == "c":
            watched.told.clear()
            assert watched.told.wait(60)
    assert "Reading, 2 of 3: 0 s so far" in capsys.readouterr().err


def test_the_quiet_are_told_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    watched = _Watched(quiet=True)
    with watched.step("Calibrating"):
        assert not watched.told.wait(5 * SOON_S)
    assert capsys.readouterr().err == ""


def _texts(**characters: Any) -> st.SearchStrategy[str]:
    letters = st.sampled_from("ab[31m =" + _OBEYED) | st.characters(codec="utf-8", **characters)
    return st.text(letters, min_size=1, max_size=20)


_names = _texts(exclude_characters="/\0")


def _obeyed(text: str, but: str = "") -> list[str]:
    return [character for character in text if character in _OBEYED and character not in but]


def _plain(text: str) -> str:
    return "".join(character for character in text if character.isascii() and character.isprintable())


@given(_names)
def test_an_error_that_names_a_file_is_one_line(name: str) -> None:
    with TemporaryDirectory() as folder, contextlib.redirect_stderr(io.StringIO()) as err:
        missing = Path(folder) / f"{name}-missing"
        assert main(["replay", str(missing), "--out", f"{folder}/out"]) == 2
    message = err.getvalue()
    assert message.endswith("\n")
    assert _obeyed(message[:-1]) == []
    assert _plain(f"{name}-missing") in _plain(message)


@given(_texts(), st.booleans())
def test_a_cell_of_a_table_says_nothing_to_the_terminal(text: str, is_terminal: bool) -> None:
    out = io.StringIO()
    table = Table("name", "value", box=None, show_edge=False)
    table.add_row(Text(f"start{text}"), "1")
    HarmlessConsole(file=out, width=60, force_terminal=is_terminal, color_system=None).print(table)
    shown = out.getvalue().replace("\x1b[1m", "").replace("\x1b[0m", "") if is_terminal else out.getvalue()
    assert _obeyed(shown, but="\n") == []
    assert "start" in shown


@given(_names)
def test_a_note_and_a_summary_are_as_long_as_they_are_written(name: str) -> None:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stderr(err), contextlib.redirect_stdout(out):
        assert main(["replay", f"./{name}-missing", "--out", "out"]) == 2
        terminal = Terminal()
        terminal.note(f"note {name}-missing\nsecond")
        terminal.show(f"result {name}-missing\nsecond")
    for text in (err.getvalue().split("note ", 1)[-1], out.getvalue()):
        assert text.count("\n") == 2
        assert _obeyed(text, but="\n") == []


@given(st.lists(st.sampled_from(_QUANTITIES + _WORDS), min_size=1, max_size=40), st.integers(24, 100))
def test_lines_break_between_words_and_never_within_a_quantity(words: list[str], width: int) -> None:
    text = " ".join(words)
    lines = wrapped(text, width).splitlines()
    assert " ".join(lines) == text
    # Nothing here but a run of quantities that hold on to each other is longer than a line.
    assert all(len(line) <= width or not re.search("[a-z]{3}", line) for line in lines)
    for quantity in _QUANTITIES:
        assert sum(line.count(quantity) for line in lines) == text.count(quantity)


def test_lines_fill_the_width() -> None:
    assert wrapped("one two three", 9) == "one two\nthree"
    assert wrapped("  indented text goes on indented", 16) == "  indented text\n  goes on\n  indented"
    assert wrapped("first\n\nthird", 80) == "first\n\nthird"


@given(
    st.lists(st.tuples(_numbers, _numbers, _numbers), min_size=1, max_size=6),
    st.integers(20, 120),
    st.booleans(),
)
def test_narrow_tables_keep_every_digit(rows: list[tuple[str, str, str]], width: int, title: bool) -> None:
    table = Table(title="Numbers" if title else None)
    for heading in ("", "value", "sigma", "truth"):
        table.add_column(heading, no_wrap=True)
    for number, row in enumerate(rows):
        table.add_row(f"  row {number}", *row)
    out = io.StringIO()
    console = Console(file=out, width=width)
    console.print(fitted(table, console), markup=False)
    shown = out.getvalue()
    assert all(value in shown for row in rows for value in row)
    assert max(map(len, shown.splitlines())) <= width
    assert ("Numbers" in shown) == title


def test_a_table_that_fits_is_unchanged() -> None:
    table = Table("", "value")
    table.add_row("a", "1" * 30)
    for column in table.columns:
        column.no_wrap = True
    assert fitted(table, Console(file=io.StringIO(), width=80)) is table
    assert fitted(table, Console(file=io.StringIO(), width=30)) == f"a\n  value\n  {'1' * 30}"


def test_wrappable_text_stays_in_its_table() -> None:
    table = Table("", "advice")
    table.add_row("a", "turn the lamp off " * 5)
    console = Console(file=io.StringIO(), width=30)
    assert fitted(table, console) is table
