"""Frame verification by what pictures say twice: complementary sums, and a parity picture.

Some pictures sum to uniform light, such as a picture and its inverse. If all frames show their pictures, their sum is
level. A frame that contains a share of the previous or next picture, or shows another one altogether, leaves the
difference between the two in that sum.

Binary pictures without inverses have a parity picture, which is lit where an odd number of the others is. Every place
is then lit by an even number of all. If a frame shows another picture altogether, the parity is wrong at half of all
places. A smaller share of the previous or next picture shows at that picture's edges: a bit rarely has an edge in the
same place, and indirect light varies slowly.
"""

from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from calib.numerics import Floats, Image, median, robust_sigma
from hw.rig import Redundancy

_MOST_PAIRS = 10_000
_APART = 75  # pixels of a pair are 2 px to max(3 px, width / 75) apart
_LEAST_TOLERANCE = 0.015
_MOST_TERMS = 10  # differences between successive pictures, times frames in the sum, of two or four frames
_LEAST_DIFFERENCE = 0.15  # rms of a difference between pictures; below it there is only noise

_ALIKE = 0.2  # relative singular value below which differences count as linearly dependent
# Limits of the rms and of the mean brightness of a sum. Lenses and interreflection cause an rms of 0.1 in correct sums,
# wrong pictures 0.5. The mean brightness of a pair is 0.5, that of fine stripes and fringes down to 0.35, by the
# projector's response.
_UNEVEN, _DARKEST, _BRIGHTEST = 0.35, 0.2, 0.7
_CROSSED = 0.1  # error of a correlation of steps; correct ones reach 0.03 where the camera sees few periods
_CERTAIN = 0.2  # distance from half-way between black and white that noise and indirect light do not exceed
_LEAST_CERTAIN = 0.1  # of all pixels; blurred stripes leave fewer between their edges
_EDGE = 0.25  # a difference between neighbours that is an edge, relative to white
_LIT = 128


@dataclass(frozen=True)
class ComplementarySums:
    """Verifies frames at N lit pixels; `dark` (N,) is the level of black, `contrast` (N,) that of white minus black.

    The pixels form pairs: each of the second half is near its counterpart in the first.

    `tolerance`: the largest share of another picture that cannot be distinguished from noise. `variance`: of the
    noise relative to the contrast, the mean of black and white.
    """

    pixels: tuple[np.ndarray, np.ndarray]
    dark: Floats
    contrast: Floats
    tolerance: float
    variance: float

    def brightness(self, image: Image) -> Floats:
        """Normalised brightness (N,) of a frame: 0 for black, 1 for white."""
        return (_grey(image[self.pixels]) - self.dark) / self.contrast

    def foreign_share(
        self,
        group: Sequence[int],
        pictures: Sequence[Image],
        brightness: Mapping[int, Floats],
        neighbours: Mapping[int, Collection[int]],
    ) -> float:
        """The approximate share of other pictures in the frames of a group that should sum to uniform light.

        `group`: frame numbers, steps of a fringe in order. `brightness`: of these frames, and of the pictures on
        the wall just before and after each, whose numbers are in `neighbours`.

        The share is the part of the sum that the differences between successive pictures explain. It is 1 if the sum is
        far from level or from its expected brightness: a picture that stayed too long leaves no difference. The
        brightness of uniform pictures is checked directly.
        """
        plain = [
            abs(float(brightness[number].mean()) - picture[0, 0] / 255)
            for number, picture in zip(group, pictures, strict=True)
            if _is_plain(picture)
        ]
        total = np.sum([brightness[number] for number in group], axis=0)
        if total.std() > _UNEVEN or not _DARKEST < total.mean() / len(group) < _BRIGHTEST:
            return 1.0
        crossed = _crossed_share([brightness[number] for number in group])
        return float(max([self._share(group, brightness, neighbours, total), crossed, *plain]))

    def changed_share(
        self,
        group: Sequence[int],
        pictures: Sequence[Image],
        before: Mapping[int, Floats],
        brightness: Mapping[int, Floats],
        neighbours: Mapping[int, Collection[int]],
    ) -> float:
        """The approximate share by which repeated frames differ from the first ones.

        Deviations caused by the scene repeat; light of another picture does not. `neighbours`: the pictures on the wall
        before and after each frame, at either time. Uniform pictures are compared by brightness.
        """
        shares = []
        for number, picture in zip(group, pictures, strict=True):
            change = brightness[number] - before[number]
            shares += [self._share((number,), brightness, neighbours, change)]
            shares += [abs(float(change.mean()))] if _is_plain(picture) else []
        return max(shares)

    def _share(
        self,
        group: Sequence[int],
        brightness: Mapping[int, Floats],
        neighbours: Mapping[int, Collection[int]],
        values: Floats,
    ) -> float:
        """The largest share of a difference between successive pictures that `values` (N,) contain.

        Each difference is fitted alone, because a faint one (a fine fringe after a coarse one) would seem small beside
        the largest. All together are fitted by least squares, for shares of several. The covariance of the noise
        that values and differences have in common is subtracted.
        """
        changes = sorted(
            {(min(number, neighbour), max(number, neighbour)) for number in group for neighbour in neighbours[number]}
        )
        changes = [(of, to) for of, to in changes if of in brightness and to in brightness]
        if not changes:
            return 0.0
        steps = np.stack([brightness[to] - brightness[of] for of, to in changes])
        steps -= steps.mean(axis=1, keepdims=True)
        sizes = steps.std(axis=1)
        significant = sizes > _LEAST_DIFFERENCE
        if not significant.any():
            return 0.0
        values = values - values.mean()
        noise = self.variance * np.array([(to in group) - (of in group) for of, to in changes])
        single = np.abs(steps @ values / values.size - noise)[significant] / sizes[significant] ** 2
        return float(max(single.max(), _explained(steps[significant], values).std() / sizes.max()))


