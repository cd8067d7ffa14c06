"""The report in a terminal."""

from rich import box
from rich.markup import escape
from rich.table import Table

from scanner.checking.report import CheckReport, State

# A sign and a word for each, for colour-blind readers.
_SIGNS = {State.OK: "✓", State.POOR: "!", State.FAILED: "✗"}
_PLAIN_SIGNS = {State.OK: "+", State.POOR: "!", State.FAILED: "x"}
_STYLES = {State.OK: "cyan", State.POOR: "yellow", State.FAILED: "bold magenta"}


def signs_for(encoding: str | None) -> dict[State, str]:
    """Return ✓, ! and ✗, or plain letters where the terminal's encoding lacks them."""
    try:
        "".join(_SIGNS.values()).encode(encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return _PLAIN_SIGNS
    return _SIGNS


def table_of(report: CheckReport, encoding: str | None) -> Table:
    """A line for each row, with the advice below the finding."""
    signs = signs_for(encoding)
    table = Table(box=box.SIMPLE, show_header=False, pad_edge=False)
    table.add_column(no_wrap=True)
    table.add_column(no_wrap=True)
    table.add_column()
    for row in report.rows:
        style = _STYLES[row.state]
        text = escape(row.finding) + (f"\n[bold]→ {escape(row.advice)}[/bold]" if row.advice else "")
        if signs is _PLAIN_SIGNS:
            text = text.replace("→", "->")
        table.add_row(f"[{style}]{signs[row.state]} {row.state.value}[/{style}]", row.name, text)
    return table
