"""What a terminal would obey, in names of files and in what files say, does not reach it."""

import contextlib
import io
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
from rich.table import Table
from rich.text import Text

from scanner.commands import main
from scanner.ui import Terminal
from scanner.ui.terminal import HarmlessConsole

_OBEYED = "\n\t\r\x1b\x07\x08\x9b\x85\u202e\u2028\ufeff"


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
