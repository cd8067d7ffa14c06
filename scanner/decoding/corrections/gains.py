"""The gains of frames of different brightness: of patterns and their inverses, of the steps of fringes, of single bits.

Groups of frames that add up to the same light tell them (`brightness`). Where stripes are too fine to have much
contrast, the sum of a pattern and its inverse is uninformative, but within each cell of the coarser bits, a bit lights
one half and its inverse the other. The mean logarithm of their ratio over a cell is therefore that of their brightness,
for any contrast and response curve; its scatter between cells gives the uncertainty.

The threshold of a bit without an inverse is half-way between white and black in steady light. Flicker, ambient light
changes, and fine stripes that lose light change the two levels of a bit. Both are fitted over many pixels: dark I = a B
+ l (W − B), or lit I = a B + u (W − B), with a, l and u common to the frame.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from math import sqrt
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import Bools, Floats32, Image, Ints, median, medians, robust_sigma
from scanner.decoding.light import (
    BANDS,
    LEAST_DIFFERENCE,
    PASSES,
    Gains,
    LitRows,
    PartOfFrames,
    Sample,
    Samples,
    flicker_of,
    gains_of_fringe,
    gains_of_pair,
    lit_by,
    starts_of_bands,
)
from scanner.decoding.sequence_plan import Fringe, SequencePlan
from scanner.decoding.significance import FEW, FEWEST_PIXELS, HUBER_ROUNDS, MAJORITY, NEGLIGIBLE, SIGNIFICANT_SIGMAS

# Levels are alike up to this share of white minus black: a threshold and the one half-way, or white in several bits.
_ALIKE = 0.05
# Of groups of frames, by the numbers of their frames.
GroupGains = dict[tuple[int, ...], Gains]
# Quantiles of a bit's levels in its dark and in its bright stripes: blurred edges and interreflection are in between.
TAILS = (0.05, 0.95)


@dataclass(frozen=True)
class BitLevels:
    """Levels of a bit in its frame: I = of_black · black + (dark or bright) · (white − black)."""

    of_black: float
    """Share of black."""
    dark: float
    """Share of white minus black where the bit is 0."""
    bright: float
    """The same where it is 1."""
    away: float
    """Distance of the half-way level from that of white and black, in the same unit."""

    def threshold(self, half_lit: Image, white: Image) -> Image:
        """Return the threshold from half-way level and white, (H, W); the half-way level itself if
        it is close enough.
        """
        if self.away < _ALIKE:
            return half_lit
        of_white = self.dark + self.bright - self.of_black
        return cast(Image, cv2.addWeighted(half_lit, self.of_black - of_white, white, of_white, 0))


def levels_of_bit(frame: Image, half_lit: Image, white: Image) -> BitLevels | None:
    """Fit the levels of a frame, given the half-way level and white, at pixels of a sample (P,).

    None if too few pixels have either level, or the levels are not distinct.
    """
    level, half_way, brightest = (image.astype(np.float32) for image in (frame, half_lit, white))
    lit = lit_by(brightest - half_way)
    half = np.maximum((brightest - half_way)[lit], np.float32(0.5))
    relative, black = level[lit] / (2 * half), (half_way[lit] - half) / (2 * half)
    is_bright = relative - black > np.mean(np.quantile(relative - black, TAILS))
    for _ in range(HUBER_ROUNDS):
        if min(np.count_nonzero(is_bright), np.count_nonzero(~is_bright)) < FEWEST_PIXELS:
            return None
        of_black, dark, bright = _parts(relative, black, is_bright)
        threshold = of_black * black + (dark + bright) / 2
        is_bright = relative > threshold
    off = relative - of_black * black - np.where(is_bright, bright, dark)
    if bright - dark < SIGNIFICANT_SIGMAS * robust_sigma(off):  # not two levels
        return None
    return BitLevels(of_black, dark, bright, median(np.abs(threshold - black - 0.5)))


def white_of(bits: Sequence[BitLevels]) -> float:
    """Return the brightness of white in the patterns, relative to white minus black in the white frame.

    1 unless all bits without an inverse agree on a different value, as with a longer exposure of the white frame or a
    projector that dims bright pictures.
    """
    if len(bits) < MAJORITY:
        return 1.0
    whites = np.array([bit.dark + bit.bright for bit in bits])
    white, dark, bright = (float(np.median(n)) for n in (whites, [b.dark for b in bits], [b.bright for b in bits]))
    if robust_sigma(whites - white) > _ALIKE or abs(white - 1) < FEW:
        return 1.0
    # Ambient light raises both levels by as much, but does not separate them by more than white and black.
    is_white = dark * np.sign(white - 1) < FEW * abs(white - 1) or bright - dark > 1 + FEW / 2
    return white if is_white else 1.0


def white_and_threshold(plan: SequencePlan, frames: Mapping[int, Image]) -> tuple[Image, Image]:
    """Return the brightest level, and that half-way between lit and unlit, where all `frames` (...) are shown."""
    white = extreme(np.maximum, [*frames.values()]) if plan.white is None else frames[plan.white]
    if plan.black is not None:
        return white, _mean(white, frames[plan.black])
    if plan.complements:
        first = min(plan.complements, key=lambda pair: max(map(plan.shown.index, pair)))
        return white, _mean(*(frames[frame] for frame in first))
    return white, _mean(white, extreme(np.minimum, [*frames.values()]))


def extreme(of: np.ufunc, images: Sequence[Image]) -> Image:
    """Return the least or greatest level of some images."""
    result = images[0].copy()
    for image in images[1:]:
        of(result, image, out=result)
    return result


def _mean(first: Image, second: Image) -> Image:
    return cast(Image, cv2.addWeighted(first, 0.5, second, 0.5, 0).reshape(first.shape))


def fit_bits(plan: SequencePlan, sample: Sample) -> tuple[dict[int, BitLevels | None], float]:
    """Return the levels of each bit without an inverse, by its frame, and how bright white is in the patterns."""
    levels = {frame: sample.level(frame) for frame in dict.fromkeys(plan.shown)}
    white, threshold = white_and_threshold(plan, levels)
    alone = {frame for code in plan.codes for frame in code.unpaired.values()}
    bits = {frame: levels_of_bit(levels[frame], threshold, white) for frame in alone}
    return bits, white_of([bit for bit in bits.values() if bit])


def as_in_patterns(white: Image, threshold: Image, white_gain: float) -> tuple[Image, Image]:
    """Return white and threshold (...) as bright as in the patterns."""
    if white_gain == 1:
        return white, threshold
    brighter, half_way = (
        cast(Image, cv2.addWeighted(white, of, threshold, 1 - of, 0).reshape(white.shape))
        for of in (2 * white_gain - 1, white_gain - 1)
    )
    return brighter, half_way


def with_white_as_in_patterns(plan: SequencePlan, samples: Samples, white_gain: float) -> Samples:
    """Return samples whose scattered pixels have a white frame as bright as white is in the patterns."""
    if white_gain == 1 or plan.white is None:
        return samples
    sample = samples.scattered
    ends = white_and_threshold(plan, {frame: sample.level(frame) for frame in dict.fromkeys(plan.shown)})
    brighter = np.maximum(as_in_patterns(*ends, white_gain)[0], 1)
    white = np.maximum(sample.level(plan.white), 1)
    return replace(samples, scattered=sample.divided({plan.white: white / brighter}))


def _parts(relative: Floats32, black: Floats32, is_bright: Bools) -> tuple[float, float, float]:
    """Fit the share of black, and those of white minus black where dark and where bright, by least squares.

    Levels (P,) are relative to white minus black.
    """
    design = np.stack([black, ~is_bright, is_bright], axis=1).astype(np.float64)
    of_black, dark, bright = np.linalg.lstsq(design, relative, rcond=1e-4)[0].tolist()
    return of_black, dark, bright


# Fewer cells do not determine the mean's uncertainty; for high-contrast stripes the sums are more precise.
_FEWEST_CELLS, _MOST_CELLS, _FEWEST_PER_CELL = 16, 64, 32
_MOST_CONTRAST = 1.5


def gains_of_pairs(plan: SequencePlan, sample: Sample) -> GroupGains:
    """Return the gains of patterns and their inverses, relative to the pairs before them.

    The first pair is white and black; without them it is the reference, and left out.
    """
    coarser = {
        pair: [code.pairs[coarser] for coarser in sorted(code.pairs) if coarser < bit]
        for code in plan.codes
        if code.base is None and not code.unpaired
        for bit, pair in code.pairs.items()
    }
    ends = [(plan.white, plan.black)] if plan.white is not None and plan.black is not None else []
    pairs = sorted({*plan.complements} - {*ends}, key=lambda pair: max(map(plan.shown.index, pair)))
    gains_of: GroupGains = {}
    bits: dict[tuple[int, int], Bools] = {}
    swing, total = np.zeros((2, *sample.rows.shape), np.float32)
    lit = np.arange(0)
    for number, pair in enumerate([*ends, *pairs]):
        levels = np.stack([sample.level(frame) for frame in pair], dtype=np.float32)
        if number:
            common = total[lit] / np.float32(2 * number)
            is_known = pair in coarser and bits.keys() >= {*coarser[pair]}
            of_coarser = [bits[pair_of_bit][lit] for pair_of_bit in coarser[pair]] if is_known else None
            places = LitRows(sample.rows[lit], sample.shape[0])
            gains = gains_of[pair] = _gains_of_pair(levels[:, lit], common, places, of_coarser)
            if gains.are_harmful:
                levels /= gains.at(sample.rows).astype(np.float32)
        bits[pair] = levels[0] > levels[1]
        total += levels.sum(axis=0)
        if number < MAJORITY:
            swing = np.maximum(swing, np.abs(levels[0] - levels[1]))
            lit = lit_by(swing)
    return gains_of


def _gains_of_pair(levels: Floats32, common: Floats32, places: LitRows, coarser: Sequence[Bools] | None) -> Gains:
    """Return the gains of a pair (2, P), from its stripes if all `coarser` bits (P,) of the code are known, or from the
    light that it has in `common` with others.
    """
    of_stripes = None if coarser is None else gains_of_stripes(levels, coarser)
    if of_stripes is not None:
        return of_stripes
    return Gains(np.ones((2, 1))) if _is_steady(levels, common) else gains_of_pair(levels, common, places)


def _is_steady(levels: Floats32, common: Floats32) -> bool:
    """Whether the sum of two frames (2, P) is uncorrelated with their difference, as in steady light.

    `common` (P,): the light that they share with others. A fast test that most pairs pass: over all pixels, and in most
    bands of rows.
    """
    if len(common) < FEWEST_PIXELS:
        return True
    sums, differences = levels[0] + levels[1], levels[0] - levels[1]
    residual = sums - (common @ sums) / max(common @ common, np.float32(NEGLIGIBLE)) * common
    products, squares = np.add.reduceat([differences * residual, differences**2], starts_of_bands(len(common)), axis=1)
    squares += np.float32(NEGLIGIBLE)
    # A gain between the frames of a pair correlates their sum with their difference by as much as its half.
    is_even = abs(products.sum()) < LEAST_DIFFERENCE / 2 * squares.sum()
    return bool(is_even and np.sort(np.abs(products) / squares)[BANDS // 2] < LEAST_DIFFERENCE)


def gains_of_stripes(levels: Floats32, coarser: Sequence[Bools]) -> Gains | None:
    """Return the gains of a pattern and its inverse (2, P), given all coarser bits of the code, coarsest first, (P,)
    each.

    None if they are not determined or not significant.
    """
    first, second = levels
    if abs(float(np.sum(first - second))) < LEAST_DIFFERENCE / 2 * float(np.sum(first + second)):
        return None
    logs = np.log((first + 1) / (second + 1))
    if np.std(logs) > _MOST_CONTRAST:
        return None
    cell, count = _cells(coarser, len(first))
    if len(count) < _FEWEST_CELLS:
        return None
    known = cell >= 0
    means = np.bincount(cell[known], logs[known]) / count
    ratio = float(np.mean(means))
    sigma = float(np.std(means)) / sqrt(len(means))
    if abs(ratio) < SIGNIFICANT_SIGMAS * sigma:
        return None
    return Gains(np.exp(np.array([[ratio / 2], [-ratio / 2]])))


def _cells(coarser: Sequence[Bools], pixels: int) -> tuple[Ints, Ints]:
    """Return each pixel's cell index (P,), −1 for cells of few pixels, and the pixel count of each other cell."""
    words = np.zeros(pixels, np.int64)
    of_pixel, count = words, np.array([pixels])
    for bit in coarser:
        words = 2 * words + bit
        _, finer, in_finer = np.unique(words, return_inverse=True, return_counts=True)
        if len(in_finer) > _MOST_CELLS:
            break
        of_pixel, count = finer, in_finer
    full = count >= _FEWEST_PER_CELL
    number: Ints = np.where(full, np.cumsum(full) - 1, -1)
    return number[of_pixel], count[full]


