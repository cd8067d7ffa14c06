"""The report of a check: a row for each thing checked, and the conclusions."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from calib.refusal import RefusalError
from hw.errors import DeviceError

Pixels = NDArray[np.uint8]


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


@dataclass(frozen=True)
class CheckReport:
    """The rows in the order in which they were found.

    `exposure_us`: the exposure to scan with, None if none could be found. `response`: the projector's light at equally
    spaced grey levels from 0 to 255, from 0 to 1, None if it was not measured. `pictures`: RGB images (H, W, 3) by
    name. `failure`: why a scan would fail; None if it would not.
    """

    rows: tuple[CheckRow, ...]
    exposure_us: float | None = None
    response: tuple[float, ...] | None = None
    pictures: Mapping[str, Pixels] = field(default_factory=dict)
    failure: DeviceError | RefusalError | None = None

    @property
    def state(self) -> State:
        """The worst of all rows."""
        states = {row.state for row in self.rows}
        return next((state for state in (State.FAILED, State.POOR) if state in states), State.OK)
