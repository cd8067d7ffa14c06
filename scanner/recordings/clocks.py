"""The clocks of an unsynchronised projector and camera, from the frames.

Row r of frame n is exposed for E from t_n + (r − r_m) L − E / 2 on: t_n is the frame's time, r_m the middle row, L the
line time, E the exposure. The picture changes at b + j T, in the camera's time. So of two pictures, the share of the
later one is (time exposed after the change) / E in every row, which the light shows (Moreno, Calakli and Taubin,
SIGGRAPH Asia 2015, use the same with binary pictures).
"""

from dataclasses import dataclass

import numpy as np

from calib.numerics import Floats
from scanner.recordings.start_marks import Loop
from scanner.recordings.tone_curve import ToneCurve

_ALIKE = 1.2  # ratio of exposures that are one


@dataclass(frozen=True)
class Clocks:
    """When rows of the camera are exposed, and when the pictures change."""

    exposure_s: float
    line_s: float  # from one row to the next
    loops: tuple[Loop, ...]  # with refined starts and slots
    shifts_s: tuple[Floats, ...]  # (slots + 1,) for each loop: the delays of its changes
    tone: ToneCurve
    scatter_s: float  # root mean square of the changes' residuals
    exposures_s: tuple[float, float]  # least and greatest exposure, with a readout in proportion, that are as likely

    def changes(self, number: int) -> Floats:
        """Return when the slots of a loop begin, and the last one ends, (slots + 1,) in the camera's time."""
        loop, shifts = self.loops[number], self.shifts_s[number]
        return loop.start_s + loop.slot_s * np.arange(len(shifts)) + shifts

    @property
    def has_exposure(self) -> bool:
        """Whether the film determines exposure and readout."""
        least, greatest = self.exposures_s
        return greatest < _ALIKE * least

    @property
    def every_change(self) -> Floats:
        """Changes of all loops in order, (loops · (slots + 1),)."""
        return np.concatenate([self.changes(number) for number in range(len(self.loops))])

    def row_delays(self, rows: Floats, middle_row: float) -> Floats:
        """Return the delay of rows relative to the middle row, in seconds."""
        return (rows - middle_row) * self.line_s


def exposure_text(clocks: Clocks) -> str:
    """The exposure for people, as 16.7 ms or 'from 1.0 to 17.2 ms'."""
    if clocks.has_exposure:
        return f"{1e3 * clocks.exposure_s:.1f} ms"
    return "from {:.1f} to {:.1f} ms".format(*(1e3 * exposure_s for exposure_s in clocks.exposures_s))