def gains_of_fringes(plan: SequencePlan, levels: Floats32, places: LitRows) -> GroupGains:
    """Return the gains of the steps of each evenly stepped fringe.

    `levels` (frames, P): of lit pixels. Empty for a single fringe, as the offset is known only from other fringes.
    """
    even = [fringe for axis in plan.axes for fringe in axis.fringes if fringe.equal_steps and not axis.is_unchecked]
    if len(even) < 2:
        return {}
    gains_of: GroupGains = {}
    means = [levels[list(fringe.frames)].mean(axis=0) for fringe in even]
    # The offset of a fringe comes from the others, so that an error in one affects the rest; hence the passes.
    for _ in range(PASSES):
        for number, fringe in enumerate(even):
            of_fringe, usual_means = levels[list(fringe.frames)], means[:number] + means[number + 1 :]
            common = medians(np.stack(usual_means), axis=0)
            is_steady = _are_steps_steady(fringe, of_fringe, common)
            steady = Gains(np.ones((len(of_fringe), 1)))
            gains = steady if is_steady else gains_of_fringe(fringe, of_fringe, common, places)
            means[number] = (of_fringe / gains.at(places.rows)).mean(axis=0).astype(np.float32)
            gains_of[fringe.frames] = gains
        if not any(gains.are_harmful for gains in gains_of.values()):
            break
    return gains_of


