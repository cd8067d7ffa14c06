"""The projector's size and its cells, from the codes that a camera saw."""

from collections.abc import Iterator
from itertools import product
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanner.importing import LAYOUTS, FrameFiles, Given
from scanner.importing.layout import Candidate, Size, candidates
from scanner.importing.projector_size import Extent, SizeFit, find_sizes, is_clear
from scanner.patterns import Gray, Pattern, count_bits

BY_NAME = {layout.name: layout for layout in LAYOUTS}
MARKET = [(640, 360), (640, 480), (800, 600), (848, 480), (960, 540), (1024, 768), (1280, 720), (1280, 800)]
MARKET += [(1400, 1050), (1920, 1080), (1920, 1200), (2560, 1440), (3840, 2160)]


def candidate_of(name: str, size: Size, cell: int) -> Candidate:
    """The order of frames that a program leaves with cells of this length."""
    pairs = sum(count_bits(length, cell) for length in size)
    count = 2 * pairs + 2 if name != "moreno-taubin" else 42  # its ten bits an axis
    files = FrameFiles(Path(), tuple(Path(f"{number}.png") for number in range(count)))
    wanted = {axis: count_bits(length, cell) for axis, length in zip("xy", size, strict=True)}
    if name == "moreno-taubin":
        wanted = {"x": 10, "y": 10}
    possible = candidates(BY_NAME[name], files, Given())
    return next(c for c in possible if all(p.bits == wanted[p.axis] for p in c.patterns if isinstance(p, Gray)))


def codes_of(patterns: tuple[Pattern, ...], size: Size) -> Iterator[tuple[int, int]]:
    for axis, length in zip("xy", size, strict=True):
        code = next(p for p in patterns if isinstance(p, Gray) and p.axis == axis)
        yield int(code.offset // code.cell), int((length - 1 + code.offset) // code.cell)


def extents_of(patterns: tuple[Pattern, ...], size: Size, lost: int = 0) -> tuple[Extent, Extent]:
    """What a camera sees that sees the left and the lower end, but for some `lost` codes."""
    (left, right), (top, bottom) = codes_of(patterns, size)
    x = Extent(left + lost, right - (right - left) // 10, begins=True, ends=False)
    return x, Extent(top + (bottom - top) // 5, bottom - lost, begins=False, ends=True)


def fitting(name: str, size: Size, cell: int, known: Given, lost: int = 0) -> tuple[list[SizeFit], tuple[Pattern, ...]]:
    candidate = candidate_of(name, size, cell)
    true = candidate.on(size, cell)[0]
    return find_sizes(candidate, extents_of(true, size, lost), known), true


@pytest.mark.parametrize("name", ["opencv", "3dunderworld", "moreno-taubin"])
@pytest.mark.parametrize(("size", "cell"), [*product(MARKET, (1, 2, 4))])
def test_the_true_projector_is_taken_or_among_those_to_choose_from(name: str, size: Size, cell: int) -> None:
    """Nothing is taken without asking but what is often met, in cells of one pixel."""
    if name == "moreno-taubin" and (cell > 1 or min(count_bits(length, 1) for length in size) < 10):
        pytest.skip("its cells follow from ten bits an axis")
    fits, true = fitting(name, size, cell, Given())
    assert (size, true) in [(fit.size, fit.patterns) for fit in fits]
    taken = fits[0]
    if is_clear(fits, Given()):
        assert taken.is_often or len(fits) == 1
        assert taken.cell == 1
        assert taken.size[0] <= size[0]
    elif len(fits) > 1:
        assert [fit.is_usual for fit in fits] == sorted([fit.is_usual for fit in fits], reverse=True)


@pytest.mark.parametrize(
    ("name", "size", "cell", "expected"),
    [
        ("moreno-taubin", (1920, 1080), 1, ["1920 × 1080 in cells of 2 px", "3840 × 2160 in cells of 4 px"]),
        ("opencv", (1280, 720), 2, ["1280 × 720 in cells of 2 px", "640 × 360 in cells of 1 px"]),
        ("opencv", (1024, 768), 2, ["1024 × 768 in cells of 2 px", "2048 × 1536 in cells of 4 px"]),
    ],
)
def test_what_also_fits_is_asked(name: str, size: Size, cell: int, expected: list[str]) -> None:
    fits, _ = fitting(name, size, cell, Given())
    assert not is_clear(fits, Given())
    assert [str(fit) for fit in fits][:2] == expected


@pytest.mark.parametrize("size", [(1280, 720), (1024, 768), (1920, 1080), (800, 600)])
def test_usual_projectors_in_single_pixels_are_taken(size: Size) -> None:
    fits, true = fitting("opencv", size, 1, Given())
    assert is_clear(fits, Given())
    assert (fits[0].size, fits[0].patterns) == (size, true)


@settings(max_examples=40)
@given(size=st.sampled_from(MARKET), cell=st.sampled_from([1, 2, 4]), lost=st.integers(0, 1))
def test_codes_that_end_a_pixel_short_are_those_of_a_usual_size(size: Size, cell: int, lost: int) -> None:
    """The rim's last code is often blurred away: 511 × 384 codes are 1024 × 768 in cells of two."""
    candidate = candidate_of("opencv", size, cell)
    true = candidate.on(size, cell)[0]
    (_, right), (_, bottom) = codes_of(true, size)
    seen = Extent(0, right - lost, begins=True, ends=True), Extent(0, bottom - lost, begins=True, ends=True)
    fits = find_sizes(candidate, seen, Given())
    assert size in [fit.size for fit in fits]
    assert fits[0].is_usual


def test_a_given_cell_that_leads_to_no_usual_projector_is_questioned() -> None:
    """Cells of four would make 1023 × 767 codes a projector of 4092 × 3068."""
    candidate = candidate_of("opencv", (1024, 768), 1)
    straight = Extent(0, 1022, begins=True, ends=True), Extent(0, 766, begins=True, ends=True)
    known = Given(cell=4)
    fits = find_sizes(candidate, straight, known)
    assert not is_clear(fits, known)
    assert str(fits[0]) == "1024 × 768 in cells of 1 px"
    assert str(fits[-1]) == "4092 × 3068 in cells of 4 px"


@pytest.mark.parametrize(
    ("given_size", "fits_it"), [((1280, 720), False), ((1920, 1080), True), ((3840, 2160), True), ((1024, 768), True)]
)
def test_a_given_size_has_to_have_the_codes(given_size: Size, fits_it: bool) -> None:
    candidate = candidate_of("moreno-taubin", (1920, 1080), 1)
    extents = extents_of(candidate.on((1920, 1080), 1)[0], (1920, 1080))
    known = Given(given_size)
    fits = find_sizes(candidate, extents, known)
    assert bool(fits) == fits_it
    if fits:
        assert is_clear(fits, known)
        assert fits[0].is_contradicted == (given_size == (1024, 768)), (
            "the picture is seen to begin and to end elsewhere"
        )


def test_another_size_is_measured_where_both_ends_are_seen() -> None:
    size = (500, 400)
    candidate = candidate_of("opencv", size, 1)
    straight = Extent(0, 499, begins=True, ends=True), Extent(0, 399, begins=True, ends=True)
    fits = find_sizes(candidate, straight, Given())
    assert size in [fit.size for fit in fits]
    assert not any(fit.is_usual for fit in fits if fit.size == size)
    unseen = Extent(0, 450, begins=True, ends=False), Extent(0, 380, begins=True, ends=False)
    assert size not in [fit.size for fit in find_sizes(candidate, unseen, Given())]
