"""Every mix of patterns that a capture may hold, on one scene with ground truth."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from scanner.patterns import (
    Axis,
    Black,
    Gray,
    Pattern,
    Phase,
    White,
    gray_sequence,
    phase_sequence,
    sequence_for,
    xor_sequence,
)
from tests.support.synthetic_capture import Scene, fringes

SCENE = Scene()
LENGTHS: tuple[tuple[Axis, int], ...] = (("x", 300), ("y", 200))


def without_white_and_black(patterns: tuple[Pattern, ...]) -> tuple[Pattern, ...]:
    return tuple(pattern for pattern in patterns if not isinstance(pattern, White | Black))


def standard(**options: Any) -> tuple[Pattern, ...]:
    return sequence_for(SCENE.projector, **options)


def codes(cell: int) -> tuple[Pattern, ...]:
    return (*gray_sequence("x", 300, cell), *gray_sequence("y", 200, cell))


def on_base(cell: int, above_finest: int) -> tuple[Pattern, ...]:
    x, y = (xor_sequence(axis, n, cell, above_finest=above_finest) for axis, n in LENGTHS)
    return (*x, *y)


def shifted(patterns: tuple[Pattern, ...], offset: int, bits: int) -> tuple[Pattern, ...]:
    """Return codes with an offset, with as many bits as that takes."""
    axes = {p.axis: p for p in patterns if isinstance(p, Gray)}
    return tuple(
        Gray(axis, bit, bits, p.cell, offset, inverted)
        for axis, p in axes.items()
        for bit in range(bits)
        for inverted in (False, True)
    )


UNEVEN = tuple(Phase(axis, 16.0, shift) for axis in ("x", "y") for shift in (-0.3, -0.05, 0.1, 0.33, 0.5, 0.7))


@dataclass(frozen=True)
class Case:
    """Largest errors of a coordinate in px, `median` and `largest` (99.9 %); `kept`: least share of the lit pixels."""

    name: str
    patterns: tuple[Pattern, ...]
    median: tuple[float, float]
    largest: float
    kept: float
    scene: Scene = SCENE

    def __str__(self) -> str:
        return self.name


CASES = [
    Case("standard", standard(), (0.005, 0.03), 0.6, 0.999),
    Case("without inverses", standard(inverses=False), (0.005, 0.03), 0.6, 0.999),
    Case("without white and black", without_white_and_black(standard()), (0.005, 0.03), 0.6, 0.999),
    Case("neither", without_white_and_black(standard(inverses=False)), (0.005, 0.03), 0.6, 0.999),
    Case("white, but no black", standard(inverses=False)[:1] + standard(inverses=False)[2:], (0.005, 0.03), 0.6, 0.999),
    Case("only the inverses", (White(), Black(), *codes(8)[1::2], *fringes([16], 8)), (0.005, 0.03), 0.6, 0.999),
    Case("frames in another order", tuple(reversed(standard())), (0.005, 0.03), 0.6, 0.999),
    Case("one period in eight shifts", standard(periods=(16.0,), shifts=8), (0.005, 0.03), 0.6, 0.999),
    Case("XOR code", standard(code="xor"), (0.005, 0.03), 0.6, 0.97),
    Case("XOR code without inverses", standard(code="xor", inverses=False), (0.005, 0.03), 0.6, 0.97),
    Case("XOR code on a coarser base", (*on_base(8, 2), *fringes([16], 8)), (0.005, 0.03), 0.6, 0.97),
    Case("both codes", standard(code="both"), (0.005, 0.03), 0.6, 0.998),
    Case("three shifts", standard(shifts=3), (0.01, 0.06), 0.7, 0.998),
    Case("shifts at will", (*codes(8), *UNEVEN), (0.01, 0.05), 0.7, 0.999, replace(SCENE, gamma=1.0)),
    Case("offset cells", (*shifted(codes(8), 100, 6), *fringes([16], 5)), (0.01, 0.04), 0.6, 0.999),
    Case("two periods", (*codes(16), *fringes([16, 11], 6)), (0.005, 0.03), 0.6, 0.999),
    Case("cell as long as the period", (*codes(50), *fringes([50, 100 / 3], 3)), (0.02, 0.1), 1.0, 0.99),
    Case("cell and single period", (*codes(16), *fringes([16], 8)), (0.005, 0.03), 0.6, 0.7),
    Case("fringes only, to the axis", fringes([320, 40, 16], 8), (0.005, 0.03), 0.7, 0.999),
    Case("fringes only, beating", fringes([21, 19, 17], 8), (0.005, 0.03), 0.7, 0.999),
    Case("a long fringe", fringes([400], 16), (0.1, 0.8), 20.0, 0.99, replace(SCENE, indirect=0.0)),
    Case("code, cell 1", standard(shifts=0, cell=1), (0.004, 0.02), 0.8, 0.999),
    Case("XOR code on a coarser base, cell 4", (White(), Black(), *on_base(4, 2)), (0.02, 0.15), 1.0, 0.4),
    Case("XOR code, cell 4", standard(shifts=0, cell=4, code="xor"), (0.02, 0.15), 1.0, 0.4),
    Case("code, cell 4", standard(shifts=0, cell=4), (0.004, 0.02), 1.0, 0.97),
    Case("bare code", without_white_and_black(standard(shifts=0, cell=4, inverses=False)), (0.008, 0.03), 1.0, 0.97),
    Case("two codes", (*codes(4), *shifted(codes(4), 2, 7)), (0.004, 0.02), 1.5, 0.97),
    Case("code, a quarter turn", standard(shifts=0, cell=2), (0.004, 0.02), 1.0, 0.5, replace(SCENE, turn_deg=85.0)),
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_every_mix_decodes(case: Case) -> None:
    decoding = case.scene.decode(case.patterns)
    errors = np.abs(case.scene.errors(decoding))
    assert case.median[0] < np.median(errors) < case.median[1]
    assert np.quantile(errors.max(axis=1), 0.999) < case.largest
    assert np.mean(decoding.reasons[SCENE.well_lit()] == 0) > case.kept


def test_one_axis_with_fringes_and_one_with_a_code() -> None:
    patterns: tuple[Pattern, ...] = (
        White(),
        Black(),
        *gray_sequence("x", 300, 8),
        *phase_sequence("x", 16, 8),
        *gray_sequence("y", 200, 4),
    )
    decoding = SCENE.decode(patterns)
    errors = np.abs(SCENE.errors(decoding))
    assert 0.005 < np.median(errors[:, 0]) < 0.03
    assert 0.8 < np.median(errors[:, 1]) < 1.2, "cells of 4 px: evenly spread up to 2"
    assert np.mean(decoding.reasons[SCENE.well_lit()] == 0) > 0.95
    assert len(decoding.matches) == np.count_nonzero(decoding.reasons == 0), "one match per pixel"


def test_an_xor_code_gives_one_match_per_cell() -> None:
    decoding = SCENE.decode(standard(shifts=0, cell=4, code="xor"))
    cells = decoding.matches.projector_px
    assert len(np.unique(cells, axis=0)) == len(cells)
    assert 1000 < len(cells) < 75 * 50
    assert np.allclose((cells - 1.5) % 4, 0), "cell centres"
    fractions = decoding.matches.camera_px % 1
    assert np.mean((fractions > 0.1) & (fractions < 0.9)) > 0.5, "between camera pixels"


@pytest.mark.parametrize("cell", [2, 3, 5])
def test_between_the_edges_of_stripes_each_pixel_has_a_match(cell: int) -> None:
    decoding = SCENE.decode(standard(shifts=0, cell=cell))
    assert np.mean(decoding.reasons[SCENE.well_lit()] == 0) > 0.95, "but for cells that are cut off"
    errors = SCENE.errors(decoding)
    assert len(errors) == np.count_nonzero(decoding.reasons == 0)
    scatter = np.sqrt(np.mean(np.clip(errors, -1, 1) ** 2, axis=0))
    assert np.all((scatter > 0.01) & (scatter < 0.08)), "a cell over the root of 12: 0.6 to 1.4"
    assert np.all(np.abs(np.median(errors, axis=0)) < 0.005), "to neither side"


def test_cells_that_are_cut_off_are_left_out() -> None:
    decoding = SCENE.decode(standard(shifts=0, cell=4, code="xor"))
    assert 0.7 < np.mean(decoding.reasons[SCENE.well_lit()] == 0) < 0.9, "a sixth of the cells is on box and wall"
    assert np.all(np.percentile(np.abs(SCENE.errors(decoding)), 99, axis=0) < 0.6)


def test_sigmas_match_the_errors() -> None:
    code = standard(shifts=0, cell=2)
    for patterns in (standard(), standard(periods=(16.0,), shifts=3), fringes([21, 19, 17], 8), code):
        decoding = SCENE.decode(patterns)
        assert decoding.matches.sigma_px is not None
        ratio = SCENE.errors(decoding) / decoding.matches.sigma_px[:, None]
        assert 0.8 < np.std(np.clip(ratio, -6, 6)) < 1.3
