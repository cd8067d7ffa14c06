"""Coarse projector coordinates at sampled pixels, without the decoder."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np

from calib.numerics import Bools, Floats
from scanner.importing.samples import LevelSamples
from scanner.importing.unwrapping import agreed, deviates_from_code, repeats_after
from scanner.patterns import Axis, Black, Gray, Pattern, Phase, White

# Shares of a pixel's range of brightness: threshold of a bit; largest distance of fringes from each other and from
# cosines.
_DECIDED, _MOST_MISFIT = 0.05, 0.15
_FEWEST = 200
_FEWEST_CERTAIN = 0.3
_FINEST = 2  # finest bits that the camera may hardly resolve
# Share of the lit pixels at which a bit is bright or dark, below which the camera does not resolve it, or hardly, with
# no finer one that it does; and the number of the coarsest bits, which it always does.
_UNRESOLVED, _HARDLY, _COARSEST = 0.1, 0.5, 4
# Levels of a frame relative to half-way between black and white, in swings: its darkest and brightest pixels; hardly
# resolved stripes, which are neither.
_ENDS, _FAINT, _NEITHER = (0.1, 0.9), 0.5, 0.45
_LEAST_OF_EACH = 0.02
_MOST_BETWEEN_CELLS = 0.5  # share of neighbours in different cells, half a cycle long, where all are near each other
_SMOOTHED = (5, 5)
_STEPS_OF_CYCLE = 128  # steps per cycle; gamma shifts fringes of three steps by hundredths of a cycle
_FEWEST_STEPS = 3  # of a fringe
_KEPT = 64  # results of the last orders: most orders differ from another one along one axis only
_BITS_KEPT = 256  # orders that share no axis often share most pairs of frames


_Shown = tuple[tuple[int, Pattern], ...]  # frames by their numbers


@dataclass(frozen=True)
class Coordinates:
    """The coordinates of sampled pixels (H, W) along an axis."""

    values: Floats
    """In cells or pixels."""
    certain: Bools
    """Where they are certain."""
    steps: float = 1.0
    """They are accurate to a few of these."""
    misfit: float | None = None
    """Of fringes that determine the coordinate together, and that fit equally well counted from the other end."""
    unresolved: int = 0
    """Number of the finest bits that the camera does not resolve."""


@dataclass(frozen=True)
class Mismatch:
    """Why frames along an axis are not what they are tried as."""

    words: str
    reached: float
    """The share of the axis's fringes and bits that are what they should be, before the first that is not."""


def coordinates(samples: LevelSamples, patterns: Sequence[Pattern], axis: Axis) -> Coordinates | Mismatch | None:
    """Return the coordinates from the Gray code of an axis, else from its longest fringe or from several close periods.

    Returns None if the axis has neither.
    """
    ours = ((i, p) for i, p in enumerate(patterns) if isinstance(p, White | Black) or p.axis == axis)
    return _coordinates(samples, tuple(_without_copies(samples, tuple(ours))), axis)


def _without_copies(samples: LevelSamples, frames: _Shown) -> Iterator[tuple[int, Pattern]]:
    """Yield the frames but copies of the ones before, whose patterns follow from other frames."""
    kept = [pattern for index, pattern in frames if index not in samples.copies]
    for index, pattern in frames:
        if index not in samples.copies or not _follows(pattern, kept):
            yield index, pattern


def _follows(pattern: Pattern, candidates: Sequence[Pattern]) -> bool:
    """Whether other patterns along the same axis show what a pattern does."""
    match pattern:
        case Gray():
            return replace(pattern, inverted=not pattern.inverted) in candidates
        case Phase():
            steps = [p for p in candidates if isinstance(p, Phase) and p.period == pattern.period]
            return len(steps) >= _FEWEST_STEPS
    return isinstance(pattern, White | Black)


