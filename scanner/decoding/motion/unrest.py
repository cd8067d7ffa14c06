"""Where the frames of a pixel contradict each other while those of other pixels do not: something moved there.

What contradicts light's own arithmetic: a pattern and its inverse make as much light as any other pair; a fringe's mean
is the same part of white everywhere; its steps lie on a cosine, but for the harmonics of a bent brightness curve, which
go with its phase; no bit is brighter than white or darker than black. A frame that shows another pattern breaks this
all over the picture. Something that moved, or its shadow, breaks it in patches, beside which all frames agree.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np

from calib.numerics import Bools, median
from scanner.decoding.arrays import Floats32
from scanner.decoding.coordinate_maps import Maps
from scanner.decoding.light.noise_model import NoiseModel
from scanner.decoding.mask_reasons import MaskReason
from scanner.decoding.medians import medians
from scanner.decoding.motion.coarse_frames import CoarseFrames
from scanner.decoding.sequence_plan import Fringe, GrayCode, SequencePlan

# A contradiction: in swings of a pixel, in standard deviations of the noise, and in what most pixels have of it (a
# camera that is not linear, a projector that sharpens or loses the light of fine stripes).
_LEAST, _SIGMAS, _TIMES_USUAL = 0.1, 6.0, 4.0
_MOST_PIXELS = 0.6
# Of bits without inverses, about half are lit at each pixel: those beyond so many are all lit.
_LIT_BITS = 0.7
# Pixels that swing less than this share of what the brightest few do are hardly lit.
_LIT, _BRIGHT = 0.1, 0.98
# Every so many-th of the grid's pixels tells quickly that nothing moved: so few contradictions are no patch.
_STRIDE, _A_FEW = 3, 4
# A camera that is not linear sees such pairs of stripes as brighter or darker than others.
_FINE_BITS = 3
# Offset, amplitude and phase.
_PARAMETERS = 3
_HARMONICS, _TRIMS, _MOST_OFF = (2, 3), 3, 3.0
# So many of the lit pixels around one are in contradiction where something moved; its edges are lit by both.
_WINDOW, _DENSE, _ENOUGH_LIT = 9, 0.3, 0.3
_SMALLEST, _MARGIN = 30, 1
# Frames that contradict the others in so much of where something moved are those in which it did.
_MUCH_OF_IT = 0.1
_BROKEN = (MaskReason.INCONSISTENT, MaskReason.INDIRECT, MaskReason.OUTSIDE, MaskReason.ISOLATED)
# Of a period: a bit that is wrong leaves the fringes' positions as they are.
_JUMP = 0.7
# Where more than this moved, it is no thing before what rests.
_MOST = 0.6


@dataclass(frozen=True)
class Unrest:
    """Where something `moved` (H, W), a `share` of what is lit; and where what is lit `rests`. `frames`: those that
    contradict others where something moved.
    """

    moved: Bools
    rests: Bools
    share: float
    frames: tuple[int, ...]

    def said(self, plan: SequencePlan) -> str:
        """For the operator."""
        return (
            f"Something moved in {max(self.share, 0.01):.0%} of the lit picture, which shows in "
            f"{plan.names(self.frames)}; it was masked, and the rest is used."
        )


@dataclass(frozen=True)
class _Group:
    """How far `frames` are `off` each other or the other frames at pixels (P,), in grey levels, and the noise of that
    for a noise of one.
    """

    frames: tuple[int, ...]
    off: Floats32
    noise_gain: float


def find_unrest(plan: SequencePlan, coarse: CoarseFrames, noise: NoiseModel) -> Unrest | None:
    """Where something moved, if it is not most of what is lit."""
    levels = coarse.levels
    swing = np.ptp(levels, axis=0)
    lit: Bools = swing > max(_LIT * float(np.quantile(swing, _BRIGHT)), 1e-6)
    some = np.zeros_like(lit)
    some[::_STRIDE, ::_STRIDE] = lit[::_STRIDE, ::_STRIDE]
    if sum(np.count_nonzero(each) for _, each in _contradictions(plan, levels[:, some], noise)) <= _A_FEW:
        return None
    groups = _contradictions(plan, levels[:, lit], noise)
    off = np.zeros(lit.shape, np.bool_)
    off[lit] = np.any([each for _, each in groups], axis=0) if groups else False
    moved = _patches(off, lit)
    inside = moved[lit]
    share = float(inside.mean()) if len(inside) else 0.0
    if not 0 < share <= _MOST:
        return None
    frames = {frame for of, each in groups if each[inside].mean() > _MUCH_OF_IT for frame in of}
    if not frames:
        return None
    rests = coarse.at_full_size(lit & ~moved)
    return Unrest(coarse.at_full_size(moved), rests, share, tuple(sorted(frames)))


def mask_broken(plan: SequencePlan, maps: Maps) -> None:
    """Mask, in place, patches in which pixels contradict themselves or their surface, where something moved elsewhere.

    A shadow turns bits over that have no inverse, and nothing but their coordinates tells.
    """
    coarse = CoarseFrames((maps.reason.shape[0], maps.reason.shape[1]))
    reason = coarse.of(maps.reason)
    broken = np.isin(reason, _BROKEN) | _jumps(plan, coarse, maps)
    patches = _patches(broken, broken | (reason == MaskReason.KEPT))
    more = coarse.at_full_size(patches) & (maps.reason != MaskReason.DARK)
    maps.reason[more] = np.uint8(MaskReason.MOVED)
    maps.projector_px[more] = np.nan


def _jumps(plan: SequencePlan, coarse: CoarseFrames, maps: Maps) -> Bools:
    """Pixels of the grid (h, w) that are farther from the next one than a wrong bit leaves fringes, or cells."""
    found = np.zeros(coarse.of(maps.reason).shape, np.bool_)
    for number, axis in enumerate(plan.axes):
        value = cast(Floats32, coarse.of(maps.projector_px[..., number]))
        least = _JUMP * (axis.fringes[-1].period if axis.fringes else 2 * axis.cell)
        for here, there in (np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:]):
            distance = np.abs(value[here] - value[there])
            known = np.isfinite(distance)
            usual = median(distance[known]) if known.any() else 0.0
            far = known & (distance > max(least, _TIMES_USUAL * usual))
            found[here] |= far
            found[there] |= far
    return found


def _contradictions(plan: SequencePlan, levels: Floats32, noise: NoiseModel) -> list[tuple[tuple[int, ...], Bools]]:
    """Groups of frames, and where they contradict each other or the rest (P,), at lit pixels, `levels` (frames, P)."""
    swing = np.ptp(levels, axis=0)
    sigma = np.sqrt(noise.variance(levels.max(axis=0))) / swing
    return [(group.frames, _contradicts(group, swing, sigma)) for group in _groups(plan, levels)]


def _contradicts(group: _Group, swing: Floats32, sigma: Floats32) -> Bools:
    off = np.abs(group.off) / swing
    usual = _TIMES_USUAL * float(np.quantile(off, _MOST_PIXELS))
    return cast(Bools, off > np.maximum(max(_LEAST, usual), _SIGMAS * group.noise_gain * sigma))


def _groups(plan: SequencePlan, levels: Floats32) -> Iterator[_Group]:
    """What must agree, at lit pixels, `levels` (frames, P)."""
    if not levels.shape[1]:
        return
    blurred = {frame for code in plan.codes if not plan.fringes for frame in _finest(code)}
    pairs = [pair for pair in plan.complements if not blurred & {*pair}]
    half_lit = [(levels[a] + levels[b]) / 2 for a, b in pairs]
    even = [fringe for fringe in plan.fringes if fringe.equal_steps]
    means = [levels[list(fringe.frames)].mean(axis=0) for fringe in even]
    usual = medians(np.stack(half_lit or means), axis=0) if half_lit or means else None
    if usual is not None:
        together = zip([*pairs, *(fringe.frames for fringe in even)], [*half_lit, *means], strict=True)
        for frames, light in together:
            share = median(light / np.maximum(usual, 1))
            yield _Group(frames, light - np.float32(share) * usual, 1.0)
    for fringe in plan.fringes:
        if len(fringe.frames) > _PARAMETERS:
            yield _Group(fringe.frames, _off_cosine(fringe, levels[list(fringe.frames)]), 1.0)
    yield from _beyond_white_and_black(plan, levels)


def _finest(code: GrayCode) -> set[int]:
    """The frames of bits that may be finer than what camera and projector resolve, or the scene scatters."""
    fine = range(code.bits - _FINE_BITS, code.bits)
    return {frames[bit] for frames in (code.normal, code.inverse) for bit in fine if bit in frames}


def _beyond_white_and_black(plan: SequencePlan, levels: Floats32) -> Iterator[_Group]:
    """Bits without an inverse, `levels` (frames, P), if white and black tell what they should be between."""
    alone = [frame for code in plan.codes for frame in code.unpaired.values()]
    if not alone or plan.white is None or plan.black is None:
        return
    ordered = np.sort(levels[alone], axis=0)
    # Not white alone: it may be the odd one, and harms nothing then.
    most = np.maximum(levels[plan.white], ordered[round(_LIT_BITS * (len(alone) - 1))])
    least = np.minimum(levels[plan.black], ordered[round((1 - _LIT_BITS) * (len(alone) - 1))])
    for frame in alone:
        bright = levels[frame] > (most + least) / 2
        brighter = median(levels[frame][bright] / np.maximum(most[bright], 1)) if bright.any() else 1.0
        above = levels[frame] / np.float32(max(brighter, 1.0)) - most
        below = least - levels[frame] / np.float32(min(brighter, 1.0))
        yield _Group((frame,), np.maximum(np.maximum(above, below), 0), float(np.sqrt(2)))


def _off_cosine(fringe: Fringe, levels: Floats32) -> Floats32:
    """What the steps (N, P) of a fringe leave of a cosine and of its harmonics, rms (P,)."""
    angles = 2 * np.pi * np.array(fringe.shifts)
    design = np.stack([np.ones_like(angles), np.cos(angles), -np.sin(angles)], axis=1).astype(np.float32)
    fit = fringe.weights.astype(np.float32) @ levels
    left = levels - design @ fit
    phase, amplitude = np.arctan2(fit[2], fit[1]), np.hypot(fit[1], fit[2])
    terms = np.stack([amplitude * wave(k * phase) for k in _HARMONICS for wave in (np.cos, np.sin)], axis=1)
    kept = np.ones(len(phase), np.bool_)
    for _ in range(_TRIMS):
        parts = np.linalg.lstsq(terms[kept], left[:, kept].T, rcond=None)[0]
        size = np.sqrt(np.mean((left - (terms @ parts).T) ** 2, axis=0))
        kept = size <= _MOST_OFF * max(median(size), 1e-6)
    return cast(Floats32, size)


def _patches(off: Bools, lit: Bools) -> Bools:
    """Where most lit pixels around are off, (h, w), as far as they hang together, with a margin."""
    window = (_WINDOW, _WINDOW)
    wrong, around = (
        cv2.boxFilter(each.astype(np.float32), -1, window, normalize=False, borderType=cv2.BORDER_CONSTANT)
        for each in (off & lit, lit)
    )
    dense = (wrong > _DENSE * around) & (around > _ENOUGH_LIT * _WINDOW**2) & lit
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(dense.astype(np.uint8), connectivity=8)
    large = statistics[:, cv2.CC_STAT_AREA] >= _SMALLEST
    large[0] = False
    kernel = np.ones((2 * _MARGIN + 1, 2 * _MARGIN + 1), np.uint8)
    return cast(Bools, cv2.dilate(large[labels].astype(np.uint8), kernel).astype(np.bool_))
