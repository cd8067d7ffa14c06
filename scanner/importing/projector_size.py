"""How large the projector is, from the codes that the camera saw.

It is a usual size whose codes are those seen; of several, one whose rim was seen. Cells of one projector pixel, two or
four show the same frames on projectors of different sizes: the smallest is taken if it is often met and the larger
ones need longer cells or are seldom met; otherwise all are returned. Any other size has to be seen to end, inside the
camera's image and straight: all rows at the same column.

Describe an order of patterns in words that distinguish it from other orders.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby, product

import numpy as np

from calib.geometry import Matches
from calib.numerics import Bools, Floats
from scanner.importing.layout import Candidate, Given, Size
from scanner.patterns import Axis, Black, Gray, Pattern, Phase, White

_MOST_RUNS = 4  # of patterns along one axis: the fringes, then the codes
# Sizes of projectors on the market, and of the light engines of scanners; and those that are seldom met.
_OFTEN: tuple[Size, ...] = (
    (608, 684), (640, 480), (800, 600), (848, 480), (854, 480), (912, 1140), (1024, 768), (1280, 720), (1280, 768),
    (1280, 800), (1280, 1024), (1366, 768), (1400, 1050), (1440, 900), (1600, 900), (1680, 1050), (1920, 1080),
    (1920, 1200), (3840, 2160),
)  # fmt: skip
_SELDOM: tuple[Size, ...] = (
    (640, 360), (800, 480), (960, 540), (1024, 600), (1600, 1200), (2048, 1080), (2048, 1536), (2560, 1440),
    (2560, 1600), (4096, 2160),
)  # fmt: skip
# Of these, arrays of mirrors that stand on a corner: twice as many columns to a length as rows.
DIAMOND_ARRAYS: tuple[Size, ...] = ((608, 684), (912, 1140))
_STRIPES = 24
_FEWEST_IN_STRIPE = 5
_MOST_STRAY = 0.0005
_LEAST_STRAIGHT = 0.6
_BORDER = 0.02  # share of the camera's image
_SLACK = 2  # partly visible cells at the rim are dropped


def describe_order(patterns: Sequence[Pattern]) -> str:
    """Axes, which bit is first, where inverses are, and where white and black are."""
    bits = [pattern for pattern in patterns if isinstance(pattern, Gray)]
    axes = [axis for axis, _ in groupby(p.axis for p in patterns if isinstance(p, Gray | Phase))]
    by_turns = len(axes) > _MOST_RUNS
    parts = [" and ".join(axes[:2]) + " by turns" if by_turns else ", then ".join(dict.fromkeys(axes))]
    fringes = dict.fromkeys(p.period for p in patterns if isinstance(p, Phase))
    if bits:
        first, second = [p for p in bits if p.axis == bits[0].axis and p.inverted == bits[0].inverted][:2]
        parts += [] if all(bit.cell == 1 for bit in bits) else [describe_cells(bits)]
        parts += ["codes counted from the middle"] if any(bit.offset for bit in bits) and not fringes else []
        parts += ["coarsest bit first" if first.bit < second.bit else "finest bit first", _inverses(bits)]
    if fringes:
        shifts = [p.shift for p in patterns if isinstance(p, Phase)]
        shifted = f"shifted from {shifts[0] % 1:.2g} cycles {'on' if shifts[1] > shifts[0] else 'back'}"
        parts.append(f"fringes of {', '.join(f'{period:.4g}' for period in fringes)} px, {shifted}")
    return "; ".join([*parts, *_ends(patterns)])


def describe_cells(patterns: Sequence[Pattern]) -> str:
    """The lengths of the cells of Gray codes."""
    lengths = dict.fromkeys(f"{p.cell:g}" for p in patterns if isinstance(p, Gray))
    return f"cells of {' and '.join(lengths)} px"


def _inverses(bits: Sequence[Gray]) -> str:
    inverted = [bit.inverted for bit in bits]
    if not any(inverted):
        return "no inverses"
    runs = len([*groupby(inverted)])
    if runs == len(bits):
        return "each bit's inverse after it"
    return "inverses last" if runs == 2 else "inverses after the bits of each axis"


def _ends(patterns: Sequence[Pattern]) -> list[str]:
    names = {White(): "white", Black(): "black"}
    at = [number for number, pattern in enumerate(patterns) if pattern in names]
    if not at:
        return ["no white or black"]
    names_in_order = ", ".join(names[patterns[number]] for number in at)
    return [f"{names_in_order} {'first' if at[0] == 0 else 'last'}"]


@dataclass(frozen=True)
class Extent:
    """The smallest and the largest code along an axis that the camera saw."""

    low: int
    high: int
    begins: bool
    """Whether the picture begins at the smallest: inside the camera's image and straight."""
    ends: bool
    """Whether it ends so at the largest."""

    def allows(self, first: int, last: int) -> bool:
        """Whether codes from `first` to `last` may have been shown."""
        return first - _SLACK <= self.low and self.high <= last + _SLACK

    def contradicts(self, first: int, last: int) -> bool:
        """Whether the picture is seen to begin or to end inside codes from `first` to `last`."""
        return (self.begins and self.low - first > _SLACK) or (self.ends and last - self.high > _SLACK)

    def reaches(self, first: int, last: int, *, straight: bool = False) -> int:
        """Count the observed ends that depend on the projector's size, or only the straight ones."""
        begins = first > 0 and self.low - first <= _SLACK and (self.begins or not straight)
        return int(begins) + int(last - self.high <= _SLACK and (self.ends or not straight))


