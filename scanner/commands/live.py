"""Show live clouds, and keep the requested ones."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread

from calib.geometry import Calibration
from hw.rig import Rig
from scanner.commands.options_of_rigs import LiveCommand
from scanner.errors import InputError
from scanner.io import read_calibration
from scanner.live import (
    Account,
    LiveCloud,
    LiveResult,
    Watcher,
    Wishes,
    account_text,
    result_texts,
    round_texts,
    scan_live,
)
from scanner.quantities import parse_length, parse_seconds
from scanner.results import default_out
from scanner.shown_text import shown
from scanner.ui import Terminal
from scanner.viewing import require_viser

_EVERY_S = 2.0


def run(args: LiveCommand) -> None:
    """Do the work. Raises InputError, DeviceError, RefusalError, KeyboardInterrupt."""
    config = args.settings.load()
    terminal = Terminal(quiet=args.quiet)
    out = args.out or default_out(f"{args.settings.file.stem}-live", overwrite=args.overwrite)
    unit = read_calibration(args.calibration).unit
    wishes = Wishes(args.clouds, _seconds(args.every), args.room)
    if terminal.can_ask and not args.quiet:
        terminal.note("Enter keeps a cloud; Ctrl-C ends.")
        Thread(target=_keep_on_enter, args=(wishes,), daemon=True).start()
    with _page(args, terminal) as page:
        result = scan_live(
            config,
            out,
            calibration=args.calibration,
            wishes=wishes,
            depths=_depths(args.depths, unit),
            overwrite=args.overwrite,
            terminal=terminal,
            watcher=_TerminalOutput(terminal, unit, page),
        )
    _show(result, out, args, terminal)
    if result.ended_by is not None:
        raise result.ended_by


@contextmanager
def _page(args: LiveCommand, terminal: Terminal) -> Iterator[Watcher]:
    """The page that looks, if one is wanted. Raises InputError if it cannot be had."""
    if not args.page:
        yield Watcher()
        return
    require_viser()
    from scanner.console import LiveView  # viser is an extra
    from scanner.viewing import CloudScene, add_style, announce_page, serving

    with serving(f"Live: {args.settings.file.stem}", args.address.host, args.address.port) as served:
        served.server.gui.main_panel.dock_left()
        add_style(served.server.gui, panel_left=True)
        view = LiveView(served.server.gui, CloudScene(served.server))
        announce_page(served.address, args.address.host, terminal, browser=not args.address.no_browser)
        yield view


class _TerminalOutput(Watcher):
    """Prints a line about the clouds every other second, and passes everything on to a page."""

    def __init__(self, terminal: Terminal, unit: str, page: Watcher) -> None:
        self._terminal, self._unit, self._page = terminal, unit, page
        self._told_s = time.monotonic()

    def begin(self, calibration: Calibration, wishes: Wishes) -> None:
        self._page.begin(calibration, wishes)

    def on_rig(self, rig: Rig) -> None:
        self._told_s = time.monotonic()
        self._page.on_rig(rig)

    def on_round(self, cloud: LiveCloud | None, account: Account) -> None:
        self._page.on_round(cloud, account)
        if time.monotonic() - self._told_s >= _EVERY_S:
            self._told_s = time.monotonic()
            self._terminal.show(*round_texts(cloud, account, self._unit))

    def tell(self, sentence: str) -> None:
        self._terminal.show(sentence)
        self._page.tell(sentence)


def _keep_on_enter(wishes: Wishes) -> None:
    for _ in sys.stdin:
        wishes.now.set()


def _show(result: LiveResult, out: Path, args: LiveCommand, terminal: Terminal) -> None:
    terminal.show(account_text(result.account))
    terminal.show(*result_texts(len(result.kept), out, args.settings.file, args.calibration, of_room=args.room))


def _seconds(text: str | None) -> float | None:
    seconds = None if text is None else parse_seconds("--every", text)
    if seconds is not None and not 0 <= seconds < float("inf"):
        raise InputError(f"--every: expected a time, as in 2s, found {shown(text)}")
    return seconds


def _depths(text: str | None, unit: str) -> tuple[float, float] | None:
    if text is None:
        return None
    lengths = [parse_length(part, unit) for part in text.split(",")]
    if len(lengths) != 2 or not 0 < lengths[0] < lengths[1]:
        raise InputError(f"--depths: expected the nearest and the farthest, as in 0.3m,0.6m, found {shown(text)}")
    return lengths[0], lengths[1]
