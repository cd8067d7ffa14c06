"""How large the projector is, from the codes that the camera saw.

It is one that projectors have, if one of these fits; of several the one whose rim was seen. Any other has to be seen to
end, inside the camera's image and straight: all rows at the same column.

A projector of two or four times as many pixels shows the same codes with cells of two or four. Nothing in the frames
tells them apart, and calibrated as the wrong one, all lengths in the projector's pixels are off by that factor. So
where a multiple is sold more often than the size itself, both are possible.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from calib.geometry import Matches
from calib.numerics import Bools, Floats
from scanner.importing.layout import Candidate, Given, Size
from scanner.patterns import Axis, Gray, Pattern, Phase

# Sizes of projectors on the market, and of the light engines of scanners.
_COMMON: tuple[Size, ...] = (
    (608, 684), (640, 360), (640, 480), (800, 480), (800, 600), (848, 480), (854, 480), (912, 1140), (960, 540),
    (1024, 600), (1024, 768), (1280, 720), (1280, 768), (1280, 800), (1280, 1024), (1366, 768), (1400, 1050),
    (1440, 900), (1600, 900), (1600, 1200), (1680, 1050), (1920, 1080), (1920, 1200), (2048, 1080), (2048, 1536),
    (2560, 1440), (2560, 1600), (3840, 2160), (4096, 2160),
)  # fmt: skip
# Sizes that most projectors have; the rest of those above is rare.
_USUAL: frozenset[Size] = frozenset(
    {(800, 600), (854, 480), (1024, 768), (1280, 720), (1280, 800), (1920, 1080), (1920, 1200), (3840, 2160)}
)
_ENLARGED = (1, 2, 4)
_STRIPES = 24
_FEWEST_IN_STRIPE = 5
_MOST_STRAY = 0.0005
_LEAST_STRAIGHT = 0.6
_BORDER = 0.02  # share of the camera's image
_SLACK = 2  # partly visible cells at the rim are dropped


@dataclass(frozen=True)
class Extent:
    """The smallest and the largest code along an axis, and whether the picture `ends` at the largest."""

    low: int
    high: int
    ends: bool

    def allows(self, first: int, last: int) -> bool:
        """Whether codes from `first` to `last` may have been shown."""
        return first - _SLACK <= self.low and self.high <= last + _SLACK

    def reaches(self, first: int, last: int) -> int:
        """Count the observed ends that depend on the projector's size."""
        return int(first > 0 and self.low - first <= _SLACK) + int(last - self.high <= _SLACK)


@dataclass(frozen=True)
class PossibleSize:
    """A size that the projector may have, by the codes that were seen."""

    size: Size
    patterns: tuple[Pattern, ...]
    """What it showed then."""
    reached: tuple[int, int]
    """How many ends of its codes in x and in y were seen."""
    enlarged: int = 1
    """How many of its pixels each pixel of the smallest such projector takes up, in each direction."""

    @property
    def total(self) -> int:
        """The number of all ends."""
        return sum(self.reached)

    @property
    def rank(self) -> int:
        """How often such projectors are sold: 2 often, 1 rarely, 0 never."""
        return int(self.size in _COMMON) + int(self.size in _USUAL)

    @property
    def reason(self) -> str:
        """Why it is among several."""
        sold = ("is no usual size", "is rare", "is usual")[self.rank]
        width, height = self.size
        return f"{width} × {height} {sold}" + (f", with cells of {self.enlarged} px" if self.enlarged > 1 else "")


def possible_sizes(candidate: Candidate, extents: Sequence[Extent], given: Given) -> list[PossibleSize]:
    """Sizes that the projector may have by the codes in x and y: the likeliest, or all that are equally so, the most
    usual first; several where a multiple is sold more often.
    """
    possible = [fit for size in _COMMON if (fit := _fit(candidate, size, extents, given))]
    if not possible and all(extent.ends for extent in extents) and not _shows_any_scale(candidate):
        fit = _fit(candidate, _measured(candidate, extents), extents, given)
        possible = [fit] if fit else []
    most = max((fit.total for fit in possible), default=0)
    best = [fit for fit in possible if fit.total == most]
    if best and all(best[0].reached):
        best = [best[0], *(fit for fit in best[1:] if fit.rank > best[0].rank)]
    if given.cell is not None:
        return best
    every = {fit.size: fit for smallest in reversed(best) for fit in _multiples(candidate, smallest)}
    usual = max((fit.rank for fit in every.values()), default=0)
    return best if len(best) == 1 and best[0].rank >= usual else sorted(every.values(), key=_most_usual_first)


def _most_usual_first(fit: PossibleSize) -> tuple[int, int]:
    return -fit.rank, fit.enlarged


