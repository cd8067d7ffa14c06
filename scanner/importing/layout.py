"""A layout: an order of frames, as a function of the projector's size."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from itertools import compress, product
from pathlib import Path
from typing import Literal

from scanner.importing.frame_files import FrameFiles
from scanner.patterns import Axis, Black, Gray, Pattern, Phase, White, count_bits

Size = tuple[int, int]
_CELLS = (1, 2, 4)  # pixels in a cell of a Gray code, as programs offer them
_BITS = range(4, 14)
# A longer series is no capture and not read: four fringes of both axes in eight steps, white and black, and one
# duplicate.
MOST_FRAMES = 4 * 2 * 8 + 3
_MOST_APART = 4  # largest difference of the bits of the two axes


@dataclass(frozen=True)
class Given:
    """What is known of a capture beside its frames; None if it is not."""

    projector_size: Size | None = None
    """(width, height)"""
    cell: int | None = None
    """Length of a Gray code's cell in pixels."""
    codes: Size | None = None
    """Number of codes in x and in y."""
    periods: tuple[float, ...] | None = None
    """Numbers of fringe periods across the picture."""

    @property
    def cells(self) -> tuple[int, ...]:
        """The lengths that a cell may have."""
        return (self.cell,) if self.cell else _CELLS

    def or_else(self, other: "Given") -> "Given":
        """Fill unknown values from the other."""
        values = ((getattr(self, field.name) or getattr(other, field.name)) for field in fields(self))
        return Given(*values)


Need = Literal["projector_size", "cell", "periods"]
# The patterns for a projector size, cells of this many pixels, and a number of frames.
SequenceOf = Callable[[Size, int, int], tuple[Pattern, ...]]


@dataclass(frozen=True)
class FrameLayout:
    """The order of frames of a program."""

    name: str
    title: str
    source: str
    """Where it is documented."""
    sequences: tuple[SequenceOf, ...] = ()
    """Of each variant."""
    needs: tuple[Need, ...] = ()
    """Fields of `Given` that the frames cannot determine."""
    settings: Callable[[Path], Given] = lambda _: Given()
    """Values from a file beside the frames."""
    names: Callable[[tuple[Path, ...]], tuple[Pattern, ...]] | None = None
    """The patterns, from the names of the frames."""
    last: bool = False
    """Tried if no other fits."""
    any_size: Size | None = None
    """A placeholder size, if only the lengths of periods and cells depend on it."""

    def lacks(self, given: Given) -> bool:
        """Whether something is needed that is not given."""
        return any(getattr(given, name) is None for name in self.needs)


@dataclass(frozen=True)
class Candidate:
    """An order that the frames may have."""

    files: tuple[Path, ...]
    patterns: tuple[Pattern, ...]
    """The pattern of each file, on a projector of `projector_size`."""
    projector_size: Size
    """The projector's size if it is known, else the least that has all codes."""
    size_known: bool
    for_size: Callable[[Size, int], tuple[Pattern, ...]]
    """The order on another projector, with cells of another length."""

    def on(self, size: Size, cell: int) -> list[tuple[Pattern, ...]]:
        """The same bits on a projector of this size, with cells of this length: those that the order has there, or as
        many along the shorter axis as along the longer one. Empty if there are none.
        """
        padded = tuple(replace(p, cell=cell, offset=0) if isinstance(p, Gray) else p for p in self.patterns)
        bits = count_bits(max(size), cell)
        is_padded = all(p.bits == bits for p in padded if isinstance(p, Gray))
        kind = _unsized(self.patterns)
        possible = dict.fromkeys([self.for_size(size, cell), *([padded] if is_padded else [])])
        return [patterns for patterns in possible if _unsized(patterns) == kind]

    def without_finest(self, counts: Mapping[Axis, int]) -> "Candidate":
        """The same without some of the finest bits of each axis, and longer cells instead."""

        def is_kept(pattern: Pattern) -> bool:
            return not isinstance(pattern, Gray) or pattern.bit < pattern.bits - counts.get(pattern.axis, 0)

        def coarser(patterns: Sequence[Pattern]) -> tuple[Pattern, ...]:
            return tuple(_coarser(p, counts) for p in patterns if is_kept(p))

        kept = map(is_kept, self.patterns)
        return replace(
            self,
            files=tuple(compress(self.files, kept)),
            patterns=coarser(self.patterns),
            for_size=lambda size, cell: coarser(self.for_size(size, cell)),
        )


