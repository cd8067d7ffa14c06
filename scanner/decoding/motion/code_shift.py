"""Motion between the codes of an axis and its fringes, from the offset of the fringes from the cells of the code."""

from dataclasses import dataclass

import numpy as np

from calib.numerics import Bools, Floats
from scanner.decoding.axis_signals import Signals
from scanner.decoding.codes.gray_code import interval_of
from scanner.decoding.light.noise_model import NoiseModel
from scanner.decoding.motion.period_slips import Offsets, PeriodSlip, moved_by_periods
from scanner.decoding.sequence_plan import COSINE_PARAMETERS, AxisPlan, SequencePlan
from scanner.decoding.significance import AS_GOOD, ENDS, FEWEST_PIXELS, NEARLY_ALL, SIGNIFICANT_SIGMAS
from scanner.decoding.subsampling import evenly_spread

_LEAST_PX = 0.5


@dataclass(frozen=True)
class CodeShift:
    """Motion by `px` projector pixels or more along an axis, between the frames of its codes and those of its fringes.

    `px` is known only up to whole periods, and is a part of the motion if that happened during either group of frames.
    `by_periods`: whether it includes whole periods of the longest fringe, which leave all pixels decodable. `sure`:
    whether the motion was along this axis, rather than along the other one alone.
    """

    axis: AxisPlan
    px: float
    by_periods: bool = False
    sure: bool = True


def shifts_of_codes(
    plan: SequencePlan, signals: tuple[Signals, Signals], noise: NoiseModel, resting: Bools
) -> tuple[CodeShift, ...]:
    """Return the significant shifts, from the signals of pixels (P,) of which only the `resting` ones (P,) count."""
    x, y = (_offsets(axis, of_axis, noise, resting) for axis, of_axis in zip(plan.axes, signals, strict=True))
    by_periods = moved_by_periods(x, y) if x is not None and y is not None else (None, None)
    found = (_shift(each, slip) for each, slip in zip((x, y), by_periods, strict=True) if each is not None)
    return tuple(shift for shift in found if shift is not None)


def _offsets(axis: AxisPlan, signals: Signals, noise: NoiseModel, resting: Bools) -> Offsets | None:
    """Return the offsets of the longest fringe from its code; None if there is no such pair, or the fringe follows no
    code.
    """
    if not axis.codes or not axis.fringes or axis.cell >= axis.fringes[0].period:
        return None
    longest = axis.fringes[0]
    if len(longest.frames) <= COSINE_PARAMETERS:
        return None
    interval = interval_of(axis, signals.words, len(signals.middle))
    cosine, sine = signals.fringe(0)
    amplitude2 = cosine**2 + sine**2
    seen = (
        resting
        & interval.possible
        & (amplitude2 > (SIGNIFICANT_SIGMAS * longest.noise_gain) ** 2 * noise.variance(signals.middle))
    )
    if np.count_nonzero(seen) < FEWEST_PIXELS:
        return None
    centre, px_per_radian = interval.centre.astype(np.float64), longest.period / (2 * np.pi)
    beyond = np.arctan2(sine, cosine).astype(np.float64) - centre / px_per_radian
    # Exchanged frames leave fringes that follow the code nowhere, or only in places.
    if abs(np.mean(np.exp(1j * beyond[seen]))) < NEARLY_ALL * np.sinc(axis.cell / longest.period):
        return None
    about = middle_of(beyond[seen], axis.cell / longest.period)
    return Offsets(axis, centre, px_per_radian * _wrapped(beyond - about), px_per_radian * about, seen)


def middle_of(angles: Floats, width: float) -> float:
    """Return the middle of the arc, `width` turns wide, that holds most of the angles (P,).

    The mean angle is unreliable where a cell is nearly as long as the period: a few angles more or less turn it.
    """
    some = np.sort(_wrapped(evenly_spread(angles)))
    turned = np.concatenate([some, some + 2 * np.pi])
    held = np.searchsorted(turned, some + 2 * np.pi * width, side="right") - np.arange(len(some))
    first = int(np.argmax(held))
    about = float(_wrapped((turned[first] + turned[first + held[first] - 1]) / 2))
    return about + float(np.quantile(_wrapped(angles - about), ENDS).mean())


def _wrapped(angles: Floats) -> Floats:
    """Wrap angles to ±π."""
    return angles - 2 * np.pi * np.rint(angles / (2 * np.pi))


def _shift(found: Offsets, slip: PeriodSlip | None) -> CodeShift | None:
    if slip is not None:
        return CodeShift(found.axis, slip.px, by_periods=True, sure=slip.sure)
    # A finest bit that was exchanged with its inverse also shifts by half a period.
    is_one = _LEAST_PX <= abs(found.mean_px) <= AS_GOOD * found.period / 2
    return CodeShift(found.axis, found.mean_px) if is_one else None