def _is_plain(picture: Image) -> bool:
    """Whether a picture is uniform."""
    return bool(picture.min() == picture.max())


def _crossed_share(steps: Sequence[Floats]) -> float:
    """The share of other pictures that cancels in the sum of a fringe's steps: two steps half a period apart that
    contain the same share of pictures half a period apart.

    Differences of opposite steps correlate as the cosine of the phase between them; such a share disturbs that. Needs
    an even number of steps (N,), otherwise 0.
    """
    half = len(steps) // 2
    if half < 2 or len(steps) % 2:
        return 0.0
    differences = np.stack(steps[:half]) - np.stack(steps[half:])
    differences -= differences.mean(axis=1, keepdims=True)
    products = differences @ differences.T
    expected = np.cos(np.pi / half * np.subtract.outer(np.arange(half), np.arange(half)))
    off = np.abs(products / products.max() - expected)[np.triu_indices(half, 1)].max()
    return float(off) if off > _CROSSED else 0.0


def _explained(terms: Floats, values: Floats) -> Floats:
    """The part of values (N,) that terms (T, N) explain, by least squares (normal equations). Directions of nearly
    dependent terms are left out.
    """
    squares, directions = np.linalg.eigh(terms @ terms.T)
    kept = squares > _ALIKE**2 * squares[-1]
    along = (terms @ values) @ directions[:, kept] / squares[kept]
    levels: Floats = (directions[:, kept] @ along) @ terms
    return levels


def complementary_sums(
    dark: Sequence[Image], bright: Sequence[Image], lit: np.ndarray, tolerance: float
) -> ComplementarySums:
    """Made from frames of black and of white at rest; `lit` (H, W): pixels that distinguish them."""
    pixels = _pairs(lit)
    levels = [np.stack([_grey(image[pixels]) for image in images]) for images in (dark, bright)]
    contrast = levels[1].mean(axis=0) - levels[0].mean(axis=0)
    # The noise of a frame is also in its differences to others, and correlates with them by chance.
    variances = [float(np.mean(np.diff(frames, axis=0) ** 2 / 2 / contrast**2)) for frames in levels]
    by_chance = 6 * np.sqrt(_MOST_TERMS * variances[1] / len(pixels[0]))
    tolerance = max(_LEAST_TOLERANCE, tolerance) + float(4 * variances[1] + by_chance)
    return ComplementarySums(pixels, levels[0].mean(axis=0), contrast, tolerance, float(np.mean(variances)))


def _pairs(lit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of random lit pixels (H, W), then of a lit pixel near each, in any direction."""
    rng = np.random.default_rng(0)
    rows, columns = np.nonzero(lit)
    chosen = rng.permutation(len(rows))[:_MOST_PAIRS]
    first = np.stack([rows[chosen], columns[chosen]])
    angle = 2 * np.pi * rng.random(len(chosen))
    apart = rng.uniform(2, max(3.0, lit.shape[1] / _APART), len(chosen))
    second = first + np.rint(apart * np.stack([np.sin(angle), np.cos(angle)])).astype(np.int64)
    inside = np.all((second >= 0) & (second < np.array(lit.shape)[:, None]), axis=0)
    inside[inside] = lit[tuple(second[:, inside])]
    if not inside.any():  # hardly any lit pixels: use each twice
        return np.tile(first[0], 2), np.tile(first[1], 2)
    pairs = np.concatenate([first[:, inside], second[:, inside]], axis=1)
    return pairs[0], pairs[1]


def _grey(pixels: Image) -> Floats:
    """Brightness (N,) of pixels (N,) or, of colour cameras, (N, 3)."""
    return pixels.mean(axis=1) if pixels.ndim == 2 else pixels.astype(np.float64)


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