@dataclass(frozen=True)
class SizeFit:
    """A projector whose codes may be those that the camera saw."""

    size: Size
    patterns: tuple[Pattern, ...]
    """The patterns of all frames on it."""
    cell: int
    """Length of the order's cells in pixels, before any that the order itself makes longer."""
    reached: tuple[int, int]
    """How many ends of its codes were seen, in x and in y."""
    is_contradicted: bool
    """Whether the picture is seen to begin or to end inside its codes."""
    is_own: bool
    """Whether the order counts its codes from where they are counted on it."""
    is_often: bool
    """Whether such projectors are often met."""
    is_usual: bool = True
    """Whether there are such projectors at all."""

    @property
    def total(self) -> int:
        """The number of all ends."""
        return sum(self.reached)

    @property
    def reason(self) -> str:
        """Why it is among several."""
        met = "is usual" if self.is_often else "is rare" if self.is_usual else "is no usual size"
        return f"{show_size(self.size)} {met}" + (f", with cells of {self.cell} px" if self.cell > 1 else "")

    def __str__(self) -> str:
        """Describe the projector: 1280 × 720 in cells of 2 px."""
        return f"{show_size(self.size)} in {describe_cells(self.patterns)}"


def show_size(size: Size) -> str:
    """Width and height."""
    return f"{size[0]} × {size[1]}"


def find_sizes(candidate: Candidate, extents: Sequence[Extent], given: Given) -> list[SizeFit]:
    """Projectors that the codes in x and y fit best, the likeliest first."""
    sizes = [given.projector_size] if given.projector_size else [*_OFTEN, *_SELDOM]
    fits = _fits(candidate, sizes, extents, given) or _fits(candidate, sizes, extents, replace(given, cell=None))
    reached = max((fit.total for fit in fits), default=0)
    best = [fit for fit in fits if fit.total == reached]
    of_pixels = replace(given, cell=given.cell or 1)
    is_measurable = all(extent.ends for extent in extents) and not (given.projector_size or _has_any_scale(candidate))
    if is_measurable and all(fit.cell != of_pixels.cell for fit in best):
        measured = _fits(candidate, [_measured(candidate, extents, of_pixels.cells[0])], extents, of_pixels)
        best += [replace(fit, is_often=False, is_usual=False) for fit in measured]
    return sorted(best, key=lambda fit: (not fit.is_usual, not fit.is_often, fit.cell, fit.size))


def constant_axes(candidate: Candidate, extents: Sequence[Extent]) -> list[str]:
    """The axes whose two coarsest bits never change where the camera looks, as white and black taken for bits."""
    coarsest = (_code_of(candidate.patterns, axis).bits - 2 for axis in (0, 1))
    both = zip("xy", extents, coarsest, strict=True)
    return [axis for axis, extent, bits in both if bits > 0 and extent.low >> bits == extent.high >> bits]


def is_clear(fits: Sequence[SizeFit], given: Given) -> bool:
    """Whether the first of several fits can be taken without asking."""
    first = fits[0]
    if first.size == given.projector_size:
        return first.cell in given.cells
    is_plain = first.cell == (given.cell or 1)
    if len(fits) == 1:
        return is_plain or all(first.reached)
    is_least = is_plain and first.is_often and first.size == min(fit.size for fit in fits)
    return is_least and all(fit.cell > first.cell or not fit.is_often for fit in fits[1:])


def extents_of(candidate: Candidate, matches: Matches, camera_size: Size) -> tuple[Extent, Extent]:
    """Return the extents in x and in y, from a candidate's matches."""
    numbers = np.stack([_numbers(candidate.patterns, axis, matches.projector_px) for axis in (0, 1)], axis=1)
    inside = np.all(np.abs(matches.camera_px / camera_size - 0.5) < 0.5 - _BORDER, axis=1)
    x, y = (_extent(numbers[:, axis], numbers[:, 1 - axis], inside) for axis in (0, 1))
    return x, y


