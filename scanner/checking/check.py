"""The check from top to bottom. The rows come as they are found, so that a page can show them one by one."""

from collections.abc import Callable, Iterable
from contextlib import ExitStack

from hw.errors import DeviceError
from hw.rig import Rig
from scanner.checking.devices import device_rows, opened
from scanner.checking.report import CheckReport, CheckRow, State
from scanner.config import Config
from scanner.terminal import Terminal

OnRow = Callable[[CheckRow], None]

_DEVICES = "devices"


def check(config: Config, terminal: Terminal, on_row: OnRow | None = None) -> CheckReport:
    """Open the configured rig and check it; `on_row` is called with each row as soon as it is known.

    A device that fails is a row. Raises InputError if the configuration names no rig or no sizes.
    """
    with ExitStack() as devices:
        try:
            with terminal.step("Preparing the rig"):
                rig = devices.enter_context(opened(config))
        except DeviceError as error:
            return _Checking(on_row).failed(error)
        return check_rig(rig, config, terminal, on_row)


def check_rig(rig: Rig, config: Config, terminal: Terminal, on_row: OnRow | None = None) -> CheckReport:
    """Check a rig that is open. Its camera is left at the exposure that is proposed."""
    checking = _Checking(on_row)
    try:
        checking.add(device_rows(rig))
    except DeviceError as error:
        return checking.failed(error)
    return CheckReport(tuple(checking.rows))


class _Checking:
    """The rows so far."""

    def __init__(self, on_row: OnRow | None) -> None:
        self.rows: list[CheckRow] = []
        self._on_row = on_row

    def add(self, rows: Iterable[CheckRow]) -> None:
        for row in rows:
            self.rows.append(row)
            if self._on_row:
                self._on_row(row)

    def failed(self, error: DeviceError) -> CheckReport:
        """The report of a check that a device has ended."""
        self.add([CheckRow(_DEVICES, State.FAILED, str(error))])
        return CheckReport(tuple(self.rows), failure=error)
