"""What the page says, as Markdown."""

from scanner.checking.report import CheckRow, State
from scanner.console.worker import Status
from scanner.viewing.texts import escaped

_SIGNS = {State.OK: "✓", State.POOR: "!", State.FAILED: "✗"}


def status_text(status: Status) -> str:
    """What is being done, or how the last thing ended."""
    if status.message:
        return "\n\n".join(f"**{escaped(line)}**" for line in status.message.splitlines() if line.strip())
    if status.cancelling:
        return f"**{status.activity}**: stopping after the present step …"
    if status.stage is None:
        return f"**{status.activity}**"
    counted = f", {status.stage.done} of {status.stage.total}" if status.stage.total else ""
    return f"**{status.activity}**: {escaped(status.stage.what)}{counted}"


def rows_text(rows: list[CheckRow]) -> str:
    """The check's findings, and what to do about them."""
    lines = []
    for row in rows:
        lines.append(f"- **{_SIGNS[row.state]} {escaped(row.name)}**, {row.state.value}: {escaped(row.finding)}")
        if row.advice:
            lines.append(f"  → {escaped(row.advice)}")
    return "\n".join(lines)
