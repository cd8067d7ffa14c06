"""How far everything moved between the codes of an axis and its fringes: how far these lie beside the code's cells."""

from dataclasses import dataclass

import numpy as np

from calib.numerics import Bools
from scanner.decoding.axis_signals import Signals
from scanner.decoding.codes.gray_code import interval_of
from scanner.decoding.light.noise_model import NoiseModel
from scanner.decoding.sequence_plan import AxisPlan, SequencePlan

_SEEN = 5.0
_FEWEST = 300
# Three frames make a fringe in any order, a wrong one included.
_PARAMETERS = 3
# Frames that were exchanged leave fringes that follow the code nowhere, or here and there.
_AGREEING = 0.9
_LEAST_PX = 0.5
# Half a period is also what a finest bit makes that was exchanged with its inverse.
_MOST_CYCLES = 0.4


@dataclass(frozen=True)
class CodeShift:
    """Along an axis everything moved by `px` projector pixels, from the frames of its codes to those of its fringes."""

    axis: AxisPlan
    px: float


def shifts_of_codes(
    plan: SequencePlan, signals: tuple[Signals, Signals], noise: NoiseModel, resting: Bools
) -> tuple[CodeShift, ...]:
    """Those that are more than nothing, given the signals of some pixels (P,); those that are `resting` (P,) count."""
    found = (_shift(axis, of_axis, noise, resting) for axis, of_axis in zip(plan.axes, signals, strict=True))
    return tuple(shift for shift in found if shift is not None)


def _shift(axis: AxisPlan, signals: Signals, noise: NoiseModel, resting: Bools) -> CodeShift | None:
    if not axis.codes or not axis.fringes or axis.cell >= axis.fringes[0].period:
        return None
    longest = axis.fringes[0]
    if len(longest.frames) <= _PARAMETERS:
        return None
    interval = interval_of(axis, signals.words, len(signals.middle))
    cosine, sine = signals.fringe(0)
    amplitude2 = cosine**2 + sine**2
    seen = (
        resting & interval.possible & (amplitude2 > (_SEEN * longest.noise_gain) ** 2 * noise.variance(signals.middle))
    )
    if np.count_nonzero(seen) < _FEWEST:
        return None
    beyond = np.arctan2(sine, cosine) - 2 * np.pi / longest.period * interval.centre
    mean = complex(np.mean(np.exp(1j * beyond[seen])))
    px = float(np.angle(mean)) * longest.period / (2 * np.pi)
    follows = abs(mean) >= _AGREEING * np.sinc(axis.cell / longest.period)
    return CodeShift(axis, px) if follows and _LEAST_PX <= abs(px) <= _MOST_CYCLES * longest.period else None
