"""A layout: an order of frames, as a function of the projector's size."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Literal

from scanner.importing.frame_files import FrameFiles
from scanner.patterns import Black, Gray, Pattern, Phase, White

Size = tuple[int, int]
_BITS = range(4, 14)
# A longer series is no capture and not read: four fringes of both axes in eight steps, white and black, and one
# duplicate.
MOST_FRAMES = 4 * 2 * 8 + 3
# Lengths of cells that a program may have been given, where the size of the projector is known.
_CELLS = [1, 2, 4]
_MOST_APART = 4  # largest difference of the bits of the two axes


@dataclass(frozen=True)
class Given:
    """Given values: the projector's size (width, height), the cell length of a Gray code in pixels, and the number of
    `codes` in x and in y.
    """

    projector_size: Size | None = None
    cell: int | None = None
    codes: Size | None = None

    def or_else(self, other: "Given") -> "Given":
        """Fill unknown values from the other."""
        return Given(self.projector_size or other.projector_size, self.cell or other.cell, self.codes or other.codes)


# The patterns for a projector size, cells of this many pixels, and a number of frames.
SequenceOf = Callable[[Size, int, int], tuple[Pattern, ...]]


@dataclass(frozen=True)
class FrameLayout:
    """The order of frames of a program (`name`, `title`), and where it is documented (`source`).

    `sequences`: of each variant. `needs`: fields of `Given` that the frames cannot determine. `settings`: values from a
    file beside the frames. `names`: the patterns, from the names of the frames. `last`: tried if no other fits.
    `any_size`: a placeholder size, if only the lengths of periods and cells depend on it.
    """

    name: str
    title: str
    source: str
    sequences: tuple[SequenceOf, ...] = ()
    needs: tuple[Literal["projector_size", "cell"], ...] = ()
    settings: Callable[[Path], Given] = lambda _: Given()
    names: Callable[[tuple[Path, ...]], tuple[Pattern, ...]] | None = None
    last: bool = False
    any_size: Size | None = None

    def lacks(self, given: Given) -> bool:
        """Whether something is needed that is not given."""
        return any(getattr(given, name) is None for name in self.needs)


@dataclass(frozen=True)
class Candidate:
    """Patterns that may belong to the `files`, one for each.

    `size_known`: whether `projector_size` is the projector's, or only the least that has all codes. `for_size`: the
    same for another projector.
    """

    files: tuple[Path, ...]
    patterns: tuple[Pattern, ...]
    projector_size: Size
    size_known: bool
    for_size: Callable[[Size], tuple[Pattern, ...]]


def candidates(
    layout: FrameLayout, files: FrameFiles, given: Given, missing: tuple[Pattern, ...] = ()
) -> Iterator[Candidate]:
    """All variants of a layout for this number of frames, if the `missing` patterns were not taken."""
    if layout.names is not None and not missing:
        yield from _by_name(layout.names(files.numbered), files, given)
    known = given.projector_size is not None and not layout.lacks(given)
    cells = [given.cell] if given.cell else _CELLS if known else [1]
    sizes = [given.projector_size] if given.projector_size and known else _sizes(cells[0])
    sizes = [layout.any_size] if layout.any_size and not known else sizes
    tried: set[tuple[Pattern, ...]] = set()
    for cell, sequence, size in product(cells, layout.sequences, sizes):
        if tried and cell != cells[0]:
            return  # a code of single pixels is what programs project

        def for_size(size: Size, sequence: SequenceOf = sequence, cell: int = cell) -> tuple[Pattern, ...]:
            return _beside(files, sequence(size, cell, len(files.numbered) + len(missing)), missing)

        paths, patterns = _paths(files), for_size(size)
        if len(patterns) != len(paths) or (
            cell != cells[0] and any(isinstance(pattern, Phase) for pattern in patterns)
        ):
            continue
        kind = patterns if known else tuple(map(_unsized, patterns))
        if kind not in tried:
            tried.add(kind)
            yield Candidate(paths, patterns, size, known, for_size)


def _by_name(patterns: tuple[Pattern, ...], files: FrameFiles, given: Given) -> Iterator[Candidate]:
    if patterns:
        whole = _beside(files, patterns)
        bits = {p.axis: p.bits for p in patterns if isinstance(p, Gray)}
        size = given.projector_size or (1 << bits.get("x", 0), 1 << bits.get("y", 0))
        yield Candidate(_paths(files), whole, size, given.projector_size is not None, lambda _: whole)


def _unsized(pattern: Pattern) -> Pattern:
    """The parts of a pattern that do not depend on the projector's size; Gray codes differ by their number of bits
    only.
    """
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
