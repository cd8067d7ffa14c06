"""Check for period slips: neighbours that are a whole fringe period apart, all over the picture.

With a single fringe, a code that was shown before a motion, or that belongs to another capture, selects the wrong
period near the borders of its cells. No pixel by itself looks wrong.
"""

import numpy as np

from scanner.decoding.arrays import Floats32
from scanner.decoding.sequence_plan import AxisPlan, SequencePlan
from scanner.errors import InputError

# Largest share of neighbours. At rest, occlusion edges cause 0.03 %; a code that is a quarter of a period off its
# fringes causes 3 %.
_MOST = 0.01
_NEARLY = 0.25


def check_cycles(plan: SequencePlan, projector_px: Floats32) -> None:
    """Raise InputError if too many neighbours in the coordinates (H, W, 2) are a whole period apart."""
    for number, axis in enumerate(plan.axes):
        if axis.corrects_bits or not (axis.codes and axis.fringes):
            continue
        share = _a_period_apart(projector_px[..., number], axis.fringes[0].period)
        if share > _MOST:
            raise InputError(
                f"along {axis.axis} {share:.1%} of all neighbouring pixels are a whole period of the fringes apart: "
                f"the code of {_named(plan, axis)} is not that of the fringes. Did something move in between, or were "
                "frames exchanged?"
            )


def _a_period_apart(coordinate: Floats32, period: float) -> float:
    apart = known = 0
    for way in (0, 1):
        step = np.abs(np.diff(coordinate, axis=way))
        known += int(np.count_nonzero(np.isfinite(step)))
        apart += int(np.count_nonzero(np.abs(step - np.float32(period)) < _NEARLY * period))  # NaN is not
    return apart / max(known, 1)


def _named(plan: SequencePlan, axis: AxisPlan) -> str:
    frames = [frame for code in axis.codes for frame in code.frames]
    return f"{plan.name(min(frames))} to {plan.name(max(frames))}"
