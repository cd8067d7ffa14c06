"""Results so far: each with date, grade and picture, to be opened, or set beside another."""

import tempfile
from collections.abc import Callable
from pathlib import Path

import viser

from scanner.comparing import COMPARE_PAGE, compare_files, comparison_verdict, headings, rows, write_compare_page
from scanner.console.results import card_of, earlier_results
from scanner.console.texts import card_html
from scanner.results import LOG_FILE
from scanner.viewing import PLAIN, failures_shown, link_html, verdict_text

_NONE_YET = "none yet"
_NEWEST = 8


class History:
    """Built into the container that is open when it is made; `opened` shows a result, `link` gives a file's address."""

    def __init__(self, gui: viser.GuiApi, opened: Callable[[Path], None], link: Callable[[Path], str]) -> None:
        self._gui, self._open, self._link = gui, opened, link
        self._listed: tuple[tuple[Path, float], ...] | None = None
        self._result = gui.add_dropdown("Result", [_NONE_YET])
        gui.add_button("Open", color=PLAIN).on_click(lambda _: self._open_chosen())
        self._other = gui.add_dropdown("Beside", [_NONE_YET], hint="Another calibration of the same rig")
        gui.add_button("Compare", color=PLAIN).on_click(lambda _: self._compare())
        self._message = gui.add_markdown("")
        self._beside = gui.add_html("")
        self._differences = gui.add_markdown("")
        self._page = gui.add_html("")
        self._cards = gui.add_html("")
        self._scratch = tempfile.TemporaryDirectory(prefix="scan-compare-")
        self.refresh()

    def close(self) -> None:
        """Forget comparisons."""
        self._scratch.cleanup()

    def refresh(self) -> None:
        """List what is there now, the newest first."""
        try:
            logs = tuple((path, (path / LOG_FILE).stat().st_mtime) for path in earlier_results())
            if logs == self._listed:
                return
            cards = "".join(card_html(card_of(path, made_s)) for path, made_s in logs[:_NEWEST])
        except OSError:
            return  # what is listed changes at this moment; the next look finds it as it is then
        self._listed = logs
        names = tuple(str(path) for path, _ in logs) or (_NONE_YET,)
        if names != self._result.options:
            self._result.options = self._other.options = names
        self._cards.content = cards

    def _offered(self, name: str) -> Path | None:
        """The page says which; only what was offered to it is opened."""
        return {str(path): path for path in earlier_results()}.get(name)

    def _open_chosen(self) -> None:
        if (chosen := self._offered(self._result.value)) is not None:
            self._message.content = ""
            with failures_shown(self._message):
                self._open(chosen)

    def _compare(self) -> None:
        first, second = self._offered(self._result.value), self._offered(self._other.value)
        if first is None or second is None or first == second:
            self._message.content = "Choose two different results."
            return
        with failures_shown(self._message):
            comparison = compare_files(first, second)
            page = Path(self._scratch.name, f"{first.name} and {second.name}", COMPARE_PAGE)
            page.parent.mkdir(exist_ok=True)
            write_compare_page(page, comparison)
            self._message.content = verdict_text(comparison_verdict(comparison))
            made_s = dict(self._listed or ())
            self._beside.content = "".join(card_html(card_of(path, made_s.get(path, 0.0))) for path in (first, second))
            self._differences.content = _table(headings(comparison), rows(comparison))
            self._page.content = link_html(self._link(page), "Open the comparison, with maps")


def _table(names: tuple[str, ...], cells: list[tuple[str, ...]]) -> str:
    """Each depth a column, as a panel is narrow."""
    lines = ["| " + " | ".join(["", *(row[0] for row in cells)]) + " |", "|:--|" + "--:|" * len(cells)]
    lines[0] = lines[0].replace("|  |", f"| {names[0]} |", 1)
    return "\n".join(
        [*lines, *("| " + " | ".join([name, *(row[i] for row in cells)]) + " |" for i, name in enumerate(names) if i)]
    )
