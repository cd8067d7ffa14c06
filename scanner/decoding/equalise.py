"""Frames whose brightness differs, made alike: bits as they are folded in, fringes once all frames are known.

A pattern and its inverse are compared as soon as both are there, so that they are made alike then. Of a fringe only its
two components are kept; what brighter and darker steps did to them is undone afterwards, given the light around
which the fringe swings.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanner.decoding.arrays import Floats32
from scanner.decoding.brightness import Gains, Places, gains_of_fringe, gains_of_pair, lit_by
from scanner.decoding.medians import medians
from scanner.decoding.pixel_sample import Sample
from scanner.decoding.sequence_plan import Fringe, SequencePlan

# Which pixels are lit shows in the first pairs, even if one of them is odd.
_TELLING_PAIRS = 3
_PASSES = 3


class PairEqualiser:
    """The gains of each pattern and its inverse, as they arrive, against the pairs before them.

    The first pair has none before it, unless white and black came first.
    """

    def __init__(self, plan: SequencePlan, sample: Sample, shape: tuple[int, int]) -> None:
        self.found: dict[tuple[int, int], Gains] = {}
        self._plan, self._sample = plan, sample
        self._rows, self._height = sample.pixels // shape[1], shape[0]
        self._total, self._pairs = np.zeros(len(self._rows), np.float32), 0
        self._swing = np.zeros_like(self._total)
        self._lit = np.arange(0)

    def gains(self, pair: tuple[int, int]) -> Gains | None:
        """Those of two frames that are in the sample; None if they do not matter."""
        levels = self._levels(pair)
        if not self._pairs:
            self._begin_with_white_and_black()
        found = None
        if self._pairs:
            common: Floats32 = self._total[self._lit] / np.float32(2 * self._pairs)
            found = gains_of_pair(levels[:, self._lit], common, Places(self._rows[self._lit], self._height))
            self.found[pair] = found
            if found.matter:
                levels = (levels / found.at(self._rows)).astype(np.float32)
        self._add(levels)
        return found if found is not None and found.matter else None

    def _begin_with_white_and_black(self) -> None:
        white, black = self._plan.white, self._plan.black
        if white is not None and black is not None and self._sample.has(white, black):
            self._add(self._levels((white, black)))

    def _levels(self, pair: tuple[int, int]) -> Floats32:
        return np.stack([self._sample.level(frame) for frame in pair], dtype=np.float32)

    def _add(self, levels: Floats32) -> None:
        self._total += levels[0] + levels[1]
        self._pairs += 1
        if self._pairs <= _TELLING_PAIRS:
            self._swing = np.maximum(self._swing, np.abs(levels[0] - levels[1]))
            self._lit = lit_by(self._swing)


@dataclass(frozen=True)
class Correction:
    """What gives the components of a fringe from those that were accumulated, (2, 2, rows), and the light around which
    it swings, (2, rows); that light is `light` (3,) times middle, brightest and 1. Rows: of the image, or one for all.
    """

    of_components: Floats32
    of_light: Floats32
    light: Floats32

    def apply(
        self, cosine: Floats32, sine: Floats32, middle: Floats32, brightest: Floats32, rows: NDArray[np.int64]
    ) -> tuple[Floats32, Floats32]:
        """At pixels in these `rows`, all (P,)."""
        at = rows if self.of_light.shape[-1] > 1 else np.zeros(1, np.int64)
        light = self.light[0] * middle + self.light[1] * brightest + self.light[2]
        a, b = self.of_components[..., at], self.of_light[..., at]
        return a[0, 0] * cosine + a[0, 1] * sine + b[0] * light, a[1, 0] * cosine + a[1, 1] * sine + b[1] * light


def correction(fringe: Fringe, gains: Gains, common: Floats32, middle: Floats32, brightest: Floats32) -> Correction:
    """Undoes the `gains` of the steps of a fringe around the `common` light; that and the others at some pixels (P,).

    I = g (M + C cos φ − S sin φ), and what was accumulated are weighted sums of I.
    """
    angles = 2 * np.pi * np.array(fringe.shifts)
    design = np.stack([np.ones_like(angles), np.cos(angles), -np.sin(angles)], axis=1)
    seen = np.einsum("ck,kr,kd->rcd", fringe.weights[1:], gains.of_rows, design)
    inverse = np.linalg.inv(seen[:, :, 1:])
    of_light = -np.einsum("rcd,rd->cr", inverse, seen[:, :, 0])
    light, *_ = np.linalg.lstsq(np.stack([middle, brightest, np.ones_like(middle)], axis=1), common, rcond=1e-4)
    components = np.moveaxis(inverse, 0, -1)
    return Correction(components.astype(np.float32), of_light.astype(np.float32), light.astype(np.float32))


def swings_of(plan: SequencePlan, levels: Floats32, places: Places) -> dict[Fringe, tuple[Gains, Floats32]]:
    """Of each fringe in even steps: the gains of its steps, and the light around which it swings (P,).

    `levels` (frames, P): of lit pixels. What a single fringe swings around, no other tells: then there are none.
    """
    even = [fringe for fringe in plan.fringes if fringe.equal_steps]
    if len(even) < 2:
        return {}
    found: dict[Fringe, tuple[Gains, Floats32]] = {}
    means = [levels[list(fringe.frames)].mean(axis=0) for fringe in even]
    # The light around which a fringe swings is known from the others: what is wrong with it there is wrong elsewhere.
    for _ in range(_PASSES):
        for number, fringe in enumerate(even):
            of_fringe, others = levels[list(fringe.frames)], means[:number] + means[number + 1 :]
            gains = gains_of_fringe(fringe, of_fringe, medians(np.stack(others), axis=0), places)
            means[number] = (of_fringe / gains.at(places.rows)).mean(axis=0).astype(np.float32)
            found[fringe] = gains, means[number]
        if not any(gains.matter for gains, _ in found.values()):
            break
    return found