@lru_cache(_KEPT)
def _coordinates(samples: LevelSamples, frames: _Shown, axis: Axis) -> Coordinates | Mismatch | None:
    """`coordinates` from the frames of the axis, white and black."""
    fringes: dict[float, list[tuple[float, int]]] = defaultdict(list)
    for index, pattern in frames:
        if isinstance(pattern, Phase):
            fringes[pattern.period].append((pattern.shift, index))
    waves = dict[float, _Wave]()
    for period, steps in fringes.items():
        waves[period] = _wave(samples, tuple(steps))
        wrong = _misfit(samples, waves[period], next(iter(waves.values())))
        if wrong:
            return Mismatch(f"the fringes of {axis} {wrong}", (len(waves) - 1) / (len(fringes) + 1))
    codes: dict[tuple[float, float], Coordinates] = {}
    for numbering in dict.fromkeys((bit.cell, bit.offset) for _, bit in frames if isinstance(bit, Gray)):
        code = _code(samples, frames, axis, numbering)
        if isinstance(code, Mismatch):
            return code
        codes[numbering] = code
    if not codes:
        return _phases(samples, waves, axis)
    if _contradicts_codes(waves, codes):
        return Mismatch(f"the fringes of {axis} belong to another code", 1.0)
    return next(iter(codes.values()))


def _contradicts_codes(waves: "dict[float, _Wave]", codes: dict[tuple[float, float], Coordinates]) -> bool:
    """Whether a fringe contradicts codes that together determine half of its period."""
    certain = np.logical_and.reduce([code.certain for code in codes.values()])
    middles = [(code.values + 0.5) * cell - offset - 0.5 for (cell, offset), code in codes.items()]
    cell_width = max(cell for cell, _ in codes) / len(codes)
    middle = np.mean(middles, axis=0)
    beside = {period: wave.cycles() for period, wave in waves.items() if period == 2 * cell_width}
    return int(np.count_nonzero(certain)) >= _FEWEST and any(
        deviates_from_code(cycles[certain], period, middle[certain]) or _runs_back(cycles, middle, certain)
        for period, cycles in beside.items()
    )


def _runs_back(cycles: Floats, middle: Floats, certain: Bools) -> bool:
    """Whether a fringe's phase (H, W) falls from pixel to pixel where the coordinate grows.

    `middle`: the coordinate of the cell's middle, so that neighbours in the same cell do not count. If most are in
    different ones, they may be more than half a cycle apart, and tell nothing.
    """
    both = 0.0
    for axis in (0, 1):
        there = np.minimum.reduce([np.delete(certain, end, axis) for end in (0, -1)])
        direction = np.sign(np.diff(middle, axis=axis))[there]
        if direction.size and np.mean(direction != 0) < _MOST_BETWEEN_CELLS:
            both += float(np.sum(np.sin(2 * np.pi * np.diff(cycles, axis=axis))[there] * direction))
    return both < 0


@dataclass(frozen=True)
class _Wave:
    """Of a period: mean level (H, W), cosine and sine of the phase times the amplitude.

    `misfit`: the median of the largest residuals of lit pixels, relative to their swing.
    """

    mean: Floats
    cosine: Floats
    sine: Floats
    misfit: float

    def cycles(self) -> Floats:
        """The phase (H, W)."""
        return np.arctan2(self.sine, self.cosine) / (2 * np.pi)


@lru_cache(_KEPT)
def _wave(samples: LevelSamples, steps: tuple[tuple[float, int], ...]) -> _Wave:
    """The wave of a fringe's steps: shift and number of the frame."""
    angles = 2 * np.pi * np.array([shift for shift, _ in steps])
    design = np.stack([np.ones_like(angles), np.cos(angles), -np.sin(angles)], axis=1)
    levels = samples.levels[[index for _, index in steps]]
    mean, cosine, sine = fitted = np.tensordot(np.linalg.pinv(design), levels, 1)
    worst = np.abs(levels - np.tensordot(design, fitted, 1)).max(axis=0)
    return _Wave(mean, cosine, sine, float(np.median(worst[samples.lit] / samples.swing[samples.lit])))