def _multiples(candidate: Candidate, smallest: PossibleSize) -> list[PossibleSize]:
    """The same codes on projectors of one, two and four times the size; of a size that nobody sells, also with a code
    more in x or in y, since the last one may be hidden.
    """
    (width, height), cells = smallest.size, [_code_of(smallest.patterns, axis).cell for axis in (0, 1)]
    more = (0, 1) if smallest.rank == 0 else (0,)
    sizes = [smallest.size, *((width + dx * cells[0], height + dy * cells[1]) for dx in more for dy in more)]
    multiples = {smallest.size: smallest}
    for (across, down), times in product(sizes, _ENLARGED):
        size = across * times, down * times
        if size in _COMMON and size not in multiples:
            patterns = tuple(_enlarged(pattern, times) for pattern in candidate.for_size((across, down)))
            multiples[size] = replace(smallest, size=size, patterns=patterns, enlarged=times)
    return list(multiples.values())


def _enlarged(pattern: Pattern, times: int) -> Pattern:
    if isinstance(pattern, Gray):
        return replace(pattern, cell=pattern.cell * times, offset=pattern.offset * times)
    return replace(pattern, period=pattern.period * times) if isinstance(pattern, Phase) else pattern


def extents_of(candidate: Candidate, matches: Matches, camera_size: Size) -> tuple[Extent, Extent]:
    """Return the extents in x and in y, from a candidate's matches."""
    numbers = np.stack([_numbers(candidate.patterns, axis, matches.projector_px) for axis in (0, 1)], axis=1)
    inside = np.all(np.abs(matches.camera_px / camera_size - 0.5) < 0.5 - _BORDER, axis=1)
    x, y = (_extent(numbers[:, axis], numbers[:, 1 - axis], inside) for axis in (0, 1))
    return x, y


def _extent(values: Floats, across: Floats, inside: Bools) -> Extent:
    """Of codes (N,) along an axis, with those `across`; the picture ends only `inside` the camera's image."""
    low, high = (int(value) for value in np.quantile(values, (_MOST_STRAY, 1 - _MOST_STRAY), method="nearest"))
    stripes = np.floor((across - across.min()) / (np.ptp(across) + 1) * _STRIPES).astype(np.int64)
    straight, total = 0, 0
    for members in (np.flatnonzero(stripes == stripe) for stripe in range(_STRIPES)):
        if len(members) >= _FEWEST_IN_STRIPE:
            last = members[np.argmax(values[members])]
            straight += bool(inside[last] and abs(values[last] - high) <= _SLACK)
            total += 1
    return Extent(low, high, total > 0 and straight >= _LEAST_STRAIGHT * total)


def _code_of(patterns: Sequence[Pattern], axis: int) -> Gray:
    """The finest Gray code along an axis, any bit of it."""
    name: Axis = "x" if axis == 0 else "y"
    return min((p for p in patterns if isinstance(p, Gray) and p.axis == name), key=lambda code: code.cell)


def _numbers(patterns: Sequence[Pattern], axis: int, projector_px: Floats) -> Floats:
    code = _code_of(patterns, axis)
    return np.floor((projector_px[:, axis] + 0.5 + code.offset) / code.cell)


def _fit(candidate: Candidate, size: Size, extents: Sequence[Extent], given: Given) -> PossibleSize | None:
    """Whether the codes are possible on a projector of this size."""
    patterns, reached = candidate.for_size(size), [0, 0]
    if len(patterns) != len(candidate.files):
        return None
    for axis, (length, seen) in enumerate(zip(size, extents, strict=True)):
        code, provisional = _code_of(patterns, axis), _code_of(candidate.patterns, axis)
        first, last = code.offset // code.cell, (length - 1 + code.offset) // code.cell
        right_count = given.codes is None or last - first + 1 == given.codes[axis]
        if code.bits != provisional.bits or not seen.allows(first, last) or not right_count:
            return None
        reached[axis] = seen.reaches(first, last)
    return PossibleSize(size, patterns, (reached[0], reached[1]))


def _shows_any_scale(candidate: Candidate) -> bool:
    """Whether a projector of twice the size would be shown as many patterns, with cells of twice the length."""
    width, height = candidate.projector_size
    return len(candidate.for_size((2 * width, 2 * height))) == len(candidate.files)


def _measured(candidate: Candidate, extents: Sequence[Extent]) -> Size:
    """The size of a projector that ends where the codes do, be they counted from one side or from the middle."""
    codes = [_code_of(candidate.patterns, axis) for axis in (0, 1)]
    width, height = ((seen.high + 1) * code.cell for seen, code in zip(extents, codes, strict=True))
    if not any(_code_of(candidate.for_size((width, height)), axis).offset for axis in (0, 1)):
        return width, height
    x, y = (code.cell << code.bits for code in codes)
    return 2 * width - x, 2 * height - y
