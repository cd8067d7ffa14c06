"""Bits of a Gray code that something moving has spoilt are decided by the surface around them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.numerics import Bools
from scanner.decoding import MaskReason, plan_sequence
from scanner.decoding.codes import CodeWords, cell_numbers
from scanner.decoding.motion.wrong_bits import repair_bits
from scanner.patterns import Gray, sequence_for
from tests.support.findings import kinds_of
from tests.support.synthetic_capture import Scene, decode

PROJECTOR = 512, 384
PATTERNS = sequence_for(PROJECTOR, cell=1, shifts=0)
SHAPE = 120, 160


def folded(position: np.ndarray, corrupted: dict[int, Bools], seed: int) -> tuple[CodeWords, dict[int, np.ndarray]]:
    """Return the code along x at these positions (H, W) and its frames, with random levels where a bit is spoilt."""
    (code,) = plan_sequence(PATTERNS, PROJECTOR).x.codes
    rng = np.random.default_rng(seed)
    number = np.floor(position + code.offset + 0.5).astype(np.uint32)
    word = number ^ number >> 1
    fold, frames = CodeWords(code, SHAPE, np.dtype(np.uint8), contrast=True), {}
    for bit, pair in code.pairs.items():
        lit = np.where(word >> (code.bits - 1 - bit) & 1, 200, 40).astype(np.uint8)
        of_pair = [lit, 240 - lit]
        for k, frame in enumerate(pair):
            where = corrupted.get(bit, np.zeros(SHAPE, np.bool_))
            frames[frame] = np.where(where, rng.integers(20, 120, SHAPE), of_pair[k]).astype(np.uint8)
    fold.fill(frames, {})
    return fold, frames


@settings(max_examples=25)
@given(
    st.floats(0.6, 1.6), st.floats(-0.3, 0.3), st.integers(0, 4), st.booleans(), st.integers(5, 90), st.integers(0, 99)
)
def test_spoilt_bits_of_a_slanted_surface_are_decided(
    across: float, down: float, bit: int, mirrored: bool, left: int, seed: int
) -> None:
    rows, columns = np.indices(SHAPE)
    position = 250 + (-1 if mirrored else 1) * across * (columns - 80) + down * (rows - 60)
    places = [np.zeros(SHAPE, np.bool_) for _ in range(2)]
    places[0][10:110, left : left + 40] = True
    places[1][10:110, left + 30 : left + 60] = True  # overlaps with the first
    corrupted = dict(zip((bit, bit + 1), places, strict=True))
    fold, frames = folded(position, corrupted, seed)
    somewhere = places[0] | places[1]
    fold, decided = repair_bits(fold, corrupted, frames, ~somewhere)
    right = cell_numbers(fold.words) == np.floor(position + fold.code.offset + 0.5)
    assert not decided[~somewhere].any()
    assert right[decided].mean() > 0.995
    assert decided[somewhere].mean() > 0.6
    assert fold.least[decided].min() == 160, "the contrast of the bits that are not spoilt"


def test_nothing_is_decided_where_coordinates_grow_in_no_direction() -> None:
    position = np.random.default_rng(0).uniform(0, 500, SHAPE)
    corrupted = {3: np.ones(SHAPE, np.bool_)}
    corrupted[3][:, :60] = False
    fold, frames = folded(position, corrupted, 0)
    assert not repair_bits(fold, corrupted, frames, ~corrupted[3])[1].any()


@pytest.mark.parametrize(("bits", "least", "most"), [(2, 0.6, 1.0), (5, 0.0, 0.0)])
def test_pixels_that_are_hidden_for_long_stay_spoilt(bits: int, least: float, most: float) -> None:
    place = np.zeros(SHAPE, np.bool_)
    place[10:110, 60:75] = True
    corrupted = dict.fromkeys(range(1, 1 + bits), place)
    fold, frames = folded(100 + 1.2 * np.indices(SHAPE)[1], corrupted, 0)
    assert least <= np.mean(repair_bits(fold, corrupted, frames, ~place)[1][place]) <= most


@pytest.mark.parametrize("first", [4, 8], ids=["coarse", "finer"])
def test_somebody_who_goes_past_leaves_most_of_the_picture(first: int) -> None:
    """Three parts of the picture are hidden one after the other, each during the frames of one bit."""
    scene = Scene()
    patterns = sequence_for(scene.projector, cell=1, shifts=0)
    other = replace(scene, turn_deg=-20.0, zoom=0.6, exposure=400.0, seed=2)
    frames, lit = scene.frames(patterns), scene.well_lit()
    columns = np.flatnonzero(lit.any(axis=0))
    edges = np.quantile(columns, [0.05, 0.35, 0.65, 0.95]).astype(int)
    for number, left, right in zip(range(first, first + 6, 2), edges, edges[1:], strict=False):
        pattern = patterns[number]
        assert isinstance(pattern, Gray)
        for frame in (number, number + 1):
            frames[frame] = frames[frame].copy()
            frames[frame][:, left:right] = other.frame(patterns[frame], frame)[:, left:right]
    decoding = decode(patterns, frames, scene.projector)
    kept = decoding.reasons == MaskReason.KEPT
    assert 0.5 < np.mean(kept[lit]) < 0.98
    assert np.mean(np.abs(scene.errors(decoding)).max(axis=1) > 1.5) < 0.01
    assert "moving-object" in kinds_of(decoding.findings)