def _are_steps_steady(fringe: Fringe, levels: Floats32, common: Floats32) -> bool:
    """Whether opposite steps (N, P) of a fringe are equally bright, and all such pairs; False for an odd number of
    steps.

    A fast test, as for a pattern and its inverse.
    """
    pairs, is_odd = divmod(len(levels), 2)
    if is_odd:
        return False
    ordered = levels[np.argsort(np.mod(np.array(fringe.shifts) + 1e-9, 1))]
    along = ordered @ common
    of_pairs = along[:pairs] + along[pairs:]
    return bool(np.ptp(of_pairs) < LEAST_DIFFERENCE * of_pairs.min()) and all(
        _is_steady(ordered[step::pairs], common) for step in range(pairs)
    )


@dataclass(frozen=True)
class FrameGains:
    """The relative brightness of the frames of each group that adds up to the same light, by its frames' numbers."""

    of_pairs: GroupGains
    """Of patterns and their inverses."""
    of_fringes: GroupGains = field(default_factory=dict)
    """Of the steps of fringes."""
    lit: LitRows | None = None
    """Of the pixels that tell those of fringes; None if none do."""

    @cached_property
    def harmful(self) -> GroupGains:
        """Those of the groups whose frames differ enough to do harm."""
        return {frames: gains for frames, gains in (self.of_pairs | self.of_fringes).items() if gains.are_harmful}

    @property
    def flicker(self) -> float | None:
        """As in `Decoding`."""
        return flicker_of([*self.of_pairs.values(), *self.of_fringes.values()])

    def with_fringes(self, plan: SequencePlan, sample: Sample, lit: Ints) -> "FrameGains":
        """Return the gains with those of fringes, as some lit pixels of a sample tell them."""
        places = LitRows(sample.rows[lit], sample.shape[0])
        return FrameGains(self.of_pairs, gains_of_fringes(plan, sample.levels[:, lit], places), places)

    def without(self, plan: SequencePlan, samples: Samples) -> Samples:
        """Return samples of equally bright frames, and of groups as bright as the others of their kind."""
        equalised = samples.divided(plan, self.harmful)
        outlying = self._outlying(equalised.scattered)
        return equalised.divided(plan, {group: Gains(np.full((len(group), 1), by)) for group, by in outlying})

    def apply(self, frames: PartOfFrames, places: Sequence[int]) -> Iterator[Image]:
        """Yield the frames (...) at some places, equally bright: patterns and their inverses as the darker of the two,
        in whole grey levels; the steps of fringes divided by their gains.
        """
        for place, levels in zip(places, frames.read(places), strict=True):
            equalised = self._by_frame.get(frames.plan.shown[place])
            yield equalised(levels, frames.rows) if equalised else levels

    @cached_property
    def _by_frame(self) -> dict[int, Callable[[Image, Ints], NDArray[Any]]]:
        """What makes the levels of a frame, by its number, in some rows as bright as those of the others."""
        return {
            frame: partial(gains.to_darkest if group in self.of_pairs else self._of_steps(gains).divided, number)
            for group, gains in self.harmful.items()
            for number, frame in enumerate(group)
        }

    def _of_steps(self, gains: Gains) -> Gains:
        """Return the gains of a fringe's steps, for whole frames."""
        return gains if self.lit is None else gains.within(self.lit)

    def _outlying(self, sample: Sample) -> Iterator[tuple[tuple[int, ...], float]]:
        """Yield groups of equalised frames that differ in brightness from the other pairs or fringes, with the ratio.

        Those whose gains were not harmful are the reference, if any.
        """
        for groups in (self.of_pairs, self.of_fringes):
            kind = [*groups]
            means = np.array([np.mean([np.mean(sample.level(frame)) for frame in frames]) for frames in kind])
            differed = np.array([groups[frames].are_harmful for frames in kind], np.bool_)
            if differed.any():
                usual = float(np.median(means if differed.all() else means[~differed]))
                yield from ((kind[at], float(means[at]) / usual) for at in np.flatnonzero(differed))
