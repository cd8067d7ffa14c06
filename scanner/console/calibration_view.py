"""The calibration in use over time, as scan check --update has logged it: plots, and the last changes in words."""

from collections.abc import Callable, Sequence
from pathlib import Path

import viser

from scanner.console.results import newest_calibration
from scanner.errors import InputError
from scanner.reporting import history_svg
from scanner.results import LogEntry, calibration_file, log_of, read_log
from scanner.viewing import bold, escaped

_LAST = 3


class CalibrationView:
    """Built into the container that is open when it is made; not there for a calibration without a log.

    `given` returns the calibration that was given, None for the newest result's.
    """

    def __init__(self, gui: viser.GuiApi, given: Callable[[], Path | None]) -> None:
        self._given = given
        self._read: tuple[Path, int] | None = None
        self._folder = gui.add_folder("The calibration over time", visible=False)
        with self._folder:
            self._title = gui.add_markdown("")
            self._plots = gui.add_html("")
            self._changes = gui.add_markdown("")

    def follow(self) -> None:
        """Show the log as it is now."""
        calibration = self._given() or newest_calibration()
        log = None if calibration is None else log_of(calibration_file(calibration))
        try:
            read = None if log is None else (log, log.stat().st_mtime_ns)
        except OSError:
            read = None  # nothing was updated yet
        if read != self._read:
            self._read = read
            self._show(None if read is None else read[0])

    def _show(self, log: Path | None) -> None:
        self._plots.content = self._changes.content = self._title.content = ""
        if log is not None:
            try:
                entries = read_log(log)
                self._title.content = f"{escaped(str(log))}, as differences from the first, ± one standard deviation:"
                self._plots.content = str(history_svg(entries))
                self._changes.content = changes_text(entries)
            except InputError as error:
                self._title.content = bold(str(error))
        self._folder.visible = log is not None


def changes_text(entries: Sequence[LogEntry]) -> str:
    """The last updates in words, the newest first, as Markdown."""
    updates = [entry for entry in entries if entry.captures][: -_LAST - 1 : -1]
    return "\n".join(
        f"- {entry.date.astimezone():%Y-%m-%d, %H:%M}: {'✓' if entry.holds else '✕'} {escaped(entry.change)}"
        for entry in updates
    )
