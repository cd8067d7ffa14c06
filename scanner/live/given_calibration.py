"""Whether rays meet under the calibration of live clouds, which have one axis and cannot tell: one round of the other.

Its fringes are unwrapped around what the calibration predicts. Pixels that move between two rounds of the usual axis,
before and after, do not count.
"""

from contextlib import closing
from dataclasses import replace

import numpy as np

from calib.diagnostics import Uncertainty
from calib.finding import Finding
from calib.geometry import Calibration, Matches, cross_epipolar_lines
from calib.scene import find_change
from hw.rig import Rig
from scanner.decoding import MaskReason
from scanner.live.cloud import LiveCloud, LiveDecoder, Round
from scanner.live.first_look import FirstLook
from scanner.live.rounds import take_rounds
from scanner.live.sequence import LiveSequence
from scanner.live.unwrapping import unwrap

# A quarter of the longer fringe is what coarse sines tell safely; half of it is how far a changed rig may be off.
_LONG_PX, _SHORT_PX = 64.0, 16.11


def find_change_live(
    rig: Rig, sequence: LiveSequence, look: FirstLook, calibration: Calibration, stated: Uncertainty | None
) -> tuple[Finding, ...]:
    """A warning if rays do not meet under the given calibration; else (). Raises DeviceError."""
    decoder = LiveDecoder(sequence, look, calibration)
    before = decoder.cloud(_round(rig, sequence, look))
    across = _across(before, sequence, calibration)
    taken = _round(rig, across, look)
    after = decoder.cloud(replace(_round(rig, sequence, look), number=before.taken.number + 1), before)
    matches = _matches((before, after), taken, sequence, across, look, calibration)
    return find_change(calibration, stated, [matches])


def _round(rig: Rig, sequence: LiveSequence, look: FirstLook) -> Round:
    """The next whole round."""
    with closing(take_rounds(rig, sequence, look.response)) as rounds:
        return next(taken_round for taken_round in rounds if taken_round is not None)


def _across(cloud: LiveCloud, sequence: LiveSequence, calibration: Calibration) -> LiveSequence:
    """The sequence of the other axis, around where the epipolar lines cross the stripes of a cloud."""
    height, width = cloud.reason.shape
    row, column = np.divmod(cloud.pixel, width)
    camera_px = np.stack([column, row], axis=1).astype(np.float64)
    known_px = cloud.coordinate.ravel()[cloud.pixel].astype(np.float64)
    crossed = cross_epipolar_lines(camera_px, known_px, sequence.number, calibration)
    middle = np.full((height, width), np.nan, np.float32)
    middle[row, column] = crossed.projector_px[:, 1 - sequence.number]
    return LiveSequence("y" if sequence.axis == "x" else "x", _LONG_PX, _SHORT_PX, middle)


def _matches(
    clouds: tuple[LiveCloud, LiveCloud],
    taken: Round,
    sequence: LiveSequence,
    across: LiveSequence,
    look: FirstLook,
    calibration: Calibration,
) -> Matches:
    """Matches of what rested in all three rounds, both coordinates measured."""
    before, after = clouds
    shape = taken.grey.shape[1:]
    coordinate, variance = np.empty(shape, np.float32), np.empty(shape, np.float32)
    reason, moving = np.empty(shape, np.uint8), np.empty(shape, np.uint8)
    unwrap(
        taken.grey,
        taken.grey,
        coordinate,
        0.0,
        across.middle,
        (across.long_px, across.short_px),
        float(calibration.projector.size[across.number]),
        look.noise,
        look.saturated,
        coordinate,
        variance,
        reason,
        moving,
    )
    kept = [mask == MaskReason.KEPT for mask in (reason, before.reason, after.reason)]
    row, column = np.nonzero(np.all(kept, axis=0) & (after.moving == 0) & np.isfinite(coordinate))
    projector_px = np.empty((len(row), 2))
    usual = (before.coordinate[row, column], after.coordinate[row, column])
    projector_px[:, sequence.number] = np.mean(usual, axis=0, dtype=np.float64)
    projector_px[:, across.number] = coordinate[row, column]
    camera_px = np.stack([column, row], axis=1).astype(np.float64)
    return Matches(camera_px, projector_px, None, np.sqrt(variance[row, column], dtype=np.float64))
