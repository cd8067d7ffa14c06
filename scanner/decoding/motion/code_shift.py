"""Motion between the codes of an axis and its fringes, from the offset of the fringes from the cells of the code."""

import numpy as np

from calib.numerics import Bools, Floats32, evenly_spread
from scanner.decoding.axis_signals import Signals
from scanner.decoding.codes.gray_code import interval_of
from scanner.decoding.light.noise_model import NoiseModel
from scanner.decoding.motion.period_slips import CodeShift, Offsets, moved_by_periods
from scanner.decoding.motion.pixels import SeenFringes
from scanner.decoding.sequence_plan import COSINE_PARAMETERS, AxisPlan
from scanner.decoding.significance import AS_GOOD, ENDS, FEWEST_PIXELS, NEARLY_ALL, SIGNIFICANT_SIGMAS

_LEAST_PX = 0.5


def shifts_of_codes(seen: SeenFringes) -> tuple[CodeShift, ...]:
    """Return the significant shifts, from the pixels where nothing moved."""
    offsets = (_offsets(axis, of_axis, seen.noise, seen.tiles.resting) for axis, of_axis in seen.axes)
    found = [each for each in offsets if each is not None]
    by_periods = [*moved_by_periods(*found)] if len(found) == len(seen.plan.axes) else []
    others = [each for each in found if each.axis not in [shift.axis for shift in by_periods]]
    # A finest bit that was exchanged with its inverse also shifts by half a period.
    shifted = [each for each in others if _LEAST_PX <= abs(each.mean_px) <= AS_GOOD * each.period / 2]
    return (*by_periods, *(CodeShift(each.axis, each.mean_px) for each in shifted))


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
    px_per_radian = np.float32(longest.period / (2 * np.pi))
    beyond = np.arctan2(sine, cosine) - interval.centre / px_per_radian
    # Exchanged frames leave fringes that follow the code nowhere, or only in places.
    if abs(np.mean(np.exp(np.complex64(1j) * beyond[seen]))) < NEARLY_ALL * np.sinc(axis.cell / longest.period):
        return None
    about = middle_of(beyond[seen], axis.cell / longest.period)
    return Offsets(
        axis, interval.centre, px_per_radian * _wrapped(beyond - np.float32(about)), float(px_per_radian * about), seen
    )


def middle_of(angles: Floats32, width: float) -> float:
    """Return the middle of the arc, `width` turns wide, that holds most of the angles (P,).

    The mean angle is unreliable where a cell is nearly as long as the period: a few angles more or less turn it.
    """
    some = np.sort(_wrapped(evenly_spread(angles)))
    turned = np.concatenate([some, some + 2 * np.pi])
    held = np.searchsorted(turned, some + 2 * np.pi * width, side="right") - np.arange(len(some))
    first = int(np.argmax(held))
    about = float(_wrapped((turned[[first]] + turned[first + held[first] - 1]) / 2)[0])
    return about + float(np.quantile(_wrapped(angles - np.float32(about)), ENDS).mean())


def _wrapped(angles: Floats32) -> Floats32:
    """Wrap angles to ±π."""
    wrapped: Floats32 = angles - 2 * np.pi * np.rint(angles / (2 * np.pi))
    return wrapped
