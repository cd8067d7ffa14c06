"""Equalise frames of different brightness: bits as they are folded in, fringes once all frames are known.

A pattern and its inverse are compared as soon as both are there, so they are equalised then. For a fringe only its two
components are kept; the effect of brighter and darker steps is corrected afterwards, given the offset around which the
fringe oscillates.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Bools, Image, compiled
from scanner.decoding.arrays import NEGLIGIBLE, Floats32
from scanner.decoding.fringes.single_fringe import is_unchecked
from scanner.decoding.light.balanced_stripes import gains_of_stripes
from scanner.decoding.light.brightness import (
    BANDS,
    LEAST_DIFFERENCE,
    PASSES,
    Gains,
    Places,
    gains_of_fringe,
    gains_of_pair,
    starts_of_bands,
)
from scanner.decoding.light.lit_pixels import lit_by
from scanner.decoding.medians import medians
from scanner.decoding.samples import Sample
from scanner.decoding.sequence_plan import Fringe, SequencePlan
from scanner.decoding.significance import FEWEST_PIXELS, MAJORITY

Levels = Image | Floats32


class PairEqualiser:
    """The gains of each pattern and its inverse, as they arrive, relative to the pairs before them.

    The first pair is the reference, unless white and black came first.
    """

    def __init__(self, plan: SequencePlan, sample: Sample) -> None:
        self.found: dict[tuple[int, int], Gains] = {}
        self._plan, self._sample = plan, sample
        self._rows, self._height = sample.rows, sample.shape[0]
        self._total, self._pairs = np.zeros(len(self._rows), np.float32), 0
        self._swing = np.zeros_like(self._total)
        self._lit = np.arange(0)
        self._coarser = {
            pair: [code.pairs[coarser] for coarser in sorted(code.pairs) if coarser < bit]
            for axis in plan.axes
            for code in axis.codes
            if code.base is None and not code.unpaired
            for bit, pair in code.pairs.items()
        }
        self._bits: dict[tuple[int, int], Bools] = {}

    def gains(self, pair: tuple[int, int]) -> Gains | None:
        """Return the gains of two frames that are in the sample; None if they do not matter."""
        first, second = (self._sample.level(frame) for frame in pair)
        if not self._pairs:
            self._begin_with_white_and_black()
        if not self._pairs:
            self._add(pair, first, second)
            return None
        gains = self._between(pair, first, second)
        self.found[pair] = gains
        if not gains.are_harmful:
            self._add(pair, first, second)
            return None
        by_pixel = gains.at(self._rows).astype(np.float32)
        self._add(pair, first / by_pixel[0], second / by_pixel[1])
        return gains

    def _between(self, pair: tuple[int, int], first: Levels, second: Levels) -> Gains:
        levels = np.stack([first[self._lit], second[self._lit]], dtype=np.float32)
        coarser = self._coarser.get(pair)
        if coarser is not None and all(each in self._bits for each in coarser):
            of_stripes = gains_of_stripes(levels, [self._bits[each][self._lit] for each in coarser])
            if of_stripes is not None:
                return of_stripes
        common: Floats32 = self._total[self._lit] / np.float32(2 * self._pairs)
        if _is_steady(levels, common):
            return Gains(np.ones((2, 1)))
        return gains_of_pair(levels, common, Places(self._rows[self._lit], self._height))

    def _begin_with_white_and_black(self) -> None:
        white, black = self._plan.white, self._plan.black
        if white is not None and black is not None and self._sample.has(white, black):
            self._add_to_common(self._sample.level(white), self._sample.level(black))

    def _add(self, pair: tuple[int, int], first: Levels, second: Levels) -> None:
        self._bits[pair] = first > second
        self._add_to_common(first, second)

    def _add_to_common(self, first: Levels, second: Levels) -> None:
        self._total += first
        self._total += second
        self._pairs += 1
        if self._pairs <= MAJORITY:
            self._swing = np.maximum(self._swing, np.abs(first.astype(np.float32) - second))
            self._lit = lit_by(self._swing)


def _is_steady(levels: Floats32, common: Floats32) -> bool:
    """Whether the sum of two frames (2, P) is uncorrelated with their difference, as in steady light.

    `common` (P,): the light that they share with others. A fast test that most pairs pass: over all pixels, and in most
    bands of rows.
    """
    if len(common) < FEWEST_PIXELS:
        return True
    sums, differences = levels[0] + levels[1], levels[0] - levels[1]
    left = sums - (common @ sums) / max(common @ common, np.float32(NEGLIGIBLE)) * common
    products, squares = np.add.reduceat([differences * left, differences**2], starts_of_bands(len(common)), axis=1)
    squares += np.float32(NEGLIGIBLE)
    # A gain between the frames of a pair correlates their sum with their difference by as much as its half.
    is_even = abs(products.sum()) < LEAST_DIFFERENCE / 2 * squares.sum()
    return bool(is_even and np.sort(np.abs(products) / squares)[BANDS // 2] < LEAST_DIFFERENCE)


@dataclass(frozen=True)
class Correction:
    """Linear correction of a fringe's components for the gains of its steps.

    `of_components` (2, 2, rows) applies to the accumulated components, `of_light` (2, rows) to the fringe's offset,
    which is `light` (3,) times middle, brightest and 1. Rows: of the image, or one for all. If the gains depend on the
    row, both are 0 in rows beyond those with lit pixels.
    """

    of_components: Floats32
    of_light: Floats32
    light: Floats32

    def apply(
        self, cosine: Floats32, sine: Floats32, middle: Floats32, brightest: Floats32, rows: NDArray[np.int64]
    ) -> tuple[Floats32, Floats32]:
        """Return the corrected components at pixels in these `rows`, all (P,)."""
        corrected = np.empty((2, len(cosine)), np.float32)
        light = self.light[0] * middle + self.light[1] * brightest + self.light[2]
        _correct(cosine, sine, light, rows, self.of_components, self.of_light, corrected)
        return corrected[0], corrected[1]


@compiled
def _correct(
    cosine: Floats32,
    sine: Floats32,
    light: Floats32,
    rows: NDArray[np.int64],
    of_components: Floats32,
    of_light: Floats32,
    corrected: Floats32,
) -> None:
    by_row = int(of_light.shape[1] > 1)
    for component in range(2):
        of_cosine, of_sine, offset = of_components[component, 0], of_components[component, 1], of_light[component]
        into = corrected[component]
        for i in range(len(into)):
            row = by_row * rows[i]
            into[i] = of_cosine[row] * cosine[i] + of_sine[row] * sine[i] + offset[row] * light[i]


def correction(
    fringe: Fringe, gains: Gains, places: Places, common: Floats32, middle: Floats32, brightest: Floats32
) -> Correction:
    """Return the correction for the `gains` of a fringe's steps around the `common` light.

    `common`, `middle` and `brightest` (P,): at the `places` from which the gains were estimated. I = g (M + C cos φ − S
    sin φ), and the accumulated components are weighted sums of I.
    """
    angles = 2 * np.pi * np.array(fringe.shifts)
    design = np.stack([np.ones_like(angles), np.cos(angles), -np.sin(angles)], axis=1)
    seen = np.einsum("ck,kr,kd->rcd", fringe.weights[1:], gains.of_rows, design)
    inverse = np.linalg.inv(seen[:, :, 1:])
    of_light = -np.einsum("rcd,rd->cr", inverse, seen[:, :, 0])
    light, *_ = np.linalg.lstsq(np.stack([middle, brightest, np.ones_like(middle)], axis=1), common, rcond=1e-4)
    components = np.moveaxis(inverse, 0, -1)
    if gains.are_banded:
        for unknown in np.s_[: places.rows[0]], np.s_[places.rows[-1] + 1 :]:
            components[..., unknown] = 0
            of_light[..., unknown] = 0
    return Correction(components.astype(np.float32), of_light.astype(np.float32), light.astype(np.float32))


def swings_of(plan: SequencePlan, levels: Floats32, places: Places) -> dict[Fringe, tuple[Gains, Floats32]]:
    """Return, for each evenly stepped fringe, the gains of its steps and the offset around which it oscillates (P,).

    `levels` (frames, P): of lit pixels. Empty for a single fringe, as the offset is known only from other fringes.
    """
    even = [fringe for axis in plan.axes for fringe in axis.fringes if fringe.equal_steps and not is_unchecked(axis)]
    if len(even) < 2:
        return {}
    found: dict[Fringe, tuple[Gains, Floats32]] = {}
    means = [levels[list(fringe.frames)].mean(axis=0) for fringe in even]
    # The offset of a fringe comes from the others, so that an error in one affects the rest; hence the passes.
    for _ in range(PASSES):
        for number, fringe in enumerate(even):
            of_fringe, others = levels[list(fringe.frames)], means[:number] + means[number + 1 :]
            common = medians(np.stack(others), axis=0)
            is_steady = _are_steps_steady(fringe, of_fringe, common)
            steady = Gains(np.ones((len(of_fringe), 1)))
            gains = steady if is_steady else gains_of_fringe(fringe, of_fringe, common, places)
            means[number] = (of_fringe / gains.at(places.rows)).mean(axis=0).astype(np.float32)
            found[fringe] = gains, means[number]
        if not any(gains.are_harmful for gains, _ in found.values()):
            break
    return found


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


def outlier_groups(
    groups: Sequence[tuple[tuple[int, ...], bool]], sample: Sample
) -> Iterator[tuple[tuple[int, ...], float]]:
    """Yield groups of equalised frames that differ in brightness from the other pairs or fringes, with the ratio.

    `groups`: the frames of pairs and fringes, and whether they differed. Those that did not are the reference, if any.
    """
    for kind in ([one for one in groups if len(one[0]) == 2], [one for one in groups if len(one[0]) > 2]):
        means = np.array([np.mean([np.mean(sample.level(frame)) for frame in frames]) for frames, _ in kind])
        differed = np.array([differ for _, differ in kind], np.bool_)
        if differed.any():
            usual = float(np.median(means if differed.all() else means[~differed]))
            yield from ((kind[at][0], float(means[at]) / usual) for at in np.flatnonzero(differed))