def _extent(values: Floats, across: Floats, inside: Bools) -> Extent:
    """Of codes (N,) along an axis, with those `across`; the picture ends only `inside` the camera's image."""
    low, high = (int(value) for value in np.quantile(values, (_MOST_STRAY, 1 - _MOST_STRAY), method="nearest"))
    stripe = np.floor((across - across.min()) / (np.ptp(across) + 1) * _STRIPES).astype(np.int64)
    groups = [np.flatnonzero(stripe == number) for number in range(_STRIPES)]
    groups = [members for members in groups if len(members) >= _FEWEST_IN_STRIPE]

    def is_straight(end: int, sign: int) -> bool:
        outermost = np.array([members[np.argmax(sign * values[members])] for members in groups], np.int64)
        straight = inside[outermost] & (np.abs(values[outermost] - end) <= _SLACK)
        return len(groups) > 0 and int(np.count_nonzero(straight)) >= _LEAST_STRAIGHT * len(groups)

    return Extent(low, high, is_straight(low, -1), is_straight(high, 1))


def _code_of(patterns: Sequence[Pattern], axis: int) -> Gray:
    """The finest Gray code along an axis, any bit of it."""
    name: Axis = "x" if axis == 0 else "y"
    return min((p for p in patterns if isinstance(p, Gray) and p.axis == name), key=lambda code: code.cell)


def _numbers(patterns: Sequence[Pattern], axis: int, projector_px: Floats) -> Floats:
    code = _code_of(patterns, axis)
    return np.floor((projector_px[:, axis] + 0.5 + code.offset) / code.cell)


def _fits(candidate: Candidate, sizes: Sequence[Size], extents: Sequence[Extent], given: Given) -> list[SizeFit]:
    """The sizes whose codes are possible, with cells of each length.

    Codes may have as many bits along the shorter axis as along the longer one. Those that the order counts from the rim
    are taken to be counted from the middle only if the picture is seen to begin or end there in both directions.
    """
    fits = dict[tuple[Size, tuple[Pattern, ...]], SizeFit]()
    for size, cell in product(sizes, given.cells):
        for patterns in candidate.on(size, cell):
            for variant, straight in ((patterns, False), (_centred(patterns, size), True)):
                fit = _fit(size, cell, variant, extents, given, straight=straight)
                if fit and (all(fit.reached) or not straight):
                    fits.setdefault((size, variant), fit)
    return [*fits.values()]


def _fit(
    size: Size,
    cell: int,
    patterns: tuple[Pattern, ...],
    extents: Sequence[Extent],
    given: Given,
    *,
    straight: bool = False,
) -> SizeFit | None:
    reached, is_contradicted = list[int](), False
    for axis, (length, extent) in enumerate(zip(size, extents, strict=True)):
        code = _code_of(patterns, axis)
        first, last = int(code.offset // code.cell), int((length - 1 + code.offset) // code.cell)
        right_count = given.codes is None or last - first + 1 == given.codes[axis]
        if last >= 1 << code.bits or not extent.allows(first, last) or not right_count:
            return None
        is_contradicted |= extent.contradicts(first, last)
        reached.append(extent.reaches(first, last, straight=straight))
    return SizeFit(size, patterns, cell, (reached[0], reached[1]), is_contradicted, not straight, size in _OFTEN)


def _centred(patterns: Sequence[Pattern], size: Size) -> tuple[Pattern, ...]:
    """The same patterns with all codes counted from the middle of the picture."""
    lengths = dict(zip("xy", size, strict=True))
    return tuple(
        replace(p, offset=((int(p.cell) << p.bits) - lengths[p.axis]) // 2) if isinstance(p, Gray) else p
        for p in patterns
    )


def _has_any_scale(candidate: Candidate) -> bool:
    """Whether a projector of twice the size would be shown as many patterns, with cells of twice the length."""
    width, height = candidate.projector_size
    return len(candidate.for_size((2 * width, 2 * height), 1)) == len(candidate.files)


def _measured(candidate: Candidate, extents: Sequence[Extent], cell: int) -> Size:
    """The size of a projector that ends where the codes do, be they counted from one side or from the middle."""
    width, height = ((extent.high + 1) * cell for extent in extents)
    if not any(_code_of(candidate.for_size((width, height), cell), axis).offset for axis in (0, 1)):
        return width, height
    x, y = (cell << _code_of(candidate.patterns, axis).bits for axis in (0, 1))
    return 2 * width - x, 2 * height - y
