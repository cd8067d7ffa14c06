"""Frame verification of binary pictures without inverses, by a parity picture.

The parity picture is lit where an odd number of the others is. Every place is then lit by an even number of all.

If a frame shows another picture altogether, the parity is wrong at half of all places. A smaller share of the previous
or next picture shows at that picture's edges: a bit rarely has an edge in the same place, and indirect light varies
slowly.
"""

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from calib.numerics import Floats, Image, median, robust_sigma
from hw.rig import Redundancy

_CERTAIN = 0.2  # distance from half-way between black and white that noise and indirect light do not exceed
_LEAST_CERTAIN = 0.1  # of all pixels; blurred stripes leave fewer between their edges
_EDGE = 0.25  # a difference between neighbours that is an edge, relative to white
_LIT = 128


@dataclass(frozen=True)
class WithParity:
    """A series of images with parity pictures inserted; groups and numbers refer to this series.

    `even`: groups of which an even number of images lights every place; the first of each is its parity picture.
    """

    images: Iterator[Image]
    level: tuple[tuple[int, ...], ...]
    even: tuple[tuple[int, ...], ...]

    @property
    def added(self) -> frozenset[int]:
        """The numbers of the parity pictures."""
        return frozenset(group[0] for group in self.even)


def with_parity(images: Iterable[Image], redundancy: Redundancy) -> WithParity:
    """Insert the parity picture of each unpaired group before its first image; images are read on demand."""
    firsts = sorted(min(group) for group in redundancy.unpaired)

    def moved(number: int) -> int:
        return number + sum(first <= number for first in firsts)

    even = tuple((moved(min(group)) - 1, *map(moved, sorted(group))) for group in redundancy.unpaired)
    level = tuple(tuple(map(moved, group)) for group in redundancy.level)
    groups = {min(group): group for group in redundancy.unpaired}
    return WithParity(_with_parity(iter(images), groups), level, even)


def _with_parity(images: Iterator[Image], groups: Mapping[int, Sequence[int]]) -> Iterator[Image]:
    """The images with parity pictures; `groups` by their first numbers."""
    read: deque[Image] = deque()  # from the next one on
    number = 0
    while True:
        last = max(groups.get(number, (number,)))
        while len(read) <= last - number and (image := next(images, None)) is not None:
            read.append(image)
        if not read:
            return
        if number in groups:
            yield _parity([read[picture - number] for picture in groups[number] if picture - number < len(read)])
        yield read.popleft()
        number += 1


def _parity(images: Sequence[Image]) -> Image:
    """The parity picture of binary images (H, W)."""
    odd = reduce(np.logical_xor, (image >= _LIT for image in images))
    return np.where(odd, np.uint8(255), np.uint8(0))


def odd_share(group: Sequence[int], levels: Mapping[int, Floats]) -> float:
    """The share of places with wrong parity, among those that are certain in all frames of an even group; 1 if too few
    are certain. `levels`: brightness (N,) of each frame, 0 for black and 1 for white.
    """
    frames = np.stack([levels[number] for number in group])
    certain = np.all(np.abs(frames - 0.5) > _CERTAIN, axis=0)
    if certain.mean() < _LEAST_CERTAIN:
        return 1.0
    lit = np.count_nonzero(frames[:, certain] > 0.5, axis=0)
    return float(np.mean(lit % 2))


def mixed_share(frame: Floats, neighbours: Sequence[Floats], tolerance: float) -> float | None:
    """The largest share of another picture in the frame of a binary picture; None if it is not known to the tolerance,
    as where the other picture has no edges.

    `frame` and `others` (2 M,): brightness at M places, then at a neighbour of each. A frame that is on the same side
    of one half at both has no edge of its own there. The share is the median over the edges of the other picture,
    because the scene has edges as well.
    """
    first, second = np.split(frame > 0.5, 2)
    flat = first == second
    own, shares = _across(frame), [0.0] if neighbours else []
    for neighbour in neighbours:
        step = _across(neighbour)
        edges = flat & (np.abs(step) > _EDGE)
        measured = own[edges] / step[edges]
        if not len(measured):
            return None
        share = median(measured)
        if robust_sigma(measured - share) * np.sqrt(np.pi / 2 / len(measured)) > tolerance / 2:  # of the median
            return None
        shares.append(share)
    return max(shares, default=None)


def _across(frame: Floats) -> Floats:
    """Differences (M,) between neighbours."""
    first, second = np.split(frame, 2)
    return first - second