def _misfit(samples: LevelSamples, wave: _Wave, first: _Wave) -> str | None:
    """Why levels are not those of a fringe beside the `first` one."""
    lit, swing = samples.lit, samples.swing
    if wave.misfit > _MOST_MISFIT:
        return "are no fringes"
    if np.median(np.abs(wave.mean - first.mean)[lit] / swing[lit]) > _MOST_MISFIT:
        return "differ in their mean brightness"
    return None


def _phases(samples: LevelSamples, waves: dict[float, _Wave], axis: Axis) -> Coordinates | Mismatch | None:
    if not waves:
        return None
    period, whole = max(waves), repeats_after([*waves])
    if whole > period:
        return _unwrapped(samples, waves, whole, axis)
    cosine, sine = (cv2.blur(part, _SMOOTHED) for part in (waves[period].cosine, waves[period].sine))
    certain = samples.lit & (np.hypot(cosine, sine) > _DECIDED * samples.swing)
    if np.count_nonzero(certain) < _FEWEST:
        return Mismatch(f"the fringes of {axis} are hardly visible", 1.0)
    return Coordinates(np.mod(np.arctan2(sine, cosine) / (2 * np.pi), 1) * period, certain, period / _STEPS_OF_CYCLE)


def _unwrapped(samples: LevelSamples, waves: dict[float, _Wave], whole: float, axis: Axis) -> Coordinates | Mismatch:
    """Where the fringes of several periods agree, below a coordinate from which on they repeat."""
    if not np.isfinite(whole):
        return Mismatch(f"the fringes of {axis} have no common period", 1.0)
    certain = samples.lit.copy()
    for wave in waves.values():
        certain &= np.hypot(wave.cosine, wave.sine) > _DECIDED * samples.swing
    if np.count_nonzero(certain) < _FEWEST:
        return Mismatch(f"the fringes of {axis} are hardly visible", 1.0)
    agreement = agreed(np.stack([wave.cycles()[certain] for wave in waves.values()]), [*waves], whole)
    if isinstance(agreement, str):
        return Mismatch(f"the fringes of {axis} {agreement}", 1.0)
    values = np.zeros(certain.shape)
    values[certain] = agreement.coordinate
    return Coordinates(values, certain, agreement.step, agreement.misfit)


def contrasts_of_bits(samples: LevelSamples, patterns: Sequence[Pattern], axis: Axis) -> list[float]:
    """How far apart the bright and the dark pixels of each bit of an axis's code are, in swings, coarsest first."""
    of_axis = [(i, p) for i, p in enumerate(patterns) if isinstance(p, White | Black) or p.axis == axis]
    of_code = {index: p for index, p in of_axis if isinstance(p, Gray)}
    lit = samples.lit
    contrasts = []
    for bit in sorted({p.bit for p in of_code.values()}):
        bright, dark = _levels_of_bit(samples, _frames_of_bit(of_axis, of_code, bit))
        share = 1 if len([p for p in of_code.values() if p.bit == bit]) > 1 else 2
        contrasts.append(share * float(np.quantile(np.abs(bright - dark)[lit] / samples.swing[lit], _ENDS[1])))
    return contrasts


def _code(samples: LevelSamples, frames: _Shown, axis: Axis, numbering: tuple[float, float]) -> Coordinates | Mismatch:
    """The code of an axis with its cell and offset, without the finest bits that the camera does not resolve."""
    of_code = {index: p for index, p in frames if isinstance(p, Gray) and (p.cell, p.offset) == numbering}
    bits = max(p.bits for p in of_code.values())
    lit, enough = samples.lit, max(_FEWEST, _FEWEST_CERTAIN * np.count_nonzero(samples.lit))
    number, certain, before = np.zeros(lit.shape), lit.copy(), np.zeros(lit.shape, np.bool_)
    for bit in range(bits):
        bright, decided = _bit(samples, _frames_of_bit(frames, of_code, bit))
        if bit < bits - _FINEST:
            if np.count_nonzero(certain & decided) < enough:  # most wrong orders end at one of the first bits
                share = float(np.mean(decided[lit]))
                fine = [_bit(samples, _frames_of_bit(frames, of_code, n))[1] for n in range(bit + 1, bits)]
                finer = [float(np.mean(of_bit[lit])) for of_bit in fine]
                if bit >= _COARSEST and max(finer) <= max(share, _UNRESOLVED) < _HARDLY:
                    cells = 2.0 ** (bits - bit)
                    return Coordinates((number + 0.5) * cells, certain, cells, unresolved=bits - bit)
                return Mismatch(
                    f"bit {bit} of {axis} is neither bright nor dark at {1 - share:.0%} of the pixels", bit / bits
                )
            certain &= decided
        elif bit == bits - 1 and _is_constant(bright[lit & decided]):
            return Mismatch(f"the finest bit of {axis} never changes", bit / bits)
        before ^= bright
        number = 2 * number + before
    return Coordinates(number, certain)


