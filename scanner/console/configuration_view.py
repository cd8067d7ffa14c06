"""The configuration file as text: checked as it is typed, and written with its comments."""

from collections.abc import Callable
from pathlib import Path

import viser

from scanner.configuration import check_text, write_text
from scanner.errors import InputError
from scanner.io import read_text
from scanner.ui import failure_of
from scanner.viewing import PLAIN, bold, escaped


class ConfigurationView:
    """Built into the container that is open when it is made."""

    def __init__(self, gui: viser.GuiApi, path: Path) -> None:
        self._path, self._as_read, self._saved = path, "", ""
        gui.add_markdown(f"`{path}` is read anew for each check and scan.")
        self._text = gui.add_text("", "", multiline=True)
        self._message = gui.add_markdown("")
        self._save = gui.add_button("Save", color=PLAIN)
        gui.add_button("As it is in the file", color=PLAIN).on_click(lambda _: self.read())
        self._text.on_update(lambda _: self._check())
        self._save.on_click(lambda _: self._telling(self._written))
        self.read()

    def read(self) -> None:
        """Show the file as it is."""
        self._telling(self._read)
        self._check()

    def follow(self) -> None:
        """Show the file as it is now, unless it was edited here: a check may have written into it."""
        try:
            changed = self._text.value == self._as_read != read_text(self._path)
        except InputError:
            return  # for a moment; whoever reads it next says so
        if changed:
            self.read()

    def _read(self) -> str:
        self._saved = ""
        self._as_read = self._text.value = read_text(self._path)
        return ""

    def _check(self) -> None:
        self._save.disabled = not self._telling(self._checked)

    def _checked(self) -> str:
        text = self._text.value
        check_text(text, self._path)
        # A check of what was typed last may run after it was saved.
        return self._saved if self._saved and text == self._as_read else "✓ This can be saved."

    def _written(self) -> str:
        text = self._text.value
        backup = write_text(self._path, text)
        self._as_read, self._saved = text, f"Saved. The original file is {escaped(str(backup))}."
        return self._saved

    def _telling(self, action: Callable[[], str]) -> bool:
        """Do it, and say what came of it; False if it failed."""
        try:
            self._message.content = action()
        except Exception as error:
            self._message.content = bold(str(error) if isinstance(error, InputError) else failure_of(error).message)
            return False
        return True
