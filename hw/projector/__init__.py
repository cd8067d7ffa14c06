"""The projector: a window that covers one of the computer's screens, in a process of its own."""

from typing import TYPE_CHECKING

from calib.deferred_imports import defer_imports

if TYPE_CHECKING:
    from hw.projector.process import ScreenProjector as ScreenProjector
    from hw.projector.process import list_screens as list_screens
    from hw.projector.screens import Screen as Screen
    from hw.projector.screens import choose_screen as choose_screen
    from hw.projector.screens import display_of as display_of

# The process of the window, which has to open soon, does without the rest.
__all__, __getattr__, __dir__ = defer_imports(
    __name__, {"process": "ScreenProjector list_screens", "screens": "Screen choose_screen display_of"}
)
