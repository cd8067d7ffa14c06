"""The screens of a computer, one of which is the projector."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from hw.errors import DeviceError


@dataclass(frozen=True)
class Screen:
    """A screen of the desktop: number, name, position and size in pixels; `refresh_hz` is None if unknown. `display`:
    the X display, if it is not the desktop's.
    """

    number: int
    name: str
    x: int
    y: int
    width: int
    height: int
    refresh_hz: float | None
    display: str | None = None

    @property
    def geometry(self) -> str:
        """Size and position as X11 writes them, such as 1920x1080+1920+0."""
        return f"{self.width}x{self.height}+{self.x}+{self.y}"

    def __str__(self) -> str:
        rate = "refresh rate unknown" if self.refresh_hz is None else f"{self.refresh_hz:.4g} Hz"
        where = f" of {self.display}" if self.display else ""
        return f"screen {self.number} '{self.name}'{where}, {self.geometry}, {rate}"


def display_of(wanted: int | str | None) -> str | None:
    """The X display that a rig's `screen` names, as in :1 or :0.1; None for a screen of the desktop."""
    return wanted if isinstance(wanted, str) and re.fullmatch(r":\d+(\.\d+)?", wanted) else None


def choose_screen(screens: Sequence[Screen], wanted: int | str | None, size: tuple[int, int]) -> Screen:
    """The screen with this number, name or geometry; with None, the only one of `size` (width, height).

    Raises DeviceError if there is none, if there are several, or if it has another size.
    """
    fitting = [screen for screen in screens if _is_wanted(screen, wanted, size)]
    shown_size = f"{size[0]} × {size[1]}"
    described = f"called {wanted!r}" if wanted is not None else f"a screen of the projector's size, {shown_size}"
    if len(fitting) != 1:
        problem = f"no screen is {described}" if not fitting else f"{len(fitting)} screens are {described}"
        raise DeviceError(
            f"projector: {problem}. There are: {'; '.join(map(str, screens)) or 'none'}. Set the rig's screen to "
            "the number, name or geometry of the projector's, and the projector's width and height to its size."
        )
    (screen,) = fitting
    if (screen.width, screen.height) != size:
        raise DeviceError(
            f"projector: {screen} is not {shown_size}, the size of the patterns. Pictures are never scaled: set the "
            f"screen to the projector's own resolution, and the width and height of the patterns to the same."
        )
    return screen


def _is_wanted(screen: Screen, wanted: int | str | None, size: tuple[int, int]) -> bool:
    if wanted is None:
        return (screen.width, screen.height) == size
    if isinstance(wanted, int):
        return screen.number == wanted
    if re.fullmatch(r"\d+x\d+\+-?\d+\+-?\d+", wanted):
        return screen.geometry == wanted
    return screen.name == wanted
