"""Check that each frame shows the pattern that the capture states, by fringes and coordinates.

Fringes that run backwards decode like any others. But fringes must agree with the Gray code and with each other. Camera
and projector see the same side of a surface, so that the map between them is never mirrored.
"""

from collections.abc import Iterator
from itertools import pairwise
from math import sqrt

import numpy as np

from calib.finding import Finding
from calib.numerics import MANY_PIXELS, Bools, Floats32, Ints, lines_of
from scanner.decoding.constraints import anomaly
from scanner.decoding.coordinates import AxisDecoder, Maps, UnwrappedFringes, agreeing
from scanner.decoding.fringes import disagreements
from scanner.decoding.mask_reasons import MaskReason
from scanner.decoding.sequence_plan import AxisPlan, SequencePlan
from scanner.decoding.significance import BRIGHTEST, FEW, FEWEST_PIXELS, HALF
from scanner.errors import FramesError, InputError

# Mean cosine of the phase within a Gray cell; fringes for which it is lower are not checked.
_INFORMATIVE = 0.3
# Unrelated fringes reach no more than this share of the expected cosine, and differ by a quarter of a cycle in the
# median; a rippled phase differs by 0.06. Fringe orders are right as long as the difference is below half a cycle.
_UNRELATED = 0.2
# Largest share of neighbours that are whole periods apart, and how nearly. At rest, occlusion edges cause 0.03 %; a
# code that is a quarter of a period off its fringes causes 3 %.
_MOST_SLIPS = 0.01
_NEARLY = 0.25
_MOST_BAD = 0.6  # of the lit pixels: a wrong frame makes half and more of them contradict


def check_fringes(plan: SequencePlan, decoder: AxisDecoder, measured: UnwrappedFringes) -> Iterator[Finding]:
    """Yield anomalies where the fringes of an axis agree poorly with its Gray code or with each other, on a sample
    that was `measured` with the widest tolerances.

    Raises InputError if they do not agree at all.
    """
    axis, interval = decoder.plan, measured.interval
    lit = measured.well_lit & interval.possible
    if np.any(lit):
        # Slightly wrong gains of a lamp leave a fringe where there is only ambient light.
        power = measured.power(0)
        lit &= power > FEW**2 * np.quantile(power[lit], BRIGHTEST)
    if np.count_nonzero(lit) < FEWEST_PIXELS:
        return
    for fringe, position in zip(axis.fringes[: decoder.finest + 1], measured.orders.coordinates, strict=False):
        expected = float(np.sinc(axis.cell / fringe.period))
        cosine = np.mean(np.cos(2 * np.pi / fringe.period * (position - interval.centre)[lit]))
        if axis.codes and axis.cell < fringe.period and expected > _INFORMATIVE and cosine < HALF * expected:
            if cosine < _UNRELATED * expected:
                raise FramesError(
                    f"the fringes of {plan.names(fringe.frames)} do not follow the Gray code along {axis.axis}",
                    f"were some of these frames exchanged{_or_code(plan, axis)}?",
                )
            yield anomaly(
                f"the fringes of {plan.names(fringe.frames)} follow the Gray code along {axis.axis} badly",
                fringe.frames,
            )
    between_px = disagreements(measured.orders, interval, agreeing(measured)).between_px
    for (longer, shorter), distance in zip(pairwise(axis.fringes[: decoder.finest + 1]), between_px, strict=False):
        apart = float(np.median(distance))
        if apart <= FEW * shorter.period:
            continue
        frames = (*longer.frames, *shorter.frames)
        message = (
            f"along {axis.axis} the fringes of period {longer.period:g} and {shorter.period:g} px contradict each "
            f"other by {apart:.1f} px: {plan.names(frames)}"
        )
        if apart > _UNRELATED * shorter.period:
            raise InputError(
                f"{message}. Were some of these exchanged{_or_code(plan, axis)}? Or do the projector's gamma or "
                "interreflection bend the fringes so much that more shifts or shorter periods are needed?"
            )
        yield anomaly(message, frames)


def check_cycles(plan: SequencePlan, projector_px: Floats32) -> None:
    """Raise InputError if too many neighbours in the coordinates (H, W, 2) are whole periods apart.

    With a single fringe, a code that was shown before a motion, that belongs to another capture or that runs backwards
    selects the wrong period near the borders of its cells. No pixel by itself looks wrong.
    """
    for number, axis in enumerate(plan.axes):
        if not (axis.codes and axis.fringes):
            continue
        # Two periods, as if the code ran backwards, may agree with a second fringe as well.
        slips, period = (2,) if axis.corrects_bits else (1, 2), axis.fringes[0].period
        share = max(_apart(projector_px[..., number], slip * period, period) for slip in slips)
        if share > _MOST_SLIPS:
            frames = [frame for code in axis.codes for frame in code.frames]
            raise InputError(
                f"along {axis.axis} {share:.1%} of all neighbouring pixels are whole periods of the fringes apart: the "
                f"code of {plan.name(min(frames))} to {plan.name(max(frames))} is not that of the fringes. Did "
                "something move in between, or were frames exchanged?"
            )


def _apart(coordinate: Floats32, px: float, period: float) -> float:
    """Return the share of neighbours along some lines of an image (H, W) that are about `px` apart."""
    steps = np.concatenate([np.abs(np.diff(lines_of(image), axis=1)).ravel() for image in (coordinate, coordinate.T)])
    apart = int(np.count_nonzero(np.abs(steps - np.float32(px)) < _NEARLY * period))  # NaN is not
    return apart / max(int(np.count_nonzero(np.isfinite(steps))), 1)


class MirroredError(InputError):
    """The map from camera to projector is mirrored."""


def check_maps(plan: SequencePlan, maps: Maps, kept: Bools) -> None:
    """Raise InputError if most of what is lit is inconsistent, MirroredError if the map is mirrored.

    `kept` (H, W): pixels that remain after all masks.
    """
    for axis, counts in zip(plan.axes, maps.counts, strict=True):
        _check_share(plan, axis, counts, int(np.count_nonzero(kept)))
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
            raise FramesError(
                f"along {axis.axis} {what} at {bad / (bad + kept):.0%} of the lit pixels",
                f"were frames exchanged, or is the projector's size wrong? {plan.names(axis.frames)}",
            )


def _mirrored_axis(plan: SequencePlan, maps: Maps, kept: Bools) -> AxisPlan | None:
    """Return the axis that runs backwards, if the map from camera to projector is mirrored at most pixels."""
    reach = max(_reach(axis, kept.shape) for axis in plan.axes)
    if 2 * reach >= min(kept.shape):
        return None
    stride = max(1, round(sqrt(kept.size / MANY_PIXELS)))
    near, far, inner = np.s_[: -2 * reach : stride], np.s_[2 * reach :: stride], np.s_[reach:-reach:stride]
    to_left, right, above, below = (inner, near), (inner, far), (near, inner), (far, inner)
    whole = kept[to_left] & kept[right] & kept[above] & kept[below]
    if np.count_nonzero(whole) < FEWEST_PIXELS:
        return None
    x_u, y_u = ((value[right] - value[to_left])[whole] for value in np.moveaxis(maps.projector_px, 2, 0))
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
