"""The operator's page: image, check, scan, result. One worker owns the rig; only the page and its parts know viser."""

from typing import TYPE_CHECKING

from calib.deferred_imports import defer_imports

if TYPE_CHECKING:
    from scanner.console.live_view import LiveView as LiveView
    from scanner.console.page import console as console
    from scanner.console.progress import durations_in as durations_in
    from scanner.console.settings import ConsoleSettings as ConsoleSettings
    from scanner.console.settings import IdlePicture as IdlePicture
    from scanner.console.worker import Activity as Activity
    from scanner.console.worker import Status as Status
    from scanner.console.worker import Worker as Worker

# The page needs viser, which is optional; its worker does without.
__all__, __getattr__, __dir__ = defer_imports(
    __name__,
    {
        "live_view": "LiveView",
        "page": "console",
        "progress": "durations_in",
        "settings": "ConsoleSettings IdlePicture",
        "worker": "Activity Status Worker",
    },
)
