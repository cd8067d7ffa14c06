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


@dataclass(frozen=True)
class Clocks:
    """`loops` with refined starts and slots; `shifts_s`: for each loop, the delays of its changes, (slots + 1,).

    `scatter_s`: root mean square of their residuals.
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
        return loop.start_s + loop.slot_s * np.arange(len(shifts)) + shifts

    def row_delays(self, rows: Floats, middle_row: float) -> Floats:
        """Return the delay of rows relative to the middle row, in seconds."""
        return (rows - middle_row) * self.line_s