def _coarser(pattern: Pattern, counts: Mapping[Axis, int]) -> Pattern:
    if not isinstance(pattern, Gray) or not counts.get(pattern.axis):
        return pattern
    count = counts[pattern.axis]
    return replace(pattern, bits=pattern.bits - count, cell=pattern.cell * 2**count)


def candidates(
    layout: FrameLayout, files: FrameFiles, given: Given, missing: tuple[Pattern, ...] = ()
) -> Iterator[Candidate]:
    """All variants of a layout for this number of frames, if the `missing` patterns were not taken.

    Codes alone tell the projector's size, fringes need it.
    """
    if layout.names is not None and not missing:
        yield from _by_name(layout.names(files.numbered), files)
    paths, cell = _paths(files), given.cell or 1
    count = len(files.numbered) + len(missing)
    known = given.projector_size if layout.needs and not layout.lacks(given) else None
    sizes = [known] if known else [layout.any_size] if layout.any_size else _sizes(cell)
    kinds: set[tuple[Pattern, ...]] = set()
    for sequence, size in product(layout.sequences, sizes):

        def for_size(size: Size, cell: int, sequence: SequenceOf = sequence) -> tuple[Pattern, ...]:
            return _beside(files, sequence(size, cell, count), missing)

        patterns = for_size(size, cell)
        if len(patterns) != len(paths):
            continue
        kind = patterns if known else _unsized(patterns)
        if kind in kinds:
            continue
        kinds.add(kind)
        yield Candidate(paths, patterns, size, known is not None, for_size)


def _by_name(patterns: tuple[Pattern, ...], files: FrameFiles) -> Iterator[Candidate]:
    if patterns:
        bits = {p.axis: p.bits for p in patterns if isinstance(p, Gray)}

        def for_size(size: Size, cell: int) -> tuple[Pattern, ...]:
            del size
            return _beside(files, tuple(replace(p, cell=cell) if isinstance(p, Gray) else p for p in patterns))

        size = 1 << bits.get("x", 0), 1 << bits.get("y", 0)
        yield Candidate(_paths(files), for_size(size, 1), size, False, for_size)


def _unsized(patterns: Sequence[Pattern]) -> tuple[Pattern, ...]:
    """The parts of patterns that do not depend on the projector's size; Gray codes differ by their number of bits
    only.
    """
    return tuple(_without_size(pattern) for pattern in patterns)


@cache  # thousands of orders have the same patterns
def _without_size(pattern: Pattern) -> Pattern:
    match pattern:
        case Gray():
            return replace(pattern, cell=1, offset=0)
        case Phase():
            return replace(pattern, period=1.0)
    return pattern


def _beside(files: FrameFiles, patterns: tuple[Pattern, ...], missing: tuple[Pattern, ...] = ()) -> tuple[Pattern, ...]:
    """White and black at the end, if they are separate files; without the patterns that are `missing`."""
    own = tuple(p for p, path in ((White(), files.white), (Black(), files.black)) if path)
    elsewhere = (*own, *missing)  # usually none: thousands of sequences need not be compared
    return (*(p for p in patterns if p not in elsewhere), *own) if elsewhere else patterns


def _paths(files: FrameFiles) -> tuple[Path, ...]:
    return (*files.numbered, *(path for path in (files.white, files.black) if path))


def _sizes(cell: int) -> list[Size]:
    """Powers of two: for each number of bits the largest projector that they suffice for; squares first."""
    bits = sorted(product(_BITS, _BITS), key=lambda xy: (abs(xy[0] - xy[1]), xy))
    return [(cell << x, cell << y) for x, y in bits if abs(x - y) <= _MOST_APART]
