"""Narrow terminals: lines break between words, and tables keep every digit."""

import io
import re

from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from rich.table import Table

from scanner.ui.terminal import fitted, wrapped

_QUANTITIES = ["± 0.030 %", "1 to 3 %", "0.4 mm", "90.1 ± 0.2 °", "× 4", "−0.04 %", "1.5 px", "12 ± 3 µm"]
_WORDS = ["length", "the", "known", "is", "corner.squareness_deg", "sigmas"]
_numbers = st.floats(-1e4, 1e4).map(lambda value: f"{value:.4f}")


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