@dataclass(frozen=True)
class _BitFrames:
    """The frames that decide a bit, by their numbers."""

    shown: int | None
    """The bit's; None if it was not taken."""
    inverted: int | None
    """Its inverse's; None if it was not taken."""
    ends: tuple[int, ...] = ()
    """White and black, where either of the two is missing."""


def _frames_of_bit(axis_frames: Sequence[tuple[int, Pattern]], of_code: dict[int, Gray], bit: int) -> _BitFrames:
    """From the frames of its code by their numbers."""
    frames = {p.inverted: index for index, p in of_code.items() if p.bit == bit}
    if len(frames) > 1:
        return _BitFrames(frames[False], frames[True])
    ends = tuple(index for index, p in axis_frames if isinstance(p, White | Black))
    return _BitFrames(frames.get(False), frames.get(True), ends)


@lru_cache(_BITS_KEPT)
def _bit(samples: LevelSamples, frames: _BitFrames) -> tuple[Bools, Bools]:
    """Where a bit is bright (H, W), and where it is decided."""
    bright, dark = _levels_of_bit(samples, frames)
    return bright > dark, np.abs(bright - dark) > _DECIDED * samples.swing


def _levels_of_bit(samples: LevelSamples, frames: _BitFrames) -> tuple[Floats, Floats]:
    """The levels (H, W) that are compared: those of both frames, or of one and its threshold."""
    taken = [frame for frame in (frames.shown, frames.inverted) if frame is not None]
    if len(taken) == 2:
        return samples.levels[taken[0]], samples.levels[taken[1]]
    half_way = _middle(samples, frames.ends)
    if taken:
        half_way = half_way + _above_middle(samples, *taken, frames.ends) * samples.swing
    bright, dark = (half_way if frame is None else samples.levels[frame] for frame in (frames.shown, frames.inverted))
    return bright, dark


@lru_cache(_KEPT)
def _middle(samples: LevelSamples, ends: tuple[int, ...]) -> Floats:
    """Half-way between white and black (H, W), from the numbers of both frames; else between the extremes."""
    extremes = samples.levels[[*ends]] if len(ends) == 2 else samples.levels
    middle: Floats = (extremes.min(axis=0) + extremes.max(axis=0)) / 2
    return middle


@lru_cache(_KEPT)
def _above_middle(samples: LevelSamples, frame: int, ends: tuple[int, ...]) -> float:
    """How far above the middle, in swings, a bit is decided that has no inverse: half-way between its own two levels.

    Where a camera's curve is bent, stripes that it does not resolve are brighter than half-way between black and white.
    """
    excess = samples.levels[frame] - _middle(samples, ends)
    dark, bright = np.quantile((excess / np.maximum(samples.swing, 1e-6))[samples.lit], _ENDS)
    # A bit that is constant over the picture is dark or bright; a coarse bit is compared with the middle as well.
    is_fine = bright - dark < _FAINT and max(abs(dark), abs(bright)) < _NEITHER
    return float(dark + bright) / 2 if is_fine else 0.0


def _is_constant(bits: Bools) -> bool:
    """Whether nearly all values are equal, if there are enough."""
    share = float(np.mean(bits)) if len(bits) >= _FEWEST else 0.5
    return min(share, 1 - share) < _LEAST_OF_EACH
