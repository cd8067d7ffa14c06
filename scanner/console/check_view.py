"""The findings of a check, row by row: grade, pictures, and the proposed exposure."""

from collections.abc import Callable
from pathlib import Path

import viser

from scanner.checking import CheckReport, CheckRow, CheckState
from scanner.configuration import set_keys
from scanner.console.texts import grade_text, rows_text
from scanner.viewing import PLAIN, escaped, failures_shown

_WORST_FIRST = (CheckState.FAILED, CheckState.POOR, CheckState.OK)


class CheckView:
    """A folder in the container that is open when it is made; `take` takes over an exposure in microseconds."""

    def __init__(self, gui: viser.GuiApi, config: Path, take: Callable[[float], None]) -> None:
        self._gui, self._config, self._take = gui, config, take
        self._rows: list[CheckRow] = []
        self._maps: list[viser.GuiImageHandle] = []
        self._exposure_us: float | None = None
        self._section = "rig"
        self._folder = gui.add_folder("Check", visible=False)
        with self._folder:
            self._grade = gui.add_markdown("")
            self._found = gui.add_markdown("")
            self._use = gui.add_button("Use this exposure", visible=False, color=PLAIN)
            self._save = gui.add_button("Write it into the configuration", visible=False, color=PLAIN)
            self._saved = gui.add_markdown("")
        self._use.on_click(lambda _: self._take_exposure())
        self._save.on_click(lambda _: self._save_exposure())

    def begin(self, section: str) -> None:
        """Forget the last check; `section` of the configuration is where the exposure of the next belongs."""
        self._section = section
        self._folder.visible = True
        self._rows, self._exposure_us = [], None
        for image in self._maps:
            image.remove()
        self._maps = []
        self._use.visible = self._save.visible = False
        self._saved.content = self._found.content = self._grade.content = ""

    def add(self, row: CheckRow) -> None:
        """Show what is known so far."""
        self._rows.append(row)
        self._found.content = rows_text(self._rows)

    def end(self, report: CheckReport) -> None:
        """Show the grade, what is not good before the rest, and the maps, and offer the exposure."""
        self._grade.content = grade_text(self._rows)
        self._found.content = rows_text(sorted(self._rows, key=lambda row: _WORST_FIRST.index(row.state)))
        with self._folder:
            self._maps += [self._gui.add_image(pixels, label=name) for name, pixels in report.pictures.items()]
        self._exposure_us = report.exposure_us
        if report.exposure_us is not None:
            self._use.label = f"Use the exposure that it proposes: {report.exposure_us / 1000:.4g} ms"
            self._use.visible = self._save.visible = True

    def _take_exposure(self) -> None:
        if self._exposure_us is not None:
            self._take(self._exposure_us)

    def _save_exposure(self) -> None:
        if self._exposure_us is None:
            return
        with failures_shown(self._saved):
            set_keys(self._config, {f"{self._section}.exposure_us": round(self._exposure_us, 1)})
            self._saved.content = f"Written into {escaped(str(self._config))}."
