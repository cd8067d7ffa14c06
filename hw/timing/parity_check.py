"""Pictures of black and white that have no inverses are proven by one more that is shown before them, their parity: lit
where an odd number of them is. So every place is lit by an even number of all these together.

Where a frame shows another picture altogether, half of all places are not. Of a share of the picture before or after it
the edges show: a bit is the same on both sides of nearly every edge of another one, and so is its frame, whatever light
bounces, for that changes but slowly from place to place.
"""

from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from calib.numerics import Floats, Image, median, robust_sigma

_CERTAIN = 0.2  # this far from halfway between black and white, neither noise nor bounced light makes one of the other
_LEAST_CERTAIN = 0.1  # of all pixels; blurred stripes leave fewer between their edges
_EDGE = 0.25  # such a difference between neighbours, of black and white, is no noise
_LIT = 128


@dataclass(frozen=True)
class WithParity:
    """A series of images with those that were added; groups and numbers are of this series.

    `even`: groups of which every place is lit by an even number; the first of each is the `added` one.
    """

    images: Iterator[Image]
    level: tuple[tuple[int, ...], ...]
    even: tuple[tuple[int, ...], ...]

    @property
    def added(self) -> frozenset[int]:
        """The numbers of the pictures that nobody asked for."""
        return frozenset(group[0] for group in self.even)


def with_parity(
    images: Iterable[Image], level: Iterable[Sequence[int]], unpaired: Collection[Sequence[int]]
) -> WithParity:
    """The same images, read when they are wanted, and before the first of each `unpaired` group its parity."""
    firsts = sorted(min(group) for group in unpaired)

    def moved(number: int) -> int:
        return number + sum(first <= number for first in firsts)

    even = tuple((moved(min(group)) - 1, *map(moved, sorted(group))) for group in unpaired)
    groups = {min(group): group for group in unpaired}
    return WithParity(_with_parity(iter(images), groups), tuple(tuple(map(moved, group)) for group in level), even)


def _with_parity(images: Iterator[Image], groups: Mapping[int, Sequence[int]]) -> Iterator[Image]:
    """`groups` by their first numbers."""
    read: deque[Image] = deque()  # from the next one on
    number = 0
    while True:
        last = max(groups.get(number, (number,)))
        while len(read) <= last - number and (image := next(images, None)) is not None:
            read.append(image)
        if not read:
            return
        if number in groups:
            yield _parity([read[each - number] for each in groups[number] if each - number < len(read)])
        yield read.popleft()
        number += 1


def _parity(images: Sequence[Image]) -> Image:
    """Of pictures of black and white."""
    odd = reduce(np.logical_xor, (image >= _LIT for image in images))
    return np.where(odd, np.uint8(255), np.uint8(0))


def odd_share(group: Sequence[int], seen: Mapping[int, Floats]) -> float:
    """At which share of all places that are certain in all frames of an even group an odd number of them is lit; 1 if
    too few are certain. `seen`: brightness (N,) of each frame, 0 for black and 1 for white.
    """
    frames = np.stack([seen[number] for number in group])
    certain = np.all(np.abs(frames - 0.5) > _CERTAIN, axis=0)
    if certain.mean() < _LEAST_CERTAIN:
        return 1.0
    lit = np.count_nonzero(frames[:, certain] > 0.5, axis=0)
    return float(np.mean(lit % 2))


def mixed_share(frame: Floats, others: Sequence[Floats], tolerance: float) -> float | None:
    """The largest share of another picture in the frame of a picture of black and white; None if that cannot be told
    by the tolerance: of a picture without edges nothing can.

    `frame` and those of the `others` (2 M,) are brightness at M places, then at a place near each. Where a frame is on
    the same side of halfway at both, its own picture has no edge. The median over the edges of another one, for some of
    them are where the scene has its own.
    """
    first, second = np.split(frame > 0.5, 2)
    flat = first == second
    own, shares = _across(frame), [0.0] if others else []
    for other in others:
        step = _across(other)
        edges = flat & (np.abs(step) > _EDGE)
        found = own[edges] / step[edges]
        if not len(found):
            return None
        share = median(found)
        if robust_sigma(found - share) * np.sqrt(np.pi / 2 / len(found)) > tolerance / 2:  # of the median
            return None
        shares.append(share)
    return max(shares, default=None)


def _across(frame: Floats) -> Floats:
    """Differences (M,) from place to place."""
    first, second = np.split(frame, 2)
    difference: Floats = first - second
    return difference
