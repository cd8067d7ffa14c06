"""The report of a check: a row for each thing checked, and the conclusions."""

import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from calib.refusal import RefusalError
from hw.errors import DeviceError

Pixels = NDArray[np.uint8]

log = logging.getLogger(__name__)


class State(StrEnum):
    """The grade of one row."""

    OK = "ok"
    POOR = "poor"
    """A scan works, but the marked lines would make it clearly better."""
    FAILED = "failed"
    """A scan would fail."""


@dataclass(frozen=True)
class CheckRow:
    """One checked item: its `name`, its state, the finding, and what to do (empty: nothing)."""

    name: str
    state: State
    finding: str
    advice: str = ""


OnRow = Callable[[CheckRow], None]


@dataclass
class CheckReport:
    """The rows in the order in which they were found; `on_row` is called with each.

    `exposure_us`: the exposure to scan with, None if none could be found. `response`: the projector's light at equally
    spaced grey levels from 0 to 255, from 0 to 1, None if it was not measured. `pictures`: RGB images (H, W, 3) by
    name. `failure`: why a scan would fail; None if it would not.
    """

    rows: list[CheckRow] = field(default_factory=list)
    exposure_us: float | None = None
    response: tuple[float, ...] | None = None
    pictures: dict[str, Pixels] = field(default_factory=dict)
    failure: DeviceError | RefusalError | None = None
    on_row: OnRow | None = None

    def add(self, *rows: CheckRow) -> None:
        """Take rows in."""
        for row in rows:
            log.info("%s: %s: %s %s", row.name, row.state.value, row.finding, row.advice)
            self.rows.append(row)
            if self.on_row:
                self.on_row(row)

    def fail(self, error: DeviceError) -> None:
        """A device has ended the check."""
        self.failure = error
        self.add(CheckRow("devices", State.FAILED, str(error)))

    @property
    def state(self) -> State:
        """The worst of all rows."""
        states = {row.state for row in self.rows}
        return next((state for state in (State.FAILED, State.POOR) if state in states), State.OK)
