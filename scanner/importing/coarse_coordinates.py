"""The projector's coordinate at sampled pixels, as well as it can be told without a decoder."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calib.numerics import Bools, Floats
from scanner.importing.samples import Samples
from scanner.patterns import Axis, Black, Gray, Pattern, Phase, White

# Of a pixel's own range of brightness: what decides a bit; how far fringes may be from each other and from cosines.
_DECIDED, _MOST_MISFIT = 0.05, 0.15
_FEWEST = 200
_FEWEST_CERTAIN = 0.3
_FINEST = 2  # bits that a camera may not resolve
# Levels of a frame next to half-way between black and white, in swings: its darkest and brightest pixels; stripes that
# are hardly resolved, and neither black nor white.
_ENDS, _FAINT, _NEITHER = (0.1, 0.9), 0.5, 0.45
_LEAST_OF_EACH = 0.02
_SMOOTHED = (5, 5)
_STEPS_OF_CYCLE = 128  # a projector's gamma bends fringes of three steps by hundredths of a cycle


@dataclass(frozen=True)
class Coordinates:
    """`values` (H, W) along an axis, in cells or pixels, good to a few `steps`; where they are `certain`."""

    values: Floats
    certain: Bools
    steps: float = 1.0


def coordinates(samples: Samples, patterns: Sequence[Pattern], axis: Axis) -> Coordinates | str | None:
    """From the Gray code of an axis, else its longest fringe; None if it has neither; or what is wrong with them."""
    fringes: dict[float, list[tuple[float, int]]] = defaultdict(list)
    for index, pattern in enumerate(patterns):
        if isinstance(pattern, Phase) and pattern.axis == axis:
            fringes[pattern.period].append((pattern.shift, index))
    waves = {period: _Wave(samples, shown) for period, shown in fringes.items()}
    wrong = _misfit(samples, list(waves.values()))
    if wrong:
        return f"the fringes of {axis} {wrong}"
    codes = _codes(samples, patterns, axis)
    return _phases(samples, waves, axis) if codes is None else codes


class _Wave:
    """Of a period: mean level (H, W), cosine and sine of the phase times the amplitude, and what is left of frames."""

    def __init__(self, samples: Samples, shown: Sequence[tuple[float, int]]) -> None:
        angles = 2 * np.pi * np.array([shift for shift, _ in shown])
        design = np.stack([np.ones_like(angles), np.cos(angles), -np.sin(angles)], axis=1)
        levels = samples.levels[[index for _, index in shown]]
        self.mean, self.cosine, self.sine = np.tensordot(np.linalg.pinv(design), levels, 1)
        self.rest = levels - np.tensordot(design, np.stack([self.mean, self.cosine, self.sine]), 1)


def _misfit(samples: Samples, waves: Sequence[_Wave]) -> str | None:
    lit, swing = samples.lit, samples.swing
    for wave in waves:
        if np.median(np.abs(wave.rest).max(axis=0)[lit] / swing[lit]) > _MOST_MISFIT:
            return "are no fringes"
        if np.median(np.abs(wave.mean - waves[0].mean)[lit] / swing[lit]) > _MOST_MISFIT:
            return "differ in their mean brightness"
    return None


def _phases(samples: Samples, waves: dict[float, _Wave], axis: Axis) -> Coordinates | str | None:
    if not waves:
        return None
    period = max(waves)
    cosine, sine = (cv2.blur(part, _SMOOTHED) for part in (waves[period].cosine, waves[period].sine))
    certain = samples.lit & (np.hypot(cosine, sine) > _DECIDED * samples.swing)
    if np.count_nonzero(certain) < _FEWEST:
        return f"the fringes of {axis} are hardly seen"
    return Coordinates(np.mod(np.arctan2(sine, cosine) / (2 * np.pi), 1) * period, certain, period / _STEPS_OF_CYCLE)


def _codes(samples: Samples, patterns: Sequence[Pattern], axis: Axis) -> Coordinates | str | None:
    """The codes of an axis, None if it has none, or what is wrong with them."""
    shown = {(p.bit, p.inverted): index for index, p in enumerate(patterns) if isinstance(p, Gray) and p.axis == axis}
    if not shown:
        return None
    bits = max(p.bits for p in patterns if isinstance(p, Gray) and p.axis == axis)
    levels, lit = samples.levels, samples.lit
    known = {type(p): levels[index] for index, p in enumerate(patterns) if isinstance(p, White | Black)}
    middle = (known[White] + known[Black]) / 2 if len(known) == 2 else (levels.min(axis=0) + levels.max(axis=0)) / 2
    number, certain, before = np.zeros(lit.shape), lit.copy(), np.zeros(lit.shape, np.bool_)
    for bit in range(bits):
        normal, inverse = shown.get((bit, False)), shown.get((bit, True))
        alone = inverse if normal is None else normal
        half_way = middle if alone is None else middle + _above_middle(samples, levels[alone], middle)
        bright = half_way if normal is None else levels[normal]
        dark = half_way if inverse is None else levels[inverse]
        one, decided = bright > dark, np.abs(bright - dark) > _DECIDED * samples.swing
        if bit < bits - _FINEST:
            certain &= decided
        elif bit == bits - 1 and _is_constant(one[lit & decided]):
            return f"the finest bit of {axis} never changes"
        before ^= one
        number = 2 * number + before
    if np.count_nonzero(certain) < max(_FEWEST, _FEWEST_CERTAIN * np.count_nonzero(lit)):
        return f"the bits of {axis} are neither bright nor dark at {1 - certain.sum() / lit.sum():.0%} of the pixels"
    return Coordinates(number, certain)


def _above_middle(samples: Samples, frame: Floats, middle: Floats) -> Floats:
    """How far above the middle (H, W) a bit is decided that has no inverse: half-way between its own two levels.

    Where a camera's curve is bent, stripes that it does not resolve are brighter than half-way between black and white.
    """
    relative = ((frame - middle) / np.maximum(samples.swing, 1e-6))[samples.lit]
    dark, bright = np.quantile(relative, _ENDS)
    between: Floats = (dark + bright) / 2 * samples.swing
    # A bit that is alike everywhere is either dark or bright, and a coarse one is decided by the middle as well.
    is_fine = bright - dark < _FAINT and max(abs(dark), abs(bright)) < _NEITHER
    return between if is_fine else np.zeros_like(between)


def _is_constant(bits: Bools) -> bool:
    """Whether nearly all of them are alike, where there are enough to say."""
    share = float(np.mean(bits)) if len(bits) >= _FEWEST else 0.5
    return min(share, 1 - share) < _LEAST_OF_EACH
