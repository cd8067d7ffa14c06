"""Results so far: cards that open on a click; the chosen one is compared, renamed, noted on, or moved into a bin."""

import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from threading import RLock
from typing import Any

import viser

from scanner.comparing import COMPARE_PAGE, compare_files, comparison_verdict, headings, rows, write_compare_page
from scanner.console.results import (
    bin_result,
    card_of,
    changes_s,
    earlier_results,
    last_binned,
    note_of,
    rename_result,
    restore_result,
    write_note,
)
from scanner.console.texts import card_html
from scanner.results import CALIBRATION_FILE
from scanner.shown_text import harmless
from scanner.viewing import HintedButton, escaped, failures_shown, link_html, verdict_text

_NONE = "none"
_AT_ONCE = 12
_NOTHING_CHOSEN = "There is no result yet: scan first."

Listed = tuple[tuple[Path, float, float], ...]


class History:
    """Built into the container that is open when it is made; `opened` shows a result, `link` gives a file's address.

    `moved` is told where a result was, and where it is now: None if in the bin.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        opened: Callable[[Path], None],
        link: Callable[[Path], str],
        moved: Callable[[Path, Path | None], None],
    ) -> None:
        self._gui, self._open, self._link, self._moved = gui, opened, link, moved
        self._listed: Listed | None = None
        self._chosen: Path | None = None
        self._lock = RLock()  # the page's clock refreshes, too
        self._shown = _AT_ONCE
        self._cards: list[viser.GuiFolderHandle] = []
        self._title = gui.add_markdown("")
        self._other = gui.add_dropdown("Compare with", [_NONE], hint="Another calibration of the same rig")
        self._compare = HintedButton(
            gui, "Compare", lambda _: self._show_comparison(), "Where the two calibrations differ, and by how much"
        )
        with gui.add_folder("Rename, note, delete", expand_by_default=False):
            self._name = gui.add_text("Name", "", hint="Letters, digits, dots and dashes")
            self._rename = HintedButton(gui, "Rename", lambda _: self._telling(self._do_rename))
            self._note = gui.add_text("Note", "", multiline=True, hint="Kept with the result, in note.txt")
            self._save = HintedButton(gui, "Save the note", lambda _: self._telling(self._do_note))
            self._delete = HintedButton(
                gui, "Delete", lambda _: self._telling(self._do_delete), "Into a bin, scans/.bin: Undo takes it back"
            )
            self._undo = HintedButton(gui, "Undo delete", lambda _: self._telling(self._do_undo))
        self._message = gui.add_markdown("")
        self._beside = gui.add_html("")
        self._differences = gui.add_markdown("")
        self._page = gui.add_html("")
        self._list = gui.add_folder(None)
        self._more = HintedButton(gui, "Show older results", lambda _: self._show_more())
        self._scratch = tempfile.TemporaryDirectory(prefix="scan-compare-")
        self._name.on_update(lambda _: self._offer())
        self._note.on_update(lambda _: self._offer())
        self._other.on_update(lambda _: self._offer())
        self.refresh()

    def close(self) -> None:
        """Forget comparisons."""
        self._scratch.cleanup()

    def refresh(self) -> None:
        """List what is there now, the newest first; a new result is chosen."""
        with self._lock, suppress(OSError):  # what changes at this moment is found as it is by the next look
            listed = tuple((path, *changes_s(path)) for path in earlier_results())
            if listed != self._listed:
                self._list_cards(listed)

    def _list_cards(self, listed: Listed) -> None:
        paths, before = [path for path, *_ in listed], [path for path, *_ in self._listed or ()]
        newest = next(iter(paths), None)
        self._listed = listed
        if self._chosen not in paths or (newest not in before and not self._is_edited):
            self._choose(newest)
        else:
            self._choose_other()
        self._draw()

    @property
    def _is_edited(self) -> bool:
        """Whether a name or a note was typed that is not kept yet."""
        chosen = self._chosen
        return chosen is not None and (self._name.value, self._note.value) != (chosen.name, note_of(chosen))

    def _draw(self) -> None:
        cards = [(path, card_of(path, *changed)) for path, *changed in (self._listed or ())[: self._shown]]
        for folder in self._cards:
            folder.remove()
        self._cards = []
        for path, card in cards:
            with self._list:
                self._cards.append(self._gui.add_folder(None))
            with self._cards[-1]:
                self._gui.add_html(f'<div class="scan-open">{card_html(card, chosen=path == self._chosen)}</div>')
                self._gui.add_button(harmless(f"Open {path.name}")).on_click(self._opening(path))
        self._more.visible = len(self._listed or ()) > self._shown

    def _show_more(self) -> None:
        self._shown += _AT_ONCE
        self._draw()

    def _choose(self, result: Path | None) -> None:
        self._chosen = result
        self._title.content = "" if result is None else f"Chosen: **{escaped(result.name)}**"
        self._name.value = "" if result is None else result.name
        self._note.value = "" if result is None else note_of(result)
        self._choose_other()

    def _choose_other(self) -> None:
        listed = (path for path, *_ in self._listed or ())
        candidates = tuple(str(path) for path in listed if path != self._chosen and _is_calibrated(path)) or (_NONE,)
        if self._other.options != candidates:
            self._other.options = candidates
        self._offer()

    def _offer(self) -> None:
        """Offer what can be done with the chosen result, and say why the rest cannot."""
        result = self._chosen
        nothing = _NOTHING_CHOSEN if result is None else ""
        compared = nothing
        if result is not None and not _is_calibrated(result):
            compared = "This result has no calibration to compare."
        elif self._other.value == _NONE:
            compared = nothing or "There is no other result with a calibration."
        self._compare.allow(compared)
        same_name = result is not None and self._name.value == result.name
        self._rename.allow(nothing or ("Type another name first." if same_name else ""))
        same_note = result is not None and self._note.value == note_of(result)
        self._save.allow(nothing or ("The note is as it was saved: change it first." if same_note else ""))
        self._delete.allow(nothing)
        binned = last_binned()
        self._undo.allow("" if binned else "Nothing was deleted.")
        self._undo.label = f"Undo delete of {binned.name}" if binned else "Undo delete"

    def _opening(self, result: Path) -> Callable[[viser.GuiEvent[Any]], None]:
        def open_card(_: viser.GuiEvent[Any]) -> None:
            with self._lock:
                self._choose(result)
                self._draw()
                self._message.content = ""
            with failures_shown(self._message):
                self._open(result)

        return open_card

    def _telling(self, action: Callable[[Path | None], str]) -> None:
        """Do it with the chosen result, and say what came of it."""
        with self._lock:
            with failures_shown(self._message):
                self._message.content = escaped(action(self._chosen))
            self.refresh()
            self._offer()

    def _do_rename(self, result: Path | None) -> str:
        if result is None:
            return _NOTHING_CHOSEN
        place = rename_result(result, self._name.value)
        self._moved(result, place)
        self._choose_listed(place)
        return f"It is called {place.name} now."

    def _do_note(self, result: Path | None) -> str:
        if result is None:
            return _NOTHING_CHOSEN
        write_note(result, self._note.value)
        return "The note is saved." if self._note.value.strip() else "The note is removed."

    def _do_delete(self, result: Path | None) -> str:
        if result is None:
            return _NOTHING_CHOSEN
        binned = bin_result(result)
        self._moved(result, None)
        return f"{result.name} is in the bin, {binned.parent}."

    def _do_undo(self, _: Path | None) -> str:
        binned = last_binned()
        if binned is None:
            return "Nothing was deleted."
        restored = restore_result(binned)
        self._choose_listed(restored)
        return f"{restored.name} is back."

    def _choose_listed(self, result: Path) -> None:
        self.refresh()
        self._choose(result)
        self._draw()

    def _show_comparison(self) -> None:
        listed = {str(path): path for path in earlier_results()}
        first, second = self._chosen, listed.get(self._other.value)
        if first is None or second is None:
            return
        with failures_shown(self._message):
            comparison = compare_files(first, second)
            page = Path(self._scratch.name, f"{first.name} and {second.name}", COMPARE_PAGE)
            page.parent.mkdir(exist_ok=True)
            write_compare_page(page, comparison)
            self._message.content = verdict_text(comparison_verdict(comparison))
            self._beside.content = "".join(card_html(card_of(path, *changes_s(path))) for path in (first, second))
            self._differences.content = _table(headings(comparison), rows(comparison))
            self._page.content = link_html(self._link(page), "Open the comparison, with maps")


def _is_calibrated(result: Path) -> bool:
    return (result / CALIBRATION_FILE).is_file()


def _table(names: tuple[str, ...], cells: list[tuple[str, ...]]) -> str:
    """Each depth a column, as a panel is narrow."""
    lines = ["| " + " | ".join(["", *(row[0] for row in cells)]) + " |", "|:--|" + "--:|" * len(cells)]
    lines[0] = lines[0].replace("|  |", f"| {names[0]} |", 1)
    return "\n".join(
        [*lines, *("| " + " | ".join([name, *(row[i] for row in cells)]) + " |" for i, name in enumerate(names) if i)]
    )
