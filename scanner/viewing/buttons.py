"""Buttons that say what they do, or why they cannot, while the pointer is on them.

viser shows the hints of its fields, but not of its buttons: what stands behind a button here is shown by page.css.
"""

from collections.abc import Callable
from typing import Any

import viser
from markupsafe import escape

PLAIN = (90, 98, 106)  # colour of secondary buttons


class HintedButton:
    """A button in the GUI container that is open when it is made; `hint` is what it does. `main`: it stands out."""

    def __init__(
        self,
        gui: viser.GuiApi,
        label: str,
        action: Callable[[viser.GuiEvent[Any]], object],
        hint: str = "",
        *,
        main: bool = False,
    ) -> None:
        self._hint = hint
        self._button = gui.add_button(label, color=None if main else PLAIN)
        self._text = gui.add_html(_html(hint))
        self._button.on_click(action)

    def allow(self, reason: str = "") -> None:
        """Enable it, or disable it for a `reason`."""
        if self._button.disabled != bool(reason):
            self._button.disabled = bool(reason)
        if self._text.content != (html := _html(reason or self._hint)):
            self._text.content = html

    @property
    def label(self) -> str:
        """What is on it."""
        return str(self._button.label)

    @label.setter
    def label(self, label: str) -> None:
        if self._button.label != label:
            self._button.label = label

    @property
    def visible(self) -> bool:
        """Whether it is there at all."""
        return bool(self._button.visible)

    @visible.setter
    def visible(self, visible: bool) -> None:
        self._button.visible = self._text.visible = visible

    def stand_out(self, *, main: bool) -> None:
        """Whether one presses it next."""
        self._button.color = None if main else PLAIN

    def remove(self) -> None:
        """Take it away."""
        self._button.remove()
        self._text.remove()


def _html(hint: str) -> str:
    return f'<div class="scan-hint" role="note">{escape(hint)}</div>' if hint else ""
