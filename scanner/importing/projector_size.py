"""How large the projector is, from the codes that the camera saw.

It is one that projectors have, if one of these fits; of several the one whose rim was seen. Any other has to be seen to
end, inside the camera's image and straight: all rows at the same column.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.geometry import Matches
from calib.numerics import Bools, Floats
from scanner.importing.layout import Candidate, Given, Size
from scanner.patterns import Axis, Gray, Pattern

# Sizes of projectors on the market, and of the light engines of scanners.
_COMMON: tuple[Size, ...] = (
    (608, 684), (640, 360), (640, 480), (800, 480), (800, 600), (848, 480), (854, 480), (912, 1140), (960, 540),
    (1024, 600), (1024, 768), (1280, 720), (1280, 768), (1280, 800), (1280, 1024), (1366, 768), (1400, 1050),
    (1440, 900), (1600, 900), (1600, 1200), (1680, 1050), (1920, 1080), (1920, 1200), (2048, 1080), (2048, 1536),
    (2560, 1440), (2560, 1600), (3840, 2160), (4096, 2160),
)  # fmt: skip
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
class SizeFound:
    """`size` is possible; `reached`: how many ends of its codes in x and in y were seen; `usual`: it is sold."""

    size: Size
    reached: tuple[int, int]
    usual: bool = True

    @property
    def total(self) -> int:
        """The number of all ends."""
        return sum(self.reached)


def find_sizes(candidate: Candidate, extents: Sequence[Extent], given: Given) -> list[SizeFound]:
    """Sizes that the projector may have by the codes in x and y: the most likely, or all that are equally so."""
    possible = [found for size in _COMMON if (found := _fit(candidate, size, extents, given))]
    if not possible and all(each.ends for each in extents) and not _shows_any_scale(candidate):
        found = _fit(candidate, _measured(candidate, extents), extents, given)
        possible = [replace(found, usual=False)] if found else []
    most = max((found.total for found in possible), default=0)
    best = [found for found in possible if found.total == most]
    # A projector with half as many pixels may show the same; measured in its pixels, everything is consistent.
    return best[:1] if best and all(best[0].reached) else best


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


def _fit(candidate: Candidate, size: Size, extents: Sequence[Extent], given: Given) -> SizeFound | None:
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
    return SizeFound(size, (reached[0], reached[1]))


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
