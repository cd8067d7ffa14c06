"""The clocks of a projector and a camera that nothing synchronised, from what the frames show.

Row r of frame n is exposed for E from t_n + (r − r_m) L − E / 2 on: t_n is the frame's time, r_m the middle row, L the
line time, E the exposure. The picture changes at b + j T, in time of the camera. So of two pictures the share of the
later one is (time exposed after the change) / E in every row, and that is what light says (Moreno, Calakli and Taubin,
SIGGRAPH Asia 2015, use the same in binary pictures).
"""

from dataclasses import dataclass

import numpy as np

from calib.numerics import Floats
from scanner.recordings.start_marks import Loop
from scanner.recordings.tone_curve import ToneCurve


@dataclass(frozen=True)
class Clocks:
    """`loops` with their beginnings and slots refined; `shifts_s`: for each loop, how much later than evenly each of
    its changes came, (slots + 1,); `scatter_s` (root mean square) of what is left of that.
    """

    exposure_s: float
    line_s: float
    loops: tuple[Loop, ...]
    shifts_s: tuple[Floats, ...]
    tone: ToneCurve
    scatter_s: float

    def changes(self, number: int) -> Floats:
        """Return when the slots of a loop begin, and the last one ends, (slots + 1,) in the camera's time."""
        loop, shifts = self.loops[number], self.shifts_s[number]
        times: Floats = loop.start_s + loop.slot_s * np.arange(len(shifts)) + shifts
        return times

    def row_delays(self, rows: Floats, middle_row: float) -> Floats:
        """Return the delay of rows relative to the middle row, in seconds."""
        delays: Floats = (rows - middle_row) * self.line_s
        return delays
