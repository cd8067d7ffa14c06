"""A finished result in 3-D, in the browser. Views, labels and parts are computed without viser."""

from typing import TYPE_CHECKING

from calib.deferred_imports import defer_imports

if TYPE_CHECKING:
    from scanner.viewing.buttons import PLAIN as PLAIN
    from scanner.viewing.buttons import HintedButton as HintedButton
    from scanner.viewing.clicking import KnownScale as KnownScale
    from scanner.viewing.colouring import Colouring as Colouring
    from scanner.viewing.first_look import preview_scan as preview_scan
    from scanner.viewing.opening import DEFAULT_PORT as DEFAULT_PORT
    from scanner.viewing.opening import LOCAL as LOCAL
    from scanner.viewing.opening import free_port as free_port
    from scanner.viewing.opening import require_viser as require_viser
    from scanner.viewing.panel import ResultPanel as ResultPanel
    from scanner.viewing.panel import reading as reading
    from scanner.viewing.panel import view_result as view_result
    from scanner.viewing.result import CloudWithSigma as CloudWithSigma
    from scanner.viewing.result import PlacedRig as PlacedRig
    from scanner.viewing.result import ViewedCloud as ViewedCloud
    from scanner.viewing.result import ViewedResult as ViewedResult
    from scanner.viewing.result import read_white_picture as read_white_picture
    from scanner.viewing.scene import CloudScene as CloudScene
    from scanner.viewing.server import OriginCheck as OriginCheck
    from scanner.viewing.server import ServedFiles as ServedFiles
    from scanner.viewing.server import Serving as Serving
    from scanner.viewing.server import add_style as add_style
    from scanner.viewing.server import announce_page as announce_page
    from scanner.viewing.server import serving as serving
    from scanner.viewing.server import wait as wait
    from scanner.viewing.texts import bar_html as bar_html
    from scanner.viewing.texts import bold as bold
    from scanner.viewing.texts import escaped as escaped
    from scanner.viewing.texts import link_html as link_html
    from scanner.viewing.texts import notes_text as notes_text
    from scanner.viewing.texts import verdict_text as verdict_text
    from scanner.viewing.view_controls import failures_shown as failures_shown
    from scanner.viewing.windows import Window as Window
    from scanner.viewing.windows import Windows as Windows

# Viser is optional, and the command line asks for the address alone.
__all__, __getattr__, __dir__ = defer_imports(
    __name__,
    {
        "buttons": "HintedButton PLAIN",
        "clicking": "KnownScale",
        "colouring": "Colouring",
        "first_look": "preview_scan",
        "opening": "DEFAULT_PORT LOCAL free_port require_viser",
        "panel": "ResultPanel reading view_result",
        "result": "CloudWithSigma PlacedRig ViewedCloud ViewedResult read_white_picture",
        "scene": "CloudScene",
        "server": "OriginCheck ServedFiles Serving add_style announce_page serving wait",
        "texts": "bar_html bold escaped link_html notes_text verdict_text",
        "view_controls": "failures_shown",
        "windows": "Window Windows",
    },
)
