"""The report of a check: a row for each thing checked, the conclusions, and when a quantity is poor."""

import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from math import sqrt

import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.markup import escape
from rich.table import Table

from calib.finding import Finding, FindingKind, Severity
from calib.refusal import RefusalError
from hw.errors import DeviceError

# One rule for light and lenses. The sigma of a match is proportional to the noise over the amplitude of the fringes,
# and the sigma of a calibration to that over the root of the number of matches. A quantity is poor if it costs a factor
# of √2 in sigma, as much as losing half of the frames or half of the pixels.
TOLERATED_LOSS = sqrt(2.0)
# Of the amplitude of a fringe, or of the range of grey levels, so much is left then.
LEAST_AMPLITUDE = 1 / TOLERATED_LOSS
# Of the number of pixels, or of electrons, whose root sigma goes with.
LEAST_SHARE = 1 / TOLERATED_LOSS**2


Pixels = NDArray[np.uint8]

log = logging.getLogger(__name__)

CHECKED_DEVICES = FindingKind(
    "check-devices",
    "What scan check says of the devices that were opened, or why one failed.",
    "See to what the message names: cable, power, another program that uses the device.",
)


class CheckState(StrEnum):
    """The grade of one row."""

    OK = "ok"
    POOR = "poor"
    """A scan works, but the marked lines would make it clearly better."""
    FAILED = "failed"
    """A scan would fail."""


_STATES = {Severity.NOTE: CheckState.OK, Severity.WARNING: CheckState.POOR, Severity.REFUSAL: CheckState.FAILED}


@dataclass(frozen=True)
class CheckRow:
    """One checked item."""

    name: str
    """What was checked."""
    finding: Finding
    """What was found, and what to do about it: as a clause, if it is as it should be."""

    @property
    def state(self) -> CheckState:
        """Its grade, by the finding's severity."""
        return _STATES[self.finding.severity]


OnRow = Callable[[CheckRow], None]


@dataclass
class CheckReport:
    """The rows of a check, in the order in which they were found."""

    rows: list[CheckRow] = field(default_factory=list)
    exposure_us: float | None = None
    """The exposure to scan with, None if none could be found."""
    response: tuple[float, ...] | None = None
    """The projector's light at equally spaced grey levels from 0 to 255, from 0 to 1, None if it was not measured."""
    pictures: dict[str, Pixels] = field(default_factory=dict)
    """RGB images (H, W, 3) by name."""
    failure: DeviceError | RefusalError | None = None
    """Why a scan would fail; None if it would not."""
    on_row: OnRow | None = None
    """Called with each row."""

    def add(self, *rows: CheckRow) -> None:
        """Take rows in."""
        for row in rows:
            log.info("%s: %s: %s %s", row.name, row.state.value, row.finding.message, row.finding.advice)
            self.rows.append(row)
            if self.on_row:
                self.on_row(row)

    def fail(self, error: DeviceError) -> None:
        """A device has ended the check."""
        self.failure = error
        self.add(CheckRow("devices", Finding(CHECKED_DEVICES, Severity.REFUSAL, str(error))))

    @property
    def state(self) -> CheckState:
        """The worst of all rows."""
        states = {row.state for row in self.rows}
        return next((state for state in (CheckState.FAILED, CheckState.POOR) if state in states), CheckState.OK)


# A sign and a word for each, for colour-blind readers.
_SIGNS = {CheckState.OK: "✓", CheckState.POOR: "!", CheckState.FAILED: "✗"}
_PLAIN_SIGNS = {CheckState.OK: "+", CheckState.POOR: "!", CheckState.FAILED: "x"}
_STYLES = {CheckState.OK: "cyan", CheckState.POOR: "yellow", CheckState.FAILED: "bold magenta"}


def signs_for(encoding: str | None) -> dict[CheckState, str]:
    """Return ✓, ! and ✗, or plain letters where the terminal's encoding lacks them."""
    try:
        "".join(_SIGNS.values()).encode(encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return _PLAIN_SIGNS
    return _SIGNS


def table_of(report: CheckReport, encoding: str | None) -> Table:
    """A line for each row, with the advice below the finding."""
    signs = signs_for(encoding)
    table = Table(box=box.SIMPLE, show_header=False, pad_edge=False)
    table.add_column(no_wrap=True)
    table.add_column(no_wrap=True)
    table.add_column()
    for row in report.rows:
        style = _STYLES[row.state]
        advice = row.finding.advice
        text = escape(row.finding.message) + (f"\n[bold]→ {escape(advice)}[/bold]" if advice else "")
        if signs is _PLAIN_SIGNS:
            text = text.replace("→", "->")
        table.add_row(f"[{style}]{signs[row.state]} {row.state.value}[/{style}]", row.name, text)
    return table
