"""Check that each frame shows the pattern that the capture states, by fringes and coordinates.

Fringes that run backwards decode like any others. But fringes must agree with the Gray code and with each other. Camera
and projector see the same side of a surface, so that the map between them is never mirrored.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from math import sqrt

import numpy as np

from calib.numerics import Bools, Ints, compiled
from scanner.decoding.arrays import Floats32
from scanner.decoding.axis_decoder import AxisDecoder
from scanner.decoding.axis_signals import Signals
from scanner.decoding.checks.contradictions import Anomaly
from scanner.decoding.coordinate_maps import Maps
from scanner.decoding.decoder_calibration import agreeing
from scanner.decoding.fringes.phase_unwrapping import disagreements, widest_tolerances
from scanner.decoding.mask_reasons import MaskReason
from scanner.decoding.sequence_plan import AxisPlan, SequencePlan
from scanner.decoding.significance import BRIGHTEST, FEW, FEWEST_PIXELS
from scanner.decoding.subsampling import FARTHEST_PX, lines_of
from scanner.errors import InputError

# Mean cosine of the phase within a Gray cell; fringes for which it is lower are not checked.
_INFORMATIVE = 0.3
# Unrelated fringes reach no more than this share of the expected cosine.
_UNRELATED_SHARE = 0.2
# Unrelated periods differ by a quarter cycle in the median, a rippled phase by 0.06. Fringe orders are right as long as
# the difference is below half a cycle.
_ODD_CYCLES = 0.1
_UNRELATED_CYCLES = 0.2
_MOST_BAD = 0.6  # of the lit pixels: a wrong frame makes half and more of them contradict
_MOST_COMPARED = 100_000  # pixels of the whole image; FEWEST_PIXELS are then 0.1 % of it


def check_fringes(plan: SequencePlan, decoder: AxisDecoder, signals: Signals) -> Iterator[Anomaly]:
    """Yield anomalies where the fringes of an axis agree poorly with its Gray code or with each other, on a sample.

    Raises InputError if they do not agree at all.
    """
    axis = decoder.plan
    if not axis.fringes:
        return
    measured = replace(decoder, tolerances=widest_tolerances(axis)).measure(signals)
    interval = measured.interval
    lit = measured.well_lit & interval.possible
    if np.any(lit):
        # Slightly wrong gains of a lamp leave a fringe where there is only ambient light.
        power = measured.power(0)
        lit &= power > FEW**2 * np.quantile(power[lit], BRIGHTEST)
    if np.count_nonzero(lit) < FEWEST_PIXELS:
        return
    for fringe, position in zip(axis.fringes[: decoder.finest + 1], decoder.positions(signals), strict=False):
        expected = float(np.sinc(axis.cell / fringe.period))
        found = np.mean(np.cos(2 * np.pi / fringe.period * (position - interval.centre)[lit]))
        if axis.codes and axis.cell < fringe.period and expected > _INFORMATIVE and found < expected / 2:
            if found < _UNRELATED_SHARE * expected:
                raise InputError(
                    f"the fringes of {plan.names(fringe.frames)} do not follow the Gray code along {axis.axis}; were "
                    f"some of these frames exchanged{_or_code(plan, axis)}?"
                )
            yield Anomaly(
                f"the fringes of {plan.names(fringe.frames)} follow the Gray code along {axis.axis} badly",
                fringe.frames,
            )
    between_px = disagreements(measured.orders, interval, agreeing(measured)).between_px
    for (longer, shorter), distance in zip(pairwise(axis.fringes[: decoder.finest + 1]), between_px, strict=False):
        apart = float(np.median(distance))
        if apart <= _ODD_CYCLES * shorter.period:
            continue
        message = (
            f"along {axis.axis} the fringes of period {longer.period:g} and {shorter.period:g} px contradict each "
            f"other by {apart:.1f} px: {plan.names([*longer.frames, *shorter.frames])}"
        )
        if apart > _UNRELATED_CYCLES * shorter.period:
            raise InputError(
                f"{message}. Were some of these exchanged{_or_code(plan, axis)}? Or do the projector's gamma or "
                "interreflection bend the fringes so much that more shifts or shorter periods are needed?"
            )
        yield Anomaly(message, (*longer.frames, *shorter.frames))


class MirroredError(InputError):
    """The map from camera to projector is mirrored."""


def check_maps(plan: SequencePlan, maps: Maps, kept: Bools) -> None:
    """Raise InputError if most of what is lit is inconsistent, MirroredError if the map is mirrored.

    `kept` (H, W): pixels that remain after all masks.
    """
    for axis, value, counts in zip(plan.axes, np.moveaxis(maps.projector_px, 2, 0), maps.counts, strict=True):
        _check_share(plan, axis, counts, int(np.count_nonzero(kept)))
        if axis.codes and axis.fringes:
            _check_direction(plan, axis, value, kept)
    mirrored = None if plan.only_axis else _mirrored_axis(plan, maps, kept)
    if mirrored is not None:
        frames = [frame for fringe in mirrored.fringes for frame in fringe.frames] or mirrored.frames
        raise MirroredError(
            f"the {mirrored.axis} coordinate runs backwards, as if seen in a mirror. Does the projector mirror its "
            "picture, as for rear projection? Then switch that off; or were frames exchanged, perhaps "
            f"{plan.names(frames)}{_or_code(plan, mirrored)}?"
        )


def _check_share(plan: SequencePlan, axis: AxisPlan, counts: Ints, kept: int) -> None:
    for reasons, what in (
        ([MaskReason.INCONSISTENT, MaskReason.INDIRECT], "the frames contradict each other"),
        ([MaskReason.OUTSIDE], f"the codes are outside the projector's 0 … {axis.length - 1}"),
    ):
        bad = int(counts[reasons].sum())
        if bad > FEWEST_PIXELS and bad > _MOST_BAD * (bad + kept):
            raise InputError(
                f"along {axis.axis} {what} at {bad / (bad + kept):.0%} of the lit pixels; were frames exchanged, or is "
                f"the projector's size wrong? {plan.names(axis.frames)}"
            )


def _check_direction(plan: SequencePlan, axis: AxisPlan, value: Floats32, kept: Bools) -> None:
    """Raise InputError if the code runs backwards: fringes as long as its cell agree, but jump at the edge of each
    cell.
    """
    code = min(axis.codes, key=lambda code: code.cell)
    counts = [
        _count_jumps(lines_of(image), lines_of(there), code.cell, code.offset + 0.5, FARTHEST_PX)
        for image, there in ((value, kept), (value.T, kept.T))
    ]
    jumps, total = np.sum(counts, axis=0)
    if total >= FEWEST_PIXELS and jumps > total / 2:
        raise InputError(
            f"the Gray code along {axis.axis} runs against its fringes; were frames of it exchanged, perhaps with "
            f"their inverses? {plan.names(axis.frames)}"
        )


@compiled
def _count_jumps(values: Floats32, there: Bools, cell: float, before: float, farthest: int) -> tuple[int, int]:
    """Count neighbours along lines (lines, P) that jump by more than a cell, and all those in different cells.

    `before`: how far before zero the cells begin. `farthest`: largest distance of neighbours.
    """
    jumps = total = 0
    for line in range(values.shape[0]):
        last = -1
        for place in range(values.shape[1]):
            if not there[line, place]:
                continue
            if last >= 0 and place - last <= farthest:
                value, value_before = values[line, place], values[line, last]
                if np.floor((value + before) / cell) != np.floor((value_before + before) / cell):
                    total += 1
                    jumps += abs(value - value_before) > cell
            last = place
    return jumps, total


def _mirrored_axis(plan: SequencePlan, maps: Maps, kept: Bools) -> AxisPlan | None:
    """Return the axis that runs backwards, if the map from camera to projector is mirrored at most pixels."""
    reach = max(_reach(axis, kept.shape) for axis in plan.axes)
    if 2 * reach >= min(kept.shape):
        return None
    stride = max(1, round(sqrt(kept.size / _MOST_COMPARED)))
    near, far, inner = np.s_[: -2 * reach : stride], np.s_[2 * reach :: stride], np.s_[reach:-reach:stride]
    left, right, above, below = (inner, near), (inner, far), (near, inner), (far, inner)
    whole = kept[left] & kept[right] & kept[above] & kept[below]
    if np.count_nonzero(whole) < FEWEST_PIXELS:
        return None
    x_u, y_u = ((value[right] - value[left])[whole] for value in np.moveaxis(maps.projector_px, 2, 0))
    x_v, y_v = ((value[below] - value[above])[whole] for value in np.moveaxis(maps.projector_px, 2, 0))
    if np.mean(x_u * y_v < x_v * y_u) <= 0.5:
        return None
    # Devices are assumed roughly upright: the axis that runs against the camera's own is the mirrored one.
    return plan.x if np.median(x_u) < 0 or np.median(y_v) > 0 else plan.y


def _reach(axis: AxisPlan, shape: tuple[int, ...]) -> int:
    """Return the distance in camera pixels over which a coordinate changes by more than its resolution."""
    step = 1.0 if axis.fringes else 2 * axis.cell
    return max(1, round(step * max(shape) / axis.length))


def _or_code(plan: SequencePlan, axis: AxisPlan) -> str:
    """Return a phrase that names the frames of the Gray code as further suspects."""
    frames = [frame for code in axis.codes for frame in code.frames]
    if not frames or not axis.fringes:
        return ""
    return f", or frames of the Gray code (between {plan.name(min(frames))} and {plan.name(max(frames))})"
